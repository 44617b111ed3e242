"""Boxes of estimated grids, powers and errors: the region cut along the schedule's pieces, and what differs from box to
box."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.error_bounds import ErrorBounds, angles, box_parameters, error_bounds, finer, reach
from vsgdesign.certificate.region import Region, System
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.grid import SCR_BASES, ScrBasis
from vsgdesign.equations.power_flow import POWER_MARGIN
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.runtime.schedule import ClosedFormSchedule
from vsgdesign.runtime.table import TableSchedule

Array = NDArray[np.float64]

UNIT = np.array([0.2, 0.5, 1.0, 0.5, 0.5, 0.5])
"""A size for each coordinate: how boxes are cut where nothing better is known."""

ERROR_PARAMETERS = 4
"""Of a box: the factors that make the least and the largest R of R̂, then X of X̂; a table's columns follow. With
``error_Z``, those of :mod:`vsgdesign.certificate.error_bounds` come last."""


@dataclass(frozen=True)
class Boxes:
    """N boxes of estimates, (N, 6) limits each, and the piece of the schedule, ``piece`` (N,), that each lies in."""

    low: Array
    high: Array
    piece: NDArray[np.intp]
    errors: ErrorBounds | None = None
    """With ``error_Z``: of each piece, what the coordinates of the errors stand for."""

    def __len__(self) -> int:
        return len(self.low)

    def take(self, index: Any) -> Boxes:
        """Some of the boxes."""
        return Boxes(self.low[index], self.high[index], self.piece[index], self.errors)

    def halves(self, dimension: NDArray[np.intp]) -> Boxes:
        """Each cut in the middle of its dimension."""
        return Boxes(*halved(self.low, self.high, dimension), np.concatenate([self.piece, self.piece]), self.errors)


def halved(low: Array, high: Array, dimension: NDArray[np.intp]) -> tuple[Array, Array]:
    """The limits of boxes (N, d), each cut in the middle of its dimension: the lower halves, then the upper ones."""
    rows = np.arange(len(low))
    middle = 0.5 * (low[rows, dimension] + high[rows, dimension])
    begin, end = low.copy(), high.copy()
    begin[rows, dimension], end[rows, dimension] = middle, middle
    return np.concatenate([low, begin]), np.concatenate([end, high])


def encloses(system: System) -> bool:
    """Whether the schedule's gains can be enclosed: normalised parameters that are constant or a table's."""
    return isinstance(system.schedule, (ClosedFormSchedule, TableSchedule))


def whole_region(system: System, region: Region) -> Boxes:
    """All estimates of the region's grids, by pieces of the schedule: a table's cells, and what lies beyond its axes.

    Coordinates (:eq:`box-coordinates`): |Ẑ_g|/Z_base or, for a table on the reactance basis, X̂_g/Z_base; atan(X̂/R̂);
    p = P|Ẑ_g|/V² and q = Q|Ẑ_g|/V²; both errors.
    """
    if region.error_Z:
        return _with_errors_of_Z(system, region)
    e = region.error
    ratio = np.array([region.x_over_r[0] * (1.0 - e) / (1.0 + e), region.x_over_r[1] * (1.0 + e) / (1.0 - e)])
    size = np.array([(1.0 - e) / region.scr[1], (1.0 + e) / region.scr[0]])
    if (basis := basis_of(system)).name != system.study.scr_basis:
        # |Z| is at least X, by 1/sin of the angle.
        sines = np.sin(np.arctan(region.x_over_r))
        size = size * (1.0 / sines[::-1] if basis.counts_resistance else sines)
    powers = _powers(system, region, basis.magnitude(size[1], np.sin(np.arctan(ratio[0]))), 1.0 + e)
    rest_low = [powers[0][0], powers[1][0], -e, -e]
    rest_high = [powers[0][1], powers[1][1], e, e]
    first, second = [size], [np.arctan(ratio)]
    if isinstance(system.schedule, TableSchedule):
        first = _pieces(1.0 / system.schedule.scr[::-1], *size)
        second = _pieces(np.arctan(1.0 / system.schedule.r_over_x[::-1]), *np.arctan(ratio))
    low, high = [], []
    for one in first:
        for other in second:
            low.append([one[0], other[0], *rest_low])
            high.append([one[1], other[1], *rest_high])
    return Boxes(np.array(low), np.array(high), np.arange(len(low)))


def _powers(system: System, region: Region, widest: float, longest: float) -> list[Array]:
    """Least and largest p and q for estimates of at most ``widest`` (pu), ``longest`` times the truth."""
    c = system.study.converter
    # No more than the static limit leaves: |Z||S|/V² ≤ PHASES/1.3, at the rated frequency.
    slow = min(system.study.grid_source.omega_g / c.omega_n, 1.0)
    most = PHASES / POWER_MARGIN * longest / slow
    largest = PHASES * widest / (c.S_rated * c.V_min_pu**2)
    return [np.clip([min(x[0] * largest, 0.0), max(x[1] * largest, 0.0)], -most, most) for x in (region.P, region.Q)]


def _with_errors_of_Z(system: System, region: Region) -> Boxes:
    """:func:`whole_region` for an error set with ``error_Z``. A table's estimates are those within its axes."""
    basis, schedule = basis_of(system), system.schedule
    own = SCR_BASES[system.study.scr_basis]
    counted = np.array([1.0 / region.scr[1], 1.0 / region.scr[0]])
    if basis.name != own.name:
        # |Z| is at least X, by 1/sin of the angle.
        sines = np.sin(np.arctan(region.x_over_r))
        counted = counted * (1.0 / sines[::-1] if basis.counts_resistance else sines)
    size = counted * reach(region, basis)
    angle = np.array(angles(region))
    first, second = [size], [angle]
    if isinstance(schedule, TableSchedule):
        nodes = 1.0 / schedule.scr[::-1], np.arctan(1.0 / schedule.r_over_x[::-1])
        size, angle = (np.clip(limits, axis[0], axis[-1]) for limits, axis in zip((size, angle), nodes, strict=True))
        first, second = _pieces(nodes[0], *size), _pieces(nodes[1], *angle)
    second = finer(second)
    longest = reach(region, SCR_BASES["impedance"])[1]
    # sin of an angle beyond π/2 falls again
    widest = basis.magnitude(size[1], min(np.sin(angle[0]), np.sin(angle[1])))
    powers, e = _powers(system, region, float(widest), longest), region.largest_error
    low, high = [], []
    for one in first:
        for other in second:
            low.append([one[0], other[0], powers[0][0], powers[1][0], -e, -e])
            high.append([one[1], other[1], powers[0][1], powers[1][1], e, e])
    limits = np.array(low), np.array(high)
    bounds = error_bounds(region, limits[0][:, 1], limits[1][:, 1])
    return Boxes(*limits, np.arange(len(low)), bounds)


