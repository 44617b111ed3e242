"""What an estimator said of the grid over time: how wrong, how late, and how sure; at rest, and after a change.

An answer acts from its instant until the next answer. It is judged against the grid that holds at its instant. All
times are those of the run. In polar form an answer has a 95 % band, from the covariance of its R and X.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FOUND = 0.10
"""An answer with a relative error of up to this has found the grid."""

WRONG, VERY_WRONG = 0.20, 0.30
"""A valid answer with a relative error above these is wrong, and very wrong."""

GRACE_S = 0.04
"""For this long after an event, s, an answer that is valid and wrong is not counted: the cycle in which the event
falls must end before it can be seen at all."""

_SLACK_S = 1e-9
"""Instants are equal up to this, s: they are sums of many sampling periods."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Answers:
    """All answers of a run, one row each, in the order of time. Impedances are R + jX at the nominal frequency."""

    t_s: Array
    """(n,) instants from which on the answers act, s: the end of the cycle behind each."""
    Z: NDArray[np.complex128]
    """(n,) true impedance of the grid, Ω."""
    Z_hat: NDArray[np.complex128]
    """(n,) estimate, Ω; NaN where there is none."""
    covariance: Array
    """(n, 2, 2) covariance of the estimate's (R, X), Ω²; NaN where it is not known."""
    valid: Mask
    """(n,) whether the estimator stands by its answer."""
    changed: Mask
    """(n,) whether it announced with this answer that the grid has changed."""
    end_s: float
    """End of the run, s: the last answer acts until then."""

    def __post_init__(self) -> None:
        n = len(self.t_s)
        shapes = {"t_s": (n,), "Z": (n,), "Z_hat": (n,), "covariance": (n, 2, 2), "valid": (n,), "changed": (n,)}
        faults = [
            f"{name} has the shape {np.shape(getattr(self, name))}, but must have {shape}."
            for name, shape in shapes.items()
            if np.shape(getattr(self, name)) != shape
        ]
        if not faults and n and not (np.diff(self.t_s) > 0.0).all():
            faults.append("t_s must ascend.")
        if not faults and n and self.end_s < self.t_s[-1] - _SLACK_S:
            faults.append(f"end_s = {self.end_s:g} s is before the last answer, {self.t_s[-1]:g} s.")
        if faults:
            raise ValueError("answers: " + " ".join(faults))

    @property
    def error(self) -> Array:
        """(n,) |Ẑ − Z|/|Z|; NaN where there is no estimate."""
        return np.abs(self.Z_hat - self.Z) / np.abs(self.Z)

    def rows(self, begin_s: float, end_s: float) -> Mask:
        """(n,) which answers act from an instant in [begin_s, end_s)."""
        return (self.t_s >= begin_s - _SLACK_S) & (self.t_s < end_s - _SLACK_S)


def answers_of(
    t_s: ArrayLike,
    true: tuple[ArrayLike, ArrayLike],
    estimate: tuple[ArrayLike, ArrayLike],
    variances: tuple[ArrayLike, ArrayLike, ArrayLike],
    valid: ArrayLike,
    changed: ArrayLike,
    *,
    omega_n: float,
    end_s: float,
) -> Answers:
    """Answers from series of R (Ω) and L (H): ``true`` and ``estimate`` are (R_g, L_g), ``variances`` the estimate's
    (var R, cov RL, var L) in Ω², Ω·H and H², all (n,). ``omega_n``: nominal angular frequency, rad/s."""
    R_L = [[np.asarray(x, dtype=float) for x in pair] for pair in (true, estimate)]
    RR, RL, LL = (np.asarray(x, dtype=float) for x in variances)
    X_scaled = np.stack([np.stack([RR, omega_n * RL], -1), np.stack([omega_n * RL, omega_n**2 * LL], -1)], -2)
    Z, Z_hat = (R + 1j * omega_n * L for R, L in R_L)
    return Answers(
        t_s=np.asarray(t_s, dtype=float),
        Z=Z,
        Z_hat=Z_hat,
        covariance=X_scaled,
        valid=np.asarray(valid).astype(bool) & np.isfinite(Z_hat),
        changed=np.asarray(changed).astype(bool),
        end_s=end_s,
    )


