"""Whether a step of a reference keeps its settling time and its overshoot: one rule for everything that says "met".

The page of a run, ``verify``, ``comply``, ``compare``, a gain table, the explorer and the Python functions ask here
(docs/definitions.md). A value that misses its limit is shown with so many digits that a reader sees it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

SETTLING_ROOM = 1.005
"""A settling time is met up to this many times the time that was asked for."""

OVERSHOOT_ROOM = 5e-4
"""An overshoot is met up to this share of the step above the one that was asked for: 0.05 percentage points."""

MARGIN_ROOM = 1e-3
"""A margin within a thousandth of its limit keeps it: an optimizer stops on the limit, and not always above it."""

_ROUNDING = 1.0 + 1e-12
"""A percentage of a share, and a share of a percentage, may differ in the last digit."""

RULE = "within 0.5 % of the settling time and 0.05 percentage points of the overshoot"
"""The rule in words, as the end of a sentence on what counts as met."""


def most_settling_time(asked_s: Any) -> Any:
    """The longest settling time that meets the one asked for, s; a number or an array."""
    return SETTLING_ROOM * _ROUNDING * asked_s


def most_overshoot(asked: Any, noise: Any = 0.0) -> Any:
    """The largest overshoot that meets the one asked for, as a share of the step; a number or an array.

    ``noise``: what the noise of the judged difference can do to it, as a share of the step; 0 where there is none.
    """
    return (asked + OVERSHOOT_ROOM + noise) * _ROUNDING


def settling_met(settling_time_s: float | None, asked_s: float) -> bool:
    """Whether a settling time (s) meets the one asked for. None, and what is no number: it did not settle."""
    return settling_time_s is not None and bool(settling_time_s <= most_settling_time(asked_s))


def score_met(score: float | None) -> bool:
    """Whether a share of what is asked of the inner loops, 1 where it is just reached, counts as reached."""
    return score is not None and bool(score >= 1.0 - MARGIN_ROOM)


def overshoot_met(overshoot: float, asked: float, noise: float = 0.0) -> bool:
    """Whether an overshoot, as a share of the step, meets the one asked for (:func:`most_overshoot`)."""
    return bool(overshoot <= most_overshoot(asked, noise))


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
