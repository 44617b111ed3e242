"""Scheduled gains from a gain table. They follow from interpolated normalised parameters and the Jacobian."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import base_impedance
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.runtime.schedule import Schedule

if TYPE_CHECKING:
    from vsgdesign.artifacts.gain_table import GainTable


class Interval(NamedTuple):
    """Where a value lies on an axis: between nodes ``low`` and ``high``, at ``fraction`` of the way, 0 to 1.

    ``clipped``: −1 below the axis, 1 above it, 0 on it.
    """

    low: Any
    high: Any
    fraction: Any
    clipped: Any


class Weights(NamedTuple):
    """Weights of the four corners of a cell; the first word of a name is the row, the second the column."""

    low_low: Any
    low_high: Any
    high_low: Any
    high_high: Any


def locate(axis: Array, value: Any) -> Interval:
    """The interval of a strictly increasing axis in which a value (scalar or array) lies.

    ``low`` is the last node that is not above the value, but at most the last but one. The fraction is (value −
    axis[low])/(axis[low + 1] − axis[low]), clipped to 0 and 1, so a value beyond an end takes that end. An axis with
    one node takes this node for every value. NaN gives a fraction of NaN.
    """
    value = np.asarray(value, dtype=float)
    clipped = np.where(value > axis[-1], 1, np.where(value < axis[0], -1, 0))
    low = np.clip(np.searchsorted(axis, value, side="right") - 1, 0, max(len(axis) - 2, 0))
    high = np.minimum(low + 1, len(axis) - 1)
    width = np.where(high > low, axis[high] - axis[low], 1.0)
    inside = np.minimum(np.maximum(value, axis[0]), axis[-1])
    return Interval(low, high, (inside - axis[low]) / width, clipped)


def corner_weights(row: Any, column: Any) -> Weights:
    """The weights (1 − r)(1 − c), (1 − r)c, r(1 − c), rc for the fractions r and c (:eq:`bilinear`)."""
    r, c = 1.0 - row, 1.0 - column
    return Weights(r * c, r * column, row * c, row * column)


def blend(weights: Weights, low_low: Any, low_high: Any, high_low: Any, high_high: Any) -> Any:
    """The weighted sum ((w00 v00 + w01 v01) + w10 v10) + w11 v11 (:eq:`bilinear`)."""
    w00, w01, w10, w11 = weights
    return ((w00 * low_low + w01 * low_high) + w10 * high_low) + w11 * high_high


def interpolate(values: Array, row: Interval, column: Interval, weights: Weights) -> Any:
    """Interpolates a column (n, m) of a table (:eq:`bilinear`).

    At a node one weight is 1 and three are 0, so the result is exactly the value of the node.
    """
    return blend(
        weights,
        values[row.low, column.low],
        values[row.low, column.high],
        values[row.high, column.low],
        values[row.high, column.high],
    )


Array = NDArray[np.float64]


class TablePlace(NamedTuple):
    """The position of an estimated grid in a table, as scalars or arrays.

    ``clipped_scr`` and ``clipped_x_over_r`` are −1 below the axis, 1 above it and 0 on it. ``designed`` is True if
    every node with a weight has a design, so that none is outside. It is False for an estimate that is not a number.
    """

    scr: Any
    x_over_r: Any
    clipped_scr: Any
    clipped_x_over_r: Any
    designed: Any


@dataclass(frozen=True, eq=False, kw_only=True)
class TableSchedule(Schedule):
    """A gain schedule that interpolates a table over SCR and R/X (:eq:`bilinear`).

    SCR and X/R come from the estimated R_g and L_g on the table's basis. Beyond the axes the value at the edge is used,
    and :meth:`place` says so. R_g may be negative, because the estimate of a small resistance may be; this is taken as
    the largest X/R. An estimate that is not finite or has no inductance (L_g ≤ 0) gives NaN. Keep the present gains
    then.
    """

    Z_base: float
    scr_basis: str
    scr: Array
    """SCR axis (n,), strictly increasing."""
    r_over_x: Array
    """R/X axis (m,), strictly increasing: the reciprocals of the table's X/R axis in reversed order."""
    columns: NormalisedGains
    """Normalised parameters: six arrays (n, m) in SI over scr and r_over_x."""
    valid: NDArray[np.bool_]
    """Whether each node has a design, (n, m) over scr and r_over_x."""

    def normalised(self, R_g: Any, L_g: Any) -> NormalisedGains:
        """Normalised parameters for an estimated grid; R_g and L_g are scalars or arrays."""
        row, column = self._intervals(R_g, L_g)
        weights = corner_weights(row.fraction, column.fraction)
        return NormalisedGains(*(interpolate(values, row, column, weights) for values in self.columns))

    def place(self, R_g: Any, L_g: Any) -> TablePlace:
        """The position of the estimate, whether it is clipped, and whether every node with a weight has a design."""
        scr, r_over_x = self._coordinates(R_g, L_g)
        row, column = self._intervals(R_g, L_g)
        weights = corner_weights(row.fraction, column.fraction)
        corners = ((row.low, column.low), (row.low, column.high), (row.high, column.low), (row.high, column.high))
        # A weight that is NaN is neither zero nor positive, so an unusable estimate is never ``designed``.
        designed = np.all(
            [(w == 0.0) | (self.valid[at] & (w > 0.0)) for at, w in zip(corners, weights, strict=True)], axis=0
        )
        with np.errstate(divide="ignore"):
            return TablePlace(scr, 1.0 / r_over_x, row.clipped, -column.clipped, designed)

    def drawn_to(
        self, R_g: Any, L_g: Any, scr: tuple[float, float], r_over_x: tuple[float, float]
    ) -> tuple[Any, Any, Any]:
        """R_g and L_g of the nearest place within limits of SCR and R/X, as in the scheduler.

        The third result says whether every node with a weight has a design there.
        """
        at_scr, at_r = self._coordinates(R_g, L_g)
        at_scr, at_r = np.clip(at_scr, *scr), np.clip(at_r, *r_over_x)
        R_g, L_g = SCR_BASES[self.scr_basis].grid(at_scr, 1.0 / at_r, self.Z_base, self.omega)
        return R_g, L_g, self.place(R_g, L_g).designed

    def _coordinates(self, R_g: Any, L_g: Any) -> tuple[Any, Any]:
        R_g, L_g = np.asarray(R_g, dtype=float), np.asarray(L_g, dtype=float)
        usable = np.where(np.isfinite(R_g) & np.isfinite(L_g) & (L_g > 0.0), 1.0, np.nan)
        L_g = L_g * usable
        with np.errstate(invalid="ignore"):
            return SCR_BASES[self.scr_basis].scr(R_g, L_g, self.Z_base, self.omega), R_g / (self.omega * L_g)

    def _intervals(self, R_g: Any, L_g: Any) -> tuple[Interval, Interval]:
        scr, r_over_x = self._coordinates(R_g, L_g)
        return locate(self.scr, scr), locate(self.r_over_x, r_over_x)


