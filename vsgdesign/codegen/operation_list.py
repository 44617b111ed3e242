"""Machine code that does a list of operations for several lanes: for functions that are too long to be compiled.

LLVM takes 10 s for a straight line of 40,000 operations, and more than in proportion for more of them. A list of them
is data, which is there at once.
Operations of one kind that do not depend on each other stand together, so that each kind is one short loop; and every
operation is done for all lanes, so that reading the list takes no longer than the arithmetic. Each operation rounds by
itself. In which order independent ones are done changes no bit.
"""

from __future__ import annotations

import ctypes
import functools
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import aligned_zeros
from vsgdesign.codegen.machine_code import compiled

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]

LANES = 8
"""Lanes of a list: one register of AVX-512, or several smaller ones."""

_V, _FLAGS, _ZERO = f"<{LANES} x double>", f"<{LANES} x i1>", "zeroinitializer"
_ONE, _MINUS_ONE = (f"<{', '.join([f'double {value}'] * LANES)}>" for value in (1.0, -1.0))


def _chosen(flag: str, yes: str, no: str) -> str:
    return f"%r = select {_FLAGS} {flag}, {_V} {yes}, {_V} {no}"


def _compared(how: str, other: str = "%y") -> list[str]:
    return [f"%flag = fcmp {how} {_V} %x, {other}", _chosen("%flag", _ONE, _ZERO)]


def _joined(how: str) -> list[str]:
    both = [f"%{one}.true = fcmp une {_V} %{one}, {_ZERO}" for one in "xy"]
    return [*both, f"%flag = {how} {_FLAGS} %x.true, %y.true", _chosen("%flag", _ONE, _ZERO)]


def _one_of_two(how: str) -> list[str]:
    """As fmin and fmax of C: the other one where one is not a number."""
    flags = [f"%than = fcmp {how} {_V} %x, %y", f"%none = fcmp uno {_V} %y, %y"]
    return [*flags, f"%flag = or {_FLAGS} %than, %none", _chosen("%flag", "%x", "%y")]


_INTRINSICS = ("sqrt", "fabs", "floor", "ceil")
_ARITHMETIC: dict[str, list[str]] = {
    **{name: [f"%r = f{name} {_V} %x, %y"] for name in ("mul", "add", "sub", "div")},
    "neg": [f"%r = fneg {_V} %x"],
    **{name: [f"%r = call {_V} @llvm.{name}.v{LANES}f64({_V} %x)"] for name in _INTRINSICS},
    "sign": [
        f"%above = fcmp ogt {_V} %x, {_ZERO}",
        f"%below = fcmp olt {_V} %x, {_ZERO}",
        f"%least = select {_FLAGS} %below, {_V} {_MINUS_ONE}, {_V} %x",
        _chosen("%above", _ONE, "%least"),
    ],
    "fmin": _one_of_two("olt"),
    "fmax": _one_of_two("ogt"),
    **{name: _compared(how) for name, how in {"lt": "olt", "le": "ole", "eq": "oeq", "ne": "une"}.items()},
    "not": _compared("oeq", _ZERO),
    "and": _joined("and"),
    "or": _joined("or"),
    "if_else_zero": [f"%flag = fcmp une {_V} %x, {_ZERO}", _chosen("%flag", "%y", _ZERO)],
}
"""What is done with the operands %x and %y, as LLVM's text. Flags are 1 and 0."""

_OF_ONE = (
    "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh",
    "exp", "expm1", "log", "log1p", "erf",
)  # fmt: skip
_OF_TWO = ("atan2", "pow", "fmod", "hypot", "copysign")
_LIBRARY = (*_OF_ONE, *_OF_TWO)
"""Functions of C's library, which take one lane after the other."""

OPERATIONS = (*_ARITHMETIC, *_LIBRARY)
"""What a list can do, by name."""


