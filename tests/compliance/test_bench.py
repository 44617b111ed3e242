"""One test of a suite as a run: its study, its trace, the judge, its row, and fewer rows of its trace."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.compliance.bench_studies import TEXT, judged_test, subject, suite_test
from vsgdesign.campaigns.compliance.case import Subject, case_of, case_text
from vsgdesign.campaigns.compliance.evidence import Evidence, thinned
from vsgdesign.campaigns.compliance.matrix import network_in_words
from vsgdesign.campaigns.compliance.reading import SUITES, suite_from_text, suite_named
from vsgdesign.campaigns.compliance.rows import (
    FAIL,
    IMPOSSIBLE,
    INFORMATIONAL,
    NOT_APPLICABLE,
    PASS,
    limits_of,
    summary_of,
)
from vsgdesign.campaigns.compliance.run import run_test
from vsgdesign.campaigns.compliance.suite import Criterion, Suite, SuiteTest
from vsgdesign.equations.frames import SPACE_VECTOR_POWER
from vsgdesign.report.explore.session import start_of
from vsgdesign.report.explore.state import state_of
from vsgdesign.study.given_files import parse_toml
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import Fault, Load, Sag, SynchroCheck
from vsgdesign.study.parameters.loading import study_from_text
from vsgdesign.verbs.pipeline.live_part import explorer_link

JUMP = Event.of_pu(0.0, phase_deg=30.0)
SURVIVED = Criterion(measure="survived", at_least=1.0)


@pytest.mark.parametrize("case", ["hoang2025_5kva", "utility_1mva_60hz"])
def test_a_study_says_a_test_in_si(case: str) -> None:
    one = subject(case=case)
    events = Event.of_pu(0.01, df_hz=-0.5, over_s=0.5), Event.of_pu(1.0, scr=2.0, x_over_r=10.0, P_pu=0.2)
    test = suite_test(*events, scr=4.0, x_over_r=3.0, P_pu=0.6, Q_pu=-0.1, V_g_pu=0.97, df_hz=0.2)
    study, text = case_of(one, test), case_text(one, test, name="case", folder=".")
    c = study.converter
    assert math.hypot(study.grid.R_g, c.omega_n * study.grid.L_g) == pytest.approx(c.Z_base / 4.0, rel=1e-12)
    assert c.omega_n * study.grid.L_g / study.grid.R_g == pytest.approx(3.0)
    assert (study.simulation.P_ref, study.simulation.Q_ref) == (0.6 * c.S_rated, -0.1 * c.S_rated)
    first, ramp, step = study.events
    assert first.t_s == 0.0
    assert first.V_g_rms == pytest.approx(0.97 * c.V_rated_rms)
    assert first.omega_g == pytest.approx(c.omega_n + 0.4 * math.pi)
    assert ramp.omega_g == pytest.approx(c.omega_n - math.pi)
    assert (ramp.over, ramp.t_s) == (0.5, pytest.approx(one.lead_s + 0.01))
    assert step.grid is not None
    assert math.hypot(step.grid.R_g, c.omega_n * step.grid.L_g) == pytest.approx(c.Z_base / 2.0)
    assert step.P_ref == 0.2 * c.S_rated
    # A trace has a whole number of rows of whole samples before and in the test.
    rows = study.simulation.duration / (one.row_samples * c.T_s)
    assert rows == pytest.approx(round(rows))
    again = study_from_text(text)
    assert again.events == study.events
    assert again.grid == study.grid
    assert again.simulation == study.simulation


def test_the_schedule_is_told_late() -> None:
    study = case_of(subject(), suite_test(JUMP, silent_s=0.7))
    assert study.controllers[0].knowledge is not None
    assert study.controllers[0].knowledge.silent_s == 0.7
    forever = case_of(subject(), suite_test(JUMP, silent_s=math.inf))
    assert forever.controllers[0].knowledge is not None
    assert forever.controllers[0].knowledge.silent_s > forever.simulation.duration
    fixed = case_of(subject("fixed"), suite_test(JUMP))
    assert fixed.controllers[0].knowledge is None


def test_a_trace_is_per_unit_and_keeps_every_peak() -> None:
    one = subject()
    run = run_test(one, suite_test(JUMP, scr=20.0, x_over_r=10.0))
    trace, simulation, c = run.trace, run.simulation, run.study.converter
    assert trace is not None
    assert simulation is not None
    assert np.allclose(np.diff(trace.t_s), 5e-4)
    begin = round(one.lead_s / c.T_s)
    i_s = np.hypot(simulation.each("i_s_alpha"), simulation.each("i_s_beta")) / c.I_rated_pk
    assert len(i_s) == run.study.simulation.duration / c.T_s
    assert trace.i_s_pu[trace.t_s > 0.0].max() == pytest.approx(i_s[begin + 1 :].max(), abs=1e-12)
    assert trace.i_phase_pu.max() <= trace.i_s_pu.max() + 1e-12
    # At rest the dc link gives what the capacitor sends on, and the losses of R_1.
    lost = SPACE_VECTOR_POWER * run.study.filter.R_1 * (trace.i_s_pu[0] * c.I_rated_pk) ** 2 / c.S_rated
    assert trace.P_dc_pu[20] == pytest.approx(trace.P_pu[20] + lost, abs=1e-5)
    at = int(np.searchsorted(trace.t_s, -1e-9))
    assert trace.delta_rad[at] - trace.delta_rad[at - 1] == pytest.approx(-math.pi / 6.0, abs=1e-3)


def test_fewer_rows_keep_peaks_and_energy() -> None:
    run = run_test(subject(), suite_test(JUMP, scr=20.0, x_over_r=10.0))
    assert run.trace is not None
    whole = run.trace
    few = thinned(Evidence(trace=whole), [0.0]).trace
    assert len(few.t_s) < 0.5 * len(whole.t_s)
    near = (whole.t_s > -0.0199) & (whole.t_s < 0.1499)
    assert np.isin(whole.t_s[near], few.t_s).all()
    assert (few.i_s_pu.max(), few.t_s[0], few.t_s[-1]) == (whole.i_s_pu.max(), whole.t_s[0], whole.t_s[-1])
    energy = float(np.sum(whole.P_dc_pu[1:])) * 5e-4
    assert float(np.sum(few.P_dc_pu[1:] * np.diff(few.t_s))) == pytest.approx(energy, rel=1e-12)


def test_each_verdict_has_its_reason() -> None:
    def row(one: SuiteTest, name: str = "damped"):
        suite = Suite(name="made", title="Made", source=one.source, tests=(one,))
        return judged_test(subject(name), suite, one)

    good = row(suite_test(JUMP, criteria=(SURVIVED,)))
    assert (good.row.verdict, good.row.status, good.row.why) == (PASS, "survived", "")
    assert good.evidence is not None
    assert row(suite_test(JUMP, criteria=(Criterion(measure="peak_pu"),))).row.verdict == INFORMATIONAL
    late = row(suite_test(JUMP, criteria=(SURVIVED, Criterion(measure="recovery_s", at_most=0.01)))).row
    assert late.verdict == FAIL
    assert late.why.startswith("recovery time 0.")
    assert [check.verdict for check in late.checks] == [PASS, FAIL]
    needs = row(suite_test(JUMP, needs=("60 Hz",)))
    assert (needs.row.verdict, needs.evidence) == (NOT_APPLICABLE, None)
    assert row(suite_test(JUMP, P_pu=1.6)).row.verdict == IMPOSSIBLE
    unknown = row(suite_test(JUMP, criteria=(Criterion(measure="above_limit_s", at_most=0.1),)), "fixed").row
    assert (unknown.verdict, unknown.checks[0].value) == (FAIL, None)
    assert "no current limit" in unknown.why


def test_a_circuit_that_cannot_be_followed_does_not_apply() -> None:
    fault = Fault(R=1e-9)
    test = suite_test(Event.of_pu(0.0, fault=fault), Event.of_pu(0.1, fault="cleared"), criteria=(SURVIVED,))
    row = judged_test(subject(), Suite(name="made", title="Made", source=test.source, tests=(test,)), test).row
    assert row.verdict == NOT_APPLICABLE
    assert row.why.startswith("it cannot be simulated with this converter: three-phase fault at the PCC")


def test_a_start_that_the_grid_cannot_carry_fails_without_a_limit() -> None:
    test = suite_test(JUMP, scr=1.2, x_over_r=20.0, P_pu=1.9, criteria=(SURVIVED,))
    suite = Suite(name="made", title="Made", source=test.source, tests=(test,))
    row = judged_test(subject("fixed"), suite, test).row
    assert (row.verdict, row.status, row.csv) == (FAIL, "no rest", None)
    assert row.why.startswith("before the test:")
    assert row.checks[0].value is None


def test_an_island_is_judged_by_its_own_rest() -> None:
    opens = Event.of_pu(0.0, breaker="open")
    load = Load(R_parallel=1.0 / 0.6)
    good = run_test(subject(), suite_test(opens, load=load))
    assert good.survival.status == "survived"
    assert good.trace is not None
    # The droop of 5 %: 0.1 pu more than the reference costs 0.25 Hz.
    assert good.trace.f_hz[-1] == pytest.approx(50.0 - 0.05 * 50.0 * (good.trace.P_pu[-1] - 0.5), abs=0.02)


def test_an_island_of_a_wrong_frequency_is_lost() -> None:
    soft = study_from_text(TEXT.replace("CASE", "hoang2025_5kva").replace('P_droop = "5 %"', 'P_droop = "10 %"'))
    one = Subject(study=soft, spec=soft.controllers[0])
    test = suite_test(Event.of_pu(0.0, breaker="open"), load=Load(R_parallel=20.0), P_pu=0.9)
    found = run_test(one, test).survival
    assert found.status == "not at rest"
    assert found.reason is not None
    assert found.reason.endswith("Hz, outside of 47 to 53 Hz")


def test_a_synchro_check_waits_for_both_sides() -> None:
    check = SynchroCheck(angle=math.radians(10.0), V_pu=0.1, omega=2.0 * math.pi * 2.0)
    opens = Event.of_pu(0.0, breaker="open")
    closes = Event.of_pu(0.5, breaker="closed", synchro_check=check)
    load = Load(R_parallel=1.0 / 0.8)
    run = run_test(subject(), suite_test(opens, closes, load=load))
    assert run.survival.status == "survived"
    assert run.test.events[1].t_s > 0.5
    never = Event.of_pu(0.5, breaker="closed", synchro_check=replace(check, omega=2.0 * math.pi * 0.3))
    lost = run_test(subject(), suite_test(opens, never, load=load)).survival
    assert lost.status == "not at rest"
    assert "so the breaker stays open" in str(lost.reason)


def test_a_rest_at_the_limit_is_held_and_said() -> None:
    run = run_test(subject(), suite_test(Event.of_pu(0.0, V_g_pu=0.6), scr=10.0, x_over_r=10.0))
    assert run.survival.status == "survived"
    assert run.survival.reason is not None
    assert run.survival.reason.startswith("it comes to a rest of its own (the rest needs")


@pytest.mark.parametrize(
    ("events", "kind"),
    [
        ((JUMP,), "phase"),
        ((Event.of_pu(0.0, V_g_pu=0.2), Event.of_pu(0.15, V_g_pu=1.0)), "sag"),
        ((Event.of_pu(0.0, sag=Sag(kind="A", V_pu=0.2)), Event.of_pu(0.15, V_g_pu=1.0)), "sag"),
        ((Event.of_pu(0.0, df_hz=-1.0, over_s=0.5),), "ramp"),
        ((Event.of_pu(0.0, scr=2.0, x_over_r=3.0),), "grid"),
        ((Event.of_pu(0.0, P_pu=0.7),), "step"),
        ((Event.of_pu(0.0, V_ref_pu=1.03),), "voltage_set_point"),
    ],
)
def test_a_link_shows_the_test_in_the_explorer(events: tuple[Event, ...], kind: str) -> None:
    one = subject()
    link = explorer_link(one.study, {}, suite_test(*events, scr=8.0, x_over_r=3.0), "damped")
    assert link is not None
    state = state_of(start_of(link, one.study), one.study)
    assert (state.event.kind, state.controllers, state.silent_s) == (kind, ("damped",), 0.2)
    place = one.study.grid.place(one.study.converter, one.study.scr_basis)
    assert json.loads(link)["x_over_r"] == 3.0
    assert state.scr != place.scr


@pytest.mark.parametrize(
    "events",
    [
        (Event.of_pu(0.0, breaker="open"),),
        (JUMP, Event.of_pu(1.0, P_pu=0.2)),
        (Event.of_pu(0.0, V_g_pu=0.0), Event.of_pu(0.15, V_g_pu=1.0)),
        (Event.of_pu(0.0, sag=Sag(kind="C", V_pu=0.5)), Event.of_pu(0.15, V_g_pu=1.0)),
    ],
)
def test_of_an_event_that_the_explorer_does_not_have_the_grid_is_shown(events: tuple[Event, ...]) -> None:
    one = subject()
    link = explorer_link(one.study, {}, suite_test(*events, x_over_r=3.0), "damped")
    assert link is not None
    assert "event" not in json.loads(link)
    assert json.loads(link)["x_over_r"] == 3.0


def test_a_load_or_a_missing_table_has_no_link() -> None:
    one = subject()
    assert explorer_link(one.study, {}, suite_test(JUMP, load=Load(R_parallel=2.0)), "damped") is None
    tabled = replace(one.study, controllers=(replace(one.spec, schedule="table"),))
    assert explorer_link(tabled, {}, suite_test(JUMP), "damped") is None


def test_the_network_is_said_in_words() -> None:
    test = suite_test(JUMP, Q_pu=-0.1, df_hz=0.2, load=Load(R_parallel=2.0, L_parallel=10.0))
    assert network_in_words(test) == "SCR 5, X/R 5, P 0.5 pu, Q -0.1 pu, +0.2 Hz, load 0.5 pu, 0.1 pu reactive"


def row(
    controller: str, verdict: str, status: str, *checks: tuple[str, str, str], csv: str | None = "x"
) -> dict[str, Any]:
    """A row of results.json with (measure, verdict, whose limit) of its checks."""
    names = "label", "at_least", "at_most", "envelope", "unit", "ours"
    found = [{"measure": one, "verdict": v, "limit_of": of, **dict.fromkeys(names)} for one, v, of in checks]
    said = {"suite": "a", "controller": controller, "verdict": verdict, "status": status, "checks": found, "csv": csv}
    return said | {"settling_time_s": 1.0, "deadline_s": 2.2}


def test_the_summary_counts_each_verdict_and_whose_limits_are_kept() -> None:
    lived, quick = ("survived", PASS, "ours"), ("response_i_ms", PASS, "source")
    rows = [
        row("x", PASS, "survived", lived),
        row("x", PASS, "survived", lived, quick),
        row("x", PASS, "survived", ("survived", PASS, "user")),
        row("x", NOT_APPLICABLE, "", csv=None),
        row("x", FAIL, "latched", ("survived", FAIL, "ours"), quick),
        row("y", FAIL, "no rest", ("survived", FAIL, "ours"), csv=None),
    ]
    rows[1] |= {"peak_pu": 2.1}
    rows[4] |= {"peak_pu": 9.0}
    x, y = summary_of(rows)
    assert (x["beyond_hardware"], y["beyond_hardware"]) == (1, 0)
    assert (x["pass"], x["pass_source"], x["pass_ours"], x["pass_user"]) == (3, 1, 1, 1)
    assert (x["fail"], x["not_applicable"], x["not_begun"], x["survived"], x["judged"]) == (1, 1, 0, 3, 4)
    assert (y["controller"], y["fail"], y["not_begun"], y["judged"], y["deadline_s"]) == ("y", 1, 1, 0, 2.2)
    told = {(one["measure"], one["limit_of"]): one for one in limits_of(rows)}
    assert {key: (one["judged"], one["failed"], one["lost"], one["lost_kept"]) for key, one in told.items()} == {
        ("survived", "ours"): (3, 1, 1, 0),
        ("survived", "user"): (1, 0, 0, 0),
        ("response_i_ms", "source"): (2, 0, 1, 1),
    }


def test_all_limits_of_the_fnn_suite_are_ours() -> None:
    """Its 28 tests pass against limits of this project alone."""
    suite = suite_named("fnn")
    assert {one.limit_of(test.source) for test in suite.tests for one in test.criteria} == {"", "ours"}
    judged = judged_test(subject(), suite, suite.tests[0]).row
    assert [check.limit_of for check in judged.checks] == ["ours", "", ""]
    mine = suite_from_text(
        'criteria = [{ measure = "survived", at_least = 1 }]\n[[tests]]\nname = "a"\nscr = 3\n' + EVENT
    )
    assert mine.tests[0].criteria[0].limit_of(mine.tests[0].source) == "user"


EVENT = 'x_over_r = 5\nevents = [{ phase_jump = "10 deg" }]'


@pytest.mark.parametrize("name", SUITES)
def test_a_packaged_suite_bounds_the_settling_time(name: str) -> None:
    """A controller that is designed for 60 s had 120.2 s to come to rest, and survived whatever it did in them."""
    assert {test.T_at_most for test in suite_named(name).tests} == {1.4}


def test_a_slow_controller_has_the_deadline_of_the_suite() -> None:
    slow = study_from_text(TEXT.replace("CASE", "hoang2025_5kva").replace('"0.3 s"', '"60 s"'))
    one = Subject(study=slow, spec=slow.controllers[0])
    test = suite_test(JUMP, criteria=(SURVIVED,), T_at_most=1.4)
    judged = judged_test(one, suite_named("fnn"), test).row
    assert (judged.settling_time_s, judged.deadline_s) == (1.4, pytest.approx(3.0))
    assert (judged.verdict, judged.status) == (FAIL, "not at rest")
    asked = judged_test(subject(), suite_named("fnn"), test).row
    assert (asked.settling_time_s, asked.deadline_s) == (0.3, pytest.approx(0.8))
    # The study file of the row judges it alike.
    document = parse_toml(case_text(one, test, name="slow", folder="."), "case")
    assert document["simulation"]["survival_settling_time"] == 1.4
    assert case_of(one, test).simulation.survival_settling_time == 1.4
