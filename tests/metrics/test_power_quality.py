"""Voltage between harmonics and ripple of power, on sums of sines."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vsgdesign.metrics.oscillation import interharmonic_rms, ripple_rms


@pytest.mark.parametrize(("nominal", "frequency"), [(50.0, 50.0), (50.0, 49.63), (60.0, 60.37)])
@pytest.mark.parametrize("step_s", [5e-5, 1.0 / 6000.0])
def test_a_line_between_harmonics_is_its_rms_value(nominal: float, frequency: float, step_s: float) -> None:
    t = np.arange(round(1.3 / step_s)) * step_s
    angle = 2.0 * math.pi * frequency * t
    x = 100.0 * np.cos(angle + 0.3) + 3.0 * np.sin(5.0 * angle) + 2.0 * np.cos(7.0 * angle) + 0.5
    x += 0.2 * np.cos(1.5 * angle + 1.0) + 0.1 * np.sin(2.5 * angle)
    # A window of not quite whole samples lets a thousandth of a harmonic through.
    assert interharmonic_rms(x, step_s, frequency, 1, nominal) == pytest.approx(0.2 / math.sqrt(2.0), rel=0.02)
    assert interharmonic_rms(x, step_s, frequency, 2, nominal) == pytest.approx(0.1 / math.sqrt(2.0), rel=0.04)
    assert interharmonic_rms(x, step_s, frequency, 3, nominal) < 0.004


def test_a_line_next_to_a_harmonic_is_the_harmonics() -> None:
    t = np.arange(20_000) * 5e-5
    near, off = (np.cos(2.0 * math.pi * (50.0 + d) * t) for d in (5.0, 10.0))
    assert interharmonic_rms(near, 5e-5, 50.0, 1) < 1e-3
    assert interharmonic_rms(off, 5e-5, 50.0, 1) == pytest.approx(1.0 / math.sqrt(2.0), rel=1e-3)


def test_a_sign_that_changes_keeps_its_power_between_the_harmonics() -> None:
    """Every 5 cycles another sign: the line spreads over bins, and their squares add up to nearly all of it."""
    t = np.arange(40_000) * 5e-5
    sign = np.where(np.floor(t / 0.1) % 4 < 2, 1.0, -1.0)
    x = sign * np.cos(2.0 * math.pi * 75.0 * t)
    assert interharmonic_rms(x, 5e-5, 50.0, 1) == pytest.approx(1.0 / math.sqrt(2.0), rel=0.05)


def test_too_short_a_record() -> None:
    with pytest.raises(ValueError, match=r"0\.1 s.*window has 0\.2 s"):
        interharmonic_rms(np.zeros(2000), 5e-5, 50.0, 1)


def test_ripple_is_about_the_mean() -> None:
    t = np.arange(1000) / 1000.0
    assert ripple_rms(7.0 + 0.3 * np.sin(2.0 * math.pi * 3.0 * t)) == pytest.approx(0.3 / math.sqrt(2.0))
