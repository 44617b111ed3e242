"""The schedulers of many converters at once, with the state and the last answers of each."""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.runtime.guards import (
    NO_ESTIMATE,
    NO_REASON,
    TOLD_CHANGED,
    TOLD_LIMITED,
    TOLD_SURPRISED,
    SchedulerSettings,
)
from vsgdesign.runtime.lookup import GainLookup
from vsgdesign.runtime.many_lookups import ManyLookups, ManyPlaces, everywhere, taken, with_lanes
from vsgdesign.runtime.many_updating import ManyAnswers, ManyCovariances, ManyInputs, advance_many, told_many
from vsgdesign.runtime.state import SchedulerState
from vsgdesign.runtime.updating import first_state

Array = NDArray[np.float64]
Whole = NDArray[np.int64]
Lanes = NDArray[np.int64] | None


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
        self._put(lanes, told_many(state, bits), None)

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
        inputs = ManyInputs(said, R_g, L_g, P, Q, V_rms, np.asarray(ticks), covariance)
        with np.errstate(all="ignore"):
            state, places, answers = advance_many(self._many, self._settings, state, places, inputs)
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


def _flags(values: Any, count: int) -> Whole:
    return np.broadcast_to(np.asarray(values, dtype=bool), (count,)).astype(np.int64)
