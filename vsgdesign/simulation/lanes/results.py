"""Verdicts and figures of a batch from what its lanes watched: those of one run after the other, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.survival import swung
from vsgdesign.simulation.watched_sample import Entry, entered_s

Array = NDArray[np.float64]
Kinds = NDArray[np.int8]

NO_REST, OVER_LIMIT, JUDGED, DIVERGED, SLIPPED, LATCHED, NOT_AT_REST, TRIPPED, IN_NOISE, BLOCKED = range(10)
STATUSES = (
    *("no rest", "rest over limit", "judged", "diverged", "slipped", "latched", "not at rest", "tripped"),
    "too small for its noise",
    "blocked",
)
"""What became of a case. The first two and ``too small for its noise`` have no verdict. ``judged`` means survived for a
disturbance, and that there are figures for a step; ``too small for its noise``: a step that cannot be judged
(:eq:`twin-noise`); ``blocked``: the dc link left its limits."""


@dataclass(frozen=True, kw_only=True)
class LaneResults:
    """Results of N cases: arrays (N,). NaN where a figure has no meaning, inf for a time that was not reached."""

    status: Kinds
    """Place in STATUSES."""
    fault: Kinds
    """Why there is no rest: place in :data:`vsgdesign.linear.operating_point.many.FAULTS`; 0 otherwise."""
    overshoot: Array
    """Of a step, as a share of it."""
    settling_s: Array
    """Of a step, from the step on, s."""
    noise: Array
    """Of a step beside its twin: what noise may do to its overshoot, as a share of the step; 0 without a twin."""
    recovery_s: Array
    """Of a disturbance, from its end on, s."""
    first_peak_pu: Array
    """Largest converter current within 5 ms of an event, pu of the rated peak."""
    peak_pu: Array
    """Largest converter current later than this after an event."""
    above_s: Array
    """Time for which the converter current was above its limit after the first event, s."""
    limited_s: Array
    """Time for which the current limiter acted after the first event, s."""
    limited_at_end: Array
    """Of a disturbance: share of the last 0.3 s in which the limiter acted, 0 to 1."""
    swing_rad: Array
    """Of a disturbance: largest distance of the angle from the nearest rest that each event leaves it, rad."""
    dc_beyond_j: Array
    """The energy beyond the dc link, J (:func:`vsgdesign.simulation.dc_beyond.energy_beyond`), where this is why there
    is no verdict; NaN elsewhere."""

    def __len__(self) -> int:
        return len(self.status)

    @classmethod
    def of_none(cls, count: int) -> LaneResults:
        """Results of so many cases that have no rest, to be filled in."""
        numbers = {f.name: np.full(count, np.nan) for f in fields(cls) if f.name not in ("status", "fault")}
        return cls(status=np.zeros(count, dtype=np.int8), fault=np.zeros(count, dtype=np.int8), **numbers)

    def take(self, chosen: slice) -> LaneResults:
        """Those of some cases."""
        return LaneResults(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    def fill(self, index: NDArray[np.intp], part: LaneResults) -> None:
        """Takes the results of some cases."""
        for f in fields(self):
            getattr(self, f.name)[index] = getattr(part, f.name)


class LastEntry(NamedTuple):
    """What :class:`vsgdesign.simulation.watched_sample.Entry` holds at the end, (n,)."""

    last_out: Array
    error_out: Array
    error_in: Array
    was_out: Array

    def time(self, band: float, T_s: float, since_s: Array) -> Array:
        """:func:`vsgdesign.simulation.watched_sample.entered_s` of every lane."""
        return entered_s(Entry(*self), band, T_s, since_s)


class Swings(NamedTuple):
    """The angle of n lanes after each of E events, (n, E), rad, not wrapped: at the event, least and largest until the
    next one."""

    first: Array
    least: Array
    most: Array


def swings_of(angle: Swings, events: Array, last: Array, rest: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Largest distance of the angle from its rest after each event, rad (n,), and whether it slipped by a turn.

    ``events``: whether an event is one of the lane, (n, E). ``last``: the angle at the end, ``rest``: the angle of the
    rest after the last event, (n,). As one run is judged (:func:`vsgdesign.metrics.survival.judge_survival`).
    """
    swing, slipped = np.zeros(len(rest)), np.zeros(len(rest), dtype=bool)
    final = events.sum(axis=1) - 1
    for k in range(events.shape[1]):
        each = angle.first[:, k], angle.least[:, k], angle.most[:, k]
        far, gone = swung(*each, last, rest, 1.0 * (final == k))
        slipped |= events[:, k] & (gone > 0.5)
        swing = np.where(events[:, k], np.maximum(swing, far), swing)
    return swing, slipped
