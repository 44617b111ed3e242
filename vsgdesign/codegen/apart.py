"""Machine code that takes the columns of a log apart: from all lanes sample by sample to each lane in one piece."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.machine_code import compiled

Floats = NDArray[np.float64]


class TakenApart:
    """Columns of the rows (n, m, L) of a log, written into arrays (lanes, slots) that stay where they are."""

    def __init__(self, columns: Sequence[int], into: Sequence[Floats], width: int, target: str = "native") -> None:
        """``columns``: which column of the rows goes into which array. ``width``: L, a power of two, of which the first
        lanes are taken, as many as the arrays have.

        Raises ValueError for arrays that are not alike or do not lie in one piece.
        """
        lanes, self._slots = into[0].shape
        alike = all(one.shape == (lanes, self._slots) and one.flags.c_contiguous for one in into)
        if not alike or len(columns) != len(into) or not 0 < lanes <= width or width & (width - 1):
            raise ValueError(
                f"columns {list(columns)} into arrays {[one.shape for one in into]} of {width} lanes: give one array "
                "(lanes, slots) for each column, in one piece, and as many lanes as a power of two has at most."
            )
        self._kept, self._width = tuple(into), width
        self._offset = np.array([column * width for column in columns], dtype=np.int64)
        self._base = np.array([one.ctypes.data for one in into], dtype=np.int64)
        self._least = max(columns) + 1
        self._call = _function(width, target)
        self._fixed = self._offset.ctypes.data, self._base.ctypes.data, len(into), self._slots, lanes - 1

    def take(self, first: int, rows: Floats) -> None:
        """The rows (n, m, L) go into slots ``first`` to ``first`` + n − 1. Raises ValueError where they do not fit."""
        n, m, width = rows.shape
        whole = rows.strides[1:] == (8 * width, 8) and rows.dtype == np.float64
        if width != self._width or m < self._least or not whole or not 0 <= first <= first + n <= self._slots:
            raise ValueError(f"rows {rows.shape} from slot {first} on: {self._slots} slots have {self._width} lanes.")
        self._call(rows.ctypes.data, rows.strides[0] // 8, n, first, *self._fixed)


@functools.cache
def _function(width: int, target: str) -> Callable[..., None]:
    address = compiled(_text(width), "apart", target)
    kinds = [ctypes.c_void_p, *[ctypes.c_int64] * 3, ctypes.c_void_p, ctypes.c_void_p, *[ctypes.c_int64] * 3]
    return ctypes.CFUNCTYPE(None, *kinds)(address)


def _text(width: int) -> str:
    """Column by column: blocks of as many rows as there are lanes are transposed in registers, the others one by one.

    Lanes beyond the last one write to its place before it does, so that nothing is asked in the loop.
    """
    vector = f"<{width} x double>"
    head = "ptr %src, i64 %row, i64 %n, i64 %first, ptr %offset, ptr %base, i64 %columns, i64 %slots, i64 %last"
    places = [
        line
        for lane in reversed(range(width))
        for line in (
            f"  %least{lane} = icmp ult i64 {lane}, %last",
            f"  %lane{lane} = select i1 %least{lane}, i64 {lane}, i64 %last",
            f"  %far{lane} = mul i64 %lane{lane}, %slots",
            f"  %to{lane} = add i64 %far{lane}, %first",
        )
    ]
    return "\n".join(
        [
            f"define void @apart({head}) #0 {{",
            "entry:",
            f"  %rest = urem i64 %n, {width}",
            "  %whole = sub i64 %n, %rest",
            *places,
            "  br label %column",
            "column:",
            "  %c = phi i64 [0, %entry], [%c.next, %column.end]",
            "  %c.more = icmp ult i64 %c, %columns",
            "  br i1 %c.more, label %column.begin, label %exit",
            "column.begin:",
            "  %offset.at = getelementptr i64, ptr %offset, i64 %c",
            "  %off = load i64, ptr %offset.at",
            "  %base.at = getelementptr ptr, ptr %base, i64 %c",
            "  %dst = load ptr, ptr %base.at",
            "  %from = getelementptr double, ptr %src, i64 %off",
            *(f"  %dst{lane} = getelementptr double, ptr %dst, i64 %to{lane}" for lane in range(width)),
            "  br label %block",
            "block:",
            "  %b = phi i64 [0, %column.begin], [%b.next, %block.body]",
            "  %b.more = icmp ult i64 %b, %whole",
            "  br i1 %b.more, label %block.body, label %one",
            "block.body:",
            *_block(width, vector),
            f"  %b.next = add i64 %b, {width}",
            "  br label %block",
            "one:",
            "  %k = phi i64 [%whole, %block], [%k.next, %one.body]",
            "  %k.more = icmp ult i64 %k, %n",
            "  br i1 %k.more, label %one.body, label %column.end",
            "one.body:",
            "  %k.row = mul i64 %k, %row",
            "  %k.from = getelementptr double, ptr %from, i64 %k.row",
            *(line for lane in reversed(range(width)) for line in _single(lane)),
            "  %k.next = add i64 %k, 1",
            "  br label %one",
            "column.end:",
            "  %c.next = add i64 %c, 1",
            "  br label %column",
            "exit:",
            "  ret void",
            "}",
            'attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }',
            "",
        ]
    )


def _block(width: int, vector: str) -> list[str]:
    """Rows become lanes: in each step two vectors exchange the lanes whose number has one bit that their own lacks."""
    lines = []
    for row in range(width):
        lines += [
            f"  %at{row} = add i64 %b, {row}",
            f"  %row{row} = mul i64 %at{row}, %row",
            f"  %p{row} = getelementptr double, ptr %from, i64 %row{row}",
            f"  %v0.{row} = load {vector}, ptr %p{row}, align 8",
        ]
    step, bit = 0, 1
    while bit < width:
        for low in (row for row in range(width) if not row & bit):
            high = low | bit
            pair = f"{vector} %v{step}.{low}, {vector} %v{step}.{high}"
            to_low = [lane if not lane & bit else width + (lane ^ bit) for lane in range(width)]
            to_high = [lane ^ bit if not lane & bit else width + lane for lane in range(width)]
            for name, mask in ((low, to_low), (high, to_high)):
                chosen = ", ".join(f"i32 {lane}" for lane in mask)
                lines.append(f"  %v{step + 1}.{name} = shufflevector {pair}, <{width} x i32> <{chosen}>")
        step, bit = step + 1, 2 * bit
    for lane in reversed(range(width)):
        lines += [
            f"  %q{lane} = getelementptr double, ptr %dst{lane}, i64 %b",
            f"  store {vector} %v{step}.{lane}, ptr %q{lane}, align 8",
        ]
    return lines


def _single(lane: int) -> list[str]:
    return [
        f"  %s{lane} = getelementptr double, ptr %k.from, i64 {lane}",
        f"  %x{lane} = load double, ptr %s{lane}",
        f"  %t{lane} = getelementptr double, ptr %dst{lane}, i64 %k",
        f"  store double %x{lane}, ptr %t{lane}",
    ]
