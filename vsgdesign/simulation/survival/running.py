"""One disturbance through the EMT, and the verdict on it."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.dc_control import reactive_rest
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.grid import capacitor_node_voltage
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.errors import InfeasibleStudyError, LimitHitError, SimulationDivergedError
from vsgdesign.identification import estimator_kind
from vsgdesign.linear.operating_point.many import Lanes
from vsgdesign.linear.operating_point.many_rests import reactive_curve, rest_with_measured_gains
from vsgdesign.metrics.protection import Trip, first_trip
from vsgdesign.metrics.step_response import cycle_mean
from vsgdesign.metrics.survival import (
    BLOCKED,
    DIVERGED,
    NO_REST,
    OVER_LIMIT,
    TRIPPED,
    ExpectedRest,
    Survival,
    SurvivalDemand,
    SurvivalRecord,
    judge_survival,
)
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.circuits import Connection, circuit_at_rest
from vsgdesign.simulation.dc_beyond import told_of_blocked
from vsgdesign.simulation.dc_start import moved_rest
from vsgdesign.simulation.estimated import EstimateLog
from vsgdesign.simulation.feeds import LateSchedule, safe_grid
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.gains import GainChange, gain_changes
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.survival.cases import (
    GridKnowledge,
    SurvivalCase,
    at_asked_powers,
    demand_of,
    field_demand,
    late_grid,
    settling_time_of,
)
from vsgdesign.simulation.timeline import Timeline, build_timeline
from vsgdesign.study.parameters.grid import Grid, GridSource, Load, Network, only_a_grid
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

OWN_REST_PU = 0.15
"""A switched bridge rests beside the averaged model by its ripple, up to this far: by 7 % of S_rated in Q for a 1 MVA
converter with 3 kHz at SCR 20, with and without a limit. It is judged by its own rest."""

OWN_REST_CYCLES = 5
"""A switched bridge rests at the means over a cycle within its last cycles, of which there are so many."""


_SAME_INSTANT = 1e-6
"""Share of a sample by which a row may lie before an event and is still after it: times are rounded."""


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A converter with one of its controllers: what is sent through the cases.

    The controller's own current limiter acts, else that of the study. ``limit_pu`` is the limit that decides which
    rests are asked for. It stands apart, so that a controller without a limit is asked for the same cases.
    """

    study: Study
    spec: ControllerSpec
    ready: Ready = NOTHING
    limit_pu: float
    bridge: str = "averaged"
    room_pu: float | None = None
    """Largest converter current of a rest that is asked for, pu; None: what the limit allows. Where the grid's voltage
    has harmonics, the limiter needs room for theirs."""

    @property
    def in_the_field(self) -> bool:
        """Whether the grid's voltage wanders, or the sensors err: no power is then at rest for long."""
        return self.study.background is not None or self.study.sensors is not None

    @property
    def learns(self) -> bool:
        """Whether the controller estimates its grid by itself, in every sample. The cases' knowledge is then nothing to
        it; an estimator of windows is taken as late and wrong as the cases say."""
        estimate = self.spec.estimate
        return estimate != "truth" and estimator_kind(estimate).by_sample

    def refused(self, rest: ExpectedRest) -> tuple[str, str] | None:
        """(status, reason) if this rest is not asked for."""
        if self.room_pu is not None and rest.i_s_pu > self.room_pu:
            return OVER_LIMIT, f"the rest needs {rest.i_s_pu:.3g} pu, more than the {self.room_pu:.3g} pu with room"
        return rest.refused(self.limit_pu)

    @property
    def safe(self) -> Grid | None:
        """Where the schedule takes its gains from once its estimate is stale (:func:`safe_grid`)."""
        return safe_grid(self.study, self.spec, self.ready)

    @property
    def settling_time(self) -> float:
        """T: that of its table's specification, or of its closed form, s."""
        return settling_time_of(self.spec, self.ready)

    def demand(self, case: SurvivalCase) -> SurvivalDemand:
        """What is asked of it in a case."""
        c = self.study.converter
        df_hz = [change.df_hz for change in case.changes if change.df_hz is not None]
        frequency = c.omega_n / (2.0 * math.pi) + (df_hz[-1] if df_hz else case.start.df_hz)
        demand = demand_of(
            c,
            self.settling_time,
            silent_s=case.knowledge.silent_s,
            limit_pu=self.limit_pu,
            cycle_s=1.0 / frequency,
        )
        return replace(demand, **field_demand(case.scr_at_the_end, c.omega_n)) if self.in_the_field else demand


