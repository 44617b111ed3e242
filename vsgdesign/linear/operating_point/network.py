"""The circuit of a converter with what stands at its grid: load, fault and breaker (:eq:`network-circuit`).

Every branch has its own equation and every node its law of currents. Some of these equations hold no derivative: the
currents of a node add up, a bolted fault has no voltage, a resistance has no inductance. They are eliminated exactly
(:eq:`network-reduced`), and what is left is a linear circuit with the same states for all networks of a run.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import clarke
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.plant import TwoAxisCircuit
from vsgdesign.study.parameters.converter import Filter
from vsgdesign.study.parameters.grid import FAULT_KINDS, PHASE_PAIRS, PHASE_TO_PHASE, Fault, Grid, Load, Network

Array = NDArray[np.float64]

_STATES_OF_LOAD = {"i_coil": "L_parallel", "v_bank": "C_parallel", "i_series": "L_series", "v_series": "C_series"}
"""The states of a load, and the element that each belongs to."""


@dataclass(frozen=True)
class NetworkStates:
    """The states that a run needs for all of its networks, besides i_s, v_c and i_g."""

    shares: tuple[float, ...] = ()
    """Where faults divide the grid's impedance, ascending, each above 0 and below 1."""
    load: tuple[str, ...] = ()
    """Names of the states of the load: ``i_coil`` and ``v_bank`` of the inductance and the capacitance in parallel,
    ``i_series`` and ``v_series`` of those in series."""

    @property
    def names(self) -> tuple[str, ...]:
        """One name for each pair (α, β), in the order of the circuit's states."""
        grid = tuple(f"i_grid_{k}" for k in range(len(self.shares) + 1))
        return ("i_s", "v_c", "i_g", *grid, *self.load)


@dataclass(frozen=True, eq=False, kw_only=True)
class NetworkCircuit(TwoAxisCircuit):
    """The circuit with load, fault and breaker, the voltage at its PCC and the current of its fault."""

    pcc_per_state: Array
    pcc_per_source: Array
    """2×2n and 2×2: the voltage at the PCC is the sum of these times x and times v_g (:eq:`network-pcc`)."""
    fault_per_state: Array
    """2×2n: the current into the fault is this times x (:eq:`fault-current`); zero where there is no fault."""


def states_of_networks(networks: Iterable[Network]) -> NetworkStates:
    """The states that all the networks need together. Raises InfeasibleStudyError for a network that cannot be."""
    networks = tuple(networks)
    for network in networks:
        _check(network)
    faults = [network.fault for network in networks if network.fault is not None]
    loads = [network.load for network in networks if network.load is not None]
    return NetworkStates(
        tuple(sorted({fault.at for fault in faults if fault.at > 0.0})),
        tuple(name for name, given in _STATES_OF_LOAD.items() if any(getattr(one, given) is not None for one in loads)),
    )


