"""Where error sets meet the edge of a table (:eq:`clipped-set`).

A schedule clips an estimate to its table: SCR and R/X each to their limits. The clipped corners of an error set are
therefore not all corners of the clipped set; the others are where its sides cross the limits. In the same way, of the
true grids that may be looked up at a place, the table's edge cuts off corners and leaves others on the edge. All grids
here are R and X at the rated frequency, in Ω.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.error_bounds import truth_behind
from vsgdesign.equations.grid import SCR_BASES, ScrBasis, error_half_widths
from vsgdesign.study.parameters.specification import Specification
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Point = tuple[float, float]
"""R and X of one grid, Ω."""

_ROUNDING = 1e-9
"""What is this little outside a limit, relatively, is on it."""

_SAMPLES = 65
"""Grids on each edge, as far as a set reaches, among which its ends are looked for."""

_BISECTIONS = 40

_TURNS = np.array([0.75, 0.5, 0.25, 0.0])
"""R̂ of estimates beyond the largest X/R, relative to where they are looked up."""


@dataclass(frozen=True)
class TableEdge:
    """The limits of a table, and how wrong its estimates may be."""

    basis: ScrBasis
    counted: Point
    """Least and largest counted part of the impedance, Ω: at the largest and at the least SCR."""
    r_over_x: Point
    errors: tuple[float, float, float]
    """error_R, error_X and error_Z (:eq:`error-set`)."""

    def seen_beside_corners(self, R: float, X: float) -> list[Point]:
        """Estimates of a true grid where a side of its error set crosses a limit of the table, or R̂ = 0.

        Clipped, they and the corners are all corners of the clipped set: between two of them a side is on one side of
        every limit, and neither SCR nor R/X turns back.
        """
        w_R, w_X = (float(width) for width in error_half_widths(R, X, *self.errors))
        Rs, Xs = (R - w_R, R + w_R), (X - w_X, X + w_X)
        level = [(ratio * x, x) for ratio in (0.0, *self.r_over_x) for x in Xs]
        upright = [(r, r / ratio) for ratio in self.r_over_x for r in Rs]
        for size in self.counted:
            if self.basis.counts_resistance:
                roots = [(float(np.sqrt(size * size - x * x)), x) for x in Xs if x < size]
                level += [*roots, *((-r, x) for r, x in roots)]
                upright += [(r, float(np.sqrt(size * size - r * r))) for r in Rs if abs(r) < size]
            else:
                upright += [(r, size) for r in Rs]
        slack = _ROUNDING * float(np.hypot(R, X))  # a crossing at a corner is that corner
        return [
            *((r, x) for r, x in level if Rs[0] + slack < r < Rs[1] - slack),
            *((r, x) for r, x in upright if Xs[0] + slack < x < Xs[1] - slack),
        ]

    def may_be_seen_at(self, R: Any, X: Any, R_hat: Any, X_hat: Any) -> NDArray[np.bool_]:
        """Whether an estimate of the true grids R, X is looked up at the places R_hat, X_hat of the table."""
        widths = error_half_widths(R, X, *self.errors)
        R_low, R_high, X_low, X_high = R - widths[0], R + widths[0], X - widths[1], X + widths[1]
        (least, most), (ratio_low, ratio_high) = self.counted, self.r_over_x
        size, ratio = self.basis.counted(R_hat, X_hat), R_hat / X_hat
        # The estimates that are clipped to this R/X have it between these: at an edge, also what is beyond.
        low = np.where(ratio <= ratio_low * (1.0 + _ROUNDING), -np.inf, ratio)
        high = np.where(ratio >= ratio_high * (1.0 - _ROUNDING), np.inf, ratio)
        least_ratio = np.where(R_low > 0.0, R_low / X_high, R_low / X_low)
        inside = (least_ratio <= high * (1.0 + _ROUNDING)) & (R_high / X_low >= low * (1.0 - _ROUNDING))
        # Of the error set between these rays, the estimates with the least and with the largest counted part.
        X_least = np.maximum(X_low, np.maximum(R_low, 0.0) / high)
        R_least = np.maximum(np.maximum(R_low, 0.0), np.maximum(low, 0.0) * X_least)
        X_most = np.where(low > 0.0, np.minimum(X_high, R_high / np.where(low > 0.0, low, 1.0)), X_high)
        R_most = np.minimum(R_high, high * X_most)
        R_most = np.where(low > 0.0, R_most, np.maximum(R_most, -R_low))
        inside &= (size <= least * (1.0 + _ROUNDING)) | (self.basis.counted(R_most, X_most) >= size * (1.0 - _ROUNDING))
        return inside & (
            (size >= most * (1.0 - _ROUNDING)) | (self.basis.counted(R_least, X_least) <= size * (1.0 + _ROUNDING))
        )

    def truths_seen_at(self, R_hat: Array, X_hat: Array, R: Array, X: Array) -> list[list[Point]]:
        """Of K places of the table (K,): the corners of the set of true grids that may be looked up there, beside those
        with the largest errors of both signs. Most are on the table's edge, where the set begins or ends.

        ``R``, ``X``: (K, n) grids that are known to be in the sets. Among them are those to which the corners of each
        set are drawn in, so that no part of a set that leaves the table is overlooked.
        """
        place = R_hat[:, None], X_hat[:, None]
        sign_R, sign_X = np.array(list(itertools.product((-1.0, 1.0), repeat=2))).T
        behind = truth_behind(*place, sign_R, sign_X, *self.errors)
        # Of estimates beyond the largest X/R, up to R̂ = 0: the grids with the largest R and X, along an arc.
        at_end = (R_hat / X_hat <= self.r_over_x[0] * (1.0 + _ROUNDING))[:, None]
        R_turned, size = _TURNS * place[0], self.basis.counted(*place)
        X_turned = np.sqrt(size * size - R_turned * R_turned) if self.basis.counts_resistance else size + 0.0 * R_turned
        turned = truth_behind(R_turned, X_turned, -1.0, -1.0, *self.errors)
        beyond = np.where(at_end, turned[0], place[0]), np.where(at_end, turned[1], place[1])
        known = [np.hstack(parts) for parts in zip(behind, beyond, place, (R, X), strict=True)]
        within = at_end & self._is_within(*beyond)
        found = [
            [(float(r), float(x)) for r, x in zip(rs[ok], xs[ok], strict=True)]
            for rs, xs, ok in zip(*beyond, within, strict=True)
        ]
        sizes = np.clip(self.basis.counted(*known), *self.counted)
        ratios = np.clip(np.maximum(known[0], 0.0) / known[1], *self.r_over_x)
        for limit in self.counted:
            self._add_ends(found, R_hat, X_hat, ratios, self.r_over_x, lambda at, limit=limit: (limit + 0.0 * at, at))
        for limit in self.r_over_x:
            self._add_ends(found, R_hat, X_hat, sizes, self.counted, lambda at, limit=limit: (at, limit + 0.0 * at))
        return found

    def _add_ends(
        self,
        found: list[list[Point]],
        R_hat: Array,
        X_hat: Array,
        known: Array,
        limits: Point,
        grid: Callable[[Array], tuple[Array, Array]],
    ) -> None:
        """Adds the ends of the sets of K places on one edge. ``known``: (K, n) coordinates along the edge, between its
        ``limits``, up to which the sets reach. ``grid`` makes counted part and R/X of a coordinate."""

        def at(coordinate: Array) -> tuple[Array, Array]:
            size, ratio = grid(np.exp(coordinate))
            return self.basis.grid(1.0 / size, 1.0 / ratio, 1.0, 1.0)

        known, ends = np.log(known), np.log(limits)
        first, last = known.min(axis=1, keepdims=True), known.max(axis=1, keepdims=True)
        even = first + np.linspace(0.0, 1.0, _SAMPLES) * (last - first)
        tried = np.sort(np.hstack([known, even, np.tile(ends, (len(known), 1))]))
        inside = self.may_be_seen_at(*at(tried), R_hat[:, None], X_hat[:, None])
        place, k = np.nonzero(inside[:, 1:] != inside[:, :-1])
        begins, left, right = inside[place, k + 1], tried[place, k], tried[place, k + 1]
        within, beyond = np.where(begins, right, left), np.where(begins, left, right)
        for _ in range(_BISECTIONS if len(place) else 0):
            middle = 0.5 * (within + beyond)
            seen = self.may_be_seen_at(*at(middle), R_hat[place], X_hat[place])
            within, beyond = np.where(seen, middle, within), np.where(seen, beyond, middle)
        corners = [np.flatnonzero(inside[:, end]) for end in (0, -1)]
        whose = np.concatenate([place, *corners])
        where = np.concatenate([within, *(np.full(len(of), end) for of, end in zip(corners, ends, strict=True))])
        for of, r, x in zip(whose, *at(where), strict=True):
            found[of].append((float(r), float(x)))

    def _is_within(self, R: Array, X: Array) -> NDArray[np.bool_]:
        """Whether grids are within the table."""
        with np.errstate(divide="ignore", invalid="ignore"):
            parts = ((self.basis.counted(R, X), self.counted), (R / X, self.r_over_x))
            inside = [(low <= value) & (value <= high) for value, (low, high) in parts]
        return (X > 0.0) & inside[0] & inside[1]


def table_edge(study: Study, spec: Specification) -> TableEdge:
    """The edge of the table of a specification."""
    Z_base = study.converter.Z_base
    return TableEdge(
        basis=SCR_BASES[spec.scr_basis],
        counted=(Z_base / spec.scr[-1], Z_base / spec.scr[0]),
        r_over_x=(1.0 / spec.x_over_r[-1], 1.0 / spec.x_over_r[0]),
        errors=spec.box.errors,
    )
