"""The full-order model at solved steady states: matrices of many cells, modes and their sensitivities."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller_data import flat_settings
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.linear.model.dc_link import LinkInModel
from vsgdesign.linear.model.full_order import (
    PARAMETERS,
    ControllerMap,
    FullOrderMap,
    LimiterInModel,
    controller_map,
    full_order_map,
    limiter_states,
    watched_map,
)
from vsgdesign.linear.operating_point.dc_rest import power_of_plant, series_of
from vsgdesign.linear.operating_point.many import Lanes, ManyStates, clamped_lanes, lanes_of, many_steady_states
from vsgdesign.linear.operating_point.plant import state_matrices
from vsgdesign.linear.operating_point.sampled import SampledState, cold_start, fault_of_rest
from vsgdesign.metrics.modes import Eigen, eigen
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

_AT_ONCE = 1000
"""Lanes whose matrices are made at once: what they need stays small."""


@dataclass(frozen=True)
class Cell:
    """One grid and operating point at which the model is linearised."""

    grid: Grid
    gains: PowerLoopGains
    P_ref: float
    Q_ref: float
    source: GridSource | None = None
    """The grid source; None stands for that of the study."""
    omega_0: float | None = None
    V_n: float | None = None
    """The other set points, rad/s and phase rms V; None: nominal."""
    link: DcLink | None = None
    """The dc link; None: that of the study."""

    @classmethod
    def with_references(
        cls, grid: Grid, gains: PowerLoopGains, refs: References, source: GridSource, link: DcLink | None = None
    ) -> Cell:
        """The cell of these set points."""
        return cls(grid, gains, refs.P_ref, refs.Q_ref, source, refs.omega_0, refs.V_n, link)

    def lanes(self, study: Study) -> Lanes:
        """Grid, source and set points on a study's converter."""
        nominal = study.converter.references(self.P_ref, self.Q_ref)
        refs = nominal._replace(
            omega_0=nominal.omega_0 if self.omega_0 is None else self.omega_0,
            V_n=nominal.V_n if self.V_n is None else self.V_n,
        )
        return Lanes.at(self.grid, self.source or study.grid_source, refs)


