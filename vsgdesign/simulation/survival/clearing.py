"""Critical clearing time: how long a fault may last."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]

LENGTHS_S = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.0, 3.0)
"""Lengths at which a fault is tried first: a fault may be lost and a longer one survived, which bisection misses."""

RESOLUTION_S = 0.005


class Verdicts(NamedTuple):
    """Of n faults, (n,) each."""

    judged: Mask
    """Whether there is a verdict."""
    survived: Mask


FaultsOf = Callable[[Index, Array], Verdicts]
"""The verdicts of faults in some of the cells, each of its own length in s; both arguments (n,)."""


class ClearingTimes(NamedTuple):
    """Of every cell, (count,)."""

    longest_s: Array
    """Longest fault that was survived with every shorter one that was tried, s; 0 where none was, and NaN where the
    cell has no verdict at any length."""
    bounded: Mask
    """Whether a longer fault was lost. Otherwise every length that was tried was survived."""


def critical_clearing_times(
    faults_of: FaultsOf, count: int, *, lengths_s: tuple[float, ...] = LENGTHS_S, resolution_s: float = RESOLUTION_S
) -> ClearingTimes:
    """The critical clearing time of a fault in each of ``count`` cells.

    Every length is tried. Bisection between the longest that was survived before the first loss and this loss follows,
    down to ``resolution_s``, in all cells side by side.
    """
    lengths = np.asarray(lengths_s, dtype=float)
    every = np.arange(count)
    first = faults_of(every, np.full(count, lengths[0]))
    judged = every[first.judged]
    survived = np.ones((count, len(lengths)), dtype=bool)
    survived[:, 0] = first.survived
    if len(judged):
        index, tried = np.repeat(judged, len(lengths) - 1), np.tile(lengths[1:], len(judged))
        survived[judged, 1:] = faults_of(index, tried).survived.reshape(len(judged), -1)
    bounded = first.judged & ~survived.all(axis=1)
    lost = np.argmin(survived, axis=1)  # the first loss; 0 too where there is none
    good = np.where(bounded, np.where(lost > 0, lengths[lost - 1], 0.0), lengths[-1])
    bad = np.where(bounded, lengths[lost], good)
    while len(open_ := np.flatnonzero(bad - good > resolution_s)):
        middle = 0.5 * (good[open_] + bad[open_])
        held = faults_of(open_, middle).survived
        good[open_], bad[open_] = np.where(held, middle, good[open_]), np.where(held, bad[open_], middle)
    return ClearingTimes(np.where(first.judged, good, np.nan), bounded)
