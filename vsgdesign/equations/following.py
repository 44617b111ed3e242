"""How far a schedule follows an estimate that knows its own error."""

from __future__ import annotations

from typing import Any

import numpy as np

CHI_SQUARE_95 = 5.991464547107979
"""95 % quantile of χ² with two degrees of freedom, −2 ln 0.05."""


def share_that_fits(h_R: Any, h_X: Any, var_R: Any, var_X: Any) -> Any:
    """1 if the 95 % ellipse of an estimate fits a box of the half-widths h, otherwise the factor by which it would have
    to shrink (:eq:`share-that-fits`).

    Whatever the correlation, the ellipse reaches as far as √(χ² var) in each coordinate. The half-widths must be
    positive.
    """
    reach_R, reach_X = np.sqrt(CHI_SQUARE_95 * var_R), np.sqrt(CHI_SQUARE_95 * var_X)
    return np.minimum(h_R / np.maximum(reach_R, h_R), h_X / np.maximum(reach_X, h_X))


def part_of_the_way(
    goal_scr: Any,
    goal_r_over_x: Any,
    scr: Any,
    r_over_x: Any,
    share: Any,
    left_scr: Any,
    left_r_over_x: Any,
) -> tuple[Any, Any]:
    """Returns (moved_scr, moved_r_over_x): the goal, moved by a share of the way to an estimate in (ln SCR, ln R/X)
    (:eq:`partly-followed`).

    A step that leads towards the place that the grid has left is not made; where it has left none, give the goal
    itself. All values must be positive.
    """
    way_scr, way_r = np.log(scr / goal_scr), np.log(r_over_x / goal_r_over_x)
    towards = way_scr * np.log(left_scr / goal_scr) + way_r * np.log(left_r_over_x / goal_r_over_x)
    step = np.where(towards > 0.0, 0.0, share)
    return goal_scr * np.exp(step * way_scr), goal_r_over_x * np.exp(step * way_r)