class OperationList:
    """A list of operations for lanes side by side.

    Values are numbered: inputs, then constants, then the result of each operation in its turn.
    """

    def __init__(
        self,
        inputs: int,
        constants: Sequence[float],
        names: Sequence[str],
        operands: Sequence[tuple[int, int]] | NDArray[np.int64],
        outputs: Sequence[int],
    ) -> None:
        """``names`` of :data:`OPERATIONS`; ``operands``: the numbers of the values that each takes, any number in place
        of a second one that it does not take. ``outputs``: the values that are wanted.

        Raises ValueError for an operation that there is not, and for an operand that is not there before it.
        """
        first = inputs + len(constants)
        unknown = sorted(set(names) - set(OPERATIONS))
        if unknown:
            raise ValueError(f"a list has no operation {', '.join(unknown)}; it has {', '.join(OPERATIONS)}.")
        taken = np.array(operands, dtype=np.int32).reshape(-1, 2)
        after = np.arange(first, first + len(taken))
        if len(names) != len(taken) or (taken < 0).any() or (taken >= after[:, None]).any():
            raise ValueError("an operation takes a value that is not there before it.")
        code_of = {name: code for code, name in enumerate(OPERATIONS)}
        codes = np.array([code_of[name] for name in names], dtype=np.int32)
        order = np.lexsort((codes, _levels(taken, first)))
        places, count = _places(taken, order, first, outputs)
        self._list = np.ascontiguousarray(
            np.column_stack([places[first + order], places[taken[order]].reshape(-1, 2)]), dtype=np.int32
        )
        begins = np.flatnonzero(np.diff(codes[order], prepend=-1))
        lengths = np.diff(np.append(begins, len(order)))
        self._runs = np.ascontiguousarray(np.column_stack([codes[order][begins], lengths]), dtype=np.int32)
        self.inputs, self._first, self._count = inputs, first, count
        """How many inputs there are."""
        self._constants = np.array(constants, dtype=float)[:, None]
        self._outputs = places[np.array(outputs, dtype=np.int64)]
        self._rooms: list[Floats] = []

    def run(self, inputs: Floats) -> Floats:
        """Does all operations with inputs (inputs, LANES); the outputs (outputs, LANES)."""
        try:
            values = self._rooms.pop()  # no other thread has this one
        except IndexError:
            values = aligned_zeros((self._count, LANES))
            values[self.inputs : self._first] = self._constants
        values[: self.inputs] = inputs
        given = self._runs, self._list, values, _library()
        _function()(len(self._runs), *(one.ctypes.data for one in given))
        found = values[self._outputs]
        self._rooms.append(values)
        return found

    def of_points(self, points: Floats) -> Floats:
        """The outputs (N, outputs) of N points (N, inputs)."""
        found = np.empty((len(points), len(self._outputs)))
        lanes = np.empty((self.inputs, LANES))
        for begin in range(0, len(points), LANES):
            part = points[begin : begin + LANES]
            lanes[:, : len(part)] = part.T
            lanes[:, len(part) :] = part[:1].T  # a lane without a point does what is done anyway
            found[begin : begin + LANES] = self.run(lanes)[:, : len(part)].T
        return found


def _levels(taken: Integers, first: int) -> Integers:
    """When each operation is done at the latest, counted from the end: few values have to be kept then."""
    found = [0] * (first + len(taken))
    pairs = taken.tolist()
    for number in range(len(pairs) - 1, -1, -1):
        before = found[first + number] - 1
        for value in pairs[number]:
            if found[value] > before:
                found[value] = before
    return np.array(found[first:], dtype=np.int32)


def _places(taken: Integers, order: NDArray[np.int64], first: int, outputs: Sequence[int]) -> tuple[Integers, int]:
    """Where each value stands, and the number of places: that of a value which nobody takes any more is free."""
    turns = np.empty(len(order), dtype=np.int64)
    turns[order] = np.arange(len(order))
    last = np.full(first + len(order), -1, dtype=np.int64)
    for column in taken.T:
        np.maximum.at(last, column, turns)
    last[:first] = len(order)
    last[np.array(outputs, dtype=np.int64)] = len(order)
    until, pairs = last.tolist(), taken.tolist()
    places, free, count = list(range(first)) + [0] * len(order), list[int](), first
    for turn, number in enumerate(order.tolist()):
        for value in set(pairs[number]):
            if until[value] == turn:
                free.append(places[value])
        if not free:
            free.append(count)
            count += 1
        places[first + number] = free.pop()
        if until[first + number] < 0:
            free.append(places[first + number])  # nobody asks for it
    return np.array(places, dtype=np.int32), count


@functools.cache
def _function() -> Callable[..., None]:
    kinds = [ctypes.c_int64, *[ctypes.c_void_p] * 4]
    return ctypes.CFUNCTYPE(None, *kinds)(compiled(_text(), "operations"))