@dataclass(frozen=True, kw_only=True)
class CaseRun:
    """One run with everything that a figure of it needs."""

    case: SurvivalCase
    study: Study
    """With the events of the case."""
    rest: ExpectedRest
    simulation: Simulation
    record: SurvivalRecord
    verdict: Survival
    estimates: EstimateLog | None = None
    """Of a controller that estimates: what it was told."""


@dataclass(frozen=True, kw_only=True)
class CaseResult:
    """What became of a subject in one case."""

    case: SurvivalCase
    verdict: Survival
    seconds: float
    """Wall time of the run, s; of runs that shared a loop the mean."""


def run_case(subject: Subject, case: SurvivalCase) -> CaseResult:
    """One case: simulated if its rests exist, and judged."""
    begin = time.perf_counter()
    found = trace_case(subject, case)
    verdict = found if isinstance(found, Survival) else found.verdict
    return CaseResult(case=case, verdict=verdict, seconds=time.perf_counter() - begin)


def trace_case(subject: Subject, case: SurvivalCase) -> CaseRun | Survival:
    """One case with its traces. A verdict alone where nothing was simulated, or where it diverged at once."""
    demand = subject.demand(case)
    study, told = study_of_case(subject, case)
    timeline = build_timeline(study)
    rests = [rest_of(subject, study, timeline, t_s, told) for t_s in (0.0, study.simulation.duration)]
    for rest, where in zip(rests, ("before the event", "after the event"), strict=True):
        refused = subject.refused(rest)
        if refused is not None:
            return Survival(status=refused[0], reason=f"{where}: {refused[1]}")
    rest = rests[1]
    try:
        feed = _feed(subject, study, timeline, told)
        simulation = simulate(study, feed, bridge=subject.bridge)
    except SimulationDivergedError as error:
        return Survival(status=DIVERGED, reason=str(error))
    except InfeasibleStudyError as error:
        return Survival(status=NO_REST, reason=f"before the event: {error}")
    record = record_of(study, simulation)
    if subject.in_the_field:
        since_s = case.lead_s + case.cleared_s + demand.deadline_s
        refs = timeline.references_at(study.simulation.duration)
        known = _known(subject, told, study.simulation.duration)
        held = replace(study, dc=timeline.link_at(study.simulation.duration))
        rest = rest_on(subject, held, known, *late_grid(study, timeline, since_s), refs)
    elif subject.bridge == "pwm":
        rest = own_rest_of(rest, record, demand)
    instants = case.instants_s
    verdict = judge_survival(record, instants, case.lead_s + case.cleared_s, rest, demand)
    verdict = with_protection(verdict, study, simulation, instants[0])
    if verdict.status == BLOCKED and (told := _told_of_blocked(subject, case)) is not None:
        verdict = replace(verdict, status=NO_REST, reason=told)
    return CaseRun(
        case=case,
        study=study,
        rest=rest,
        simulation=simulation,
        record=record,
        verdict=verdict,
        estimates=feed.log(timeline) if isinstance(feed, FieldScheduler) else None,
    )


def _told_of_blocked(subject: Subject, case: SurvivalCase) -> str | None:
    """:func:`vsgdesign.simulation.dc_beyond.told_of_blocked` of a case."""

    def run(study: Study) -> Simulation | None:
        found = trace_case(replace(subject, study=study), case)
        return found.simulation if isinstance(found, CaseRun) else None

    def survives(study: Study) -> bool:
        return run_case(replace(subject, study=study), case).verdict.survived

    return told_of_blocked(subject.study, run, survives)


def study_of_case(subject: Subject, case: SurvivalCase) -> tuple[Study, tuple[tuple[float, Grid | None], ...]]:
    """The study that is simulated for a case, and what the schedule is told of the grid from each instant on."""
    demand = subject.demand(case)
    study = case.study(subject.study.with_limit_of(subject.spec), demand.needed_s + 2.0 * demand.cycle_s)
    if subject.in_the_field:
        only_a_grid(study.network, "a case in a disturbed grid")
        study = at_asked_powers(study, subject.spec, subject.ready)
    known = replace(case, knowledge=GridKnowledge()) if subject.learns else case
    return study, known.told(study, build_timeline(study))


