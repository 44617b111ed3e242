"""Whether a converter survived a disturbance: one judge for every page, study and measurement.

A converter survives if, in time, it is at the new rest and stays there, has not slipped by a turn and has not latched
in its current limit (docs/survival.md). The judge sees arrays alone, so it serves a simulation, another tool's
simulation and a measurement alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.step_response import SETTLING_BAND, cycle_mean, settling_time, unwrapped

Array = NDArray[np.float64]

SURVIVED = "survived"
NOT_AT_REST = "not at rest"
SLIPPED = "slipped"
LATCHED = "latched"
DIVERGED = "diverged"
TRIPPED = "tripped"
BLOCKED = "blocked"
NOT_KNOWN = "not known"
NO_REST = "no rest"
OVER_LIMIT = "rest over limit"
STATUSES = (SURVIVED, NOT_AT_REST, SLIPPED, LATCHED, DIVERGED, TRIPPED, NOT_KNOWN, NO_REST, OVER_LIMIT, BLOCKED)
"""All results of the judge. The first six and the last are verdicts. The other three say why there is none."""

VERDICTS = (*STATUSES[:6], BLOCKED)

SETTLING_TIMES, GRACE_S = 2.0, 0.2
"""The new rest must be reached within SETTLING_TIMES · T + GRACE_S after the clearing."""

FIRST_S = 5e-3
"""The current in the first 5 ms of an event is judged apart, because no sampled loop can act at once."""

REST_SHARE = 0.9
"""Largest current of a rest that a converter is asked to reach, as a share of its limit."""

WATCHED = 0.25
"""How long the rest is watched after the deadline, as a share of the settling time."""

SAME_ROW = 1e-6
"""Share of a step by which a row may lie before an event and still be after it. With more, the angle of this row would
be that before a jump of the phase, from which a turn looks like a slip."""

_EITHER_WAY = math.radians(20.0)
"""An event that leaves the angle this near to the unstable equilibrium between two rests may go either way round."""

END_S = 0.3
"""The last part of a record, in which a latched limiter shows."""

LATCHED_SHARE = 0.5

HARDWARE_PU = 2.0
"""Current later than FIRST_S after an event, pu of the rated peak, that no hardware of this rating is taken to carry.
Semiconductors carry twice their rated current for a millisecond; that they are rated as the converter is, is our
choice."""


@dataclass(frozen=True, kw_only=True)
class SurvivalRecord:
    """What is known of a run: arrays of the same length (n), equally spaced in time.

    A run that diverged ends where it did, with ``diverged`` set. A value that is no number counts as a divergence.
    """

    t_s: Array
    P: Array
    """Active power at the point at which the rest is known, W."""
    Q: Array
    """Reactive power there, var."""
    delta: Array
    """Angle of the converter's frame against the grid source, rad, wrapped or not. It turns by less than half a turn
    between two rows, except by a phase jump."""
    i_s_pu: Array
    """Length of the converter's current vector over the rated peak."""
    limited: Array
    """Share of the samples since the row before in which the current limiter acted, 0 to 1."""
    diverged: bool = False

    @cached_property
    def finite_rows(self) -> int:
        """How many rows come before the first that holds anything but numbers."""
        columns = (self.P, self.Q, self.delta, self.i_s_pu, self.limited)
        # A sum is finite only if every number is. One of large numbers may overflow, so it proves nothing else.
        with np.errstate(all="ignore"):
            if all(math.isfinite(float(np.sum(column))) for column in columns):
                return len(self.t_s)
        bad = ~np.isfinite(np.column_stack(columns)).all(axis=1)
        return int(np.argmax(bad)) if bad.any() else len(self.t_s)


