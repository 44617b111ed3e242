"""Inertia and droop of a converter, told apart in its response to a ramp of the frequency."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ROWS = 400
"""At most as many rows enter the fit: what follows is one of some hundred samples."""

_TIMES = 5.0
"""The columns may hide so many times what they leave unexplained: they are many, and most of an error fits in."""


class RampFit(NamedTuple):
    """ΔP = −D Δf/f_n − (2H/f_n) df/dt + what decays (:eq:`ramp-fit`)."""

    H_s: float
    """Inertia constant, s, with the delay of the power's filter taken out."""
    D_pu: float
    """Power per frequency, both per unit, positive if power rises when the frequency falls: 1/droop."""
    misfit: float
    """Rms of what the fit leaves of ΔP, over the rms of ΔP."""
    spread_s: float
    """Uncertainty of H, s: how far it is from that of a fit without dQ/dt and dV/dt, but at least what the unexplained
    part of ΔP could do to it, and at most five times that. It is large where a schedule changes the gains."""


def fit_ramp(
    P_pu: Array,
    Q_pu: Array,
    V_pu: Array,
    f_hz: Array,
    step_s: float,
    f_n_hz: float,
    cycle_rows: int,
    rest: tuple[float, float],
    lag_s: float = 0.0,
    limited: NDArray[np.bool_] | None = None,
) -> RampFit | None:
    """Inertia and droop from signals (n,) that begin at or before a ramp. None if they are too short.

    ``f_hz`` is the frequency of the converter's own voltage and ``rest`` the (P_pu, f_hz) before the ramp. The law
    of the power loops (:eq:`power-loop-law`) is linear in Δf, df/dt, dP/dt, dQ/dt and dV/dt, and a filter of P adds
    second derivatives, so that a least-squares fit over these columns holds during the transient as well, and no
    state of rest within the ramp is needed. All columns are means over a cycle. A filter of the delay ``lag_s``
    makes the droop lead by as much, which a ramp shows as D·lag/2 of H; it is subtracted. ``limited`` (n,) says where
    the current limiter acts: it may change the powers that the law sees, so that these rows are left out.
    """
    if len(P_pu) < 4 * cycle_rows + 8:
        return None
    P = P_pu - rest[0]
    f = (f_hz - rest[1]) / f_n_hz

    def mean(y: Array) -> Array:
        total = np.concatenate(([0.0], np.cumsum(0.5 * (y[1:] + y[:-1]))))
        return (total[cycle_rows:] - total[:-cycle_rows]) / cycle_rows

    def rate(y: Array) -> Array:
        return (y[cycle_rows:] - y[:-cycle_rows]) / (cycle_rows * step_s)

    columns = [mean(f), rate(f), *(rate(y) for y in (P, Q_pu, V_pu, np.gradient(P, step_s), np.gradient(f, step_s)))]
    # The windows of the first rows begin before the ramp, where its corner makes no difference to an exact law.
    A, y = np.column_stack(columns)[1:-1], mean(P)[1:-1]
    if limited is not None and limited.any():
        # A row's means reach back over a cycle, and the filter of P over one more.
        acted = np.concatenate(([0], np.cumsum(limited)))
        back = np.arange(len(limited) - cycle_rows)
        silent = acted[back + cycle_rows + 1] == acted[np.maximum(back - cycle_rows, 0)]
        A, y = A[silent[1:-1]], y[silent[1:-1]]
        if len(y) < 4 * cycle_rows:
            return None
    stride = max(len(y) // _ROWS, 1)
    A, y = A[::stride], y[::stride]
    size = float(np.linalg.norm(y))
    if size == 0.0 or not np.any(A[:, 0]):
        return None
    found, left = _solved(A, y)
    D = -float(found[0])
    fewer, _ = _solved(np.delete(A, (0, 3, 4), axis=1), y + D * A[:, 0])
    scale = _scale(A)
    hidden = left * float(np.linalg.norm(np.linalg.pinv(A / scale)[1])) / float(scale[1])
    spread = 0.5 * min(max(abs(float(found[1] - fewer[0])), hidden), _TIMES * hidden)
    return RampFit(0.5 * (-float(found[1]) - D * lag_s), D, left / size, spread)


def _solved(A: Array, y: Array) -> tuple[Array, float]:
    """Least-squares solution with columns of one size, and the norm of what is left."""
    scale = _scale(A)
    found = np.linalg.lstsq(A / scale, y, rcond=1e-12)[0]
    return found / scale, float(np.linalg.norm(A / scale @ found - y))


def _scale(A: Array) -> Array:
    """Largest magnitude in each column; one of a column of zeros."""
    largest = np.abs(A).max(axis=0)
    return np.where(largest > 0.0, largest, 1.0)
