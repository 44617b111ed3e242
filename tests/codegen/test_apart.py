"""Columns of a log that are taken apart by machine code, against NumPy's own transposing."""

from __future__ import annotations

import numpy as np
import pytest

from vsgdesign.codegen.apart import TakenApart

COLUMNS = (0, 3, 4)


@pytest.mark.parametrize(("width", "lanes"), [(1, 1), (2, 1), (2, 2), (4, 3), (4, 4), (8, 5), (8, 8)])
def test_each_lane_has_its_column_in_one_piece(width: int, lanes: int) -> None:
    """Whatever the pieces are in which the rows come, and nothing is written beside them."""
    rng = np.random.default_rng(17)
    rows = rng.normal(size=(300, 6, width))
    into = [np.full((lanes, len(rows) + 9), np.nan) for _ in COLUMNS]
    apart = TakenApart(COLUMNS, into, width)
    at = 0
    while at < len(rows):
        end = min(at + int(rng.integers(0, 40)), len(rows))
        apart.take(at + 4, rows[at:end])
        at = end
    for column, one in zip(COLUMNS, into, strict=True):
        np.testing.assert_array_equal(one[:, 4 : len(rows) + 4], rows[:, column, :lanes].T)
        assert np.isnan(one[:, :4]).all()
        assert np.isnan(one[:, len(rows) + 4 :]).all()


def test_what_does_not_fit_is_refused() -> None:
    """Machine code would write beside the arrays."""
    into = [np.zeros((2, 10))]
    for columns, arrays, width in (([0, 1], into, 4), ([0], into, 3), ([0], into, 1), ([0], [into[0][:, ::2]], 4)):
        with pytest.raises(ValueError, match="give one array"):
            TakenApart(columns, arrays, width)
    apart = TakenApart([2], into, 4)
    for first, rows in ((0, np.zeros((11, 3, 4))), (-1, np.zeros((1, 3, 4))), (0, np.zeros((1, 2, 4)))):
        with pytest.raises(ValueError, match="10 slots have 4 lanes"):
            apart.take(first, rows)
    with pytest.raises(ValueError, match="10 slots have 4 lanes"):
        apart.take(0, np.zeros((4, 3, 1)).transpose(0, 1, 2)[..., [0, 0, 0]])
