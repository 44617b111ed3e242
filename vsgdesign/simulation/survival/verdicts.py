"""Verdicts on disturbances: on a run of a study whose own events are one, and figures over many verdicts: how many
survived, how large the currents were, how long recovery took, and the critical clearing time, which says how long a
fault may last."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.grid import capacitor_node_voltage
from vsgdesign.equations.power_loops import References
from vsgdesign.metrics.survival import (
    LATCHED,
    NOT_AT_REST,
    STATUSES,
    ExpectedRest,
    Survival,
    SurvivalDemand,
    SurvivalRecord,
    judge_survival,
)
from vsgdesign.simulation.feeds import STALE_S, Told, knowledge_of, told_at, told_of
from vsgdesign.simulation.run import Simulation
from vsgdesign.simulation.survival.cases import demand_of, held_fault, silent_s_of
from vsgdesign.simulation.survival.running import CaseResult, Subject, own_rest_of, record_of, rest_on, with_protection
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.grid import Grid, GridSource, Load
from vsgdesign.study.parameters.study import ControllerSpec, Study

_LAST_CYCLES = 5
"""A run without a rest that is computed apart from it is judged by its means over so many cycles at its end."""

ISLAND_F = 0.06
"""How far the frequency of an island may be from the nominal one, as a share of it: 47 to 53 Hz at 50 Hz. It is this
project's choice."""


def judge_scenario(
    study: Study,
    spec: ControllerSpec,
    ready: Ready,
    simulation: Simulation,
    bridge: str = "averaged",
    *,
    own_rest: bool = False,
    rests: KnownRests | None = None,
) -> Survival:
    """:func:`judged_by_rest`, and whether the protection of the study trips (``[survival.protection]``)."""
    verdict = judged_by_rest(study, spec, ready, simulation, bridge, own_rest=own_rest, rests=rests)
    first_s = min(event.t_s for event in study.events if event.t_s > 0.0)
    return with_protection(verdict, study, simulation, first_s)


def judged_by_rest(
    study: Study,
    spec: ControllerSpec,
    ready: Ready,
    simulation: Simulation,
    bridge: str = "averaged",
    *,
    own_rest: bool = False,
    rests: KnownRests | None = None,
) -> Survival:
    """The verdict on a run of a study whose events are one disturbance, as :func:`trace_case` gives it for a case.

    ``study`` has the current limit of the controller. One that estimates the grid rests with the gains of the true one.
    A run that ends with a fault or an open breaker has no rest that is computed apart from it: it must come to a rest
    of its own, the means of its last cycles, and behind an open breaker within ISLAND_F and the voltage limits of the
    converter. ``own_rest`` asks the same of a run after whose events there is no rest within the current limit, and
    that it does there what its current allows (:func:`held_fault`). It judges a run that began with little room below
    the limit, too. ``rests``: those of this controller that are known, which gets the one of this run.
    """
    c, timeline = study.converter, simulation.timeline
    end_s, limit_pu = study.simulation.duration, c.current_limit_pu
    instants = sorted({event.t_s for event in study.events if event.t_s > 0.0})
    cleared_s = max(event.t_s + event.over for event in study.events)
    subject = Subject(study=study, spec=spec, ready=ready, limit_pu=math.inf if limit_pu is None else limit_pu)
    alone = not timeline.network_at(end_s).connected
    longest = study.simulation.survival_settling_time
    demand = demand_of(
        c,
        subject.settling_time if longest is None else min(subject.settling_time, longest),
        silent_s=silent_s_of(spec),
        cycle_s=None if alone else 2.0 * math.pi / timeline.source_at(end_s).omega,
    )
    found = rests_of_scenario(subject, study, timeline, (end_s,) if own_rest else (0.0, end_s), rests)
    record = _while_connected(record_of(study, simulation), timeline)
    refused: list[tuple[str, str] | None] = [None if rest is None else subject.refused(rest) for rest in found]
    if refused[0] is not None and not own_rest:
        return Survival(status=refused[0][0], reason=f"before the events: {refused[0][1]}")
    rest, beyond = found[-1], refused[-1]
    if beyond is not None and not own_rest:
        return Survival(status=beyond[0], reason=f"after the events: {beyond[1]}")
    if rest is None or beyond is not None:
        verdict = judge_survival(
            record, instants, cleared_s, _last_means(record, demand), replace(demand, i_max_pu=None)
        )
        if not verdict.survived:
            return verdict
        fault = _fault_of_island(study, simulation) if alone else None
        if fault is not None:
            return replace(verdict, status=NOT_AT_REST, reason=fault)
        fault = None if rest is None else held_fault(study, simulation, rest)
        if fault is not None:
            return replace(verdict, status=LATCHED, reason=fault)
        words = None if beyond is None else f"it comes to a rest of its own ({beyond[1]})"
        return replace(verdict, reason=words)
    if bridge == "pwm" or (study.background is not None and study.background.distorts):
        rest = own_rest_of(rest, record, demand)
    return judge_survival(record, instants, cleared_s, rest, demand)


