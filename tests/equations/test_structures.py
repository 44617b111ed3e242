"""Structures against poles found by another route, and against what each promises at rest."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from vsgdesign.equations.placing import closed_form_poles
from vsgdesign.equations.power_flow import jacobian_from_powers, operating_point, power_flow
from vsgdesign.equations.power_loops import (
    PowerLoopGains,
    References,
    gain_transfer,
    power_loops,
    power_loops_about_rest,
)
from vsgdesign.equations.structures import (
    STRUCTURES,
    ClosedFormAim,
    NormalisedGains,
    angle_damped_gains,
    decoupled_gains,
    decoupling,
    effective_inertia,
)

OMEGA_0, V_N = 314.0, 110.0
POLES = 5e3, OMEGA_0, False
"""Rating, frequency, and the law with poles."""
K_1, D_1, K_2 = 15.8, 6.6, 4.0
AIM = ClosedFormAim(1.0, 1.0, 0.01, K_1, D_1, K_2, 1.0, 1.0)
WHOLE = NormalisedGains(K_1, D_1, K_2, 0.0, 1.0, 1.0)
"""All coupling taken out."""
SAME_AT_ONE_SECOND = WHOLE._replace(k_1_or_H=21.329, d_1_or_zeta=8.2433, k_2=np.log(50.0))
"""Both polynomials' step responses are at 98 % after 1 s."""


def random_grids(count: int, seed: int) -> list[tuple[float, float, float, float]]:
    """(P, Q, R, X) with an operating point, X/R from 0.2 to 20."""
    rng = np.random.default_rng(seed)
    found: list[tuple[float, float, float, float]] = []
    while len(found) < count:
        P, Q = rng.uniform(-4e3, 4e3), rng.uniform(-1e3, 2e3)
        Z, ratio = rng.uniform(0.3, 4.0), np.exp(rng.uniform(np.log(0.2), np.log(20.0)))
        R = Z / np.hypot(1.0, ratio)
        with np.errstate(invalid="ignore"):
            V, delta = operating_point(P, Q, V_N, R, R * ratio)
        if np.isfinite(V) and abs(delta) < 1.0:
            found.append((P, Q, float(R), float(R * ratio)))
    return found


def closed_loop(P: float, Q: float, R: float, X: float, gains: PowerLoopGains) -> NDArray[np.complex128]:
    """Eigenvalues of (δ, ω_i, V) by central differences of the nonlinear equations: no formula of the library."""
    V_0, delta_0 = (float(value) for value in operating_point(P, Q, V_N, R, X))
    omega_i = OMEGA_0 + gains.k_P * P + gains.k_Q * (Q + gains.D_q * V_0)
    refs = References(P, Q - gains.D_q * (V_N - V_0), OMEGA_0, V_N)

    def rates(x: NDArray[np.float64]) -> NDArray[np.float64]:
        p, q = power_flow(x[0], x[2], V_N, R, X)
        omega, domega, dV = power_loops(x[1], x[2], p, q, refs, gains)
        return np.array([omega - OMEGA_0, domega, dV])

    at = np.array([delta_0, omega_i, V_0])
    # It is a steady state: the largest rate is rounding of powers of some kW times the gains.
    assert np.abs(rates(at)).max() < 1e-8
    h = np.array([1e-5, 1e-4, 1e-3])
    columns = [(rates(at + h * e) - rates(at - h * e)) / (2.0 * h @ e) for e in np.eye(3)]
    return np.linalg.eigvals(np.array(columns).T).astype(complex)


def wanted() -> NDArray[np.complex128]:
    return np.array([*np.roots([1.0, D_1, K_1]), -K_2], dtype=complex)


@pytest.mark.parametrize("grid", random_grids(12, seed=1))
@pytest.mark.parametrize(("D_p", "D_q"), [(0.0, 0.0), (318.0, 0.0), (318.0, 909.0), (40.0, 100.0)])
def test_angle_damping_places_the_poles_whatever_grid_and_droops(
    grid: tuple[float, float, float, float], D_p: float, D_q: float
) -> None:
    P, Q, R, X = grid
    J = jacobian_from_powers(P, Q, operating_point(P, Q, V_N, R, X)[0], R, X)
    gains = angle_damped_gains(*J, WHOLE, D_p, D_q, *POLES)
    found = np.sort_complex(closed_loop(P, Q, R, X, gains))
    # Differences of a stiff W times kW-sized powers: 1e-5 of the poles' size.
    assert np.abs(found - np.sort_complex(wanted())).max() < 1e-4