def table_schedule(table: GainTable) -> TableSchedule:
    """The schedule of a controller with this table."""
    base = table.base
    return TableSchedule(
        P=table.P_design,
        Q=table.Q_design,
        V_g_rms=base.V_g_rms,
        omega=base.omega_n,
        R_2=base.R_2,
        L_2=base.L_2,
        structure=table.structure,
        law=table.law,
        S_rated=base.S_rated,
        D_p=table.D_p,
        D_q=table.D_q,
        Z_base=base_impedance(base.S_rated, base.V_rated_rms),
        scr_basis=base.scr_basis,
        scr=table.scr,
        r_over_x=1.0 / table.x_over_r[::-1],
        columns=NormalisedGains(*(values[:, ::-1] for values in table.parameters.values())),
        valid=table.valid[:, ::-1],
    )


def table_grids(table: GainTable) -> tuple[Array, Array]:
    """R_g (Ω) and L_g (H) of the table's nodes, (n, m)."""
    base = table.base
    Z_base = base_impedance(base.S_rated, base.V_rated_rms)
    R_g, L_g = SCR_BASES[base.scr_basis].grid(table.scr[:, None], table.x_over_r[None, :], Z_base, base.omega_n)
    return R_g + 0.0 * L_g, L_g + 0.0 * R_g


def node_gains(table: GainTable) -> PowerLoopGains:
    """Gains (n, m) in SI at the table's nodes and design point, from its columns. They are NaN at nodes outside."""
    keep = np.where(table.valid, 1.0, np.nan)
    schedule = table_schedule(table)
    R_g, L_g = table_grids(table)
    parameters = NormalisedGains(*table.parameters.values())
    return PowerLoopGains(*(value * keep for value in schedule.gains_with(parameters, R_g, L_g)))


def with_node_gains(table: GainTable) -> GainTable:
    """The table with its ``gains`` computed from its columns. This is the last step of building a table."""
    return replace(table, gains=node_gains(table))
