"""What is kept of the runs: counts, the worst cases and a map. Two summaries merge without an error, in any order."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

PER_DECADE = 250
LOWEST, DECADES = 1e-6, 10

EDGES = tuple(LOWEST * 10.0 ** (k / PER_DECADE) for k in range(PER_DECADE * DECADES + 1))
"""Upper edges: a value is in the first bin whose edge it does not exceed. The last bin has none: it is infinity's."""

QUANTILE_ERROR = 10.0 ** (1.0 / PER_DECADE) - 1.0
"""Largest relative error of a quantile, 0.93 %: it is the upper edge of a bin, so it is never too small."""

_EDGES = np.array(EDGES)

K = TypeVar("K", int, str)


def binned(values: NDArray[np.float64]) -> dict[int, int]:
    """How many of the values (n,) are in which bin; infinity and NaN are in the last one."""
    places = np.searchsorted(_EDGES, values, side="left")  # NaN sorts behind everything
    bins, counts = np.unique(places, return_counts=True)
    return {int(k): int(count) for k, count in zip(bins, counts, strict=True)}


def merged_counts(one: Mapping[K, int], other: Mapping[K, int]) -> dict[K, int]:
    """Both together, in the order of their bins or names."""
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


WORST = 20
"""Worst cases that are kept of each promise of a family."""

BROKEN = 1000
"""Broken cases that are kept with their figures: those with the lowest numbers. All are counted."""

MAP = (12, 8)
"""Bins of the map: SCR and X/R."""


class CaseFigures(NamedTuple):
    """One case of those that are kept."""

    number: int
    """Its number: with the seed it is everything that the case depends on."""
    severity: float
    """The figure over the most that keeps its promise; infinite where the figure is."""
    status: str
    """A name of :data:`vsgdesign.simulation.lanes.STATUSES`."""
    figures: tuple[float, ...]
    """In the order of :data:`vsgdesign.campaigns.verification.counting.FIGURES`; NaN where a figure does not exist."""


class BrokenCase(NamedTuple):
    """A case that breaks promises."""

    number: int
    family: str
    promises: tuple[str, ...]
    status: str
    figures: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class PromiseCount:
    """How a promise was kept in the judged cases of a family."""

    broken: int = 0
    worst: tuple[CaseFigures, ...] = ()
    """Up to WORST cases, the worst first; of equal ones the lowest number first."""
    bins: Mapping[int, int] = field(default_factory=dict)
    """Histogram of the figure (:mod:`vsgdesign.campaigns.verification.summary`)."""
    worst_map: NDArray[np.float64] = field(default_factory=lambda: np.full(MAP, -math.inf))
    """MAP, the largest figure in each bin of the map; -inf where nothing was judged."""
    noise: float = 0.0
    """The most that noise may do to the figure in any judged case, in its unit."""

    def merged(self, other: PromiseCount) -> PromiseCount:
        """Both together."""
        return PromiseCount(
            broken=self.broken + other.broken,
            worst=worst_of((*self.worst, *other.worst)),
            bins=merged_counts(self.bins, other.bins),
            worst_map=np.maximum(self.worst_map, other.worst_map),
            noise=max(self.noise, other.noise),
        )


