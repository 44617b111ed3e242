"""Exact step responses of linear models, for predictions and for overshoot and settling time without a simulation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsgdesign.linear.model.coupled import INPUTS, OUTPUTS, CoupledModel
from vsgdesign.linear.model.full_order import INPUTS as FULL_INPUTS
from vsgdesign.linear.model.full_order import OUTPUTS as FULL_OUTPUTS
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.operating_point.plant import transitions
from vsgdesign.metrics.modes import Eigen, partial_fractions, taken
from vsgdesign.metrics.step_response import SETTLING_BAND, ResponseMetrics, settling_times, step_response

Array = NDArray[np.float64]

_CELLS = 64
"""Cells whose powers are kept at once."""


_FASTEST_GROWTH = 100.0
"""ln of the largest growth of a response within one of its steps."""
_STIFFEST = 1e14
"""Largest norm of A·dt of which the exponential has digits left."""


def reduced_step(model: CoupledModel, input_: str, output: str, t_end: float, dt: float) -> tuple[Array, Array]:
    """Unit step responses (N, K) of the reduced model at times (K,): exact at the samples.

    The model is sampled by its matrix exponential over ``dt``, and its response is a sum over the modes. A cell that
    grows by more than e^100 within ``dt``, or whose exponential is nothing but rounding, has no response: infinity.
    """
    column, row = INPUTS.index(input_), OUTPUTS.index(output)
    count = round(t_end / dt) + 1
    y = np.full((len(model.A), count), np.inf)
    slow = np.linalg.eigvals(model.A).real.max(axis=1) * dt < _FASTEST_GROWTH
    k = np.flatnonzero(slow & (np.abs(model.A).sum(axis=1).max(axis=1) * dt < _STIFFEST))
    A, b = transitions(model.A[k], model.B[k][:, :, [column]], dt)
    y[k] = sampled_steps(A, b, model.C[k][:, [row]], model.D[k][:, [row]][:, :, [column]], 1, count)[..., 0, 0]
    return np.arange(count, dtype=np.float64) * dt, y


def full_order_step(
    model: FullOrderModel, input_: str, output: str, t_end: float, every: int = 1
) -> tuple[Array, Array]:
    """Unit step responses (N, K) of the sampled model, one value every given number of samples (K,)."""
    column, row = FULL_INPUTS.index(input_), FULL_OUTPUTS.index(output)
    count = round(t_end / model.T_s) // every + 1
    parts = model.B[:, :, [column]], model.C[:, [row]], model.D[:, [row]][:, :, [column]]
    k = every * np.arange(count, dtype=np.float64)
    return k * model.T_s, sampled_steps(model.A, *parts, every, count, model.eigen)[..., 0, 0]


def sampled_steps(
    A: Array, B: Array, C: Array, D: Array, every: int | Array, count: int, known: Eigen | None = None
) -> Array:
    """Unit step responses (N, count, outputs, inputs) of N sampled models at 0, ``every``, 2·``every`` … samples, as
    a sum over the modes.

    A mode z adds R (zᵏ − 1)/(z − 1) to sample k. A cell with (nearly) defective modes is stepped instead. ``every`` may
    be (N,), one for each model. ``known``: the eigenvectors of A, if they were computed before.
    """
    modes, steps = partial_fractions(A, B, C, known), np.broadcast_to(np.asarray(every, dtype=float), len(A))
    outputs, inputs = D.shape[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = modes.residues / (modes.poles - 1.0)[:, :, None, None]
    # Powers are products of coarse and fine ones, which are few: k = coarse·fine_count + fine.
    fine = max(int(np.sqrt(count)), 1)
    coarse = -(-count // fine)
    log_z = np.log(np.where(modes.poles == 0.0, 1e-300, modes.poles)) * steps[:, None]
    y = np.empty((len(A), count, outputs, inputs))
    for start in range(0, len(A), _CELLS):
        part = slice(start, start + _CELLS)
        with np.errstate(over="ignore", invalid="ignore"):
            small = np.exp(log_z[part, :, None] * np.arange(fine))
            large = np.exp(fine * np.arange(coarse)[:, None] * log_z[part, None, :])
            for i, j in np.ndindex(outputs, inputs):
                weight = weights[part, :, i, j]
                sums = ((large * weight[:, None]) @ small).real.reshape(len(small), -1)[:, :count]
                y[part, :, i, j] = sums - weight.sum(axis=1).real[:, None]
    for cell in np.flatnonzero(~modes.usable):
        y[cell] = _stepped(A[cell], B[cell], C[cell], int(steps[cell]), count)
    return y + D[:, None]


def _stepped(A: Array, B: Array, C: Array, every: int, count: int) -> Array:
    """The same (count, outputs, inputs) of one model without feedthrough, by a map over ``every`` samples."""
    n, inputs = B.shape
    one = np.block([[A, B], [np.zeros((inputs, n)), np.eye(inputs)]])
    several = np.linalg.matrix_power(one, every)
    x = np.vstack([np.zeros((n, inputs)), np.eye(inputs)])
    y = np.empty((count, len(C), inputs))
    for k in range(count):
        y[k] = C @ x[:n]
        x = several @ x
    return y


def reduced_step_metrics(
    model: CoupledModel, input_: str, output: str, t_end: float = 12.0, dt: float = 1e-3
) -> list[ResponseMetrics | None]:
    """Overshoot, settling and rise time of each cell relative to its own final value; None for an unstable cell and for
    one without a response."""
    t, y = reduced_step(model, input_, output, t_end, dt)
    column, row = INPUTS.index(input_), OUTPUTS.index(output)
    found: list[ResponseMetrics | None] = []
    for k, A in enumerate(model.A):
        if np.linalg.eigvals(A).real.max() >= 0.0 or not np.isfinite(y[k]).all():
            found.append(None)
            continue
        final = float(model.D[k, row, column] - model.C[k, row] @ np.linalg.solve(A, model.B[k, :, column]))
        found.append(step_response(t, y[k], 0.0, final))
    return found


_TIME_CONSTANTS = 10.0
"""Time constants of the slowest mode over which a step is observed."""
_OBSERVED_S = (1.0, 120.0)


def full_order_settling(model: FullOrderModel, input_: str, output: str, points: int = 4000) -> tuple[Array, Array]:
    """2 % settling time in s and overshoot as a share of the step, (N,) each, of the sampled model's unit steps.

    Both are relative to the cell's own final value. A step is observed over 10 time constants of the cell's slowest
    mode, from 1 s to 120 s, at about so many ``points``. NaN for an unstable cell; the settling time is infinite where
    the response is still outside the band at the end.
    """
    column, row = FULL_INPUTS.index(input_), FULL_OUTPUTS.index(output)
    settling, overshoot = np.full(len(model.A), np.nan), np.full(len(model.A), np.nan)
    if len(model.A) == 0:
        return settling, overshoot
    decay = -np.log(np.abs(model.eigen.values).max(axis=1)) / model.T_s
    k = np.flatnonzero(decay > 0.0)
    A, b, c, d = model.A[k], model.B[k][:, :, [column]], model.C[k][:, [row]], model.D[k][:, [row]][:, :, [column]]
    final = (d + c @ np.linalg.solve(np.eye(A.shape[-1]) - A, b))[:, 0, 0]
    every = np.maximum(np.round(np.clip(_TIME_CONSTANTS / decay[k], *_OBSERVED_S) / points / model.T_s), 1.0)
    y = sampled_steps(A, b, c, d, every, points, taken(model.eigen, k))[..., 0, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        progress = y / final[:, None]
    overshoot[k] = np.maximum(progress.max(axis=1) - 1.0, 0.0)
    settling[k] = settling_times(every * model.T_s, np.abs(progress - 1.0), SETTLING_BAND)
    return settling, overshoot
