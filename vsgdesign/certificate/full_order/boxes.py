"""Boxes of true grids and of estimates: where a proof begins, and what differs from piece to piece of the schedule."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.boxes import ERROR_PARAMETERS, bilinear
from vsgdesign.certificate.error_bounds import angles, reach
from vsgdesign.certificate.full_order.programs import ERRORS
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


DrawnTo = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Pieces:
    """Of K pieces of the estimates: limits (K, 2) of the third and fourth coordinate; ``kept`` (K, 4): what an estimate
    there has in common with the one that was drawn in (R, X, size, angle); ``columns`` (m, K): the parameters of a
    table."""

    low: Array
    high: Array
    kept: Array
    columns: Array

    def __len__(self) -> int:
        return len(self.low)


@dataclass(frozen=True)
class Part:
    """Boxes of one or more cells: limits (N, 6), the cell and the piece of each, the place of the arc that is looked at
    first, and its share of the whole."""

    low: Array
    high: Array
    cell: NDArray[np.int64]
    piece: NDArray[np.int64]
    begin: NDArray[np.int64]
    share: Array

    def __len__(self) -> int:
        return len(self.low)

    def take(self, index: Any) -> Part:
        """Some of the boxes."""
        return Part(*(value[index] for value in vars(self).values()))

    def halves(self, dimension: NDArray[np.intp]) -> Part:
        """Each cut in the middle of its dimension."""
        rows = np.arange(len(self))
        middle = 0.5 * (self.low[rows, dimension] + self.high[rows, dimension])
        low, high = self.low.copy(), self.high.copy()
        low[rows, dimension], high[rows, dimension] = middle, middle
        cell, piece, begin = (np.concatenate([v, v]) for v in (self.cell, self.piece, self.begin))
        share = 0.5 * np.concatenate([self.share, self.share])
        return Part(np.concatenate([self.low, low]), np.concatenate([high, self.high]), cell, piece, begin, share)

    @classmethod
    def joined(cls, parts: list[Part]) -> Part:
        """All boxes of some parts."""
        return cls(*(np.concatenate(columns) for columns in zip(*(vars(p).values() for p in parts), strict=True)))


def by_errors(system: System, region: Region) -> bool:
    """Whether the third and fourth coordinate are the errors: where no table is, and no error of \\|Z_g\\|."""
    return not isinstance(system.schedule, TableSchedule) and not region.error_Z


def pieces_of(system: System, region: Region, drawn_to: DrawnTo | None = None) -> Pieces:
    """The pieces of a schedule: cells of a table, the edges that estimates are drawn to, else one. ``drawn_to``: the
    limits of SCR and R/X of a table's scheduler; None: its axes."""
    if by_errors(system, region):
        e = np.full((1, 2), region.error)
        return Pieces(-e, e, np.zeros((1, 4)), np.zeros((0, 1)))
    schedule = system.schedule
    basis = _basis_of_estimates(system)
    size, angle = estimates_of(system, region)
    if not isinstance(schedule, TableSchedule):
        return Pieces(
            np.array([[size[0], angle[0]]]), np.array([[size[1], angle[1]]]), np.ones((1, 4)), np.zeros((0, 1))
        )
    axes = [1.0 / schedule.scr[::-1], np.arctan(1.0 / schedule.r_over_x[::-1])]
    if drawn_to is not None:
        ends = [1.0 / np.array(drawn_to[0][::-1]), np.arctan(1.0 / np.array(drawn_to[1][::-1]))]
        axes = [_cut(axis, low, high) for axis, (low, high) in zip(axes, ends, strict=True)]
    # With an error of |Z_g| a certificate holds for the estimates within the axes, as that of the power loops does.
    drawn = not region.error_Z
    first, second = (_intervals(axis, limits, drawn) for axis, limits in zip(axes, (size, angle), strict=True))
    low, high, kept = [], [], []
    for a, b, inside in first:
        for c, d, within in second:
            low.append([a, c])
            high.append([b, d])
            kept.append([inside and within, inside and within, inside, within])
    limits = np.array(low), np.array(high)
    x, y = 0.5 * (1.0 / limits[0][:, 0] + 1.0 / limits[1][:, 0]), 1.0 / np.tan(0.5 * (limits[0] + limits[1])[:, 1])
    columns = np.zeros((ERROR_PARAMETERS + 4 * len(schedule.columns), len(low)))
    for k, values in enumerate(schedule.columns):
        columns[ERROR_PARAMETERS + 4 * k : ERROR_PARAMETERS + 4 * k + 4] = bilinear(schedule, values, x, y)
    kept_array = np.array(kept, dtype=float)
    if not basis.counts_resistance:  # the size that an estimate keeps at an edge of X/R is then X
        kept_array[:, 1] = np.maximum(kept_array[:, 1], kept_array[:, 2])
    return Pieces(*limits, kept_array, columns)


def _basis_of_estimates(system: System) -> ScrBasis:
    schedule = system.schedule
    return SCR_BASES[schedule.scr_basis if isinstance(schedule, TableSchedule) else system.study.scr_basis]


def estimates_of(system: System, region: Region) -> tuple[Array, Array]:
    """Least and largest first coordinate and angle of the estimates of a region's grids, (2,) each."""
    basis, own = _basis_of_estimates(system), SCR_BASES[system.study.scr_basis]
    counted = np.array([1.0 / region.scr[1], 1.0 / region.scr[0]])
    if basis.name != own.name:
        sines = np.sin(np.arctan(region.x_over_r))
        counted = counted * (1.0 / sines[::-1] if basis.counts_resistance else sines)
    slack = np.array([1.0 - 1e-12, 1.0 + 1e-12])
    return counted * np.array(reach(region, basis)) * slack, np.array(angles(region)) * slack


