"""The matrix pencil on signals made of known modes, without and with noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from vsgdesign.metrics.oscillation import dominant_oscillation, matrix_pencil

Array = NDArray[np.float64]

STEP_S = 5e-4
CYCLE_S = 0.02


def made(t: Array, *modes: tuple[float, float, float, float]) -> Array:
    """Σ a e^{σt} cos(2πft + φ) of (a, σ, f, φ)."""
    return np.sum([a * np.exp(s * t) * np.cos(2.0 * math.pi * f * t + p) for a, s, f, p in modes], axis=0)


def damping(sigma: float, hz: float) -> float:
    return -sigma / math.hypot(sigma, 2.0 * math.pi * hz)


def test_poles_and_amplitudes_of_known_modes() -> None:
    t = 0.01 * np.arange(100, dtype=np.float64)
    found = matrix_pencil(made(t, (1.0, -2.0, 3.0, 0.3), (0.5, -1.0, 8.0, 1.0), (0.2, -4.0, 0.0, 0.0)), 0.01)
    upper = found.s.imag > 1.0
    order = np.argsort(found.s[upper].imag)
    expected = [complex(-2.0, 6.0 * math.pi), complex(-1.0, 16.0 * math.pi)]
    assert found.s[upper][order] == pytest.approx(expected, rel=1e-8)
    halves = [0.5 * np.exp(0.3j), 0.25 * np.exp(1.0j)]
    assert found.amplitude[upper][order] == pytest.approx(halves, rel=1e-8)
    assert found.misfit < 1e-10
    assert len(found.s) == 5


def test_a_constant_is_a_mode_at_zero() -> None:
    found = matrix_pencil(np.full(30, 2.5), 0.01)
    assert found.s == pytest.approx([0.0], abs=1e-10)
    assert found.amplitude == pytest.approx([2.5])


@pytest.mark.parametrize(
    ("sigma", "hz"), [(-0.5, 0.5), (-3.0, 2.0), (-8.0, 5.0), (-40.0, 20.0), (-5.0, 35.0), (0.3, 4.0), (-0.2, 0.15)]
)
def test_the_dominant_one_of_many(sigma: float, hz: float) -> None:
    """Its neighbours are half as large, faster in decay, or harmonics of the grid, which the cycle's mean takes out."""
    t = STEP_S * np.arange(round(max(3.0, 3.0 / hz) / STEP_S), dtype=np.float64)
    signal = made(t, (0.3, sigma, hz, 0.4), (0.03, -2.0, 0.0, 0.0), (0.1, -30.0, 50.0, 0.0), (0.05, 0.0, 100.0, 0.2))
    found = dominant_oscillation(signal, STEP_S, 0.1, 50.0, CYCLE_S)
    assert found is not None
    # What the cycle's mean leaves of the decaying part at 50 Hz is all that disturbs.
    assert found.hz == pytest.approx(hz, rel=0.01)
    assert found.damping == pytest.approx(damping(sigma, hz), abs=0.01)


def test_noise_of_one_per_cent() -> None:
    """Ten draws: the largest error of the damping ratio is below 0.01, as the Cramér–Rao bound of 0.002 lets expect."""
    t = STEP_S * np.arange(4000, dtype=np.float64)
    rng = np.random.default_rng(17)
    for _ in range(10):
        signal = made(t, (1.0, -3.0, 2.0, rng.uniform(0, 6.0))) + 0.01 * rng.standard_normal(t.size)
        found = dominant_oscillation(signal, STEP_S, 0.1, 50.0, CYCLE_S)
        assert found is not None
        assert found.hz == pytest.approx(2.0, rel=0.01)
        assert found.damping == pytest.approx(damping(-3.0, 2.0), abs=0.01)


def test_a_signal_that_only_decays_does_not_oscillate() -> None:
    t = STEP_S * np.arange(4000, dtype=np.float64)
    assert dominant_oscillation(np.exp(-3.0 * t) - 0.5 * np.exp(-8.0 * t), STEP_S, 0.1, 50.0, CYCLE_S) is None
    assert dominant_oscillation((1.0 + 4.0 * t) * np.exp(-4.0 * t), STEP_S, 0.1, 50.0, CYCLE_S) is None
    assert dominant_oscillation(made(t, (1.0, 0.0, 80.0, 0.0)), STEP_S, 0.1, 50.0, CYCLE_S) is None


def test_too_short_or_no_number() -> None:
    assert dominant_oscillation(np.ones(50), STEP_S, 0.1, 50.0, CYCLE_S) is None
    with pytest.raises(ValueError, match="at least six finite ones"):
        matrix_pencil(np.array([1.0, 2.0, math.nan, 1.0, 1.0, 1.0, 1.0]), 0.1)