@pytest.mark.parametrize("grid", random_grids(12, seed=4))
@pytest.mark.parametrize("D_q", [0.0, 45.0, 909.0])
def test_every_step_of_P_and_Q_is_at_98_percent_after_a_second(
    grid: tuple[float, float, float, float], D_q: float
) -> None:
    """From the nonlinear equations, small steps, 5 % P-f droop; the poles are those that are at 98 % at 1 s alone."""
    P, Q, R, X = grid
    V_0, delta_0 = (float(value) for value in operating_point(P, Q, V_N, R, X))
    gains = angle_damped_gains(*jacobian_from_powers(P, Q, V_0, R, X), SAME_AT_ONE_SECOND, 318.0, D_q, *POLES)
    omega_i = OMEGA_0 + gains.k_P * P + gains.k_Q * (Q + D_q * V_0)
    for signal in (0, 1):
        step = np.zeros(2)
        step[signal] = 0.1

        def rates(_: float, x: NDArray[np.float64], step: NDArray[np.float64] = step) -> list[float]:
            refs = References(P + step[0], Q - D_q * (V_N - V_0) + step[1], OMEGA_0, V_N)
            omega, domega, dV = power_loops(x[1], x[2], *power_flow(x[0], x[2], V_N, R, X), refs, gains)
            return [omega - OMEGA_0, domega, dV]

        run = solve_ivp(
            rates, (0.0, 6.0), [delta_0, omega_i, V_0], method="LSODA", t_eval=[1.0, 6.0], rtol=1e-11, atol=1e-12
        )
        after = power_flow(run.y[0], run.y[2], V_N, R, X)[signal] - (P, Q)[signal]
        # 0.1 W or var of kW: curvature is below 1e-4. k_2 D_p w11 is up to 0.23 here: sigma is 1.2 % off at most.
        assert after[0] / after[1] == pytest.approx(0.98, abs=2e-3)


@pytest.mark.parametrize("D_p", [318.0, 4e3, 1e5])
def test_no_droop_makes_the_gains_of_the_V_row_grow_without_bound(D_p: float) -> None:
    """x/(1 + x³) has its maximum 2^(2/3)/3 at x = 2^(-1/3): the determinant keeps 47 % of itself."""
    for P, Q, R, X in random_grids(50, seed=5):
        J = jacobian_from_powers(P, Q, operating_point(P, Q, V_N, R, X)[0], R, X)
        if J[0] <= 0.0 or J[0] * J[3] <= J[1] * J[2]:
            continue
        without = angle_damped_gains(*J, WHOLE, 0.0, 0.0, *POLES)
        with_droop = angle_damped_gains(*J, WHOLE, D_p, 0.0, *POLES)
        assert abs(with_droop.K_qp / without.K_qp) <= 1.0 / (1.0 - 2.0 ** (2.0 / 3.0) / 3.0) + 1e-9


@pytest.mark.parametrize("grid", random_grids(12, seed=2))
@pytest.mark.parametrize("D_q", [0.0, 50.0])
def test_decoupling_places_the_poles_without_P_f_droop_of_its_own(
    grid: tuple[float, float, float, float], D_q: float
) -> None:
    P, Q, R, X = grid
    J = jacobian_from_powers(P, Q, operating_point(P, Q, V_N, R, X)[0], R, X)
    gains = decoupled_gains(*J, WHOLE, 0.0, D_q, *POLES)
    assert gains.K_ip * gains.D_p == pytest.approx(D_1, rel=1e-12)
    found = np.sort_complex(closed_loop(P, Q, R, X, gains))
    assert np.abs(found - np.sort_complex(wanted())).max() < 1e-4


