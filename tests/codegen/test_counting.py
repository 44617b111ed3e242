"""The operations of a function, counted by hand and from its expression trees."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.codegen import language
from tests.codegen.counting import Cost, cost_of
from vsgdesign.equations.frames import rotate


def by_hand(x: Any, y: Any) -> Any:
    """Returns (one, two)."""
    turned_x, turned_y = rotate(x, y, 0.6, 0.8)
    larger = turned_x if turned_x > turned_y else turned_y
    return larger / np.sqrt(x), larger - y


def test_counted_by_hand() -> None:
    """A rotation has four products and two sums."""
    assert cost_of(rotate) == Cost(products=4, sums=2, divisions=0, functions=0, choices=0)
    found = cost_of(by_hand)
    assert found == Cost(products=4, sums=3, divisions=1, functions=1, choices=2)
    assert found.multiply_adds == 4


def test_what_is_called_and_what_is_chosen_counts() -> None:
    # Two of 2 x, three comparisons, two "and", one more comparison, two choices of records.
    assert cost_of(language.picked) == Cost(products=2, sums=0, divisions=0, functions=0, choices=8)
    assert cost_of(language.unfolded, {"rule": "twice"}) == Cost(1, 0, 0, 0, 0)