def rest_of(
    subject: Subject, study: Study, timeline: Timeline, t_s: float, told: tuple[tuple[float, Grid | None], ...]
) -> ExpectedRest:
    """The steady state that belongs to an instant of a case, with the gains of the grid that is known then.

    No limit of the current stands in its way: the current that it needs is part of the answer.
    """
    source = timeline.source_at(t_s)
    at = GridSource(source.V_g_rms, source.omega)
    known, refs = _known(subject, told, t_s), timeline.references_at(t_s)
    held = replace(study, dc=timeline.link_at(t_s))
    return rest_on(subject, held, known, timeline.grid_at(t_s), at, refs, timeline.network_at(t_s).load)


def _known(subject: Subject, told: tuple[tuple[float, Grid | None], ...], t_s: float) -> Grid:
    """The grid whose gains are in force at an instant, once the schedule has come to rest."""
    if told[-1][1] is None and t_s >= told[-1][0] and subject.safe is not None:
        return subject.safe
    return [grid for start, grid in told if start <= t_s and grid is not None][-1]


def rest_on(
    subject: Subject,
    study: Study,
    known: Grid,
    grid: Grid,
    source: GridSource,
    refs: References,
    load: Load | None = None,
) -> ExpectedRest:
    """The steady state on a grid and a source, with a load at the PCC and the gains for the grid that is ``known``."""
    c = study.converter
    law = gain_law(study, subject.spec, subject.ready)
    free = replace(study, converter=replace(c, current_limit_pu=None))

    def gains_of(P: float, Q: float, V_rms: float) -> PowerLoopGains:
        return PowerLoopGains(*(float(value) for value in law(known.R_g, known.L_g, P, Q, V_rms)))

    try:
        state, _ = rest_with_measured_gains(
            free,
            grid,
            source,
            refs,
            gains_of,
            circuit=circuit_at_rest(study, Connection(grid, Network(load=load))),
        )
    except LimitHitError as error:
        return ExpectedRest.none(f"{error.limit}: {error}")
    except InfeasibleStudyError as error:
        return ExpectedRest.none(str(error))
    return ExpectedRest(
        P=state.controller.P_f,
        Q=state.controller.Q_f,
        delta=state.controller.theta,
        i_s_pu=float(np.hypot(*state.plant[:2])) / c.I_rated_pk,
    )


def record_of(study: Study, simulation: Simulation) -> SurvivalRecord:
    """What the judge sees of a run. Where the charge moves the rest of a clamped converter, P and the Q that belongs to
    it have moved back with it."""
    t_s, i_s = simulation.each_s, [simulation.each(name) for name in ("i_s_alpha", "i_s_beta")]
    every = max(round(float(t_s[1] - t_s[0]) / study.converter.T_s), 1)
    counted = simulation.each("limited_samples")
    P, Q = (np.ascontiguousarray(simulation.each(name)) for name in ("P", "Q"))
    if (moved := _moved(study, simulation)) is not None:
        P, Q = P - moved[0], Q - moved[1]
    phase = simulation.timeline.source_phase(t_s, _SAME_INSTANT * study.converter.T_s)
    limited = np.zeros(len(t_s))
    np.subtract(counted[1:], counted[:-1], out=limited[1:])
    return SurvivalRecord(
        t_s=t_s,
        P=P,
        Q=Q,
        delta=np.subtract(simulation.each("theta"), phase, out=phase),
        i_s_pu=np.sqrt(i_s[0] * i_s[0] + i_s[1] * i_s[1]) / study.converter.I_rated_pk,
        limited=limited if every == 1 else limited / every,
        diverged=simulation.divergence is not None,
    )


