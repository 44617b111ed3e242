"""Fixed logarithmic bins: quantiles of any number of values in a bounded memory, merged without an error."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

PER_DECADE = 250
LOWEST, DECADES = 1e-6, 10

EDGES = tuple(LOWEST * 10.0 ** (k / PER_DECADE) for k in range(PER_DECADE * DECADES + 1))
"""Upper edges: a value is in the first bin whose edge it does not exceed. The last bin has none: it is infinity's."""

QUANTILE_ERROR = 10.0 ** (1.0 / PER_DECADE) - 1.0
"""Largest relative error of a quantile, 0.93 %: it is the upper edge of a bin, so it is never too small."""

_EDGES = np.array(EDGES)


def binned(values: NDArray[np.float64]) -> dict[int, int]:
    """How many of the values (n,) are in which bin; infinity and NaN are in the last one."""
    places = np.searchsorted(_EDGES, values, side="left")  # NaN sorts behind everything
    bins, counts = np.unique(places, return_counts=True)
    return {int(k): int(count) for k, count in zip(bins, counts, strict=True)}


def merged_bins(one: Mapping[int, int], other: Mapping[int, int]) -> dict[int, int]:
    """Both together, in the order of the bins."""
    return {k: one.get(k, 0) + other.get(k, 0) for k in sorted({*one, *other})}


def quantile(bins: Mapping[int, int], share: float, largest: float) -> float:
    """The value that a share of all values does not exceed, by at most QUANTILE_ERROR too large; NaN without values.

    ``largest``: the largest value, which no quantile exceeds.
    """
    total = sum(bins.values())
    order = sorted(bins)
    if not order:
        return float("nan")
    sums = np.cumsum([bins[k] for k in order]).tolist()
    at = order[min(bisect_left(sums, share * total), len(order) - 1)]
    return min(EDGES[at], largest) if at < len(EDGES) else largest
