"""Gains at one place of a schedule on plain floats, as a controller computes them in every window.

The exported C must agree with these functions.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import repeat
from typing import Any

import numpy as np

from vsgdesign.equations.grid import grid_from_scr_impedance, grid_from_scr_reactance, scr_impedance, scr_reactance
from vsgdesign.equations.power_flow import scheduled_jacobian
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
from vsgdesign.frames import base_impedance
from vsgdesign.runtime.closed_form import ClosedFormSchedule
from vsgdesign.runtime.floats import on_floats
from vsgdesign.runtime.interpolation import Interval, blend, corner_weights
from vsgdesign.runtime.table import TableSchedule

_ZEROS = (0.0,) * 6
_MOST_KEPT = 32
_scheduled_jacobian = on_floats(scheduled_jacobian)
_SCR = {"impedance": on_floats(scr_impedance), "reactance": on_floats(scr_reactance)}
_GRID = {"impedance": on_floats(grid_from_scr_impedance), "reactance": on_floats(grid_from_scr_reactance)}


@dataclass(frozen=True, eq=False, kw_only=True)
class GainLookup:
    """A schedule as a table over SCR and R/X. Made by :func:`gain_lookup`."""

    scr: tuple[float, ...]
    r_over_x: tuple[float, ...]
    nodes: tuple[tuple[tuple[float, ...] | None, ...], ...]
    """n × m nodes: NormalisedGains in SI, None where there is no design."""
    Z_base: float
    scr_basis: str
    omega: float
    R_2: float
    L_2: float
    structure: str
    law: str
    S_rated: float
    D_p: float
    D_q: float
    V_n_rms: float
    """Voltage that is assumed before the first measurement, V."""
    _kept: dict[tuple[str, float, float], Any] = field(default_factory=dict, init=False, repr=False)
    """Answers of the last places: a schedule mostly stays where it was."""

    def _remembered(self, what: str, one: float, other: float, function: Callable[[float, float], Any]) -> Any:
        """``function`` of two numbers, which is asked again only where they are new."""
        key = what, one, other
        if key not in self._kept:
            if len(self._kept) >= _MOST_KEPT:
                self._kept.clear()
            self._kept[key] = function(one, other)
        return self._kept[key]

    def coordinates(self, R_g: float, L_g: float) -> tuple[float, float]:
        """SCR on the table's basis and R/X of a grid with R_g (Ω) and L_g > 0 (H) (:eq:`scr`)."""
        return self._remembered("place", R_g, L_g, self._coordinates)

    def _coordinates(self, R_g: float, L_g: float) -> tuple[float, float]:
        return _SCR[self.scr_basis](R_g, L_g, self.Z_base, self.omega), R_g / (self.omega * L_g)

    def grid(self, scr: float, r_over_x: float) -> tuple[float, float]:
        """R_g (Ω) and L_g (H) of a place (:eq:`scr`)."""
        return self._remembered("grid", scr, r_over_x, self._grid)

    def _grid(self, scr: float, r_over_x: float) -> tuple[float, float]:
        return _GRID[self.scr_basis](scr, 1.0 / r_over_x, self.Z_base, self.omega)

    def normalised(self, scr: float, r_over_x: float) -> NormalisedGains | None:
        """Normalised parameters (:eq:`bilinear`). The result is None where a node with a weight has no design."""
        return self._remembered("normalised", scr, r_over_x, self._normalised)

    def _normalised(self, scr: float, r_over_x: float) -> NormalisedGains | None:
        row, column = locate_one(self.scr, scr), locate_one(self.r_over_x, r_over_x)
        weights = corner_weights(row.fraction, column.fraction)
        low, high = self.nodes[row.low], self.nodes[row.high]
        corners = low[column.low], low[column.high], high[column.low], high[column.high]
        if None in corners and any(c is None and w != 0.0 for c, w in zip(corners, weights, strict=True)):
            return None
        # A corner without a design may have any number here, since its weight is zero.
        v00, v01, v10, v11 = (corner or _ZEROS for corner in corners)
        return NormalisedGains(*map(blend, repeat(weights), v00, v01, v10, v11))

    def gains(self, normalised: NormalisedGains, scr: float, r_over_x: float, P: float, Q: float, V_rms: float) -> Any:
        """Gains on the grid of a place at measured powers and voltage (:eq:`structure-gains`)."""
        R_g, L_g = self.grid(scr, r_over_x)
        A, B, C, D = _scheduled_jacobian(P, Q, V_rms, R_g + self.R_2, self.omega * (L_g + self.L_2))
        gains = on_floats(STRUCTURES[self.structure].gains)
        return gains(A, B, C, D, normalised, self.D_p, self.D_q, self.S_rated, self.omega, self.law == "inertia")


def gain_lookup(
    schedule: TableSchedule | ClosedFormSchedule, *, V_n_rms: float, S_rated: float = 0.0, scr_basis: str = "impedance"
) -> GainLookup:
    """The lookup of a table's schedule, or of a closed form as a table of one node.

    ``S_rated`` (VA) and ``scr_basis`` define the SCR of a closed form; a table has its own. V_n_rms is the nominal
    voltage in V.
    """
    if isinstance(schedule, TableSchedule):
        scr, r_over_x, Z_base, scr_basis = schedule.scr, schedule.r_over_x, schedule.Z_base, schedule.scr_basis
        columns = np.stack(schedule.columns, axis=-1).tolist()
        designed = schedule.valid.tolist()
    else:
        scr, r_over_x = np.ones(1), np.ones(1)
        Z_base = base_impedance(S_rated or schedule.S_rated, V_n_rms)
        columns, designed = [[list(map(float, schedule.normalised(0.0, 1.0)))]], [[True]]
    nodes = tuple(
        tuple(tuple(node) if good else None for node, good in zip(*pair, strict=True))
        for pair in zip(columns, designed, strict=True)
    )
    D_p, D_q = STRUCTURES[schedule.structure].droops(schedule.D_p, schedule.D_q)
    return GainLookup(
        scr=tuple(scr.tolist()),
        r_over_x=tuple(r_over_x.tolist()),
        nodes=nodes,
        Z_base=float(Z_base),
        scr_basis=scr_basis,
        omega=schedule.omega,
        R_2=schedule.R_2,
        L_2=schedule.L_2,
        structure=schedule.structure,
        law=schedule.law,
        S_rated=schedule.S_rated,
        D_p=D_p,
        D_q=D_q,
        V_n_rms=V_n_rms,
    )


def locate_one(axis: tuple[float, ...], value: float) -> Interval:
    """:func:`vsgdesign.runtime.interpolation.locate` for one number, with the same bits at a tenth of the cost."""
    last = len(axis) - 1
    low = min(max(bisect_right(axis, value) - 1, 0), max(last - 1, 0))
    high = min(low + 1, last)
    width = axis[high] - axis[low] if high > low else 1.0
    inside = min(max(value, axis[0]), axis[last])
    clipped = 1 if value > axis[last] else (-1 if value < axis[0] else 0)
    return Interval(low, high, (inside - axis[low]) / width, clipped)
