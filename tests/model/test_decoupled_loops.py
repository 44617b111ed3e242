"""The linearised power loops against the transfer functions that the paper prints."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.model import LoopMatrices, decoupled_loops

GAINS = PowerLoopGains(K_ip=0.00767, D_p=2087.0, K_iq=0.115, D_q=0.687)
"""Table II."""

A, D = 8348.21665, 68.6969676

S_POINTS = [0.3j, 2.0j, 4.0 + 1.0j, 50.0j, -1.0 + 3.0j]


def transfer(loop: LoopMatrices, s: complex) -> complex:
    """c (sI − A)⁻¹ b."""
    return complex((loop.c @ np.linalg.solve(s * np.eye(len(loop.A)) - loop.A, loop.b)).item())


def closed(open_: complex) -> complex:
    return open_ / (1.0 + open_)


@pytest.mark.parametrize("s", S_POINTS)
def test_P_loop(s: complex) -> None:
    """K_ip A/(s² + D_p K_ip s + K_ip A)."""
    loop, _ = decoupled_loops(GAINS, A, D)
    K, damping = GAINS.K_ip * A, GAINS.D_p * GAINS.K_ip
    assert transfer(loop, s) == pytest.approx(K / (s * (s + damping)), rel=1e-13)
    assert closed(transfer(loop, s)) == pytest.approx(K / (s * s + damping * s + K), rel=1e-12)


@pytest.mark.parametrize("s", S_POINTS)
def test_Q_loop(s: complex) -> None:
    """K_iq D/(s + K_iq (D + D_q))."""
    _, loop = decoupled_loops(GAINS, A, D)
    assert transfer(loop, s) == pytest.approx(GAINS.K_iq * D / (s + GAINS.K_iq * GAINS.D_q), rel=1e-13)
    assert closed(transfer(loop, s)) == pytest.approx(GAINS.K_iq * D / (s + GAINS.K_iq * (D + GAINS.D_q)), rel=1e-12)


def test_the_droop_is_in_the_Q_loops_gain_at_rest() -> None:
    """Closed at s = 0 the Q loop gives D/(D + D_q), not one: the paper's droop leaves 1 % of a step."""
    _, loop = decoupled_loops(GAINS, A, D)
    assert closed(transfer(loop, 0.0)) == pytest.approx(D / (D + GAINS.D_q), rel=1e-13)


@pytest.mark.parametrize("seed", range(5))
def test_poles_against_python_control(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gains = PowerLoopGains(*(base * 10.0 ** rng.uniform(-1.0, 1.0) for base in GAINS))
    A_here, D_here = A * 10.0 ** rng.uniform(-0.5, 1.0), D * 10.0 ** rng.uniform(-0.5, 1.0)
    loop_P, loop_Q = decoupled_loops(gains, A_here, D_here)
    s: Any = control.tf("s")
    K = gains.K_ip * A_here
    expected = {
        "P": K / (s * s + gains.D_p * gains.K_ip * s + K),
        "Q": gains.K_iq * D_here / (s + gains.K_iq * (D_here + gains.D_q)),
    }
    for loop, reference in ((loop_P, expected["P"]), (loop_Q, expected["Q"])):
        poles = np.sort_complex(np.linalg.eigvals(loop.A - loop.b @ loop.c))
        np.testing.assert_allclose(poles, np.sort_complex(reference.poles()), rtol=1e-9)


def test_both_loops_are_stable_where_the_paper_puts_them() -> None:
    """ω_n = 8 rad/s and ξ = 1 (the 0.5 s design): a double pole at −8, and −8 for Q."""
    loop_P, loop_Q = decoupled_loops(GAINS, A, D)
    poles = np.linalg.eigvals(loop_P.A - loop_P.b @ loop_P.c)
    # Rounded to three digits, the gains part a double pole by √(1e-3).
    np.testing.assert_allclose(poles, -8.0, atol=8.0 * 0.04)
    assert (loop_Q.A - loop_Q.b @ loop_Q.c).item() == pytest.approx(-8.0, rel=5e-3)
