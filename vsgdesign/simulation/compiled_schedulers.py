"""The scheduler's equations as machine code, for many converters at once."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import Loop, LoopSpec, best_lanes, compiled_loop, empty_rows, flat_block
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.scheduler_data import SchedulerLimits, SchedulerState
from vsgdesign.equations.scheduling import begun, told_and_updated
from vsgdesign.runtime.guards import SchedulerSettings
from vsgdesign.runtime.lookup import GainLookup

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
