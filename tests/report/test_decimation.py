"""Decimation draws the same picture: every extreme stays, in few points."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vsgdesign.report.drawing.time_axis import Trace, envelope, extreme_indices, ripple_level

FINITE = st.floats(-1e9, 1e9, allow_nan=False)
SIGNALS = st.integers(1, 400).flatmap(lambda n: arrays(float, n, elements=FINITE))


@given(SIGNALS, st.integers(1, 60))
def test_every_column_keeps_its_extremes_and_ends(y, columns):
    picks = extreme_indices(y, columns)
    assert (np.diff(picks) > 0).all()
    assert picks[0] == 0
    assert picks[-1] == len(y) - 1
    size = -(-len(y) // columns)
    for start in range(0, len(y), size):
        block = y[start : start + size]
        kept = y[picks[(picks >= start) & (picks < start + size)]]
        assert kept.min() == block.min()
        assert kept.max() == block.max()


@given(SIGNALS, st.integers(1, 60))
def test_no_more_than_four_points_a_column(y, columns):
    assert len(extreme_indices(y, columns)) <= 4 * columns


@given(SIGNALS, st.integers(1, 60))
def test_envelope_contains_the_signal_and_touches_it(y, columns):
    t = np.arange(len(y), dtype=float)
    middle, low, high = envelope(t, y, columns)
    assert len(middle) <= columns
    assert low.min() == y.min()
    assert high.max() == y.max()
    assert (low <= high).all()
    assert middle[-1] == t[-1]


def test_a_lone_spike_among_a_million_samples_survives():
    y = np.zeros(1_000_003)
    y[777_777] = 5.0
    y[123] = -3.0
    kept = y[extreme_indices(y, 640)]
    assert kept.max() == 5.0
    assert kept.min() == -3.0
    assert len(kept) <= 2560


def test_transients_are_no_ripple():
    t = np.linspace(0.0, 10.0, 100_001)
    mean = np.where(t < 5.0, 1.0, 2.0)
    step = np.where(t < 4.9, 1.0, 2.0)
    assert ripple_level(step, mean) == 0.0
    assert ripple_level(mean + 0.1 * np.sign(np.sin(1e4 * t)), mean) > 0.09


def test_a_part_of_a_trace_includes_both_ends():
    t = np.arange(11, dtype=float) * 0.1
    part = Trace(t, t, t, 0.0).between(0.3, 0.7)
    assert np.allclose(part.t, [0.3, 0.4, 0.5, 0.6, 0.7])
