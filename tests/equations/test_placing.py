"""Placed poles against step responses that are integrated, and the rule in a study against its numbers by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lti, step

from vsgdesign.equations.placing import (
    DAMPING_RATIO,
    OVERSHOOT_PCT,
    PLACED,
    damping_of,
    overshoot_of,
    placed_poles,
    placing_time,
    settling_factor,
    settling_margin,
)
from vsgdesign.simulation.scenario.judging import promises_of
from vsgdesign.study.parameters import study_from_text


@pytest.mark.parametrize("damping", [0.05, 0.3, 0.6, 0.77, 0.79, 0.92, 1.0, 1.3, 8.0])
def test_the_settling_factor_is_when_a_step_stays_within_its_band(damping: float) -> None:
    """The last sample outside, by the matrix exponential of one step of time: no closed form of the response."""
    h = 5e-3
    forward = expm(h * np.array([[0.0, 1.0], [-1.0, -2.0 * damping]]))
    state, last = np.array([-1.0, 0.0]), 0  # the error and its rate
    for k in range(1, int(100.0 / h)):
        state = forward @ state
        if abs(state[0]) > 0.02:
            last = k
    assert settling_factor(damping) == pytest.approx((last + 0.5) * h, abs=0.6 * h)


def test_both_placed_responses_reach_98_percent_at_the_time_that_is_asked_for() -> None:
    poles = placed_poles(1.0)
    times = np.array([0.0, 1.0])
    of_angle = step(lti([poles.k_1], [1.0, poles.d_1, poles.k_1]), T=times)[1][-1]
    of_voltage = step(lti([poles.k_2], [1.0, poles.k_2]), T=times)[1][-1]
    assert of_angle == pytest.approx(0.98, abs=1e-9)
    assert of_voltage == pytest.approx(0.98, abs=1e-9)
    assert tuple(PLACED) == pytest.approx((24.21, 9.053, 3.912), rel=1e-4)
    assert poles.d_1 / (2.0 * math.sqrt(poles.k_1)) == pytest.approx(DAMPING_RATIO)


def test_the_damping_for_an_overshoot_is_the_inverse_of_the_overshoot() -> None:
    for wanted in (0.01, OVERSHOOT_PCT, 5.0, 60.0):
        assert overshoot_of(damping_of(wanted)) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize(
    ("error", "margin"), [(0.0, 0.03), (0.03, 0.03), (0.05, 0.03), (0.0501, 0.037535), (0.1, 0.055), (0.2, 0.09)]
)
def test_the_margin_grows_with_the_error_of_the_estimate(error: float, margin: float) -> None:
    assert settling_margin(error) == pytest.approx(margin, rel=1e-12)


def test_a_mean_longer_than_the_time_leaves_half_of_it() -> None:
    assert placing_time(0.03, 0.04, 0.03) == pytest.approx(0.97 * 0.015)
    assert placing_time(1.0, 0.02, 0.03) == pytest.approx(0.9603)


STUDY = """
base = "case:lab_12kva_lcl"
grid = { scr = 3, x_over_r = 4 }
simulation = { duration = "3 s", P_ref = "4 kW", Q_ref = "0 var" }
power_loops = { structure = "angle_damped" }
specification = { scr = [2, 10], x_over_r = [1, 10] }
controllers = [{ name = "one", kind = "scheduled" }]
"""
KIND = 'kind = "scheduled"'


@pytest.mark.parametrize(
    ("old", "new", "T_d"),
    [
        ("", "", 0.99 * 0.97),
        ("scr = [2, 10],", 'error = "10 %", scr = [2, 10],', 0.99 * 0.945),
        ("scr = [2, 10],", 'error_R = "3 %", error_X = "8 %", scr = [2, 10],', 0.99 * 0.952),
        ("scr = [2, 10],", 'error = "5 %", error_Z = "20 %", scr = [2, 10],', 0.99 * 0.91),
        ('kind = "scheduled" }', 'kind = "scheduled", knowledge = { error_X = "20 %" } }', 0.99 * 0.97),
        ('"one", kind = "scheduled" }', '"one", kind = "scheduled", settling_time = "0.5 s" }', 0.49 * 0.97),
        (
            'kind = "scheduled" }',
            'kind = "scheduled" }, { name = "two", kind = "scheduled", estimate = "field" }',
            0.9506,
        ),
        ('structure = "angle_damped"', 'structure = "decoupled"', 0.99 * 0.97),
    ],
)
def test_a_study_places_the_poles_that_it_does_not_give(old: str, new: str, T_d: float) -> None:
    """50 Hz: half a mean is 10 ms, and 20 ms beside a field estimator."""
    target = study_from_text(STUDY.replace(old, new)).controllers[0].target
    assert target.k_1 == pytest.approx(PLACED.k_1 / T_d**2, rel=1e-12)
    assert target.d_1 == pytest.approx(PLACED.d_1 / T_d, rel=1e-12)
    assert target.k_2 == pytest.approx(math.log(50.0) / T_d, rel=1e-12)
    assert target.settling_time == (0.5 if "0.5 s" in new else 1.0)


def test_a_fast_V_loop_has_a_k_2_of_its_own() -> None:
    for T in (1.0, 0.5):
        text = STUDY.replace('"angle_damped"', f'"fast_voltage", settling_time = {T}')
        target = study_from_text(text).controllers[0].target
        assert target.k_2 == pytest.approx(20.0 / T, rel=1e-12)
        assert target.k_1 == pytest.approx(PLACED.k_1 / (0.97 * (T - 0.01)) ** 2, rel=1e-12)
        assert target.follow_references
    promises = promises_of(study_from_text(text), study_from_text(text).controllers[0])
    assert (promises.overshoot_pct, promises.overshoot_Q_pct) == (2.0, 50.0)


def test_poles_that_a_study_gives_stay_and_are_scaled_for_a_controller() -> None:
    given = STUDY.replace('"angle_damped" }', '"angle_damped", k_1 = 30, k_2 = 5 }')
    target = study_from_text(given).controllers[0].target
    assert (target.k_1, target.k_2) == (30.0, 5.0)
    assert target.d_1 == pytest.approx(PLACED.d_1 / (0.99 * 0.97), rel=1e-12)
    twice = given.replace('kind = "scheduled" }', 'kind = "scheduled", settling_time = "0.5 s", k_2 = 7 }')
    target = study_from_text(twice).controllers[0].target
    assert (target.k_1, target.k_2) == (120.0, 7.0)
    assert target.d_1 == pytest.approx(PLACED.d_1 / (0.49 * 0.97), rel=1e-12)
