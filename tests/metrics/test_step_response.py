"""Step and disturbance figures against responses whose figures are known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import root_scalar

from vsgdesign.metrics import ResponseMetrics, disturbance_response, step_response

Array = NDArray[np.float64]

OMEGA_N = 4.0
DT = 1e-4
"""Linear interpolation between samples is then wrong by less than (ω_n·DT)² = 1.6e-7 of a step."""

TOLERANCE_S = 5e-6
"""That error over the slowest slope at which a figure is read (2 % a 1/ω_n), with a margin."""

T = np.arange(0.0, 6.0, DT)


def second_order(t: Array, zeta: float) -> Array:
    """Unit-step response of ω_n²/(s² + 2ζω_n s + ω_n²)."""
    if zeta == 1.0:
        return 1.0 - (1.0 + OMEGA_N * t) * np.exp(-OMEGA_N * t)
    if zeta < 1.0:
        root = math.sqrt(1.0 - zeta * zeta)
        phase = OMEGA_N * root * t
        return 1.0 - np.exp(-zeta * OMEGA_N * t) * (np.cos(phase) + zeta / root * np.sin(phase))
    root = math.sqrt(zeta * zeta - 1.0)
    slow, fast = OMEGA_N * (zeta - root), OMEGA_N * (zeta + root)
    return 1.0 - (fast * np.exp(-slow * t) - slow * np.exp(-fast * t)) / (fast - slow)


def crossing(zeta: float, level: float, after: float, before: float) -> float:
    """Where the closed-form response passes a level."""

    def above(t: float) -> float:
        return float(second_order(np.array(t), zeta)) - level

    return root_scalar(above, bracket=(after, before), method="brentq", xtol=1e-13).root


def last_exit(zeta: float, band: float) -> float:
    """When the closed-form response enters the band for good, from its extremes at k·π/ω_d.

    The distance at the k-th extreme is exp(−kπζ/√(1−ζ²)); between the last one outside and the next the response
    passes the edge of the band once.
    """
    root = math.sqrt(1.0 - zeta * zeta)
    k = math.ceil(-math.log(band) * root / (math.pi * zeta)) - 1
    level = 1.0 - (-1.0) ** k * band
    period = math.pi / (OMEGA_N * root)
    return crossing(zeta, level, k * period, (k + 1) * period)


@pytest.mark.parametrize("zeta", [0.1, 0.2, 0.4, 0.6, 0.8])
def test_underdamped(zeta: float) -> None:
    t = np.arange(0.0, 20.0, DT)
    m = step_response(t, second_order(t, zeta), 0.0, 1.0)
    over = math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta * zeta))
    # The largest sample is at most half a sample from the peak: (ω_n DT/2)²/2 = 2e-8 of the step below it.
    assert m.overshoot_pct == pytest.approx(100.0 * over, abs=100.0 * 5e-8)
    assert m.settling_time_s == pytest.approx(last_exit(zeta, 0.02), abs=TOLERANCE_S)
    peak = math.pi / (OMEGA_N * math.sqrt(1.0 - zeta * zeta))
    rise = crossing(zeta, 0.9, 0.0, peak) - crossing(zeta, 0.1, 0.0, peak)
    assert m.rise_time_s == pytest.approx(rise, abs=TOLERANCE_S)
    assert m.peak_deviation == 1.0  # the first sample


def test_critically_damped() -> None:
    m = step_response(T, second_order(T, 1.0), 0.0, 1.0)
    assert m.overshoot_pct == 0.0
    # (1 + x) exp(−x) = 0.02 at x = 5.834: the rule 4/ω_n is 46 % short.
    assert m.settling_time_s == pytest.approx(5.83392 / OMEGA_N, abs=1e-5)
    # (1 + x) exp(−x) = 0.9 and 0.1 at x = 0.53181 and 3.88972.
    assert m.rise_time_s == pytest.approx((3.88972 - 0.53181) / OMEGA_N, abs=1e-5)
    # ∫ t (1 + ω_n t) exp(−ω_n t) dt = 3/ω_n², less what comes after 6 s (1e-8).
    assert m.itae_s2 == pytest.approx(3.0 / OMEGA_N**2, rel=1e-6)


def test_overdamped_has_no_overshoot_and_settles_with_its_slow_pole() -> None:
    zeta = 2.0
    m = step_response(T, second_order(T, zeta), 0.0, 1.0)
    assert m.overshoot_pct == 0.0
    assert m.settling_time_s == pytest.approx(crossing(zeta, 0.98, 0.0, 6.0), abs=TOLERANCE_S)


def test_first_order() -> None:
    tau = 0.3
    m = step_response(T, 1.0 - np.exp(-T / tau), 0.0, 1.0)
    assert m.settling_time_s == pytest.approx(tau * math.log(50.0), abs=TOLERANCE_S)
    assert m.rise_time_s == pytest.approx(tau * math.log(9.0), abs=TOLERANCE_S)
    assert m.itae_s2 == pytest.approx(tau * tau, rel=1e-6)


@pytest.mark.parametrize("band", [0.01, 0.02, 0.05])
def test_the_band_is_the_one_asked_for(band: float) -> None:
    m = step_response(T, 1.0 - np.exp(-T), 0.0, 1.0, band)
    assert m.settling_time_s == pytest.approx(-math.log(band), abs=TOLERANCE_S)


def test_figures_are_of_the_step_and_not_of_the_signal() -> None:
    """From 2500 to 2000 W: percent of 500 W, deviations in W."""
    response = second_order(T, 0.4)
    unit = step_response(T, response, 0.0, 1.0)
    m = step_response(T, 2500.0 - 500.0 * response, 2500.0, 2000.0)
    assert (m.initial, m.final) == (2500.0, 2000.0)
    assert m.overshoot_pct == pytest.approx(unit.overshoot_pct, rel=1e-9)
    assert m.settling_time_s == pytest.approx(unit.settling_time_s, rel=1e-9)
    assert m.peak_deviation == pytest.approx(500.0, rel=1e-12)


def test_never_settled_and_never_risen_are_none() -> None:
    still_ringing = step_response(T, second_order(T, 0.01), 0.0, 1.0)
    assert still_ringing.settling_time_s is None
    too_short = T[T < 0.1]
    m = step_response(too_short, 1.0 - np.exp(-too_short), 0.0, 1.0)
    assert m.settling_time_s is None
    assert m.rise_time_s is None  # it reaches 9.5 %
    assert m.overshoot_pct == 0.0


def test_outside_at_the_last_sample_alone_is_not_settled() -> None:
    y = np.ones(100)
    assert step_response(T[:100], y, 0.0, 1.0).settling_time_s == 0.0
    y[-1] = 1.021
    assert step_response(T[:100], y, 0.0, 1.0).settling_time_s is None


def test_without_a_step_there_is_no_step_response() -> None:
    with pytest.raises(ValueError, match="needs a step"):
        step_response(T, T, 1.0, 1.0)


def test_noise_in_the_tail() -> None:
    """Noise below the band moves the settling time by little; above it, the response never settles."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 4.0, 1e-3)
    clean = 1.0 - np.exp(-t / 0.3)
    noise = rng.uniform(-1.0, 1.0, len(t))
    quiet = step_response(t, clean + 0.002 * noise, 0.0, 1.0)
    # Within ±0.002 the band is left between the clean response's 2.2 % and 1.8 %.
    assert quiet.settling_time_s is not None
    assert 0.3 * math.log(1.0 / 0.022) < quiet.settling_time_s < 0.3 * math.log(1.0 / 0.018)
    assert quiet.overshoot_pct == pytest.approx(0.2, abs=0.02)
    loud = step_response(t, clean + 0.1 * noise, 0.0, 1.0)
    assert loud.settling_time_s is None or loud.settling_time_s > 3.9


