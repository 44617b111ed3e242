"""A compiled loop as a function of arrays, which are checked before it may touch them."""

from __future__ import annotations

import ctypes
import functools
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm_loop import INTEGERS, POINTERS
from vsgdesign.codegen.loop_spec import LoopSpec

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Arrays = Mapping[str, NDArray[Any]]

_FLOATS, _INTEGERS = np.dtype(np.float64), np.dtype(np.int64)
_PACKED = struct.Struct(f"{len(INTEGERS) + len(POINTERS)}q")
_FED, _FED_SAMPLE = len(INTEGERS) + POINTERS.index("fed"), INTEGERS.index("fed_sample")
_FED_GROUP, _GROUPS = INTEGERS.index("fed_group"), INTEGERS.index("groups")
_LOG, _LOG_SLOT = len(INTEGERS) + POINTERS.index("log"), INTEGERS.index("log_sample")
"""Places among the arguments of the compiled function."""

_ONE = np.zeros(1)

_FORMS = 64
"""Forms of calls that a loop remembers."""


@dataclass(frozen=True)
class Program:
    """What is known beforehand: numbers that are written into rows before a sample.

    Record p of group g, first[g] ≤ p < first[g + 1], acts before sample at[p], on ``count[p]`` rows from ``row[p]`` of
    lane ``lane[p]``. They become values[source[p]:], or, where source[p] < 0, what the rows from −1 − source[p] of the
    same lane are. Records of a group are in order of ``at``. ``done`` is where each group is in its records: a call
    moves it, and the next call goes on from there.
    """

    first: Integers
    """(G + 1,)"""
    at: Integers
    lane: Integers
    row: Integers
    count: Integers
    source: Integers
    """(m,) each"""
    values: Floats
    done: Integers
    """(G,)"""


_OF_PROGRAM = tuple(field.name for field in fields(Program))


@functools.lru_cache(maxsize=64)
def _no_program(groups: int) -> tuple[Program, list[int]]:
    """A program without records, and where it lies. No call changes it."""
    none = np.zeros(0, np.int64)
    own = Program(np.zeros(groups + 1, np.int64), none, none, none, none, none, np.zeros(0), np.zeros(groups, np.int64))
    return own, [_address(getattr(own, name)) for name in _OF_PROGRAM]


