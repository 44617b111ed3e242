"""Inner loops, power loops, filter and grid: each against the definition in complex numbers."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsgdesign.equations.grid import (
    FilterGrid,
    capacitor_node_voltage,
    filter_grid_derivative,
    grid_from_scr_impedance,
    grid_from_scr_reactance,
    pcc_voltage,
    scr_impedance,
    scr_reactance,
)
from vsgdesign.equations.inner_loops import (
    InnerLoopGains,
    current_loop,
    limit_length,
    predicted_current,
    transient_impedance,
    voltage_integrators,
    voltage_loop,
)
from vsgdesign.equations.integration import low_pass_share
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops

COMPONENT = st.floats(-1e3, 1e3)
CIRCUIT = FilterGrid(L_1=2e-3, R_1=0.05, C=20e-6, R_c=2.0, L_2=0.5e-3, R_2=0.02, R_g=0.8, L_g=5e-3)
GAINS = InnerLoopGains(K_pv=0.05, K_iv=15.0, K_pc=10.0, K_ic=3e4, K_ff=0.8)
T_S = 50e-6


@given(st.floats(1e-5, 10.0), st.integers(1, 1000))
def test_a_low_pass_filter_goes_its_way_in_equal_shares(tau: float, samples: int) -> None:
    """After n samples exp(−n T_s/τ) of the way is left, and without a filter nothing."""
    left = math.prod([1.0 - low_pass_share(tau, T_S)] * samples)
    assert left == pytest.approx(math.exp(-samples * T_S / tau), rel=1e-10, abs=1e-300)
    assert low_pass_share(0.0, T_S) == 1.0


@given(COMPONENT, COMPONENT, st.floats(1e-3, 1e3))
def test_limit_length_keeps_direction(x: float, y: float, limit: float) -> None:
    short = complex(*limit_length(x, y, limit))
    length = abs(complex(x, y))
    assert abs(short) <= limit * (1.0 + 1e-15 * 4.0)
    expected = complex(x, y) if length <= limit else complex(x, y) * (limit / length)
    assert short == pytest.approx(expected, rel=1e-14, abs=1e-300)


def test_limit_length_has_a_derivative_at_zero() -> None:
    """Complex step through the origin: the root is never taken of zero."""
    step = 1e-30
    x, _ = limit_length(np.complex128(complex(0.0, step)), np.complex128(0.0), 5.0)
    assert x.imag / step == pytest.approx(1.0)


def pi_step(wanted: complex, error: complex, xi: complex, limit: float, K_p: float, K_i: float) -> tuple:
    out = wanted if abs(wanted) <= limit else wanted / abs(wanted) * limit
    return out, xi + T_S * K_i * (error - (wanted - out) / K_p)


@given(COMPONENT, COMPONENT, COMPONENT, COMPONENT, COMPONENT, COMPONENT, st.floats(1.0, 2e3), st.floats(1.0, 500.0))
def test_inner_loops_in_complex_numbers(
    a: float, b: float, c: float, d: float, e: float, f: float, limit: float, v_ref: float
) -> None:
    first, second, xi = complex(a, b), complex(c, d), complex(e, f)
    drop = complex(0.3 * d, -0.2 * a)
    error = v_ref - drop - first
    wanted = GAINS.K_pv * error + xi + GAINS.K_ff * second + 1j * 0.0063 * first
    out, xi_next = pi_step(wanted, error, xi, limit, GAINS.K_pv, GAINS.K_iv)
    e_d, e_q, want_d, want_q = voltage_loop(v_ref, drop.real, drop.imag, a, b, c, d, e, f, GAINS, 0.0063)
    i_ref = limit_length(want_d, want_q, limit)
    result = (*i_ref, *voltage_integrators(e_d, e_q, i_ref[0] - want_d, i_ref[1] - want_q, e, f, GAINS, T_S))
    # The sums have terms of up to 5e4 (K_p·error), so 1e-10 is a few roundings of the largest.
    assert result == pytest.approx((out.real, out.imag, xi_next.real, xi_next.imag), abs=1e-10)

    reference = complex(v_ref, -0.5 * v_ref)
    error = reference - first
    wanted = GAINS.K_pc * error + xi + second + 1j * 0.31 * first
    out, xi_next = pi_step(wanted, error, xi, limit, GAINS.K_pc, GAINS.K_ic)
    result = current_loop(v_ref, -0.5 * v_ref, a, b, c, d, 7.0, -9.0, e, f, GAINS, 0.31, 0.05, limit, T_S)
    assert result == pytest.approx((out.real, out.imag, xi_next.real, xi_next.imag), abs=1e-10)


def test_anti_windup_brings_the_integrator_to_the_limit_and_no_further() -> None:
    """A constant unreachable reference: the limited output settles on the limit, the integrator stays bounded."""
    xi_d = xi_q = out_d = out_q = 0.0
    for _ in range(20000):
        e_d, e_q, want_d, want_q = voltage_loop(300.0, 0.0, 0.0, 100.0, 0.0, 0.0, 0.0, xi_d, xi_q, GAINS, 0.0)
        out_d, out_q = limit_length(want_d, want_q, 20.0)
        xi_d, xi_q = voltage_integrators(e_d, e_q, out_d - want_d, out_q - want_q, xi_d, xi_q, GAINS, T_S)
    assert math.hypot(out_d, out_q) == pytest.approx(20.0, rel=1e-12)
    # At rest the unwinding equals the error: wanted = limit + K_pv·error, so xi = the limit itself.
    assert xi_d == pytest.approx(20.0, rel=1e-9)


def test_power_loops_say_what_is_printed() -> None:
    gains, refs = PowerLoopGains(0.0077, 2087.0, 0.115, 0.69), References(3000.0, 500.0, 314.0, 110.0)
    omega, domega_dt, dV_dt = power_loops(313.5, 112.0, 2800.0, 650.0, refs, gains)
    assert omega == 313.5
    assert domega_dt == pytest.approx(0.0077 * (200.0 + 2087.0 * 0.5), rel=1e-14)
    assert dV_dt == pytest.approx(0.115 * (-150.0 - 0.69 * 2.0), rel=1e-13)


def test_the_filter_at_standstill_is_an_impedance_network() -> None:
    """Solve the network by node voltages at 50 Hz; the derivative must then be jω times the state."""
    omega, v_b, v_g, f = 2.0 * math.pi * 50.0, 160.0 + 25.0j, 155.0 - 3.0j, CIRCUIT
    Z_1, Z_c = f.R_1 + 1j * omega * f.L_1, f.R_c + 1.0 / (1j * omega * f.C)
    Z_2, Z_g = f.R_2 + 1j * omega * f.L_2, f.R_g + 1j * omega * f.L_g
    v_node = (v_b / Z_1 + v_g / (Z_2 + Z_g)) / (1.0 / Z_1 + 1.0 / Z_c + 1.0 / (Z_2 + Z_g))
    i_s, i_g = (v_b - v_node) / Z_1, (v_node - v_g) / (Z_2 + Z_g)
    v_c = v_node - f.R_c * (i_s - i_g)
    derivative = filter_grid_derivative(i_s, v_c, i_g, v_b, v_g, f)
    for rate, state in zip(derivative, (i_s, v_c, i_g), strict=True):
        assert rate == pytest.approx(1j * omega * state, rel=1e-11)
    assert capacitor_node_voltage(i_s, v_c, i_g, f) == pytest.approx(v_node, rel=1e-13)
    assert pcc_voltage(i_s, v_c, i_g, v_g, f) == pytest.approx(v_g + Z_g * i_g, rel=1e-13)


@given(COMPONENT, COMPONENT, COMPONENT, COMPONENT)
def test_pcc_voltage_off_standstill(i_s: float, v_c: float, i_g: float, v_g: float) -> None:
    """v_pcc = v_g + R_g i_g + L_g di_g/dt, whatever the instant."""
    di_g = filter_grid_derivative(i_s, v_c, i_g, 0.0, v_g, CIRCUIT)[2]
    expected = v_g + CIRCUIT.R_g * i_g + CIRCUIT.L_g * di_g
    assert pcc_voltage(i_s, v_c, i_g, v_g, CIRCUIT) == pytest.approx(expected, abs=1e-9)
    bare = CIRCUIT._replace(L_2=0.0, R_2=0.0)
    node = capacitor_node_voltage(i_s, v_c, i_g, bare)
    assert pcc_voltage(i_s, v_c, i_g, v_g, bare) == pytest.approx(node, abs=1e-9)


def test_energy_balance_of_the_circuit() -> None:
    """What the bridge gives and the source takes is stored or burnt: d/dt(½LI² + ½CV²) at random states."""
    rng, f = np.random.default_rng(3), CIRCUIT
    for i_s, v_c, i_g, v_b, v_g in rng.uniform(-200.0, 200.0, (50, 5)):
        di_s, dv_c, di_g = filter_grid_derivative(i_s, v_c, i_g, v_b, v_g, f)
        stored = f.L_1 * i_s * di_s + f.C * v_c * dv_c + (f.L_2 + f.L_g) * i_g * di_g
        burnt = f.R_1 * i_s**2 + (f.R_2 + f.R_g) * i_g**2 + f.R_c * (i_s - i_g) ** 2
        assert v_b * i_s - v_g * i_g == pytest.approx(stored + burnt, abs=1e-9 * 200.0**2)


@pytest.mark.parametrize("x_over_r", [0.05, 1.0, 12.0])
@pytest.mark.parametrize("scr", [0.8, 2.0, 20.0])
def test_short_circuit_ratio_is_a_ratio_of_currents(scr: float, x_over_r: float) -> None:
    """Short-circuit current over rated current, both in amperes, for 5 kVA at 110 V."""
    omega, Z_base, rated = 314.0, 3.0 * 110.0**2 / 5000.0, 5000.0 / 330.0
    R, L = grid_from_scr_impedance(scr, x_over_r, Z_base, omega)
    assert abs(110.0 / complex(R, omega * L)) / rated == pytest.approx(scr, rel=1e-13)
    assert omega * L / R == pytest.approx(x_over_r, rel=1e-13)
    assert scr_impedance(R, L, Z_base, omega) == pytest.approx(scr, rel=1e-13)
    R, L = grid_from_scr_reactance(scr, x_over_r, Z_base, omega)
    assert 110.0 / (omega * L) / rated == pytest.approx(scr, rel=1e-13)
    assert omega * L / R == pytest.approx(x_over_r, rel=1e-13)
    assert scr_reactance(R, L, Z_base, omega) == pytest.approx(scr, rel=1e-13)


def test_rotating_the_frame_rotates_the_loops() -> None:
    """Nothing in the loops prefers an axis: a turned input gives a turned output (v_ref apart)."""
    turn = cmath.exp(0.9j)
    v, i_g, xi, drop = 20.0 - 5.0j, 3.0 + 4.0j, 1.0 + 0.5j, 2.0 - 1.0j

    def loop(v: complex, i_g: complex, xi: complex, drop: complex) -> complex:
        parts = (part for x in (drop, v, i_g, xi) for part in (x.real, x.imag))
        wanted = voltage_loop(0.0, *parts, gains=GAINS, omega_C=0.1)[2:]
        return complex(*limit_length(*wanted, 2.0))

    turned = loop(v * turn, i_g * turn, xi * turn, drop * turn)
    assert turned == pytest.approx(loop(v, i_g, xi, drop) * turn, rel=1e-14)


def test_the_transient_impedance_forgets_a_constant_current() -> None:
    """A step of current meets Z_t at once, Z_t/e after the low-pass's time constant, and nothing in the end."""
    Z_t, tau, i_g = 0.5 - 0.3j, 40 * T_S, 8.0 - 6.0j
    gains = GAINS._replace(R_t=Z_t.real, X_t=Z_t.imag)
    i_f, drops = 0j, []
    for _ in range(2001):
        *drop, d, q = transient_impedance(i_g.real, i_g.imag, i_f.real, i_f.imag, gains, -math.expm1(-T_S / tau))
        i_f = complex(d, q)
        drops.append(complex(*drop))
    assert drops[0] == pytest.approx(Z_t * i_g, rel=1e-15)
    assert drops[40] == pytest.approx(Z_t * i_g / math.e, rel=1e-12)
    assert abs(drops[2000]) < 1e-12


