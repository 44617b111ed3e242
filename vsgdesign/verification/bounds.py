"""What a count of broken promises says of the share of all cases: the exact one-sided bound.

The bound holds for cases that were drawn independently and all with the same distribution. A search, a stratified
draw or a weighted one must never be counted here.
"""

from __future__ import annotations

import math

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
