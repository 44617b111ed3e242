"""The scheduler's equations as machine code, for many converters at once, and a run in which every operation rounds by
itself: the sines of its source and the scheduler of a gain table, too.

The latter are made of the functions of :mod:`vsgdesign.codegen.vector_math` and not of a library's, so that they have
the same bits wherever the compiled loops have them, as on a page of the explorer (``[simulation] strict``).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.codegen.llvm import Loop, LoopSpec, best_lanes, compiled_loop, empty_rows, flat_block
from vsgdesign.codegen.vector_math import cosine, sine
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.scheduler_data import SchedulerInput, SchedulerLimits, SchedulerState
from vsgdesign.equations.scheduling import begun, told_and_updated
from vsgdesign.identification import Estimator
from vsgdesign.runtime.guards import SchedulerSettings
from vsgdesign.runtime.scheduler import Scheduler, scheduler_of
from vsgdesign.runtime.updating import Answer, GainLookup

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


class CompiledSchedulers:
    """The equations of :class:`vsgdesign.runtime.many.ManySchedulers`. Each lane has the bits of plain Python."""

    def __init__(self, lookup: GainLookup, settings: SchedulerSettings) -> None:
        self._lookup, self._limits = lookup, settings.limits

    def begin(self, R_g: Array, L_g: Array, nearest: bool) -> tuple[Any, NDArray[np.bool_]]:
        """States on known grids, and which of these are in the box."""
        found = _run(_beginning(self._lookup, nearest), self._limits, {"R_g": R_g, "L_g": L_g})
        return _record(SchedulerState, found, "first."), found["known"] != 0.0

    def update(self, state: Any, told: Whole, given: Any) -> tuple[Any, Whole, Whole]:
        """States after an update before which each was told something, with status and reason."""
        values = {"told": told} | _columns(state, "s.") | _columns(given, "given.")
        found = _run(_update(self._lookup), self._limits, values)
        status, reason = (found[name].astype(np.int64) for name in ("status", "reason"))
        return _record(SchedulerState, found, "following."), status, reason


@functools.lru_cache(maxsize=16)
def _update(lookup: GainLookup) -> Loop:
    return compiled_once(told_and_updated, {"table": lookup.table, "law": lookup.functions})


@functools.lru_cache(maxsize=16)
def _beginning(lookup: GainLookup, nearest: bool) -> Loop:
    return compiled_once(begun, {"table": lookup.table, "law": lookup.functions, "nearest": nearest})


def compiled_once(function: Any, fixed: dict[str, Any], lanes: int | None = None, vectors: int = 1) -> Loop:
    """A function as one sample of a loop: the inputs are rows, its ``limits`` are uniform, and the outputs are logged.
    ``lanes`` as :func:`vsgdesign.codegen.llvm.best_lanes` where nothing else is said."""
    block = flat_block(function, fixed=fixed)
    limits = tuple(name for name in block.inputs if name.startswith("limits."))
    rows = [name for name in block.inputs if name not in limits]
    outputs = tuple(name for name, _ in block.outputs)
    # A loop moves at least one number; this one is read no more.
    state, width = ((rows[0], outputs[0]),), lanes or best_lanes()
    spec = LoopSpec((block,), state, tuple(rows[1:]), limits, logged=outputs, lanes=width, vectors=vectors, strict=True)
    # It runs once in some hundred samples: what compiling quickly saves is worth many calls.
    return compiled_loop(spec, quickly=True)


def uniform_of(loop: Loop, limits: SchedulerLimits) -> Array:
    """The limits as such a loop takes them."""
    return np.array([float(getattr(limits, name.removeprefix("limits."))) for name in loop.spec.uniform])


def _run(loop: Loop, limits: SchedulerLimits, values: dict[str, Any]) -> dict[str, Array]:
    """The outputs of a function, (N,) each, for inputs of N lanes."""
    spec, count = loop.spec, len(next(iter(values.values())))
    groups = -(-count // spec.width)
    rows, log = empty_rows(spec, groups), np.empty((groups, 1, len(spec.logged), spec.width))
    padded = np.empty(groups * spec.width)
    for at, name in enumerate(spec.rows):
        padded[:count], padded[count:] = values[name], values[name][-1] if count else 0.0
        rows[:, at] = padded.reshape(groups, spec.width)
    loop(0, 1, rows, uniform_of(loop, limits), log=log, every=1)
    return {name: log[:, 0, at].reshape(-1)[:count] for at, name in enumerate(spec.logged)}


def _columns(record: Any, prefix: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, values in record._asdict().items():
        found |= _columns(values, f"{prefix}{name}.") if isinstance(values, tuple) else {f"{prefix}{name}": values}
    return found


def _record(cls: Any, found: dict[str, Array], prefix: str) -> Any:
    """A record of arrays; counts are whole numbers."""
    kinds = cls.__annotations__
    return cls(
        **{
            name: _record(PowerLoopGains, found, f"{prefix}{name}.")
            if name == "gains"
            else found[f"{prefix}{name}"].astype(np.int64 if kinds[name] == "Count" else float)
            for name in cls._fields
        }
    )


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
