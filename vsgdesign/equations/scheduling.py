"""One update of the gain scheduler, from an estimate to guarded gains with a status: for Python, many lanes and C.

The guards act in this order: time and inputs, plausibility, jump (:eq:`place-band`), hysteresis, the estimate's own
error (:eq:`partly-followed`), doubt and staleness, rate (:eq:`place-rate`), certified box, design.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vsgdesign.equations.estimate_guards import OLDEST, CheckedInput, drawn_in, estimate_is_finite, finite, followed
from vsgdesign.equations.notation import WHOLE, Count
from vsgdesign.equations.scheduler_data import (
    CLAMPED,
    DOUBT,
    FALLBACK,
    FRESH,
    HELD,
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
    ScheduleLaw,
    SchedulerInput,
    SchedulerLimits,
    SchedulerState,
    ScheduleTable,
    gains_at,
    place_of,
)

HALF_RANGE = 0x80000000
"""A difference of the 32-bit counter of half its range means that time went backwards."""

ARRIVED = 1e-5
"""Relative distance within which a place has reached its goal. A distance this small is rounding alone."""


def limited(goal: Any, present: Any, factor: Any) -> Any:
    """The goal, limited to at most a factor away from the present value (:eq:`place-rate`)."""
    return np.clip(goal, present / factor, present * factor)


def checked_input(limits: SchedulerLimits, s: SchedulerState, given: SchedulerInput) -> CheckedInput:
    """Time and inputs: a measurement that is refused is replaced by the last good one."""
    P, Q, V_rms, said = given.P, given.Q, given.V_rms, given.said
    elapsed = (given.ticks - s.ticks) & WHOLE if s.started != 0 else 0
    step, reason, status = np.minimum(elapsed, limits.longest_ticks), said, 0
    backwards = elapsed >= HALF_RANGE
    numbers = finite(P) and finite(Q) and finite(V_rms)
    powers = np.abs(P) <= limits.power_range and np.abs(Q) <= limits.power_range
    in_range = powers and V_rms >= 0.0 and V_rms <= limits.voltage_range
    no_number, saturated = said == NOT_FINITE, said == SATURATED
    spoilt = said == NO_REASON and not estimate_is_finite(given)
    if backwards:
        elapsed, step, reason, status = limits.update_ticks, 0, TIME, REFUSED
    elif not numbers:
        reason, status = NOT_FINITE, REFUSED
    elif not in_range:
        reason, status = RANGE, REFUSED
    elif no_number or saturated:
        status = REFUSED
    elif spoilt:
        reason, status = NOT_FINITE, REFUSED

    if status == REFUSED:
        P, Q, V_rms = s.P, s.Q, s.V_rms
    else:
        P = np.clip(P, limits.P_low, limits.P_high)
        Q = np.clip(Q, limits.Q_low, limits.Q_high)
        V_rms = np.clip(V_rms, limits.V_low, limits.V_high)
        status = CLAMPED if P != given.P or Q != given.Q or V_rms != given.V_rms else 0
    return CheckedInput(elapsed, step, reason, status, P, Q, V_rms)


def doubt_after(s: SchedulerState, reason: Count, elapsed: Count) -> Count:
    """Ticks of doubt: they begin with a surprise, and anew with a new one."""
    doubt, surprised = 0, s.told & TOLD_SURPRISED != 0
    if reason != NO_REASON and s.doubt > 0 and not (surprised and s.told & SURPRISED_BEFORE == 0):
        doubt = np.minimum(s.doubt + elapsed, OLDEST)
    elif reason != NO_REASON and (s.told != 0 or reason == JUMP):
        doubt = 1
    return doubt


def updated(
    table: ScheduleTable, limits: SchedulerLimits, s: SchedulerState, given: SchedulerInput, law: ScheduleLaw
) -> tuple[SchedulerState, Count, Count]:
    """Makes one update. Returns (following, status, reason).

    Whatever the inputs are, the gains are those of a place and of powers within the box.
    """
    checked = checked_input(limits, s, given)
    found = followed(table, limits, s, given, checked, law)
    reason, status, goal_scr, goal_r_over_x = found.reason, checked.status, found.goal_scr, found.goal_r_over_x

    age = np.minimum(s.age + checked.elapsed, OLDEST)
    doubt = doubt_after(s, reason, checked.elapsed)
    stale = reason != NO_REASON and (age > limits.lost_ticks or doubt > limits.stale_ticks)
    if stale:
        goal_scr, goal_r_over_x = limits.safe_scr, limits.safe_r_over_x

    factor = 1.0 + checked.step * limits.rate_per_tick
    moved_scr, moved_r = limited(goal_scr, s.scr, factor), limited(goal_r_over_x, s.r_over_x, factor)
    scr, r_over_x = drawn_in(moved_scr, moved_r, limits)
    aim_scr, aim_r = drawn_in(goal_scr, goal_r_over_x, limits)
    clamped = CLAMPED if aim_scr != goal_scr or aim_r != goal_r_over_x else 0
    far = np.abs(scr - aim_scr) > ARRIVED * aim_scr or np.abs(r_over_x - aim_r) > ARRIVED * aim_r
    moving = clamped | LIMITED if far else clamped

    P, Q, V_rms = checked.P, checked.Q, checked.V_rms
    normalised, designed = law.normalised(table, scr, r_over_x)
    if designed == 0:
        reason = UNDESIGNED if reason == NO_REASON else reason
        status = status & REFUSED
        gains, scr, r_over_x, P, Q, V_rms = s.gains, s.scr, s.r_over_x, s.P, s.Q, s.V_rms
    else:
        status = status | moving
        gains = gains_at(table, normalised, scr, r_over_x, P, Q, V_rms, law)

    status = status | FALLBACK if stale else status
    status = status | DOUBT if doubt > 0 else status
    if reason == NO_REASON:
        status = status | FRESH | PARTLY if found.share < 1.0 else status | FRESH
        age, told = 0, 0
    else:
        status = status | HELD
        before = SURPRISED_BEFORE if s.told & TOLD_SURPRISED != 0 else 0
        told = s.told & TOLD_CHANGED | before
    following = SchedulerState(
        started=1,
        ticks=given.ticks,
        age=age,
        doubt=doubt,
        told=told,
        agreed=found.agreed,
        refuted=found.refuted,
        scr=scr,
        r_over_x=r_over_x,
        goal_scr=goal_scr,
        goal_r_over_x=goal_r_over_x,
        candidate_scr=found.candidate_scr,
        candidate_r_over_x=found.candidate_r_over_x,
        left_scr=s.left_scr,
        left_r_over_x=s.left_r_over_x,
        P=P,
        Q=Q,
        V_rms=V_rms,
        gains=gains,
    )
    return following, status, reason


def told_state(s: SchedulerState, told: Count) -> SchedulerState:
    """The state that was told something: bits of TOLD_LIMITED, TOLD_SURPRISED and TOLD_CHANGED. Returns (following).

    With TOLD_CHANGED, the goal of this moment is the place that the grid has left.
    """
    changed = told & TOLD_CHANGED != 0 and s.told & TOLD_CHANGED == 0
    return s._replace(
        told=s.told | told,
        refuted=1 if changed else s.refuted,
        left_scr=s.goal_scr if changed else s.left_scr,
        left_r_over_x=s.goal_r_over_x if changed else s.left_r_over_x,
    )


def state_at(
    table: ScheduleTable, limits: SchedulerLimits, scr: Any, r_over_x: Any, age: Count, law: ScheduleLaw
) -> SchedulerState:
    """The state at a place with a design, without load, before any update. Returns (first)."""
    P = np.clip(0.0, limits.P_low, limits.P_high)
    Q = np.clip(0.0, limits.Q_low, limits.Q_high)
    V_rms = np.clip(table.V_n, limits.V_low, limits.V_high)
    normalised, _ = law.normalised(table, scr, r_over_x)
    gains = gains_at(table, normalised, scr, r_over_x, P, Q, V_rms, law)
    return SchedulerState(
        started=0,
        ticks=0,
        age=age,
        doubt=0,
        told=0,
        agreed=0,
        refuted=0,
        scr=scr,
        r_over_x=r_over_x,
        goal_scr=scr,
        goal_r_over_x=r_over_x,
        candidate_scr=limits.safe_scr,
        candidate_r_over_x=limits.safe_r_over_x,
        left_scr=limits.safe_scr,
        left_r_over_x=limits.safe_r_over_x,
        P=P,
        Q=Q,
        V_rms=V_rms,
        gains=gains,
    )


def start_place(
    table: ScheduleTable, limits: SchedulerLimits, R_g: Any, L_g: Any, nearest: bool, law: ScheduleLaw
) -> tuple[Any, Any, Count]:
    """Returns (scr, r_over_x, known) of a grid on which a scheduler is to begin.

    known is 0 where the grid is not in the box: the place is then the safe one. With nearest, a grid outside the box is
    taken for the nearest place in it.
    """
    scr, r_over_x, known = limits.safe_scr, limits.safe_r_over_x, 0
    if finite(R_g + L_g) and L_g > 0.0:
        at_scr, at_r = place_of(table, R_g, L_g, law)
        if nearest:
            at_scr, at_r = drawn_in(at_scr, at_r, limits)
        inside = limits.scr_low <= at_scr <= limits.scr_high and limits.r_over_x_low <= at_r <= limits.r_over_x_high
        _, designed = law.normalised(table, at_scr, at_r)
        if inside and designed != 0:
            scr, r_over_x, known = at_scr, at_r, 1
    return scr, r_over_x, known


def begun(
    table: ScheduleTable, limits: SchedulerLimits, R_g: Any, L_g: Any, nearest: bool, law: ScheduleLaw
) -> tuple[SchedulerState, Count]:
    """Begins on a grid (:func:`start_place`), or stale at the safe place. Returns (first, known)."""
    scr, r_over_x, known = start_place(table, limits, R_g, L_g, nearest, law)
    age = 0 if known != 0 else limits.lost_ticks + 1
    first = state_at(table, limits, scr, r_over_x, age, law)
    return first, known


def told_and_updated(
    table: ScheduleTable,
    limits: SchedulerLimits,
    s: SchedulerState,
    told: Count,
    given: SchedulerInput,
    law: ScheduleLaw,
) -> tuple[SchedulerState, Count, Count]:
    """One update after the scheduler was told something. Returns (following, status, reason)."""
    s = told_state(s, told)
    return updated(table, limits, s, given, law)