@dataclass(frozen=True, kw_only=True)
class FamilyCount:
    """The cases of one family."""

    drawn: int = 0
    judged: int = 0
    left_out: Mapping[str, int] = field(default_factory=dict)
    """Cases that are not asked for, by the reason."""
    lost: Mapping[str, int] = field(default_factory=dict)
    """Judged cases that were not survived, by the status."""
    beyond: int = 0
    """Cases that were survived with a current above HARDWARE_PU, which hardware does not carry."""
    beyond_worst: tuple[CaseFigures, ...] = ()
    """Up to WORST of them, the largest current first; the severity is the current over HARDWARE_PU."""
    broken: int = 0
    """Cases that break at least one promise."""
    promises: Mapping[str, PromiseCount] = field(default_factory=dict)
    judged_map: NDArray[np.int64] = field(default_factory=lambda: np.zeros(MAP, np.int64))
    broken_map: NDArray[np.int64] = field(default_factory=lambda: np.zeros(MAP, np.int64))

    def merged(self, other: FamilyCount) -> FamilyCount:
        """Both together."""
        nothing = PromiseCount()
        return FamilyCount(
            drawn=self.drawn + other.drawn,
            judged=self.judged + other.judged,
            left_out=merged_counts(self.left_out, other.left_out),
            lost=merged_counts(self.lost, other.lost),
            beyond=self.beyond + other.beyond,
            beyond_worst=worst_of((*self.beyond_worst, *other.beyond_worst)),
            broken=self.broken + other.broken,
            promises={
                name: self.promises.get(name, nothing).merged(other.promises.get(name, nothing))
                for name in sorted({*self.promises, *other.promises})
            },
            judged_map=self.judged_map + other.judged_map,
            broken_map=self.broken_map + other.broken_map,
        )


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Everything that is kept of some blocks of runs. The memory that it takes does not depend on how many they are."""

    blocks: tuple[int, ...] = ()
    """Numbers of the blocks, ascending."""
    instruction_sets: tuple[str, ...] = ()
    """Of the machines that computed them."""
    families: Mapping[str, FamilyCount] = field(default_factory=dict)
    broken: tuple[BrokenCase, ...] = ()
    """Up to BROKEN broken cases, by number."""

    def merged(self, other: Summary) -> Summary:
        """Both together: the same whatever the order. Raises ValueError where they have a block in common."""
        common = set(self.blocks) & set(other.blocks)
        if common:
            raise ValueError(f"block {min(common)} is in both")
        nothing = FamilyCount()
        return Summary(
            blocks=tuple(sorted((*self.blocks, *other.blocks))),
            instruction_sets=tuple(sorted({*self.instruction_sets, *other.instruction_sets})),
            families={
                name: self.families.get(name, nothing).merged(other.families.get(name, nothing))
                for name in sorted({*self.families, *other.families})
            },
            broken=tuple(sorted((*self.broken, *other.broken))[:BROKEN]),
        )

    @property
    def drawn(self) -> int:
        """Runs in all."""
        return sum(family.drawn for family in self.families.values())

    @property
    def judged(self) -> int:
        """Runs that were judged."""
        return sum(family.judged for family in self.families.values())


def worst_of(cases: Iterable[CaseFigures], count: int = WORST) -> tuple[CaseFigures, ...]:
    """The worst first; of equal ones the lowest number first."""
    return tuple(sorted(cases, key=lambda case: (-case.severity, case.number))[:count])


def summary_document(summary: Summary) -> dict[str, Any]:
    """A summary in JSON's types, without a rounding. What is not finite has a word: NaN, inf, -inf."""
    return {
        "blocks": _ranges(summary.blocks),
        "instruction_sets": list(summary.instruction_sets),
        "families": {
            name: {
                "drawn": family.drawn,
                "judged": family.judged,
                "left_out": dict(family.left_out),
                "lost": dict(family.lost),
                "beyond": family.beyond,
                "beyond_worst": _cases_document(family.beyond_worst),
                "broken": family.broken,
                "judged_map": family.judged_map.ravel().tolist(),
                "broken_map": family.broken_map.ravel().tolist(),
                "promises": {
                    key: {
                        "broken": one.broken,
                        "worst": _cases_document(one.worst),
                        "bins": [[k, count] for k, count in one.bins.items()],
                        "worst_map": [_said(x) for x in one.worst_map.ravel().tolist()],
                        "noise": one.noise,
                    }
                    for key, one in family.promises.items()
                },
            }
            for name, family in summary.families.items()
        },
        "broken": [
            [case.number, case.family, list(case.promises), case.status, [_said(x) for x in case.figures]]
            for case in summary.broken
        ],
    }


def summary_of(document: Mapping[str, Any]) -> Summary:
    """The inverse of :func:`summary_document`. Raises ValueError, KeyError or TypeError for anything else."""
    return Summary(
        blocks=tuple(k for first, step, count in document["blocks"] for k in range(first, first + step * count, step)),
        instruction_sets=tuple(document["instruction_sets"]),
        families={
            name: FamilyCount(
                drawn=family["drawn"],
                judged=family["judged"],
                left_out=dict(family["left_out"]),
                lost=dict(family["lost"]),
                beyond=family["beyond"],
                beyond_worst=_cases_of(family["beyond_worst"]),
                broken=family["broken"],
                judged_map=np.array(family["judged_map"], np.int64).reshape(MAP),
                broken_map=np.array(family["broken_map"], np.int64).reshape(MAP),
                promises={
                    key: PromiseCount(
                        broken=one["broken"],
                        worst=_cases_of(one["worst"]),
                        bins=dict(one["bins"]),
                        worst_map=np.array(list(map(float, one["worst_map"]))).reshape(MAP),
                        noise=float(one["noise"]),
                    )
                    for key, one in family["promises"].items()
                },
            )
            for name, family in document["families"].items()
        },
        broken=tuple(
            BrokenCase(index, family, tuple(promises), status, tuple(map(float, figures)))
            for index, family, promises, status, figures in document["broken"]
        ),
    )


def _cases_document(cases: Iterable[CaseFigures]) -> list[list[Any]]:
    return [[case.number, _said(case.severity), case.status, [_said(x) for x in case.figures]] for case in cases]


def _cases_of(rows: Iterable[Any]) -> tuple[CaseFigures, ...]:
    return tuple(
        CaseFigures(index, float(severity), status, tuple(map(float, figures)))
        for index, severity, status, figures in rows
    )


def _said(value: float) -> float | str:
    return value if math.isfinite(value) else str(value)


def _ranges(blocks: tuple[int, ...]) -> list[tuple[int, int, int]]:
    """Ascending numbers as (first, step, count): a shard's blocks are one such row."""
    rows: list[tuple[int, int, int]] = []
    for k in blocks:
        if rows:
            first, step, count = rows[-1]
            last = first + step * (count - 1)
            if count == 1 or k - last == step:
                rows[-1] = (first, k - last if count == 1 else step, count + 1)
                continue
        rows.append((k, 1, 1))
    return rows
