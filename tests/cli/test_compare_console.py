"""A number of a comparison shows why its limit is missed, on the page and on the terminal."""

from __future__ import annotations

import math

import pytest

from vsgdesign.report.comparison.tables import reached


@pytest.mark.parametrize(
    ("value", "factor", "limit", "at_least", "said"),
    [
        (1.3070, 1.0, 1.3, False, "1.31"),
        (1.2996, 1.0, 1.3, False, "1.30"),
        (1.3004, 1.0, 1.3, False, "1.30"),  # within half a per cent of the time, so that it is met
        (0.050502, 100.0, 0.05, False, "5.05"),
        (0.050498, 100.0, 0.05, False, "5.05"),
        (0.49996, 1.0, 0.5, True, "0.49996"),
        (0.50004, 1.0, 0.5, True, "0.500"),
        (math.inf, 1.0, 1.3, False, "∞"),
    ],
)
def test_a_missed_limit_is_shown_with_the_digits_that_tell_it(
    value: float, factor: float, limit: float, at_least: bool, said: str
) -> None:
    assert reached(value, factor, limit, at_least=at_least) == said
