"""Inertia and droop of a swing equation whose response to a ramp is known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from vsgdesign.metrics.oscillation import fit_ramp

STEP_S = 5e-4
F_N = 50.0


def ramp_response(H: float, D: float, K: float, lag_s: float) -> tuple[np.ndarray, np.ndarray]:
    """P and the own frequency, per unit of f_n, of 2H dω/dt = −P_f − D ω with P = K δ, dδ/dt = ω_n (ω − ω_g) and a
    filter lag·dP_f/dt = P − P_f, for a grid that falls by 1 Hz in 1 s after 0.1 s."""
    omega_n = 2.0 * math.pi * F_N
    t = STEP_S * np.arange(4200)
    ramp = -np.clip(t - 0.1, 0.0, 1.0) / F_N
    A = np.array([[-D / (2 * H), 0.0, -1.0 / (2 * H)], [omega_n, 0.0, 0.0], [0.0, K / lag_s, -1.0 / lag_s]])
    B = np.array([[0.0], [-omega_n], [0.0]])
    y = lsim(StateSpace(A, B, np.eye(3), np.zeros((3, 1))), ramp, t)[1]
    return K * y[:, 1], y[:, 0]


@pytest.mark.parametrize(("H", "D"), [(5.0, 20.0), (2.0, 100.0), (10.0, 0.0), (0.5, 33.3)])
def test_inertia_and_droop_of_a_swing_equation(H: float, D: float) -> None:
    """No rest is reached within the ramp, and the filter's delay of 5 ms is taken out."""
    P, f = ramp_response(H, D, 3.0, 5e-3)
    nothing = np.zeros_like(P)
    found = fit_ramp(0.5 + P, nothing, nothing, F_N * (1.0 + f), STEP_S, F_N, 40, (0.5, F_N), 5e-3)
    assert found is not None
    assert found.H_s == pytest.approx(H, rel=5e-3)
    assert found.D_pu == pytest.approx(D, abs=0.02)
    assert found.misfit < 1e-4


def test_nothing_moves() -> None:
    rest = np.full(500, 0.5)
    assert fit_ramp(rest, rest, rest, np.full(500, F_N), STEP_S, F_N, 40, (0.5, F_N)) is None
    assert fit_ramp(rest[:9], rest[:9], rest[:9], rest[:9], STEP_S, F_N, 40, (0.5, F_N)) is None


def test_a_power_that_does_not_follow_the_frequency_has_a_large_misfit() -> None:
    P, f = ramp_response(5.0, 20.0, 3.0, 5e-3)
    held = np.clip(P, -0.1, 0.1)
    nothing = np.zeros_like(P)
    found = fit_ramp(held, nothing, nothing, F_N * (1.0 + f), STEP_S, F_N, 40, (0.0, F_N))
    assert found is not None
    assert found.misfit > 0.02