@dataclass(frozen=True, kw_only=True)
class ExpectedRest:
    """The steady state to which a disturbance leads, computed from a model and not from the record."""

    P: float
    """W."""
    Q: float
    """var."""
    delta: float
    """rad."""
    i_s_pu: float
    """Converter current with the current of the filter capacitor, over the rated peak."""
    obstacle: str | None = None
    """Why there is no such state; None if there is one. The numbers are then NaN."""

    @classmethod
    def none(cls, obstacle: str) -> ExpectedRest:
        """No steady state, with its reason in words."""
        return cls(P=math.nan, Q=math.nan, delta=math.nan, i_s_pu=math.nan, obstacle=obstacle)

    def refused(self, i_max_pu: float | None) -> tuple[str, str] | None:
        """(status, reason) if no converter is asked to reach this rest: NO_REST or OVER_LIMIT. None if one is.

        ``i_max_pu``: limit of the converter's current, None without a limit.
        """
        if self.obstacle is not None:
            return NO_REST, self.obstacle
        if not all(map(math.isfinite, (self.P, self.Q, self.delta, self.i_s_pu))):
            return NO_REST, "the rest is not known: one of its values is no number"
        if i_max_pu is not None and self.i_s_pu > REST_SHARE * i_max_pu:
            return OVER_LIMIT, (
                f"the rest needs {self.i_s_pu:.3g} pu, more than {100.0 * REST_SHARE:.0f} % of the limit of "
                f"{i_max_pu:.3g} pu"
            )
        return None


@dataclass(frozen=True, kw_only=True)
class SurvivalDemand:
    """What is asked of a converter."""

    S_rated: float
    """VA. The band is a share of it, for P and for Q."""
    settling_time: float
    """T of the specification, s."""
    cycle_s: float
    """Period of the grid at the end, s: P and Q are judged by their means over it."""
    i_max_pu: float | None
    """Limit of the converter's current, pu of the rated peak; None without a limit."""
    settling_times: float = SETTLING_TIMES
    """The deadline is this many T, and ``grace_s``, after the clearing."""
    grace_s: float = GRACE_S
    band: float = SETTLING_BAND
    """How far the means of P and Q may be from the rest, as a share of S_rated."""
    share_inside: float = 1.0
    """From the deadline on, at least this share of the means must be inside the band. In a grid whose voltage and
    frequency wander, a converter at rest leaves any band now and then."""

    @property
    def deadline_s(self) -> float:
        """Time from the clearing until the converter must be at rest, s."""
        return self.settling_times * self.settling_time + self.grace_s

    @property
    def needed_s(self) -> float:
        """Length of the record from the clearing on that the judge needs, s."""
        return self.deadline_s + WATCHED * self.settling_time


@dataclass(frozen=True, kw_only=True)
class Survival:
    """The verdict on one record. A figure is None where there is none."""

    status: str
    """One of STATUSES."""
    reason: str | None = None
    """Why it did not survive, why there is no verdict, or what is remarkable of a run that survived; else None."""
    recovery_s: float | None = None
    """Time from the clearing until P and Q stay at the new rest, s; None if they are not there at the end."""
    peak_pu: float | None = None
    """Largest length of the converter current's vector later than 5 ms after each event, pu of the rated peak."""
    first_peak_pu: float | None = None
    """The same within 5 ms of an event."""
    limited_s: float | None = None
    """Time for which the limiter acted after the first event, s."""
    limited_at_end: float | None = None
    """Share of the last 0.3 s in which the limiter acted, 0 to 1."""
    swing_rad: float | None = None
    """Largest distance of the angle from the nearest rest that each event leaves it, rad."""

    @property
    def survived(self) -> bool:
        """Whether the converter survived."""
        return self.status == SURVIVED

    @property
    def beyond_hardware(self) -> bool:
        """Whether the current is more than hardware carries (HARDWARE_PU), whatever the verdict is."""
        return self.peak_pu is not None and self.peak_pu > HARDWARE_PU

    @property
    def judged(self) -> bool:
        """Whether there is a verdict at all."""
        return self.status in VERDICTS


