"""How close the rests of a gain table are to the largest power that each grid carries: dP/dδ at every node."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import POWER_MARGIN, jacobian_from_powers, operating_point
from vsgdesign.report.drawing.quantities import DASH, number, plain
from vsgdesign.report.page.blocks import Table

Array = NDArray[np.float64]

ABOUT_STIFFNESS = (
    "dP/dδ over 3VV_g/|Z| is sin(δ + α), where α is the angle of the impedance: 1 at the stiffest rest, 0 at the "
    "largest power that the grid carries or gives. The static limits do not contain it. Where it is small, a "
    "disturbance takes the angle beyond the largest power, and only a limiter with a way back leads it home."
)


def stiffness_table(table: GainTable) -> Table:
    """At the design point of each node, and in brackets the least over the corners of the table's powers."""
    at_design, least = stiffness(table)
    rows = tuple(
        (plain(scr), *(_cell(*pair) for pair in zip(design, worst, strict=True)))
        for scr, design, worst in zip(table.scr, at_design, least, strict=True)
    )
    head = ("SCR", *(f"X/R {plain(x_over_r)}" for x_over_r in table.x_over_r))
    return Table("dP/dδ at the rest, over 3VV_g/|Z|: at the design point (least over the powers)", head, rows)


def stiffness(table: GainTable) -> tuple[Array, Array]:
    """dP/dδ over 3VV_g/|Z| at the exact grid of each node, (n, m) each: at the design point, and the least at the
    corners of the powers for which the table is valid, as far as V is valid there and the grid carries them. NaN where
    there is no such rest."""
    corners = [(P, Q) for P in table.validity.P for Q in table.validity.Q]
    with np.errstate(invalid="ignore"):
        found = np.array([_at_powers(table, P, Q) for P, Q in corners])
        known = np.isfinite(found).any(axis=0)
        least = np.where(known, np.nanmin(np.where(known, found, 0.0), axis=0), np.nan)
        return _at_powers(table, table.P_design, table.Q_design), least


def _at_powers(table: GainTable, P: float, Q: float) -> Array:
    base = table.base
    Z_base = PHASES * base.V_rated_rms**2 / base.S_rated
    R_g, L_g = SCR_BASES[base.scr_basis].grid(table.scr[:, None], table.x_over_r[None, :], Z_base, base.omega_n)
    R, X = base.R_2 + R_g, base.omega_n * (base.L_2 + L_g)
    V, _ = operating_point(P, Q, base.V_g_rms, R, X)
    Z = np.hypot(R, X)
    low, high = table.validity.V_rms
    sound = (low <= V) & (high >= V) & (POWER_MARGIN * np.hypot(P, Q) * Z <= PHASES * V * V)
    A = jacobian_from_powers(P, Q, V, R, X)[0]
    return np.where(sound, A * Z / (PHASES * V * base.V_g_rms), np.nan)


def _cell(design: float, least: float) -> str:
    if not np.isfinite(design):
        return DASH
    return f"{number(design, 2)} ({number(least, 2) if np.isfinite(least) else DASH})"
