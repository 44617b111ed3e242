"""Operating points against a solver that knows nothing of the closed form, and the words where there is none."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar, root

from vsgdesign.equations.power_flow import operating_point_discriminant, power_flow
from vsgdesign.errors import NoOperatingPointError
from vsgdesign.linear.operating_point import solve_operating_point, solve_with_droop
from vsgdesign.linear.operating_point.equilibrium import feasible_powers


def random_grid(rng: np.random.Generator, x_over_r: tuple[float, float]) -> tuple[float, float, float, float]:
    """(V_g, S, R, X): 30 V to 30 kV, 1 kVA to 10 MVA, |Z| from 1/50 to 1/1.5 of the base."""
    V_g, S = 10.0 ** rng.uniform(1.5, 4.5), 10.0 ** rng.uniform(3.0, 7.0)
    Z = 3.0 * V_g * V_g / S * 10.0 ** rng.uniform(math.log10(0.02), math.log10(0.67))
    angle = math.atan(10.0 ** rng.uniform(*np.log10(x_over_r)))
    return V_g, S, Z * math.cos(angle), Z * math.sin(angle)


def test_closed_form_against_a_root_finder() -> None:
    """Newton-like from the flat start, on the phasor equation V∠δ = V_g + Z·I; no part of the closed form."""
    rng = np.random.default_rng(11)
    solved = 0
    for _ in range(300):
        V_g, S, R, X = random_grid(rng, (0.05, 50.0))
        P, Q = rng.uniform(-0.5, 0.7) * S, rng.uniform(-0.2, 0.4) * S
        try:
            point = solve_operating_point(P, Q, V_g, R, X)
        except NoOperatingPointError:
            continue

        def residual(v: np.ndarray, P: float = P, Q: float = Q, V_g: float = V_g, Z: complex = complex(R, X)) -> list:
            V = complex(v[0], v[1]) * V_g
            I_grid = (complex(P, Q) / (3.0 * V)).conjugate()
            gap = (V - V_g - Z * I_grid) / V_g
            return [gap.real, gap.imag]

        solution = root(residual, [1.0, 0.0], tol=1e-13)
        if not solution.success or np.max(np.abs(solution.fun)) > 1e-12:
            continue
        V = complex(*solution.x)
        if abs(V) < point.V_rms / V_g - 1e-6:  # the root finder fell onto the low-voltage side
            continue
        solved += 1
        nose = operating_point_discriminant(P, Q, V_g, R, X)[1] / V_g**4
        # Near the nose both lose digits as one over the root of the discriminant.
        assert point.V_rms / V_g == pytest.approx(abs(V), abs=1e-12 / math.sqrt(nose))
        assert point.delta == pytest.approx(math.atan2(V.imag, V.real), abs=1e-11 / math.sqrt(nose))
    assert solved > 200


def test_the_point_delivers_what_was_asked() -> None:
    rng = np.random.default_rng(12)
    for _ in range(300):
        V_g, S, R, X = random_grid(rng, (0.02, 100.0))
        P, Q = rng.uniform(-0.4, 0.6) * S, rng.uniform(-0.2, 0.4) * S
        try:
            point = solve_operating_point(P, Q, V_g, R, X)
        except NoOperatingPointError:
            continue
        size = 3.0 * V_g * V_g / math.hypot(R, X)
        assert power_flow(point.delta, point.V_rms, V_g, R, X) == pytest.approx((P, Q), abs=1e-13 * size)
        assert (point.P, point.Q) == (P, Q)


def test_the_jacobian_of_the_point_is_that_of_the_power_flow() -> None:
    point = solve_operating_point(4500.0, 1000.0, 110.0, 3.64, 3.64)
    P_d, Q_d = (value.imag / 1e-30 for value in power_flow(point.delta + 1e-30j, point.V_rms, 110.0, 3.64, 3.64))
    P_V, Q_V = (value.imag / 1e-30 for value in power_flow(point.delta, point.V_rms + 1e-30j, 110.0, 3.64, 3.64))
    assert pytest.approx((P_d, P_V, Q_d, Q_V), rel=1e-12) == (point.A, point.B, point.C, point.D)


def test_the_voltage_limits_are_a_flag() -> None:
    """SCR 2 at X/R 1 needs 150.5 V: outside 1.25 pu, and still an operating point."""
    asked = (4500.0, 1000.0, 110.0, 3.63, 3.63)
    assert not solve_operating_point(*asked, (93.5, 137.5)).V_within_limits
    assert solve_operating_point(*asked, (93.5, 151.0)).V_within_limits
    assert not solve_operating_point(*asked, (151.0, 200.0)).V_within_limits


@pytest.mark.parametrize(
    ("V_g", "Q", "R", "X"),
    [
        (110.0, 1000.0, 3.63, 3.63),
        (110.0, 0.0, 0.0, 3.0),
        (110.0, -800.0, 0.5, 4.0),
        (110.0, 500.0, 3.0, 0.3),
        (19e3, 2e6, 5.0, 60.0),
        (19e3, 0.0, 0.02, 0.3),
        (400.0, 1e4, 0.01, 0.2),
    ],
)
def test_feasible_powers_are_the_zeros_of_the_discriminant(V_g: float, Q: float, R: float, X: float) -> None:
    """On both ends, from 110 V to 33 kV: found again by bisection, and by walking over the edge."""
    low, high = feasible_powers(Q, V_g, R, X)
    middle = 0.5 * (low + high)

    def distance(P: float) -> float:
        return operating_point_discriminant(P, Q, V_g, R, X)[1] / V_g**4

    assert low < middle < high
    assert distance(middle) > 0.0
    for end in (low, high):
        beyond = end + 0.5 * (end - middle)
        found = brentq(distance, middle, beyond, xtol=1e-13 * abs(beyond), rtol=np.float64(1e-14))
        assert end == pytest.approx(found, abs=1e-9 * (high - low))
        slack = 1e-6 * (end - middle)
        assert solve_operating_point(end - slack, Q, V_g, R, X).V_rms > 0.0
        with pytest.raises(NoOperatingPointError):
            solve_operating_point(end + slack, Q, V_g, R, X)


def test_no_power_at_all() -> None:
    """So much reactive power is drawn that no P is possible; and a resistive grid that takes any amount of P."""
    assert all(math.isnan(value) for value in feasible_powers(-1e5, 110.0, 1.0, 3.0))
    low, high = feasible_powers(0.0, 110.0, 2.0, 0.0)
    assert math.isinf(high)
    # 3·V_g²/(4R): half the source's voltage across the resistance.
    assert low == pytest.approx(-3.0 * 110.0**2 / 8.0, rel=1e-12)


REFUSED = [
    (12e3, 1000.0, 110.0, 1.0, 3.5),
    (-9e3, 500.0, 110.0, 3.0, 3.0),
    (40e6, 2e6, 19e3, 5.0, 60.0),
    (3e3, -6e3, 110.0, 0.5, 3.0),
    (0.0, -1e5, 110.0, 1.0, 3.0),
    (1000.0, 60e3, 110.0, 6.0, 0.4),
]


@pytest.mark.parametrize(("P", "Q", "V_g", "R", "X"), REFUSED)
def test_a_refusal_names_the_shortfall_and_remedies_that_work(
    P: float, Q: float, V_g: float, R: float, X: float
) -> None:
    with pytest.raises(NoOperatingPointError) as caught:
        solve_operating_point(P, Q, V_g, R, X)
    error, text = caught.value, str(caught.value)
    assert error.shortfall_w > 0.0
    assert f"P = {P / 1e3:.4g} kW" in text

    nearest = re.search(r"nearest possible P is (\S+) kW, (\S+) kW away", text)
    if nearest is not None:
        P_near, away = (1e3 * float(group) for group in nearest.groups())
        assert away == pytest.approx(error.shortfall_w, rel=1e-3)
        assert abs(P - P_near) == pytest.approx(away, rel=1e-2, abs=1e-3 * abs(P))
        inwards = math.copysign(error.shortfall_w, P_near - P)
        assert solve_operating_point(P + 1.0001 * inwards, Q, V_g, R, X)
        with pytest.raises(NoOperatingPointError):
            solve_operating_point(P + 0.9999 * inwards, Q, V_g, R, X)

    remedy = re.search(r"scale P and Q to (\S+) %.*reduce \|Z\| to (\S+) Ω .*, or (raise|lower) Q", text)
    assert remedy is not None
    scale, Z = float(remedy.group(1)) / 100.0, float(remedy.group(2))
    # The message has three or four digits: a percent either way decides.
    for s in (scale, Z / math.hypot(R, X)):
        assert solve_operating_point(0.99 * s * P, 0.99 * s * Q, V_g, R, X)
        assert solve_operating_point(P, Q, V_g, 0.99 * s * R, 0.99 * s * X)
        with pytest.raises(NoOperatingPointError):
            solve_operating_point(1.01 * s * P, 1.01 * s * Q, V_g, R, X)
    step = math.copysign(1e-4 * (abs(Q) + 1.0), 1.0 if remedy.group(3) == "raise" else -1.0)
    assert operating_point_discriminant(P, Q + step, V_g, R, X)[1] > operating_point_discriminant(P, Q, V_g, R, X)[1]


def test_droop_equation_holds() -> None:
    """P is delivered, Q = Q_ref + D_q (V_n − V), on the side where more angle is more power."""
    rng = np.random.default_rng(13)
    solved = 0
    for _ in range(300):
        V_g, S, R, X = random_grid(rng, (0.02, 100.0))
        P, Q_ref, D_q = rng.uniform(-0.3, 0.5) * S, rng.uniform(-0.1, 0.3) * S, 10.0 ** rng.uniform(-6.0, 1.0) * S / V_g
        V_n = V_g * rng.uniform(0.95, 1.05)
        try:
            point = solve_with_droop(P, Q_ref, D_q, V_n, V_g, R, X)
        except NoOperatingPointError:
            continue
        solved += 1
        size = 3.0 * V_g * V_g / math.hypot(R, X)
        P_is, Q_is = power_flow(point.delta, point.V_rms, V_g, R, X)
        assert P_is == pytest.approx(P, abs=1e-11 * size)
        assert pytest.approx(Q_is, abs=1e-9 * size) == point.Q
        # A voltage known to 1e-13 gives Q to 1e-13 of D + D_q; on a resistive grid the angle is a square root of it.
        assert pytest.approx(Q_ref + D_q * (V_n - point.V_rms), abs=1e-9 * (size + D_q * V_n)) == point.Q
        assert -1e-9 * size <= point.A
    assert solved > 200


def test_droop_around_a_known_point_returns_it_on_every_grid() -> None:
    """With V_n at the point's own voltage the droop is silent; X/R 0.01 was once refused for missing the root."""
    rng = np.random.default_rng(14)
    tried = 0
    for _ in range(400):
        V_g, S, R, X = random_grid(rng, (0.01, 100.0))
        P, Q = rng.uniform(-0.4, 0.6) * S, rng.uniform(-0.3, 0.5) * S
        try:
            point = solve_operating_point(P, Q, V_g, R, X)
        except NoOperatingPointError:
            continue
        if point.A <= 0.0 or point.A * point.D <= point.B * point.C:
            continue
        for droop in (1e-6, 0.01, 1.0):
            tried += 1
            again = solve_with_droop(P, Q, droop * S / V_g, point.V_rms, V_g, R, X)
            assert again.V_rms == pytest.approx(point.V_rms, rel=1e-9)
    assert tried > 600