@functools.cache
def _library() -> NDArray[np.int64]:
    """Addresses of C's functions."""
    library: Any = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    return np.array([ctypes.cast(getattr(library, name), ctypes.c_void_p).value for name in _LIBRARY], dtype=np.int64)


def _text() -> str:
    """Run after run, each in the loop of its operation."""
    cases = " ".join(f"i32 {code}, label %{name}" for code, name in enumerate(OPERATIONS))
    lines = [
        *(f"declare {_V} @llvm.{name}.v{LANES}f64({_V})" for name in _INTRINSICS),
        "define void @operations(i64 %runs, ptr %run.first, ptr %list, ptr %values, ptr %library) #0 {",
        "entry:",
        "  br label %head",
        "head:",
        "  %n = phi i64 [ 0, %entry ], [ %n.next, %done ]",
        "  %begin = phi i64 [ 0, %entry ], [ %end, %done ]",
        "  %more = icmp ult i64 %n, %runs",
        "  br i1 %more, label %read, label %exit",
        "read:",
        "  %run = getelementptr [2 x i32], ptr %run.first, i64 %n",
        "  %code = load i32, ptr %run",
        "  %length.at = getelementptr i32, ptr %run, i64 1",
        "  %length.short = load i32, ptr %length.at",
        "  %length = zext i32 %length.short to i64",
        "  %end = add i64 %begin, %length",
        f"  switch i32 %code, label %exit [ {cases} ]",
    ]
    for code, name in enumerate(OPERATIONS):
        own = _ARITHMETIC.get(name) or _lane_by_lane(code - len(_ARITHMETIC), 1 if name in _OF_ONE else 2)
        lines += [f"{name}:", "  br label %NAME.next".replace("NAME", name), f"{name}.next:"]
        lines += [f"  {line}" for line in _own_names([*_OPERANDS, *own, *_STORED], name)]
        lines += [f"  br i1 %more.{name}, label %{name}.next, label %done"]
    return "\n".join(
        [
            *lines,
            "done:",
            "  %n.next = add i64 %n, 1",
            "  br label %head",
            "exit:",
            "  ret void",
            "}",
            'attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }',
            "",
        ]
    )


_OPERANDS = [
    "%k = phi i64 [ %begin, %NAME ], [ %next, %NAME.next ]",
    "%at = getelementptr [3 x i32], ptr %list, i64 %k",
    *(
        line
        for place, name in enumerate(("into", "x", "y"))
        for line in (
            f"%at.{name} = getelementptr i32, ptr %at, i64 {place}",
            f"%short.{name} = load i32, ptr %at.{name}",
            f"%wide.{name} = zext i32 %short.{name} to i64",
            f"%ptr.{name} = getelementptr {_V}, ptr %values, i64 %wide.{name}",
        )
    ),
    f"%x = load {_V}, ptr %ptr.x, align 64",
    f"%y = load {_V}, ptr %ptr.y, align 64",
]
_STORED = [
    f"store {_V} %r, ptr %ptr.into, align 64",
    "%next = add i64 %k, 1",
    "%more = icmp ult i64 %next, %end",
]
_SHARED = ("values", "list", "library", "begin", "end")


def _own_names(lines: Sequence[str], name: str) -> list[str]:
    """Lines of LLVM's text whose names are those of one operation."""

    def own(match: re.Match[str]) -> str:
        return match[0] if match[1] in _SHARED or match[1].startswith("NAME") else f"{match[0]}.{name}"

    return [re.sub(r"%([\w.]+)", own, line).replace("NAME", name) for line in lines]


def _lane_by_lane(number: int, operands: int) -> list[str]:
    """Calls of a function of C's library."""
    lines = [f"%function.at = getelementptr ptr, ptr %library, i64 {number}", "%function = load ptr, ptr %function.at"]
    whole = "poison"
    for lane in range(LANES):
        for one in "xy"[:operands]:
            lines.append(f"%{one}{lane} = extractelement {_V} %{one}, i64 {lane}")
        given = ", ".join(f"double %{one}{lane}" for one in "xy"[:operands])
        into = "%r" if lane == LANES - 1 else f"%r{lane}"
        lines += [
            f"%of{lane} = call double %function({given})",
            f"{into} = insertelement {_V} {whole}, double %of{lane}, i64 {lane}",
        ]
        whole = into
    return lines