@pytest.mark.parametrize("grid", random_grids(12, seed=7))
def test_a_very_fast_V_loop_places_the_poles_of_P_with_four_gains(grid: tuple[float, float, float, float]) -> None:
    """At k_2 = 10⁴/s, V is at rest beside δ: what is left of its pole in the two others is of the order of d_1/k_2."""
    P, Q, R, X = grid
    J = jacobian_from_powers(P, Q, operating_point(P, Q, V_N, R, X)[0], R, X)
    normalised = NormalisedGains(K_1, D_1, 1e4, 0.01, 0.0, 0.0)
    gains = STRUCTURES["fast_voltage"].gains(*J, normalised, 0.0, 0.0, *POLES)
    assert (gains.K_pq, gains.K_qp, gains.k_P, gains.k_Q) == (0.0, 0.0, 0.0, 0.0)
    found = closed_loop(P, Q, R, X, gains)
    slow = found[np.argsort(np.abs(found))[:2]]
    assert np.sort_complex(slow) == pytest.approx(np.sort_complex(np.roots([1.0, D_1, K_1])), rel=2e-2)
    assert found[np.argmax(np.abs(found))] == pytest.approx(-1e4, rel=2e-2)


def test_inertia_asked_of_a_fast_V_loop_is_that_of_its_gains() -> None:
    normalised = NormalisedGains(5.0, 0.7, 20.0, 0.01, 0.0, 0.0)
    gains = STRUCTURES["fast_voltage"].gains(8348.0, 91.9, -4840.0, 68.7, normalised, 0.0, 0.0, 5e3, OMEGA_0, True)
    assert effective_inertia(gains, 5e3, OMEGA_0) == pytest.approx(5.0, rel=1e-12)


def test_the_published_structure_is_the_law_with_four_gains() -> None:
    normalised = NormalisedGains(*closed_form_poles(1.0, 1.0), 0.01, 0.0, 0.0)
    gains = STRUCTURES["published"].gains(8348.0, 91.9, -4840.0, 68.7, normalised, 0.0, 0.0, *POLES)
    refs = References(3e3, 1e3, OMEGA_0, V_N)
    omega, domega, dV = power_loops(313.5, 112.0, 2.8e3, 650.0, refs, gains)
    assert omega == 313.5
    assert domega == pytest.approx(gains.K_ip * (200.0 + gains.D_p * 0.5), rel=1e-14)
    assert dV == pytest.approx(gains.K_iq * (350.0 - gains.D_q * 2.0), rel=1e-14)
    assert gains.named() == {"K_ip": gains.K_ip, "D_p": gains.D_p, "K_iq": gains.K_iq, "D_q": gains.D_q}


def test_no_share_leaves_a_diagonal_and_one_row_can_stay_pure() -> None:
    A, B, C, D = 8348.0, 91.9, -4840.0, 68.7
    assert decoupling(A, B, C, D, 0.0, 0.0, 0.0) == pytest.approx((1.0 / A, 0.0, 0.0, 1.0 / D), rel=1e-14)
    w11, w12, w21, w22 = decoupling(A, B, C, D, 0.0, 0.0, 1.0)
    assert (w11, w12) == pytest.approx((1.0 / A, 0.0), rel=1e-14)
    assert np.array([[w11, w12], [w21, w22]]) @ np.array([[A, 0.0], [C, D]]) == pytest.approx(np.eye(2), abs=1e-12)


REFS = References(3e3, 1e3, OMEGA_0, V_N)
WEAK, STRONG = (8348.0, 91.9, -4840.0, 68.7), (24076.0, 217.0, -20845.0, 211.0)
"""A, B, C, D of two grids."""


