"""Boxes of true grids and of estimates: where a proof begins, what differs from piece to piece of the schedule, and a
table's columns over boxes whose estimates meet several of its cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vsgdesign.certificate.boxes import basis_of, bilinear, halved
from vsgdesign.certificate.error_bounds import error_segments
from vsgdesign.certificate.region import Region, System
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.grid import SCR_BASES, ScrBasis
from vsgdesign.equations.power_flow import POWER_MARGIN
from vsgdesign.runtime.table import TableSchedule

Array = NDArray[np.float64]

_WIDEST = 0.15, 0.13
"""Of the cells of grids at the start: the logarithm of the ratio of the first coordinates, and the angle in rad."""

NATURAL = np.array([1.5, 2.0, 1.0, 1.0, 0.35, 0.35])
"""How much a coordinate's half-width counts where nothing better is known; that of the first one relative to itself."""


SMALLEST = 2.0
"""Frequency in rad/s near which f is smallest."""

_OVERLAP = 1e-12
"""Relative: pieces of a table overlap by so much."""

_SLACK = 1e-11
"""Relative: the estimates of a box may lie by so much beyond what is computed, or beyond their piece."""

DrawnTo = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Pieces:
    """K pieces of the true grids and of the schedule: on each the same kind of error is the larger one, and all
    estimates lie within the limits of a table, or are drawn to the same edge.

    ``angle``, ``first``, ``slope``: limits (K, 2) of the true angle in rad, and of the estimate's first coordinate and
    R̂/X̂; ``errors``: the coordinates of the errors run to so much on both sides. ``scales`` (4, K): a and b of
    :func:`~vsgdesign.certificate.error_bounds.error_segments`, or none. ``drawn``: whether there are edges."""

    angle: Array
    first: Array
    slope: Array
    errors: float
    scales: Array
    bases: tuple[ScrBasis, ScrBasis]
    """Of the grids' first coordinate and of the estimates'."""
    drawn: bool = False
    table: Columns | None = None
    places: Array | None = None
    """Of a table, by piece: what says that an estimate lies there, (WITHIN + DRAWN, K)."""

    def __len__(self) -> int:
        return len(self.angle)

    def estimates(self, low: Array, high: Array, piece: NDArray[np.intp]) -> tuple[Array, Array]:
        """Least and largest first coordinate and R̂/X̂, (N, 2) each, of the estimates of boxes between limits (N, 6),
        without regard to the limits of their pieces."""
        a_R, b_R, a_X, b_X = self.scales[:, piece]
        if not self.scales.any():
            a_R = a_X = np.ones(len(piece))
        own, basis = self.bases
        R = [np.cos(at[:, 1]) * (1.0 + a_R * c) + b_R * c for at, c in ((high, low[:, 2]), (low, high[:, 2]))]
        X = [np.sin(at[:, 1]) * (1.0 + a_X * c) + b_X * c for at, c in ((low, low[:, 3]), (high, high[:, 3]))]
        if self.scales.any():
            sizes = np.array([own.magnitude(a[:, 0], np.sin(b[:, 1])) for a in (low, high) for b in (low, high)])
            least = basis.counted(np.maximum(R[0], 0.0), X[0]) * sizes.min(axis=0)
            most = basis.counted(np.maximum(np.abs(R[0]), R[1]), X[1]) * sizes.max(axis=0)
        else:
            # It rises with the grid's first coordinate and with both errors, and rises or falls with the angle alone.
            least, most = (
                choice(
                    *(
                        own.magnitude(e[:, 0], np.sin(at[:, 1]))
                        * basis.counted(np.cos(at[:, 1]) * (1.0 + e[:, 2]), np.sin(at[:, 1]) * (1.0 + e[:, 3]))
                        for at in (low, high)
                    )
                )
                for e, choice in ((low, np.minimum), (high, np.maximum))
            )
        slopes = np.array([r / x for r in R for x in X])
        return np.stack([least, most], axis=1), np.stack([slopes.min(axis=0), slopes.max(axis=0)], axis=1)

    def parameters(self, low: Array, high: Array, piece: NDArray[np.intp]) -> Array:
        """The parameters of the programs for boxes between limits (N, 6), (m, N): of the errors; with a table, its
        columns over the box, the place of the piece, and by how much each column may be off."""
        if self.table is None or self.places is None:
            return np.ascontiguousarray(self.scales[:, piece])
        limits = []
        for reach, piece_limits in zip(
            self.estimates(low, high, piece), (self.first[piece], self.slope[piece]), strict=True
        ):
            ends = np.where(np.isinf(piece_limits), piece_limits[:, ::-1], piece_limits)  # what is drawn to an edge
            within = np.clip(reach, ends[:, :1], ends[:, 1:])
            limits.append(within * np.where(within > 0.0, [1.0 - _SLACK, 1.0 + _SLACK], [1.0 + _SLACK, 1.0 - _SLACK]))
        columns, off = self.table.over(1.0 / limits[0][:, ::-1], limits[1])
        return np.concatenate([self.scales[:, piece], columns, self.places[:, piece], off])


