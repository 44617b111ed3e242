"""CasADi's Jacobian of the power flow against complex steps, and the tracing switch."""

from __future__ import annotations

import threading

import casadi as ca
import numpy as np
import pytest

from vsgdesign.linear.model import jacobian, power_flow_function
from vsgdesign.linear.model.power_loops import numpy_on_symbols

STEP = 1e-30
"""A complex step has no cancellation: its error is the square of the step."""


def complex_power(delta: complex, V: complex, V_g: float, R: float, X: float) -> tuple[complex, complex]:
    """P and Q from real and imaginary parts of V∠δ·conj((V∠δ − V_g)/Z), written out to stay analytic."""
    re, im = V * np.cos(delta), V * np.sin(delta)
    Z_sq = R * R + X * X
    i_re, i_im = ((re - V_g) * R + im * X) / Z_sq, (im * R - (re - V_g) * X) / Z_sq
    return 3.0 * (re * i_re + im * i_im), 3.0 * (im * i_re - re * i_im)


def complex_step(delta: float, V: float, V_g: float, R: float, X: float) -> np.ndarray:
    by_delta = complex_power(delta + 1j * STEP, V, V_g, R, X)
    by_V = complex_power(delta, V + 1j * STEP, V_g, R, X)
    return np.array([[by_delta[k].imag, by_V[k].imag] for k in range(2)]) / STEP


def random_points(count: int) -> np.ndarray:
    """(δ, V, V_g, R, X) over ratings from 50 V to 20 kV, SCR 1 to 50 and X/R 0.1 to 20."""
    rng = np.random.default_rng(6)
    V_g = 50.0 * 400.0 ** rng.random(count)
    Z = 10.0 ** rng.uniform(-2.0, 2.0, count)
    angle = np.arctan(10.0 ** rng.uniform(-1.0, 1.3, count))
    V = V_g * rng.uniform(0.5, 1.5, count)
    return np.column_stack([rng.uniform(-1.2, 1.2, count), V, V_g, Z * np.cos(angle), Z * np.sin(angle)])


def test_jacobian_against_complex_step() -> None:
    for point in random_points(300):
        exact = complex_step(*point)
        # Relative to the largest entry of a row: an entry may pass through zero.
        error = np.abs(jacobian(*point) - exact) / np.abs(exact).max(axis=1, keepdims=True)
        assert error.max() < 1e-10


def test_powers_against_phasors() -> None:
    for delta, V, V_g, R, X in random_points(100):
        v = V * np.exp(1j * delta)
        S = 3.0 * v * np.conj((v - V_g) / complex(R, X))
        P, Q, _ = power_flow_function()(delta, V, V_g, R, X)
        assert complex(float(P), float(Q)) == pytest.approx(S, abs=1e-11 * 3.0 * V * V_g / np.hypot(R, X))


def test_check_vector_of_the_authors_model() -> None:
    """A and D at P = 4.5 kW, Q = 1 kvar, given with nine digits; V and δ from the same point."""
    R, X = 3.64097929, 3.64422703
    # Solve for the point independently: V∠δ = V_g + Z·conj(S/(3V∠δ)), fixed point from above.
    v = complex(150.0, 30.0)
    for _ in range(500):
        v = 110.0 + complex(R, X) * np.conj(complex(4500.0, 1000.0) / (3.0 * v))
    J = jacobian(float(np.angle(v)), abs(v), 110.0, R, X)
    assert J[0, 0] == pytest.approx(8348.21665, rel=1e-8)
    assert J[1, 1] == pytest.approx(68.6969676, rel=1e-8)


def test_the_published_form_puts_C_over_a_voltage_where_D_belongs() -> None:
    point = (0.26, 150.0, 110.0, 3.63, 3.63)
    exact, published = jacobian(*point), jacobian(*point, form="published")
    np.testing.assert_array_equal(published[0], exact[0])
    assert published[1, 0] == exact[1, 0]
    assert published[1, 1] == pytest.approx(exact[1, 0], rel=1e-12)  # the printed D is C
    assert abs(published[1, 1] - exact[1, 1]) > abs(exact[1, 1])


def test_an_unknown_form_is_refused() -> None:
    with pytest.raises(ValueError, match='"exact" or "published"'):
        jacobian(0.1, 110.0, 110.0, 1.0, 1.0, form="printed")


@pytest.mark.parametrize("mode", [0, 1])
def test_numpy_mode_is_put_back(mode: int) -> None:
    before = ca.GlobalOptions.getNumpyMode()
    try:
        ca.GlobalOptions.setNumpyMode(mode)
        with numpy_on_symbols():
            assert ca.GlobalOptions.getNumpyMode() == 1
            assert str(np.sin(ca.SX.sym("x"))) == "sin(x)"
        assert ca.GlobalOptions.getNumpyMode() == mode
        with pytest.raises(RuntimeError, match="inside"), numpy_on_symbols():
            raise RuntimeError("inside")
        assert ca.GlobalOptions.getNumpyMode() == mode
    finally:
        ca.GlobalOptions.setNumpyMode(before)


def test_two_threads_do_not_put_back_each_others_mode() -> None:
    """As when a server traces two models at once: the first that is ready must not end the other's block."""
    entered, leave, inside, seen = threading.Event(), threading.Event(), threading.Event(), []

    def first() -> None:
        with numpy_on_symbols():
            entered.set()
            leave.wait(60.0)

    def second() -> None:
        with numpy_on_symbols():
            inside.set()
            threads[0].join(60.0)
            seen.append(ca.GlobalOptions.getNumpyMode())

    threads = [threading.Thread(target=target) for target in (first, second)]
    threads[0].start()
    assert entered.wait(60.0)
    threads[1].start()
    inside.wait(0.05)
    leave.set()
    for thread in threads:
        thread.join(60.0)
    assert seen == [1]


def test_tracing_leaves_the_mode_of_a_fresh_interpreter() -> None:
    before = ca.GlobalOptions.getNumpyMode()
    power_flow_function.cache_clear()
    jacobian(0.1, 110.0, 110.0, 1.0, 1.0)
    assert ca.GlobalOptions.getNumpyMode() == before
