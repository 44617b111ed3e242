"""The schedulers of many converters at once: what :func:`vsgdesign.runtime.updating.advance` does, on arrays.

The equations are the same functions. The order of the guards is written twice: there as the C has it, with branches and
for one controller, and here with masks, since an update of one controller takes 30 times as long. A test holds both
together, bit by bit and with every guard.
"""

from __future__ import annotations

from copy import copy
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
    NO_ESTIMATE,
    NO_REASON,
    NOT_FINITE,
    PARTLY,
    RANGE,
    REFUSED,
    SATURATED,
    SURPRISED_BEFORE,
    TIME,
    TOLD_CHANGED,
    TOLD_LIMITED,
    TOLD_SURPRISED,
    UNDESIGNED,
    SchedulerSettings,
    limited,
    near,
    within,
)
from vsgdesign.runtime.lookup import GainLookup
from vsgdesign.runtime.many_lookups import ManyLookups, ManyPlaces, everywhere, taken, with_lanes
from vsgdesign.runtime.state import SchedulerState
from vsgdesign.runtime.updating import (
    COUNTER_HALF,
    COUNTER_MASK,
    OLDEST,
    ROUNDED_CORRELATION,
    first_state,
)

Array = NDArray[np.float64]
Whole = NDArray[np.int64]
Lanes = NDArray[np.int64] | None


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