def test_no_droop_is_the_plain_point() -> None:
    asked = (2000.0, 500.0, 110.0, 1.0, 2.0)
    assert solve_with_droop(2000.0, 500.0, 0.0, 110.0, *asked[2:]) == solve_operating_point(*asked)


def test_no_power_with_droop() -> None:
    """P = 0 and a reference of zero on a nominal grid: nothing flows."""
    point = solve_with_droop(0.0, 0.0, 5.0, 110.0, 110.0, 0.5, 2.0)
    assert (point.V_rms, point.delta) == pytest.approx((110.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("P", [2e4, -2e4])
def test_droop_cannot_carry_what_no_voltage_can(P: float) -> None:
    """Beyond the largest P over all voltages; the refusal is an error, not a number."""
    R, X, V_g = 1.0, 3.5, 110.0
    if P < 0.0:  # into the converter: 3 V_g²/(4R) bounds it at any voltage
        assert 3.0 * V_g**2 / (4.0 * R) < -P
    else:  # a stiff droop holds V near V_n, where |P| is bounded by the angle
        best = minimize_scalar(lambda d: -power_flow(d, 115.0, V_g, R, X)[0], bounds=(0.0, 3.0), method="bounded")
        assert -best.fun < P
    with pytest.raises(NoOperatingPointError):
        solve_with_droop(P, 0.0, 1e5, V_g, V_g, R, X)


def test_a_droop_that_the_grid_cannot_follow_is_not_called_a_missing_operating_point() -> None:
    """P and Q have a point at 171 V; the droop about 231 V has none. The message once said "-0.99 kW away"."""
    P, Q_ref, D_q, V_n, V_g, R, X = -4689.0, 756.3, 1083.0, 230.9, 230.9, 6.673, 4.254
    plain = solve_operating_point(P, Q_ref, V_g, R, X)
    with pytest.raises(NoOperatingPointError) as caught:
        solve_with_droop(P, Q_ref, D_q, V_n, V_g, R, X)
    error, text = caught.value, str(caught.value)
    assert text.startswith("no steady state with the Q–V droop")
    assert "no operating point" not in text
    assert f"at {plain.V_rms:.4g} V rms" in text
    assert f"asks for {D_q * (V_n - plain.V_rms) / 1e3:.4g} kvar more" in text
    # Both remedies are right to their three digits.
    share = float(re.search(r"scale P to (\S+) %", text).group(1)) / 100.0  # type: ignore[union-attr]
    droop = float(re.search(r"weaken the droop to D_q = (\S+) var/V", text).group(1))  # type: ignore[union-attr]
    for s in (0.98, 1.02):
        for asked in ((s * share * P, Q_ref, D_q), (P, Q_ref, s * droop)):
            if s < 1.0:
                assert solve_with_droop(*asked, V_n, V_g, R, X).V_rms > 0.0
            else:
                with pytest.raises(NoOperatingPointError):
                    solve_with_droop(*asked, V_n, V_g, R, X)
    assert error.shortfall_w == pytest.approx((1.0 - share) * abs(P), rel=0.02)


def test_where_the_grid_itself_is_what_forbids_it_the_message_says_so() -> None:
    with pytest.raises(NoOperatingPointError, match="no operating point: P = 20 kW"):
        solve_with_droop(2e4, 0.0, 1e3, 110.0, 110.0, 1.0, 3.5)


@pytest.mark.parametrize("P", [0.0, 2000.0])
def test_a_source_without_voltage_has_no_operating_point(P: float) -> None:
    for asked in (
        lambda: solve_operating_point(P, 0.0, 0.0, 1.0, 3.5),
        lambda: solve_with_droop(P, 0.0, 10.0, 110.0, 0.0, 1.0, 3.5),
    ):
        with pytest.raises(NoOperatingPointError, match="bolted fault"):
            asked()