def inside_ellipse(answers: Answers, level: float = 0.95) -> Mask:
    """(n,) whether the true impedance is inside the answer's own ellipse of a level.

    With the error e = (R̂ − R, X̂ − X) and the covariance P it is inside if eᵀP⁻¹e ≤ −2 ln(1 − level), which is the
    quantile of χ² with two degrees of freedom. An answer without a covariance, or with one that is not positive
    definite, contains nothing.
    """
    if not 0.0 < level < 1.0:
        raise ValueError(f"level = {level:g}: must be between 0 and 1.")
    off = answers.Z_hat - answers.Z
    P_RR, P_RX, P_XX = answers.covariance[:, 0, 0], answers.covariance[:, 0, 1], answers.covariance[:, 1, 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        determinant = P_RR * P_XX - P_RX**2
        squared = (P_XX * off.real**2 - 2.0 * P_RX * off.real * off.imag + P_RR * off.imag**2) / determinant
        return (determinant > 0.0) & (P_RR > 0.0) & (squared <= -2.0 * math.log1p(-level))


def coverage(answers: Answers, rows: Mask, level: float = 0.95) -> float:
    """Share of the valid answers among ``rows`` whose ellipse contains the true impedance; NaN where none is valid."""
    chosen = rows & answers.valid
    return float(np.mean(inside_ellipse(answers, level)[chosen])) if chosen.any() else math.nan


def time_to_stay(answers: Answers, change_s: float, until_s: float) -> float:
    """Time from a change of the grid until it is found for good, s; infinite where it is not found until ``until_s``.

    It ends with the first valid answer whose error is at most ``FOUND`` and after which no valid answer has a larger
    error until ``until_s``. Answers that are not valid neither find the grid nor lose it.
    """
    rows = np.flatnonzero(answers.rows(change_s, until_s) & answers.valid)
    off = np.flatnonzero(~(answers.error[rows] <= FOUND))
    first = int(off[-1]) + 1 if off.size else 0
    return float(answers.t_s[rows[first]] - change_s) if first < len(rows) else math.inf


@dataclass(frozen=True)
class Wrong:
    """How long an estimator was valid and wrong, and how wrong a valid answer was at most."""

    seconds: float
    """Time in force of valid answers with an error above WRONG, s."""
    worst: float
    """Largest relative error of a valid answer that was in force; zero where none was."""


def valid_and_wrong(
    answers: Answers,
    begin_s: float,
    until_s: float,
    events_s: Sequence[float],
    *,
    above: float = WRONG,
) -> Wrong:
    """For how long valid answers were off by more than ``above`` between two instants, and the largest error of one.

    Time up to ``GRACE_S`` after each of the events is left out of both. An answer that acts across an event counts up
    to the event, and the rest of it lies within the grace.
    """
    edges = np.append(answers.t_s, max(answers.end_s, answers.t_s[-1])) if len(answers.t_s) else np.zeros(1)
    counted = _overlap(edges, begin_s, until_s)
    last = begin_s
    for event_s in sorted(events_s):
        # Graces that follow one another closely overlap: each counts from the end of the one before.
        start, last = max(event_s, last), max(event_s + GRACE_S, last)
        counted = counted - _overlap(edges, max(start, begin_s), min(last, until_s))
    in_force = answers.valid & (counted > _SLACK_S)
    error = answers.error
    return Wrong(
        seconds=float(np.sum(counted[in_force & (error > above)])),
        worst=float(np.max(error[in_force], initial=0.0)),
    )


def share_valid(answers: Answers, begin_s: float, until_s: float) -> float:
    """Share of the time between two instants in which a valid answer acts; before the first answer none does."""
    if not until_s > begin_s:
        raise ValueError(f"until_s = {until_s:g} s: must be after begin_s = {begin_s:g} s.")
    if not len(answers.t_s):
        return 0.0
    edges = np.append(answers.t_s, max(answers.end_s, answers.t_s[-1]))
    return float(np.sum(_overlap(edges, begin_s, until_s)[answers.valid])) / (until_s - begin_s)


def _overlap(edges: Array, begin_s: float, until_s: float) -> Array:
    """How much of every interval between two edges lies in [begin_s, until_s], s."""
    clipped = np.clip(edges, begin_s, max(until_s, begin_s))
    return np.diff(clipped)


WIDTH = 1.959963984540054
"""Half the width of the central 95 % of a normal distribution, in standard deviations."""


class PolarBand(NamedTuple):
    """Magnitude (Ω) and angle (rad) of an impedance, and half the width of the 95 % band of each; NaN where there is
    no estimate."""

    size: Array
    size_half: Array
    angle: Array
    angle_half: Array


def polar_band(answers: Answers) -> PolarBand:
    """The answers in polar form, each with half the width of its 95 % band, all (n,).

    Of a small error e, the part along Z changes |Z| and the part across it turns Z by this part over |Z|. Their
    variances are those of the covariance in these two directions.
    """
    Z, P = answers.Z_hat, answers.covariance
    size = np.abs(Z)
    with np.errstate(invalid="ignore", divide="ignore"):
        along, across = Z / size, 1j * Z / size
        variances = [
            P[:, 0, 0] * u.real**2 + 2.0 * P[:, 0, 1] * u.real * u.imag + P[:, 1, 1] * u.imag**2
            for u in (along, across)
        ]
        halves = [WIDTH * np.sqrt(np.maximum(variance, 0.0)) for variance in variances]
        return PolarBand(size, halves[0], np.angle(Z), halves[1] / size)


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
