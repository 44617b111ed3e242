"""The band of magnitude and angle against draws from the covariance."""

from __future__ import annotations

import numpy as np
import pytest

from vsgdesign.metrics.answers import answers_of, polar_band


def test_the_band_holds_95_percent_of_draws() -> None:
    rng = np.random.default_rng(5)
    Z, P = 1.2 + 0.9j, np.array([[2e-3, 8e-4], [8e-4, 1e-3]])
    draws = rng.multivariate_normal([Z.real, Z.imag], P, size=20000) @ np.array([1.0, 1j])
    answers = answers_of(
        [0.02],
        ([Z.real], [Z.imag]),
        ([Z.real], [Z.imag]),
        ([P[0, 0]], [P[0, 1]], [P[1, 1]]),
        [True],
        [False],
        omega_n=1.0,
        end_s=1.0,
    )
    band = polar_band(answers)
    within_size = np.mean(np.abs(np.abs(draws) - band.size) <= band.size_half)
    within_angle = np.mean(np.abs(np.angle(draws) - band.angle) <= band.angle_half)
    # 20,000 draws have a standard error of 0.15 points; the curvature of the polar form is of the same order.
    assert within_size == pytest.approx(0.95, abs=0.005)
    assert within_angle == pytest.approx(0.95, abs=0.005)
