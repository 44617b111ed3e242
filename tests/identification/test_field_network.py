"""The learned part as it runs: its outputs, its gate and its fusion, each against an independent computation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.artifacts.field_networks import random_field_weights
from vsgdesign.equations.field.fusion import (
    CHI_SQUARE_95,
    FIRST_GATE,
    GateLimits,
    Posterior,
    fused_impedance,
    may_speak,
    next_gate,
    posterior_distance,
)
from vsgdesign.errors import ArtifactError
from vsgdesign.identification.field import field_network

LIMITS = GateLimits(first=4.0, first_refuted=2.0, last=6.0, confident=0.15)


def test_folded_network_gives_the_same_numbers() -> None:
    weights = random_field_weights()
    layers, x = weights.layers, np.array([0.3, -2.0, 1.0])
    hidden = np.tanh(layers.W_1 @ ((x - layers.mean) / layers.deviation) + layers.b_1)
    expected = layers.W_3 @ np.tanh(layers.W_2 @ hidden + layers.b_2) + layers.b_3
    network = field_network(weights, weights.features)
    assert network.posterior(x.tolist()) == pytest.approx(expected, rel=1e-13, abs=1e-14)


def test_other_features_are_refused_by_name() -> None:
    weights = random_field_weights()
    with pytest.raises(ArtifactError, match=r"they lack current; they also take doubt.*Train again"):
        field_network(weights, ("size", "angle", "current"))
    with pytest.raises(ArtifactError, match="in another order"):
        field_network(weights, ("angle", "size", "doubt"))


def opened(events: list[int], refuted: float) -> list[int]:
    """Cycles in which the gate is open, when events are flagged in some of 20 cycles."""
    gate, found = FIRST_GATE, []
    for k in range(20):
        gate = next_gate(gate, 1.0 if k in events else 0.0)
        if may_speak(gate, refuted, LIMITS) > 0.5:
            found.append(k)
    return found


def test_gate() -> None:
    assert opened([], 0.0) == []
    assert opened([], 1.0) == []
    assert opened([5], 0.0) == [9, 10, 11]
    assert opened([5], 1.0) == [7, 8, 9, 10, 11]
    # A second event closes it again.
    assert opened([5, 10], 0.0) == [9, 14, 15, 16]


def test_fusion_is_that_of_many_samples() -> None:
    """Mean and covariance of Z = Ẑ e^y against 400,000 samples of a y that is small enough for first order."""
    posterior = Posterior(0.2, -0.3, math.log(0.01), math.log(0.02), 0.7)
    radius_squared = 1.5 * CHI_SQUARE_95
    fused = fused_impedance(0.1, 0.3, posterior, radius_squared)
    rng = np.random.default_rng(0)
    u, w = math.sqrt(1.5) * rng.standard_normal((2, 400_000))
    size = 0.2 + 0.01 * u
    angle = -0.3 + 0.7 * 0.01 * u + 0.02 * w
    Z = (0.1 + 0.3j) * np.exp(size + 1j * angle)
    assert pytest.approx(Z.real.mean(), rel=2e-3) == fused.R
    assert pytest.approx(Z.imag.mean(), rel=2e-3) == fused.X
    # Variances of 400,000 samples have a deviation of 0.2 %; second order adds a few 1e-4.
    covariance = np.cov(Z.real, Z.imag)
    largest = math.sqrt(covariance[0, 0] * covariance[1, 1])
    assert fused.var_R == pytest.approx(covariance[0, 0], rel=0.02)
    assert fused.var_X == pytest.approx(covariance[1, 1], rel=0.02)
    assert fused.cov_RX == pytest.approx(covariance[0, 1], abs=0.02 * largest)


def test_distance_of_the_held_estimate() -> None:
    """ln(Ẑ/Ẑ) = 0 lies 5 deviations from a mean that has moved by 5 deviations in size alone."""
    posterior = Posterior(0.05, 0.0, math.log(0.01), math.log(0.02), 0.0)
    assert fused_impedance(0.1, 0.3, posterior, CHI_SQUARE_95).distance == pytest.approx(25.0)
    assert posterior_distance(0.05, 0.04, posterior) == pytest.approx(4.0)


def test_an_absurd_answer_stays_finite() -> None:
    fused = fused_impedance(0.1, 0.3, Posterior(1e3, 50.0, 300.0, -300.0, 1.0), 6.0)
    assert np.isfinite(tuple(fused)).all()
    assert fused.var_R + fused.var_X > (0.15 * math.hypot(fused.R, fused.X)) ** 2