KnownRests = dict[tuple[Grid, Grid, GridSource, References, Load | None], ExpectedRest]
"""Rests of one controller of one converter: by the grid that it is told, the true one, its source, the references and
the load."""


def rests_of_scenario(
    subject: Subject,
    study: Study,
    timeline: Timeline,
    instants_s: tuple[float, ...],
    rests: KnownRests | None = None,
) -> tuple[ExpectedRest | None, ...]:
    """Where a converter rests at instants before and after the events of a study, with its current limit out of the
    way; None where there is a fault or an open breaker. ``rests``: those that are known, which gets these."""
    knowledge = knowledge_of(subject.spec, timeline)
    told = None if knowledge is None else told_of(study, knowledge, timeline)
    found: list[ExpectedRest | None] = []
    rests = {} if rests is None else rests
    for t_s in instants_s:
        source, grid, network = timeline.source_at(t_s), timeline.grid_at(t_s), timeline.network_at(t_s)
        if network.fault is not None or not network.connected:
            found.append(None)
            continue
        known = grid if told is None else _known_at(told, t_s, subject.safe)
        at = GridSource(source.V_g_rms, source.omega)
        asked = known, grid, at, timeline.references_at(t_s), network.load
        if asked not in rests:
            rests[asked] = rest_on(subject, study, *asked)
        found.append(rests[asked])
    return tuple(found)


def _known_at(told: Told, t_s: float, safe: Grid | None) -> Grid:
    """The grid whose gains are in force at an instant: the one told last, or a safe one once that is stale."""
    known, answered = told_at(told, t_s)
    if answered or safe is None:
        return known
    last = max(k for k, (start_s, said) in enumerate(told) if said is not None and start_s <= t_s)
    return safe if t_s - told[last + 1][0] >= STALE_S else known


def _while_connected(record: SurvivalRecord, timeline: Timeline) -> SurvivalRecord:
    """The record with the angle against the grid source held while the breaker is open: it means nothing then."""
    if all(network.connected for _, network in timeline.networks):
        return record
    starts = np.array([t_s for t_s, _ in timeline.networks])
    closed = np.array([network.connected for _, network in timeline.networks])
    step = float(record.t_s[1] - record.t_s[0])
    there = closed[np.searchsorted(starts, record.t_s + 1e-3 * step, side="right") - 1]
    last = np.maximum.accumulate(np.where(there, np.arange(len(there)), 0))
    return replace(record, delta=record.delta[last])


def _last_means(record: SurvivalRecord, demand: SurvivalDemand) -> ExpectedRest:
    """The means of a record over its last cycles, in place of a rest that is computed apart from it."""
    rows = min(max(round(_LAST_CYCLES * demand.cycle_s / float(record.t_s[1] - record.t_s[0])), 1), len(record.t_s))
    P, Q, i_s = (float(np.mean(values[-rows:])) for values in (record.P, record.Q, record.i_s_pu))
    turn = 2.0 * math.pi
    delta = float(np.mean(np.unwrap(record.delta[-rows:])))
    found = ExpectedRest(P=P, Q=Q, delta=delta - turn * round(delta / turn), i_s_pu=i_s)
    return found if math.isfinite(P + Q + delta + i_s) else replace(found, P=0.0, Q=0.0, delta=0.0, i_s_pu=0.0)


def _fault_of_island(study: Study, simulation: Simulation) -> str | None:
    """What is wrong with the voltage or the frequency of an island over the last cycles; None: nothing."""
    c, circuit = study.converter, study.circuit()
    rows = max(round(_LAST_CYCLES * 2.0 * math.pi / c.omega_n / simulation.interval), 1)
    log = simulation.log[-rows:]
    v = np.hypot(*(capacitor_node_voltage(log[:, k], log[:, 2 + k], log[:, 4 + k], circuit) for k in (0, 1)))
    V_pu = float(np.mean(v)) / rms_to_peak(c.V_rated_rms)
    f_hz, f_n = float(np.mean(simulation.column("omega")[-rows:])) / (2.0 * math.pi), c.omega_n / (2.0 * math.pi)
    if not c.V_min_pu <= V_pu <= c.V_max_pu:
        return f"the island has {V_pu:.3g} pu, outside of {c.V_min_pu:g} to {c.V_max_pu:g} pu"
    if abs(f_hz - f_n) > ISLAND_F * f_n:
        low, high = f_n * (1.0 - ISLAND_F), f_n * (1.0 + ISLAND_F)
        return f"the island has {f_hz:.4g} Hz, outside of {low:.4g} to {high:.4g} Hz"
    return None


CURRENT_PU = 1.26
"""What the current later than 5 ms after an event should keep below, pu of rated, with a limit of 1.2 pu."""


