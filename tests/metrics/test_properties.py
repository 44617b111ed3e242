"""What must hold for any response: figures know no unit, no offset and no sign.

Samples and offsets are whole numbers and scales powers of two, so that every operation is exact and equality
is equality.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.examples import examples
from vsgdesign.metrics import cycle_mean, disturbance_response, step_response
from vsgdesign.metrics.step_response import settling_time

Array = NDArray[np.float64]

SAMPLES = st.lists(st.integers(-60, 60), min_size=3, max_size=60).map(lambda v: np.array(v, dtype=float))
STEP = st.integers(1, 50).map(float)
EXPONENT = st.integers(-8, 8)
OFFSET = st.integers(-1000, 1000).map(float)

thorough = examples(40)


def times(y: Array) -> Array:
    return np.arange(len(y), dtype=float) * 0.125


@thorough
@given(SAMPLES, STEP, EXPONENT, OFFSET)
def test_scale_and_offset_do_not_matter(y: Array, step: float, exponent: int, offset: float) -> None:
    t, scale = times(y), 2.0**exponent
    here = step_response(t, y, 0.0, step)
    there = step_response(t, scale * (y + offset), scale * offset, scale * (step + offset))
    assert here.peak_deviation is not None
    assert there == replace(
        here, initial=scale * offset, final=scale * (step + offset), peak_deviation=scale * here.peak_deviation
    )


@thorough
@given(SAMPLES, STEP, OFFSET)
def test_a_step_down_has_the_figures_of_the_step_up(y: Array, step: float, offset: float) -> None:
    t = times(y)
    up = step_response(t, y + offset, offset, offset + step)
    down = step_response(t, -(y + offset), -offset, -(offset + step))
    assert up.final is not None
    assert down == replace(up, initial=-up.initial, final=-up.final)


@thorough
@given(SAMPLES, STEP, EXPONENT)
def test_slower_by_a_factor_is_slower_by_a_factor(y: Array, step: float, exponent: int) -> None:
    t, slower = times(y), 2.0**exponent
    here, there = step_response(t, y, 0.0, step), step_response(slower * t, y, 0.0, step)
    assert there.overshoot_pct == here.overshoot_pct
    assert here.itae_s2 is not None
    assert there.itae_s2 == slower * slower * here.itae_s2
    for name in ("settling_time_s", "rise_time_s"):
        before, after = getattr(here, name), getattr(there, name)
        assert after == (None if before is None else slower * before)


@thorough
@given(SAMPLES, st.floats(0.001, 50.0), st.floats(0.001, 50.0))
def test_settling_is_monotone_in_the_band(y: Array, one: float, other: float) -> None:
    narrow, wide = min(one, other), max(one, other)
    inf = float("inf")
    slow, fast = (settling_time(times(y), np.abs(y), band) for band in (narrow, wide))
    assert (inf if fast is None else fast) <= (inf if slow is None else slow)


@thorough
@given(SAMPLES, st.floats(0.001, 50.0))
def test_after_the_settling_time_nothing_is_outside(y: Array, band: float) -> None:
    t, error = times(y), np.abs(y)
    settled = settling_time(t, error, band)
    if settled is None:
        assert error[-1] > band
    else:
        assert np.all(error[t > settled] <= band)
        # …and just before it something is (or the response never left).
        assert settled == 0.0 or error[np.flatnonzero(t <= settled)[-1]] > band or settled in t


@thorough
@given(SAMPLES, st.integers(1, 1000).map(float), OFFSET)
def test_a_disturbance_has_no_sign_and_no_offset(y: Array, rating: float, offset: float) -> None:
    t = times(y)
    here = disturbance_response(t, y, 0.0, 0.0, rating)
    there = disturbance_response(t, -(y + offset), -offset, -offset, rating)
    assert there == replace(here, initial=-offset, final=-offset)


@thorough
@given(SAMPLES, st.integers(1, 30))
def test_cycle_mean_against_a_loop(y: Array, per_cycle: int) -> None:
    expected = [float(np.mean(y[max(k - per_cycle + 1, 0) : k + 1])) for k in range(len(y))]
    # Sums of whole numbers are exact; the division rounds once here and twice there.
    np.testing.assert_allclose(cycle_mean(y, per_cycle), expected, rtol=0.0, atol=60.0 * 4e-16)


@thorough
@given(st.integers(2, 60), st.integers(1, 7), st.floats(0.0, 6.28), st.floats(-1e4, 1e4))
def test_cycle_mean_takes_out_whole_cycle_ripple(per_cycle: int, harmonic: int, phase: float, level: float) -> None:
    if harmonic % per_cycle == 0:  # aliases to a constant: no ripple
        return
    k = np.arange(4 * per_cycle)
    ripple = np.cos(2.0 * np.pi * harmonic * k / per_cycle + phase)
    mean = cycle_mean(level + ripple, per_cycle)
    np.testing.assert_allclose(mean[per_cycle - 1 :], level, rtol=0.0, atol=1e-11)
    assert np.ptp(ripple) > 0.0


def test_cycle_mean_of_a_single_sample_is_the_signal_and_no_view_of_it() -> None:
    y = np.arange(5.0)
    mean = cycle_mean(y, 1)
    mean[0] = 9.0
    assert y[0] == 0.0


def test_cycle_mean_keeps_its_digits_over_a_long_run() -> None:
    """A running sum must not lose the ripple under the total: 3e5 samples of 2 kW."""
    rng = np.random.default_rng(2)
    y = 2000.0 + rng.standard_normal(300_000)
    mean = cycle_mean(y, 100)
    late = rng.integers(len(y) // 2, len(y), 50)
    # The sum has passed 1e3 (of y − y[0], times a few) by then: 1e-9 leaves it 1e-12 a sample.
    np.testing.assert_allclose(mean[late], [np.mean(y[k - 99 : k + 1]) for k in late], rtol=0.0, atol=1e-9)