def points_of(system: System, region: Region, boxes: Boxes, places: Array) -> Array:
    """Places (N, 6) in the boxes' coordinates, each in the box of its row, as points of :class:`System`, (M, 6): those
    that lie in the region."""
    c, f, source = system.study.converter, system.study.filter, system.study.grid_source
    first, angle, p, q, e_R, e_L = places.T
    size = basis_of(system).magnitude(first, np.sin(angle))
    if boxes.errors is not None:
        e_R, e_L = relative_errors(boxes, places)
    R, X = size * np.cos(angle) / (1.0 + e_R), size * np.sin(angle) / (1.0 + e_L)
    r = (R + f.R_2 / c.Z_base) / size
    x = (X + c.omega_n * f.L_2 / c.Z_base) * (source.omega_g / c.omega_n) / size
    V_sq = (source.V_g_rms / c.V_rated_rms) ** 2 / drop_sq(r, x, p, q)
    scale = V_sq / (size * PHASES) * c.S_rated
    weakness = SCR_BASES[system.study.scr_basis].counted(R, X)
    points = np.stack([weakness, np.arctan2(X, R), p * scale, q * scale, e_R, e_L], axis=1)
    low, high = region.limits
    known = (points[:, :4] >= low[:4]) & (points[:, :4] <= high[:4])
    with np.errstate(invalid="ignore"):
        return points[known.all(axis=1) & (R > 0.0) & (X > 0.0) & region.holds(points[:, 1], e_R, e_L)]


def relative_errors(boxes: Boxes, places: Array) -> tuple[Array, Array]:
    """Relative errors of R_g and of L_g at places (N, 6), each in the box of its row."""
    if boxes.errors is None:
        return places[:, 4], places[:, 5]
    found = []
    for k, (hat, three) in enumerate(
        ((np.cos(places[:, 1]), boxes.errors.R), (np.sin(places[:, 1]), boxes.errors.X)), start=4
    ):
        a, b, m = (one[boxes.piece] for one in three)
        with np.errstate(divide="ignore"):
            found.append(hat / (hat / (1.0 + a * places[:, k]) + m - b * places[:, k]) - 1.0)
    return found[0], found[1]


def drop_sq(r: Any, x: Any, p: Any, q: Any) -> Any:
    """(V_g/V)² behind a path r + jx in |Ẑ_g|, p and q in V²/|Ẑ_g| (:eq:`box-coordinates`): numbers or symbols."""
    along, across = 1.0 - (r * p + x * q) * (1.0 / PHASES), (x * p - r * q) * (1.0 / PHASES)
    return along * along + across * across


