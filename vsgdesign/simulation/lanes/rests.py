"""Where the cases of a batch rest before and after, for how long they run, and what is asked of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.dc_control import RestCurve
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.many import (
    BRIDGE_VOLTAGE,
    CURRENT,
    DC_FAULTS,
    LIMITER_ACTS,
    LIMITER_PULLS,
    NO_POINT,
    Lanes,
    ManyStates,
    lanes_of,
    power_of,
    powers_at_pcc,
)
from vsgdesign.linear.operating_point.many_rests import many_rests_with_measured_gains, reactive_curve
from vsgdesign.linear.operating_point.network import NetworkCircuit, NetworkStates, network_circuit, states_of_networks
from vsgdesign.metrics.survival import REST_SHARE, WATCHED, SurvivalDemand
from vsgdesign.simulation.circuits import Connection, no_rest_with
from vsgdesign.simulation.lanes.cases import STEP, LaneCases
from vsgdesign.simulation.lanes.results import JUDGED, OVER_LIMIT, LaneResults
from vsgdesign.simulation.lanes.telling import OfTrueGrid, Telling
from vsgdesign.simulation.survival.cases import settling_times_asked
from vsgdesign.simulation.timeline import Segments
from vsgdesign.study.parameters.grid import Grid, Network
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Samples = NDArray[np.int64]

STEP_WINDOW = 1.85
"""For how many settling times a step is watched."""

SWITCHED_WINDOW = 2.5
"""The same with a switched bridge, and for how many settling times it runs before its first event. It is judged by the
rest that it comes to, and begins at the rest of the averaged bridge, up to a tenth of the rating beside its own: in
this time what is left of either fades away."""


@dataclass(frozen=True, kw_only=True)
class Rests:
    """Where n lanes rest: the state at the start, the powers that are watched before and after, the angle after."""

    start: ManyStates
    P_start: Array
    Q_start: Array
    P_end: Array
    Q_end: Array
    P_asked: Array
    """What reference and P–f droop ask for at the end, W, whatever the source of the dc link can give."""
    curve: Array
    """(N, 4): how Q follows a P that a clamp holds elsewhere (:class:`vsgdesign.equations.dc_control.RestCurve`)."""
    delta_start: Array
    delta_end: Array
    states: NetworkStates | None = None
    """Of the networks of all lanes, which the circuits at the start have; None: there is nothing but grids."""

    def take(self, chosen: NDArray[np.intp]) -> Rests:
        """Some of the lanes."""
        others = {f.name: getattr(self, f.name)[chosen] for f in fields(self) if f.name not in ("start", "states")}
        start: Any = None if self.start is None else _some(self.start, chosen)
        return Rests(start=start, states=self.states, **others)


def _some(states: ManyStates, chosen: NDArray[np.intp]) -> ManyStates:
    """The steady states of some lanes. The last axis of every array is that of the lanes."""
    found: dict[str, Any] = {}
    for f in fields(states):
        value = getattr(states, f.name)
        found[f.name] = _some_fields(value, chosen) if hasattr(value, "_fields") else value[..., chosen]
    return ManyStates(**found)


def _some_fields(record: Any, chosen: NDArray[np.intp]) -> Any:
    return type(record)(*(_some_fields(one, chosen) if hasattr(one, "_fields") else one[chosen] for one in record))


def rests_of(
    study: Study,
    cases: LaneCases,
    segments: Segments,
    told: Telling | OfTrueGrid,
    demand: SurvivalDemand,
    results: LaneResults,
) -> tuple[Rests, PowerLoopGains]:
    """Where every case rests before and after, with the gains at the start; cases without one are marked."""
    last = last_of(segments)
    at_end = Lanes(last.R_g, last.L_g, last.V_g_rms, last.omega, *cases.references_at_end(study.converter.references()))
    phase, linked = cases.around.phase, circuits_at_rest(study, cases, at_end)
    start, gains = many_rests_with_measured_gains(study, cases.at_start, told.first, phase=phase, circuit=linked.start)
    held = cases.links(study.dc)
    end, at_last = many_rests_with_measured_gains(
        study,
        at_end,
        told.known_at_end(),
        phase=0.0,
        circuit=linked.end,
        links=None if held is None else [one[-1] for one in held],
    )
    for state, obstacle in ((start, linked.none_at_start), (end, linked.none_at_end)):
        state.fault[obstacle] = NO_POINT
    step = cases.kind == STEP
    at_pcc = [
        powers_at_pcc(study, state, lanes, at, circuits)
        for state, lanes, at, circuits in (
            (start, cases.at_start, phase, linked.start),
            (end, at_end, 0.0, linked.end),
        )
    ]
    rests = Rests(
        start=start,
        P_start=np.where(step, at_pcc[0][0], start.P),
        Q_start=np.where(step, at_pcc[0][1], start.Q),
        P_end=np.where(step, at_pcc[1][0], end.P),
        Q_end=np.where(step, at_pcc[1][1], end.Q),
        P_asked=power_of(*lanes_of(study, at_end, at_last)),
        curve=curve_of_rest(study, at_end, at_last, end, linked.end),
        delta_start=start.controller.theta - phase,
        delta_end=end.controller.theta,
        states=linked.states,
    )
    fault = np.where(start.fault > 0, start.fault, end.fault)
    results.fault[:] = fault
    results.status[fault == 0] = JUDGED
    if demand.i_max_pu is not None:
        largest = REST_SHARE * demand.i_max_pu * study.converter.I_rated_pk
        over = ~step & (fault == 0) & (np.maximum(start.i_s_pk, end.i_s_pk) > largest)
        results.status[over] = OVER_LIMIT
    limited = np.isin(fault, (BRIDGE_VOLTAGE, CURRENT, LIMITER_ACTS, LIMITER_PULLS, *DC_FAULTS))
    results.status[limited] = OVER_LIMIT
    return rests, gains


def curve_of_rest(
    study: Study, at_end: Lanes, gains: PowerLoopGains, end: ManyStates, circuits: tuple[NetworkCircuit, ...] | None
) -> Array:
    """How Q follows a P that a clamp holds elsewhere, (N, 4); zeros without a clamp."""
    if study.dc is None or not study.dc.clamps:
        return np.zeros((len(end), len(RestCurve._fields)))
    found = reactive_curve(study, at_end, gains, end.P, circuits)
    return np.stack([found.P, np.where(np.isfinite(found.Q), found.Q, end.Q), found.slope, found.bend], axis=1)


class Linked(NamedTuple):
    """What the filters of N cases are connected to at the start and at the end; None: to grids alone."""

    states: NetworkStates | None
    start: tuple[NetworkCircuit, ...] | None
    end: tuple[NetworkCircuit, ...] | None
    none_at_start: Mask
    none_at_end: Mask
    """Where a fault or an open breaker leaves no rest that is known, (N,)."""


def circuits_at_rest(study: Study, cases: LaneCases, at_end: Lanes) -> Linked:
    """The circuits with the networks of the cases, with the states that all of them need together. Where there is no
    rest, the load is in it alone."""
    nothing = np.zeros(len(cases), dtype=bool)
    if cases.networks is None:
        return Linked(None, None, None, nothing, nothing)
    states = states_of_networks([network for listed in cases.networks for _, network in listed])
    circuits, without = [], []
    for lanes, k in ((cases.at_start, 0), (at_end, -1)):
        networks = [listed[k][1] for listed in cases.networks]
        without.append(np.array([no_rest_with(network) is not None for network in networks], dtype=bool))
        of = zip(lanes.R_g.tolist(), lanes.L_g.tolist(), networks, strict=True)
        loaded = (Connection(Grid(R_g, L_g), Network(load=network.load)) for R_g, L_g, network in of)
        circuits.append(tuple(network_circuit(study.filter, *one, states) for one in loaded))
    return Linked(states, *circuits, *without)


def last_of(segments: Segments) -> Segments:
    """What holds at the end of every case."""
    index = np.isfinite(segments.t_s).sum(axis=1) - 1
    rows = np.arange(len(index))
    return Segments(*(values[rows, index] for values in segments))


def cycles_at_end(study: Study, segments: Segments) -> Samples:
    """Samples of a cycle of the grid at the end of each case, (N,)."""
    cycle_s = 2.0 * math.pi / last_of(segments).omega
    return np.maximum(np.round(cycle_s / study.converter.T_s), 1).astype(np.int64)


def ends_of(
    study: Study, cases: LaneCases, segments: Segments, demand: SurvivalDemand, bridge: str
) -> tuple[Samples, Samples]:
    """For how many samples each case runs, and the samples of a cycle at its end, (N,)."""
    T_s, T = study.converter.T_s, demand.settling_time
    cycle_s, cycle = 2.0 * math.pi / last_of(segments).omega, cycles_at_end(study, segments)
    times = settling_times_asked(cases.silent_s, T)
    needed = times * T + demand.grace_s + WATCHED * T + 2.0 * cycle_s
    window = SWITCHED_WINDOW if bridge == "pwm" or cases.around.distort(study) else STEP_WINDOW
    end_s = np.where(cases.kind == STEP, cases.events.t_s[:, 0] + window * T, cases.cleared_s + needed)
    return np.ceil(end_s / T_s - 1e-6).astype(np.int64), cycle
