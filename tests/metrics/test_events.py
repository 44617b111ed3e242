"""Which samples an event's figures are taken from."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vsgdesign.metrics import EventMetrics, EventWindow, measure_event

DT = 2e-4
PER_CYCLE = 100
RATING = 5000.0
T = np.arange(30_000) * DT  # 0 … 6 s
TAU = 0.2


def first_order(t_event: float, before: float, after: float) -> np.ndarray:
    since = np.maximum(T - t_event, 0.0)
    return np.where(t_event - 0.5 * DT > T, before, after + (before - after) * np.exp(-since / TAU))


def measure(
    t_s: float, end_s: float, y: np.ndarray, steps: bool = True, current: np.ndarray | None = None
) -> EventMetrics:
    current = np.zeros_like(y) if current is None else current
    return measure_event(EventWindow("event", t_s, end_s, steps), "P_pcc", T, y, current, RATING, PER_CYCLE)


def test_a_step_in_the_middle() -> None:
    m = measure(2.0, 5.0, first_order(2.0, 2000.0, 2500.0))
    assert (m.name, m.t_s, m.signal, m.kind) == ("event", 2.0, "P_pcc", "step")
    assert m.raw.initial == pytest.approx(2000.0)
    # The last tenth of 3 s: exp(−13.5) = 1.4e-6 of the step is still to come.
    assert m.raw.final == pytest.approx(2500.0, abs=1e-3)
    # 1e-4 s: what 1.4e-6 of the final value moves the edge of the band, and the linear interpolation.
    assert m.raw.settling_time_s == pytest.approx(TAU * math.log(50.0), abs=1e-4)
    assert m.raw.rise_time_s == pytest.approx(TAU * math.log(9.0), abs=1e-4)


def test_times_count_from_the_event_and_not_from_the_sample_after() -> None:
    """An event between two samples: its response starts there."""
    t_event = 2.0 + 0.3 * DT
    m = measure(t_event, 5.0, first_order(t_event, 2000.0, 2500.0))
    assert m.raw.settling_time_s == pytest.approx(TAU * math.log(50.0), abs=1e-4)


def test_nothing_outside_the_window_counts() -> None:
    y = first_order(2.0, 2000.0, 2500.0)
    clean = measure(2.0, 5.0, y)
    current = np.full_like(y, 0.5)
    spoilt = y.copy()
    outside = (T < 2.0 - (PER_CYCLE + 1) * DT) | (T > 5.0 - 0.5 * DT)
    spoilt[outside], current[outside] = 1e6, 9.0
    dirty = measure(2.0, 5.0, spoilt, current=current)
    assert dirty.raw == clean.raw
    assert dirty.one_cycle_mean == clean.one_cycle_mean
    assert dirty.peak_current_pu == 0.5


def test_peak_current_is_the_windows_largest() -> None:
    current = np.where(np.abs(T - 3.0) < 0.01, 1.7, 0.4)
    assert measure(2.0, 5.0, first_order(2.0, 2000.0, 2500.0), current=current).peak_current_pu == 1.7
    assert measure(4.0, 5.0, first_order(2.0, 2000.0, 2500.0), current=current).peak_current_pu == 0.4


def test_at_the_start_of_the_run_the_first_sample_is_the_value_before() -> None:
    y = 2500.0 - 500.0 * np.exp(-T / TAU)
    m = measure(0.0, 6.0, y)
    assert m.raw.initial == 2000.0
    assert m.raw.settling_time_s == pytest.approx(TAU * math.log(50.0), abs=1e-4)
    assert m.kind == "step"


def test_less_than_a_cycle_before_the_event() -> None:
    t_event = 10 * DT
    m = measure(t_event, 6.0, first_order(t_event, 2000.0, 2500.0))
    assert m.raw.initial == 2000.0
    assert m.raw.settling_time_s == pytest.approx(TAU * math.log(50.0), abs=1e-4)


def test_to_the_end_of_the_run_and_beyond() -> None:
    y = first_order(2.0, 2000.0, 2500.0)
    last = float(T[-1] + DT)
    assert measure(2.0, last, y).raw == measure(2.0, last + 10.0, y).raw


def test_a_window_of_two_samples() -> None:
    m = measure(float(T[-2]), float(T[-1]), first_order(2.0, 2000.0, 2500.0))
    assert m.kind == "disturbance"
    assert m.raw.settling_time_s == 0.0


def test_too_small_a_step_is_none() -> None:
    """A thousandth of the rating is 5 W."""
    assert measure(2.0, 5.0, first_order(2.0, 2000.0, 2004.9)).kind == "disturbance"
    assert measure(2.0, 5.0, first_order(2.0, 2000.0, 2005.1)).kind == "step"


def test_another_signals_event_is_a_disturbance_with_a_band_of_the_rating() -> None:
    m = measure(2.0, 5.0, first_order(2.0, 2000.0, 2500.0), steps=False)
    assert m.kind == "disturbance"
    assert m.raw.overshoot_pct is None
    assert m.raw.settling_time_s == pytest.approx(TAU * math.log(500.0 / (0.02 * RATING)), abs=1e-4)


def test_ripple_of_a_cycle_is_gone_from_the_mean_and_not_from_the_raw() -> None:
    y = first_order(2.0, 2000.0, 2500.0)
    ripple = 50.0 * np.cos(2.0 * np.pi * T / (PER_CYCLE * DT))
    m = measure(2.0, 5.0, y + ripple)
    assert m.raw.settling_time_s is None or m.raw.settling_time_s > 2.9
    assert m.raw.overshoot_pct == pytest.approx(10.0, abs=0.1)
    assert m.one_cycle_mean.overshoot_pct == pytest.approx(0.0, abs=0.01)
    # The mean over the last cycle of an exponential lags by half a cycle, 10 ms (to (cycle/τ)²/24 τ = 0.1 ms).
    lag = 0.5 * PER_CYCLE * DT
    assert m.one_cycle_mean.settling_time_s == pytest.approx(TAU * math.log(50.0) + lag, abs=5e-4)