class Loop:
    """A compiled loop. Threads may call it at the same time, each with its own rows."""

    def __init__(self, spec: LoopSpec, call: Callable[..., int]) -> None:
        self.spec = spec
        self._call = call
        self._fitting: set[tuple[object, ...]] = set()
        """The forms of the arrays of calls that were right (:func:`_form`)."""
        self._records: Integers | None = None
        """``at`` of the program whose records were right."""

    def __call__(  # noqa: PLR0913 (as many arrays as a loop can have)
        self,
        begin: int,
        end: int,
        rows: Floats,
        uniform: Floats,
        *,
        cyclic: Floats | None = None,
        cycle: Integers | None = None,
        fed: Floats | None = None,
        rings: Floats | None = None,
        ring_length: Integers | None = None,
        log: Floats | None = None,
        every: int = 0,
        log_begin: int = 0,
        origin: int = 0,
        program: Program | None = None,
    ) -> int:
        """Moves ``rows`` (G, R, L) through samples ``begin`` to ``end`` − 1 and gives the number of samples done.

        R are the rows of ``spec.rows``, and more that a program's copies alone use; L the lanes of a group.
        ``uniform`` (n,); ``cyclic`` (period, n) and ``cycle`` (period,), the body's number, are those of sample
        k % period. ``fed`` (G, end − begin, n, L) begins at sample ``begin``. ``rings`` (G, size, n, L) hold the last
        ``ring_length`` (G,) samples, sample k in slot k % ring_length. ``log`` (G, slots, n, L) gets samples 0,
        ``every``, 2·``every``, … of the run in slots 0, 1, 2, …, or those from ``log_begin`` on, a multiple of
        ``every`` and not after ``begin``; ``every`` = 0 logs nothing. Where each lane has a slot of its own, ``log`` is
        (G, L, slots, n), and every sample is logged. ``index`` is k − ``origin``.

        Raises ValueError with everything that does not fit. The interpreter's lock is free meanwhile.
        """
        arguments = self._arguments(
            begin, end, rows, uniform, cyclic, cycle, fed, rings, ring_length, log, every, origin, program, log_begin
        )
        return 0 if begin == end or not len(rows) else self._call(_PACKED.pack(*arguments))

    def standing(
        self,
        rows: Floats,
        uniform: Floats,
        *,
        cyclic: Floats | None = None,
        cycle: Integers | None = None,
        rings: Floats | None = None,
        ring_length: Integers | None = None,
        log: Floats | None = None,
        every: int = 0,
        log_begin: int = 0,
        program: Program | None = None,
    ) -> StandingLoop:
        """The loop over arrays that stay where they are: many short calls cost less."""
        nothing_fed = np.zeros((len(rows), 0, len(self.spec.fed), self.spec.width)) if self.spec.fed else None
        arguments = self._arguments(
            log_begin, log_begin, rows, uniform, cyclic, cycle, nothing_fed, rings, ring_length, log, every, 0, program,
            log_begin,
        )  # fmt: skip
        kept = (rows, uniform, cyclic, cycle, rings, ring_length, log, program)
        slots = (log_begin, every, log.shape[1]) if log is not None and every else None
        return StandingLoop(self.spec, self._call, arguments, kept, slots)

    def _arguments(  # noqa: PLR0913
        self,
        begin: int,
        end: int,
        rows: Floats,
        uniform: Floats,
        cyclic: Floats | None,
        cycle: Integers | None,
        fed: Floats | None,
        rings: Floats | None,
        ring_length: Integers | None,
        log: Floats | None,
        every: int,
        origin: int,
        program: Program | None,
        log_begin: int = 0,
    ) -> list[int]:
        """The arguments of the compiled function, after all checks."""
        spec = self.spec
        every = every if spec.logged else 0
        given: dict[str, NDArray[Any]] = {"rows": rows, "uniform": uniform}
        if spec.cyclic and cyclic is not None:
            given["cyclic"] = cyclic
        if len(spec.bodies) > 1 and cycle is not None:
            given["cycle"] = cycle
        if spec.fed and fed is not None:
            given["fed"] = fed
        if spec.rings and rings is not None and ring_length is not None:
            given |= {"rings": rings, "ring_length": ring_length}
        if every and log is not None:
            given["log"] = log
        if program is not None:
            given |= {name: getattr(program, name) for name in _OF_PROGRAM}
        # A call is mostly like one before: then a look at the forms is all that is needed.
        forms = tuple(_form(name, array, given, spec) for name, array in given.items())
        if forms not in self._fitting:
            _refuse(_shape_faults(spec, given, every > 0))
        if program is not None and (forms not in self._fitting or program.at is not self._records):
            _refuse(_program_faults(spec, program, rows))
        _refuse(_faults(spec, given, begin, end, every, log_begin))
        if len(self._fitting) >= _FORMS:
            self._fitting.clear()
        self._fitting.add(forms)
        self._records = program.at if program is not None else None
        period = given["cycle"] if "cycle" in given else given.get("cyclic", _ONE)
        fed_strides, log_strides = (given[name].strides if name in given else (0, 0) for name in ("fed", "log"))
        places = [_address(given[name]) if name in given else 0 for name in POINTERS]
        if "log" in given and not spec.slot:  # the loop counts slots from sample 0
            places[POINTERS.index("log")] -= log_begin // every * log_strides[1]
        if program is None:
            places[-len(_OF_PROGRAM) :] = _no_program(len(rows))[1]
        return [
            begin, end, len(rows), rows.strides[0] // 8, len(period), fed_strides[0] // 8, fed_strides[1] // 8,
            given["rings"].shape[1] if "rings" in given else 0, log_strides[0] // 8, log_strides[1] // 8, every,
            origin, *places,
        ]  # fmt: skip