@dataclass(frozen=True)
class Part:
    """Boxes of one or more cells: limits (N, 6), the cell and the piece of each, the frequency in rad/s of the arc that
    is looked at first, where f was not known last, and its share of the whole."""

    low: Array
    high: Array
    cell: NDArray[np.int64]
    piece: NDArray[np.int64]
    frequency: Array
    share: Array

    def __len__(self) -> int:
        return len(self.low)

    def take(self, index: Any) -> Part:
        """Some of the boxes."""
        return Part(*(value[index] for value in vars(self).values()))

    def halves(self, dimension: NDArray[np.intp]) -> Part:
        """Each cut in the middle of its dimension."""
        low, high = halved(self.low, self.high, dimension)
        cell, piece = (np.concatenate([v, v]) for v in (self.cell, self.piece))
        frequency = np.concatenate([self.frequency, self.frequency])
        share = 0.5 * np.concatenate([self.share, self.share])
        return Part(low, high, cell, piece, frequency, share)

    @classmethod
    def joined(cls, parts: list[Part]) -> Part:
        """All boxes of some parts."""
        return cls(*(np.concatenate(columns) for columns in zip(*(vars(p).values() for p in parts), strict=True)))


def pieces_of(system: System, region: Region, drawn_to: DrawnTo | None = None) -> Pieces:
    """The pieces of a schedule: a table, the edges that estimates are drawn to, else one. ``drawn_to``: the limits of
    SCR and R/X of a table's scheduler; None: its axes."""
    low, high, rows = error_segments(region) if region.error_Z else (*np.arctan(region.x_over_r), np.zeros((4, 1)))
    angles = np.stack(np.broadcast_arrays(low, high), axis=-1).reshape(-1, 2)
    schedule, most = system.schedule, region.largest_error
    bases = SCR_BASES[system.study.scr_basis], basis_of(system)
    if not isinstance(schedule, TableSchedule):
        every = np.broadcast_to([0.0, np.inf], angles.shape)
        return Pieces(angles, every, every * [-1.0, 1.0], most, rows, bases)
    ends = [(float(axis[0]), float(axis[-1])) for axis in (1.0 / schedule.scr[::-1], schedule.r_over_x)]
    if drawn_to is not None:
        ends = [(1.0 / drawn_to[0][1], 1.0 / drawn_to[0][0]), drawn_to[1]]
    # With an error of |Z_g| a certificate holds for the estimates within the axes, as that of the power loops does.
    drawn = not region.error_Z
    parts = [(a, b) for a in _intervals(*ends[0], drawn) for b in _intervals(*ends[1], drawn)]
    first, slope = (np.array([part[k].limits for part in parts]) for k in range(2))
    count = len(angles)
    return Pieces(
        np.repeat(angles, len(parts), axis=0),
        np.tile(first, (count, 1)),
        np.tile(slope, (count, 1)),
        most,
        np.repeat(rows, len(parts), axis=1),
        bases,
        drawn,
        Columns(schedule),
        np.tile(_of_place(bases[1], parts), count),
    )


class _Interval(NamedTuple):
    """Of an axis: the limits of what lies there, and the edge that all is drawn to."""

    limits: tuple[float, float]
    edge: float | None = None


def _intervals(low: float, high: float, drawn: bool) -> list[_Interval]:
    """What lies between the limits of an axis and, where estimates are drawn in, beyond."""
    within = _Interval((low, high))
    if not drawn:
        return [within]
    beyond = _Interval((-np.inf, low), low), _Interval((high, np.inf), high)
    return [beyond[0], within, beyond[1]] if low < high else list(beyond)


def _of_place(basis: ScrBasis, cells: Sequence[tuple[_Interval, _Interval]]) -> Array:
    """The parameters of pieces of a table by which an estimate is told to lie there, and drawn to their edges,
    (WITHIN + DRAWN, K)."""
    found = []
    for first, slope in cells:
        (low, high), (least, most) = first.limits, slope.limits
        row = [-1.0, low * (1.0 - _OVERLAP)] if np.isfinite(low) else [0.0, 0.0]
        row += [1.0, -high * (1.0 + _OVERLAP)] if np.isfinite(high) else [0.0, 0.0]
        row += [-1.0, least * (1.0 - _OVERLAP)] if np.isfinite(least) else [0.0, 0.0]
        row += [1.0, -most * (1.0 + _OVERLAP)] if np.isfinite(most) else [0.0, 0.0]
        row += [1.0, 0.0] if first.edge is None else [0.0, first.edge]
        row += [1.0, 0.0] if slope.edge is None else [0.0, slope.edge]
        # The estimate, over its first coordinate, by the part of it that counts, and by |Z_g|: one of them is meant.
        edge = 1.0 if first.edge is None else first.edge
        if slope.edge is None:
            unit = np.zeros(2)
            row += [1.0, 0.0] if first.edge is None else [0.0, edge]
        else:
            unit = np.array([slope.edge, 1.0]) / basis.counted(slope.edge, 1.0) * edge
            row += [0.0, 0.0]
        for one in unit:
            row += [one, 0.0] if first.edge is None else [0.0, one]
        found.append(row)
    return np.array(found).T