@pytest.mark.parametrize("structure", list(STRUCTURES))
@pytest.mark.parametrize("offset", [-2.5, 0.0, 1.8])
def test_what_is_at_rest_stays_at_rest_when_the_gains_change(structure: str, offset: float) -> None:
    """At rest on a grid of any frequency both errors are zero, so P = P_ref − D_p (ω − ω_0) and Q + D_q V likewise."""
    normalised = STRUCTURES[structure].closed_form(AIM)
    old, new = (STRUCTURES[structure].gains(*J, normalised, 318.0, 90.0, *POLES) for J in (WEAK, STRONG))
    omega, V = OMEGA_0 + offset, 112.0

    def at_rest(gains: PowerLoopGains) -> tuple[float, float]:
        return REFS.P_ref - gains.D_p * offset, REFS.Q_ref + gains.D_q * (V_N - V)

    def omega_i_of(gains: PowerLoopGains) -> float:
        P, Q = at_rest(gains)
        return omega + gains.k_P * P + gains.k_Q * (Q + gains.D_q * V)

    moved = gain_transfer(omega_i_of(old), REFS, old, new)
    assert moved == pytest.approx(omega_i_of(new), rel=1e-15)
    rates = power_loops(moved, V, *at_rest(new), REFS, new)
    assert rates == pytest.approx((omega, 0.0, 0.0), abs=1e-11)
    assert (old.k_P == new.k_P) is not STRUCTURES[structure].P_droop  # with damping through the angle there is a change


def test_the_transfer_keeps_the_deviation_from_rest_and_asks_no_measurement() -> None:
    """Of any ω_i, in rest or not; there and back gives the same ω_i, and equal gains the same bits."""
    old, new = (angle_damped_gains(*J, WHOLE, 318.0, 90.0, *POLES) for J in (WEAK, STRONG))
    for omega_i in (300.0, 317.0, 330.0):
        rests = []
        for gains, own in ((old, omega_i), (new, gain_transfer(omega_i, REFS, old, new))):
            # Where e_P = 0 with e_Q = 0: solved from the law itself, linear in ω.
            own -= gains.k_Q * (REFS.Q_ref + gains.D_q * REFS.V_n)
            rests.append((own - gains.k_P * (REFS.P_ref + gains.D_p * OMEGA_0)) / (1.0 - gains.k_P * gains.D_p))
        assert rests[1] == pytest.approx(rests[0], rel=1e-14)
        there = gain_transfer(omega_i, REFS, old, new)
        assert gain_transfer(there, REFS, new, old) == pytest.approx(omega_i, rel=1e-15)
        assert gain_transfer(omega_i, REFS, old, old._replace()) == omega_i


@pytest.mark.parametrize("structure", [*STRUCTURES, "other"])
def test_the_law_about_its_rest_is_the_law(structure: str) -> None:
    """With ω_i by the transfer from gains without damping through the angle, and dω_i/dt taken back likewise."""
    if structure == "other":  # k_P and k_Q in another ratio than K_ip and K_pq
        gains = PowerLoopGains(0.02, 300.0, 0.1, 90.0, -3e-3, 5e-3, 1.5e-3, 4e-4)
    else:
        gains = STRUCTURES[structure].gains(*WEAK, STRUCTURES[structure].closed_form(AIM), 318.0, 90.0, *POLES)
    bare = gains._replace(k_P=0.0, k_Q=0.0)
    omega_r, V, P, Q = 316.0, 108.0, 4.1e3, -700.0
    omega_i = gain_transfer(omega_r, REFS, bare, gains)
    omega, domega_i, dV = power_loops(omega_i, V, P, Q, REFS, gains)
    back = gain_transfer(omega_i + domega_i, REFS, gains, bare) - omega_r
    found = power_loops_about_rest(omega_r - OMEGA_0, V, P, Q, REFS, gains)
    assert found == pytest.approx((omega, back, dV), rel=1e-10)


def test_a_chain_of_transfers_is_the_transfer_to_the_last_gains() -> None:
    first, last = (angle_damped_gains(*J, WHOLE, 318.0, 90.0, *POLES) for J in (WEAK, STRONG))
    between = angle_damped_gains(*STRONG, SAME_AT_ONE_SECOND, 200.0, 500.0, *POLES)
    there = gain_transfer(gain_transfer(320.0, REFS, first, between), REFS, between, last)
    assert there == pytest.approx(gain_transfer(320.0, REFS, first, last), rel=1e-14)


