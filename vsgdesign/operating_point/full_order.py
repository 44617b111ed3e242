"""The full-order model at solved steady states: matrices of many cells, modes and their sensitivities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller_data import flat_settings
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.model.full_order import PARAMETERS, FullOrderMap, LimiterInModel, full_order_map, limiter_states
from vsgdesign.operating_point.plants import state_matrices
from vsgdesign.operating_point.sampled import SampledState, cold_start, steady_state
from vsgdesign.parameters.study import Grid, GridSource, Study

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Cell:
    """One grid and operating point at which the model is linearised."""

    grid: Grid
    gains: PowerLoopGains
    P_ref: float
    Q_ref: float
    source: GridSource | None = None
    """None: the study's own."""


@dataclass(frozen=True, kw_only=True)
class FullOrderModel:
    """Discrete-time model of N cells, z' = A z + B u, y = C z + D u, at their steady states.

    States are named in ``states``; inputs and outputs are model.full_order's INPUTS and OUTPUTS. ``faults``
    holds, per requested cell, None or why it has no steady state; the arrays hold the good cells only, in
    order, and ``index`` says which requested cell each is.
    """

    states: tuple[str, ...]
    T_s: float
    z: Array
    p: Array
    A: Array
    B: Array
    C: Array
    D: Array
    index: NDArray[np.intp]
    faults: tuple[str | None, ...]
    map: FullOrderMap


def linearise_full_order(study: Study, cells: Sequence[Cell]) -> FullOrderModel:
    """Linearises at the steady state of every cell.

    A cell without one is recorded in ``faults`` and raises no error.
    """
    settings = study.controller_settings()
    rows, params, good, faults = [], [], [], []
    functions = full_order_map(
        study.converter.delay_samples,
        study.tau_P > 0.0,
        study.tau_Q > 0.0,
        study.inner_gains.R_t != 0.0 or study.inner_gains.X_t != 0.0,
        _squarings(study, cells),
        LimiterInModel(
            law=study.limiter.law, memory=type(cold_start(study).controller.limiter), constants=type(settings.limiter)
        ),
        study.has_notch,
    )
    for k, cell in enumerate(cells):
        source = cell.source or study.grid_source
        try:
            start = steady_state(study, cell.grid, source, cell.P_ref, cell.Q_ref, cell.gains)
        except InfeasibleStudyError as error:
            faults.append(str(error))
            continue
        faults.append(None)
        good.append(k)
        rows.append(pack(functions.states, start))
        params.append([*parameter_values(study, cell), *flat_settings(settings)])
    z = np.array(rows).reshape(len(good), len(functions.states))
    p = np.array(params).reshape(len(good), functions.step.size1_in(1))
    A, B, C, D = _matrices(functions, z, p)
    return FullOrderModel(
        states=functions.states,
        T_s=settings.T_s,
        z=z,
        p=p,
        A=A,
        B=B,
        C=C,
        D=D,
        index=np.array(good, dtype=int),
        faults=tuple(faults),
        map=functions,
    )


def parameter_values(study: Study, cell: Cell) -> list[float]:
    """The map's PARAMETERS for a cell, in order."""
    source = cell.source or study.grid_source
    c = study.converter
    return [
        *study.circuit(cell.grid),
        *cell.gains,
        *study.inner_gains,
        cell.P_ref,
        cell.Q_ref,
        c.omega_n,
        c.V_rated_rms,
        source.V_g_rms,
        source.omega_g,
    ]


def pack(states: Sequence[str], start: SampledState) -> list[float]:
    """A sampled steady state (source at phase zero) as the map's state vector."""
    s = start.controller
    values = {
        **dict(zip(("i_s_d", "i_s_q", "v_c_d", "v_c_q", "i_g_d", "i_g_q"), start.plant, strict=True)),
        "pending_d": start.pending[0],
        "pending_q": start.pending[1],
        "delta": s.theta,
        **s._asdict(),
        **dict(zip(limiter_states(s.limiter._fields), s.limiter, strict=True)),
    }
    return [float(values[name]) for name in states]


def _squarings(study: Study, cells: Sequence[Cell]) -> int:
    """Enough that the exponential's series sees at most half a radian (or neper) of the fastest mode."""
    grids = {cell.grid for cell in cells}
    fastest = max(
        (float(np.abs(np.linalg.eigvals(state_matrices(study.circuit(g))[0])).max()) for g in grids), default=1.0
    )
    return max(0, math.ceil(math.log2(2.0 * fastest * study.converter.T_s)))


def _matrices(functions: FullOrderMap, z: Array, p: Array) -> tuple[Array, Array, Array, Array]:
    count = len(z)
    if count == 0:
        shapes = [functions.linear.size_out(k) for k in range(4)]
        return tuple(np.empty((0, *shape)) for shape in shapes)  # type: ignore[return-value]
    outputs = functions.linear.map(count)(z.T, p.T)
    matrices = []
    for k, out in enumerate(outputs):
        shape = functions.linear.size_out(k)
        matrices.append(np.array(out).reshape(shape[0], count, shape[1]).transpose(1, 0, 2))
    return tuple(matrices)  # type: ignore[return-value]


def parameter_sensitivity(model: FullOrderModel, cell: int, parameter: str) -> Array:
    """dA/dp of one good cell for a PARAMETER, its steady state following (:eq:`eigenvalue-sensitivity`).

    dz/dp = (I − A)⁻¹ ∂F/∂p, then the directional derivative of A, both by automatic differentiation.
    """
    if parameter not in PARAMETERS:
        raise ValueError(f'parameter = "{parameter}": must be one of {", ".join(PARAMETERS)}')
    column = PARAMETERS.index(parameter)
    z, p, A = model.z[cell], model.p[cell], model.A[cell]
    of_p = np.array(model.map.of_parameters(z, p))[:, column]
    dz = np.linalg.solve(np.eye(len(z)) - A, of_p)
    dp = np.zeros_like(p)
    dp[column] = 1.0
    return np.array(model.map.directional(z, p, dz, dp))


__all__ = [
    "Cell",
    "FullOrderModel",
    "linearise_full_order",
    "pack",
    "parameter_sensitivity",
    "parameter_values",
]
