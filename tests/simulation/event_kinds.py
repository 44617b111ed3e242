"""A kind of event through everything that runs events, with a judge of its own on a log of every sample."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.compliance.case import Subject as OfSuite
from vsgdesign.campaigns.compliance.reading import suite_from_text
from vsgdesign.campaigns.compliance.run import run_test
from vsgdesign.campaigns.verification.draws import cases_of, families, uniforms_of
from vsgdesign.campaigns.verification.emt import case_study
from vsgdesign.linear.stability.maps import cells_under
from vsgdesign.report.explore.live import emt_answer, simulated
from vsgdesign.report.explore.maps import survived_cells
from vsgdesign.report.explore.scene import scene_of, study_of
from vsgdesign.report.explore.state import defaults, state_of
from vsgdesign.simulation.lanes.results import JUDGED
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.simulation.run import Simulation
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.survival import CaseRun, GridState, Subject, SurvivalCase, trace_case
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.event import Event

TEXT = """
base = "case:hoang2025_5kva"
[converter]
current_limit_pu = 1.2
current_limiter = "projection"
[grid]
scr = 5
x_over_r = 5
[power_loops]
structure = "angle_damped"
settling_time = "0.3 s"
tau_P = "5 ms"
tau_Q = "5 ms"
P_droop = "5 %"
Q_droop = "5 %"
[simulation]
duration = "2.4 s"
P_ref = "2 kW"
Q_ref = "0.5 kvar"
[[controllers]]
name = "damped"
kind = "scheduled"
"""
BAND = 0.02
"""How near P and Q have to come to their rest, as a share of the rating (docs/survival.md)."""
SAME_S = 2e-5
"""Largest difference of two recovery times, s: one rest is computed, and the other one is where the run ends, 1e-6 of
the rating beside it."""


def study_with(more: str = "", text: str = TEXT) -> Study:
    """The study of this module with more sections, logged at every sample."""
    study = study_from_text(text + more)
    simulation = replace(study.simulation, log_interval=study.converter.T_s, survival=bool(study.events))
    return replace(study, simulation=simulation)


class Verdict(NamedTuple):
    """What the own judge says."""

    recovery_s: float
    P: float
    Q: float
    V: float
    """Rest: means over the last cycle."""


def judged(study: Study, run: Simulation, since_s: float) -> Verdict:
    """When the means over a cycle of P and Q are at their last values for good, after an instant. The log has every
    sample."""
    T_s, S = study.converter.T_s, study.converter.S_rated
    cycle = round(2.0 * np.pi / run.timeline.source_at(study.simulation.duration).omega / T_s)
    P, Q, V = (
        np.convolve(np.concatenate([np.full(cycle - 1, values[0]), values]), np.full(cycle, 1.0 / cycle), "valid")
        for values in (run.each(name) for name in ("P", "Q", "V_rms"))
    )
    P_end, Q_end, V_end = float(P[-1]), float(Q[-1]), float(V[-1])
    error = np.maximum(np.abs(P - P_end), np.abs(Q - Q_end)) / S
    outside = np.flatnonzero((error > BAND) & (run.each_s >= since_s - 0.1 * T_s))
    if not outside.size:
        return Verdict(0.0, P_end, Q_end, V_end)
    k = int(outside[-1])
    share = (error[k] - BAND) / (error[k] - error[k + 1])
    return Verdict(float(run.each_s[k] + share * T_s - since_s), P_end, Q_end, V_end)


def in_simulate(event: str) -> tuple[Study, Simulation, float | None]:
    """A run of a study with one event at 0.2 s, as a table of [[events]]; and the recovery time that it tells."""
    result = run_scenario(study_with(f"[[events]]\ntime = '0.2 s'\n{event}\n"))
    one = result.controllers[0]
    assert one.survival is not None
    assert one.survival.status == "survived"
    return result.study, one.simulation, one.survival.recovery_s


def in_verify(family: str, count: int) -> None:
    """Cases of a family side by side; each is run again from its own study file, and judged there."""
    study = study_with(f"[verification.{family}]\nweight = 1\n")
    spec, number = study.controllers[0], families().index(family)
    cases, of = cases_of(study, spec, uniforms_of(1, 0, count), number)
    assert (of == number).all()
    results, told = run_lanes(study, spec, NOTHING, cases), 0
    for k in range(count):
        _, text = case_study(study, spec, cases, k)
        again = study_from_text(text)
        run = run_scenario(again).controllers[0]
        assert run.survival is not None
        assert run.survival.survived == (results.status[k] == JUDGED)
        if run.survival.survived:
            assert run.survival.recovery_s is not None
            assert abs(results.recovery_s[k] - run.survival.recovery_s) < 1e-9
            found = judged(again, run.simulation, float(cases.events.t_s[k, 0])).recovery_s
            assert abs(results.recovery_s[k] - found) < SAME_S
            told += found > 0.0
    assert told >= count // 2


def in_survive(change: Event) -> None:
    """A survival case of one change."""
    study = study_with()
    start = GridState(scr=5.0, x_over_r=5.0, P_pu=0.4, Q_pu=0.1)
    case = SurvivalCase(group="one", start=start, changes=(change,), cleared_s=change.end_s)
    run = trace_case(Subject(study=study, spec=study.controllers[0], limit_pu=1.2), case)
    assert isinstance(run, CaseRun)
    assert run.verdict.status == "survived"
    assert run.study is not None
    assert run.simulation is not None
    found = judged(run.study, run.simulation, case.lead_s).recovery_s
    assert run.verdict.recovery_s is not None
    assert abs(run.verdict.recovery_s - found) < SAME_S


def in_a_suite(event: str) -> None:
    """A test of a suite with one event."""
    text = f"[[tests]]\nname = 'one'\nscr = 5\nx_over_r = 5\nP_pu = 0.4\nevents = [{{ {event} }}]\n"
    study = study_with()
    run = run_test(OfSuite(study=study, spec=study.controllers[0]), suite_from_text(text).tests[0])
    assert run.survival.status == "survived"
    assert run.simulation is not None
    assert run.survival.recovery_s is not None
    found = judged(run.study, run.simulation, run.study.events[-1].t_s).recovery_s
    assert abs(run.survival.recovery_s - found) < SAME_S


def in_the_explorer(kind: str, size: float) -> dict[str, Any]:
    """The page's answer to an event, and the map of what is survived. Returns the answer's row."""
    study = study_with()
    document = defaults(study) | {"event": {"kind": kind, "size": size}}
    state = state_of(json.loads(json.dumps(document)), study)
    scene = scene_of(study, NOTHING, state)
    answer = emt_answer(study, NOTHING, state)
    assert answer is not None
    (row,) = answer.header["controllers"]
    one = study_of(scene, NOTHING, state, 0)
    run = simulated(one, NOTHING)
    found = judged(one, run, one.events[0].t_s).recovery_s
    assert row["status"] == "survived"
    assert abs(row["recovery_s"] - found) < SAME_S
    shown, at = scene.shown[0], (scene.grid.R_g, scene.grid.L_g, scene.P, scene.Q)
    assert shown.law is not None
    cells = cells_under(shown.study, shown.law, *(np.array([value]) for value in at))
    known, good = survived_cells(shown, NOTHING, state, cells)
    assert known.all()
    assert good.all()
    return row
