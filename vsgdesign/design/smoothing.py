"""Designs that go well together: rough nodes are pulled to a smooth surface through their neighbours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.design.between import PointCheck
from vsgdesign.design.box import Reach
from vsgdesign.design.record import CellRecord
from vsgdesign.design.variables import Variables

Array = NDArray[np.float64]

PULL = 30.0
"""How much more than usual the surface counts for a node that is designed again."""

_BANDWIDTH = 0.35
"""Least standard deviation of the surface's weights, in the logarithms of SCR and X/R."""

_DOUBTFUL = 0.1
"""Weight of a node that does not keep its promises."""

_RIDGE = 0.3
"""On the surface's slopes, in weights: a node alone has none."""


def surface(v: Variables, table: GainTable, records: Sequence[CellRecord], scr: Array, x_over_r: Array) -> Array:
    """y (N, k) at N grids: local linear regression through the table's designs over ln SCR and ln X/R."""
    rows = [(r, s, x) for r, (s, x) in zip(records, _nodes(table), strict=True) if r.design is not None]
    y = np.array([v.of(r.design.normalised) for r, _, _ in rows if r.design is not None])
    at = np.log([(s, x) for _, s, x in rows])
    weight = np.array([_DOUBTFUL if r.missed else 1.0 for r, _, _ in rows])
    found = np.empty((len(scr), y.shape[1]))
    for k, place in enumerate(np.log(np.stack([scr, x_over_r], axis=1))):
        axes = zip((table.scr, table.x_over_r), place, strict=True)
        widths = [max(_BANDWIDTH, _spacing(np.log(axis), value)) for axis, value in axes]
        away = (at - place) / widths
        w = weight * np.exp(-0.5 * np.sum(away**2, axis=1))
        basis = np.column_stack([np.ones(len(at)), away])
        normal = basis.T @ (w[:, None] * basis) + np.diag([0.0, _RIDGE, _RIDGE])
        found[k] = np.linalg.solve(normal, basis.T @ (w[:, None] * y))[0]
    return np.clip(found, v.low, v.high)


def rough_nodes(
    table: GainTable, records: Sequence[CellRecord], broken: Sequence[PointCheck], missed: bool
) -> list[int]:
    """Nodes to design again, by number: those around a grid at which a promise is broken, those that miss one by
    themselves (``missed``), and their neighbours. What no power loop cures is left alone."""
    n, m = table.shape
    marked = np.zeros((n, m), dtype=bool)
    for k, record in enumerate(records):
        if missed and record.missed and record.inner_rad_s is None:
            marked[k // m, k % m] = True
    for point in broken:
        marked.ravel()[around(table, point)] = True
    wide = marked.copy()
    for i, j in np.argwhere(marked):
        wide[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2] = True
    curable = [record.design is not None and record.inner_rad_s is None for record in records]
    return np.flatnonzero(wide.ravel() & np.array(curable)).tolist()


def broken_beside(
    table: GainTable, broken: Sequence[PointCheck], node: tuple[float, float]
) -> tuple[tuple[float, float], ...]:
    """SCR and X/R of the grids next to a node at which a promise is broken."""
    nodes = _nodes(table)
    return tuple((p.scr, p.x_over_r) for p in broken if node in (nodes[k] for k in around(table, p)))


def around(table: GainTable, point: PointCheck) -> list[int]:
    """The four nodes around a grid, by number: row by row over SCR × X/R."""
    n, m = table.shape
    i = int(np.clip(np.searchsorted(table.scr, point.scr) - 1, 0, n - 2))
    j = int(np.clip(np.searchsorted(table.x_over_r, point.x_over_r) - 1, 0, m - 2))
    return [i * m + j, i * m + j + 1, (i + 1) * m + j, (i + 1) * m + j + 1]


def reach(scr: Sequence[float], x_over_r: Sequence[float], s: float, x: float) -> Reach:
    """How far a node's say is the largest: half way to its neighbours, in logarithms."""
    return (*_half(scr, s), *_half(x_over_r, x))


def _half(axis: Sequence[float], value: float) -> tuple[float, float]:
    below = max((a for a in axis if a < value), default=value)
    above = min((a for a in axis if a > value), default=value)
    return float(np.sqrt(below * value)), float(np.sqrt(value * above))


def _spacing(axis: Array, value: float) -> float:
    """Length of the interval that holds a value."""
    k = int(np.clip(np.searchsorted(axis, value) - 1, 0, len(axis) - 2))
    return float(axis[k + 1] - axis[k])


def _nodes(table: GainTable) -> list[tuple[float, float]]:
    return [(float(s), float(x)) for s in table.scr for x in table.x_over_r]
