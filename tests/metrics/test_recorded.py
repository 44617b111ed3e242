"""A measured step: the mean is as long as its noise asks for, and too small a step is refused with the one needed."""

from __future__ import annotations

import math

import numpy as np
import pytest

import vsgdesign as vd

T = np.arange(0.0, 14.0, 1e-3)
AT, TAU = 4.0, 0.2


def measured(size: float, rms: float) -> np.ndarray:
    """A first-order step from 1 kW, with white noise of ``rms`` in the mean of a cycle of 50 Hz."""
    since = np.maximum(T - AT, 0.0)
    noise = rms * math.sqrt(20.0) * np.random.default_rng(3).standard_normal(T.size)
    return 1000.0 + size * (1.0 - np.exp(-since / TAU)) + noise


@pytest.mark.parametrize(("rms", "cycles"), [(0.0, 1), (1.0, 1), (2.2, 4), (6.0, 32)])
def test_the_mean_is_as_long_as_the_noise_asks_for(rms: float, cycles: int) -> None:
    """Four times the noise within half the band of 2 %: 4 · 2.2/√n ≤ 5 W from n = 4 on."""
    found = vd.step_figures(T, measured(500.0, rms), at=AT)
    assert found.cycles == cycles
    late_s = 0.5 * cycles / 50.0
    assert found.settling_time_s == pytest.approx(TAU * math.log(50.0) + late_s, abs=0.02 + 0.5 * late_s)
    assert found.final - found.initial == pytest.approx(500.0, abs=1.0 + 0.2 * rms)
    assert found.noise.rest == pytest.approx(rms, rel=0.2)
    assert found.overshoot_pct <= 100.0 * found.noise.share + 1e-9
    assert found.noise.share <= 0.0113  # 4.5 times what four times fits into half the band


def test_a_step_that_is_too_small_is_refused_with_the_one_needed() -> None:
    y = measured(40.0, 5.0)
    with pytest.raises(vd.VsgDesignError, match="too small for its noise: a step of at least") as refused:
        vd.step_figures(T, y, at=AT)
    least = float(str(refused.value).split("at least ")[1].split()[0])
    assert least == pytest.approx(400.0 * 5.0 / math.sqrt(32.0), rel=0.4)  # 64 cycles fit three times only
    assert vd.step_figures(T, y + np.where(T > AT, 1.02 * least, 0.0), at=AT).cycles == 32


def test_what_moves_on_is_not_settled_and_ringing_shows() -> None:
    y = measured(500.0, 0.5)
    drift = vd.step_figures(T, y + 20.0 * np.maximum(T - AT, 0.0), at=AT)
    assert drift.settling_time_s is None or drift.settling_time_s > 8.0
    ring = np.where(T > AT, 30.0 * np.exp(-0.1 * (T - AT)) * np.sin(2.0 * math.pi * 1.5 * T), 0.0)
    settled = vd.step_figures(T, y + ring, at=AT).settling_time_s
    assert settled is None or settled > 8.0


def test_faults_of_the_arguments_are_told_together() -> None:
    y = measured(500.0, 0.0)
    for t, P, at, f_hz, said in (
        (T, y[:-1], AT, 50.0, "same length"),
        (T, np.where(T > 9.0, np.nan, y), AT, 50.0, "no number"),
        (T**2, y, AT, 50.0, "equal steps"),
        (10.0 * T, y, AT, 50.0, "ten values a cycle"),
        (T, y, 0.01, 50.0, "four cycles of rest"),
        (T, y, AT, 0.0, "above zero"),
    ):
        with pytest.raises(vd.VsgDesignError, match=said):
            vd.step_figures(t, P, at=at, f_hz=f_hz)
