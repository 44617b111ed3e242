"""A run in which every operation rounds by itself: the sines of its source and the scheduler of a gain table, too.

They are made of the functions of :mod:`vsgdesign.codegen.vector_math` and not of a library's, so that they have the
same bits wherever the compiled loops have them, as on a page of the explorer (``[simulation] strict``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.codegen.vector_math import cosine, sine
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.scheduler_data import SchedulerInput, SchedulerState
from vsgdesign.identification import Estimator
from vsgdesign.runtime.guards import SchedulerSettings
from vsgdesign.runtime.lookup import GainLookup
from vsgdesign.runtime.scheduler import Scheduler, scheduler_of
from vsgdesign.runtime.updating import Answer
from vsgdesign.simulation.compiled_schedulers import CompiledSchedulers

Array = NDArray[np.float64]


def directions(angles: Sequence[float], *, strict: bool) -> Array:
    """Cosine and sine of angles (rad), (n, 2)."""
    of = (cosine, sine) if strict else (math.cos, math.sin)
    return np.array([[float(one(angle)) for one in of] for angle in angles]).reshape(-1, 2)


def direction(angle: float) -> tuple[float, float]:
    """Cosine and sine of an angle, rad. Returns (re, im)."""
    return np.cos(angle), np.sin(angle)


class StrictScheduler(Scheduler):
    """The scheduler of a table whose updates are those of a strict loop."""

    def __init__(self, lookup: GainLookup, settings: SchedulerSettings, estimator: Estimator | None = None) -> None:
        self._compiled = CompiledSchedulers(lookup, settings)
        super().__init__(lookup, settings, estimator)

    def _updated(self, given: SchedulerInput) -> tuple[SchedulerState, Answer]:
        told = np.array([0])  # it is in the state already
        found, status, reason = self._compiled.update(_several(self._state), told, _several(given))
        state = _first(found)
        return state, Answer(state.gains, int(status[0]), int(reason[0]), state.scr, state.r_over_x)

    def _started(self, R_g: float, L_g: float, nearest: bool) -> tuple[SchedulerState, bool]:
        found, known = self._compiled.begin(np.array([R_g]), np.array([L_g]), nearest)
        return _first(found), bool(known[0])


def strict_scheduler_of(table: GainTable, estimator: Estimator | None = None) -> StrictScheduler:
    """:func:`vsgdesign.runtime.scheduler.scheduler_of`, strict."""
    made = scheduler_of(table, estimator)
    return StrictScheduler(made.lookup, made.settings, estimator)


def _several(value: Any) -> Any:
    """A record as one of arrays with one number each."""
    return type(value)(*map(_several, value)) if isinstance(value, tuple) else np.array([value])


_KINDS = {name: int if kind is int else float for name, kind in get_type_hints(SchedulerState).items()}


def _first(states: SchedulerState) -> SchedulerState:
    """The first of several states, on plain numbers."""
    gains = PowerLoopGains(*(float(value[0]) for value in states.gains))
    numbers = (name for name in SchedulerState._fields if name != "gains")
    found: dict[str, Any] = {name: _KINDS[name](getattr(states, name)[0]) for name in numbers}
    return SchedulerState(**found, gains=gains)
