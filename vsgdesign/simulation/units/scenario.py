"""A plant through a scenario: every controller of the study in all units, with rests, modes and figures of each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.frames import instantaneous_power
from vsgdesign.errors import InfeasibleStudyError, SimulationDivergedError
from vsgdesign.linear.operating_point.equilibrium import point_at
from vsgdesign.linear.operating_point.flow_of_units import clock_of_study
from vsgdesign.linear.operating_point.rest_of_units import UnitsAtRest, rest_of_units
from vsgdesign.linear.stability.loci import Mode
from vsgdesign.linear.stability.modes_of_units import PlantMode, SplitModes, modes_of_units, split_modes
from vsgdesign.metrics.survival import ExpectedRest
from vsgdesign.simulation.dc_beyond import told_of_units
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.gains import GainChange, settled_changes
from vsgdesign.simulation.outcome import Divergence, Outcome
from vsgdesign.simulation.rest import Rest
from vsgdesign.simulation.run import Simulation
from vsgdesign.simulation.scenario.controllers import ControllerResult, judged_as_one, with_told
from vsgdesign.simulation.survival.cases import settling_time_of
from vsgdesign.simulation.units.run import PlantRun, check_start, simulate_plant
from vsgdesign.simulation.units.runs_again import NEVER, Tape, joined, twins_of, waiting
from vsgdesign.simulation.units.sharing import Sharing, sharing_of
from vsgdesign.simulation.units.start import situation_at
from vsgdesign.simulation.units.timeline import PlantTimeline, plant_timeline, spec_of, without_blocked
from vsgdesign.simulation.units.unit_result import (
    InverterRest,
    as_simulation,
    inverter_series,
    inverters_at_rest,
    terminals_at_rest,
    unit_result,
)
from vsgdesign.simulation.units.windows import Follows, Schedule
from vsgdesign.study.parameters.grid import GridSource
from vsgdesign.study.parameters.power_plant import GRID
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

_MOST_NUMBERS = 120_000_000
"""Of a log of every sample, 1 GB. Of a longer run figures are taken from every n-th one."""

_SHOWN = 12
"""Modes of a plant that are kept."""


@dataclass(frozen=True, kw_only=True)
class PlantRest:
    """Where a plant comes to rest after an event, with its modes there."""

    t_s: float
    end_s: float
    name: str
    on_line: tuple[str, ...]
    modes: tuple[PlantMode, ...]
    """The slowest ones, or those that grow, first."""
    split: SplitModes | None
    """By the two models of one unit, where the units are equal."""
    obstacle: str | None
    """Why there is no rest; None where there is one."""
    units: tuple[Rest, ...]
    """Of each unit of the plant."""
    inverters: tuple[InverterRest, ...] = ()
    """Of those that are connected, where there is a rest."""
    expected: tuple[ExpectedRest, ...] = ()
    """What a disturbance of each unit is judged by."""
    islanded: bool = False
    """Whether no source is connected, and no fault is there."""

    @property
    def stable(self) -> bool:
        """Whether every mode decays; true where there is no rest."""
        return not self.modes or self.modes[0].s.real < 0.0


@dataclass(frozen=True, kw_only=True)
class PlantController:
    """A plant all of whose units have one controller."""

    spec: ControllerSpec
    timeline: PlantTimeline
    rests: tuple[PlantRest, ...]
    units: tuple[ControllerResult, ...]
    """Figures and series of each unit, as of one converter."""
    inverters: tuple[tuple[str, dict[str, Array]], ...]
    """Names and series of the inverters."""
    loop_seconds: float
    sharing: tuple[Sharing, ...] = ()
    """Of each unit in each stretch without a source."""
    alone: tuple[str, ...] = ()
    """Events whose breakers wait and never close."""

    @property
    def outcome(self) -> Outcome:
        """The worst one of its units that are connected at the end, with the name of the unit; a unit whose bridge has
        blocked is lost."""
        if (blocked := next((one.outcome for one in self.units if one.outcome.status == "blocked"), None)) is not None:
            return blocked
        if self.alone:
            return Outcome("not settled", self.alone[0])
        if self.rests[-1].islanded and self.sharing:
            at_end = [one for one in self.sharing if one.t_s == self.rests[-1].t_s]
            bad = next((one for one in at_end if one.fault is not None), None)
            return Outcome("settled") if bad is None else Outcome("not settled", f"{bad.unit}: {bad.fault}")
        order = ("diverged", "blocked", "unstable", "infeasible", "limited", "not settled", "not known", "settled")
        names, rest = [unit.name for unit in self.timeline.plant.units], self.rests[-1]
        last = [name for name in names if name in rest.on_line]
        if not last and not rest.stable:
            return Outcome("unstable", f"the inverters are unstable without a unit: {rest.modes[0].s.real:+.3g} 1/s")
        last = last or names
        ranked = [one for one in zip(names, self.units, strict=True) if one[0] in last]
        name, worst = min(ranked, key=lambda one: order.index(one[1].outcome.status))
        reason = worst.outcome.reason
        return worst.outcome if reason is None else replace(worst.outcome, reason=f"{name}: {reason}")


@dataclass(frozen=True, kw_only=True)
class PlantResult:
    """All controllers of a study with a plant."""

    study: Study
    controllers: tuple[PlantController, ...]
    ready: Ready = NOTHING


def run_plant(
    study: Study,
    ready: Ready = NOTHING,
    *,
    progress: Callable[[str, float], None] | None = None,
    warn: Callable[[str], None] | None = None,
) -> PlantResult:
    """Every controller of a study in all units of its plant. ``warn`` is called with a sentence on each rest that is
    unstable: before the run, or after it where gains follow what a unit measures. Raises InfeasibleStudyError where the
    start has no steady state, or a controller cannot be run in a plant."""
    found = []
    asked = study
    for spec in asked.controllers:
        report = None if progress is None else _reporter(progress, spec.name)
        study = unblocked = _with_closings(asked, spec, ready, report)
        blocked: dict[str, Divergence] = {}
        while True:
            timeline, schedules, rests = _prepared(study, spec, ready, warn)
            interval, tape = _interval(study, timeline), Tape()
            run = simulate_plant(study, schedules, timeline=timeline, log_interval=interval, progress=report, tape=tape)
            lost = run.divergence
            if lost is None or not lost.blocked:
                break
            blocked[lost.unit] = lost  # the others go on
            study = without_blocked(study, lost.unit, lost.t_s)
        feeds = [one if isinstance(one, FieldScheduler) else None for one in schedules]
        twins = twins_of(study, spec, run, schedules, tape, interval)
        if any(not isinstance(one, Sequence) for one in schedules):  # with the gains that it really had
            rests = _told_rests(study, spec, timeline, _settled(study, run), warn)
        units = tuple(
            unit_result(
                study,
                spec,
                ready,
                run,
                k,
                tuple(one.units[k] for one in rests),
                [one.expected[k] for one in rests],
                feed,
                twins,
                blocked.get(run.units[k].name),
            )
            for k, feed in enumerate(feeds)
        )
        told = _told_if_blocked(unblocked, spec, ready, blocked) if blocked else {}
        for name, said in told.items():
            if warn is not None:
                warn(f"{spec.name}, {name}: {said}.")
        names = (unit.name for unit in run.units)
        units = tuple(with_told(one, told.get(name)) for name, one in zip(names, units, strict=True))
        every = max(round(study.simulation.log_interval / (run.t_s[1] - run.t_s[0])), 1)
        phase = timeline.shared.source_phase(run.t_s, 1e-9)
        inverters = tuple((one.name, inverter_series(one, run.t_s, phase, every)) for one in run.inverters)
        found.append(
            PlantController(
                spec=spec,
                timeline=timeline,
                rests=rests,
                units=units,
                inverters=inverters,
                loop_seconds=run.loop_seconds,
                sharing=sharing_of(run, rests, settling_time_of(spec, ready)),
                alone=tuple(event.name for event in study.events if event.name.endswith(NEVER)),
            )
        )
    return PlantResult(study=asked, controllers=tuple(found), ready=ready)


def _told_if_blocked(study: Study, spec: ControllerSpec, ready: Ready, blocked: Collection[str]) -> dict[str, str]:
    """:func:`vsgdesign.simulation.scenario.controllers.told_if_blocked` of the units whose bridges have blocked."""
    asked = judged_as_one(study, spec, ready)
    if asked is None:
        return {}

    def runs(one: Study) -> dict[str, Simulation]:
        timeline, schedules, _ = _prepared(one, spec, ready, None)
        run = simulate_plant(one, schedules, timeline=timeline, log_interval=_interval(one, timeline))
        return {unit.name: as_simulation(run, unit, k) for k, unit in enumerate(run.units) if unit.name in blocked}

    def survives(one: Study) -> bool:
        (found,) = run_plant(one, ready).controllers
        named = zip(found.timeline.plant.units, found.units, strict=True)
        verdicts = [unit.survival for own, unit in named if own.name in found.rests[-1].on_line]
        return all(verdict is not None and verdict.survived for verdict in verdicts)

    try:
        return told_of_units(asked, runs, survives)
    except (InfeasibleStudyError, SimulationDivergedError):
        return {}


def _with_closings(study: Study, spec: ControllerSpec, ready: Ready, report: Callable[[float], None] | None) -> Study:
    """The study with the breakers that wait as events at the instants at which they close."""
    while (event := waiting(study)) is not None:
        timeline, schedules, _ = _prepared(study, spec, ready, None)
        run = simulate_plant(
            study, schedules, timeline=timeline, log_interval=_interval(study, timeline), progress=report
        )
        study = joined(study, event, run)
    return study


def check_plant_run(study: Study, ready: Ready = NOTHING) -> list[str]:
    """What a run of a plant would warn of. Raises what :func:`run_plant` raises before its first sample."""
    said: list[str] = []
    for spec in study.controllers:
        timeline, schedules, _ = _prepared(study, spec, ready, said.append)
        check_start(study, schedules, timeline)
    return said


def _prepared(
    study: Study, spec: ControllerSpec, ready: Ready, warn: Callable[[str], None] | None
) -> tuple[PlantTimeline, list[Schedule], tuple[PlantRest, ...]]:
    """Timeline, gains of each unit and rests of a controller, before its run."""
    timeline = plant_timeline(study, spec)
    schedules = [_gains(timeline, k, spec, ready) for k in range(len(timeline.units))]
    known = [one for one in schedules if not isinstance(one, Follows | FieldScheduler)]
    rests = _told_rests(study, spec, timeline, known, warn) if len(known) == len(schedules) else ()
    return timeline, schedules, rests


def _told_rests(
    study: Study,
    spec: ControllerSpec,
    timeline: PlantTimeline,
    schedules: Sequence[Sequence[GainChange]],
    warn: Callable[[str], None] | None,
) -> tuple[PlantRest, ...]:
    """The rests of a plant, with a warning of each that is unstable."""
    rests = _rests(study, timeline, schedules)
    for one in rests if warn is not None else ():
        if not one.stable and warn is not None:
            warn(_unstable(spec, one))
    return rests


def _settled(study: Study, run: PlantRun) -> list[tuple[GainChange, ...]]:
    """The gains that each unit had before each event and at the end."""
    instants = sorted({event.t_s for event in study.events})
    return [settled_changes(one.gain_changes, instants, study.simulation.duration) for one in run.units]


def _reporter(progress: Callable[[str, float], None], name: str) -> Callable[[float], None]:
    return lambda t_s: progress(name, t_s)


def _gains(timeline: PlantTimeline, k: int, spec: ControllerSpec, ready: Ready) -> Schedule:
    own = timeline.units[k]
    feed = feed_of(own, spec_of(own, spec), timeline.timelines[k], ready)
    if not isinstance(feed, Sequence | Follows | FieldScheduler):
        raise InfeasibleStudyError(
            f"controller {spec.name}: its gains follow an estimate out of windows, which a plant does not have yet. "
            'Give kind = "fixed", a schedule on the true grid, or estimate = "field".'
        )
    return feed


def _interval(study: Study, timeline: PlantTimeline) -> float:
    """The spacing of the rows from which figures are taken, s: that of the clock, as long as they fit into memory."""
    period = clock_of_study(study).period
    wide = 15 * len(timeline.plant.converters) + 2 * len(timeline.names)
    rows = study.simulation.duration / period
    logged = max(round(study.simulation.log_interval / period), 1)
    enough = (n for n in range(1, logged) if logged % n == 0 and rows * wide <= n * _MOST_NUMBERS)
    return next(enough, logged) * period


def _unstable(spec: ControllerSpec, rest: PlantRest) -> str:
    mode = rest.modes[0]
    units = ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in mode.units[:4])
    who = f"taking part: {units}"
    if rest.split is not None:
        against = rest.split.differential[0].s.real >= rest.split.common[0].s.real
        who = "the units against each other" if against else "all units together"
    hertz = abs(mode.s.imag) / (2.0 * math.pi)
    return (
        f"controller {spec.name} is unstable from {rest.t_s:g} s to {rest.end_s:g} s, after {rest.name}: "
        f"{mode.s.real:+.3g} 1/s at {hertz:.3g} Hz, {who}."
    )


def _rests(study: Study, timeline: PlantTimeline, schedules: Sequence[Sequence[GainChange]]) -> tuple[PlantRest, ...]:
    """The rest of each stretch between two instants with events."""
    names: dict[float, str] = {0.0: "the start"}
    for event in sorted(study.events, key=lambda one: one.t_s):
        before = names.get(event.t_s, "the start")
        names[event.t_s] = event.name if before == "the start" else f"{before}, {event.name}"
    instants = sorted(names)
    ends = [*instants[1:], study.simulation.duration]
    return tuple(
        _rest(study, timeline, schedules, t_s, end_s, names[t_s]) for t_s, end_s in zip(instants, ends, strict=True)
    )


def _rest(
    study: Study,
    timeline: PlantTimeline,
    schedules: Sequence[Sequence[GainChange]],
    t_s: float,
    end_s: float,
    name: str,
) -> PlantRest:
    plant, shared = timeline.plant, timeline.shared
    segment = replace(timeline.segment_at(t_s), source=shared.source_at(end_s - 1e-9))
    ramps = [later.t_s for before, later in itertools.pairwise(shared.sources) if not before.steady]
    gains = [[one.gains for one in own if one.t_s < end_s or one.t_s == 0.0][-1] for own in schedules]
    on_line = [k for k, unit in enumerate(plant.units) if unit.name not in segment.topology.opened]
    obstacle, rest = None, None
    sources = {GRID, *(one.name for one in plant.sources)}
    if segment.topology.faults:
        obstacle = "a fault is there, which is no state to stay in"
    elif not on_line and all(one.name in segment.topology.opened for one in plant.inverters):
        obstacle = "no unit is connected"
    elif not segment.source.steady:
        obstacle = "the source is still on its ramp when the window ends"
    elif sources <= segment.topology.opened:
        obstacle = "no source is connected in whose frequency a steady state could be"
    else:
        try:
            rest = rest_of_units(situation_at(study, timeline, segment, gains, on_line, t_s))
        except InfeasibleStudyError as error:
            obstacle = str(error)
    modes = () if rest is None else modes_of_units(rest, _SHOWN)
    split = None if rest is None else split_modes(rest, _SHOWN)
    source = GridSource(segment.source.V_g_rms, segment.source.omega)
    units, expected = [], []
    for k, unit in enumerate(plant.units):
        own, closed = timeline.units[k], k in on_line
        base = Rest(
            t_s=t_s,
            end_s=end_s,
            name=name,
            grid=timeline.timelines[k].grid_at(t_s),
            source=source,
            gains=gains[k],
            point=None,
            P_pcc=math.nan,
            Q_pcc=math.nan,
            mode=None,
            obstacle=obstacle or f"the breaker of {unit.name} is open",
            ramp_end_s=max([t_s, *(one for one in ramps if t_s < one <= end_s)]),
            ramping=not segment.source.steady,
            modelled=obstacle is not None,
        )
        units.append(base if rest is None or not closed else _at_rest(own, base, rest, on_line.index(k), modes))
        none = ExpectedRest.none(base.obstacle or "there is no rest")
        expected.append(none if rest is None or not closed else expected_rest(rest, on_line.index(k)))
    return PlantRest(
        t_s=t_s,
        end_s=end_s,
        name=name,
        on_line=tuple(one.name for one in plant.converters if one.name not in segment.topology.opened),
        modes=modes,
        split=split,
        obstacle=obstacle,
        units=tuple(units),
        inverters=() if rest is None else inverters_at_rest(rest),
        expected=tuple(expected),
        islanded=not segment.topology.faults and sources <= segment.topology.opened,
    )


def _at_rest(study: Study, base: Rest, rest: UnitsAtRest, k: int, modes: Sequence[PlantMode]) -> Rest:
    """The rest of a unit within that of the plant, whose slowest mode is that of every unit."""
    model = rest.model
    P, Q = model.powers(rest.z, k)
    v, i_g = terminals_at_rest(rest, k)
    P_pcc, Q_pcc = (float(one) for one in instantaneous_power(v.real, v.imag, i_g.real, i_g.imag))
    controller, _, _ = rest.controller(k, 0.0)
    path = study.path_to_grid(base.grid, base.source.omega_g)
    point = point_at(P, Q, controller.V, controller.theta, *path, study.converter.V_limits_rms)
    slowest = modes[0]
    return replace(
        base,
        point=point,
        P_pcc=P_pcc,
        Q_pcc=Q_pcc,
        mode=Mode(slowest.s, slowest.damping, slowest.units),
        obstacle=None,
        modelled=True,
    )


def expected_rest(rest: UnitsAtRest, unit: int) -> ExpectedRest:
    """A unit at rest as a disturbance is judged by it. ``unit``: its place among those that are on line."""
    P, Q = rest.model.powers(rest.z, unit)
    i_s = float(np.hypot(*rest.model.measured(rest.z, unit)[:2]))
    rated = rest.model.situation.units[unit].study.converter.I_rated_pk
    return ExpectedRest(P=P, Q=Q, delta=rest.controller(unit, 0.0)[0].theta, i_s_pu=i_s / rated)