@dataclass(frozen=True, kw_only=True)
class FullOrderModel:
    """Discrete-time model of N cells, z' = A z + B u, y = C z + D u, at their steady states.

    ``states`` has the names of the states. Inputs and outputs are INPUTS and OUTPUTS of
    :mod:`vsgdesign.linear.model.full_order`. ``faults`` has for each requested cell None, or the reason why it has no
    steady state. The arrays contain only the cells with a steady state, in order, and ``index`` has their numbers.
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
    steady: ManyStates | None = None

    @functools.cached_property
    def eigen(self) -> Eigen:
        """Eigenvalues (of z) and eigenvectors of A, computed once."""
        return eigen(self.A)


class SteadyCells(NamedTuple):
    """The steady states of cells, None without a cell, what they were asked for, and for each of them None or the
    reason why there is none."""

    lanes: Lanes
    gains: PowerLoopGains
    states: ManyStates | None
    faults: tuple[str | None, ...]


def steady_cells(study: Study, cells: Sequence[Cell]) -> SteadyCells:
    """The steady state of every cell, with its droops, its limits and its gains."""
    at = [cell.lanes(study) for cell in cells]
    lanes = Lanes(*np.array(at, dtype=float).reshape(len(cells), len(Lanes._fields)).T)
    gains = PowerLoopGains(
        *np.array([cell.gains for cell in cells], dtype=float).reshape(len(cells), len(PowerLoopGains._fields)).T
    )
    if not cells:
        return SteadyCells(lanes, gains, None, ())
    links = None if study.dc is None else [cell.link or study.dc for cell in cells]
    lanes = clamped_lanes(study, links, lanes, gains)
    states = many_steady_states(study, lanes, gains, links=links)
    faults: list[str | None] = [None] * len(cells)
    for k in np.flatnonzero(states.fault).tolist():
        cell = cells[k]
        own = study if cell.link is None else replace(study, dc=cell.link)
        asked = (own, cell.grid, cell.source or study.grid_source, at[k].refs, cell.gains)
        faults[k] = str(fault_of_rest(*asked, states, lane=k))
    return SteadyCells(lanes, gains, states, tuple(faults))


def linearise_full_order(study: Study, cells: Sequence[Cell]) -> FullOrderModel:
    """Linearises at the steady state of every cell.

    A cell without a steady state raises no error. ``faults`` says why it has none.
    """
    lanes, gains, states, faults = steady_cells(study, cells)
    link = link_in_model(study)
    functions = _functions(study, lanes, link)
    good = np.arange(0)
    z, p = np.empty((0, len(functions.states))), np.empty((0, functions.step.size1_in(1)))
    if states is not None:
        good = np.flatnonzero(states.fault == 0)
        circuit = functions.states if link is None else functions.states[: -len(link.states)]
        z, p = pack(circuit, states)[good], parameters_of(study, lanes, gains)[good]
        if link is not None:
            held = [study if cell.link is None else replace(study, dc=cell.link) for cell in cells]
            rests = [link_at_rest(held[k], link, states.plant[:, k]) for k in good.tolist()]
            widths = len(link.states), len(link.parameters)
            own = (np.reshape(b, (len(good), n)) for b, n in zip(_split(rests), widths, strict=True))
            z, p = (np.hstack(pair) for pair in zip((z, p), own, strict=True))
    A, B, C, D = _matrices(functions.linear, z, p)
    return FullOrderModel(
        states=functions.states,
        T_s=study.converter.T_s,
        z=z,
        p=p,
        A=A,
        B=B,
        C=C,
        D=D,
        index=good,
        faults=faults,
        steady=states,
        map=functions,
    )


def link_in_model(study: Study) -> LinkInModel | None:
    """The dc link of a study; None: it is ideal."""
    if study.dc is None:
        return None
    kind = study.dc.kind
    order = 0 if study.dc.compensates else series_of(study)[0]
    return LinkInModel(kind.law, *kind.records, kind.moving, order, study.dc.droops)


def link_at_rest(study: Study, link: LinkInModel, plant: Array) -> tuple[list[float], list[float]]:
    """The states and the parameters of a dc link, with the circuit's states at rest, (6,)."""
    dc = study.dc
    if dc is None:
        raise ValueError("the dc link is ideal.")
    power = float(power_of_plant(study, plant))
    state = dc.at_rest(power, study.converter, study.filter)
    of = study.converter, study.filter
    return link.at_rest(state), link.values(dc.settings(*of), state, dc.droop(study.converter))


def _split(pairs: Sequence[tuple[list[float], list[float]]]) -> tuple[Array, Array]:
    first, second = (np.array([pair[k] for pair in pairs], dtype=float) for k in (0, 1))
    return first, second


def slowest_decay(
    study: Study,
    states: ManyStates,
    lanes: Lanes,
    gains: PowerLoopGains,
) -> Array:
    """Decay rates (N,) in 1/s of the slowest modes of the full-order model at N steady states; negative: it grows.

    ``lanes`` and ``gains`` are those with which ``states`` were found. The rate is NaN for a lane with a fault.
    """
    decay = np.full(len(states), np.nan)
    for good, A in _sample_matrices(study, states, lanes, gains)[1]:
        with np.errstate(divide="ignore"):
            decay[good] = -np.log(np.abs(np.linalg.eigvals(A)).max(axis=1)) / study.converter.T_s
    return decay


def sample_matrices(
    study: Study, states: ManyStates, lanes: Lanes, gains: PowerLoopGains
) -> tuple[tuple[str, ...], Array]:
    """The names of the states, and A (N, n, n) of the full-order model at N steady states, as :func:`slowest_decay`
    takes them. NaN for a lane with a fault."""
    names, parts = _sample_matrices(study, states, lanes, gains)
    found = np.full((len(states), len(names), len(names)), np.nan)
    for good, A in parts:
        found[good] = A
    return names, found


