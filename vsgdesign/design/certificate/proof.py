"""From points to the whole region: the inequality on boxes, and on smaller boxes where that is too coarse."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.certificate.enclosure import UNIT, enclose
from vsgdesign.design.certificate.region import Region, System
from vsgdesign.design.certificate.taylor_form import TaylorForm

Array = NDArray[np.float64]

_CHUNK = 1024

Weights = Callable[[Any, Any], tuple[list[Any], list[list[Any]]]]
"""1/SCR and R/X of a point or a box to the weights 1, ρ of P_0 … P_K and to their rates, one list for each way of
moving."""


@dataclass(frozen=True)
class Boxes:
    """N boxes, (N, d) limits each."""

    low: Array
    high: Array

    def __len__(self) -> int:
        return len(self.low)

    def take(self, index: Any) -> Boxes:
        """Some of the boxes."""
        return Boxes(self.low[index], self.high[index])

    def halves(self, dimension: NDArray[np.intp]) -> Boxes:
        """Each cut in the middle of its dimension."""
        rows = np.arange(len(self))
        middle = 0.5 * (self.low[rows, dimension] + self.high[rows, dimension])
        low, high = self.low.copy(), self.high.copy()
        low[rows, dimension], high[rows, dimension] = middle, middle
        return Boxes(np.concatenate([self.low, low]), np.concatenate([high, self.high]))


@dataclass(frozen=True)
class Outcome:
    """How the proof over the boxes ended.

    ``decay``: the last one tried, 1/s. ``proved``: how many boxes hold the inequality, or nothing within the static
    limits. ``left``: those that are undecided, of ``whole``.
    """

    decay: float
    proved: int
    left: Boxes
    whole: Boxes


def prove(
    system: System, region: Region, weights: Weights, P: Array, decays: Sequence[float], whole: Boxes, budget: int,
    progress: Callable[[str, float], None] | None = None,
) -> Outcome:  # fmt: skip
    """The largest of some decays (falling) at which the inequality holds in all points of the boxes that lie within
    the static limits (:eq:`box-bound`).

    Boxes are cut in half where the bound is too coarse, the largest first, until none is left or the decay's part of
    ``budget`` boxes was looked at; the next decay goes on with what is left.
    """
    level, proved, seen, decay = whole, 0, 0, decays[0]
    for turn, decay in enumerate(decays):
        # Half of the boxes for the first decay, the other half for giving way step by step.
        part = 0.5 * (1.0 + turn / max(len(decays) - 1, 1))
        while len(level) and seen + len(level) <= budget * part:
            parts = []
            for start in range(0, len(level), _CHUNK):
                boxes = level.take(slice(start, start + _CHUNK))
                bound, dimension, empty = bound_on(system, region, weights, P, decay, boxes)
                undecided = ~(empty | (bound < 0.0))  # NaN is undecided
                proved += int((~undecided).sum())
                parts.append(boxes.take(undecided).halves(dimension[undecided]))
                if progress is not None:
                    progress("certificate", min((seen + start) / budget, 1.0))
            seen += len(level)
            level = Boxes(np.concatenate([b.low for b in parts]), np.concatenate([b.high for b in parts]))
        if len(level) == 0:
            break
    if progress is not None:
        progress("certificate", 1.0)
    return Outcome(decay, proved, level, whole)


def bound_on(
    system: System, region: Region, weights: Weights, P: Array, decay: float, boxes: Boxes
) -> tuple[Array, NDArray[np.intp], NDArray[np.bool_]]:
    """For each box: an upper bound on the largest eigenvalue of the inequality relative to P at its middle, the
    dimension to cut, and whether nothing of it lies within the static limits (:eq:`box-bound`)."""
    moving = np.flatnonzero((boxes.high > boxes.low).any(axis=0))
    count, d = len(boxes), len(moving)
    worst, score = np.full(count, -np.inf), np.zeros((count, d))
    with np.errstate(all="ignore"):  # what has no bound becomes infinite or NaN, and is cut
        found = enclose(system, region, boxes.low, boxes.high)
        here, ways = weights(found.weakness, found.r_over_x)
        centres = np.stack([_of(w, count, d)[:, 0] for w in here], axis=1)
        half = np.linalg.inv(np.linalg.cholesky(np.tensordot(centres, P, 1))).astype(float)
        for rows in found.corners:
            A = _coefficients([value for row in rows for value in row], count, d).reshape(count, -1, 3, 3)
            for way in ways:
                bound, pull = _largest(_inequality(A, here, way, P, decay, half, d), d)
                worst, score = np.maximum(worst, bound), np.maximum(score, pull)
    # Where there is no bound at all, the widest side goes first.
    wide = (boxes.high - boxes.low)[:, moving] / UNIT[moving]
    score = np.where(np.isfinite(score).all(axis=1, keepdims=True), score, wide)
    dimension = moving[np.argmax(score, axis=1)]
    wider = np.where(boxes.high[:, 4] - boxes.low[:, 4] >= boxes.high[:, 5] - boxes.low[:, 5], 4, 5)
    return worst, np.where(dimension >= 4, wider, dimension), found.empty


def _of(value: Any, count: int, d: int) -> Array:
    """All coefficients of a form in a row, (N, 1 + d + d(d + 1)/2 + d): centre, linear, square, rest."""
    found = np.zeros((count, 1 + 2 * d + d * (d + 1) // 2))
    if isinstance(value, TaylorForm):
        found[:, 0] = value.centre
        found[:, 1:] = np.concatenate([value.linear, value.square, value.rest]).T
    else:
        found[:, 0] = value
    return found


def _coefficients(values: list[Any], count: int, d: int) -> Array:
    return np.stack([_of(value, count, d) for value in values], axis=-1)


def _inequality(A: Array, here: list[Any], way: list[Any], P: Array, decay: float, half: Array, d: int) -> Array:
    """Coefficients (N, M, 6) of the inequality's triangle, in coordinates where P at the middle is the unit matrix."""
    count = len(A)
    turned = np.swapaxes(half, 1, 2)[:, None]
    left = np.swapaxes(np.linalg.inv(half), 1, 2)[:, None]
    # x = halfᵀ z: A becomes half⁻ᵀ A halfᵀ and P_k becomes half P_k halfᵀ. Rests go through absolute values.
    rest = slice(A.shape[1] - d, None)
    turned_A = left @ A @ turned
    turned_A[:, rest] = np.abs(left) @ A[:, rest] @ np.abs(turned)
    total: Any = 0.0
    for k, matrix in enumerate(P):
        Pk = (half @ matrix @ turned[:, 0])[:, None]
        product = Pk @ turned_A
        product[:, rest] = np.abs(Pk) @ turned_A[:, rest]
        product = product + np.swapaxes(product, 2, 3)
        product[:, 0] += 2.0 * decay * Pk[:, 0]
        triangle, own = product[:, :, _ROW, _COLUMN], Pk[:, 0, _ROW, _COLUMN]
        if isinstance(here[k], TaylorForm):
            triangle = np.stack([_of(here[k] * _form(triangle[:, :, m], d), count, d) for m in range(6)], axis=-1)
        rate = _of(way[k], count, d)[:, :, None] * own[:, None]
        rate[:, rest] = np.abs(rate[:, rest])
        total = total + triangle + rate
    return total


