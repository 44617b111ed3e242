"""Whether and how far a schedule follows an estimate: plausibility, jump, hysteresis and the estimate's own error."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.grid import error_half_widths
from vsgdesign.equations.notation import Count
from vsgdesign.equations.scheduler_data import (
    IMPLAUSIBLE,
    JUMP,
    NO_REASON,
    TOLD_CHANGED,
    ScheduleLaw,
    SchedulerInput,
    SchedulerLimits,
    SchedulerState,
    ScheduleTable,
    grid_at,
    place_of,
)

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


OLDEST = 0x7FFFFFFF
"""Largest age, in ticks, that is counted to."""

ROUNDED_CORRELATION = 1.001
"""Largest square of a correlation: that of R and L that belong together fully, after rounding to single precision."""


def finite(x: Any) -> bool:
    """Whether a number is neither infinite nor NaN."""
    return x - x == 0.0


def near(scr: Any, r_over_x: Any, of_scr: Any, of_r_over_x: Any, share: Any, floor: Any) -> bool:
    """Whether a place differs from another by at most a relative share (:eq:`place-band`)."""
    f = 1.0 + share
    band = share * np.maximum(np.abs(of_r_over_x), floor)
    return scr <= of_scr * f and of_scr <= scr * f and np.abs(r_over_x - of_r_over_x) <= band


def drawn_in(scr: Any, r_over_x: Any, limits: SchedulerLimits) -> tuple[Any, Any]:
    """Returns (drawn_scr, drawn_r_over_x): a place, drawn into the certified box."""
    drawn_scr = np.clip(scr, limits.scr_low, limits.scr_high)
    drawn_r_over_x = np.clip(r_over_x, limits.r_over_x_low, limits.r_over_x_high)
    return drawn_scr, drawn_r_over_x


class CheckedInput(NamedTuple):
    """What is left of an update's inputs after the first guards."""

    elapsed: Count
    """Ticks since the last update."""
    step: Count
    """Ticks for which the place may move."""
    reason: Count
    """Why there is no estimate to follow."""
    status: Count
    """REFUSED, CLAMPED or 0."""
    P: Any
    Q: Any
    V_rms: Any
    """What the gains are made for, within the box."""


def estimate_is_finite(given: SchedulerInput) -> bool:
    """Whether every number of an estimate is finite."""
    return (
        finite(given.R_g)
        and finite(given.L_g)
        and (given.has_error == 0 or (finite(given.var_R) and finite(given.cov_RL) and finite(given.var_L)))
    )


def possible_covariance(var_R: Any, cov_RL: Any, var_L: Any) -> bool:
    """Whether finite numbers can be a covariance: no negative variance, no correlation beyond ±1."""
    return var_R >= 0.0 and var_L >= 0.0 and cov_RL * cov_RL <= ROUNDED_CORRELATION * var_R * var_L


def plausible_estimate(limits: SchedulerLimits, given: SchedulerInput) -> bool:
    """Whether an estimate can be one of a grid, and its covariance one of an error."""
    inside = limits.R_g_low <= given.R_g <= limits.R_g_high and limits.L_g_low <= given.L_g <= limits.L_g_high
    return inside and (given.has_error == 0 or possible_covariance(given.var_R, given.cov_RL, given.var_L))


def followed_share(
    table: ScheduleTable, limits: SchedulerLimits, scr: Any, r_over_x: Any, given: SchedulerInput, law: ScheduleLaw
) -> Any:
    """The share of the way to an estimate that its covariance allows (:eq:`share-that-fits`). 1: the whole way.

    The half-widths are those of the error set at the place of the estimate, drawn into the box.
    """
    at_scr, at_r_over_x = drawn_in(scr, r_over_x, limits)
    R, L = grid_at(table, at_scr, at_r_over_x, law)
    h_R, h_X = error_half_widths(R, table.omega * L, limits.error_R, limits.error_X, limits.error_Z)
    return share_that_fits(h_R, h_X, given.var_R, table.omega * table.omega * given.var_L)


class Followed(NamedTuple):
    """What becomes of an estimate: the reason why it is not followed, and the goal."""

    reason: Count
    """Why the estimate is not followed."""
    share: Any
    """How much of the way to the estimate is gone; 1: all of it."""
    goal_scr: Any
    goal_r_over_x: Any
    """The place to which the present place moves."""
    candidate_scr: Any
    candidate_r_over_x: Any
    """A jump that waits to be confirmed, or is followed in part."""
    agreed: Count
    """Windows that agree on the jump."""
    refuted: Count
    """Ticks since the grid has left a place."""


def followed(
    table: ScheduleTable,
    limits: SchedulerLimits,
    s: SchedulerState,
    given: SchedulerInput,
    checked: CheckedInput,
    law: ScheduleLaw,
) -> Followed:
    """Plausibility, jump, hysteresis and the estimate's own error."""
    reason, agreed, share, floor = checked.reason, 0, 1.0, limits.ratio_floor
    goal_scr, goal_r_over_x = s.goal_scr, s.goal_r_over_x
    candidate_scr, candidate_r_over_x = s.candidate_scr, s.candidate_r_over_x
    refuted = np.minimum(s.refuted + checked.elapsed, OLDEST) if s.refuted > 0 else 0
    refuted = 0 if refuted > limits.stale_ticks else refuted
    if reason == NO_REASON and not plausible_estimate(limits, given):
        reason = IMPLAUSIBLE
    if reason != NO_REASON and s.agreed >= limits.confirm:
        # A confirmed jump that is followed in part waits for its next estimate.
        agreed = s.agreed
    if reason == NO_REASON:
        scr, r_over_x = place_of(table, given.R_g, given.L_g, law)
        if given.has_error != 0:
            share = followed_share(table, limits, scr, r_over_x, given, law)
        if not near(scr, r_over_x, goal_scr, goal_r_over_x, limits.jump, floor):
            same = s.agreed > 0 and near(scr, r_over_x, candidate_scr, candidate_r_over_x, limits.jump, floor)
            agreed = np.minimum(s.agreed + 1, limits.confirm) if same else 1
            agreed = limits.confirm if s.told & TOLD_CHANGED != 0 else agreed
            candidate_scr, candidate_r_over_x = scr, r_over_x
            if agreed < limits.confirm:
                reason = JUMP
            elif share >= 1.0:
                agreed = 0
        if reason == NO_REASON and not near(scr, r_over_x, goal_scr, goal_r_over_x, limits.hysteresis, floor):
            if share >= 1.0:
                goal_scr, goal_r_over_x = scr, r_over_x
            else:
                from_scr, from_r = drawn_in(goal_scr, goal_r_over_x, limits)
                to_scr, to_r = drawn_in(scr, r_over_x, limits)
                left_scr, left_r = drawn_in(s.left_scr, s.left_r_over_x, limits)
                if refuted == 0:
                    left_scr, left_r = from_scr, from_r
                goal_scr, goal_r_over_x = part_of_the_way(from_scr, from_r, to_scr, to_r, share, left_scr, left_r)
        if reason == NO_REASON and share >= 1.0:
            refuted = 0
    return Followed(reason, share, goal_scr, goal_r_over_x, candidate_scr, candidate_r_over_x, agreed, refuted)
