"""Which rows of a run are drawn: few, and every minimum and maximum stays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST = 800
"""Rows that are drawn at most."""

_BUCKETS = 320
_SMALLEST = 2e-3
"""A turning point that sticks out of its bucket's ends by less than this share of the whole range is not kept for
itself: it is a fraction of a pixel."""


def thinned(signals: Sequence[Array], most: int = MOST) -> NDArray[np.intp]:
    """Rows, in ascending order and at most ``most``, with which all ``signals`` (n each) can be drawn.

    The rows are divided into buckets of equal length. The first row of each bucket stays, and so do the rows of its
    minimum and maximum of a signal where these stick out of the bucket. The first and the last row and the rows of
    every signal's own minimum and maximum always stay, unless ``most`` is smaller than these.
    """
    n = len(signals[0])
    if n <= most:
        return np.arange(n)
    values = np.stack([np.asarray(signal, dtype=float) for signal in signals])
    always = np.unique([0, n - 1, *np.argmin(values, axis=1), *np.argmax(values, axis=1)])
    buckets = min(_BUCKETS, most // 2)
    while True:
        rows = np.union1d(always, _rows(values, max(-(-n // buckets), 2)))
        if len(rows) <= most or buckets <= 8:
            return rows if len(rows) <= most else always
        buckets = min(int(0.95 * buckets * most / len(rows)), buckets - 1)


def _rows(values: Array, length: int) -> NDArray[np.intp]:
    """First rows of the buckets of ``length`` rows, and those of their extremes that stick out of them."""
    signals, n = values.shape
    count = n // length
    parts = values[:, : count * length].reshape(signals, count, length)
    starts = np.arange(count) * length
    # A bucket is left towards the first row of the next one, which is drawn, too.
    following = np.minimum(starts + length, n - 1)
    ends = np.stack([values[:, starts], values[:, following]])
    slack = _SMALLEST * np.ptp(values, axis=1)[:, None]
    found = [starts, np.arange(count * length, n, length)]
    for pick, sticks in ((parts.argmin(axis=2), -1.0), (parts.argmax(axis=2), 1.0)):
        extreme = np.take_along_axis(parts, pick[:, :, None], axis=2)[:, :, 0]
        out = (sticks * extreme[None] > sticks * ends + slack).all(axis=0)
        found.append((starts[None, :] + pick)[out])
    return np.unique(np.concatenate(found))
