"""Figures over many verdicts: how many survived, how large the currents were, how long recovery took,
and the critical clearing time: how long a fault may last."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.survival import STATUSES
from vsgdesign.simulation.survival.running import CaseResult

CURRENT_PU = 1.26
"""What the current later than 5 ms after an event should keep below, pu of rated, with a limit of 1.2 pu."""


@dataclass(frozen=True, kw_only=True)
class SurvivalFigures:
    """Figures over some results. None: there is nothing to take them from."""

    cases: int
    judged: int
    """Cases that have a verdict; the others were left out."""
    survived: int
    statuses: dict[str, int]
    """How many of each status, those without a verdict among them."""
    peak_pu: float | None
    """Largest current later than 5 ms after an event."""
    peak_median_pu: float | None
    peak_99_pu: float | None
    """Median and 99th percentile of that current over the cases."""
    peak_kept: float | None
    """Share of the judged cases in which it stays at or below CURRENT_PU."""
    beyond_hardware: int
    """Cases that survived with a current that hardware does not carry (HARDWARE_PU)."""
    first_peak_pu: float | None
    """Largest current within 5 ms of an event."""
    recovery_median: float | None
    recovery_worst: float | None
    """Of those that survived, in settling times."""
    swing_rad: float | None
    """Largest swing of the angle."""

    @property
    def share(self) -> float | None:
        """Share of the judged cases that survived."""
        return self.survived / self.judged if self.judged else None


def figures_of(results: Iterable[CaseResult], settling_time: float) -> SurvivalFigures:
    """Figures over results of subjects that all have this settling time in s."""
    results = list(results)
    judged = [result.verdict for result in results if result.verdict.judged]
    good = [verdict for verdict in judged if verdict.survived]
    peaks = [verdict.peak_pu for verdict in judged if verdict.peak_pu is not None]
    recoveries = [verdict.recovery_s / settling_time for verdict in good if verdict.recovery_s is not None]
    count = Counter(result.verdict.status for result in results)
    return SurvivalFigures(
        cases=len(results),
        judged=len(judged),
        survived=len(good),
        statuses={status: count[status] for status in STATUSES if count[status]},
        peak_pu=_largest(peaks),
        peak_median_pu=float(np.median(peaks)) if peaks else None,
        peak_99_pu=float(np.percentile(peaks, 99.0)) if peaks else None,
        peak_kept=sum(peak <= CURRENT_PU for peak in peaks) / len(judged) if peaks else None,
        beyond_hardware=sum(verdict.beyond_hardware for verdict in good),
        first_peak_pu=_largest([v.first_peak_pu for v in judged if v.first_peak_pu is not None]),
        recovery_median=float(np.median(recoveries)) if recoveries else None,
        recovery_worst=_largest(recoveries),
        swing_rad=_largest([v.swing_rad for v in judged if v.swing_rad is not None]),
    )


def by_group(results: Iterable[CaseResult]) -> dict[str, tuple[CaseResult, ...]]:
    """Results by the group of their case, in the order in which groups first appear."""
    found: dict[str, list[CaseResult]] = {}
    for result in results:
        found.setdefault(result.case.group, []).append(result)
    return {group: tuple(members) for group, members in found.items()}


def _largest(values: Sequence[float]) -> float | None:
    return max(values) if values else None


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

    The shorter half of the lengths is tried in every cell, and the longer half where all of these were survived: what
    becomes of a fault that is longer than one that was lost does not matter. Bisection between the longest that was
    survived before the first loss and this loss follows, down to ``resolution_s``, in all cells side by side.
    """
    lengths, half = np.asarray(lengths_s, dtype=float), -(-len(lengths_s) // 2)
    judged, survived = np.ones(count, dtype=bool), np.ones((count, len(lengths)), dtype=bool)
    for some in (slice(0, half), slice(half, len(lengths))):
        open_ = np.flatnonzero(judged & survived.all(axis=1))
        tried = lengths[some]
        if len(open_) and len(tried):
            found = faults_of(np.repeat(open_, len(tried)), np.tile(tried, len(open_)))
            judged[open_] &= found.judged.reshape(len(open_), -1).all(axis=1)
            survived[open_, some] = found.survived.reshape(len(open_), -1)
    bounded = judged & ~survived.all(axis=1)
    lost = np.argmin(survived, axis=1)  # the first loss; 0 too where there is none
    good = np.where(bounded, np.where(lost > 0, lengths[lost - 1], 0.0), lengths[-1])
    bad = np.where(bounded, lengths[lost], good)
    while len(open_ := np.flatnonzero(bad - good > resolution_s)):
        middle = 0.5 * (good[open_] + bad[open_])
        held = faults_of(open_, middle).survived
        good[open_], bad[open_] = np.where(held, middle, good[open_]), np.where(held, bad[open_], middle)
    return ClearingTimes(np.where(judged, good, np.nan), bounded)
