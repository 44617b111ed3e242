"""Signals made from phasors, where the answer is known to the last digit, and how an estimator is fed with them."""

from __future__ import annotations

import numpy as np

from vsgdesign.identification import Estimate, Estimator, Installation, Samples
from vsgdesign.identification.interface import ComplexArray

OMEGA = 100.0 * np.pi
H, N, W = 200e-6, 100, 40
V = 155.0
R_TRUE, L_TRUE = 0.9, 0.0029
GUESS = (1.2, 0.0037)

AT = Installation(T_s=50e-6, omega_n=OMEGA, V_base=V, Z_base=7.26, samples=N, sample_interval=H, cycles=1, guess=GUESS)


def z(omega: float) -> complex:
    """The true impedance at ω."""
    return R_TRUE + 1j * omega * L_TRUE


def windows_of(i: ComplexArray, v: ComplexArray, omega: float = OMEGA, count: int = N) -> list[Samples]:
    """Rotating signals as the windows of α and β that a controller measures."""
    turn = np.exp(1j * OMEGA * H * np.arange(len(i)))
    pairs = [np.array([(x * turn).real, (x * turn).imag], dtype=float) for x in (v, i)]
    return [
        Samples(
            pairs[0][:, k : k + count],
            pairs[1][:, k : k + count],
            omega,
            OMEGA * H * np.arange(k, k + count, dtype=float),
            np.zeros(count, dtype=complex),
        )
        for k in range(0, len(i), count)
    ]


def answers(estimator: Estimator, windows: list[Samples]) -> list[Estimate]:
    """What an estimator says of windows that follow each other."""
    state, found = estimator.first(), []
    for window in windows:
        state, answer = estimator.update(state, window)
        assert answer is not None
        found.append(answer)
    return found


def power_step() -> list[Samples]:
    """The current moves slowly from one value to another, the grid stands still; L di/dt included."""
    t = H * np.arange(W * N)
    share = 0.5 * (1.0 + np.tanh((t - 0.4) / 0.05))
    i = 12.0 + (3.0 - 1.0j) * share
    slope = (3.0 - 1.0j) * 0.5 / np.cosh((t - 0.4) / 0.05) ** 2 / 0.05
    return windows_of(i, V + z(OMEGA) * i + L_TRUE * slope)


def error(found: Estimate) -> float:
    """|Ẑ − Z|/|Z| at the fundamental."""
    return abs(found.R_g + 1j * OMEGA * found.L_g - z(OMEGA)) / abs(z(OMEGA))
