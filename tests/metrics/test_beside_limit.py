"""Digits beside a limit: what is printed is on the side of the limit on which the value is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vsgdesign.metrics.met import beside_limit
from vsgdesign.report.drawing.quantities import number, percent


def decimals(value: float, digits: int) -> str:
    return f"{value:.{digits}f}"


@pytest.mark.parametrize(
    ("value", "limit", "missed", "said"),
    [
        (1.301, 1.3, True, "1.301"),
        (1.31, 1.3, True, "1.31"),
        (1.2996, 1.3, True, "1.2996"),
        (1.2996, 1.3, False, "1.30"),
        (1.3000001, 1.3, True, "1.3000001"),
        (1.3, 1.3, True, "1.30"),
        (1.301, None, True, "1.30"),
        (math.inf, 1.3, True, "inf"),
        (-0.001, 0.0, True, "-0.00"),
    ],
)
def test_a_missed_limit_is_seen(value: float, limit: float | None, missed: bool, said: str) -> None:
    assert beside_limit(value, limit, missed, decimals, 2) == said


def test_random_misses_print_on_their_side() -> None:
    rng = np.random.default_rng(16)
    for limit, miss in zip(rng.uniform(0.1, 50.0, 300).round(3), 10.0 ** rng.uniform(-8, 0, 300), strict=True):
        for value in (limit + miss, limit - miss):
            for text, digits in ((decimals, 2), (number, 3), (percent, 1)):
                shown = float(beside_limit(value, limit, True, text, digits).replace("−", "-"))
                assert (shown > limit) == (value > limit), (value, limit, shown)
                assert shown != limit
