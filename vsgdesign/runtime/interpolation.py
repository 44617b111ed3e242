"""Bilinear interpolation on non-uniform axes, written so that C with the same order of operations gives the same bits.

One search per axis and four weights serve every column of a table. In C this is a linear or binary search for the
interval and one division per axis, then four products and three sums per column. The C must be compiled without
contraction to fused operations.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Interval(NamedTuple):
    """Where a value lies on an axis: between nodes ``low`` and ``high``, at ``fraction`` of the way, 0 to 1.

    ``clipped``: −1 below the axis, 1 above it, 0 on it.
    """

    low: Any
    high: Any
    fraction: Any
    clipped: Any


class Weights(NamedTuple):
    """Weights of the four corners of a cell; the first word of a name is the row, the second the column."""

    low_low: Any
    low_high: Any
    high_low: Any
    high_high: Any


def locate(axis: Array, value: Any) -> Interval:
    """The interval of a strictly increasing axis in which a value (scalar or array) lies.

    ``low`` is the last node that is not above the value, but at most the last but one. The fraction is (value −
    axis[low])/(axis[low + 1] − axis[low]), clipped to 0 and 1, so a value beyond an end takes that end. An axis with
    one node takes this node for every value. NaN gives a fraction of NaN.
    """
    value = np.asarray(value, dtype=float)
    clipped = np.where(value > axis[-1], 1, np.where(value < axis[0], -1, 0))
    low = np.clip(np.searchsorted(axis, value, side="right") - 1, 0, max(len(axis) - 2, 0))
    high = np.minimum(low + 1, len(axis) - 1)
    width = np.where(high > low, axis[high] - axis[low], 1.0)
    inside = np.minimum(np.maximum(value, axis[0]), axis[-1])
    return Interval(low, high, (inside - axis[low]) / width, clipped)


def corner_weights(row: Any, column: Any) -> Weights:
    """The weights (1 − r)(1 − c), (1 − r)c, r(1 − c), rc for the fractions r and c (:eq:`bilinear`)."""
    r, c = 1.0 - row, 1.0 - column
    return Weights(r * c, r * column, row * c, row * column)


def blend(weights: Weights, low_low: Any, low_high: Any, high_low: Any, high_high: Any) -> Any:
    """The weighted sum ((w00 v00 + w01 v01) + w10 v10) + w11 v11 (:eq:`bilinear`)."""
    w00, w01, w10, w11 = weights
    return ((w00 * low_low + w01 * low_high) + w10 * high_low) + w11 * high_high


def interpolate(values: Array, row: Interval, column: Interval, weights: Weights) -> Any:
    """Interpolates a column (n, m) of a table (:eq:`bilinear`).

    At a node one weight is 1 and three are 0, so the result is exactly the value of the node.
    """
    return blend(
        weights,
        values[row.low, column.low],
        values[row.low, column.high],
        values[row.high, column.low],
        values[row.high, column.high],
    )
