"""A small study with a current limit, and tests of a suite, for the tests of the bench."""

from __future__ import annotations

from typing import Any

from tests.compliance.made_runs import SOURCE
from vsgdesign.campaigns.compliance.case import Subject
from vsgdesign.campaigns.compliance.matrix import Judged, judged_tests
from vsgdesign.campaigns.compliance.suite import Suite, SuiteTest
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.loading import study_from_text
from vsgdesign.study.parameters.study import Study

TEXT = """
base = "case:CASE"
[study]
name = "small"
[converter]
current_limit_pu = 1.2
current_limiter = "projection"
[power_loops]
structure = "angle_damped"
settling_time = "0.3 s"
tau_P = "5 ms"
tau_Q = "5 ms"
P_droop = "5 %"
Q_droop = "5 %"
[simulation]
duration = "1 s"
P_ref = 0
Q_ref = 0
[[controllers]]
name = "damped"
kind = "scheduled"
[[controllers]]
name = "fixed"
kind = "fixed"
current_limiter = "none"
"""


def small_study(case: str = "hoang2025_5kva") -> Study:
    """The study on one of the packaged cases."""
    return study_from_text(TEXT.replace("CASE", case))


def subject(name: str = "damped", case: str = "hoang2025_5kva") -> Subject:
    """One of its controllers."""
    study = small_study(case)
    return Subject(study=study, spec=next(spec for spec in study.controllers if spec.name == name))


def suite_test(*events: Event, **given: Any) -> SuiteTest:
    """A test with these events."""
    usual = {"id": "made", "group": "made", "title": "made", "source": SOURCE, "scr": 5.0, "x_over_r": 5.0}
    return SuiteTest(events=events, **(usual | given))


def judged_test(subject: Subject, suite: Suite, test: SuiteTest) -> Judged:
    """One test of one controller: run and judged."""
    ((_, judged),) = judged_tests(subject, [(suite, test)])
    return judged
