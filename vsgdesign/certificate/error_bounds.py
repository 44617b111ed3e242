"""What may be behind an estimate, on boxes of estimates: the true grids of :eq:`error-set` with an error of |Z|.

Without ``error_Z`` the truth behind an estimate is R̂/(1 + e), and a box has the relative error e as its coordinate.
With it, a small R̂ may hide a truth that is far from it in proportion, and R̂ itself may be zero. The coordinate c then
stands for R = R̂/(1 + a c) − b c|Ẑ| + m|Ẑ|: either a is zero, or b and m are.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.region import Region
from vsgdesign.equations.grid import ScrBasis

Array = NDArray[np.float64]

EXTRA = 14
"""Parameters of a box beside those of a relative error: see :func:`box_parameters`."""

_STEEP = float(np.arctan(50.0))

_TURN = 2.0
"""Largest ratio of the ends of a piece of angles, as X/R: the bounds of a piece are those of its worst angle."""


_SLACK = 1e-12
"""Of both errors squared: more than the arithmetic of a chord is off by."""

_TURNS = 45
"""Of the iteration for |Z|. It is a contraction by √2·error_Z, at most 0.42: what is left is below rounding."""


def truth_behind(
    R_hat: Any, X_hat: Any, sign_R: Any, sign_X: Any, error_R: Any, error_X: Any, error_Z: Any
) -> tuple[Any, Any]:
    """The true R and X whose estimate is off by the whole half-widths of :eq:`error-set` and is (R_hat, X_hat).

    ``sign_R``, ``sign_X``: 1 where the estimate is too large, −1 where it is too small, 0 where it is exact. R may come
    out negative: then no true grid has this estimate with this error. Every true grid whose error set contains the
    estimate lies in the rectangle of the four results.
    """
    R, X = R_hat / (1.0 + sign_R * error_R), X_hat / (1.0 + sign_X * error_X)
    if not np.any(error_Z):
        return R, X
    size = np.hypot(R, X)
    for _ in range(_TURNS):
        off = error_Z * size
        size = np.hypot(_further(R, R_hat, sign_R, off), _further(X, X_hat, sign_X, off))
    off = error_Z * size
    return _further(R, R_hat, sign_R, off), _further(X, X_hat, sign_X, off)


def _further(value: Any, estimate: Any, sign: Any, off: Any) -> Any:
    """The larger error decides: the lower truth behind an estimate that is too large, the higher behind one too
    small."""
    other = estimate - sign * off
    return np.where(np.asarray(sign) > 0, np.minimum(value, other), np.maximum(value, other))


@dataclass(frozen=True)
class ErrorBounds:
    """Of K pieces of estimates: a, b and m of R and of X, arrays (K,) each; and both errors, ``error`` and
    ``error_Z``."""

    R: tuple[Array, Array, Array]
    X: tuple[Array, Array, Array]
    errors: tuple[float, float]


def error_bounds(region: Region, low: Array, high: Array) -> ErrorBounds:
    """The bounds of pieces by the least and largest angle of their estimates, (K,) each in rad (:eq:`truth-bounds`).

    Behind the estimates of a piece, R and X lie between those whose error is largest; both grow with R̂ and X̂, so the
    largest R̂ and X̂ of the piece bound all.
    """
    e, e_Z = region.error, region.error_Z
    R_hat, X_hat = np.cos(low), np.sin(np.minimum(high, 0.5 * np.pi))
    R_most, X_most = truth_behind(R_hat, X_hat, -1.0, -1.0, e, e, e_Z)
    largest = e_Z * np.hypot(R_most, X_most)
    R_least, X_least = np.cos(high), np.sin(low)
    found = []
    for most, least, other_most in ((R_hat, R_least, X_most), (X_hat, X_least, R_most)):
        # Relative alone: the truth with the least R behind the least R̂ still has the larger error from its own R.
        own = least / (1.0 + e)
        relative = (least > 0.0) & (e * own >= e_Z * np.hypot(own, other_most) * (1.0 + 1e-9))
        up = np.maximum(e * np.maximum(most, 0.0) / (1.0 - e), largest)
        down = np.maximum(e * np.maximum(most, 0.0) / (1.0 + e), largest)
        scale = region.largest_error
        half, middle = 0.5 * (up + down) * (1.0 + 1e-12), 0.5 * (up - down)
        a, b, m = (np.where(relative, *pair) for pair in ((e / scale, 0.0), (0.0, half / scale), (0.0, middle)))
        found.append((a, b, m))
    return ErrorBounds(found[0], found[1], (e, e_Z))


def reach(region: Region, basis: ScrBasis) -> tuple[float, float]:
    """A least and a largest value of Ẑ over Z in the error set: of their magnitudes, or of X̂ and X for a basis that
    counts these alone."""
    e, e_Z = region.error, region.error_Z
    most = float(np.hypot(max(e, e_Z), e_Z))
    if not basis.counts_resistance:
        most = max(e, e_Z / float(np.sin(np.arctan(region.x_over_r[0]))))
    return 1.0 - most, 1.0 + most


def angles(region: Region) -> tuple[float, float]:
    """A least and a largest angle of the estimates, rad: R̂ may be negative."""
    e, e_Z = region.error, region.error_Z
    low, high = (float(np.arctan(ratio)) for ratio in region.x_over_r)
    R, X = np.cos(low), np.sin(low)
    least = np.arctan2(X - max(e * X, e_Z), R + max(e * R, e_Z))
    R, X = np.cos(high), np.sin(high)
    R_hat, X_hat = R - max(e * R, e_Z), X + max(e * X, e_Z)
    if R_hat < 0.0:  # further from π/2 with a small X̂; a truth with R < ε|Z| has at least this X
        X_hat = np.sqrt(1.0 - e_Z * e_Z) - max(e, e_Z)
    return float(least), float(np.arctan2(X_hat, R_hat))


def finer(pieces: list[Array]) -> list[Array]:
    """Pieces of angles (2,) cut so that none is too long for one bound."""
    found = []
    for low, high in pieces:
        first, last = np.tan(low), np.tan(high) if high < _STEEP else np.tan(_STEEP)
        count = max(int(np.ceil(np.log(last / first) / np.log(_TURN) - 1e-9)), 1) if 0.0 < first < last else 1
        inner = np.arctan(np.geomspace(first, last, count + 1)[1:]).tolist() if count > 1 else []
        cuts = [float(low), *(cut for cut in inner if cut < high * (1.0 - 1e-12)), float(high)]
        found += [np.array(pair) for pair in pairwise(cuts)]
    return found


def box_parameters(bounds: ErrorBounds, piece: NDArray[np.intp], low: Array, high: Array) -> tuple[Array, Array]:
    """Parameters of N boxes, (4, N) and (EXTRA, N), by their pieces and their limits (N, 6): of the angle and of both
    coordinates c.

    The limits of R and of X are factor · R̂ + addend · |Ẑ|. The first result has the factors: of the least and the
    largest R, then of X. The second has the four addends in the same order, then a, b and m of R, then of X, then the
    two numbers of :func:`_chord` of R, then of X.
    """
    factors, addends, rest, truths = [], [], [], []
    # R̂ falls with the angle; X̂ falls again beyond π/2.
    X_hat = np.sin(low[:, 1]), np.sin(high[:, 1])
    X_top = np.where((low[:, 1] < 0.5 * np.pi) & (high[:, 1] > 0.5 * np.pi), 1.0, np.maximum(*X_hat))
    estimates = (np.cos(high[:, 1]), np.cos(low[:, 1])), (np.minimum(*X_hat), X_top)
    for k, (a, b, m) in enumerate((bounds.R, bounds.X)):
        a, b, m = a[piece], b[piece], m[piece]
        for c in (high[:, 4 + k], low[:, 4 + k]):
            factors.append(1.0 / (1.0 + a * c))
            addends.append(m - b * c)
        rest += [a, b, m]
        ends = np.array([factors[j] * value + addends[j] for j in (-2, -1) for value in estimates[k]])
        truths.append((np.where(ends.min(0) * ends.max(0) < 0.0, 0.0, np.abs(ends).min(0)), np.abs(ends).max(0)))
    of_R, of_X = truths
    chords = [*_chord(bounds.errors, *of_R, *of_X), *_chord(bounds.errors, *of_X, *of_R)]
    return np.array(factors), np.array([*addends, *rest, *chords])


def _chord(errors: tuple[float, float], few: Array, most: Array, other_few: Array, other_most: Array) -> Array:
    r"""(2, N) c and d with max(e² R², ε²|Z|²) ≤ c|Z|² + d R² (:eq:`error-chord`) for all \|R\| from ``few`` to ``most``
    and all \|X\| between the others; the same for X."""
    e_sq, e_Z_sq = errors[0] ** 2, errors[1] ** 2
    with np.errstate(invalid="ignore"):  # no truth has |Z| = 0: there both limits are 0
        low, high = few**2 / (few**2 + other_most**2), most**2 / (most**2 + other_few**2)
    low, high = np.nan_to_num(low), np.nan_to_num(high, nan=1.0)
    # Of the share R²/|Z|² it is the larger of two lines, which is convex: below the chord between its ends.
    at_low, at_high = np.maximum(e_sq * low, e_Z_sq), np.maximum(e_sq * high, e_Z_sq)
    d = np.where(high > low, (at_high - at_low) / np.where(high > low, high - low, 1.0), 0.0)
    return np.array([(np.maximum(at_low, at_high - d * (high - low)) - d * low) + _SLACK * (e_sq + e_Z_sq), d])


def error_segments(region: Region) -> tuple[Array, Array, Array]:
    """Pieces of true angles on which the same kind of error is the larger one: their least and largest angle, (K,) in
    rad, and (4, K) a and b of R, then of X, with R̂ = R(1 + a c) + b c|Z| for a coordinate c of the error."""
    e, e_Z, scale = region.error, region.error_Z, region.largest_error
    low, high = np.arctan(region.x_over_r)
    share = min(e_Z / e, 1.0) if e > 0.0 else 1.0
    turns = [float(angle) for angle in (np.arccos(share), np.arcsin(share)) if low < angle < high]
    cuts = np.array([low, *sorted(set(turns)), high])
    middle = 0.5 * (cuts[1:] + cuts[:-1])
    rows = []
    for value in (np.cos(middle), np.sin(middle)):
        own = e * value >= e_Z
        rows += [np.where(own, e / scale, 0.0), np.where(own, 0.0, e_Z / scale)]
    return cuts[:-1], cuts[1:], np.array(rows)