def judge_survival(
    record: SurvivalRecord, events_s: Sequence[float], cleared_s: float, rest: ExpectedRest, demand: SurvivalDemand
) -> Survival:
    """The verdict on a record.

    ``events_s``: the instants of all sudden changes in ascending order, the end of a fault among them. ``cleared_s``:
    when the last disturbance was over, at or after the last event. Times are those of the record.

    The converter survived if the means of P and Q over a cycle stay within the band (2 % of S_rated) of the rest from
    the deadline on, if the angle was never further than one turn from its rest and did not come to rest a turn further
    on, and if the limiter does not hold it. "Its rest" is the one nearest to the angle right after each event. Between
    two rests δ and δ + 2π lies an unstable equilibrium, at π − δ on an inductive grid. Where an event leaves the angle
    within 20° of it or beyond it, the converter may go on to the next rest.

    Raises ValueError with all faults of the arguments.
    """
    _check(record, events_s, cleared_s, demand)
    refused = rest.refused(demand.i_max_pu)
    if refused is not None:
        return Survival(status=refused[0], reason=refused[1])
    good = record.finite_rows
    diverged = record.diverged or good < len(record.t_s)
    t = record.t_s[:good]
    if good < 2 or t[-1] <= events_s[0]:
        status, where = (DIVERGED, "before the first event") if diverged else (NOT_KNOWN, "the record has no event")
        return Survival(status=status, reason=where)
    step = float(t[1] - t[0])
    starts, loads = _starts(t, events_s), loads_of(record, events_s, demand.i_max_pu)
    limited = record.limited[:good]
    swing, slipped = _swing(record.delta[:good], starts, rest.delta, ended=not diverged)
    at_end = float(np.mean(limited[np.searchsorted(t, t[-1] - END_S, side="right") :]))
    recovery = None if diverged else _recovery(record, cleared_s, rest, demand)
    figures = Survival(
        status=SURVIVED,
        recovery_s=recovery,
        peak_pu=loads.peak_pu,
        first_peak_pu=loads.first_peak_pu,
        limited_s=loads.limited_s,
        limited_at_end=at_end,
        swing_rad=swing,
    )
    watched_s, reason = float(t[-1]) - cleared_s, None
    short = t[-1] + 0.5 * step < cleared_s + demand.needed_s - step
    given = diverged, slipped, short, math.inf if recovery is None else recovery, demand.deadline_s, at_end
    status = STATUSES[int(place_of_verdict(*map(float, given)))]
    if status == DIVERGED:
        reason = f"a quantity left every sensible bound at {t[-1]:.4g} s"
    elif status == NOT_KNOWN:
        reason = f"the record ends {watched_s:.4g} s after the clearing, and {demand.needed_s:.4g} s are needed"
    found = replace(figures, status=status, reason=reason)
    return found if reason is not None else replace(found, reason=why_lost(found, watched_s, demand))


def place_of_verdict(
    diverged: Any, slipped: Any, too_short: Any, recovery_s: Any, deadline_s: Any, limited_at_end: Any
) -> Any:
    """The place in STATUSES of the verdict on a run that has a rest to come to. The first three are 1 or 0: whether it
    diverged, whether it slipped by a turn, and whether the record is too short. ``recovery_s`` is infinite where it
    does not come to rest."""
    late = np.where(recovery_s > deadline_s, 1.0, 0.0)
    found = np.where((recovery_s == np.inf) and (limited_at_end > LATCHED_SHARE), 3.0, late)
    found = np.where(too_short > 0.5, 6.0, found)
    return np.where(diverged > 0.5, 4.0, np.where(slipped > 0.5, 2.0, found))


def why_lost(verdict: Survival, watched_s: float, demand: SurvivalDemand) -> str | None:
    """The reason of a verdict that follows from its figures; None where it survived. ``watched_s``: for how long the
    record goes on after the clearing."""
    if verdict.status == SLIPPED:
        return f"the angle moved {verdict.swing_rad:.3g} rad away from its rest"
    if verdict.status == LATCHED:
        at_end = 100.0 * (verdict.limited_at_end or 0.0)
        return f"not at rest at the end, and the limiter acts in {at_end:.0f} % of the last {END_S:g} s"
    if verdict.status != NOT_AT_REST:
        return None
    if verdict.recovery_s is None:
        return f"not at rest {watched_s:.3g} s after the clearing"
    return f"at rest after {verdict.recovery_s:.3g} s, later than {demand.deadline_s:.3g} s"


