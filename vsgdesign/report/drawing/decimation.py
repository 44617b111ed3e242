"""Reduce long signals to a few points per pixel column, with every extreme kept, and separate ripple from its mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def extreme_indices(y: Array, columns: int) -> NDArray[np.intp]:
    """Sorted indices of at most about 4·columns samples that draw the same line on that many pixel columns.

    Of each column the first, smallest, largest and last sample: the line cannot be told from the full one, and
    no extreme is lost.
    """
    n = len(y)
    size = -(-n // max(columns, 1))
    if size <= 4:
        return np.arange(n)
    whole = n // size * size
    blocks = y[:whole].reshape(-1, size)
    starts = np.arange(0, whole, size)
    picks = [starts, starts + np.argmin(blocks, axis=1), starts + np.argmax(blocks, axis=1), starts + size - 1]
    if whole < n:
        rest = y[whole:]
        picks.append(np.array([whole, whole + int(np.argmin(rest)), whole + int(np.argmax(rest)), n - 1]))
    return np.unique(np.concatenate(picks))


def envelope(t: Array, y: Array, columns: int) -> tuple[Array, Array, Array]:
    """(t, smallest, largest) of each of at most ``columns`` blocks; t spans the whole signal."""
    n = len(y)
    size = max(-(-n // max(columns, 1)), 1)
    starts = np.arange(0, n, size)
    middles = 0.5 * (t[starts] + t[np.minimum(starts + size, n) - 1])
    # The polygon must reach both ends of the axis.
    middles[0], middles[-1] = t[0], t[-1]
    return middles, np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)


def ripple_level(y: Array, mean: Array) -> float:
    """Typical distance of a signal from its mean over whole cycles, in the signal's unit.

    The median over the whole run: transients, during which the mean lags, do not count.
    """
    step = max(len(y) // 20_000, 1)
    return float(np.median(np.abs(y[::step] - mean[::step])))


@dataclass(frozen=True)
class Trace:
    """One signal of one controller: instantaneous and its mean over the preceding cycle."""

    t: Array
    y: Array
    mean: Array
    ripple: float
    """Typical distance between the two; zero for an averaged bridge, which has no ripple to remove."""
    broken: bool = False
    """Whether the simulation diverged, so that the signal ends early."""

    def between(self, begin_s: float, end_s: float) -> Trace:
        """The part within a stretch of time, both ends included."""
        slack = 0.5 * (self.t[1] - self.t[0]) if len(self.t) > 1 else 0.0
        first, last = np.searchsorted(self.t, [begin_s - slack, end_s + slack])
        return Trace(self.t[first:last], self.y[first:last], self.mean[first:last], self.ripple, self.broken)