@dataclass(frozen=True, kw_only=True)
class SurvivalFigures:
    """Figures over some results. None: there is nothing to take them from."""

    cases: int
    judged: int
    """Cases that have a verdict; the others were left out."""
    survived: int
    statuses: dict[str, int]
    """How many of each status, those without a verdict among them."""
    peak_pu: float | None
    """Largest current later than 5 ms after an event."""
    peak_median_pu: float | None
    peak_99_pu: float | None
    """Median and 99th percentile of that current over the cases."""
    peak_kept: float | None
    """Share of the judged cases in which it stays at or below CURRENT_PU."""
    beyond_hardware: int
    """Cases that survived with a current that hardware does not carry (HARDWARE_PU)."""
    first_peak_pu: float | None
    """Largest current within 5 ms of an event."""
    recovery_median: float | None
    recovery_worst: float | None
    """Of those that survived, in settling times."""
    swing_rad: float | None
    """Largest swing of the angle."""

    @property
    def share(self) -> float | None:
        """Share of the judged cases that survived."""
        return self.survived / self.judged if self.judged else None


def figures_of(results: Iterable[CaseResult], settling_time: float) -> SurvivalFigures:
    """Figures over results of subjects that all have this settling time in s."""
    results = list(results)
    judged = [result.verdict for result in results if result.verdict.judged]
    good = [verdict for verdict in judged if verdict.survived]
    peaks = [verdict.peak_pu for verdict in judged if verdict.peak_pu is not None]
    recoveries = [verdict.recovery_s / settling_time for verdict in good if verdict.recovery_s is not None]
    count = Counter(result.verdict.status for result in results)
    return SurvivalFigures(
        cases=len(results),
        judged=len(judged),
        survived=len(good),
        statuses={status: count[status] for status in STATUSES if count[status]},
        peak_pu=_largest(peaks),
        peak_median_pu=float(np.median(peaks)) if peaks else None,
        peak_99_pu=float(np.percentile(peaks, 99.0)) if peaks else None,
        peak_kept=sum(peak <= CURRENT_PU for peak in peaks) / len(judged) if peaks else None,
        beyond_hardware=sum(verdict.beyond_hardware for verdict in good),
        first_peak_pu=_largest([v.first_peak_pu for v in judged if v.first_peak_pu is not None]),
        recovery_median=float(np.median(recoveries)) if recoveries else None,
        recovery_worst=_largest(recoveries),
        swing_rad=_largest([v.swing_rad for v in judged if v.swing_rad is not None]),
    )


def by_group(results: Iterable[CaseResult]) -> dict[str, tuple[CaseResult, ...]]:
    """Results by the group of their case, in the order in which groups first appear."""
    found: dict[str, list[CaseResult]] = {}
    for result in results:
        found.setdefault(result.case.group, []).append(result)
    return {group: tuple(members) for group, members in found.items()}


def _largest(values: Sequence[float]) -> float | None:
    return max(values) if values else None


Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]

LENGTHS_S = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.0, 3.0)
"""Lengths at which a fault is tried first: a fault may be lost and a longer one survived, which bisection misses."""

RESOLUTION_S = 0.005


class Verdicts(NamedTuple):
    """Of n faults, (n,) each."""

    judged: Mask
    """Whether there is a verdict."""
    survived: Mask


FaultsOf = Callable[[Index, Array], Verdicts]
"""The verdicts of faults in some of the cells, each of its own length in s; both arguments (n,)."""


class ClearingTimes(NamedTuple):
    """Of every cell, (count,)."""

    longest_s: Array
    """Longest fault that was survived with every shorter one that was tried, s; 0 where none was, and NaN where the
    cell has no verdict at any length."""
    bounded: Mask
    """Whether a longer fault was lost. Otherwise every length that was tried was survived."""


def critical_clearing_times(
    faults_of: FaultsOf, count: int, *, lengths_s: tuple[float, ...] = LENGTHS_S, resolution_s: float = RESOLUTION_S
) -> ClearingTimes:
    """The critical clearing time of a fault in each of ``count`` cells.

    The shorter half of the lengths is tried in every cell, and the longer half where all of these were survived: what
    becomes of a fault that is longer than one that was lost does not matter. Bisection between the longest that was
    survived before the first loss and this loss follows, down to ``resolution_s``, in all cells side by side.
    """
    lengths, half = np.asarray(lengths_s, dtype=float), -(-len(lengths_s) // 2)
    judged, survived = np.ones(count, dtype=bool), np.ones((count, len(lengths)), dtype=bool)
    for some in (slice(0, half), slice(half, len(lengths))):
        open_ = np.flatnonzero(judged & survived.all(axis=1))
        tried = lengths[some]
        if len(open_) and len(tried):
            found = faults_of(np.repeat(open_, len(tried)), np.tile(tried, len(open_)))
            judged[open_] &= found.judged.reshape(len(open_), -1).all(axis=1)
            survived[open_, some] = found.survived.reshape(len(open_), -1)
    bounded = judged & ~survived.all(axis=1)
    lost = np.argmin(survived, axis=1)  # the first loss; 0 too where there is none
    good = np.where(bounded, np.where(lost > 0, lengths[lost - 1], 0.0), lengths[-1])
    bad = np.where(bounded, lengths[lost], good)
    while len(open_ := np.flatnonzero(bad - good > resolution_s)):
        middle = 0.5 * (good[open_] + bad[open_])
        held = faults_of(open_, middle).survived
        good[open_], bad[open_] = np.where(held, middle, good[open_]), np.where(held, bad[open_], middle)
    return ClearingTimes(np.where(judged, good, np.nan), bounded)
