"""One update of many schedulers at once: what :func:`vsgdesign.runtime.updating.advance` does, on arrays.

The equations are the same functions. The order of the guards is written twice: there as the C has it, with branches and
for one controller, and here with masks, since an update of one controller takes 30 times as long. A test holds both
together, bit by bit and with every guard.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.following import part_of_the_way, share_that_fits
from vsgdesign.equations.grid import error_half_widths
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.runtime.guards import (
    ARRIVED,
    CLAMPED,
    DOUBT,
    FALLBACK,
    FRESH,
    HELD,
    IMPLAUSIBLE,
    JUMP,
    LIMITED,
    NO_REASON,
    NOT_FINITE,
    PARTLY,
    RANGE,
    REFUSED,
    SATURATED,
    SURPRISED_BEFORE,
    TIME,
    TOLD_CHANGED,
    TOLD_SURPRISED,
    UNDESIGNED,
    SchedulerSettings,
    limited,
    near,
    within,
)
from vsgdesign.runtime.many_lookups import ManyLookups, ManyPlaces
from vsgdesign.runtime.state import SchedulerState
from vsgdesign.runtime.updating import (
    COUNTER_HALF,
    COUNTER_MASK,
    OLDEST,
    ROUNDED_CORRELATION,
)

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


class ManyCovariances(NamedTuple):
    """Covariances of many estimates, (N,) each. Where all three are NaN, the covariance of an estimate is not known."""

    var_R: Array
    """Ω²"""
    cov_RL: Array
    """Ω·H"""
    var_L: Array
    """H²"""


class ManyAnswers(NamedTuple):
    """What an update says: arrays (N,) as in :class:`vsgdesign.runtime.updating.Answer`."""

    gains: PowerLoopGains
    status: Whole
    reason: Whole
    scr: Array
    r_over_x: Array


class ManyInputs(NamedTuple):
    """What an update is given, (N,) each."""

    said: Whole
    R_g: Array
    L_g: Array
    P: Array
    Q: Array
    V_rms: Array
    ticks: Whole
    covariance: ManyCovariances | None


class _Followed(NamedTuple):
    """What becomes of an estimate: the reason why it is not followed, and the goal."""

    reason: Whole
    share: Any
    """1.0, or (N,): how much of the way to the estimate is gone."""
    goal_scr: Array
    goal_r_over_x: Array
    candidate_scr: Array
    candidate_r_over_x: Array
    agreed: Whole
    refuted: Whole


def advance_many(
    many: ManyLookups, c: SchedulerSettings, s: Any, before: ManyPlaces, given: ManyInputs
) -> tuple[SchedulerState, ManyPlaces, ManyAnswers]:
    """One update, in the order of :func:`vsgdesign.runtime.updating.advance`."""
    elapsed = np.where(s.started > 0, (given.ticks - s.ticks) & COUNTER_MASK, 0)
    step = np.minimum(elapsed, c.longest_ticks)
    reason, refused, backwards = _refusals(c, given, elapsed)
    if backwards.any():
        elapsed, step = np.where(backwards, c.update_ticks, elapsed), np.where(backwards, 0, step)

    drawn = within(given.P, *c.P), within(given.Q, *c.Q), within(given.V_rms, *c.V_rms)
    clamped = (drawn[0] != given.P) | (drawn[1] != given.Q) | (drawn[2] != given.V_rms)
    status: Any = np.where(clamped, CLAMPED, 0)
    P, Q, V_rms = drawn
    if refused.any():
        status = np.where(refused, REFUSED, status)
        P, Q, V_rms = np.where(refused, s.P, P), np.where(refused, s.Q, Q), np.where(refused, s.V_rms, V_rms)

    followed = _follow(many, c, s, given, reason, elapsed)
    reason, share, goal_scr, goal_r = followed.reason, followed.share, followed.goal_scr, followed.goal_r_over_x

    held = reason != NO_REASON
    age = np.minimum(s.age + elapsed, OLDEST)
    surprised = s.told & TOLD_SURPRISED
    doubt = np.zeros_like(age)
    stale = held
    if held.any():
        new_surprise = (surprised != 0) & (s.told & SURPRISED_BEFORE == 0)
        begins = held & ((s.told != 0) | (reason == JUMP))
        goes_on = held & (s.doubt > 0) & ~new_surprise
        doubt = np.where(goes_on, np.minimum(s.doubt + elapsed, OLDEST), np.where(begins, 1, 0))
        stale = held & ((age > c.lost_ticks) | (doubt > c.stale_ticks))
        goal_scr, goal_r = np.where(stale, c.safe_scr, goal_scr), np.where(stale, c.safe_r_over_x, goal_r)

    factor = 1.0 + step * c.rate_per_tick
    place_scr = within(limited(goal_scr, s.scr, factor), *c.scr)
    place_r = within(limited(goal_r, s.r_over_x, factor), *c.r_over_x)
    aim_scr, aim_r = within(goal_scr, *c.scr), within(goal_r, *c.r_over_x)
    outside = (aim_scr != goal_scr) | (aim_r != goal_r)
    far = (np.abs(place_scr - aim_scr) > ARRIVED * aim_scr) | (np.abs(place_r - aim_r) > ARRIVED * aim_r)
    status = status | np.where(outside, CLAMPED, 0) | np.where(far, LIMITED, 0)

    places = many.moved(before, place_scr, place_r)
    gains = many.gains(places, P, Q, V_rms)
    if not places.designed.all():
        designed = places.designed
        reason = np.where(~designed & ~held, UNDESIGNED, reason)
        held = reason != NO_REASON
        gains = PowerLoopGains(*(np.where(designed, new, old) for new, old in zip(gains, s.gains, strict=True)))
        place_scr, place_r = np.where(designed, place_scr, s.scr), np.where(designed, place_r, s.r_over_x)
        P, Q, V_rms = (
            np.where(designed, new, old) for new, old in zip((P, Q, V_rms), (s.P, s.Q, s.V_rms), strict=True)
        )
        status = np.where(designed, status, np.where(refused, REFUSED, 0))
        places = many.moved(places, place_scr, place_r)
    partly = np.where(share < 1.0, PARTLY, 0)
    status = (
        status | np.where(stale, FALLBACK, 0) | np.where(doubt > 0, DOUBT, 0) | np.where(held, HELD, FRESH | partly)
    )
    told = np.where(held, s.told & TOLD_CHANGED | np.where(surprised != 0, SURPRISED_BEFORE, 0), 0)
    following: Any = s._replace(
        started=np.ones_like(s.started),
        ticks=np.broadcast_to(given.ticks & COUNTER_MASK, s.ticks.shape),
        age=np.where(held, age, 0),
        doubt=doubt,
        told=told,
        agreed=followed.agreed,
        refuted=followed.refuted,
        scr=place_scr,
        r_over_x=place_r,
        goal_scr=goal_scr,
        goal_r_over_x=goal_r,
        candidate_scr=followed.candidate_scr,
        candidate_r_over_x=followed.candidate_r_over_x,
        P=P,
        Q=Q,
        V_rms=V_rms,
        gains=gains,
    )
    return following, places, ManyAnswers(gains, status, reason, place_scr, place_r)


def _refusals(
    c: SchedulerSettings, given: ManyInputs, elapsed: Whole
) -> tuple[Whole, NDArray[np.bool_], NDArray[np.bool_]]:
    """The reasons so far, which inputs are refused, and where time went backwards."""
    said = given.said
    backwards = elapsed >= COUNTER_HALF
    # A NaN is in no range.
    in_range = (np.abs(given.P) <= c.power_range) & (np.abs(given.Q) <= c.power_range)
    in_range &= (given.V_rms >= 0.0) & (given.V_rms <= c.voltage_range)
    estimated = np.isfinite(given.R_g) & np.isfinite(given.L_g)
    if given.covariance is not None:
        finite = np.isfinite(given.covariance).all(axis=0)
        estimated &= finite | np.isnan(given.covariance).all(axis=0)
    of_estimate = (said == NOT_FINITE) | (said == SATURATED)
    not_finite = (said == NO_REASON) & ~estimated
    refused = backwards | ~in_range | of_estimate | not_finite
    if not refused.any():
        return said, refused, backwards
    measured = np.isfinite(given.P) & np.isfinite(given.Q) & np.isfinite(given.V_rms)
    reasons = [TIME, NOT_FINITE, RANGE, said, NOT_FINITE]
    return np.select([backwards, ~measured, ~in_range, of_estimate, not_finite], reasons, said), refused, backwards


def _follow(
    many: ManyLookups, c: SchedulerSettings, s: Any, given: ManyInputs, reason: Whole, elapsed: Whole
) -> _Followed:
    """Plausibility, jump, hysteresis and the estimate's own error."""
    goal_scr, goal_r = s.goal_scr, s.goal_r_over_x
    candidate_scr, candidate_r = s.candidate_scr, s.candidate_r_over_x
    refuted = s.refuted
    if refuted.any():
        refuted = np.where(refuted > 0, np.minimum(refuted + elapsed, OLDEST), 0)
        refuted = np.where(refuted > c.stale_ticks, 0, refuted)
    plausible = (c.R_g[0] <= given.R_g) & (given.R_g <= c.R_g[1]) & (c.L_g[0] <= given.L_g) & (given.L_g <= c.L_g[1])
    known = None
    if given.covariance is not None:
        var_R, cov_RL, var_L = given.covariance
        known = ~np.isnan(given.covariance).all(axis=0)
        possible = (var_R >= 0.0) & (var_L >= 0.0) & (cov_RL * cov_RL <= ROUNDED_CORRELATION * var_R * var_L)
        plausible &= ~known | possible
    reason = np.where((reason == NO_REASON) & ~plausible, IMPLAUSIBLE, reason)
    accepted = reason == NO_REASON
    # A confirmed jump that is followed in part waits for its next estimate.
    agreed = np.where(~accepted & (s.agreed >= c.confirm), s.agreed, 0)

    scr, r_over_x = many.coordinates(given.R_g, given.L_g)
    share: Any = 1.0
    if known is not None and given.covariance is not None:
        # Nothing follows where an estimate is not accepted, so the share is 1 there.
        share = np.where(known & accepted, _share(many, c, scr, r_over_x, given.covariance), 1.0)
    fully = share >= 1.0
    far = accepted & ~near(scr, r_over_x, goal_scr, goal_r, c.jump, c.ratio_floor)
    if far.any():
        agrees = (s.agreed > 0) & near(scr, r_over_x, candidate_scr, candidate_r, c.jump, c.ratio_floor)
        count = np.where(agrees, np.minimum(s.agreed + 1, c.confirm), 1)
        count = np.where(s.told & TOLD_CHANGED != 0, c.confirm, count)
        candidate_scr, candidate_r = np.where(far, scr, candidate_scr), np.where(far, r_over_x, candidate_r)
        waits = far & (count < c.confirm)
        reason = np.where(waits, JUMP, reason)
        accepted = accepted & ~waits
        agreed = np.where(far, np.where(~waits & fully, 0, count), agreed)
    moves = accepted & ~near(scr, r_over_x, goal_scr, goal_r, c.hysteresis, c.ratio_floor)
    if moves.any():
        at_once, in_part = moves & fully, np.flatnonzero(moves & ~fully)
        present = goal_scr, goal_r
        goal_scr, goal_r = np.where(at_once, scr, goal_scr), np.where(at_once, r_over_x, goal_r)
        if len(in_part):
            goal = within(present[0][in_part], *c.scr), within(present[1][in_part], *c.r_over_x)
            left = within(s.left_scr[in_part], *c.scr), within(s.left_r_over_x[in_part], *c.r_over_x)
            has_left = refuted[in_part] > 0
            left = np.where(has_left, left[0], goal[0]), np.where(has_left, left[1], goal[1])
            to = within(scr[in_part], *c.scr), within(r_over_x[in_part], *c.r_over_x)
            goal_scr[in_part], goal_r[in_part] = part_of_the_way(*goal, *to, share[in_part], *left)
    if refuted.any():
        refuted = np.where(accepted & fully, 0, refuted)
    return _Followed(reason, share, goal_scr, goal_r, candidate_scr, candidate_r, agreed, refuted)


def _share(many: ManyLookups, c: SchedulerSettings, scr: Array, r_over_x: Array, covariance: ManyCovariances) -> Array:
    """As :func:`vsgdesign.runtime.updating.followed_share`."""
    omega = many.lookup.omega
    R, L = many.grid(within(scr, *c.scr), within(r_over_x, *c.r_over_x))
    h_R, h_X = error_half_widths(R, omega * L, *c.error_set)
    return share_that_fits(h_R, h_X, covariance.var_R, omega * omega * covariance.var_L)


def told_many(s: Any, bits: Whole) -> SchedulerState:
    """As :func:`vsgdesign.runtime.updating.told_state`."""
    changed = (bits & ~s.told & TOLD_CHANGED) != 0
    if changed.any():
        s = s._replace(
            refuted=np.where(changed, 1, s.refuted),
            left_scr=np.where(changed, s.goal_scr, s.left_scr),
            left_r_over_x=np.where(changed, s.goal_r_over_x, s.left_r_over_x),
        )
    return s._replace(told=s.told | bits)
