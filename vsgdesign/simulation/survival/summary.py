"""Figures over many verdicts: how many survived, how large the currents were, how long recovery took."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

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
