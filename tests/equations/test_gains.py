"""The closed-form gains against Table II to the last printed digit, and against the loops they promise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vsgdesign.equations.placing import (
    closed_form_poles,
    current_loop_gains,
    inner_loop_bandwidth,
    voltage_loop_gains,
)
from vsgdesign.equations.power_flow import jacobian_from_powers, operating_point
from vsgdesign.equations.structures import PUBLISHED, NormalisedGains

R_G, X_G = 3.64097929, 3.64422703


def power_loop_gains(
    A: float, D: float, settling_time: float, damping_ratio: float, droop_ratio: float
) -> tuple[float, float, float, float]:
    """K_ip, D_p, K_iq, D_q of the published structure; B and C must have no say."""
    normalised = NormalisedGains(*closed_form_poles(settling_time, damping_ratio), droop_ratio, 0.0, 0.0)
    gains = PUBLISHED.gains(A, 91.9, -4840.0, D, normalised, 0.0, 0.0, 5e3, 314.0, False)
    assert gains[4:] == (0.0, 0.0, 0.0, 0.0)
    return gains[:4]


@pytest.fixture(scope="module")
def half_second() -> tuple[float, float, float, float]:
    V, _ = operating_point(4500.0, 1000.0, 110.0, R_G, X_G)
    A, _, _, D = jacobian_from_powers(4500.0, 1000.0, V, R_G, X_G)
    return power_loop_gains(A, D, 0.5, 1.0, 0.01)


def test_check_vector(half_second: tuple[float, float, float, float]) -> None:
    K_ip, D_p, K_iq, D_q = half_second
    assert f"{D_p:.5f}" == "2087.05416"
    assert f"{K_ip:.11f}" == "0.00766630799"
    assert f"{D_q:.9f}" == "0.686969676"
    assert f"{K_iq:.9f}" == "0.115300462"


def test_table_ii_power_loops(half_second: tuple[float, float, float, float]) -> None:
    """Printed: D_p = 2.087e3, K_ip = 0.00767, K_iq = 0.115, D_q = 0.687. They are the 0.5 s design."""
    K_ip, D_p, K_iq, D_q = half_second
    assert f"{D_p:.3e}" == "2.087e+03"
    assert f"{K_ip:.5f}" == "0.00767"
    assert f"{D_q:.3f}" == "0.687"
    assert f"{K_iq:.3f}" == "0.115"


def test_table_ii_inner_loops() -> None:
    K_pc, K_ic = current_loop_gains(1e-3, 1.0, 1e-3)
    K_pv, K_iv = voltage_loop_gains(10e-3, 1.0, 50e-6)
    assert f"{K_pc:.4f}" == "12.5664"
    assert f"{K_ic:.4e}" == "3.9478e+04"
    assert f"{K_pv:.4f}" == "0.0628"
    assert f"{K_iv:.4f}" == "19.7392"
    assert inner_loop_bandwidth(1e-3) == pytest.approx(2000.0 * math.pi, rel=1e-15)


def test_one_second_gives_the_rules_of_the_text() -> None:
    """K_ip = 16/A, D_p = A/2, D_q = D/100, K_iq = 4/(D + D_q)."""
    A, D = 8348.0, 68.7
    assert power_loop_gains(A, D, 1.0, 1.0, 0.01) == pytest.approx(
        (16.0 / A, A / 2.0, 4.0 / (1.01 * D), D / 100.0), rel=1e-14
    )


@pytest.mark.parametrize("damping_ratio", [0.3, 0.7, 1.0, 2.0])
@pytest.mark.parametrize("settling_time", [0.2, 1.0, 3.0])
def test_the_decoupled_loops_have_the_poles_that_were_asked_for(settling_time: float, damping_ratio: float) -> None:
    """dω/dt = K_ip(−Aδ − D_p ω), dδ/dt = ω: ω_n² = K_ip A, 2ξω_n = K_ip D_p; Q: one pole at 4/T_s."""
    A, D = 5200.0, 81.0
    K_ip, D_p, K_iq, D_q = power_loop_gains(A, D, settling_time, damping_ratio, 0.05)
    poles = np.linalg.eigvals(np.array([[-K_ip * D_p, -K_ip * A], [1.0, 0.0]]))
    omega_n = math.sqrt(float(np.prod(poles).real))
    assert omega_n == pytest.approx(4.0 / (damping_ratio * settling_time), rel=1e-12)
    assert -float(np.sum(poles).real) / (2.0 * omega_n) == pytest.approx(damping_ratio, rel=1e-12)
    assert K_iq * (D + D_q) == pytest.approx(4.0 / settling_time, rel=1e-14)


@pytest.mark.parametrize("damping_ratio", [0.5, 1.0])
def test_inner_gains_place_the_poles_of_the_bare_inductor_and_capacitor(damping_ratio: float) -> None:
    for gains, element in ((current_loop_gains, 1.3e-3), (voltage_loop_gains, 47e-6)):
        K_p, K_i = gains(2e-3, damping_ratio, element)
        omega = 2.0 * math.pi / 2e-3
        assert K_i / element == pytest.approx(omega**2, rel=1e-14)
        assert K_p / element == pytest.approx(2.0 * damping_ratio * omega, rel=1e-14)
