"""What a verification says: shares, bounds, quantiles and the map, in JSON's types."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from vsgdesign.campaigns.verification.blocks import VerificationJob
from vsgdesign.campaigns.verification.promises import FIGURES, Promise
from vsgdesign.campaigns.verification.summary import QUANTILE_ERROR, FamilyCount, PromiseCount, Summary, quantile
from vsgdesign.metrics.survival import HARDWARE_PU

CONFIDENCE = 0.99
"""Where nothing is said."""


def upper_bound(broken: int, judged: int, confidence: float = CONFIDENCE) -> float:
    """The share of broken cases that is not exceeded with a stated confidence (:eq:`clopper-pearson`).

    It is the share p at which at most ``broken`` of ``judged`` independent cases are broken with the probability
    1 - confidence: the one-sided bound of Clopper and Pearson, exact and never too small. It is 1 where every case is
    broken, and where nothing was judged. Raises ValueError for counts or a confidence that cannot be.
    """
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence = {confidence!r}: must be between 0 and 1")
    if not 0 <= broken <= judged:
        raise ValueError(f"{broken} of {judged} cases cannot be broken")
    if broken == judged:
        return 1.0
    if broken == 0:  # the same number in closed form, without the rounding of a search for it
        return -math.expm1(math.log1p(-confidence) / judged)
    from scipy.special import betaincinv  # all of scipy.stats would take longer to load than a table to verify

    return float(betaincinv(broken + 1, judged - broken, confidence))


def one_in(bound: float) -> int:
    """The n of "fewer than 1 in n": 1 over a bound, rounded down to three digits, so that it never says too much."""
    if bound >= 1.0:
        return 1
    n = math.floor(1.0 / bound)
    unit = 10 ** max(len(str(n)) - 3, 0)
    return n // unit * unit


def record_faults(record: Mapping[str, Any]) -> Iterator[str]:
    """Where the shares, bounds and worst figures of a table's record do not belong to its counts, one sentence each."""
    for key, family in record["families"].items():
        for promised, promise in family["promises"].items():
            name = f"verification.families.{key}.promises.{promised}"
            for field, made in _share(promise["broken"], promise["judged"], record["confidence"]).items():
                stated = promise[field]
                same = stated is made if stated is None or made is None else abs(stated - made) <= 1e-9 * abs(made)
                if not same:
                    yield f"{name}.{field} is {stated}, {promise['broken']} of {promise['judged']} give {made}"
            worst, least = promise["worst"], promise.get("at_least", False)
            limit = promise["limit"] + promise.get("noise", 0.0)
            beyond = worst is not None and (worst < limit if least else worst > limit)
            if promise["broken"] and worst is not None and not beyond:
                yield f"{name}.worst is {worst:g}, within the limit {limit:g}, but {promise['broken']} are broken"
            if not promise["broken"] and beyond and abs(worst - limit) > _ALLOWED * limit:
                yield f"{name}.worst is {worst:g}, beyond the limit {limit:g}, but none is broken"


_ALLOWED = 0.1
"""Share of a limit by which a kept promise may be beyond it: more than any allowance of the judge."""

QUANTILES = ("50", "90", "99", "99.9")
"""Percentiles of each figure that are given."""


def counts_document(job: VerificationJob, summary: Summary, confidence: float) -> dict[str, Any]:
    """The counts of a verification with their bounds. A figure that does not exist (never settled) is infinite.

    A share is of the judged cases, and its bound is exact because all of them are drawn independently.
    """
    broken = sum(family.broken for family in summary.families.values())
    return {
        "runs": summary.drawn,
        "judged": summary.judged,
        **_share(broken, summary.judged, confidence),
        "families": {
            name: _family(job, summary.families[name], confidence) for name in job.families if name in summary.families
        },
        "map": {
            "scr_basis": job.axes.scr_basis,
            "scr_edges": job.axes.scr_edges,
            "x_over_r_edges": job.axes.x_over_r_edges,
            "families": {
                name: {
                    "judged": summary.families[name].judged_map,
                    "broken": summary.families[name].broken_map,
                    "worst_of": {
                        promise.figure: summary.families[name].promises[promise.name].worst_map
                        for promise in job.promises
                        if promise.name in summary.families[name].promises
                    },
                }
                for name in job.families
                if name in summary.families
            },
        },
        "quantile_error": QUANTILE_ERROR,
        "broken_cases": [
            {
                "case": case.number,
                "family": case.family,
                "promises": case.promises,
                "status": case.status,
                "figures": figures_document(case.figures),
            }
            for case in summary.broken
        ],
    }


def figures_document(figures: tuple[float, ...]) -> dict[str, float]:
    """The figures of a case by name."""
    return dict(zip(FIGURES, figures, strict=True))


def _family(job: VerificationJob, family: FamilyCount, confidence: float) -> dict[str, Any]:
    return {
        "drawn": family.drawn,
        "judged": family.judged,
        "left_out": dict(family.left_out),
        "lost": dict(family.lost),
        "beyond_hardware": {
            "above_pu": HARDWARE_PU,
            "survived": family.beyond,
            "largest_pu": HARDWARE_PU * family.beyond_worst[0].severity if family.beyond else None,
            "cases": [case.number for case in family.beyond_worst],
        },
        **_share(family.broken, family.judged, confidence),
        "promises": {
            promise.name: {
                "limit": promise.limit,
                **({} if promise.limit_Q is None else {"limit_Q": promise.limit_Q}),
                "most": promise.most,
                **({"noise": count.noise} if count.noise > 0.0 else {}),
                "unit": promise.unit,
                "figure": promise.figure,
                "survival": promise.survival,
                "at_least": False,
                "judged": family.judged,
                **_share(count.broken, family.judged, confidence),
                "worst": (worst := _worst(promise, count)),
                "quantiles": {key: quantile(count.bins, float(key) / 100.0, worst) for key in QUANTILES},
            }
            for promise in job.promises
            if (count := family.promises.get(promise.name)) is not None
        },
    }


def _worst(promise: Promise, count: PromiseCount) -> float:
    """The largest value of a promise's figure; NaN where nothing was judged."""
    if not count.worst:
        return math.nan
    first = count.worst[0]
    return math.inf if math.isinf(first.severity) else first.figures[tuple(FIGURES).index(promise.figure)]


def _share(broken: int, judged: int, confidence: float) -> dict[str, Any]:
    """How many, which share of the judged cases, and the bound on the share of all cases."""
    bound = upper_bound(broken, judged, confidence)
    return {
        "broken": broken,
        "share": broken / judged if judged else None,
        "bound": bound,
        "one_in": one_in(bound),
    }