def test_disturbance() -> None:
    """A dip of 300 W of a rating of 5000 W: 2 % is 100 W, so the exponential is in after τ·ln 3."""
    tau, dip, rating = 0.2, -300.0, 5000.0
    y = 2000.0 + dip * np.exp(-T / tau)
    m = disturbance_response(T, y, 2000.0, 2000.0, rating)
    assert m.overshoot_pct is None
    assert m.rise_time_s is None
    assert m.settling_time_s == pytest.approx(tau * math.log(3.0), abs=TOLERANCE_S)
    assert m.peak_deviation == pytest.approx(300.0, rel=1e-12)
    assert m.itae_s2 == pytest.approx(300.0 / rating * tau * tau, rel=1e-6)


def test_a_disturbance_within_the_band_is_settled_from_the_start() -> None:
    m = disturbance_response(T, 2000.0 + 99.0 * np.exp(-T), 2000.0, 2000.0, 5000.0)
    assert m.settling_time_s == 0.0


def test_a_disturbance_that_goes_on_is_not_settled() -> None:
    m = disturbance_response(T, 2000.0 + 150.0 * np.cos(50.0 * T), 2000.0, 2000.0, 5000.0)
    assert isinstance(m, ResponseMetrics)
    assert m.settling_time_s is None or m.settling_time_s > 5.9
