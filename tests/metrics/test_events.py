"""Which samples an event's figures are taken from."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vsgdesign.metrics import EndState, EventMetrics, EventWindow, measure_event, step_response
from vsgdesign.metrics.events import MEASURED, NO_STEADY_STATE, NOT_SETTLED, TOO_SHORT, UNSTABLE

DT = 2e-4
PER_CYCLE = 100
RATING = 5000.0
T = np.arange(30_000, dtype=float) * DT  # 0 … 6 s
TAU = 0.2


def first_order(t_event: float, before: float, after: float) -> np.ndarray:
    since = np.maximum(T - t_event, 0.0)
    return np.where(t_event - 0.5 * DT > T, before, after + (before - after) * np.exp(-since / TAU))


AT_2500 = EndState(2500.0, 1.0 / TAU)


def measure(
    t_s: float,
    end_s: float,
    y: np.ndarray,
    steps: bool = True,
    current: np.ndarray | None = None,
    end: EndState = AT_2500,
) -> EventMetrics:
    current = np.zeros_like(y) if current is None else current
    window = EventWindow("event", t_s, end_s, steps)
    return measure_event(
        window, "P_pcc", T, y, RATING, PER_CYCLE, end, largest_pu=lambda rows: float(current[rows].max())
    )


def test_a_step_in_the_middle() -> None:
    m = measure(2.0, 5.0, first_order(2.0, 2000.0, 2500.0))
    assert (m.name, m.t_s, m.signal, m.kind) == ("event", 2.0, "P_pcc", "step")
    assert m.raw.initial == pytest.approx(2000.0)
    assert m.raw.final == 2500.0
    assert (m.status, m.reason, m.needs_s) == (MEASURED, None, None)
    # 1e-4 s: the linear interpolation.
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
    assert dirty.cycle_mean == clean.cycle_mean
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
    assert (m.kind, m.status) == ("disturbance", TOO_SHORT)
    assert m.raw.settling_time_s is None


def test_too_small_a_step_is_none() -> None:
    """A thousandth of the rating is 5 W."""
    small, large = (
        measure(2.0, 5.0, first_order(2.0, 2000.0, after), end=EndState(after, 5.0)) for after in (2004.9, 2005.1)
    )
    assert (small.kind, large.kind) == ("disturbance", "step")


def test_another_signals_event_is_a_disturbance_with_a_band_of_the_rating() -> None:
    m = measure(2.0, 5.0, first_order(2.0, 2000.0, 2500.0), steps=False)
    assert m.kind == "disturbance"
    assert m.raw.overshoot_pct is None
    assert m.raw.settling_time_s == pytest.approx(TAU * math.log(500.0 / (0.02 * RATING)), abs=1e-4)


def test_ripple_of_a_cycle_is_gone_from_the_mean_and_not_from_the_raw() -> None:
    y = first_order(2.0, 2000.0, 2500.0)
    ripple = 50.0 * np.cos(2.0 * np.pi * T / (PER_CYCLE * DT))
    m = measure(2.0, 5.0, y + ripple, end=EndState(None, 1.0 / TAU))
    assert m.status == MEASURED
    assert m.raw.settling_time_s is None or m.raw.settling_time_s > 2.9
    assert m.raw.overshoot_pct == pytest.approx(10.0, abs=0.1)
    assert m.cycle_mean.overshoot_pct == pytest.approx(0.0, abs=0.01)
    # The mean over the last cycle of an exponential lags by half a cycle, 10 ms (to (cycle/τ)²/24 τ = 0.1 ms).
    lag = 0.5 * PER_CYCLE * DT
    assert m.cycle_mean.settling_time_s == pytest.approx(TAU * math.log(50.0) + lag, abs=5e-4)


def test_a_window_shorter_than_the_response_has_no_figure() -> None:
    """First order: the mean over a cycle settles after τ ln 50 + 10 ms = 0.792 s, and not a moment before that can it
    be said."""
    y, settled = first_order(2.0, 2000.0, 2500.0), TAU * math.log(50.0) + 0.5 * PER_CYCLE * DT
    short, enough = measure(2.0, 2.0 + settled - 0.01, y), measure(2.0, 2.0 + settled + 0.01, y)
    assert (short.status, enough.status) == (TOO_SHORT, MEASURED)
    for figures in (short.raw, short.cycle_mean):
        assert (figures.final, figures.overshoot_pct, figures.settling_time_s) == (2500.0, None, None)
    assert short.needs_s == pytest.approx(settled, abs=1e-3)
    assert short.reason == "the window is too short: 0.782 s after the step, the slowest mode needs 0.793 s"
    assert enough.cycle_mean.settling_time_s == pytest.approx(settled, abs=5e-4)
    assert enough.raw.settling_time_s == pytest.approx(TAU * math.log(50.0), abs=1e-4)


def test_a_critically_damped_step_seen_for_a_second() -> None:
    """(1 + ωt)e^(−ωt) at 4 1/s settles after 5.834/ω = 1.458 s; its last tenth of a second looks settled at 0.9 s."""
    since = np.maximum(T - 2.0, 0.0)
    y = 2500.0 - 500.0 * (1.0 + 4.0 * since) * np.exp(-4.0 * since)
    seen = y[(T > 2.0 - 0.5 * DT) & (T < 3.0 - 0.5 * DT)]
    by_eye = step_response(np.arange(len(seen), dtype=float) * DT, seen, 2000.0, float(seen[-len(seen) // 10 :].mean()))
    assert by_eye.settling_time_s is not None
    assert by_eye.settling_time_s < 1.0
    end = EndState(2500.0, 4.0)
    assert measure(2.0, 3.0, y, end=end).status == TOO_SHORT
    m = measure(2.0, 3.5, y, end=end)
    assert m.raw.settling_time_s == pytest.approx(1.4585, abs=1e-3)


@pytest.mark.parametrize("switched", [False, True])
def test_no_window_gives_a_settling_time_that_a_longer_one_takes_back(switched: bool) -> None:
    """Random sums of three modes, windows of any length: a figure is that of the whole response, or there is none."""
    rng = np.random.default_rng(21)
    t = np.arange(60_000, dtype=float) * 1e-3
    figures = refused = 0
    for _ in range(150):
        decay = rng.uniform(0.5, 8.0, 3)
        weights = rng.uniform(-1.5, 1.5, 3)
        weights[0] += 1.0 - weights.sum()
        swing = np.cos(np.outer(rng.uniform(0.0, 20.0, 3) * rng.integers(0, 2, 3), t))
        error = weights @ (np.exp(-np.outer(decay, t)) * swing)
        y = np.concatenate([np.full(1000, 0.0), 1000.0 * (1.0 - error)])
        grid = np.arange(len(y), dtype=float) * 1e-3
        length = rng.uniform(0.3, 10.0 if switched else 6.0) / decay.min()
        end = EndState(None if switched else 1000.0, float(decay.min()))
        window = EventWindow("step", 1.0, 1.0 + length, True)
        m = measure_event(window, "P_pcc", grid, y, RATING, 20, end)
        if m.status == TOO_SHORT:
            refused += 1
            continue
        figures += 1
        assert m.status == MEASURED
        assert m.raw.final == pytest.approx(1000.0, abs=3.0 if switched else 0.0)
        # A final value that is a mean may be wrong by a tenth of the band: then so are its edges.
        slack = 0.1 if switched else 0.0
        late, early = (
            step_response(t, y[1000:], 0.0, 1000.0, 0.02 * (1.0 + sign * slack)).settling_time_s for sign in (-1.5, 1.5)
        )
        assert late is not None
        assert early is not None
        assert m.raw.settling_time_s is not None
        assert early - 2e-3 <= m.raw.settling_time_s <= late + 2e-3
    assert figures > 30
    assert refused > 30


def test_a_ramp_counts_from_its_end() -> None:
    """Nothing moved yet when a ramp that lasts to 2.5 s began; the window must hold the answer to its end."""
    y = first_order(2.5, 2000.0, 2500.0)
    ramp = EndState(2500.0, 1.0 / TAU, changed_s=2.5)
    assert measure(2.0, 3.2, y, steps=False, end=ramp).status == TOO_SHORT
    assert measure(2.0, 3.4, y, steps=False, end=ramp).status == MEASURED


def test_what_hangs_beside_the_steady_state_is_not_settled() -> None:
    """30 W beside a step of 500 W is outside the band for good; ten times the time it needs have gone by."""
    m = measure(2.0, 5.0, first_order(2.0, 2000.0, 2470.0))
    assert (m.status, m.raw.settling_time_s) == (NOT_SETTLED, None)
    assert m.raw.overshoot_pct == 0.0
    assert "does not come to rest as the linear model does" in (m.reason or "")


@pytest.mark.parametrize(
    ("end", "status"),
    [(EndState(2500.0, -0.5, "a mode grows"), UNSTABLE), (EndState(None, None, "a mode grows"), NO_STEADY_STATE)],
)
def test_no_stable_end_has_no_figures(end: EndState, status: str) -> None:
    m = measure(2.0, 5.0, first_order(2.0, 2000.0, 2500.0), end=end)
    assert (m.status, m.reason, m.needs_s) == (status, "a mode grows", None)
    assert (m.raw.overshoot_pct, m.raw.settling_time_s, m.raw.rise_time_s) == (None, None, None)


def in_noise(size: float, rms: float, hidden: np.ndarray | float = 0.0) -> EventMetrics:
    """A step from 2 kW with noise of 40 W rms that is the same without it. Not the same is noise of ``rms`` in the
    mean of a cycle, and what is ``hidden``."""
    rng = np.random.default_rng(4)
    common, left = 40.0 * rng.standard_normal(T.size), rms * math.sqrt(PER_CYCLE) * rng.standard_normal(T.size)
    after = T > 0.4 - 0.5 * DT
    y = 2000.0 + common + after * (size * (1.0 + hidden) * (1.0 - np.exp(-np.maximum(T - 0.4, 0.0) / TAU)) + left)
    window, end = EventWindow("event", 0.4, 6.0, True), EndState(None, 1.0 / TAU)
    return measure_event(window, "P_pcc", T, y, RATING, PER_CYCLE, end, 2000.0 + common)


def test_a_step_beside_its_twin_has_the_figures_of_one_without_noise() -> None:
    m = in_noise(500.0, 1.0)
    assert (m.status, m.kind, m.drift) == (MEASURED, "step", 0.0)
    assert m.noise is not None
    assert m.cycle_mean.settling_time_s == pytest.approx(TAU * math.log(50.0) + 0.01, abs=0.05)
    assert m.noise.step == pytest.approx(500.0, abs=1.0)
    assert m.cycle_mean.final is not None
    assert m.cycle_mean.final - m.cycle_mean.initial == pytest.approx(m.noise.step, abs=1e-9)
    assert m.noise.left == pytest.approx(1.0, rel=0.2)
    assert m.noise.rest == pytest.approx(40.0 / math.sqrt(PER_CYCLE), rel=0.3)
    assert m.noise.share == pytest.approx(4.5 * m.noise.left / 500.0, rel=1e-2)
    assert m.noise.least_step == pytest.approx(225.0 * m.noise.left, rel=1e-9)
    assert m.noise.judgeable
    assert 0.0 < (m.cycle_mean.overshoot_pct or 0.0) < 100.0 * m.noise.share  # nothing but noise
    small = in_noise(200.0, 1.0).noise
    assert small is not None
    assert not small.judgeable  # 4.5 W beside a band of 4 W
    assert in_noise(-500.0, 1.0).cycle_mean.settling_time_s == pytest.approx(0.79, abs=0.05)


def test_a_twin_hides_nothing_that_comes_with_the_step() -> None:
    """A slow mode, a drift and a late step are outside the band, and a ringing is not called settled."""
    for hidden in (0.06 * np.exp(-0.15 * T), 0.02 * T, 0.03 * (T > 5.0), 0.03 * np.sin(2.0 * math.pi * 0.7 * T)):
        m = in_noise(500.0, 0.6, hidden)
        assert m.noise is not None
        assert m.noise.judgeable
        settled = m.cycle_mean.settling_time_s
        assert settled is None or settled > 1.5  # 0.79 s with nothing hidden


def test_a_window_that_is_too_short_stays_so_beside_a_twin() -> None:
    window, end = EventWindow("event", 2.0, 2.5, True), EndState(None, 1.0 / TAU)
    y = first_order(2.0, 2000.0, 2500.0)
    alone = measure_event(window, "P_pcc", T, y, RATING, PER_CYCLE, end)
    beside = measure_event(window, "P_pcc", T, y, RATING, PER_CYCLE, end, np.full(T.size, 2000.0))
    assert alone.status == TOO_SHORT
    assert (beside.status, beside.reason, beside.needs_s) == (alone.status, alone.reason, alone.needs_s)
    assert beside.cycle_mean.settling_time_s is None
    for one in (alone, beside):  # what it has reached so far, for who asks for no more
        assert one.so_far is not None
        assert one.so_far.settling_time_s is not None


def at_a_changed_grid(rms: float, restless: bool = True, hidden: np.ndarray | float = 0.0) -> EventMetrics:
    """A swing by 500 W about 2 kW after a change of the grid, in noise of ``rms`` in the mean of a cycle."""
    noise = rms * math.sqrt(PER_CYCLE) * np.random.default_rng(5).standard_normal(T.size)
    y = 2000.0 + noise + (T > 0.4 - 0.5 * DT) * (500.0 * np.exp(-np.maximum(T - 0.4, 0.0) / TAU) + hidden)
    window, end = EventWindow("grid", 0.4, 6.0, False), EndState(None, 1.0 / TAU)
    return measure_event(window, "P_pcc", T, y, RATING, PER_CYCLE, end, restless=restless)


def test_a_disturbance_in_noise_that_leaves_its_band_cannot_be_judged() -> None:
    """The band is 100 W, and 4.5 times 30 W are 135 W."""
    settled = at_a_changed_grid(0.0, restless=False).cycle_mean.settling_time_s
    assert settled == pytest.approx(TAU * math.log(5.0) + 0.01, abs=0.02)
    quiet, loud = at_a_changed_grid(10.0), at_a_changed_grid(30.0)
    assert quiet.noise is not None
    assert loud.noise is not None
    assert (quiet.noise.judgeable, quiet.lost_in_noise, quiet.reason) == (True, False, None)
    assert quiet.cycle_mean.settling_time_s == pytest.approx(settled, abs=0.1)
    assert (loud.status, loud.lost_in_noise, loud.cycle_mean.settling_time_s) == (MEASURED, True, None)
    assert loud.noise.rest == pytest.approx(30.0, rel=0.2)
    assert loud.noise.least_band == pytest.approx(4.5 * loud.noise.rest, rel=1e-9)
    assert str(loud.reason).startswith(f"cannot be judged: P rests in {loud.noise.rest:.3g} W rms")
    assert f"a band of at least {loud.noise.least_band:.3g} W could be judged" in str(loud.reason)
    # Where nothing explains a movement, it is none of a noise: a run that rests stays outside its band.
    assert at_a_changed_grid(30.0, restless=False).reason != loud.reason


def test_the_noise_of_a_disturbance_is_found_after_its_slowest_mode() -> None:
    """A mode of 2.5 s moves through a half of the window, and is none of its noise."""
    slow = at_a_changed_grid(3.0, hidden=400.0 * np.exp(-(T - 0.4) / 0.7))
    window, end = EventWindow("grid", 0.4, 6.0, False), EndState(None, 1.0 / 0.7)
    y = np.asarray(2000.0 + (T > 0.4 - 0.5 * DT) * 900.0 * np.exp(-np.maximum(T - 0.4, 0.0) / 0.7), dtype=float)
    alone = measure_event(window, "P_pcc", T, y, RATING, PER_CYCLE, end, restless=True)
    for m in (slow, alone):
        assert m.noise is not None
        assert m.noise.judgeable
        assert m.cycle_mean.settling_time_s is not None
