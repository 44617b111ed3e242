"""Onsets, arrivals and phasor changes of signals in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vsgdesign.metrics.step_response import first_time, onset, phasor_change


def test_onset_of_a_first_order_rise() -> None:
    t = 5e-4 * np.arange(200, dtype=np.float64)
    y = 0.7 * (1.0 - np.exp(-t / 0.01))
    largest = y[-1]
    expected = -0.01 * math.log(1.0 - 0.1 * largest / 0.7)
    assert onset(t, -y, 0.1) == pytest.approx(expected, abs=1e-5)  # chords: h²/(8τ)
    assert onset(t, np.zeros_like(t), 0.1) is None


def test_first_and_last_times() -> None:
    t = np.arange(10.0)
    assert first_time(t, t, 4.5) == pytest.approx(4.5)
    assert first_time(t, t, 20.0) is None
    assert first_time(t - 1.0, np.ones(10), 0.5) == 0.0


@pytest.mark.parametrize("hz", [50.0, 60.0])
def test_a_phasor_changes_in_spite_of_a_dc_component(hz: float) -> None:
    t = 5e-4 * np.arange(400, dtype=np.float64)
    w = 2.0 * math.pi * hz
    before, change, dc = 0.5 * np.exp(0.2j), 0.3 * np.exp(-1.0j), 0.2 + 0.1j
    late = t >= 0.1 - 1e-9
    z = (before + late * change) * np.exp(1j * w * t) + late * dc
    assert phasor_change(z, t, hz, 0.1, 0.0, 0.02) == pytest.approx(change, abs=1e-3 if hz == 60.0 else 1e-12)
    assert math.isnan(phasor_change(z[:203], t[:203], hz, 0.1, 0.0, 0.02).real)