class StandingLoop:
    """A compiled loop over arrays that stay where they are (:meth:`Loop.standing`). It serves one thread."""

    def __init__(
        self,
        spec: LoopSpec,
        call: Callable[..., int],
        arguments: list[int],
        kept: tuple[object, ...],
        slots: tuple[int, int, int] | None,
    ) -> None:
        """``slots``: the first sample of the log, its spacing and how many it has room for."""
        self._spec, self._call, self._kept = spec, call, kept
        self._given = (ctypes.c_int64 * len(arguments))(*arguments)
        self._groups, self._slots = arguments[_GROUPS], slots

    def log_from(self, begin: int) -> None:
        """The log is written anew from its first slot on, which is that of sample ``begin``, a multiple of ``every``.

        Raises ValueError where nothing is logged, or for another sample.
        """
        if self._slots is None or begin < 0 or begin % self._slots[1]:
            raise ValueError(f"log from sample {begin} on: give a loop that logs, and a multiple of its spacing.")
        before, every, room = self._slots
        self._given[_LOG] -= 8 * self._given[_LOG_SLOT] * ((begin - before) // every)
        self._slots = begin, every, room

    def __call__(self, begin: int, end: int, fed: Floats | None = None, groups: int | None = None) -> int:
        """Moves the rows of the first ``groups`` (None: of all) through samples ``begin`` to ``end`` − 1 as a call of
        :class:`Loop` does.

        Raises ValueError where the samples, the groups, the log or what is fed do not fit.
        """
        arguments, spec = self._given, self._spec
        groups = self._groups if groups is None else groups
        if not 0 <= begin <= end or not 0 <= groups <= self._groups:
            raise ValueError(
                f"samples {begin} to {end} of {groups} groups: give 0 ≤ begin ≤ end, {self._groups} at most."
            )
        if self._slots is not None and end > begin:
            first, every, room = self._slots
            if begin < first or room <= (end - 1 - first) // every:
                raise ValueError(f"log has {room} slots: give {(end - 1 - first) // every + 1} from sample {first} on.")
        if spec.fed:
            wanted = (groups, end - begin, len(spec.fed), spec.width)
            fits = fed is not None and fed.shape[1:] == wanted[1:] and len(fed) >= groups and fed.dtype == np.float64
            if fed is None or not fits or (fed.size and not fed[0, 0].flags.c_contiguous):
                raise ValueError(f"fed is {'missing' if fed is None else fed.shape}: give {wanted}, contiguous.")
            arguments[_FED], arguments[_FED_GROUP] = _address(fed), fed.strides[0] // 8
            arguments[_FED_SAMPLE] = fed.strides[1] // 8
        arguments[0], arguments[1], arguments[_GROUPS] = begin, end, groups
        return 0 if begin == end or groups == 0 else self._call(arguments)


def _address(array: NDArray[Any]) -> int:
    """Where an array lies."""
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(array))  # type: ignore[arg-type]
    except (TypeError, ValueError, BufferError):  # not contiguous, empty or not to be written: the slower way
        return array.ctypes.data


def _refuse(faults: list[str]) -> None:
    if faults:
        raise ValueError("A compiled loop cannot run: " + "; ".join(faults) + ".")


def _form(name: str, array: NDArray[Any], given: Arrays, spec: LoopSpec) -> tuple[object, ...]:
    """What has to be as in a call before, so that its shape, its type and its contiguity need no other look: not how
    many samples or records there are."""
    if name == "fed" or (name == "log" and not spec.slot):
        return name, array.ndim, len(array), array.shape[2:], array.strides[2:], 0 in array.shape, array.dtype
    if name in ("at", "lane", "row", "count", "source"):
        return name, array.shape == (len(given["at"]),), array.strides, array.dtype
    if name == "values":
        return name, array.ndim, array.strides, array.dtype
    return name, array.shape, array.strides, array.dtype


def _shape_faults(spec: LoopSpec, given: Arrays, logging: bool) -> list[str]:
    """What is missing or has another shape or type."""
    rows = given["rows"]
    groups = rows.shape[0] if rows.ndim == 3 else None
    length = next((len(given[name]) for name in ("cycle", "cyclic") if name in given and given[name].ndim), None)
    wanted: dict[str, tuple[bool, tuple[int | None, ...], np.dtype[Any]]] = {
        "rows": (True, (None, None, spec.width), _FLOATS),
        "uniform": (True, (len(spec.uniform),), _FLOATS),
        "cyclic": (bool(spec.cyclic), (length, len(spec.cyclic)), _FLOATS),
        "cycle": (len(spec.bodies) > 1, (length,), _INTEGERS),
        "fed": (bool(spec.fed), (groups, None, len(spec.fed), spec.width), _FLOATS),
        "rings": (bool(spec.rings), (groups, None, len(spec.rings), spec.width), _FLOATS),
        "ring_length": (bool(spec.rings), (groups,), _INTEGERS),
        "log": (logging, (groups, None, len(spec.logged), spec.width), _FLOATS),
    }
    if spec.slot:
        wanted["log"] = logging, (groups, spec.width, None, len(spec.logged)), _FLOATS
    if "at" in given:
        wanted |= dict.fromkeys(("at", "lane", "row", "count", "source"), (True, (len(given["at"]),), _INTEGERS))
        wanted |= {"values": (True, (None,), _FLOATS), "done": (True, (groups,), _INTEGERS)}
        wanted["first"] = True, (None if groups is None else groups + 1,), _INTEGERS
    faults = []
    for name, (needed, shape, kind) in wanted.items():
        if needed and name not in given:
            faults.append(f"{name} is missing: give an array of shape {_shown(shape)}")
        elif needed:
            faults += _array_faults(name, given[name], shape, kind)
    if groups is not None and rows.shape[1] < len(spec.rows):
        faults.append(f"rows has the shape {rows.shape}: give (any, {len(spec.rows)} or more, {spec.width})")
    if "cycle" in given and length and not faults:
        cycle = given["cycle"]
        if cycle.min() < 0 or cycle.max() >= len(spec.bodies):
            faults.append(f"cycle names a body that is not there: give 0 to {len(spec.bodies) - 1}")
    if length == 0:
        faults.append("cyclic or cycle has no sample: give at least one")
    return faults


