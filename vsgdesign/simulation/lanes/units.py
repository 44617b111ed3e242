"""Plants side by side: all units of a plant in one lane, and each unit watched and judged as a converter of its own.

A case is a study with a plant, and what :func:`vsgdesign.simulation.units.scenario.run_plant` does with one after the
other is done for many. A unit of all plants of a part is :class:`UnitOfPart`: to what tells gains, watches and judges,
it is a part of converters that stand alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.dc_control import RestCurve
from vsgdesign.equations.frames import instantaneous_power
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError, LimitHitError
from vsgdesign.linear.operating_point.circuit_of_units import wiring_of
from vsgdesign.linear.operating_point.flow_of_units import clock_of_study
from vsgdesign.linear.operating_point.many import DC_ENERGY, DC_FAULTS, Lanes, lanes_of, power_of
from vsgdesign.linear.operating_point.many_rests import many_rests_with_measured_gains
from vsgdesign.linear.operating_point.rest_of_units import UnitsAtRest, rest_of_units
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.metrics.survival import REST_SHARE, SurvivalDemand
from vsgdesign.simulation.circuit_program import SAME_INSTANT, ProgramWriter
from vsgdesign.simulation.dc_beyond import stiff
from vsgdesign.simulation.feeds import Told, ToldGrids
from vsgdesign.simulation.lanes.cases import STEP, LaneCases, LaneEvents
from vsgdesign.simulation.lanes.part import (
    Samples,
    first_judged,
    keep_links,
    means_at_rest,
    put_links,
    put_references,
    watch_disturbance,
    watch_step,
)
from vsgdesign.simulation.lanes.plant_part import PlantPart, UnitOfPart
from vsgdesign.simulation.lanes.rests import Rests, curve_of_rest
from vsgdesign.simulation.lanes.results import BLOCKED, JUDGED, NO_REST, OVER_LIMIT, LaneResults
from vsgdesign.simulation.lanes.run import drive, judge_part
from vsgdesign.simulation.lanes.telling import telling
from vsgdesign.simulation.loop import kind_of
from vsgdesign.simulation.run_kind import DISTURBANCE, LARGEST_DEGREE
from vsgdesign.simulation.run_kind import STEP as STEP_WATCHED
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.simulation.units.body import PlantKind
from vsgdesign.simulation.units.program import PlantProgram, switched
from vsgdesign.simulation.units.start import StartOfPlant, situation_at
from vsgdesign.simulation.units.timeline import PlantTimeline, plant_timeline
from vsgdesign.simulation.units.unit_result import terminals_at_rest
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Plants:
    """Studies with plants as cases. Their units are alike, all of them sample together, and nothing of a study is
    noisy; ``cases`` has what a batch knows of each besides (kind, signal, ``cleared_s``, errors and silence)."""

    studies: tuple[Study, ...]
    cases: LaneCases
    ends: Samples
    """For how many samples each case runs, (N,)."""


class _Prepared(NamedTuple):
    """A case before its run."""

    number: int
    study: Study
    timeline: PlantTimeline
    start: UnitsAtRest
    end: UnitsAtRest
    at_end: tuple[int, ...]
    """The units that are on line at the end."""


class Units(NamedTuple):
    """What became of the units of N plants: case ``case[f]``, unit ``unit[f]``, arrays over f."""

    case: Index
    unit: Index
    on_line: NDArray[np.bool_]
    """Whether it is on line at the end. Of a lost unit nothing is asked."""
    results: LaneResults


def run_plants(
    spec: ControllerSpec,
    ready: Ready,
    plants: Plants,
    *,
    demand: SurvivalDemand | None = None,
    said: Callable[[int, Study, Timeline], Told] | None = None,
    bridge: str = "averaged",
) -> Units:
    """Runs every plant with a controller in all of its units, and judges each unit. Events of a case are at least 5 ms
    apart. ``demand``: of a disturbance; None: that of the controller. ``said``: what is told to a unit of a case (its
    number), which is a converter with a timeline; None: what the cases say. ``bridge``: of all units; switched ones are
    judged by the rests to which they come. Raises InfeasibleStudyError where the
    controller cannot be run in a batch."""
    timelines = [plant_timeline(study, spec) for study in plants.studies]
    units = [(c, k) for c, timeline in enumerate(timelines) for k in range(len(timeline.units))]
    case, unit = (np.array(one, dtype=np.intp) for one in zip(*units, strict=True))
    own = timelines[0].units[0]
    flat = _cases_of_units(plants, timelines, case, unit)
    if bridge == "pwm":  # a unit that does not step is judged in the same time
        t_s = flat.events.t_s.copy()
        t_s[:, 0] = np.minimum(t_s[:, 0], plants.cases.events.t_s[case, 0])
        flat = replace(flat, events=replace(flat.events, t_s=t_s))
    results = LaneResults.of_none(len(flat))
    on_line = np.ones(len(flat), dtype=bool)
    demand = demand or demand_of(own.converter, settling_time_of(spec, ready))
    grids = None
    if said is not None:
        each = ((c, timelines[c].units[k], timelines[c].timelines[k]) for c, k in units)
        grids = ToldGrids.of([said(*one) for one in each])
    told = telling(own, spec, ready, flat, grids)
    phase = timelines[0].segments[0].source.phase
    first, gains = many_rests_with_measured_gains(own, flat.at_start, told.first, phase=phase)
    at_end, held = _at_end(timelines, flat.references_at_end(own.converter.references())), flat.links(own.dc)
    links = None if held is None else [one[-1] for one in held]
    last, last_gains = many_rests_with_measured_gains(own, at_end, told.known_at_end(), links=links)
    before, after = np.stack(np.broadcast_arrays(*gains)), np.stack(np.broadcast_arrays(*last_gains))
    begin = np.searchsorted(case, np.arange(len(timelines)))
    dc_faults = np.where(np.isin(last.fault, DC_FAULTS), last.fault, 0)
    prepared = []
    for c, (study, timeline) in enumerate(zip(plants.studies, timelines, strict=True)):
        mine = slice(begin[c], begin[c] + len(timeline.units))
        if (first.fault[mine] > 0).any():
            results.fault[mine] = first.fault[mine].max()
            continue
        there = [not _lost(timeline, k) for k in range(len(timeline.units))]
        if (dc_faults[mine][there] > 0).any():
            results.fault[mine], results.status[mine] = dc_faults[mine][there].max(), OVER_LIMIT
            continue
        found = _prepared(c, study, timeline, before[:, mine], after[:, mine])
        if isinstance(found, int):
            results.status[mine] = found
            continue
        on_line[mine] = [k in found.at_end for k in range(len(timeline.units))]
        over = plants.cases.kind[c] != STEP and _over_limit(found, demand)
        results.status[mine] = OVER_LIMIT if over else JUDGED
        prepared += [] if over else [found]
    rests = _rests(prepared, begin, len(flat), plants.cases.kind)
    if own.dc is not None and own.dc.clamps:
        asked = power_of(*lanes_of(own, at_end, last_gains))
        rests = replace(rests, P_asked=asked, curve=curve_of_rest(own, at_end, last_gains, last, None))
    parts = [
        one
        for some in _groups(plants, prepared)
        for one in _part(plants, some, begin, flat, rests, demand, bridge).units
    ]
    if parts:
        drive(parts, told, gains)
    for one in parts:
        judge_part(one, rests, demand, results)

    def again(some: Index) -> Units:
        studies = tuple(stiff(plants.studies[c]) for c in some.tolist())
        stiff_plants = Plants(studies=studies, cases=plants.cases.take(some), ends=plants.ends[some])
        of = None if said is None else _of_some(said, some)
        return run_plants(spec, ready, stiff_plants, demand=demand, said=of)

    _tell_of_sources(case, results, [stiff(study) is not study for study in plants.studies], again)
    return Units(case, unit, on_line, results)


def _of_some(said: Callable[[int, Study, Timeline], Told], some: Index) -> Callable[[int, Study, Timeline], Told]:
    """What is told to a unit of some of the cases."""
    return lambda c, unit, timeline: said(int(some[c]), unit, timeline)


def _tell_of_sources(case: Index, results: LaneResults, moves: Sequence[bool], again: Callable[[Index], Units]) -> None:
    """A plant whose units have blocked is no verdict where their sources could do no more, and where all units survive
    on stiff links. ``moves``: whether the links of a plant are not stiff; ``again``: runs plants on stiff links."""
    beyond = np.isfinite(results.dc_beyond_j)
    lost = (results.status == BLOCKED) & ~beyond
    some = np.array([c for c in np.unique(case[beyond]) if moves[c] and not lost[case == c].any()], dtype=np.intp)
    found = again(some) if some.size else None
    for k, c in enumerate(some.tolist()):
        mine, other = case == c, found.case == k if found is not None else beyond
        if found is not None and (found.results.status[other & found.on_line] == JUDGED).all():
            energy = results.dc_beyond_j[mine & beyond]
            results.status[mine], results.fault[mine] = OVER_LIMIT, DC_ENERGY
            results.dc_beyond_j[mine] = energy[np.argmax(np.abs(energy))]
            beyond[mine] = True
        else:
            beyond[mine] = False
    results.dc_beyond_j[~np.isin(case, some) | ~beyond] = np.nan


def _lost(timeline: PlantTimeline, k: int) -> bool:
    """Whether a unit is not on line at the end."""
    return timeline.plant.units[k].name in timeline.segments[-1].topology.opened


def _cases_of_units(plants: Plants, timelines: Sequence[PlantTimeline], case: Index, unit: Index) -> LaneCases:
    """Every unit as a case of its own, on the grid that it sees where all units move alike."""
    own = [timelines[c].units[k] for c, k in zip(case.tolist(), unit.tolist(), strict=True)]
    at_start = [timelines[c].timelines[k] for c, k in zip(case.tolist(), unit.tolist(), strict=True)]
    sources = [one.source_at(0.0) for one in at_start]
    refs = [one.references_at(0.0) for one in at_start]
    of_case = plants.cases
    return LaneCases(
        R_g=np.array([one.grid_at(0.0).R_g for one in at_start]),
        L_g=np.array([one.grid_at(0.0).L_g for one in at_start]),
        V_g_rms=np.array([one.V_g_rms for one in sources]),
        omega_g=np.array([one.omega for one in sources]),
        P_ref=np.array([one.P_ref for one in refs]),
        Q_ref=np.array([one.Q_ref for one in refs]),
        events=LaneEvents.of([_joined(one.events) for one in own]),
        error_R=of_case.error_R[case],
        error_X=of_case.error_X[case],
        silent_s=of_case.silent_s[case],
        cleared_s=of_case.cleared_s[case],
        kind=of_case.kind[case],
        signal=of_case.signal[case],
    )


def _joined(events: Sequence[Event]) -> list[Event]:
    """The events after t = 0, with those of one instant as one."""
    found: dict[float, Event] = {}
    for one in events:
        if one.t_s > 0.0:
            known = {f.name: getattr(one, f.name) for f in fields(one) if getattr(one, f.name) != f.default}
            found[one.t_s] = replace(found.get(one.t_s, one), **known)
    return [found[t_s] for t_s in sorted(found)]


def _at_end(timelines: Sequence[PlantTimeline], refs: Any) -> Lanes:
    """Grid, source and set points of each unit after the last event."""
    last = [own for timeline in timelines for own in timeline.timelines]
    grids, sources = [one.grids[-1][1] for one in last], [one.sources[-1] for one in last]
    return Lanes(
        np.array([one.R_g for one in grids]),
        np.array([one.L_g for one in grids]),
        np.array([one.V_g_rms for one in sources]),
        np.array([one.omega for one in sources]),
        *refs,
    )


def _prepared(c: int, study: Study, timeline: PlantTimeline, before: Array, after: Array) -> _Prepared | int:
    """The rests of a case; a status where there are none."""
    found = []
    on_line: list[int] = []
    for segment, t_s, gains in ((timeline.segments[0], 0.0, before), (timeline.segments[-1], math.inf, after)):
        laws = [PowerLoopGains(*column) for column in gains.T.tolist()]
        on_line = [k for k, one in enumerate(timeline.plant.units) if one.name not in segment.topology.opened]
        try:
            found.append(rest_of_units(situation_at(study, timeline, segment, laws, on_line, t_s)))
        except LimitHitError:
            return OVER_LIMIT
        except InfeasibleStudyError:
            return NO_REST
    return _Prepared(c, study, timeline, found[0], found[1], tuple(on_line))


def _over_limit(one: _Prepared, demand: SurvivalDemand) -> bool:
    """Whether a rest needs more current than is asked for."""
    if demand.i_max_pu is None:
        return False
    most = REST_SHARE * demand.i_max_pu * one.timeline.units[0].converter.I_rated_pk
    lengths = (
        np.hypot(*rest.model.measured(rest.z, k)[:2])
        for rest in (one.start, one.end)
        for k in range(len(rest.model.situation.units))
    )
    return max(lengths) > most


def _rests(prepared: Sequence[_Prepared], begin: Index, count: int, kind: NDArray[np.int8]) -> Rests:
    """What is watched of each unit at rest, over all units of all cases; NaN where a unit is not on line."""
    found = np.full((6, count), np.nan)
    for one in prepared:
        step = kind[one.number] == STEP
        start = range(len(one.timeline.units))
        for column, rest, on_line in ((0, one.start, tuple(start)), (2, one.end, one.at_end)):
            for at, k in enumerate(on_line):
                f = begin[one.number] + k
                found[column : column + 2, f] = _powers(rest, at, step)
                found[4 + column // 2, f] = rest.controller(at, 0.0)[0].theta
    start: Any = None  # the lanes are put at rest by what knows the plant
    curve = np.zeros((count, len(RestCurve._fields)))  # of a source that clamps the power
    names = ("P_start", "Q_start", "P_end", "Q_end", "delta_start", "delta_end")
    return Rests(start=start, P_asked=found[2], curve=curve, **dict(zip(names, found, strict=True)))


def _powers(rest: UnitsAtRest, unit: int, step: bool) -> tuple[float, float]:
    """P and Q of a unit at its terminals for a step, and at its control point for anything else."""
    if not step:
        return rest.model.powers(rest.z, unit)
    v, i_g = terminals_at_rest(rest, unit)
    P, Q = instantaneous_power(v.real, v.imag, i_g.real, i_g.imag)
    return float(P), float(Q)


def _groups(plants: Plants, prepared: Sequence[_Prepared]) -> Iterator[list[_Prepared]]:
    """Cases that share a loop and the samples of a mean."""
    of: dict[tuple[Any, ...], list[_Prepared]] = {}
    for one in prepared:
        own, step = one.timeline.units[0], plants.cases.kind[one.number] == STEP
        omega = own.converter.omega_n if step else one.timeline.segments[-1].source.omega
        cycle = max(round(2.0 * math.pi / omega / own.converter.T_s), 1)
        of.setdefault((one.timeline.names, len(one.timeline.units), bool(step), cycle), []).append(one)
    yield from of.values()


def _part(
    plants: Plants,
    some: Sequence[_Prepared],
    begin: Index,
    flat: LaneCases,
    rests: Rests,
    demand: SurvivalDemand,
    bridge: str,
) -> PlantPart:
    """The cases of a group, at rest and with everything that is known beforehand."""
    some = sorted(some, key=lambda one: -int(plants.ends[one.number]))
    numbers = np.array([one.number for one in some], dtype=np.intp)
    first, own = some[0], some[0].timeline.units[0]
    step = plants.cases.kind[first.number] == STEP
    unit = kind_of(own, switched=False)._replace(watch=STEP_WATCHED if step else DISTURBANCE, own_rest=bridge == "pwm")
    count, clock = len(first.timeline.units), clock_of_study(first.study)
    sampling = tuple(one.units for one in clock.instants)
    kind = PlantKind((unit,) * count, first.timeline.names, 1, sampling, 1)
    if bridge == "pwm":
        # Parts with circuits that are a little stiffer, or less so, share a loop.
        kind = switched(kind, [(one.timeline, wiring_of(one.study)) for one in some], clock, LARGEST_DEGREE)
    omega = own.converter.omega_n if step else first.timeline.segments[-1].source.omega
    cycle = max(round(2.0 * math.pi / omega / own.converter.T_s), 1)
    judged = [first_judged(flat.take(begin[numbers] + k), own.converter.T_s).min() for k in range(count)]
    logged = max(int(min(judged)) - (cycle if step else 0), 0)  # before a step there is the mean with which it begins
    part = PlantPart(own, kind, [one.timeline for one in some], plants.ends[numbers], flat.events.count, logged)
    part.units = tuple(
        UnitOfPart(part, k, flat.take(begin[numbers] + k), begin[numbers] + k, cycle) for k in range(count)
    )
    writer, turn = part.writer, [one.place.get("of.turn") for one in part.units]
    for lane, one in enumerate(some):
        StartOfPlant(part.at(lane), kind, one.study, one.timeline, [PowerLoopGains(*[0.0] * 8)] * count).put(one.start)
        program = PlantProgram(kind, wiring_of(one.study), one.timeline.segments, clock)
        program.write(writer, part.span(kind.matrix[0]).start, part.place["V_g"], lane)
        for sample in program.cut:
            part.cuts.setdefault(sample, []).append((lane, program, one.timeline.units))
        _phase(part, lane, one.timeline)
        for row in turn if not step else ():
            _turns(writer, lane, row, one.timeline, own.converter.T_s)
    if len(part) % part.spec.width:  # places that are left take what the last plant has
        part.put(0, np.stack([part.get(row) for row in range(part.rows.shape[1])]))
    limit = own.converter.I_rated_pk * (demand.i_max_pu if demand.i_max_pu is not None else 1e6)
    shared = {"load_of.limit_sq": limit * limit, "of.band": SETTLING_BAND if step else demand.band}
    shared |= {"of.per_S": 1.0 / own.converter.S_rated, "of.per_cycle": 1.0 / cycle}
    present, lanes = [], np.arange(len(some))
    for one in part.units:
        mine, nominal = rests.take(one.index), own.converter.references()
        for name, value in shared.items():
            if name in one.place:
                one.put(name, np.full(len(one), value))
        for name, value in zip(nominal._fields, (one.cases.P_ref, one.cases.Q_ref, *nominal[2:]), strict=True):
            one.put(f"refs.{name}", np.broadcast_to(value, len(one)))
        if "watch.entry.last_out" in one.place:
            one.put("watch.entry.last_out", np.full(len(one), -1.0))
        put_references(one, writer, one.cases)
        put_links(one, writer, one.cases)
        (watch_step if step else watch_disturbance)(one, writer, one.cases, mine)
        watched = one.span("watch")
        writer.copy(lanes, part.ends, one.kept["watch"], watched.stop - watched.start, watched.start)
        writer.copy(lanes, part.ends, one.kept["limited_at_end"], 1, one.place["limited"])
        keep_links(one, writer)
        present.append(means_at_rest(one, one.cases, mine, cycle))
    part.ring(cycle, present)
    return part


def _phase(part: PlantPart, lane: int, timeline: PlantTimeline) -> None:
    """The phasor of the grid's source at the start."""
    angle = timeline.segments[0].source.phase
    part.view("alpha.source0", lane)[:] = math.cos(angle), math.sin(angle)
    part.view("beta.source0", lane)[:] = math.sin(angle), -math.cos(angle)


def _turns(writer: ProgramWriter, lane: int, row: int | None, timeline: PlantTimeline, T_s: float) -> None:
    """By how much the grid's source turns over each interval: that of an event contains its jump."""
    if row is None:
        return
    sources = timeline.shared.sources
    writer.put([lane], [0], row, np.array([sources[0].omega * T_s]))
    for one in sources[1:]:
        after = math.ceil(one.t_s / T_s - SAME_INSTANT)
        instants = np.array([after - 1, after]) * T_s
        jumped = np.diff(timeline.shared.source_phase(instants, SAME_INSTANT * T_s))
        writer.put([lane], [after - 1], row, jumped)
        writer.put([lane], [after], row, np.array([one.omega * T_s]))


__all__ = ["Plants", "Units", "run_plants"]
