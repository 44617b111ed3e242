"""The notch of the power filters in the linear models: against the EMT, and against what a notch has to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.stability.studies import LABORATORY, PUBLISHED, UTILITY, Situation, case_study, designed, situation
from tests.stability.test_prediction_full_order import BOUND, STEP_PU, compare
from vsgdesign.artifacts.design_inputs import design_inputs
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.design.evaluation import law_of
from vsgdesign.equations.power_loops import notch, notch_constants, notch_delay
from vsgdesign.linear.model.full_order import INPUTS, OUTPUTS
from vsgdesign.linear.operating_point.full_order import Cell
from vsgdesign.linear.stability.margins import full_order_margins
from vsgdesign.study.parameters.grid import Place

CASES = (PUBLISHED, LABORATORY, UTILITY)


def with_filter(case: str, tau: float, power_filter: str = "notch", damping: float = 0.5) -> Situation:
    study = replace(case_study(case, tau_P=tau, tau_Q=tau), power_filter=power_filter, notch_damping=damping)
    grid = Place(4.0, 2.0, study.scr_basis).grid(study.converter)
    S = study.converter.S_rated
    return situation(study, Cell(grid, designed(study, grid, 0.5), 0.4 * S, 0.1 * S))


def response(omega: float, damping: float, T_s: float, frequency: float) -> complex:
    """From its own impulse response."""
    constants = notch_constants(omega, damping, T_s)
    passed, ripple, mean = [], 0.0, 0.0
    for k in range(20_000):
        y, ripple, mean = notch(float(k == 0), ripple, mean, *constants)
        passed.append(y)
    return complex(np.sum(np.array(passed) * np.exp(-1j * frequency * T_s * np.arange(20_000))))


@pytest.mark.parametrize(("f", "T_s"), [(100.0, 50e-6), (120.0, 125e-6), (120.0, 333e-6)])
@pytest.mark.parametrize("damping", [0.1, 0.5, 1.0])
def test_a_notch_is_what_it_says(f: float, T_s: float, damping: float) -> None:
    """Nothing passes at its frequency, all does at rest, half the power at the edges of its width."""
    omega = 2.0 * np.pi * f
    assert abs(response(omega, damping, T_s, omega)) < 1e-9
    assert response(omega, damping, T_s, 0.0) == pytest.approx(1.0, abs=1e-12)
    slow = 1.0
    delay = -np.angle(response(omega, damping, T_s, slow)) / slow
    assert delay == pytest.approx(notch_delay(notch_constants(omega, damping, T_s), T_s), rel=1e-5)
    # Of the notch in continuous time, to which it tends: (ω² − Ω²)² = (2ζΩω)² at the edges.
    if T_s * omega < 0.05:
        for edge in (np.hypot(1.0, damping) - damping, np.hypot(1.0, damping) + damping):
            assert abs(response(omega, damping, T_s, edge * omega)) == pytest.approx(np.sqrt(0.5), abs=0.03)


def test_single_precision_keeps_what_rests() -> None:
    """Rounding of its constants leaves its gain at rest alone. The mean stops where its step is half of its last digit,
    with β(γ/σ) ≈ 2: an error of 3e-8/2 of the value, of which the ripple holds γ/σ = 64 times as much."""
    constants = [np.float32(value) for value in notch_constants(200.0 * np.pi, 0.5, 50e-6)]
    ripple, mean, y = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for _ in range(5000):
        y, ripple, mean = notch(np.float32(12_345.0), ripple, mean, *constants)
    assert np.asarray(y).dtype == np.float32
    assert float(y) == pytest.approx(12_345.0, rel=1e-6)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("input_", ["P_ref", "Q_ref"])
def test_every_sample_of_the_emt_is_predicted(case: str, input_: str) -> None:
    found = compare(with_filter(case, 3e-3), input_, STEP_PU, seconds=0.3)
    assert max(found.errors.values()) < BOUND, found


@pytest.mark.parametrize("case", CASES)
def test_the_loops_do_not_see_twice_the_frequency(case: str) -> None:
    """What is added to the measured powers at 2 ω_0 reaches neither frequency nor voltage of the closed loop."""
    for power_filter in ("notch", "low_pass"):
        s = with_filter(case, 3e-3, power_filter)
        z = np.exp(2j * s.study.converter.omega_n * s.model.T_s)
        A, B, C, D = (m[0] for m in (s.model.A, s.model.B, s.model.C, s.model.D))
        from_powers = [INPUTS.index(name) for name in ("P_meas", "Q_meas")]
        H = C @ np.linalg.solve(z * np.eye(len(A)) - A, B) + D
        S, c = s.study.converter.S_rated, s.study.converter
        scale = {"omega": c.omega_n, "V": c.V_rated_rms}
        passed = [abs(H[OUTPUTS.index(name), k]) * S / size for name, size in scale.items() for k in from_powers]
        assert (max(passed) < 1e-9) == (power_filter == "notch"), (power_filter, passed)


@pytest.mark.parametrize("case", CASES)
def test_its_delay_stands_for_it(case: str) -> None:
    """The lags of the reduced models: a low-pass with the same lag has the same margins of the full-order model."""
    s = with_filter(case, 3.4e-3)
    lag = s.study.power_lags[0]
    assert lag == pytest.approx(3.4e-3 + 0.5 / s.study.converter.omega_n, rel=0.05)
    alike = with_filter(case, lag, "low_pass")
    ours, theirs = (full_order_margins(x.model) for x in (s, alike))
    assert ours.disk_output.value[0] == pytest.approx(theirs.disk_output.value[0], rel=0.02)
    assert set(s.model.states) - set(alike.model.states) == {"ripple_P", "ripple_Q", "mean_P", "mean_Q"}
    assert with_filter(case, 0.0).study.power_lags[0] > 0.0


def test_where_it_counts() -> None:
    """Reduced models, the base of a table and the law of its search have the lag; the inputs of its design name it."""
    s = with_filter(PUBLISHED, 3.4e-3)
    plain = replace(s.study, power_filter="low_pass")
    target = replace(s.study.target, structure="angle_damped")
    lag = s.study.power_lags
    assert lag[0] > 3.4e-3 + 1.5e-3
    law, base = law_of(s.study, target, "settling"), base_of(s.study)
    assert law.lags == base.lags == lag
    assert plain.power_lags == (3.4e-3, 3.4e-3, 0.0, 0.0, 0.0)
    ours, theirs = (design_inputs(study, target)["power_loops"] for study in (s.study, plain))
    assert ours == theirs | {"notch_damping": 0.5}