class Loads(NamedTuple):
    """What a record says of the converter's current from the first event on."""

    first_peak_pu: float | None
    """Largest within 5 ms of an event, pu of the rated peak."""
    peak_pu: float | None
    """Largest later than that."""
    limited_s: float
    """Time for which the limiter acted, s."""
    above_s: float
    """Time above the limit, s; 0 without one."""


def loads_of(record: SurvivalRecord, events_s: Sequence[float], i_max_pu: float | None) -> Loads:
    """What a record says of the converter's current, up to its first value that is no number."""
    good = record.finite_rows
    t, current, limited = record.t_s[:good], record.i_s_pu[:good], record.limited[:good]
    step, first = float(record.t_s[1] - record.t_s[0]), int(_starts(t, events_s)[0])
    first_peak_pu, peak_pu = peaks_of(t, current, events_s)
    above = 0 if i_max_pu is None else int(np.count_nonzero(current[first:] > i_max_pu))
    return Loads(
        first_peak_pu=first_peak_pu,
        peak_pu=peak_pu,
        limited_s=float(np.sum(limited[first + 1 :]) * step),
        above_s=above * step,
    )


def peaks_of(t: Array, current: Array, events_s: Sequence[float]) -> tuple[float | None, float | None]:
    """The largest current (n,) within 5 ms of an event, and the largest later than that; None where there is none."""
    step, starts = float(t[1] - t[0]) if len(t) > 1 else 0.0, _starts(t, events_s)
    firsts, laters, at = [], [], int(starts[0])
    for event_s, start in zip(events_s, starts.tolist(), strict=True):
        end = int(np.searchsorted(t, event_s + FIRST_S - 0.5 * step))
        laters.append(current[at:start])
        firsts.append(current[start:end])
        at = max(at, end)
    laters.append(current[at:])
    return _largest(firsts), _largest(laters)


def _starts(t: Array, events_s: Sequence[float]) -> NDArray[np.intp]:
    """The first row of each event. Times are rounded: a row may lie a little before its event."""
    step = float(t[1] - t[0]) if len(t) > 1 else 0.0
    return np.searchsorted(t, np.asarray(events_s, dtype=float) - SAME_ROW * step)


def _recovery(record: SurvivalRecord, cleared_s: float, rest: ExpectedRest, demand: SurvivalDemand) -> float | None:
    """Time from the clearing from which the means over a cycle stay in their band, s; None if they do not.

    Where not all of the means have to be inside, it is the last time before the deadline at which they enter the band.
    """
    t = record.t_s
    cycle = max(round(demand.cycle_s / float(t[1] - t[0])), 1)
    since = t - cleared_s
    first = int(np.searchsorted(since, 0.0))
    since = since[first:]
    if not len(since):
        return None
    error, other = (_beyond(one, cycle, first, at) for one, at in ((record.P, rest.P), (record.Q, rest.Q)))
    np.maximum(error, other, out=error)
    error /= demand.S_rated
    if demand.share_inside >= 1.0:
        return settling_time(since, error, demand.band)
    late = int(np.searchsorted(since, demand.deadline_s))
    if late < len(since) and float(np.mean(error[late:] <= demand.band)) < demand.share_inside:
        return None
    reached = settling_time(since[:late], error[:late], demand.band) if late else 0.0
    return demand.deadline_s if reached is None else reached


def _beyond(values: Array, cycle: int, first: int, rest: float) -> Array:
    """How far the means over a cycle are from a rest, from a row on."""
    away = cycle_mean(values, cycle, first)
    away -= rest
    return np.abs(away, out=away)