def _within_reach(pieces: Pieces, low: Array, high: Array) -> NDArray[np.intp]:
    """The pieces that the estimates of a cell of grids may meet."""
    every = np.arange(len(pieces))
    middle, e = 0.5 * (low[1] + high[1]), pieces.errors
    meets = (pieces.angle[:, 0] <= middle) & (middle <= pieces.angle[:, 1])
    if pieces.table is not None:
        box = [np.tile([*ends, error, error], (len(every), 1)) for ends, error in ((low, -e), (high, e))]
        for reach, own in zip(pieces.estimates(box[0], box[1], every), (pieces.first, pieces.slope), strict=True):
            meets &= (reach[:, 0] * (1.0 - 1e-9) <= own[:, 1]) & (reach[:, 1] * (1.0 + 1e-9) >= own[:, 0])
    return np.flatnonzero(meets)


def whole(system: System, region: Region, pieces: Pieces) -> tuple[Array, Array, Part]:
    """The cells that a proof begins with, limits (M, 2), and the boxes of all of them."""
    low_1, high_1 = 1.0 / region.scr[1], 1.0 / region.scr[0]
    angle: Any = np.arctan(region.x_over_r)
    counts = [max(math.ceil(width / most), 1) for width, most in zip(
        (math.log(high_1 / low_1), angle[1] - angle[0]), _WIDEST, strict=True
    )]  # fmt: skip
    first, second = np.geomspace(low_1, high_1, counts[0] + 1), np.linspace(angle[0], angle[1], counts[1] + 1)
    first[[0, -1]], second[[0, -1]] = (low_1, high_1), angle
    second = np.unique([*second, *pieces.angle[:, 0], *pieces.angle[:, 1]])
    cells = np.array([[[a, c], [b, d]] for a, b in pairwise(first) for c, d in pairwise(second)])
    lows, highs, of_cell, of_piece = [], [], [], []
    e = pieces.errors
    for k, (cell_low, cell_high) in enumerate(cells):
        p, q = _powers(system, region, cell_low, cell_high)
        index = _within_reach(pieces, cell_low, cell_high)
        count = len(index)
        lows.append(np.tile([*cell_low, -e, -e, p[0], q[0]], (count, 1)))
        highs.append(np.tile([*cell_high, e, e, p[1], q[1]], (count, 1)))
        of_cell.append(np.full(count, k))
        of_piece.append(index)
    low, high = np.concatenate(lows), np.concatenate(highs)
    width = high - low
    volume = np.where(width > 0.0, width, 1.0).prod(axis=1)
    part = Part(
        low,
        high,
        np.concatenate(of_cell).astype(np.int64),
        np.concatenate(of_piece).astype(np.int64),
        np.full(len(low), SMALLEST),
        volume / volume.sum(),
    )
    return cells[:, 0], cells[:, 1], part


def _powers(system: System, region: Region, low: Array, high: Array) -> tuple[list[float], list[float]]:
    """Least and largest p and q in a cell: P\\|Z\\|/V² with every limit of P, \\|Z\\| and V, and no more than the
    static limit leaves."""
    c = system.study.converter
    basis = SCR_BASES[system.study.scr_basis]
    sizes = [float(basis.magnitude(first, np.sin(angle))) for first in (low[0], high[0]) for angle in (low[1], high[1])]
    slow = min(system.study.grid_source.omega_g / c.omega_n, 1.0)
    most = PHASES / POWER_MARGIN / slow * (1.0 + 1e-9)
    found = []
    for limits in (region.P, region.Q):
        every = [
            PHASES * value / c.S_rated * size / V**2
            for value in limits
            for size in (min(sizes), max(sizes))
            for V in (c.V_min_pu, c.V_max_pu)
        ]
        found.append([max(min(every) - 1e-9, -most), min(max(every) + 1e-9, most)])
    return found[0], found[1]


_COEFFICIENTS = 4
_PLACES = 5
"""Of a range, in each direction, at which the form is fitted to the column."""

_ROUNDING = 1e-12
"""Of the sizes of its terms, by which a form is taken to be off beside the difference that is found."""

_compiled: Any = njit(cache=True, nogil=True, error_model="numpy")


class Columns:
    """The columns of a table as bilinear forms, and how far the columns are from these (:eq:`full-order-column`).

    Within one cell a column is bilinear, and the form is the column itself. Over more cells it is the form of least
    squares at places of the range, moved so that the column lies as far above as below. Both are bilinear between the
    nodes, so that their largest difference is at a node or at an end of the range.
    """

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