def _sample_matrices(
    study: Study, states: ManyStates, lanes: Lanes, gains: PowerLoopGains
) -> tuple[tuple[str, ...], Iterator[tuple[NDArray[np.intp], Array]]]:
    """The names of the states; then parts of the lanes without a fault, and A there."""
    count, good = len(states), np.flatnonzero(states.fault == 0)
    every, of_every = lanes_of(study, lanes, gains)
    lanes = Lanes._make(np.full(count, value)[good] for value in every)
    laws = PowerLoopGains._make(np.full(count, value)[good] for value in of_every)
    functions = _functions(study, lanes)
    z, p = pack(functions.states, states)[good], parameters_of(study, lanes, laws)

    def parts() -> Iterator[tuple[NDArray[np.intp], Array]]:
        for k in range(0, len(good), _AT_ONCE):
            part = slice(k, k + _AT_ONCE)
            yield good[part], _matrices(functions.state_matrix, z[part], p[part])[0]

    return functions.states, parts()


def watched_at(
    study: Study, states: ManyStates, lanes: Lanes, gains: PowerLoopGains
) -> tuple[tuple[str, ...], Array, Array]:
    """The states of the model, WATCHED of :mod:`vsgdesign.linear.model.full_order` (N, 9) at N steady states, and their
    derivative by the states (N, 9, n)."""
    names, function = watched_map(*_structure(study))
    values, derivative = _matrices(
        function, pack(names, states), parameters_of(study, *lanes_of(study, lanes, gains))
    )  # fmt: skip
    return names, values[:, :, 0], derivative


def parameter_values(study: Study, cell: Cell) -> list[float]:
    """The map's PARAMETERS for a cell, in order."""
    row = parameters_of(study, *lanes_of(study, cell.lanes(study), cell.gains))[0]
    return row[: len(PARAMETERS)].tolist()


def parameters_of(study: Study, lanes: Lanes, gains: PowerLoopGains) -> Array:
    """The map's p of every lane (N, len(p)): PARAMETERS, then the controller's constants."""
    values = (
        *study.circuit()._replace(R_g=lanes.R_g, L_g=lanes.L_g),
        *gains,
        *study.inner_gains,
        *lanes.refs,
        lanes.V_g_rms,
        lanes.omega_g,
        *flat_settings(study.controller_settings()),
    )
    rows = np.empty((len(values), len(lanes.R_g)))
    for row, value in zip(rows, values, strict=True):
        row[:] = value
    return rows.T.copy()


def pack(states: Sequence[str], start: SampledState | ManyStates) -> Array:
    """A sampled steady state (source at phase zero) as the map's state vector, (len(states),); many as (N, …)."""
    s = start.controller
    values = {
        **dict(zip(("i_s_d", "i_s_q", "v_c_d", "v_c_q", "i_g_d", "i_g_q"), start.plant, strict=True)),
        "pending_d": start.pending[0],
        "pending_q": start.pending[1],
        "delta": s.theta,
        **s._asdict(),
        **dict(zip(limiter_states(s.limiter._fields), s.limiter, strict=True)),
    }
    return np.array([values[name] for name in states], dtype=float).T.copy()


def _functions(study: Study, lanes: Lanes, link: LinkInModel | None = None) -> FullOrderMap:
    """The map of a study, with an exponential that is good on all of these grids. ``link``: of the model; None: the
    link is left out, and the others of the modes are the same."""
    *parts, limiter, notch = _structure(study)
    return full_order_map(*parts, _squarings(study, lanes.R_g, lanes.L_g), limiter, notch, link)


def controller_of(study: Study) -> ControllerMap:
    """The controller of a study alone."""
    return controller_map(*_structure(study))


