"""A breaker behind a synchro-check in a suite: it closes at the angle that is asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vsgdesign.campaigns.compliance import case
from vsgdesign.campaigns.compliance.case import Subject
from vsgdesign.campaigns.compliance.reading import suite_from_text
from vsgdesign.campaigns.compliance.run import run_test
from vsgdesign.errors import StudyError
from vsgdesign.study.parameters.grid import Fault
from vsgdesign.study.parameters.loading import study_from_text

STUDY = study_from_text(
    """
base = "case:lab_12kva_lcl"
converter = { current_limit_pu = 1.2, current_limiter = "projection" }
grid = { scr = 3, x_over_r = 4 }
simulation = { duration = "1 s", P_ref = 0, Q_ref = 0 }
controllers = [{ name = "damped", kind = "scheduled", structure = "angle_damped" }]
"""
)
SUITE = """
[[tests]]
name = "re-connection"
scr = 5
x_over_r = 5
load = { P_pu = LOAD }
events = [
    { breaker = "open" },
    { time = "0.2 s", breaker = "closed", synchro_check = { V_pu = 0.2, df = "2 Hz", around = "60 deg" } },
]
"""


def test_the_breaker_closes_at_the_angle_that_is_asked_for() -> None:
    test = suite_from_text(SUITE.replace("LOAD", "0.2")).tests[0]
    run = run_test(Subject(study=STUDY, spec=STUDY.controllers[0]), test)
    last = run.test.events[-1]
    assert last.switched.breaker == "closed"
    assert last.synchro_check is None
    assert 0.2 < last.t_s < 5.0
    assert run.trace is not None
    angle = float(np.interp(last.t_s, run.trace.t_s, run.trace.delta_rad))
    # The relay compares the capacitor's voltage, which differs from the frame by less than 2° at 0.2 pu.
    assert abs(math.remainder(angle - math.radians(60.0), 2.0 * math.pi)) < math.radians(12.0)
    assert run.survival.judged
    assert run.trace.t_s[-1] > last.t_s + 2.0


def test_an_island_that_never_comes_near_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 0.5 pu of load and reference the island keeps the grid's frequency, so the angle stays where it was."""
    monkeypatch.setattr(case, "WAIT_S", 0.5)
    test = suite_from_text(SUITE.replace("LOAD", "0.5")).tests[0]
    with pytest.raises(StudyError, match=r"synchro_check: both sides are never near enough within 0\.5 s"):
        run_test(Subject(study=STUDY, spec=STUDY.controllers[0]), test)


FAULT = """
[[tests]]
name = "line out"
scr = 20
x_over_r = 10
events = [
    { fault = { kind = "three_phase", at = 0.5 }, lasts = "120 ms" },
    { time = "120 ms", scr = 3 },
]
"""


def test_a_fault_ends_at_the_zeros_of_its_currents() -> None:
    """The line is out when the last phase is interrupted, and this is when the measures begin to count."""
    test = suite_from_text(FAULT).tests[0]
    subject = Subject(study=STUDY, spec=STUDY.controllers[0])
    run = run_test(subject, test)
    assert run.simulation is not None
    timeline = run.simulation.timeline
    end_s = timeline.grids[-1][0]
    assert timeline.network_at(end_s).fault is None
    assert timeline.network_at(end_s - 1e-6).fault is not None
    assert 0.12 < end_s - subject.lead_s < 0.14
    assert run.test.events[0].t_s == 0.0
    left = run.test.events[1].switched.fault
    assert isinstance(left, Fault)
    assert left.kind == "phase_to_phase"
    assert {event.t_s for event in run.test.events[2:]} == {end_s - subject.lead_s}
    assert run.trace is not None
    after = run.trace.t_s > 0.12
    assert float(run.trace.i_s_pu[after].max()) < 1.3
    assert run.survival.survived
