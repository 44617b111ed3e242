"""A schedule that is never told again has the same deadline in a suite, in a study and in a set of survival."""

from __future__ import annotations

import math

import pytest

from tests.compliance.bench_studies import subject, suite_test
from vsgdesign.campaigns.compliance.case import case_of
from vsgdesign.campaigns.compliance.run import run_test
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.survival import GridKnowledge, GridState, SurvivalCase
from vsgdesign.simulation.survival.cases import settling_times_asked
from vsgdesign.simulation.survival.running import Subject, run_case
from vsgdesign.study.parameters.event import Event

WEAKER = suite_test(Event.of_pu(0.0, scr=1.5, x_over_r=5.0), scr=10.0, P_pu=0.5, silent_s=math.inf)
"""T is 0.3 s: at rest after 0.99 s, between the deadlines of 0.8 s and 1.1 s."""


def test_every_way_to_run_it_allows_3_T() -> None:
    one = subject()
    row = run_test(one, WEAKER).survival
    assert row.status == "survived"
    assert row.recovery_s is not None
    assert 0.8 < row.recovery_s < 1.1
    study = run_scenario(case_of(one, WEAKER)).controllers[0].survival
    assert study == row
    case = SurvivalCase(
        group="jump",
        start=GridState(scr=10.0, x_over_r=5.0, P_pu=0.5, Q_pu=0.0),
        changes=(Event.of_pu(0.0, scr=1.5, x_over_r=5.0),),
        cleared_s=0.0,
        knowledge=GridKnowledge(silent_s=math.inf),
    )
    of_set = run_case(Subject(study=one.study, spec=one.spec, limit_pu=1.2), case).verdict
    assert of_set.status == row.status
    assert of_set.recovery_s == pytest.approx(row.recovery_s, abs=2e-3)  # the rows of a trace are 0.5 ms apart


def test_a_silence_that_ends_before_the_deadline_is_not_for_ever() -> None:
    assert settling_times_asked([0.0, 1.0999, 1.1001, math.inf], 0.3).tolist() == [2.0, 2.0, 3.0, 3.0]
