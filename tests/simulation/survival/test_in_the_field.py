"""A controller that estimates its grid, in a grid that wanders and with sensors that err, through survival cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.simulation import build_timeline
from vsgdesign.simulation.survival import CaseRun, GridState, Subject, SurvivalCase, field_cases, trace_case
from vsgdesign.simulation.survival.cases import LEAD_S, LEARNING_S, at_asked_powers, late_grid
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.survival import subjects_of, survival_cases

TEXT = """
base = "case:hoang2025_5kva"
converter = { current_limit_pu = 1.2, current_limiter = "projection" }
background = { level = "dirty" }
sensors = { level = "dirty" }
simulation = { duration = "1 s", P_ref = "2 kW", Q_ref = "0 var" }
[[controllers]]
name = "field"
kind = "scheduled"
estimate = "field"
structure = "angle_damped"
P_droop = "5 %"
Q_droop = "5 %"
"""
START = GridState(scr=3.0, x_over_r=2.0, P_pu=0.4, Q_pu=0.0)


def case(**values: float) -> SurvivalCase:
    return SurvivalCase(group="one", start=START, changes=(Event.of_pu(0.0, **values),), cleared_s=0.0)


def subjects(study: Study) -> dict[str, Subject]:
    spec = study.controllers[0]
    return {
        name: Subject(study=study, spec=replace(spec, estimate=name), limit_pu=1.2, bridge="pwm", room_pu=0.95)
        for name in ("field", "truth")
    }


def test_it_survives_as_with_the_truth_in_the_same_grid() -> None:
    """Nothing is lent: it learns before the event, and finds the new grid after it."""
    study = study_from_text(TEXT)
    (one,) = field_cases((case(scr=8.0, x_over_r=2.0),), seed=5, lead_s=0.6)
    runs = {name: trace_case(subject, one) for name, subject in subjects(study).items()}
    field, truth = runs["field"], runs["truth"]
    assert isinstance(field, CaseRun)
    assert isinstance(truth, CaseRun)
    assert field.verdict.status == truth.verdict.status == "survived", (field.verdict, truth.verdict)
    assert field.study.background == truth.study.background != study.background
    assert field.simulation.timeline.sources == truth.simulation.timeline.sources
    log = field.estimates
    assert log is not None
    assert log.cycles is not None
    assert truth.estimates is None
    omega = study.converter.omega_n
    size = np.hypot(log.R_g, omega * log.L_g)
    error = np.hypot(log.R_g_hat - log.R_g, omega * (log.L_g_hat - log.L_g)) / size
    before, after = (log.t_s > 0.4) & (log.t_s < 0.6), log.t_s > 1.1
    assert error[before].max() < 0.1
    assert error[after].max() < 0.1
    assert log.cycles.event[(log.t_s > 0.6) & (log.t_s < 0.7)].any()
    # It begins in the middle of the grids, not on the true one.
    first = field.simulation.gain_changes[0].grid
    assert first is not None
    assert abs(np.hypot(first.R_g, omega * first.L_g) / size[0] - 1.0) > 0.2


def test_it_begins_at_the_powers_that_are_asked_for() -> None:
    """Half a hertz beside the nominal frequency would move P by 0.2 pu through a droop of 5 %."""
    study = study_from_text(TEXT)
    off = replace(study, background=replace(study.background, frequency_offset=0.5))  # type: ignore[type-var]
    spec = study.controllers[0]
    asked = at_asked_powers(off, spec, subjects(study)["field"].ready)
    moved = (asked.simulation.P_ref - off.simulation.P_ref) / study.converter.S_rated
    assert moved == pytest.approx(0.5 / (0.05 * 50.0), rel=1e-6)


def test_the_rest_is_that_of_what_the_sensors_say() -> None:
    """Voltage sensors 1 % too large: the grid looks 1 % stronger in voltage and 1 % weaker in impedance."""
    study = study_from_text(TEXT)
    gains = (0.01, 0.01, 0.01, *[0.0] * 6)
    sensors = replace(study.sensors, gain_errors=gains)  # type: ignore[type-var]
    of = replace(study, sensors=sensors, background=None)
    grid, source = late_grid(of, build_timeline(of), 0.5)
    assert grid.R_g == pytest.approx(1.01 * study.grid.R_g, rel=1e-12)
    assert source.V_g_rms == pytest.approx(1.01 * of.grid_source.V_g_rms, rel=1e-12)


def test_a_rest_without_room_is_left_out() -> None:
    study = study_from_text(TEXT)
    heavy = replace(case(phase_deg=10.0), start=replace(START, P_pu=1.0), draw=3)
    found = trace_case(subjects(study)["field"], heavy)
    assert not isinstance(found, CaseRun)
    assert found.reason is not None
    assert "room" in found.reason


def test_the_verb_gives_every_case_time_to_learn() -> None:
    study = study_from_text(TEXT + '[survival]\nrandom = 3\n[[controllers]]\nname = "truth"\nkind = "scheduled"\n')
    cases = survival_cases(study)
    assert {case.lead_s for case in cases} == {LEARNING_S}
    assert len({case.draw for case in cases}) == len(cases)
    assert cases == survival_cases(study)
    plain = replace(study, controllers=study.controllers[1:])
    assert {case.lead_s for case in survival_cases(plain)} == {LEAD_S}
    rooms = [subject.room_pu for subject in subjects_of(study, NOTHING).values()]
    assert rooms == pytest.approx([0.95] * len(rooms))