def _array_faults(name: str, array: NDArray[Any], shape: tuple[int | None, ...], kind: np.dtype[Any]) -> list[str]:
    faults = []
    fits = array.ndim == len(shape) and all(n is None or n == m for n, m in zip(shape, array.shape, strict=True))
    if not fits:
        faults.append(f"{name} has the shape {array.shape}: give {_shown(shape)}")
    if array.dtype != kind:
        faults.append(f"{name} is of {array.dtype}: give {kind}")
    apart = name in ("fed", "log") and fits and 0 not in array.shape
    inner = array[(0,) * (array.ndim - 2)] if apart else array  # groups and samples of these may lie apart
    if not inner.flags.c_contiguous:
        faults.append(f"{name} is not contiguous: give a copy of it")
    return faults


def _program_faults(spec: LoopSpec, program: Program, rows: Floats) -> list[str]:
    """What would lead a program's records beyond the rows or its own numbers."""
    count = len(program.at)
    lengths = {len(getattr(program, name)) for name in ("lane", "row", "count", "source")}
    if not count or lengths != {count} or rows.ndim != 3 or len(program.first) != len(program.done) + 1:
        return []
    source, faults = program.source, []
    other = np.where(source < 0, -1 - source + program.count, 0)
    outside = (program.row < 0) | (program.row + program.count > rows.shape[1]) | (other > rows.shape[1])
    outside |= (program.lane < 0) | (program.lane >= spec.width) | (program.count < 0)
    outside |= (source >= 0) & (source + program.count > len(program.values))
    if outside.any():
        faults.append(f"record {int(np.argmax(outside))} of the program lies outside the rows, lanes or values")
    if program.first[0] < 0 or program.first[-1] > count or bool((np.diff(program.first) < 0).any()):
        faults.append("first of the program does not lead through its records: give ascending numbers within them")
    if bool((program.done < program.first[:-1]).any()):
        faults.append("done of the program lies before first: begin with first[:-1]")
    return faults


def _faults(spec: LoopSpec, given: Arrays, begin: int, end: int, every: int, log_begin: int) -> list[str]:
    """What may differ from call to call."""
    faults = []
    if begin < 0 or end < begin:
        faults.append(f"samples {begin} to {end}: give 0 ≤ begin ≤ end")
    if spec.stop and len(given["rows"]) > 1:
        faults.append(f"rows has {len(given['rows'])} groups: a loop that stops takes one")
    if spec.fed and given["fed"].shape[1] < end - begin:
        faults.append(f"fed has {given['fed'].shape[1]} samples: give {end - begin}")
    if every and end > begin and spec.slot:
        log = given["log"]
        if log.strides[1] != 8 * log.shape[2] * log.shape[3]:
            faults.append("the lanes of log are not one behind the other: give whole ones")
    elif every and end > begin:
        if not 0 <= log_begin <= begin or log_begin % every:
            faults.append(f"log_begin = {log_begin}: give a multiple of {every} from 0 to {begin}")
        elif (slots := (end - 1 - log_begin) // every + 1) > given["log"].shape[1]:
            faults.append(f"log has {given['log'].shape[1]} slots: give {slots}")
    if spec.rings:
        size, lengths = given["rings"].shape[1], given["ring_length"]
        if len(lengths) and (lengths.min() < 1 or lengths.max() > size):
            faults.append(f"ring_length is beyond its ring of {size} samples: give 1 to {size}")
    uniform = given["uniform"]
    if np.isnan(uniform).any():
        faults.append("uniform has NaN: give numbers")
    return faults


def _shown(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
