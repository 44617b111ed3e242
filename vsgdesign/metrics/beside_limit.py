"""A value as text beside its limit: with so many digits that a reader sees why it is missed."""

from __future__ import annotations

import math
from collections.abc import Callable

MOST = 15
"""Digits that a value may take."""


def beside_limit(
    value: float, limit: float | None, missed: bool, text: Callable[[float, int], str], digits: int
) -> str:
    """``text(value, digits)``; with more digits where a limit is ``missed`` and both would be rounded to the same text.

    A settling time of 1.301 s that misses 1.3 s is shown as 1.301 s and not as 1.30 s. ``text`` writes a number with so
    many digits, after the point or in all. ``limit`` is in the unit of ``value``.
    """
    if missed and limit is not None and math.isfinite(value):
        for more in range(digits, max(digits, MOST) + 1):
            if text(value, more) != text(limit, more):
                return text(value, more)
    return text(value, digits)