def basis_of(system: System) -> ScrBasis:
    """The SCR's basis whose reciprocal is the first coordinate."""
    schedule = system.schedule
    return SCR_BASES[schedule.scr_basis if isinstance(schedule, TableSchedule) else system.study.scr_basis]


def _pieces(nodes: Array, low: float, high: float) -> list[Array]:
    """The intervals into which an axis cuts [low, high]."""
    cuts = [low, *(float(node) for node in nodes if low < node < high), high]
    return [np.array(pair) for pair in pairwise(cuts)]


def first_extra(system: System) -> int:
    """The place of the first of the parameters that come last."""
    columns = len(NormalisedGains._fields) if isinstance(system.schedule, TableSchedule) else 0
    return ERROR_PARAMETERS + 4 * columns


def parameters_of(system: System, boxes: Boxes, pieces: Boxes) -> Array:
    """What differs from box to box, (m, N): bounds of 1/(1 + error), and the table's columns as
    c_0 + c_1 x + c_2 y + c_3 xy in x = 1/first coordinate and y = R̂/X̂ of its piece; then what ``error_Z`` needs."""
    more = np.zeros((0, len(boxes)))
    if pieces.errors is None:
        errors = np.array(
            [
                1.0 / (1.0 + boxes.high[:, 4]),
                1.0 / (1.0 + boxes.low[:, 4]),
                1.0 / (1.0 + boxes.high[:, 5]),
                1.0 / (1.0 + boxes.low[:, 5]),
            ]
        )
    else:
        errors, more = box_parameters(pieces.errors, boxes.piece, boxes.low, boxes.high)
    schedule = system.schedule
    if not isinstance(schedule, TableSchedule):
        return np.concatenate([errors, more])
    x = 0.5 * (1.0 / pieces.low[:, 0] + 1.0 / pieces.high[:, 0])
    y = 1.0 / np.tan(0.5 * (pieces.low[:, 1] + pieces.high[:, 1]))
    columns = [bilinear(schedule, column, x, y) for column in schedule.columns]
    return np.concatenate([errors, *(column[:, boxes.piece] for column in columns), more])


def bilinear(schedule: TableSchedule, values: Array, x: Array, y: Array) -> Array:
    """c_0 … c_3, (4, N), of a column in the cells that hold (x, y); beyond an axis the edge is held."""
    (i, x_0, x_1, flat_x), (j, y_0, y_1, flat_y) = _cell(schedule.scr, x), _cell(schedule.r_over_x, y)
    i_2, j_2 = np.minimum(i + 1, len(schedule.scr) - 1), np.minimum(j + 1, len(schedule.r_over_x) - 1)
    v00, v01, v10, v11 = values[i, j], values[i, j_2], values[i_2, j], values[i_2, j_2]
    low_x, low_y = x < schedule.scr[0], y < schedule.r_over_x[0]
    # Held at an edge: both ends are the edge's.
    v00, v10 = np.where(flat_x & ~low_x, v10, v00), np.where(flat_x & low_x, v00, v10)
    v01, v11 = np.where(flat_x & ~low_x, v11, v01), np.where(flat_x & low_x, v01, v11)
    v00, v01 = np.where(flat_y & ~low_y, v01, v00), np.where(flat_y & low_y, v00, v01)
    v10, v11 = np.where(flat_y & ~low_y, v11, v10), np.where(flat_y & low_y, v10, v11)
    width = (x_1 - x_0) * (y_1 - y_0)
    c_3 = (v11 - v10 - v01 + v00) / width
    c_1 = ((v10 - v00) * y_1 - (v11 - v01) * y_0) / width
    c_2 = ((v01 - v00) * x_1 - (v11 - v10) * x_0) / width
    return np.array([v00 - c_1 * x_0 - c_2 * y_0 - c_3 * x_0 * y_0, c_1, c_2, c_3])


def _cell(axis: Array, at: Array) -> tuple[NDArray[np.intp], Array, Array, NDArray[np.bool_]]:
    """The interval of an axis that holds a place, its ends, and whether the place lies beyond the axis."""
    k = np.clip(np.searchsorted(axis, at, side="right") - 1, 0, max(len(axis) - 2, 0))
    low, high = axis[k], axis[np.minimum(k + 1, len(axis) - 1)]
    flat = (at < axis[0]) | (at > axis[-1]) | (len(axis) == 1)
    return k, low, np.where(high > low, high, low + 1.0), flat
