"""Exact step responses of linear models, for predictions and for overshoot and settling time without a simulation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from vsgdesign.metrics.modes import partial_fractions
from vsgdesign.metrics.step_response import ResponseMetrics, step_response
from vsgdesign.model.coupled import INPUTS, OUTPUTS, CoupledModel
from vsgdesign.model.full_order import INPUTS as FULL_INPUTS
from vsgdesign.model.full_order import OUTPUTS as FULL_OUTPUTS
from vsgdesign.operating_point.full_order import FullOrderModel

Array = NDArray[np.float64]

_BLOCK = 256
"""Steps whose states are kept, so that outputs are made of many at once."""


def reduced_step(model: CoupledModel, input_: str, output: str, t_end: float, dt: float) -> tuple[Array, Array]:
    """Unit step responses (N, K) of the reduced model at times (K,): exact at the samples."""
    column, row = INPUTS.index(input_), OUTPUTS.index(output)
    count, n, _ = model.A.shape
    augmented = np.zeros((count, n + 1, n + 1))
    augmented[:, :n, :n] = model.A * dt
    augmented[:, :n, n] = model.B[:, :, column] * dt
    step = np.array(expm(augmented), dtype=np.float64)
    return _recurse(step[:, :n, :n], step[:, :n, n], model.C[:, row], model.D[:, row, column], round(t_end / dt), dt)


def full_order_step(
    model: FullOrderModel, input_: str, output: str, t_end: float, every: int = 1
) -> tuple[Array, Array]:
    """Unit step responses (N, K) of the sampled model, one value every given number of samples (K,)."""
    column, row = FULL_INPUTS.index(input_), FULL_OUTPUTS.index(output)
    count = round(t_end / model.T_s) // every + 1
    parts = model.B[:, :, [column]], model.C[:, [row]], model.D[:, [row]][:, :, [column]]
    k = every * np.arange(count, dtype=np.float64)
    return k * model.T_s, sampled_steps(model.A, *parts, every, count)[..., 0, 0]


def sampled_steps(A: Array, B: Array, C: Array, D: Array, every: int, count: int) -> Array:
    """Unit step responses (N, count, outputs, inputs) of N sampled models at 0, ``every``, 2·``every`` … samples, as
    a sum over the modes.

    A mode z adds R (zᵏ − 1)/(z − 1) to sample k. A cell with (nearly) defective modes is stepped instead.
    """
    modes = partial_fractions(A, B, C)
    k = every * np.arange(count, dtype=np.float64)
    y = np.empty((len(A), count, *D.shape[1:]))
    for cell, z in enumerate(modes.poles):
        if not modes.usable[cell]:
            y[cell] = _stepped(A[cell], B[cell], C[cell], every, count)
            continue
        powers = np.exp(np.outer(k, np.log(np.where(z == 0.0, 1e-300, z)))) - 1.0
        y[cell] = np.tensordot(powers, modes.residues[cell] / (z - 1.0)[:, None, None], 1).real
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


def _recurse(A: Array, b: Array, c: Array, d: Array, steps: int, dt: float) -> tuple[Array, Array]:
    y = np.empty((len(b), steps + 1))
    states = np.zeros((_BLOCK + 1, *b.shape))
    for first in range(0, steps + 1, _BLOCK):
        count = min(_BLOCK, steps + 1 - first)
        for k in range(count):
            np.einsum("ijk,ik->ij", A, states[k], out=states[k + 1])
            states[k + 1] += b
        y[:, first : first + count] = np.einsum("ij,kij->ik", c, states[:count]) + d[:, None]
        states[0] = states[count]
    return np.arange(steps + 1, dtype=np.float64) * dt, y


def reduced_step_metrics(
    model: CoupledModel, input_: str, output: str, t_end: float = 12.0, dt: float = 1e-3
) -> list[ResponseMetrics | None]:
    """Overshoot, settling and rise time of each cell relative to its own final value; None for an unstable cell."""
    t, y = reduced_step(model, input_, output, t_end, dt)
    column, row = INPUTS.index(input_), OUTPUTS.index(output)
    found: list[ResponseMetrics | None] = []
    for k, A in enumerate(model.A):
        if np.linalg.eigvals(A).real.max() >= 0.0:
            found.append(None)
            continue
        final = float(model.D[k, row, column] - model.C[k, row] @ np.linalg.solve(A, model.B[k, :, column]))
        found.append(step_response(t, y[k], 0.0, final))
    return found
