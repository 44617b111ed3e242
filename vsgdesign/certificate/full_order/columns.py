"""A table's columns over boxes whose estimates meet several of its cells: a bilinear form, and how far the column is
from it (:eq:`full-order-column`).

Within one cell a column is bilinear, and the form is the column itself. Over more cells it is the form of least squares
at places of the range, moved so that the column lies as far above as below. Both are bilinear between the nodes, so
that their largest difference is at a node or at an end of the range.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vsgdesign.certificate.boxes import bilinear
from vsgdesign.runtime.table import TableSchedule

Array = NDArray[np.float64]

_COEFFICIENTS = 4
_PLACES = 5
"""Of a range, in each direction, at which the form is fitted to the column."""

_ROUNDING = 1e-12
"""Of the sizes of its terms, by which a form is taken to be off beside the difference that is found."""

_compiled: Any = njit(cache=True, nogil=True, error_model="numpy")


class Columns:
    """The columns of a table by its cells."""

    def __init__(self, schedule: TableSchedule) -> None:
        # Copies, which can be written to: for others, and for slices with gaps, Numba compiles the functions once more.
        self.axes: tuple[Array, Array] = (np.array(schedule.scr), np.array(schedule.r_over_x))
        x, y = (np.array([0.5 * (a + b) for a, b in pairwise(axis)]) if len(axis) > 1 else axis for axis in self.axes)
        at = [one.ravel() for one in np.meshgrid(x, y, indexing="ij")]
        cells = [bilinear(schedule, values, *at).reshape(_COEFFICIENTS, len(x), len(y)) for values in schedule.columns]
        self._cells = np.ascontiguousarray(np.moveaxis(np.stack(cells), 1, -1))

    def over(self, x: Array, y: Array) -> tuple[Array, Array]:
        """c_0 … c_3 of c_0 + c_1 x + c_2 y + c_3 xy for each column, one after another, (4 columns, N), and by how much
        the column may be off, (columns, N), where x = SCR and y = R/X of the estimates are between limits (N, 2)."""
        count = len(self._cells)
        found, off = np.zeros((_COEFFICIENTS * count, len(x))), np.zeros((count, len(x)))
        _fit(np.ascontiguousarray(x), np.ascontiguousarray(y), self.axes, self._cells, found, off)
        return found, off


@_compiled
def _cell(axis: Any, at: float) -> int:
    """The interval of an axis that holds a place, or that is next to it."""
    k = 0
    while k < len(axis) - 2 and at > axis[k + 1]:
        k += 1
    return k


@_compiled
def _corners(axis: Any, low: float, high: float, places: Any) -> int:
    """The limits of a range and the nodes between them; returns how many that are."""
    places[0] = low
    count = 1
    for node in axis:
        if low < node < high:
            places[count] = node
            count += 1
    places[count] = high
    return count + 1


@_compiled
def _value(c: Any, x: float, y: float) -> float:
    return c[0] + c[1] * x + (c[2] + c[3] * x) * y


@_compiled
def _column(cells: Any, axes: Any, x: float, y: float) -> float:
    """A column at a place; beyond an axis the edge is held."""
    x, y = min(max(x, axes[0][0]), axes[0][-1]), min(max(y, axes[1][0]), axes[1][-1])
    return _value(cells[_cell(axes[0], x), _cell(axes[1], y)], x, y)


@_compiled
def _least_squares(cells: Any, axes: Any, x: Any, y: Any, c: Any) -> None:
    """c_0 … c_3 by the values at places of a range."""
    x_0, half_x, y_0, half_y = 0.5 * (x[0] + x[1]), 0.5 * (x[1] - x[0]), 0.5 * (y[0] + y[1]), 0.5 * (y[1] - y[0])
    mean, by_x, by_y, by_both, squares = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(_PLACES):
        s = 2.0 * i / (_PLACES - 1) - 1.0
        squares += s * s / _PLACES
        for j in range(_PLACES):
            t = 2.0 * j / (_PLACES - 1) - 1.0
            at_x, at_y = x_0 + s * half_x, y_0 + t * half_y
            value = _column(cells, axes, at_x, at_y) / _PLACES**2
            mean += value
            by_x += s * value
            by_y += t * value
            by_both += s * t * value
    u = 1.0 / (squares * half_x) if half_x > 0.0 else 0.0
    v = 1.0 / (squares * half_y) if half_y > 0.0 else 0.0
    c[3] = by_both * u * v
    c[1], c[2] = by_x * u - c[3] * y_0, by_y * v - c[3] * x_0
    c[0] = mean - by_x * u * x_0 - by_y * v * y_0 + c[3] * x_0 * y_0


@_compiled
def _fit(x: Any, y: Any, axes: Any, cells: Any, found: Any, off: Any) -> None:
    at_x, at_y = np.empty(len(axes[0]) + 2), np.empty(len(axes[1]) + 2)
    c = np.empty(4)
    for n in range(len(x)):
        count_x = _corners(axes[0], x[n, 0], x[n, 1], at_x)
        count_y = _corners(axes[1], y[n, 0], y[n, 1], at_y)
        for k in range(len(cells)):
            _least_squares(cells[k], axes, x[n], y[n], c)
            least, most = np.inf, -np.inf
            for i in range(count_x):
                for j in range(count_y):
                    difference = _column(cells[k], axes, at_x[i], at_y[j]) - _value(c, at_x[i], at_y[j])
                    least, most = min(least, difference), max(most, difference)
            c[0] += 0.5 * (least + most)
            size = _value(np.abs(c), x[n, 1], max(abs(y[n, 0]), abs(y[n, 1])))
            for m in range(4):
                found[4 * k + m, n] = c[m]
            off[k, n] = 0.5 * (most - least) + _ROUNDING * size
