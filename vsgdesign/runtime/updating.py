"""One update of the scheduler: from an estimate to guarded gains with a status, as a function of the state.

The exported C does the same, line by line.
"""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

from vsgdesign.equations.following import part_of_the_way, share_that_fits
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import ArtifactError
from vsgdesign.runtime.floats import on_floats
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
    REASONS,
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
from vsgdesign.runtime.lookup import GainLookup
from vsgdesign.runtime.state import SchedulerState

COUNTER_MASK, COUNTER_HALF = 0xFFFFFFFF, 0x80000000
"""The caller's counter of ticks has 32 bits; a difference of half its range means that time went backwards."""

OLDEST = 0x7FFFFFFF
"""Largest age, in ticks, that is counted to."""

_share_that_fits = on_floats(share_that_fits)
_part_of_the_way = on_floats(part_of_the_way)
_near, _limited, _drawn = on_floats(near), on_floats(limited), on_floats(within)

Covariance = tuple[float, float, float]
"""var R_g (Ω²), cov(R_g, L_g) (Ω·H) and var L_g (H²)."""

ROUNDED_CORRELATION = 1.001
"""Largest square of a correlation: that of R and L that belong together fully, after rounding to single precision."""


class Answer(NamedTuple):
    """The gains from now on, with the status bits and the reason of :mod:`vsgdesign.runtime.guards`."""

    gains: PowerLoopGains
    status: int
    reason: int
    scr: float
    """The place for which the gains are made."""
    r_over_x: float

    @property
    def why(self) -> str:
        """The reason in words. It is empty if no guard refused the estimate."""
        return REASONS[self.reason]


def first_state(lookup: GainLookup, settings: SchedulerSettings) -> SchedulerState:
    """The first state: at the safe place, without load, and without an estimate so far.

    Raises ArtifactError if the table has no design at the safe place.
    """
    scr, r_over_x, V_rms = settings.safe_scr, settings.safe_r_over_x, lookup.V_n_rms
    P, Q, V_rms = _within(0.0, *settings.P), _within(0.0, *settings.Q), _within(V_rms, *settings.V_rms)
    normalised = lookup.normalised(scr, r_over_x)
    if normalised is None:
        raise ArtifactError(
            f"safe place SCR {scr:g}, R/X {r_over_x:g}: the table has no design there. Give another (safe_scr, "
            "safe_r_over_x) on the strong side."
        )
    gains = lookup.gains(normalised, scr, r_over_x, P, Q, V_rms)
    age = settings.lost_ticks + 1
    place = scr, r_over_x
    return SchedulerState(0, 0, age, 0, 0, 0, 0, *place, *place, *place, *place, P, Q, V_rms, gains)


def told_state(s: SchedulerState, told: int) -> SchedulerState:
    """The state that was told something: bits of TOLD_LIMITED, TOLD_SURPRISED and TOLD_CHANGED.

    With TOLD_CHANGED, the goal of this moment is the place that the grid has left.
    """
    if not told & ~s.told:
        return s
    if told & ~s.told & TOLD_CHANGED:
        s = s._replace(refuted=1, left_scr=s.goal_scr, left_r_over_x=s.goal_r_over_x)
    return s._replace(told=s.told | told)


def followed_share(
    lookup: GainLookup, c: SchedulerSettings, scr: float, r_over_x: float, covariance: Covariance
) -> float:
    """The share of the way to an estimate that its covariance allows (:eq:`share-that-fits`). 1: the whole way.

    The half-widths are those of the error set at the place of the estimate, drawn into the box.
    """
    R, L = lookup.grid(*drawn_in(scr, r_over_x, c))
    h_R, h_X = c.error_set.half_widths(R, lookup.omega * L)
    return _share_that_fits(h_R, h_X, covariance[0], lookup.omega * lookup.omega * covariance[2])


