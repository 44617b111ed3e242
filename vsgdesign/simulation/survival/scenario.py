"""The verdict on a run of a study whose own events are one disturbance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.filters import capacitor_node_voltage
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.power_loops import References
from vsgdesign.metrics.survival import (
    LATCHED,
    NOT_AT_REST,
    ExpectedRest,
    Survival,
    SurvivalDemand,
    SurvivalRecord,
    judge_survival,
)
from vsgdesign.simulation.feeds import STALE_S, Told, knowledge_of, told_at, told_of
from vsgdesign.simulation.run import Simulation
from vsgdesign.simulation.survival.cases import demand_of, held_fault, silent_s_of
from vsgdesign.simulation.survival.running import Subject, own_rest_of, record_of, rest_on, with_protection
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
