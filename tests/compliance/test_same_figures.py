"""Figures of the bench beside those that other verbs call by a similar name: how far they may differ, and why."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.compliance.bench_studies import subject, suite_test
from vsgdesign.campaigns.compliance.case import Subject, case_of
from vsgdesign.campaigns.compliance.measures import MEASURES, MeasureInput, Ratings
from vsgdesign.campaigns.compliance.run import TestRun, run_test
from vsgdesign.equations.frames import SPACE_VECTOR_POWER
from vsgdesign.simulation.every_sample import signals_at_pcc
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.survival.running import record_of
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.loading import study_from_text

CASES = ["hoang2025_5kva", "utility_1mva_60hz"]  # 50 Hz with an LC filter, 60 Hz with an LCL filter


def stiff() -> Subject:
    """Fixed gains whose droop asks for four times the rating at 50.5 Hz."""
    study = study_from_text(
        'base = "case:lab_12kva_lcl"\n'
        'converter = { current_limit_pu = 1.2, current_limiter = "projection" }\n'
        'simulation = { duration = "1 s", P_ref = 0, Q_ref = 0 }\n'
        'controllers = [{ name = "fixed", kind = "fixed", design_grid = { scr = 3, x_over_r = 4 } }]\n'
    )
    return Subject(study=study, spec=study.controllers[0])


@pytest.fixture(scope="module", params=CASES)
def run(request: pytest.FixtureRequest) -> TestRun:
    sag = Event.of_pu(0.0, V_g_pu=0.6), Event.of_pu(0.15, V_g_pu=1.0)
    return run_test(subject(case=request.param), suite_test(*sag, scr=3.0, x_over_r=5.0, P_pu=0.6))


def measured(run: TestRun, name: str) -> float:
    assert run.trace is not None
    given = MeasureInput(
        test=run.test, trace=run.trace, ratings=Ratings.of(run.study, run.spec), survival=run.survival, gains=run.gains
    )
    found = MEASURES[name].of(given).value
    assert found is not None
    return found


def test_a_phase_current_is_within_the_length_of_the_vector(run: TestRun) -> None:
    """`survive`, `verify` and the explorer give the length. The largest of three phases is at least √3/2 of it."""
    longest, first = run.survival.peak_pu, run.survival.first_peak_pu
    assert longest is not None
    assert first is not None
    assert math.sqrt(3.0) / 2.0 * max(longest, first) <= measured(run, "peak_pu") <= max(longest, first) + 1e-12
    assert measured(run, "peak_after_5ms_pu") <= longest + 1e-12


def test_the_recovery_time_is_that_of_the_judge(run: TestRun) -> None:
    assert measured(run, "recovery_s") == run.survival.recovery_s


def test_the_time_in_the_limiter_is_that_of_the_judge(run: TestRun) -> None:
    assert run.survival.limited_s is not None
    assert run.survival.limited_s > 0.01
    assert measured(run, "limited_s") == pytest.approx(run.survival.limited_s, abs=1e-9)


@pytest.mark.parametrize(
    ("one", "P_pu", "event", "status"),
    [
        (subject(), 0.5, Event.of_pu(0.0, phase_deg=30.0), "survived"),
        (subject(), 1.1, Event.of_pu(0.0, phase_deg=10.0), "survived"),  # begins near its limit
        (subject(), 0.5, Event.of_pu(0.0, V_g_pu=0.6), "survived"),  # comes to a rest of its own at its limit
        (stiff(), 0.0, Event.of_pu(0.0, df_hz=0.5, over_s=0.5), "latched"),
    ],
)
def test_simulate_says_of_a_case_what_the_row_says(one: Subject, P_pu: float, event: Event, status: str) -> None:
    """The case of a row that began or ended near its limit was not judged by `simulate`."""
    test = suite_test(event, P_pu=P_pu, scr=10.0 if status == "survived" else 3.0)
    row = run_test(one, test).survival
    again = run_scenario(case_of(one, test)).controllers[0].survival
    assert row.status == status
    assert again == row


def test_P_is_at_the_capacitor_and_P_pcc_behind_the_second_inductance(run: TestRun) -> None:
    """At rest P_pcc is smaller by the losses of R_2, which an LC filter does not have."""
    assert run.trace is not None
    assert run.simulation is not None
    c, f = run.study.converter, run.study.filter
    at, row = (
        int(np.argmin(np.abs(t_s - run.trace.t_s[-1] - subject().lead_s)))
        for t_s in (run.simulation.each_s, run.simulation.t_s)
    )
    assert record_of(run.study, run.simulation).P[at] / c.S_rated == run.trace.P_pu[-1]
    i_g = np.hypot(run.trace.i_g_alpha_pu[-1], run.trace.i_g_beta_pu[-1]) * c.I_rated_pk
    P_pcc = signals_at_pcc(run.study, run.simulation).P_pcc[row]
    lost = SPACE_VECTOR_POWER * f.R_2 * i_g**2 / c.S_rated
    assert P_pcc / c.S_rated == pytest.approx(run.trace.P_pu[-1] - lost, abs=1e-5)
    assert lost > 1e-4 or f.R_2 == 0.0