def _moved(study: Study, simulation: Simulation) -> tuple[Array, Array] | None:
    """By how much P (W) and Q (var) of the rest have moved with the charge, in each row; None: they have not."""
    end_s, timeline = float(simulation.t_s[-1]), simulation.timeline
    rows, count = simulation.dc_log, len(simulation.t_s)
    if rows is not None and len(rows) < count:  # the charge moves slowly: each of them counts up to the next one
        rows = rows[np.arange(count) // -(-count // len(rows))]
    moved = None if rows is None else moved_rest(study, timeline.link_at(end_s), rows)
    if moved is None:
        return None
    source, grid, load = timeline.source_at(end_s), timeline.grid_at(end_s), timeline.network_at(end_s).load
    lanes = Lanes.at(grid, GridSource(source.V_g_rms, source.omega), timeline.references_at(end_s))
    circuit = circuit_at_rest(study, Connection(grid, Network(load=load)))
    gains = simulation.gain_changes[-1].gains
    curve = reactive_curve(study, lanes, gains, np.array([moved.P_start]), circuit)
    Q = reactive_rest(moved.P, curve) - reactive_rest(moved.P_start, curve)
    return moved.P - moved.P_start, np.where(np.isfinite(Q), Q, 0.0)


def with_protection(verdict: Survival, study: Study, simulation: Simulation, since_s: float) -> Survival:
    """The verdict on a run with its dc link and the protection of its study: a run whose bridge blocks is lost, and a
    run that survives is tripped where a limit is reached after the first event (``since_s``)."""
    if simulation.divergence is not None and simulation.divergence.blocked:
        return replace(verdict, status=BLOCKED, reason=simulation.divergence.reason)
    if study.protection is None or not verdict.survived:
        return verdict
    log, circuit = simulation.log, study.circuit()
    v = np.hypot(*(capacitor_node_voltage(log[:, k], log[:, 2 + k], log[:, 4 + k], circuit) for k in (0, 1)))
    trip = trip_of(study, simulation.t_s, simulation.column("omega"), v, since_s)
    if trip is None:
        return verdict
    return replace(verdict, status=TRIPPED, reason=TRIPS_AT.format(trip.t_s, trip.reason))


TRIPS_AT = "the protection trips at {:.4g} s: {}"
"""What is said of a trip: its time in the run, and why."""


def trip_of(study: Study, t_s: Array, omega: Array, v_pk: Array, since_s: float) -> Trip | None:
    """The first trip of the protection of a study from ``since_s`` on; None without one.

    Arrays (n,) of every sample: time (s), frequency of the converter (rad/s), and length of the voltage's vector at the
    control point (V peak).
    """
    limits, c = study.protection, study.converter
    if limits is None:
        return None
    V_pu, f_hz = v_pk / rms_to_peak(c.V_rated_rms), omega / (2.0 * math.pi)
    return first_trip(t_s, f_hz, V_pu, limits, since_s, 2.0 * math.pi / c.omega_n)


def _feed(
    subject: Subject, study: Study, timeline: Timeline, told: tuple[tuple[float, Grid | None], ...]
) -> LateSchedule | FieldScheduler | tuple[GainChange, ...]:
    if subject.learns:
        return FieldScheduler(study, subject.spec, subject.ready)
    if subject.spec.kind == "scheduled":
        return LateSchedule(study, subject.spec, told, subject.ready, safe=subject.safe)
    return gain_changes(study, subject.spec, timeline)


def own_rest_of(rest: ExpectedRest, record: SurvivalRecord, demand: SurvivalDemand) -> ExpectedRest:
    """The powers at which a switched bridge itself rests, where these are near those of the averaged model."""
    cycle = max(round(demand.cycle_s / float(record.t_s[1] - record.t_s[0])), 1)
    count = OWN_REST_CYCLES * cycle
    if record.diverged or len(record.t_s) < 2 * count:
        return rest
    P, Q = (float(np.mean(cycle_mean(values, cycle)[-count + cycle :])) for values in (record.P, record.Q))
    P_own, Q_own = own_powers(P, Q, rest.P, rest.Q, demand.S_rated)
    return replace(rest, P=float(P_own), Q=float(Q_own))


def own_powers(P: Any, Q: Any, P_rest: Any, Q_rest: Any, S_rated: Any) -> Any:
    """The powers at which a switched bridge rests whose means at the end are P and Q, W and var: these, or those of the
    averaged model where they are not near. Returns (P_own, Q_own)."""
    far = np.maximum(np.abs(P - P_rest), np.abs(Q - Q_rest))
    near = np.where(far < OWN_REST_PU * S_rated, 1.0, 0.0)
    return np.where(near > 0.5, P, P_rest), np.where(near > 0.5, Q, Q_rest)