def advance(
    lookup: GainLookup,
    c: SchedulerSettings,
    s: SchedulerState,
    said: int,
    R_g: float,
    L_g: float,
    P: float,
    Q: float,
    V_rms: float,
    ticks: int,
    covariance: Covariance | None = None,
) -> tuple[SchedulerState, Answer]:
    """Makes one update. Returns the next state and the answer.

    ``said`` is the reason why there is no estimate, or NO_REASON if R_g (Ω) and L_g (H) are an estimate. P (W), Q (var)
    and V (phase rms, V) are those of the power loops. ``ticks`` is the caller's 32-bit counter. ``covariance`` is that
    of the estimate, None if it is not known. The guards act in this order: time and inputs, plausibility, jump
    (:eq:`place-band`), hysteresis, the estimate's own error (:eq:`partly-followed`), doubt and staleness, rate
    (:eq:`place-rate`), certified box, design. Whatever the inputs are, the gains are those of a place and of powers
    within the box.
    """
    status, reason = 0, said
    elapsed = (ticks - s.ticks) & COUNTER_MASK if s.started else 0
    step = min(elapsed, c.longest_ticks)
    if elapsed >= COUNTER_HALF:
        elapsed, step, status, reason = c.update_ticks, 0, REFUSED, TIME
    elif not (isfinite(P) and isfinite(Q) and isfinite(V_rms)):
        status, reason = REFUSED, NOT_FINITE
    elif not (abs(P) <= c.power_range and abs(Q) <= c.power_range and 0.0 <= V_rms <= c.voltage_range):
        status, reason = REFUSED, RANGE
    elif said in (NOT_FINITE, SATURATED):
        status = REFUSED
    elif said == NO_REASON and not all(map(isfinite, (R_g, L_g, *(covariance or ())))):
        status, reason = REFUSED, NOT_FINITE

    if status:
        P, Q, V_rms = s.P, s.Q, s.V_rms
    else:
        asked = P, Q, V_rms
        P, Q, V_rms = _within(P, *c.P), _within(Q, *c.Q), _within(V_rms, *c.V_rms)
        status = 0 if (P, Q, V_rms) == asked else CLAMPED

    goal_scr, goal_r, count, share = s.goal_scr, s.goal_r_over_x, 0, 1.0
    refuted = min(s.refuted + elapsed, OLDEST) if s.refuted > 0 else 0
    refuted = 0 if refuted > c.stale_ticks else refuted
    candidate_scr, candidate_r = s.candidate_scr, s.candidate_r_over_x
    if reason == NO_REASON and not (c.R_g[0] <= R_g <= c.R_g[1] and c.L_g[0] <= L_g <= c.L_g[1]):
        reason = IMPLAUSIBLE
    if reason == NO_REASON and covariance is not None and not possible(covariance):
        reason = IMPLAUSIBLE
    if reason != NO_REASON and s.agreed >= c.confirm:
        count = s.agreed  # a confirmed jump that is followed in part waits for its next estimate
    if reason == NO_REASON:
        scr, r_over_x = lookup.coordinates(R_g, L_g)
        if covariance is not None:
            share = followed_share(lookup, c, scr, r_over_x, covariance)
        if not _near(scr, r_over_x, goal_scr, goal_r, c.jump, c.ratio_floor):
            agrees = s.agreed > 0 and _near(scr, r_over_x, candidate_scr, candidate_r, c.jump, c.ratio_floor)
            count = min(s.agreed + 1, c.confirm) if agrees else 1
            if s.told & TOLD_CHANGED:
                count = c.confirm
            candidate_scr, candidate_r = scr, r_over_x
            if count < c.confirm:
                reason = JUMP
            elif share >= 1.0:
                count = 0
        if reason == NO_REASON and not _near(scr, r_over_x, goal_scr, goal_r, c.hysteresis, c.ratio_floor):
            if share >= 1.0:
                goal_scr, goal_r = scr, r_over_x
            else:
                goal = drawn_in(goal_scr, goal_r, c)
                left = drawn_in(s.left_scr, s.left_r_over_x, c) if refuted > 0 else goal
                goal_scr, goal_r = _part_of_the_way(*goal, *drawn_in(scr, r_over_x, c), share, *left)
        if reason == NO_REASON and share >= 1.0:
            refuted = 0

    age = min(s.age + elapsed, OLDEST)
    doubt, surprised = 0, s.told & TOLD_SURPRISED
    if reason != NO_REASON and s.doubt > 0 and not (surprised and not s.told & SURPRISED_BEFORE):
        doubt = min(s.doubt + elapsed, OLDEST)
    elif reason != NO_REASON and (s.told != 0 or reason == JUMP):
        doubt = 1
    stale = reason != NO_REASON and (age > c.lost_ticks or doubt > c.stale_ticks)
    if stale:
        goal_scr, goal_r = c.safe_scr, c.safe_r_over_x

    factor = 1.0 + step * c.rate_per_tick
    scr, r_over_x = _limited(goal_scr, s.scr, factor), _limited(goal_r, s.r_over_x, factor)
    (place_scr, place_r), (aim_scr, aim_r) = drawn_in(scr, r_over_x, c), drawn_in(goal_scr, goal_r, c)
    moving = CLAMPED if aim_scr != goal_scr or aim_r != goal_r else 0
    if abs(place_scr - aim_scr) > ARRIVED * aim_scr or abs(place_r - aim_r) > ARRIVED * aim_r:
        moving |= LIMITED

    normalised = lookup.normalised(place_scr, place_r)
    refused = status & REFUSED
    if normalised is None:
        reason = UNDESIGNED if reason == NO_REASON else reason
        gains, place_scr, place_r, P, Q, V_rms = s.gains, s.scr, s.r_over_x, s.P, s.Q, s.V_rms
        status = refused
    else:
        gains = lookup.gains(normalised, place_scr, place_r, P, Q, V_rms)
        status |= moving
    status |= FALLBACK if stale else 0
    status |= DOUBT if doubt else 0
    if reason == NO_REASON:
        status, age, told = status | FRESH | (PARTLY if share < 1.0 else 0), 0, 0
    else:
        status, told = status | HELD, s.told & TOLD_CHANGED | (SURPRISED_BEFORE if surprised else 0)
    following = SchedulerState(
        1,
        ticks & COUNTER_MASK,
        age,
        doubt,
        told,
        count,
        refuted,
        place_scr,
        place_r,
        goal_scr,
        goal_r,
        candidate_scr,
        candidate_r,
        s.left_scr,
        s.left_r_over_x,
        P,
        Q,
        V_rms,
        gains,
    )
    return following, Answer(gains, status, reason, place_scr, place_r)


def possible(covariance: Covariance) -> bool:
    """Whether three finite numbers can be a covariance: no negative variance, no correlation beyond ±1."""
    var_R, cov_RL, var_L = covariance
    return var_R >= 0.0 and var_L >= 0.0 and cov_RL * cov_RL <= ROUNDED_CORRELATION * var_R * var_L


def _within(value: float, low: float, high: float) -> float:
    """As :func:`vsgdesign.runtime.guards.within`, which is called where it changes anything."""
    return value if low <= value <= high else _drawn(value, low, high)


def drawn_in(scr: float, r_over_x: float, c: SchedulerSettings) -> tuple[float, float]:
    """A place, drawn into the certified box."""
    return _within(scr, *c.scr), _within(r_over_x, *c.r_over_x)
