"""Where error sets meet the edge of a table (:eq:`clipped-set`).

A schedule clips an estimate to its table: SCR and R/X each to their limits. The clipped corners of an error set are
therefore not all corners of the clipped set; the others are where its sides cross the limits. All grids here are R and
X at the rated frequency, in Ω.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsgdesign.equations.grid import SCR_BASES, ScrBasis, error_half_widths
from vsgdesign.parameters.specification import Specification
from vsgdesign.parameters.study import Study

Point = tuple[float, float]
"""R and X of one grid, Ω."""

_ROUNDING = 1e-9
"""What is this little outside a limit, relatively, is on it."""


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


def table_edge(study: Study, spec: Specification) -> TableEdge:
    """The edge of the table of a specification."""
    Z_base = study.converter.Z_base
    return TableEdge(
        basis=SCR_BASES[spec.scr_basis],
        counted=(Z_base / spec.scr[-1], Z_base / spec.scr[0]),
        r_over_x=(1.0 / spec.x_over_r[-1], 1.0 / spec.x_over_r[0]),
        errors=spec.box.errors,
    )