@pytest.mark.parametrize("grid", random_grids(40, seed=8))
def test_the_droop_feeds_back_at_most_the_square_of_the_damping(grid: tuple[float, float, float, float]) -> None:
    """On any grid, with any droop, and with gains of a grid that is not there: the bound knows the poles alone."""
    P, Q, R, X = grid
    rng = np.random.default_rng(int(1e3 * X))
    J = jacobian_from_powers(P, Q, V_N, R, X)
    for normalised, bound in ((WHOLE, D_1**2 / (4.0 * K_1)), (WHOLE._replace(d_1_or_zeta=3.0), 9.0 / (4.0 * K_1))):
        for D_p in 10.0 ** rng.uniform(0.0, 5.0, 30):
            gains = angle_damped_gains(*J, normalised, D_p, 90.0, *POLES)
            assert gains.k_P * gains.D_p <= bound * (1.0 + 1e-12)
    inertial = angle_damped_gains(*J, NormalisedGains(3.0, 0.9, 4.0, 0.0, 1.0, 1.0), 318.0, 90.0, 5e3, OMEGA_0, True)
    assert inertial.k_P * 318.0 <= 0.81


def test_the_transfer_is_finite_where_the_droop_feeds_everything_back() -> None:
    old = angle_damped_gains(*WEAK, WHOLE, 318.0, 90.0, *POLES)
    singular = old._replace(k_P=1.0 / old.D_p)
    assert np.isfinite(gain_transfer(320.0, REFS, singular, old))
    assert np.isfinite(gain_transfer(320.0, REFS, old, singular))


INERTIA = NormalisedGains(2.5, 0.7, 4.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("share_P", "share_Q"), [(0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.6, 0.3)])
@pytest.mark.parametrize("grid", random_grids(3, seed=3))
def test_a_frequency_ramp_asks_for_the_power_of_the_inertia_constant(
    grid: tuple[float, float, float, float], share_P: float, share_Q: float
) -> None:
    """2HS/ω_0 per rad/s², from the nonlinear equations on a slow ramp, run until it is settled."""
    P, Q, R, X = grid
    V_0, delta_0 = (float(value) for value in operating_point(P, Q, V_N, R, X))
    J = jacobian_from_powers(P, Q, V_0, R, X)
    S, slope, D_q = 5e3, 0.02, 50.0
    normalised = INERTIA._replace(share_P=share_P, share_Q=share_Q)
    gains = angle_damped_gains(*J, normalised, 0.0, D_q, S, OMEGA_0, True)
    omega_i = OMEGA_0 + gains.k_P * P + gains.k_Q * (Q + D_q * V_0)
    refs = References(P, Q - D_q * (V_N - V_0), OMEGA_0, V_N)

    def rates(t: float, x: NDArray[np.float64]) -> list[float]:
        omega, domega, dV = power_loops(x[1], x[2], *power_flow(x[0], x[2], V_N, R, X), refs, gains)
        return [omega - OMEGA_0 - slope * t, domega, dV]

    slowest = -closed_loop(P, Q, R, X, gains).real.max()
    assert slowest > 0.3  # these grids are stable also without decoupling
    end = solve_ivp(rates, (0.0, 20.0 / slowest), [delta_0, omega_i, V_0], method="Radau", rtol=1e-10, atol=1e-10)
    fallen = P - power_flow(end.y[0, -1], end.y[2, -1], V_N, R, X)[0]
    # The ramp takes 2 % of rating: the Jacobian changes by a few tenths of a percent on the way.
    assert fallen == pytest.approx(2.0 * 2.5 * S / OMEGA_0 * slope, rel=5e-3)


def test_the_inertia_law_has_the_damping_ratio_it_says() -> None:
    J = (8348.0, 91.9, -4840.0, 68.7)
    gains = decoupled_gains(*J, INERTIA, 0.0, 0.0, 5e3, OMEGA_0, True)
    # δ alone: s² + K_ip D_p s + K_ip A.
    omega_n = np.sqrt(gains.K_ip * J[0])
    assert gains.K_ip * gains.D_p / (2.0 * omega_n) == pytest.approx(0.7, rel=1e-12)
    assert gains.K_ip == pytest.approx(OMEGA_0 / (2.0 * 2.5 * 5e3), rel=1e-12)
