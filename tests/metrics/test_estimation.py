"""Errors and delays of estimates, on hand-made rows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vsgdesign.metrics.answers import changes_seen, errors_at_rest, relative_errors_pct

T = 0.1 * np.arange(1, 61, dtype=float)
"""Ends of 60 windows of 0.1 s."""
R = np.where(T < 3.05, 2.0, 1.0)
L = 1e-3 * R


def test_a_rest_without_a_grid_is_left_out() -> None:
    """In an island there is nothing to be right about, and a figure of it has no axes."""
    there = np.where(T < 3.05, math.nan, 1.0)
    (only,) = errors_at_rest(T, R * there, L * there, R, L, [3.0], 6.0)
    assert only.end_s == 6.0


def test_errors_at_rest_are_of_the_last_second() -> None:
    R_hat, L_hat = R * 1.01, L * 0.99
    R_hat[:20] = 100.0  # before the rest
    R_hat[24], L_hat[24] = 2.0 * 1.05, 2e-3 * 0.9
    first, second = errors_at_rest(T, R, L, R_hat, L_hat, [3.0, 9.0], 6.0)
    assert (first.begin_s, first.end_s, first.R_g, first.L_g) == pytest.approx((2.25, 3.0, 2.0, 2e-3))
    # Windows that end at 2.3 … 3.0; that at 2.5 is off.
    assert first.R_mean_pct == pytest.approx((7 * 1.0 + 5.0) / 8)
    assert first.L_mean_pct == pytest.approx((7 * -1.0 - 10.0) / 8)
    assert (first.R_worst_pct, first.L_worst_pct) == pytest.approx((5.0, 10.0))
    assert (second.R_g, second.R_worst_pct, second.L_worst_pct) == pytest.approx((1.0, 1.0, 1.0))


def test_a_long_stretch_has_a_second_of_rest() -> None:
    (only,) = errors_at_rest(T, R, L, R, L, [], 6.0)
    assert (only.begin_s, only.end_s) == pytest.approx((5.0, 6.0))
    assert only.R_worst_pct == 0.0


def test_no_estimate_at_rest_is_no_error_of_zero() -> None:
    R_hat = R.copy()
    R_hat[-3] = np.nan
    (only,) = errors_at_rest(T, R, L, R_hat, L, [], 6.0)
    assert math.isnan(only.R_mean_pct)
    assert math.isnan(only.R_worst_pct)
    assert only.L_worst_pct == 0.0


def seen(R_hat: np.ndarray, L_hat: np.ndarray = L, instants: tuple[float, ...] = (3.0, 5.0)):
    (only,) = changes_seen(T, R, L, R_hat, L_hat, 0.1, [3.0], instants, 6.0)
    return only


def test_how_a_change_is_followed() -> None:
    """Row 30 is the first window that sees the change; rows 30 … 49 end before the next event at 5 s."""
    R_hat = R.copy()
    R_hat[30] = 1.5
    one = seen(R_hat)
    assert (one.t_s, one.found_windows, one.kept_windows) == (3.0, 2, 2)
    # The window that ends at 3.1 is whole: it begins with the change.
    assert one.worst_pct == pytest.approx(50.0)
    R_hat[33] = 0.8
    assert (seen(R_hat).found_windows, seen(R_hat).kept_windows) == (2, 5)
    R_hat[33] = np.nan
    assert seen(R_hat).kept_windows == 5
    R_hat[49] = 0.8
    assert seen(R_hat).kept_windows is None
    assert seen(R_hat, instants=(3.0, 4.95)).kept_windows == 5
    assert seen(R, np.where(T > 3.05, 5e-3, L)).found_windows is None


def test_the_window_that_holds_the_change_is_not_judged() -> None:
    """A change in the middle of a window: the estimate of both grids at once has no truth."""
    R_hat = R.copy()
    R_hat[30] = 1.7
    (one,) = changes_seen(T, R, L, R_hat, L, 0.1, [3.04], [3.04], 6.0)
    assert (one.found_windows, one.worst_pct) == (2, 0.0)


def test_nothing_relative_to_nothing() -> None:
    assert relative_errors_pct(np.array([0.0, 2.0]), np.array([1.0, 1.0])).tolist() == [math.inf, -50.0]
