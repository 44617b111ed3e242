"""Where the cases of a batch rest before and after, for how long they run, and what is asked of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.many import (
    BRIDGE_VOLTAGE,
    CURRENT,
    LIMITER_ACTS,
    LIMITER_PULLS,
    Lanes,
    ManyStates,
    powers_at_pcc,
)
from vsgdesign.linear.operating_point.many_rests import many_rests_with_measured_gains
from vsgdesign.metrics.survival import REST_SHARE, WATCHED, SurvivalDemand
from vsgdesign.simulation.lanes.cases import STEP, LaneCases
from vsgdesign.simulation.lanes.results import JUDGED, OVER_LIMIT, LaneResults
from vsgdesign.simulation.lanes.telling import GainsAtRest
from vsgdesign.simulation.segments import Segments
from vsgdesign.simulation.survival.demand import settling_times_asked
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
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
    delta_start: Array
    delta_end: Array

    def take(self, chosen: NDArray[np.intp]) -> Rests:
        """Some of the lanes."""
        others = {name: getattr(self, name)[chosen] for name in self.__dataclass_fields__ if name != "start"}
        return Rests(start=_some(self.start, chosen), **others)


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
    study: Study, cases: LaneCases, segments: Segments, told: GainsAtRest, demand: SurvivalDemand, results: LaneResults
) -> tuple[Rests, PowerLoopGains]:
    """Where every case rests before and after, with the gains at the start; cases without one are marked."""
    last = last_of(segments)
    at_end = Lanes(last.R_g, last.L_g, last.V_g_rms, last.omega, *cases.references_at_end(study.converter.references()))
    phase = cases.around.phase
    start, gains = many_rests_with_measured_gains(study, cases.at_start, told.first, phase=phase)
    end, _ = many_rests_with_measured_gains(study, at_end, told.known_at_end(), phase=0.0)
    step = cases.kind == STEP
    at_pcc = [
        powers_at_pcc(study, state, lanes, at)
        for state, lanes, at in ((start, cases.at_start, phase), (end, at_end, 0.0))
    ]
    rests = Rests(
        start=start,
        P_start=np.where(step, at_pcc[0][0], start.P),
        Q_start=np.where(step, at_pcc[0][1], start.Q),
        P_end=np.where(step, at_pcc[1][0], end.P),
        Q_end=np.where(step, at_pcc[1][1], end.Q),
        delta_start=start.controller.theta - phase,
        delta_end=end.controller.theta,
    )
    fault = np.where(start.fault > 0, start.fault, end.fault)
    results.fault[:] = fault
    results.status[fault == 0] = JUDGED
    if demand.i_max_pu is not None:
        largest = REST_SHARE * demand.i_max_pu * study.converter.I_rated_pk
        over = ~step & (fault == 0) & (np.maximum(start.i_s_pk, end.i_s_pk) > largest)
        results.status[over] = OVER_LIMIT
    limited = np.isin(fault, (BRIDGE_VOLTAGE, CURRENT, LIMITER_ACTS, LIMITER_PULLS))
    results.status[limited] = OVER_LIMIT
    return rests, gains


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