@functools.lru_cache(maxsize=256)
def network_circuit(filter_: Filter, grid: Grid, network: Network, states: NetworkStates) -> NetworkCircuit:
    """The circuit of a filter, a grid and a network with the given states (:eq:`network-reduced`).

    ``onto`` of the circuit is what the states become where the network begins. Fluxes and charges stay as they are as
    far as the new network lets them; the current that a breaker or the end of a fault interrupts ends at once.
    """
    axes = 2 if network.fault is not None and network.fault.kind == PHASE_TO_PHASE else 1
    equations = _equations(filter_, grid, network, states, axes)
    try:
        found = reduced(equations)
    except UndeterminedError as error:
        raise InfeasibleStudyError(
            "network: two branches without any resistance lie side by side, and nothing says how they share the "
            "current. Give fault.R or load.R_series a value."
        ) from error
    # All that the states of a run, which are the first of the variables, are made of and make.
    kept = axes * len(states.names)
    onto = found.onto[:, :kept]
    A = found.x[:kept] @ found.A @ onto
    B, E = (found.x[:kept] @ one for one in found.inputs)
    full_onto = found.x @ onto
    onto = full_onto[:kept]
    # The currents of a fault are the last of all variables, one for each direction in which it lets a current flow.
    directions = _directions(network.fault, axes)
    per_fault = directions @ full_onto[len(full_onto) - directions.shape[1] :]
    i_s, v_c, i_g = (np.eye(axes, len(A), axes * k) for k in range(3))
    # What R_2 and L_2 leave of the capacitor node's voltage (:eq:`network-pcc`).
    per_state = (v_c + filter_.R_c * (i_s - i_g) - filter_.R_2 * i_g) @ onto - filter_.L_2 * i_g @ A
    per_source = -filter_.L_2 * i_g @ E
    A, B, E, onto, per_state, per_source, per_fault = (
        np.asarray(np.kron(one, np.eye(2 // axes)), dtype=np.float64)
        for one in (A, B, E, onto, per_state, per_source, per_fault)
    )
    return NetworkCircuit(A, B, E, onto, pcc_per_state=per_state, pcc_per_source=per_source, fault_per_state=per_fault)


def _check(network: Network) -> None:
    """Raises InfeasibleStudyError with every fault of a network that was not read from a study file."""
    wrong = []
    if (fault := network.fault) is not None:
        if fault.kind not in FAULT_KINDS:
            wrong.append(f"fault.kind = {fault.kind!r} is none of {', '.join(FAULT_KINDS)}")
        if fault.phases not in PHASE_PAIRS:
            wrong.append(f"fault.phases = {fault.phases!r} is none of {', '.join(PHASE_PAIRS)}")
        if not 0.0 <= fault.at < 1.0:
            wrong.append(f"fault.at = {fault.at:g} is not from 0 (the PCC) to below 1 (the source)")
        if not 0.0 <= fault.R < math.inf:
            wrong.append(f"fault.R = {fault.R:g} Ω is not zero or a positive resistance")
    for name, value in () if network.load is None else vars(network.load).items():
        if value is not None and not (0.0 < value < math.inf or (name == "R_series" and value == 0.0)):
            least = "zero or a positive value" if name == "R_series" else "a positive value"
            wrong.append(f"load.{name} = {value:g} is not {least}; leave out what is not there")
    if wrong:
        raise InfeasibleStudyError(f"network: {'; '.join(wrong)}.")


def _equations(filter_: Filter, grid: Grid, network: Network, states: NetworkStates, axes: int) -> Equations:
    """Branch by branch and node by node, on one axis or on both in turn."""
    load, fault = network.load or Load(), network.fault
    cuts = (0.0, *states.shares, 1.0)
    pieces = np.diff(cuts)
    sources = [f"i_grid_{k}" for k in range(len(pieces))]
    masses = {"i_s": filter_.L_1, "v_c": filter_.C, "i_g": filter_.L_2}
    masses |= {name: share * grid.L_g for name, share in zip(sources, pieces, strict=True)}
    masses |= {name: getattr(load, _STATES_OF_LOAD[name]) or 0.0 for name in states.load}
    series = (load.R_series, load.L_series, load.C_series) != (None, None, None)
    there = {
        "i_coil": load.L_parallel is not None,
        "v_bank": load.C_parallel is not None,
        "i_bank": load.C_parallel is not None,
        "i_resistor": load.R_parallel is not None,
        "i_series": series,
        "v_series": load.C_series is not None,
    }
    # Currents of branches without inductance are no states; that of a series branch may be one.
    masses |= {name: 0.0 for name in ("i_bank", "i_resistor", "i_series") if there[name] and name not in masses}
    directions = _directions(fault, axes)
    size = axes * len(masses) + directions.shape[1]
    places = {name: axes * k for k, name in enumerate(masses)}

    def x(name: str) -> Array:
        """The rows that pick a variable, one for each axis; nothing where there is no such variable."""
        return np.eye(axes, size, places[name]) if name in places else np.zeros((axes, size))

    i_fault = np.eye(directions.shape[1], size, axes * len(masses))
    J = np.zeros((size, size))
    for v, i in ((x("v_c"), x("i_s") - x("i_g")), (x("v_bank"), x("i_bank")), (x("v_series"), x("i_series"))):
        J += v.T @ i - i.T @ v
    losses = [(x("i_s"), filter_.R_1), (x("i_s") - x("i_g"), filter_.R_c), (x("i_g"), filter_.R_2)]
    losses += [(x(name), share * grid.R_g) for name, share in zip(sources, pieces, strict=True)]
    losses += [(x("i_resistor"), load.R_parallel or 0.0), (x("i_series"), load.R_series or 0.0)]
    if fault is not None:
        # Between two phases the current meets half of R on its way to the middle, and half of it behind.
        losses.append((i_fault, fault.R if fault.kind != PHASE_TO_PHASE else 0.5 * fault.R))
    losses = [(rows, R) for rows, R in losses if R > 0.0]

    drawn = sum((x(name) for name in ("i_coil", "i_bank", "i_series", "i_resistor")), np.zeros((axes, size)))
    nodes = [x("i_g") - x(sources[0]) - drawn]
    nodes += [x(before) - x(behind) for before, behind in itertools.pairwise(sources)]
    if fault is not None:
        nodes[cuts.index(fault.at)] -= directions @ i_fault
    absent = [x(name) for name in states.load if not there[name]]
    absent += [] if network.connected else [x(sources[0])]
    return Equations(
        M=np.array([*np.repeat(list(masses.values()), axes), *np.zeros(len(i_fault))]),
        J=J,
        through=np.concatenate([rows for rows, _ in losses]) if losses else np.zeros((0, size)),
        R=np.array([R for rows, R in losses for _ in rows]),
        G=np.concatenate([*nodes, *absent]),
        inputs=(x("i_s").T, -x(sources[-1]).T),
    )


def _directions(fault: Fault | None, axes: int) -> Array:
    """(axes, m): the directions of the plane in which a fault lets a current flow."""
    if fault is None or fault.kind != PHASE_TO_PHASE:
        return np.eye(axes, axes if fault is not None else 0)
    there = np.array(clarke(*(float(phase == fault.phases[0]) - float(phase == fault.phases[1]) for phase in "abc")))
    return (there / np.hypot(*there))[:, None]


_NOTHING = 1e-9
"""Below this an entry of a matrix of signs and directions is zero. All others are of the order of one."""


class Equations(NamedTuple):
    """M dx/dt = (J − R) x + Σ B u and G x = 0, of all branches (:eq:`network-circuit`)."""

    M: Array
    """(n,): L of a current, C of a voltage; zero of a branch without inductance."""
    J: Array
    """(n, n): what voltages do to currents, and currents to voltages."""
    through: Array
    R: Array
    """(r, n) and (r,): the current through every resistance, and its value, Ω."""
    G: Array
    """(g, n): the nodes, and branches that are not there."""
    inputs: tuple[Array, ...]
    """(n, m) each: bridges and sources."""
    order: NDArray[np.intp] | None = None
    """In which order variables are expressed by the others, where there is a choice; None: those without a mass
    first."""


class Reduced(NamedTuple):
    """dq/dt = A q + Σ B u and x = X q + Σ X_u u, with as few states q as there are."""

    A: Array
    inputs: tuple[Array, ...]
    x: Array
    """(n, states): X."""
    of_inputs: tuple[Array, ...]
    """(n, m) each: X_u, where sources drive currents through resistances alone."""
    onto: Array
    """(states, n): what q is made of. Fluxes and charges stay as they are as far as the branches let them."""


class UndeterminedError(ValueError):
    """Some variables are not determined: branches without any resistance side by side, or sources in a loop."""

    def __init__(self, variables: list[int]) -> None:
        super().__init__(f"the variables {variables} are not determined")
        self.variables = variables
        """Those of which nothing says how large they are."""


def reduced(equations: Equations) -> Reduced:
    """The circuit without what holds no derivative. Raises UndeterminedError where the branches do not determine it."""
    M, J, through, R, G, inputs, order = equations
    K = J - through.T * R @ through
    inert = M > 0.0
    # All that the nodes allow. Where there is a choice, currents without inductance are expressed by the others.
    _, T = _pivots_and_null(G, np.argsort(inert, kind="stable") if order is None else order)
    with_mass, loops = _pivots_and_null(T[inert])
    T_m, T_0 = T[:, with_mass], T @ loops
    # Loops without inductance: where they have resistance, Ohm's law says the current. The others force the voltages of
    # capacitors to be equal, whatever current that takes.
    with_loss, bare = _pivots_and_null(through @ T_0)
    T_l, T_w = T_0[:, with_loss], T_0 @ bare
    forced, allowed = _pivots_and_null(T_w.T @ J @ T_m)
    fed = [T_w.T @ B for B in inputs]
    if len(forced) < T_w.shape[1] or any((np.abs(one) > _NOTHING).any() for one in fed):
        # The currents of loops that no capacitor closes, or of all of them where a source lies in one.
        closed = _pivots_and_null((T_w.T @ J @ T_m).T)[1] if len(forced) < T_w.shape[1] else np.eye(T_w.shape[1])
        raise UndeterminedError(np.flatnonzero((np.abs(T_w @ closed) > _NOTHING).any(axis=1)).tolist())
    T_m = T_m @ allowed
    by_law = T_l.T @ K @ T_l
    x = T_m - T_l @ np.linalg.solve(by_law, T_l.T @ K @ T_m)
    # What each of the states that are left is made of: fluxes and charges over their inductances and capacitances.
    mass = T_m.T * M @ T_m
    driven = [-T_l @ np.linalg.solve(by_law, T_l.T @ B) for B in inputs]
    onto, A, *acting = (
        np.asarray(np.linalg.solve(mass, T_m.T @ rows), dtype=np.float64)
        for rows in (np.diag(M), K @ x, *(B + K @ own for B, own in zip(inputs, driven, strict=True)))
    )
    # The currents that keep the forced voltages equal.
    coupled = T.T @ J @ T_w
    left = T.T @ (M[:, None] * (T_m @ A) - K @ x)
    x = x + T_w @ np.linalg.lstsq(coupled, left, rcond=None)[0]
    of_inputs = []
    for B, own, moved in zip(inputs, driven, acting, strict=True):
        left = T.T @ (M[:, None] * (T_m @ moved) - K @ own - B)
        of_inputs.append(own + T_w @ np.linalg.lstsq(coupled, left, rcond=None)[0])
    return Reduced(A, tuple(acting), x, tuple(of_inputs), onto)


def _pivots_and_null(matrix: Array, order: NDArray[np.intp] | None = None) -> tuple[list[int], Array]:
    """Columns of a matrix that are independent, and a basis of what it maps to zero, as columns: by elimination, the
    columns taken in a given order. The entries are of the order of one."""
    rows, size = np.array(matrix), matrix.shape[1]
    pivots: list[int] = []
    for column in range(size) if order is None else order.tolist():
        rank = len(pivots)
        if rank == len(rows):
            break
        best = rank + int(np.argmax(np.abs(rows[rank:, column])))
        if abs(rows[best, column]) < _NOTHING:
            continue
        rows[[rank, best]] = rows[[best, rank]]
        rows[rank] /= rows[rank, column]
        others = np.arange(len(rows)) != rank
        rows[others] -= np.outer(rows[others, column], rows[rank])
        pivots.append(column)
    free = [column for column in range(size) if column not in pivots]
    null = np.zeros((size, len(free)))
    null[free, range(len(free))] = 1.0
    null[pivots] = -rows[: len(pivots)][:, free]
    return pivots, null
