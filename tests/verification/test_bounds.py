"""The bound against exact binomial tails, summed in rational arithmetic."""

from __future__ import annotations

from fractions import Fraction
from math import comb

import pytest

from vsgdesign.campaigns.verification.document import one_in, upper_bound


def tail(broken: int, judged: int, share: float) -> float:
    """The probability of at most ``broken`` of ``judged``, term by term and without rounding."""
    p = Fraction(share)
    return float(sum(comb(judged, k) * p**k * (1 - p) ** (judged - k) for k in range(broken + 1)))


@pytest.mark.parametrize("confidence", [0.9, 0.99, 0.999])
@pytest.mark.parametrize(("broken", "judged"), [(0, 1), (0, 300), (1, 2), (1, 300), (7, 90), (29, 30), (150, 300)])
def test_the_bound_is_where_the_tail_is_what_is_left(broken: int, judged: int, confidence: float) -> None:
    bound = upper_bound(broken, judged, confidence)
    assert tail(broken, judged, bound) == pytest.approx(1.0 - confidence, rel=1e-9)


@pytest.mark.parametrize(("broken", "judged"), [(0, 0), (1, 1), (40, 40)])
def test_where_all_are_broken_nothing_is_excluded(broken: int, judged: int) -> None:
    assert upper_bound(broken, judged) == 1.0


@pytest.mark.parametrize(("broken", "judged", "confidence"), [(2, 1, 0.9), (-1, 5, 0.9), (0, 5, 0.0), (0, 5, 1.0)])
def test_counts_that_cannot_be(broken: int, judged: int, confidence: float) -> None:
    with pytest.raises(ValueError, match=r"cannot be broken|between 0 and 1"):
        upper_bound(broken, judged, confidence)


@pytest.mark.parametrize(("broken", "judged", "said"), [(0, 100_000, 21_700), (0, 10, 2), (3, 3, 1), (0, 0, 1)])
def test_one_in(broken: int, judged: int, said: int) -> None:
    assert one_in(upper_bound(broken, judged)) == said


@pytest.mark.parametrize("broken", range(0, 200, 7))
def test_one_in_never_says_more_than_the_bound(broken: int) -> None:
    bound = upper_bound(broken, 10_000)
    assert bound <= 1.0 / one_in(bound) <= 1.02 * bound
