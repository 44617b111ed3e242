"""The accuracy of an estimate of the grid: at rest, and how long it takes to follow a change."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FOUND_PCT = 10.0
"""Per cent. If R_g and L_g are both within this of the true values, the estimate counts as correct after a change."""

REST_S = 1.0
"""Longest part of the time before an event that counts as rest, s. Of a shorter time, the last quarter counts."""


@dataclass(frozen=True, kw_only=True)
class RestError:
    """Relative errors in per cent over the rest before an event. NaN if there is no estimate."""

    begin_s: float
    end_s: float
    R_g: float
    L_g: float
    """The true grid, Ω and H."""
    R_mean_pct: float
    L_mean_pct: float
    R_worst_pct: float
    L_worst_pct: float
    """Largest magnitudes."""


@dataclass(frozen=True)
class ChangeSeen:
    """How an estimate follows a change of the grid."""

    t_s: float
    found_windows: int | None
    """Number of windows from the change to the end of the first one whose estimate is correct."""
    kept_windows: int | None
    """The same for the first window from which every estimate is correct, until the next event."""
    worst_pct: float
    """Largest error of R_g or L_g, from the first whole window after the change to the next event."""


def relative_errors_pct(truth: Array, estimate: Array) -> Array:
    """100·(x̂/x − 1); infinite if the true value is zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return 100.0 * (estimate / truth - 1.0)


def rests(instants: Sequence[float], end_s: float) -> list[tuple[float, float]]:
    """Begin and end of what counts as rest before each of the instants (events) and before the end, s."""
    edges = [0.0, *sorted({t for t in instants if 0.0 < t < end_s}), end_s]
    return [(end - min(REST_S, 0.25 * (end - begin)), end) for begin, end in itertools.pairwise(edges)]


def rows_at_rest(t_s: Array, instants: Sequence[float], end_s: float) -> NDArray[np.bool_]:
    """(N,), which of the answers at the times t_s (N,) are at rest."""
    return np.logical_or.reduce([_rows(t_s, begin, end) for begin, end in rests(instants, end_s)])


def _rows(t_s: Array, begin: float, end: float) -> NDArray[np.bool_]:
    return (t_s > begin + 1e-9) & (t_s < end + 1e-9)


def errors_at_rest(
    t_s: Array, R_g: Array, L_g: Array, R_g_hat: Array, L_g_hat: Array, instants: Sequence[float], end_s: float
) -> tuple[RestError, ...]:
    """Errors before each of the instants (events) and before the end. ``t_s`` (N,): ends of the windows; R in Ω, L in
    H. A rest without a true grid (NaN: an island) is left out.
    """
    errors_R, errors_L = relative_errors_pct(R_g, R_g_hat), relative_errors_pct(L_g, L_g_hat)
    found = []
    for rest, end in rests(instants, end_s):
        rows = _rows(t_s, rest, end)
        if not rows.any():
            continue
        last = int(np.flatnonzero(rows)[-1])
        if not (math.isfinite(R_g[last]) and math.isfinite(L_g[last])):
            continue
        R, L = errors_R[rows], errors_L[rows]
        found.append(
            RestError(
                begin_s=rest,
                end_s=end,
                R_g=float(R_g[last]),
                L_g=float(L_g[last]),
                R_mean_pct=float(R.mean()),
                L_mean_pct=float(L.mean()),
                R_worst_pct=float(np.abs(R).max()),
                L_worst_pct=float(np.abs(L).max()),
            )
        )
    return tuple(found)


def changes_seen(
    t_s: Array,
    R_g: Array,
    L_g: Array,
    R_g_hat: Array,
    L_g_hat: Array,
    period: float,
    changes: Sequence[float],
    instants: Sequence[float],
    end_s: float,
) -> tuple[ChangeSeen, ...]:
    """How the estimate followed each change of the grid, up to the next of the instants (events) or the end."""
    worse = np.maximum(
        np.abs(relative_errors_pct(R_g, R_g_hat)), np.abs(relative_errors_pct(L_g, L_g_hat))
    )  # NaN stays NaN
    seen = []
    for change in changes:
        until = min([t for t in instants if t > change + 1e-9] + [end_s])
        rows = np.flatnonzero((t_s > change + 1e-9) & (t_s < until + 1e-9))
        if len(rows) == 0:
            continue
        good = worse[rows] <= FOUND_PCT  # NaN is not good
        windows = [math.ceil((t - change) / period - 1e-6) for t in t_s[rows]]
        first = next((windows[k] for k in np.flatnonzero(good)), None)
        bad = np.flatnonzero(~good)
        from_there = 0 if len(bad) == 0 else int(bad[-1]) + 1
        kept = windows[from_there] if from_there < len(windows) else None
        # The window that holds the change belongs to two grids.
        whole = worse[rows][np.array(t_s[rows]) > change + period - 1e-9]
        worst = float(np.nanmax(whole)) if np.isfinite(whole).any() else math.nan
        seen.append(ChangeSeen(change, first, kept, worst))
    return tuple(seen)