def _within_reach(pieces: Pieces, limits: tuple[Array, Array]) -> tuple[Array, Array, NDArray[np.intp]]:
    """Limits (M, 2) of those of the pieces, by their numbers, that estimates between limits meet or are drawn to."""
    low, high = pieces.low.copy(), pieces.high.copy()
    meets = np.ones(len(pieces), dtype=np.bool_)
    for k, (least, most) in enumerate(limits):
        edge = (low[:, k] == high[:, k]) & (pieces.kept.sum(axis=1) < pieces.kept.shape[1])
        lower = low[:, k] <= pieces.low[:, k].min()
        meets &= np.where(edge, np.where(lower, least < low[:, k], most > high[:, k]), True)
        low[:, k] = np.where(edge, low[:, k], np.maximum(low[:, k], least))
        high[:, k] = np.where(edge, high[:, k], np.minimum(high[:, k], most))
        meets &= low[:, k] <= high[:, k]
    index = np.flatnonzero(meets)
    return low[index], high[index], index


def _cut(axis: Array, low: float, high: float) -> Array:
    """An axis between two limits."""
    return np.array([low, *axis[(axis > low) & (axis < high)], high])


def _intervals(axis: Array, limits: Array, drawn: bool) -> list[tuple[float, float, bool]]:
    """The intervals of an axis that estimates between limits meet, and the edges that those beyond are drawn to."""
    low, high = (float(v) for v in np.clip(limits, axis[0], axis[-1]))
    cuts = [low, *(float(node) for node in axis if low < node < high), high]
    found = [(a, b, True) for a, b in pairwise(cuts)]
    if drawn and limits[0] < axis[0]:
        found.insert(0, (float(axis[0]), float(axis[0]), False))
    if drawn and limits[1] > axis[-1]:
        found.append((float(axis[-1]), float(axis[-1]), False))
    return found


def error_parameters(region: Region, part: Part, pieces: Pieces) -> Array:
    """What the programs' ``situation`` needs of each box, (ERRORS, N): what its piece keeps, and the half-widths of the
    error set in R and X, in \\|Z_g\\|, at the grid of its cell where they are largest."""
    found = np.empty((ERRORS, len(part)))
    found[:4] = pieces.kept[part.piece].T
    e, e_Z = region.error, region.error_Z
    found[4] = np.maximum(e * np.cos(part.low[:, 1]), e_Z) * (1.0 + 1e-12)
    found[5] = np.maximum(e * np.sin(np.minimum(part.high[:, 1], 0.5 * np.pi)), e_Z) * (1.0 + 1e-12)
    return found


def whole(system: System, region: Region, pieces: Pieces) -> tuple[Array, Array, Part]:
    """The cells that a proof begins with, limits (M, 2), and the boxes of all of them."""
    low_1, high_1 = 1.0 / region.scr[1], 1.0 / region.scr[0]
    angle: Any = np.arctan(region.x_over_r)
    counts = [max(math.ceil(width / most), 1) for width, most in zip(
        (math.log(high_1 / low_1), angle[1] - angle[0]), _WIDEST, strict=True
    )]  # fmt: skip
    first, second = np.geomspace(low_1, high_1, counts[0] + 1), np.linspace(angle[0], angle[1], counts[1] + 1)
    first[[0, -1]], second[[0, -1]] = (low_1, high_1), angle
    cells = np.array([[[a, c], [b, d]] for a, b in pairwise(first) for c, d in pairwise(second)])
    lows, highs, of_cell, of_piece = [], [], [], []
    for k, (cell_low, cell_high) in enumerate(cells):
        p, q = _powers(system, region, cell_low, cell_high)
        if by_errors(system, region):
            low_2, high_2, index = pieces.low, pieces.high, np.arange(len(pieces))
        else:
            scr, ratio = (1.0 / cell_high[0], 1.0 / cell_low[0]), (np.tan(cell_low[1]), np.tan(cell_high[1]))
            limits = estimates_of(system, replace(region, scr=scr, x_over_r=ratio))
            low_2, high_2, index = _within_reach(pieces, limits)
        count = len(index)
        shared = (
            np.tile([*cell_low, 0.0, 0.0, p[0], q[0]], (count, 1)),
            np.tile([*cell_high, 0.0, 0.0, p[1], q[1]], (count, 1)),
        )
        shared[0][:, 2:4], shared[1][:, 2:4] = low_2, high_2
        lows.append(shared[0])
        highs.append(shared[1])
        of_cell.append(np.full(count, k))
        of_piece.append(index)
    low, high = np.concatenate(lows), np.concatenate(highs)
    # An edge that estimates are drawn to has no width; it counts as a thousandth of its axis.
    span = high.max(axis=0) - low.min(axis=0)
    volume = np.maximum(high - low, 1e-3 * np.where(span > 0.0, span, 1.0)).prod(axis=1)
    part = Part(
        low,
        high,
        np.concatenate(of_cell).astype(np.int64),
        np.concatenate(of_piece).astype(np.int64),
        np.zeros(len(low), dtype=np.int64),
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


__all__ = ["Part", "Pieces", "by_errors", "error_parameters", "pieces_of", "whole"]
