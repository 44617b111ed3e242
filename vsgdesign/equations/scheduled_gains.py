"""Gains of a place in the table of a schedule: coordinates, interpolation (:eq:`bilinear`), structure."""

from __future__ import annotations

from typing import Any

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


def grid_of(table: ScheduleTable, scr: Any, r_over_x: Any, law: ScheduleLaw) -> tuple[Any, Any]:
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


def blend(w00: Any, w01: Any, w10: Any, w11: Any, v00: Any, v01: Any, v10: Any, v11: Any) -> Any:
    """The weighted sum of four corners (:eq:`bilinear`)."""
    return ((w00 * v00 + w01 * v01) + w10 * v10) + w11 * v11


def normalised_at(table: ScheduleTable, scr: Any, r_over_x: Any) -> tuple[NormalisedGains, Count]:
    """Returns (normalised, designed) at a place (:eq:`bilinear`). designed is 0 where a node with a weight has no
    design; then the first result means nothing."""
    row, next_row, r = interval(table.scr, scr)
    column, next_column, c = interval(table.r_over_x, r_over_x)
    w00, w01, w10, w11 = (1.0 - r) * (1.0 - c), (1.0 - r) * c, r * (1.0 - c), r * c
    columns, v = len(table.r_over_x), table.nodes
    a, b = (row * columns + column) * 6, (row * columns + next_column) * 6
    d, e = (next_row * columns + column) * 6, (next_row * columns + next_column) * 6
    normalised = NormalisedGains(
        k_1_or_H=blend(w00, w01, w10, w11, v[a], v[b], v[d], v[e]),
        d_1_or_zeta=blend(w00, w01, w10, w11, v[a + 1], v[b + 1], v[d + 1], v[e + 1]),
        k_2=blend(w00, w01, w10, w11, v[a + 2], v[b + 2], v[d + 2], v[e + 2]),
        q=blend(w00, w01, w10, w11, v[a + 3], v[b + 3], v[d + 3], v[e + 3]),
        share_P=blend(w00, w01, w10, w11, v[a + 4], v[b + 4], v[d + 4], v[e + 4]),
        share_Q=blend(w00, w01, w10, w11, v[a + 5], v[b + 5], v[d + 5], v[e + 5]),
    )
    low = (v[a] < 0.0 and w00 > 0.0) or (v[b] < 0.0 and w01 > 0.0)
    high = (v[d] < 0.0 and w10 > 0.0) or (v[e] < 0.0 and w11 > 0.0)
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
    R_g, L_g = grid_of(table, scr, r_over_x, law)
    R, X = R_g + table.R_2, table.omega * (L_g + table.L_2)
    A, B, C, D = scheduled_jacobian(P, Q, V_rms, R, X)
    return law.gains(A, B, C, D, normalised, table.D_p, table.D_q, table.S_rated, table.omega, law.by_inertia)
