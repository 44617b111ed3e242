"""How often an estimate is inside the error set of a gain table: measured errors against :eq:`error-set`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.measured_errors import MeasuredErrors
from vsgdesign.equations.grid import SCR_BASES, error_half_widths
from vsgdesign.frames import base_impedance
from vsgdesign.runtime.table import table_grids

Array = NDArray[np.float64]

FEWEST = 50
"""With fewer answers a bin says nothing."""

SETTLED = 0.95
"""After a jump the estimate counts as inside from when on it is for so many of the jumps."""

_EDGE = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class InsideSet:
    """Shares of the time, or of the jumps, with the estimate inside the set."""

    shares: Array
    """(n, m) at rest, at the table's nodes; NaN where nothing was measured."""
    answers: NDArray[np.int64]
    """(n, m) answers behind each share."""
    since: tuple[tuple[float, float], ...]
    """Time since a jump, s, and share of the jumps; over all grids that were measured."""
    jumps: int

    @property
    def known(self) -> int:
        """Nodes at which something was measured."""
        return int(np.isfinite(self.shares).sum())

    @property
    def worst(self) -> tuple[int, int] | None:
        """The node of the smallest share; None where none is known."""
        if self.known == 0:
            return None
        i, j = np.unravel_index(int(np.nanargmin(self.shares)), self.shares.shape)
        return int(i), int(j)

    @property
    def settled_s(self) -> float | None:
        """When the share since a jump has come to SETTLED for good, s; None where it never has."""
        after = [t_s for t_s, share in self.since if share < SETTLED]
        later = [t_s for t_s, _ in self.since if not after or t_s > after[-1]]
        return later[0] if later else None


def within(errors: Array, error: float, error_Z: float) -> NDArray[np.bool_]:
    """(n,), which of the errors (n, 3) of R and X, with R of the true grid, each over |Z|, lie in the set. NaN does
    not."""
    R = errors[:, 2]
    X = np.sqrt(np.maximum(1.0 - R * R, 0.0))
    w_R, w_X = error_half_widths(R, X, error, error, error_Z)
    with np.errstate(invalid="ignore"):
        return (np.abs(errors[:, 0]) <= w_R) & (np.abs(errors[:, 1]) <= w_X)


def inside_set(table: GainTable, measured: MeasuredErrors) -> InsideSet:
    """Measured errors against the set of a table, node by node: the worst of the bins that a node lies in."""
    error, error_Z = table.validity.error, table.validity.error_Z
    R_g, L_g = table_grids(table)
    base = table.base
    Z_base = base_impedance(base.S_rated, base.V_rated_rms)
    scr = SCR_BASES["impedance"].scr(R_g, L_g, Z_base, base.omega_n)
    ratio = base.omega_n * L_g / R_g
    shares, answers = np.full(table.shape, np.nan), np.zeros(table.shape, dtype=np.int64)
    for one in measured.bins:
        if len(one.errors) < FEWEST:
            continue
        share = float(within(one.errors, error, error_Z).mean())
        here = _between(scr, one.scr) & _between(ratio, one.x_over_r) & ~(shares <= share)
        shares[here], answers[here] = share, len(one.errors)
    since = tuple(
        (one.t_s, float(within(one.errors, error, error_Z).mean())) for one in measured.jumps if len(one.errors)
    )
    jumps = max((len(one.errors) for one in measured.jumps), default=0)
    return InsideSet(shares=shares, answers=answers, since=since, jumps=jumps)


def inside_run(
    table: GainTable,
    truth: tuple[Array, Array],
    estimate: tuple[Array, Array],
    rest: NDArray[np.bool_],
) -> tuple[float, float]:
    """Shares of the answers of a run that are inside a table's set: of those at rest, (n,), and of all.

    ``truth``, ``estimate``: R_g (Ω) and L_g (H) at each answer, (n,). Where there is no estimate the last one holds;
    before the first there is none, and it is not inside. NaN where there is no such answer.
    """
    omega = table.base.omega_n
    held = np.maximum.accumulate(
        np.where(np.isfinite(estimate[0]) & np.isfinite(estimate[1]), np.arange(len(rest)), -1)
    )
    R_hat, L_hat = (np.where(held >= 0, values[np.maximum(held, 0)], np.nan) for values in estimate)
    size = np.hypot(truth[0], omega * truth[1])
    errors = np.stack([R_hat - truth[0], omega * (L_hat - truth[1]), truth[0]], axis=1) / size[:, None]
    inside = within(errors, table.validity.error, table.validity.error_Z)
    share, whole = (float(rows.mean()) if len(rows) else float("nan") for rows in (inside[rest], inside))
    return share, whole


def _between(values: Array, limits: tuple[float, float]) -> NDArray[np.bool_]:
    return (values >= limits[0] * (1.0 - _EDGE)) & (values <= limits[1] * (1.0 + _EDGE))
