"""Power flow, its Jacobian and its inverse against phasors, complex step and the published numbers."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from vsgdesign.equations.power_flow import (
    dQ_dV_as_published,
    jacobian_from_powers,
    largest_scale,
    operating_point,
    operating_point_discriminant,
    power_flow,
)

V_SOURCE = st.floats(50.0, 20e3)
V_RATIO = st.floats(0.5, 1.5)
DELTA = st.floats(-1.4, 1.4)
IMPEDANCE = st.floats(0.01, 50.0)
IMPEDANCE_ANGLE = st.floats(0.01, 0.5 * math.pi)  # from almost pure R (X/R 0.01) to pure X

PUBLISHED = (4500.0, 1000.0, 110.0, 3.64097929, 3.64422703)


def phasor_powers(delta: complex, V: complex, V_g: float, Z: complex) -> complex:
    """S = 3 V I* with I = (V∠δ − V_g)/Z, written for real δ and V."""
    v = V * cmath.exp(1j * delta)
    return 3.0 * v * ((v - V_g) / Z).conjugate()


@examples(60)
@given(DELTA, V_RATIO, V_SOURCE, IMPEDANCE, IMPEDANCE_ANGLE)
def test_powers_against_phasors(delta: float, ratio: float, V_g: float, Z_abs: float, angle: float) -> None:
    Z = cmath.rect(Z_abs, angle)
    P, Q = power_flow(delta, ratio * V_g, V_g, Z.real, Z.imag)
    # Both ways subtract terms of the size of the short-circuit power.
    assert complex(P, Q) == pytest.approx(phasor_powers(delta, ratio * V_g, V_g, Z), abs=1e-14 * 10.0 * V_g**2 / Z_abs)


@examples(60)
@given(DELTA, V_RATIO, V_SOURCE, IMPEDANCE, IMPEDANCE_ANGLE)
def test_jacobian_against_complex_step(delta: float, ratio: float, V_g: float, Z_abs: float, angle: float) -> None:
    """A, B, C, D from measured P, Q, V equal the derivatives of the power flow, which no solver took."""
    V, R, X = ratio * V_g, Z_abs * math.cos(angle), Z_abs * math.sin(angle)
    step = 1e-30
    P, Q = power_flow(delta, V, V_g, R, X)
    by_delta = [value.imag / step for value in power_flow(delta + 1j * step, V, V_g, R, X)]
    by_V = [value.imag / step for value in power_flow(delta, V + 1j * step, V_g, R, X)]
    A, B, C, D = jacobian_from_powers(P, Q, V, R, X)
    # Relative to the size of the matrix: an entry that crosses zero has no relative error.
    size = 3.0 * V * V_g / Z_abs
    assert pytest.approx(by_delta, abs=1e-12 * size) == (A, C)
    assert pytest.approx(by_V, abs=1e-12 * size / V) == (B, D)


def test_jacobian_entries_to_ten_digits_where_none_is_small() -> None:
    """The same relative to each entry, on seeded operating points of real grids."""
    rng = np.random.default_rng(1)
    worst = 0.0
    for _ in range(1000):
        V_g = rng.uniform(50.0, 20e3)
        V, delta = V_g * rng.uniform(0.8, 1.3), rng.uniform(0.05, 0.9)
        R, X = rng.uniform(0.2, 5.0, 2)
        by_delta = [value.imag / 1e-30 for value in power_flow(delta + 1e-30j, V, V_g, R, X)]
        by_V = [value.imag / 1e-30 for value in power_flow(delta, V + 1e-30j, V_g, R, X)]
        exact = np.array([by_delta[0], by_V[0], by_delta[1], by_V[1]])
        entries = np.array(jacobian_from_powers(*power_flow(delta, V, V_g, R, X), V, R, X))
        size = 3.0 * V * V / math.hypot(R, X) * np.array([1.0, 1.0 / V, 1.0, 1.0 / V])
        clear = np.abs(exact) > 0.01 * size
        worst = max(worst, float(np.max(np.abs(entries - exact)[clear] / np.abs(exact)[clear])))
    assert worst < 1e-10


@examples(60)
@given(st.floats(-0.6, 0.6), V_RATIO, V_SOURCE, IMPEDANCE, IMPEDANCE_ANGLE)
def test_operating_point_inverts_the_power_flow(
    delta: float, ratio: float, V_g: float, Z_abs: float, angle: float
) -> None:
    V, R, X = ratio * V_g, Z_abs * math.cos(angle), Z_abs * math.sin(angle)
    P, Q = power_flow(delta, V, V_g, R, X)
    b_0, discriminant = operating_point_discriminant(P, Q, V_g, R, X)
    # The high-voltage root is the one above the nose, V² > b₀/2; the discriminant is the distance to it squared.
    above_nose = 2.0 * V * V / b_0 - 1.0
    if above_nose < 1e-3:
        return
    assert discriminant == pytest.approx((2.0 * V * V - b_0) ** 2, rel=1e-8)
    V_back, delta_back = operating_point(P, Q, V_g, R, X)
    # Rounding grows by one over the square of the distance to the nose.
    assert V_back == pytest.approx(V, rel=1e-14 / above_nose**2)
    assert delta_back == pytest.approx(delta, abs=1e-14 / above_nose**2)


@examples(50)
@given(st.floats(-3.1, 3.1), st.floats(10.0, 1e6), V_SOURCE, IMPEDANCE, IMPEDANCE_ANGLE)
def test_beyond_the_largest_scale_there_is_no_operating_point(
    direction: float, S: float, V_g: float, Z_abs: float, angle: float
) -> None:
    if abs(direction - angle) < 0.1:  # along Z itself there is no limit
        return
    P, Q, R, X = (S * math.cos(direction), S * math.sin(direction), Z_abs * math.cos(angle), Z_abs * math.sin(angle))
    scale = largest_scale(P, Q, V_g, R, X)
    for s, feasible in ((scale * (1.0 - 1e-6), True), (scale * (1.0 + 1e-6), False)):
        assert (operating_point_discriminant(s * P, s * Q, V_g, R, X)[1] >= 0.0) == feasible
        assert (operating_point_discriminant(P, Q, V_g, s * R, s * X)[1] >= 0.0) == feasible
    with np.errstate(invalid="ignore"):
        assert np.isnan(operating_point(np.float64(1.01 * scale * P), 1.01 * scale * Q, V_g, R, X)[0])


def test_published_a_and_d() -> None:
    P, Q, V_g, R, X = PUBLISHED
    V, delta = operating_point(P, Q, V_g, R, X)
    A, _, _, D = jacobian_from_powers(P, Q, V, R, X)
    assert f"{A:.5f}" == "8348.21665"
    assert f"{D:.7f}" == "68.6969676"
    assert power_flow(delta, V, V_g, R, X) == pytest.approx((P, Q), rel=1e-12)


def test_scr_2_needs_the_voltage_that_the_paper_does_not_mention() -> None:
    V, _ = operating_point(4500.0, 1000.0, 110.0, 3.63, 3.63)
    assert f"{V:.1f}" == "150.5"


@examples(40)
@given(DELTA, V_RATIO, V_SOURCE, IMPEDANCE, IMPEDANCE_ANGLE)
def test_what_the_paper_prints_for_d_is_c(delta: float, ratio: float, V_g: float, Z_abs: float, angle: float) -> None:
    V, R, X = ratio * V_g, Z_abs * math.cos(angle), Z_abs * math.sin(angle)
    C = power_flow(delta + 1e-30j, V, V_g, R, X)[1].imag / 1e-30
    assert dQ_dV_as_published(delta, V, V_g, R, X) == pytest.approx(C, abs=1e-12 * 3.0 * V * V_g / Z_abs)


def test_the_printed_d_is_not_the_derivative() -> None:
    P, Q, V_g, R, X = PUBLISHED
    V, delta = operating_point(P, Q, V_g, R, X)
    D = jacobian_from_powers(P, Q, V, R, X)[3]
    assert abs(dQ_dV_as_published(delta, V, V_g, R, X) / D - 1.0) > 1.0