def _structure(study: Study) -> tuple[int, bool, bool, bool, LimiterInModel, bool]:
    """Delay, filters of P and Q, transient impedance, limiter and notch."""
    limiter = LimiterInModel(
        law=study.limiter.law,
        memory=type(cold_start(study).controller.limiter),
        constants=type(study.controller_settings().limiter),
    )
    transient = study.inner_gains.R_t != 0.0 or study.inner_gains.X_t != 0.0
    return study.converter.delay_samples, study.tau_P > 0.0, study.tau_Q > 0.0, transient, limiter, study.has_notch


def _squarings(study: Study, R_g: Array, L_g: Array) -> int:
    """Enough that the exponential's series sees at most half a radian (or neper) of the fastest mode."""
    A = state_matrices(study.circuit()._replace(R_g=R_g, L_g=L_g))[0]
    A = A[np.isfinite(A).all(axis=(1, 2))]
    fastest = float(np.abs(np.linalg.eigvals(A)).max()) if len(A) else 1.0
    return max(0, math.ceil(math.log2(2.0 * fastest * study.converter.T_s)))


@functools.lru_cache(maxsize=32)
def _over(function: ca.Function, count: int) -> ca.Function:
    """A function of ``count`` lanes side by side; making it takes as long as a call."""
    return function.map(count)


@functools.lru_cache(maxsize=64)
def _with_zeros(function: ca.Function) -> ca.Function:
    """The function with every zero of its outputs in its place in memory."""
    given = [ca.MX.sym(f"given_{k}", *function.size_in(k)) for k in range(function.n_in())]
    return ca.Function("with_zeros", given, [ca.densify(one) for one in function.call(given)])


def _matrices(function: ca.Function, z: Array, p: Array) -> tuple[Array, ...]:
    """The outputs of a function of z (N, …) and p (N, …): arrays (N, rows, columns)."""
    count = len(z)
    shapes = [function.size_out(k) for k in range(function.n_out())]
    if count == 0:
        return tuple(np.empty((0, *shape)) for shape in shapes)
    # CasADi reads and writes the arrays where they are. Its own matrices would go through lists of Python, which takes
    # as long as the computation. It counts down columns, lane by lane.
    given = [np.ascontiguousarray(one, dtype=float) for one in (z, p)]
    found = [np.empty((count, columns, rows)) for rows, columns in shapes]
    called: Any = _over(_with_zeros(function), count)  # the types of CasADi's buffers ask for a size beside the memory
    buffer, evaluate = called.buffer()
    for k, array in enumerate(given):
        buffer.set_arg(k, array.data)
    for k, array in enumerate(found):
        buffer.set_res(k, array.data)
    evaluate()
    return tuple(one.transpose(0, 2, 1) for one in found)


def parameter_sensitivity(model: FullOrderModel, cell: int, parameter: str) -> Array:
    """dA/dp (n, n) of one cell for a PARAMETER, with the change of its steady state (:eq:`eigenvalue-sensitivity`).

    dz/dp = (I − A)⁻¹ ∂F/∂p is followed by the directional derivative of A, both by automatic differentiation.
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


def parameter_sensitivities(model: FullOrderModel, cell: int, parameters: Sequence[str]) -> Array:
    """dA/dp (parameters, n, n) of one cell for several PARAMETERS at once, as :func:`parameter_sensitivity`."""
    columns = [PARAMETERS.index(name) for name in parameters]
    z, p, A = model.z[cell], model.p[cell], model.A[cell]
    of_p = model.map.of_parameters(z, p).full()[:, columns]
    dz = np.linalg.solve(np.eye(len(z)) - A, of_p)
    dp = np.zeros((len(p), len(columns)))
    dp[columns, range(len(columns))] = 1.0
    count, n = len(columns), len(z)
    every = _over(model.map.directional, count)(np.tile(z[:, None], count), np.tile(p[:, None], count), dz, dp)
    return every.full().reshape(n, count, n).transpose(1, 0, 2)
