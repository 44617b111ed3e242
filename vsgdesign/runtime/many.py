"""The schedulers of many converters at once, with the state and the last answers of each."""

from __future__ import annotations

from copy import copy
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.scheduler_data import (
    NO_ESTIMATE,
    NO_REASON,
    TOLD_CHANGED,
    TOLD_LIMITED,
    TOLD_SURPRISED,
    SchedulerInput,
    SchedulerState,
    grid_at,
)
from vsgdesign.runtime.guards import SchedulerSettings
from vsgdesign.runtime.updating import GainLookup, advance, first_state, start_state, told_state

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


class SchedulerLanes(Protocol):
    """The equations of many schedulers. Their records have an array (N,) in every field."""

    def begin(self, R_g: Array, L_g: Array, nearest: bool) -> tuple[Any, NDArray[np.bool_]]:
        """States on known grids, and which of these are in the box."""
        ...

    def update(self, state: Any, told: Whole, given: Any) -> tuple[Any, Whole, Whole]:
        """States after an update before which each was told something, with status and reason."""
        ...


class OneByOne:
    """The schedulers one after the other in Python: NumPy is all that they need."""

    def __init__(self, lookup: GainLookup, settings: SchedulerSettings) -> None:
        self._lookup, self._settings = lookup, settings

    def begin(self, R_g: Array, L_g: Array, nearest: bool) -> tuple[Any, NDArray[np.bool_]]:
        pairs = zip(R_g.tolist(), L_g.tolist(), strict=True)
        states, known = zip(*(start_state(self._lookup, self._settings, *pair, nearest) for pair in pairs), strict=True)
        return stacked(states), np.array(known)

    def update(self, state: Any, told: Whole, given: Any) -> tuple[Any, Whole, Whole]:
        states, answers = [], []
        for one, bits, seen in zip(apart(state), told.tolist(), apart(given), strict=True):
            following, answer = advance(self._lookup, self._settings, told_state(one, bits), seen)
            states.append(following)
            answers.append(answer)
        return stacked(states), np.array([a.status for a in answers]), np.array([a.reason for a in answers])


class ManySchedulers:
    """``count`` schedulers with one lookup and one set of settings, as arrays of ``count`` lanes.

    ``lanes`` runs their equations: :class:`OneByOne` by default, with the bits of a
    :class:`vsgdesign.runtime.scheduler.Scheduler` each. An object has a state, so it serves one set of runs at a time.
    """

    def __init__(
        self, lookup: GainLookup, settings: SchedulerSettings, count: int, lanes: SchedulerLanes | None = None
    ) -> None:
        self._lookup, self._count = lookup, count
        self._equations = OneByOne(lookup, settings) if lanes is None else lanes
        self.answers: ManyAnswers | None = None
        """The last answers; None before the first update."""
        self._state: Any = stacked([first_state(lookup, settings)] * count)
        self._told = np.zeros(count, np.int64)

    def __len__(self) -> int:
        return self._count

    @property
    def gains(self) -> PowerLoopGains:
        """The present gains, arrays of ``count``."""
        return self._state.gains

    @property
    def grid(self) -> tuple[Array, Array]:
        """R_g (Ω) and L_g (H) of the places for which the present gains are made."""
        return grid_at(self._lookup.table, self._state.scr, self._state.r_over_x, self._lookup.functions)

    @property
    def state(self) -> SchedulerState:
        """The state after the last update, with an array of ``count`` in each field."""
        return self._state

    def start(self, R_g: Array, L_g: Array, *, nearest: bool = False) -> NDArray[np.bool_]:
        """Starts on known grids. Returns which of them are in the box; the others start at the safe place. With
        ``nearest``, a grid outside the box is taken for the nearest place in it."""
        self._state, known = self._equations.begin(np.asarray(R_g, float), np.asarray(L_g, float), nearest)
        self._told[:] = 0
        return known

    def take(self, chosen: NDArray[Any]) -> ManySchedulers:
        """Schedulers of their own with the state of some of these, by index or by mask."""
        some = copy(self)
        some._state, some._told, some.answers = taken(self._state, chosen), self._told[chosen], None
        some._count = len(some._told)
        return some

    def tell(self, *, limited: Any = False, surprised: Any = False, changed: Any = False, lanes: Lanes = None) -> None:
        """Says what happened since the last update, as :meth:`vsgdesign.runtime.scheduler.Scheduler.tell`."""
        here = slice(None) if lanes is None else lanes
        count = self._count if lanes is None else len(lanes)
        self._told[here] |= (
            TOLD_LIMITED * _flags(limited, count)
            | TOLD_SURPRISED * _flags(surprised, count)
            | TOLD_CHANGED * _flags(changed, count)
        )

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
        errors = np.zeros((3, len(said))) if covariance is None else np.stack(covariance)
        has_error = np.zeros(len(said), np.int64) if covariance is None else (~np.isnan(errors).all(axis=0)).astype(int)
        ticks = np.broadcast_to(np.asarray(ticks) & 0xFFFFFFFF, said.shape)
        given = SchedulerInput(said, R_g, L_g, has_error, *errors, P, Q, V_rms, ticks)  # type: ignore[arg-type]
        state = self._state if lanes is None else taken(self._state, lanes)
        told = self._told if lanes is None else self._told[lanes]
        state, status, reason = self._equations.update(state, told, given)
        self._state = state if lanes is None else _with_lanes(self._state, state, lanes)
        self._told[slice(None) if lanes is None else lanes] = 0
        self.answers = ManyAnswers(state.gains, status, reason, state.scr, state.r_over_x)
        return state.gains


def stacked(records: Any) -> Any:
    """Records as one, with an array in every field."""
    first = records[0]
    return type(first)(
        *(
            stacked([record[at] for record in records])
            if isinstance(first[at], tuple)
            else np.array([record[at] for record in records])
            for at in range(len(first))
        )
    )


def apart(record: Any) -> list[Any]:
    """A record of arrays as one of Python's numbers for each lane."""
    columns = [apart(values) if isinstance(values, tuple) else values.tolist() for values in record]
    return [type(record)(*values) for values in zip(*columns, strict=True)]


def taken(record: Any, lanes: NDArray[Any]) -> Any:
    """The same of some lanes."""
    return type(record)(*(taken(values, lanes) if isinstance(values, tuple) else values[lanes] for values in record))


def _with_lanes(record: Any, new: Any, lanes: Whole) -> Any:
    """The same with some lanes replaced."""
    after = []
    for values, of_lanes in zip(record, new, strict=True):
        if isinstance(values, tuple):
            after.append(_with_lanes(values, of_lanes, lanes))
            continue
        values = values.copy()
        values[lanes] = of_lanes
        after.append(values)
    return type(record)(*after)


def _flags(values: Any, count: int) -> Whole:
    return np.broadcast_to(np.asarray(values, dtype=bool), (count,)).astype(np.int64)
