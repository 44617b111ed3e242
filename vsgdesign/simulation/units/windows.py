"""Schedules of a plant's units that follow what they measure: each is asked at the end of its own windows, or of each
cycle of its field estimator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.field import FieldAnswer
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.simulation.feeds import LateSchedule
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.field_observer import FieldMemory
from vsgdesign.simulation.following import KnownGridScheduler
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.online import WindowPowers

Follows = KnownGridScheduler | LateSchedule
"""A schedule that takes the powers at the end of a window, and a grid that is known beforehand."""

Schedule = Sequence[GainChange] | Follows | FieldScheduler
"""What a unit's gains are: changes over time, or a schedule that follows what it measures."""


class Ended(NamedTuple):
    """A cycle of a unit's field estimator that has ended, with what followed from it."""

    unit: int
    lock: NDArray[np.float64] | None
    """The numbers of its lock-in in the next cycle; None where another unit has the estimator."""
    change: GainChange | None


class Tape:
    """What the field estimators of a plant's units do in a run, for the run to be made again without a step."""

    def __init__(self, ended: dict[int, list[Ended]] | None = None) -> None:
        """``ended``: by the sample of the loop before which they end; None: they are written down."""
        self.plays = ended is not None
        self._ended: dict[int, list[Ended]] = {} if ended is None else ended

    def played(self) -> Tape:
        """The tape for a run that does the same."""
        return Tape(self._ended)

    def add(self, sample: int, unit: int, lock: NDArray[np.float64] | None, change: GainChange | None) -> None:
        """Writes down a cycle that has ended before a sample of the loop."""
        self._ended.setdefault(sample, []).append(Ended(unit, None if lock is None else lock.copy(), change))

    def at(self, sample: int) -> Sequence[Ended]:
        """The cycles that end before a sample of the loop."""
        return self._ended.get(sample, ())


class UnitGains:
    """The gains of one unit over a run: those that are known beforehand, then what a schedule answers."""

    def __init__(self, schedule: Schedule) -> None:
        self.field = schedule.fresh() if isinstance(schedule, FieldScheduler) else None
        self.follows = schedule if isinstance(schedule, Follows) else None
        self.known: tuple[GainChange, ...]
        if self.field is not None:
            self.known = (GainChange(0.0, self.field.first(), self.field.grid(0)),)
        elif self.follows is not None:
            self.known = (GainChange(0.0, self.follows.first_gains(), self.follows.grid),)
        elif isinstance(schedule, Sequence):
            self.known = tuple(schedule)
        self.changes = list(self.known)
        self._limited = 0

    @property
    def first(self) -> PowerLoopGains:
        """At t = 0."""
        return self.known[0].gains

    @property
    def memory(self) -> FieldMemory | None:
        """The numbers of its field estimator; None without one."""
        return None if self.field is None else self.field.memory

    def concluded(
        self,
        t_s: float,
        sample: int,
        present: PowerLoopGains,
        state: ControllerState,
        shared: FieldAnswer | None = None,
    ) -> GainChange | None:
        """What the schedule says where a cycle of its field estimator has ended before a sample of the unit.
        ``shared``: the answer of the estimator that all units have together."""
        if self.field is None or not (self.field.closed or shared is not None):
            return None
        answer = self.field.concluded() if shared is None else shared
        found = self.field.take(answer, sample, present, state)
        change = GainChange(t_s, found, self.field.grid(sample))
        if found != present:
            self.changes.append(change)
        return change

    def ends(self, duration: float) -> list[float]:
        """The ends of its windows after t = 0, s."""
        if self.follows is None:
            return []
        period = self.follows.update_period
        return [k * period for k in range(1, int(duration / period * (1.0 + 1e-12)) + 1)]

    def answer(
        self, t_s: float, powers: tuple[float, float, float], limited: int, present: PowerLoopGains
    ) -> GainChange | None:
        """What the schedule says at the end of a window. ``powers``: P (W), Q (var) and V (rms) as the power loops see
        them; ``limited``: samples with a limited current since the start."""
        if self.follows is None:
            return None
        window = WindowPowers(t_s, *powers, limited - self._limited)
        self._limited = limited
        found = self.follows.update(window)
        if found is None or found == present:
            return None
        self.changes.append(GainChange(t_s, found, self.follows.grid))
        return self.changes[-1]


__all__ = ["Ended", "Follows", "Schedule", "Tape", "UnitGains"]