def _swing(delta: Array, starts: NDArray[np.intp], rest: float, ended: bool) -> tuple[float, bool]:
    """Largest distance of the angle from its rest after each event, rad, and whether it slipped by a turn."""
    angle = unwrapped(delta)
    ends = [*starts[1:], len(angle)]
    swing, slipped = 0.0, False
    for k, (begin, end) in enumerate(zip(starts, ends, strict=True)):
        part = angle[begin:end]
        if part.size == 0:
            continue
        final = 1.0 if ended and k == len(starts) - 1 else 0.0
        first, least, most, last = (float(one) for one in (part[0], part.min(), part.max(), part[-1]))
        far, gone = swung(first, least, most, last, rest, final)
        swing, slipped = max(swing, float(far)), slipped or bool(gone > 0.5)
    return swing, slipped


_TURN = 2.0 * math.pi


def swung(first: Any, least: Any, most: Any, last: Any, rest: Any, final: Any) -> tuple[Any, Any]:
    """How far the angle is from its rest after an event, and whether it slipped by a turn.

    ``first``, ``least``, ``most``: the angle right after the event, and its least and largest until the next one;
    ``last``: at the end of the record, ``rest``: of the rest after the last event; rad, not wrapped. ``final``: 1 of
    the last event of a record that does not end with a divergence, else 0. Returns (far, slipped): rad, and 1 or 0.
    """
    base = _TURN * np.floor((first - rest) / _TURN + 0.5)
    reached = _TURN * np.floor((last - rest) / _TURN + 0.5)
    own = np.where(either_way(first - rest, reached, base, rest), reached, base)
    gone = final * np.where(reached != own, 1.0, 0.0)
    base = np.where(final > 0.5, own, base)
    far = np.maximum(np.abs(most - rest - base), np.abs(least - rest - base))
    return far, np.where(far > _TURN, 1.0, gone)


def either_way(first: Any, reached: Any, base: Any, rest: Any) -> Any:
    """Whether the angle may go from ``first`` to the rest at ``reached`` instead of that at ``base``, the nearest one.

    All are in rad against the rest at ``rest``, scalars or arrays. It may where an event has left it within 20° of the
    unstable equilibrium between the two, or beyond it.
    """
    lead = rest - _TURN * np.floor(rest / _TURN + 0.5)
    beyond = np.maximum(np.where(reached > base, 2.0 * lead, -2.0 * lead), 0.0)
    return np.abs(first - reached) <= math.pi + beyond + _EITHER_WAY


def _largest(parts: Sequence[Array]) -> float | None:
    return max((float(part.max()) for part in parts if part.size), default=None)


def _check(record: SurvivalRecord, events_s: Sequence[float], cleared_s: float, demand: SurvivalDemand) -> None:
    faults = []
    lengths = {name: np.shape(getattr(record, name)) for name in ("t_s", "P", "Q", "delta", "i_s_pu", "limited")}
    if len(set(lengths.values())) > 1 or len(lengths["t_s"]) != 1:
        faults.append(f"record: the arrays have the shapes {lengths}, but must all have one dimension and one length.")
    elif lengths["t_s"][0] < 2:
        faults.append("record: it has fewer than two rows.")
    else:
        steps = np.diff(record.t_s)
        least, most, first = steps.min(), steps.max(), steps[0]
        if not (least > 0.0 and max(most - first, first - least) <= 1e-6 * first):
            faults.append("t_s: the rows must be equally spaced and ascending. Resample the record.")
    if not events_s or list(events_s) != sorted(events_s) or not np.isfinite(events_s).all():
        faults.append(f"events_s = {list(events_s)}: there must be at least one event, in ascending order.")
    elif not cleared_s >= events_s[-1]:
        faults.append(f"cleared_s = {cleared_s:g} s: must not be before the last event, {events_s[-1]:g} s.")
    if not 0.0 < demand.share_inside <= 1.0:
        faults.append(f"share_inside = {demand.share_inside:g}: must be above 0 and at most 1.")
    for name in ("S_rated", "settling_time", "cycle_s", "band"):
        value = getattr(demand, name)
        if not (value > 0.0 and math.isfinite(value)):
            faults.append(f"{name} = {value:g}: must be positive.")
    if faults:
        raise ValueError(" ".join(faults))