class ManySchedulers:
    """``count`` schedulers with one lookup and one set of settings, as arrays of ``count`` lanes.

    Each lane has the bits of a :class:`vsgdesign.runtime.scheduler.Scheduler` of its own. An object has a state, so it
    serves one set of runs at a time.
    """

    def __init__(self, lookup: GainLookup, settings: SchedulerSettings, count: int) -> None:
        self._many, self._settings, self._count = ManyLookups(lookup), settings, count
        self.answers: ManyAnswers | None = None
        """The last answers; None before the first update."""
        first = first_state(lookup, settings)
        self._state: Any = everywhere(first, count)
        self._places = self._many.places(self._state.scr, self._state.r_over_x)

    def __len__(self) -> int:
        return self._count

    @property
    def gains(self) -> PowerLoopGains:
        """The present gains, arrays of ``count``."""
        return self._state.gains

    @property
    def grid(self) -> tuple[Array, Array]:
        """R_g (Ω) and L_g (H) of the places for which the present gains are made."""
        return self._many.grid(self._state.scr, self._state.r_over_x)

    @property
    def state(self) -> SchedulerState:
        """The state, with an array of ``count`` in each field."""
        return self._state

    def start(self, R_g: Array, L_g: Array, *, nearest: bool = False) -> NDArray[np.bool_]:
        """Starts on known grids. Returns which of them are in the box; the others start at the safe place. With
        ``nearest``, a grid outside the box is taken for the nearest place in it."""
        c, many = self._settings, self._many
        first = first_state(many.lookup, c)
        with np.errstate(all="ignore"):
            usable = (L_g > 0.0) & np.isfinite(R_g + L_g)
            scr, r_over_x = many.coordinates(np.where(usable, R_g, 1.0), np.where(usable, L_g, 1.0))
            if nearest:
                scr, r_over_x = np.clip(scr, *c.scr), np.clip(r_over_x, *c.r_over_x)
            inside = usable & (c.scr[0] <= scr) & (scr <= c.scr[1])
            inside &= (c.r_over_x[0] <= r_over_x) & (r_over_x <= c.r_over_x[1])
            inside &= many.places(scr, r_over_x).designed
        blank: Any = everywhere(first, self._count)
        scr, r_over_x = np.where(inside, scr, first.scr), np.where(inside, r_over_x, first.r_over_x)
        places = many.places(scr, r_over_x)
        self._places = places
        self._state = blank._replace(
            scr=scr,
            r_over_x=r_over_x,
            goal_scr=scr,
            goal_r_over_x=r_over_x,
            age=np.where(inside, 0, blank.age),
            gains=many.gains(places, blank.P, blank.Q, blank.V_rms),
        )
        return inside

    def take(self, chosen: NDArray[Any]) -> ManySchedulers:
        """Schedulers of their own with the state of some of these, by index or by mask."""
        some = copy(self)
        some._state, some._places, some.answers = taken(self._state, chosen), taken(self._places, chosen), None
        some._count = len(some._state.scr)
        return some

    def tell(self, *, limited: Any = False, surprised: Any = False, changed: Any = False, lanes: Lanes = None) -> None:
        """Says what happened since the last update, as :meth:`vsgdesign.runtime.scheduler.Scheduler.tell`."""
        count = self._count if lanes is None else len(lanes)
        bits = (
            TOLD_LIMITED * _flags(limited, count)
            | TOLD_SURPRISED * _flags(surprised, count)
            | TOLD_CHANGED * _flags(changed, count)
        )
        if not bits.any():
            return
        state = self._state if lanes is None else taken(self._state, lanes)
        self._put(lanes, _told(state, bits), None)

    def update(  # noqa: PLR0913 - those of a scheduler
        self,
        R_g: Array,
        L_g: Array,
        P: Array,
        Q: Array,
        V_rms: Array,
        ticks: Any,
        *,
        limited: Any = False,
        surprised: Any = False,
        changed: Any = False,
        said: Whole | None = None,
        covariance: ManyCovariances | None = None,
        lanes: Lanes = None,
    ) -> PowerLoopGains:
        """One update of every lane. Returns the gains; status and reason are in ``answers``.

        A NaN in R_g (Ω) or L_g (H) means that a lane has no estimate and holds its place. All other arguments are as in
        :meth:`vsgdesign.runtime.scheduler.Scheduler.update_estimate`, as arrays or one value for all. ``said`` are the
        reasons why there is no estimate (NO_REASON: there is one). With ``lanes`` only these are updated, and arguments
        and result are those of these lanes.
        """
        self.tell(limited=limited, surprised=surprised, changed=changed, lanes=lanes)
        if said is None:
            said = np.where(np.isnan(R_g) | np.isnan(L_g), NO_ESTIMATE, NO_REASON)
        state = self._state if lanes is None else taken(self._state, lanes)
        places = self._places if lanes is None else taken(self._places, lanes)
        inputs = _Inputs(said, R_g, L_g, P, Q, V_rms, np.asarray(ticks), covariance)
        with np.errstate(all="ignore"):
            state, places, answers = _advance(self._many, self._settings, state, places, inputs)
        self._put(lanes, state, places)
        self.answers = answers
        return answers.gains

    def _put(self, lanes: Lanes, state: SchedulerState, places: ManyPlaces | None) -> None:
        if lanes is None:
            self._state, self._places = state, self._places if places is None else places
            return
        self._state = with_lanes(self._state, state, lanes)
        if places is not None:
            self._places = with_lanes(self._places, places, lanes)


class _Inputs(NamedTuple):
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


def _advance(
    many: ManyLookups, c: SchedulerSettings, s: Any, before: ManyPlaces, given: _Inputs
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
    c: SchedulerSettings, given: _Inputs, elapsed: Whole
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
    many: ManyLookups, c: SchedulerSettings, s: Any, given: _Inputs, reason: Whole, elapsed: Whole
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


def _told(s: Any, bits: Whole) -> SchedulerState:
    """As :func:`vsgdesign.runtime.updating.told_state`."""
    changed = (bits & ~s.told & TOLD_CHANGED) != 0
    if changed.any():
        s = s._replace(
            refuted=np.where(changed, 1, s.refuted),
            left_scr=np.where(changed, s.goal_scr, s.left_scr),
            left_r_over_x=np.where(changed, s.goal_r_over_x, s.left_r_over_x),
        )
    return s._replace(told=s.told | bits)


def _flags(values: Any, count: int) -> Whole:
    return np.broadcast_to(np.asarray(values, dtype=bool), (count,)).astype(np.int64)