@given(COMPONENT, COMPONENT, COMPONENT, COMPONENT, COMPONENT, COMPONENT)
def test_a_prediction_of_nothing_is_the_current_to_the_bit(
    a: float, b: float, c: float, d: float, e: float, f: float
) -> None:
    assert predicted_current(a, b, c, d, e, f, 0.0, 0.31, 0.05) == (a, b)


@pytest.mark.parametrize("omega", [2.0 * math.pi * 50.0, 2.0 * math.pi * 60.0])
def test_a_whole_period_is_predicted_to_second_order(omega: float) -> None:
    """Against the exact current of an inductor in the turning frame, u and v constant there: what is left of one
    forward Euler step falls with the square of the period.
    """
    L, i, v, u = 2e-3, 12.0 - 5.0j, 140.0 + 8.0j, 155.0 - 3.0j

    def error(T: float) -> float:
        rest = (u - v) / (1j * omega * L)
        exact = rest + (i - rest) * cmath.exp(-1j * omega * T)
        found = predicted_current(i.real, i.imag, v.real, v.imag, u.real, u.imag, 1.0, omega * L, T / L)
        return abs(complex(*found) - exact)

    assert error(100e-6) < 0.05
    assert error(100e-6) / error(50e-6) == pytest.approx(4.0, rel=0.02)