def _form(coefficients: Array, d: int) -> TaylorForm:
    """The form of a row of coefficients (N, M)."""
    last = coefficients.shape[1] - d
    parts = coefficients.T
    return TaylorForm(parts[0], parts[1 : 1 + d], parts[1 + d : last], parts[last:])


_ROW, _COLUMN = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]


def _largest(coefficients: Array, d: int) -> tuple[Array, Array]:
    """Upper bound on the largest eigenvalue (N,), and how much each dimension adds to what is not known (N, d).

    t_k² is 1/2 ± 1/2. Without that, and without the rest, the matrix is affine in each t_k, so its largest
    eigenvalue is convex in each and largest at a corner. The rest adds at most its norm.
    """
    i, j = np.triu_indices(d)
    last = coefficients.shape[1] - d
    linear, square, rest = coefficients[:, 1 : 1 + d], coefficients[:, 1 + d : last], coefficients[:, last:]
    own, cross = square[:, i == j], square[:, i != j]
    i, j = i[i != j], j[i != j]
    middle = coefficients[:, 0] + 0.5 * own.sum(axis=1)
    unknown = rest + 0.5 * np.abs(own)
    # Dimensions that nothing follows (estimate errors) need no corners.
    used = (linear != 0.0).any(axis=(0, 2))
    for k, pair in enumerate(zip(i, j, strict=True)):
        used[list(pair)] |= bool((cross[:, k] != 0.0).any())
    live = np.flatnonzero(used)
    signs = np.zeros((2 ** len(live), d))
    signs[:, live] = 1.0 - 2.0 * ((np.arange(len(signs))[:, None] >> np.arange(len(live))) & 1)
    terms = np.concatenate([linear, cross], axis=1).transpose(1, 0, 2).reshape(d + len(i), -1)
    every = np.concatenate([signs, signs[:, i] * signs[:, j]], axis=1)
    corners = (every @ terms).reshape(len(signs), len(middle), 6) + middle
    norm = _largest_eigenvalue(*unknown.sum(axis=1).T)
    bound = _largest_eigenvalue(*np.moveaxis(corners, 2, 0)).max(axis=0) + norm
    return bound, unknown.sum(axis=2) + 0.02 * np.abs(linear).sum(axis=2)


def _largest_eigenvalue(a: Array, b: Array, c: Array, d: Array, e: Array, f: Array) -> Array:
    """Of [[a, d, e], [d, b, f], [e, f, c]], in closed form by the angle of its characteristic polynomial."""
    mean = (a + b + c) / 3.0
    a, b, c = a - mean, b - mean, c - mean
    dd, ee, ff = d * d, e * e, f * f
    p = np.sqrt((a * a + b * b + c * c) / 6.0 + (dd + ee + ff) / 3.0) + 1e-300
    half_det = 0.5 * (a * (b * c - ff) - b * ee - c * dd + 2.0 * d * e * f)
    ratio = np.clip(half_det / p / p / p, -1.0, 1.0)
    return mean + 2.0 * p * np.cos(np.arccos(ratio) / 3.0)
