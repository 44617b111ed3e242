"""Compiled loops: many lanes through the same samples, from the plain functions of the equations.

:func:`flat_block` makes straight lines of functions, :class:`LoopSpec` says where each of their numbers comes from, and
:func:`compiled_loop` makes machine code of it. docs/theory/machine-code.md explains what is exact and what is not.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.codegen.llvm_loop import INTEGERS, NAME, POINTERS, loop_text
from vsgdesign.codegen.loop_spec import LoopSpec
from vsgdesign.execution.machine_code import compiled, instruction_set

__all__ = ["Block", "Loop", "LoopSpec", "Program", "best_lanes", "compiled_loop", "empty_rows", "flat_block"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_FLOATS, _INTEGERS = np.dtype(np.float64), np.dtype(np.int64)
_FED, _FED_SAMPLE = len(INTEGERS) + POINTERS.index("fed"), INTEGERS.index("fed_sample")
"""Places of what is fed among the arguments of the compiled function."""

_LANES = {"avx512": 8, "avx2": 4, "sse2": 2, "other": 2}


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


def best_lanes(target: str = "native") -> int:
    """Numbers in a vector register: 8 with AVX-512, 4 with AVX2, else 2."""
    return _LANES[instruction_set(target)]


def empty_rows(spec: LoopSpec, groups: int) -> Floats:
    """Zeros (G, R, L) for a loop, at an address that suits vectors."""
    shape = groups, len(spec.rows), spec.width
    count = int(np.prod(shape))
    room = np.zeros(count + 8)
    start = (-room.ctypes.data % 64) // 8
    return room[start : start + count].reshape(shape)


@functools.lru_cache(maxsize=256)
def compiled_loop(spec: LoopSpec, target: str = "native", quickly: bool = False) -> Loop:
    """The loop as machine code, compiled once a process for each processor ``target``: native, avx512, avx2 or sse2.

    ``quickly``: for a loop that runs rarely. It is compiled in a fifth of the time and takes five times as long. A
    strict loop has the same bits either way.

    Raises ValueError where the specification does not fit together or this processor cannot run the target.
    """
    kinds = [ctypes.c_int64] * len(INTEGERS) + [ctypes.c_void_p] * len(POINTERS)
    address = compiled(loop_text(spec), NAME, target, quickly)
    return Loop(spec, ctypes.CFUNCTYPE(ctypes.c_int64, *kinds)(address))


class Loop:
    """A compiled loop. Threads may call it at the same time, each with its own rows."""

    def __init__(self, spec: LoopSpec, call: Callable[..., int]) -> None:
        self.spec = spec
        self._call = call
        self._rows = len(spec.rows)
        self._checked: Integers | None = None
        """Records of the program that was checked last."""

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
        origin: int = 0,
        program: Program | None = None,
    ) -> int:
        """Moves ``rows`` (G, R, L) through samples ``begin`` to ``end`` − 1 and gives the number of samples done.

        R are the rows of ``spec.rows``, and more that a program's copies alone use; L the lanes of a group.
        ``uniform`` (n,); ``cyclic`` (period, n) and ``cycle``
        (period,), the body's number, are those of sample k % period. ``fed`` (G, end − begin, n, L) begins at sample
        ``begin``. ``rings`` (G, size, n, L) hold the last ``ring_length`` (G,) samples, sample k in slot k %
        ring_length. ``log`` (G, slots, n, L) gets samples 0, ``every``, 2·``every``, … of the run in slots 0, 1, 2, …;
        ``every`` = 0 logs nothing. ``index`` is k − ``origin``.

        Raises ValueError with everything that does not fit. The interpreter's lock is free meanwhile.
        """
        arguments = self._arguments(
            begin, end, rows, uniform, cyclic, cycle, fed, rings, ring_length, log, every, origin, program
        )
        return 0 if begin == end or not len(rows) else self._call(*arguments)

    def standing(
        self,
        rows: Floats,
        uniform: Floats,
        *,
        cyclic: Floats | None = None,
        cycle: Integers | None = None,
        log: Floats | None = None,
        every: int = 0,
    ) -> StandingLoop:
        """The loop over arrays that stay where they are: many short calls cost less."""
        nothing_fed = np.zeros((len(rows), 0, len(self.spec.fed), self.spec.width)) if self.spec.fed else None
        arguments = self._arguments(0, 0, rows, uniform, cyclic, cycle, nothing_fed, None, None, log, every, 0, None)
        slots = log.shape[1] if log is not None and every else None
        return StandingLoop(self.spec, self._call, arguments, (rows, uniform, cyclic, cycle, log), every, slots)

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
    ) -> list[int]:
        """The arguments of the compiled function, after all checks."""
        spec, given = self.spec, _Given()
        given.array("rows", rows, (None, None, spec.width))
        if rows.ndim == 3 and rows.shape[1] < self._rows:
            given.faults.append(f"rows has the shape {rows.shape}: give (any, {self._rows} or more, {spec.width})")
        groups = rows.shape[0] if rows.ndim == 3 else 0
        given.array("uniform", uniform, (len(spec.uniform),))
        period = 1
        if spec.cyclic or len(spec.bodies) > 1:
            period = len(cycle) if cycle is not None else (len(cyclic) if cyclic is not None else 0)
            given.fault(period == 0, "cyclic or cycle has no sample: give at least one")
        given.array("cyclic", cyclic, (period, len(spec.cyclic)), needed=bool(spec.cyclic))
        given.array("cycle", cycle, (period,), _INTEGERS, needed=len(spec.bodies) > 1)
        given.array("fed", fed, (groups, None, len(spec.fed), spec.width), needed=bool(spec.fed), whole=False)
        given.array("rings", rings, (groups, None, len(spec.rings), spec.width), needed=bool(spec.rings))
        given.array("ring_length", ring_length, (groups,), _INTEGERS, needed=bool(spec.rings))
        logging = bool(spec.logged) and every > 0
        given.array("log", log, (groups, None, len(spec.logged), spec.width), needed=logging, whole=False)
        if program is None:
            given.places = _no_program(groups)[0]
        else:
            if len(program.done) != groups:
                given.faults.append(f"done of the program has {len(program.done)} groups: give {groups}")
            given.program(program, rows.shape[1] if rows.ndim == 3 else 0, spec.width, program.at is not self._checked)
        given.raise_faults()
        given.ranges(begin, end, groups, spec, cycle, ring_length, every if logging else 0)
        given.fault(bool(np.isnan(uniform).any()), "uniform has NaN: give numbers")
        given.raise_faults()
        self._checked = None if program is None else program.at
        numbers = {
            "begin": begin, "end": end, "groups": groups, "rows_group": given.stride("rows", 0),
            "period": period, "fed_group": given.stride("fed", 0),
            "fed_sample": given.stride("fed", 1), "ring_size": given.length("rings"),
            "log_group": given.stride("log", 0), "log_sample": given.stride("log", 1),
            "every": every if logging else 0, "origin": origin,
        }  # fmt: skip
        return [*(numbers[name] for name in INTEGERS), *(given.address(name) for name in POINTERS)]


class StandingLoop:
    """A compiled loop over arrays that stay where they are (:meth:`Loop.standing`). It serves one thread."""

    def __init__(
        self,
        spec: LoopSpec,
        call: Callable[..., int],
        arguments: list[int],
        kept: tuple[NDArray[Any] | None, ...],
        every: int,
        slots: int | None,
    ) -> None:
        self._spec, self._call, self._given, self._kept = spec, call, arguments, kept
        self._every, self._slots = every, slots

    def __call__(self, begin: int, end: int, fed: Floats | None = None) -> int:
        """Moves the rows through samples ``begin`` to ``end`` − 1 as a call of :class:`Loop` does; one group is fed.

        Raises ValueError where the samples, the log or what is fed do not fit.
        """
        arguments, spec = self._given, self._spec
        if not 0 <= begin <= end:
            raise ValueError(f"samples {begin} to {end}: give 0 ≤ begin ≤ end.")
        if self._slots is not None and end > begin and self._slots <= (end - 1) // self._every:
            raise ValueError(f"log has {self._slots} slots: give {(end - 1) // self._every + 1}.")
        if spec.fed:
            wanted = (1, end - begin, len(spec.fed), spec.width)
            if fed is None or fed.shape != wanted or fed.dtype != np.float64 or not fed.flags.c_contiguous:
                raise ValueError(f"fed is {'missing' if fed is None else fed.shape}: give {wanted}, contiguous.")
            arguments[_FED] = fed.ctypes.data
            arguments[_FED_SAMPLE] = len(spec.fed) * spec.width
        arguments[0], arguments[1] = begin, end
        return 0 if begin == end else self._call(*arguments)


@functools.lru_cache(maxsize=64)
def _no_program(groups: int) -> tuple[dict[str, int], tuple[Integers, Integers]]:
    """Where the numbers of a program without records lie, and the arrays that hold them: no call changes them."""
    first, done = np.zeros(groups + 1, np.int64), np.zeros(groups, np.int64)
    return {"first": first.ctypes.data, "done": done.ctypes.data}, (first, done)


class _Given:
    """The arrays of a call, and what is wrong with them."""

    def __init__(self) -> None:
        self.arrays: dict[str, NDArray[Any]] = {}
        self.places: dict[str, int] = {}
        """Where arrays lie that need no look."""
        self.faults: list[str] = []

    def fault(self, there: bool, text: str) -> None:
        if there:
            self.faults.append(text)

    def raise_faults(self) -> None:
        if self.faults:
            raise ValueError("A compiled loop cannot run: " + "; ".join(self.faults) + ".")

    def array(
        self,
        name: str,
        array: NDArray[Any] | None,
        shape: tuple[int | None, ...],
        kind: Any = _FLOATS,
        *,
        needed: bool = True,
        whole: bool = True,
    ) -> None:
        """Notes an array; ``whole``: all of it is contiguous, else its last two axes are."""
        if array is None or not needed:
            if needed:
                self.faults.append(f"{name} is missing: give an array of shape {_shown(shape)}")
            return
        fits = array.ndim == len(shape) and all(n is None or n == m for n, m in zip(shape, array.shape, strict=True))
        if fits and array.dtype == kind and array.flags.c_contiguous:  # a text costs more than a check
            self.arrays[name] = array
            return
        self.fault(not fits, f"{name} has the shape {array.shape}: give {_shown(shape)}")
        self.fault(array.dtype != kind, f"{name} is of {array.dtype}: give {kind}")
        inner = array if whole or not fits or 0 in array.shape[:-2] else array[(0,) * (array.ndim - 2)]
        self.fault(not inner.flags.c_contiguous, f"{name} is not contiguous: give a copy of it")
        self.arrays[name] = array

    def program(self, program: Program, rows: int, width: int, anew: bool) -> None:
        """The program; its records only where they are given ``anew``."""
        count, groups = len(program.at), len(program.done)
        shapes = {"first": groups + 1, "done": groups} | dict.fromkeys(("at", "lane", "row", "count", "source"), count)
        for name, length in shapes.items():
            self.array(name, getattr(program, name), (length,), _INTEGERS)
        self.array("values", program.values, (len(program.values),))
        if self.faults or not count or not anew:
            return
        source = program.source
        other = np.where(source < 0, -1 - source, 0)
        outside = (
            (program.row < 0)
            | (program.row + program.count > rows)
            | (other + np.where(source < 0, program.count, 0) > rows)
        )
        outside |= (program.lane < 0) | (program.lane >= width) | (program.count < 0)
        outside |= np.where(source >= 0, source + program.count > len(program.values), False)
        self.fault(
            bool(outside.any()),
            f"record {int(np.argmax(outside))} of the program lies outside the rows, lanes or values",
        )
        inside = (program.first[0] >= 0) and (program.first[-1] <= count) and bool((np.diff(program.first) >= 0).all())
        self.fault(
            not inside, "first of the program does not lead through its records: give ascending numbers within them"
        )
        self.fault(
            bool((program.done < program.first[:-1]).any()),
            "done of the program lies before first: begin with first[:-1]",
        )

    def ranges(
        self,
        begin: int,
        end: int,
        groups: int,
        spec: LoopSpec,
        cycle: Integers | None,
        ring_length: Integers | None,
        every: int,
    ) -> None:
        self.fault(begin < 0 or end < begin, f"samples {begin} to {end}: give 0 ≤ begin ≤ end")
        self.fault(bool(spec.stop) and groups > 1, f"rows has {groups} groups: a loop that stops takes one")
        if spec.fed and self.arrays["fed"].shape[1] < end - begin:
            self.faults.append(f"fed has {self.arrays['fed'].shape[1]} samples: give {end - begin}")
        if every and end > begin and self.arrays["log"].shape[1] <= (end - 1) // every:
            self.faults.append(f"log has {self.arrays['log'].shape[1]} slots: give {(end - 1) // every + 1}")
        if spec.rings and ring_length is not None and groups:
            size = self.arrays["rings"].shape[1]
            wrong = bool((ring_length < 1).any() or (ring_length > size).any())
            self.fault(wrong, f"ring_length is beyond its ring of {size} samples: give 1 to {size}")
        if len(spec.bodies) > 1 and cycle is not None and len(cycle):
            wrong = bool((cycle < 0).any() or (cycle >= len(spec.bodies)).any())
            self.fault(wrong, f"cycle names a body that is not there: give 0 to {len(spec.bodies) - 1}")

    def length(self, name: str) -> int:
        """Samples that an array of groups has."""
        return self.arrays[name].shape[1] if name in self.arrays else 0

    def stride(self, name: str, axis: int) -> int:
        """Doubles from one entry to the next."""
        return self.arrays[name].strides[axis] // 8 if name in self.arrays else 0

    def address(self, name: str) -> int:
        """Where an array lies; 0 where there is none."""
        return self.arrays[name].ctypes.data if name in self.arrays else self.places.get(name, 0)


def _shown(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
