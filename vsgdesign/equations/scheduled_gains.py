"""Gains of a place in the table of a schedule: coordinates, interpolation (:eq:`bilinear`), structure."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.notation import Count, Numbers
from vsgdesign.equations.power_flow import scheduled_jacobian
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.scheduler_data import ScheduleLaw, ScheduleTable
from vsgdesign.equations.structures import NormalisedGains


def place_of(table: ScheduleTable, R_g: Any, L_g: Any, law: ScheduleLaw) -> tuple[Any, Any]:
    """Returns (scr, r_over_x) of a grid with L_g > 0 (:eq:`scr`)."""
    scr = law.scr(R_g, L_g, table.Z_base, table.omega)
    return scr, R_g / (table.omega * L_g)


def grid_at(table: ScheduleTable, scr: Any, r_over_x: Any, law: ScheduleLaw) -> tuple[Any, Any]:
    """Returns (R_g, L_g) of a place in Ω and H (:eq:`scr`)."""
    R_g, L_g = law.grid(scr, 1.0 / r_over_x, table.Z_base, table.omega)
    return R_g, L_g


def interval(axis: Numbers, value: Any) -> tuple[Count, Count, Any]:
    """Returns (low, high, fraction): between which nodes of an axis a value is, and how far on the way.

    Beyond the ends it is at the end. An axis with one node has this node for every value.
    """
    low = np.minimum(np.maximum(np.searchsorted(axis, value, side="right"), 1), np.maximum(len(axis), 2) - 1) - 1
    high = np.minimum(low + 1, len(axis) - 1)
    width = axis[high] - axis[low] if high > low else 1.0
    inside = np.clip(value, axis[0], axis[len(axis) - 1])
    return low, high, (inside - axis[low]) / width


class Corners(NamedTuple):
    """The corners of the cell around a place: where their numbers begin, and their weights (:eq:`bilinear`)."""

    low_low: Count
    low_high: Count
    high_low: Count
    high_high: Count
    """The first word is the row, the second the column."""
    w00: Any
    w01: Any
    w10: Any
    w11: Any
    """Weights in the same order."""


def blend(nodes: Numbers, at: Corners, column: Count) -> Any:
    """The weighted sum of the corners in a column of the table (:eq:`bilinear`)."""
    low = at.w00 * nodes[at.low_low + column] + at.w01 * nodes[at.low_high + column]
    return (low + at.w10 * nodes[at.high_low + column]) + at.w11 * nodes[at.high_high + column]


def outside(nodes: Numbers, corner: Count, weight: Any) -> bool:
    """Whether a corner has a weight, but no design."""
    return nodes[corner] < 0.0 and weight > 0.0


def normalised_at(table: ScheduleTable, scr: Any, r_over_x: Any) -> tuple[NormalisedGains, Count]:
    """Returns (normalised, designed) at a place (:eq:`bilinear`). designed is 0 where a node with a weight has no
    design; then the first result means nothing."""
    row, next_row, r = interval(table.scr, scr)
    column, next_column, c = interval(table.r_over_x, r_over_x)
    r_left, c_left = 1.0 - r, 1.0 - c
    w00, w01, w10, w11 = r_left * c_left, r_left * c, r * c_left, r * c
    columns, nodes = len(table.r_over_x), table.nodes
    a, b = (row * columns + column) * 6, (row * columns + next_column) * 6
    d, e = (next_row * columns + column) * 6, (next_row * columns + next_column) * 6
    at = Corners(a, b, d, e, w00, w01, w10, w11)
    normalised = NormalisedGains(
        k_1_or_H=blend(nodes, at, 0),
        d_1_or_zeta=blend(nodes, at, 1),
        k_2=blend(nodes, at, 2),
        q=blend(nodes, at, 3),
        share_P=blend(nodes, at, 4),
        share_Q=blend(nodes, at, 5),
    )
    low = outside(nodes, a, w00) or outside(nodes, b, w01)
    high = outside(nodes, d, w10) or outside(nodes, e, w11)
    designed = 0 if low or high else 1
    return normalised, designed


def gains_at(
    table: ScheduleTable,
    normalised: NormalisedGains,
    scr: Any,
    r_over_x: Any,
    P: Any,
    Q: Any,
    V_rms: Any,
    law: ScheduleLaw,
) -> PowerLoopGains:
    """Gains on the grid of a place at measured powers and voltage (:eq:`structure-gains`). Returns (gains)."""
    R_g, L_g = grid_at(table, scr, r_over_x, law)
    R, X = R_g + table.R_2, table.omega * (L_g + table.L_2)
    A, B, C, D = scheduled_jacobian(P, Q, V_rms, R, X)
    return law.gains(A, B, C, D, normalised, table.D_p, table.D_q, table.S_rated, table.omega, law.by_inertia)
