"""Normal random numbers of many streams side by side: those of :mod:`vsgdesign.codegen.normals`, in vectors.

The congruence of PCG64 has 128 bits, which no vector multiplies. Its product is made of those of 32 bits. One number
in 84 falls beside the inner part of its layer: a lane with such a number is looked at alone.
"""

from __future__ import annotations

import ctypes
import functools
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.machine_code import compiled
from vsgdesign.codegen.normals import BITS, MULTIPLIER, NormalStream, beside_text, fixed_places, raw_text

Floats = NDArray[np.float64]

_NAME = "many_normals"
_ARGUMENTS = (
    *("begin", "end", "columns", "row_step", "column_step"),
    *("out", "state", "first", "until", "scale", "layers", "log1p", "exp"),
)
_NUMBERS = 5
"""So many of the arguments are whole numbers, the others arrays and functions."""
_PACKED = struct.Struct(f"{len(_ARGUMENTS)}q")


class ManyNormalStreams:
    """The normal numbers of W generators, one after the other. It serves one thread."""

    def __init__(self, scale: Floats, copies: int = 1) -> None:
        """``scale`` (n, W): by what each of the n numbers in a row is multiplied. ``copies``: how often each number is
        written, in lanes beside each other: 1 or 2. Without a stream a lane draws any number."""
        self._scale, self._copies = np.array(scale, dtype=float, order="C"), copies
        lanes = scale.shape[1]
        self._state = np.zeros((4, lanes), dtype=np.uint64)
        self.first, self.until = np.zeros((2, lanes), dtype=np.int64)
        """(W,): each lane draws for the rows from ``first`` on up to before ``until``. To be set in place."""
        arrays = (one.ctypes.data for one in (self._state, self.first, self.until, self._scale))
        self._places = (*arrays, *fixed_places())

    def take(self, lane: int, stream: NormalStream) -> None:
        """The numbers of a lane are those of a stream from now on, which stays where it is."""
        self._state[:, lane] = stream.state

    def put(self, out: Floats, begin: int, end: int) -> None:
        """Puts the next numbers of each lane into its rows of ``out`` (rows, n, W or 2 W), as far as these lie from
        row ``begin`` up to before ``end``. What stands in the other rows there is then any number.

        Raises ValueError where ``out`` does not fit.
        """
        columns, lanes = self._scale.shape
        if out.shape[1:] != (columns, lanes * self._copies) or out.strides[2] != 8 or out.dtype != np.float64:
            raise ValueError(
                f"out is {out.shape} of {out.dtype}: give float64, (rows, {columns}, {lanes * self._copies})."
            )
        if not 0 <= begin <= end <= len(out):
            raise ValueError(f"rows {begin} to {end} of {len(out)}: give 0 ≤ begin ≤ end ≤ {len(out)}.")
        if begin < end and columns:
            given = begin, end, columns, out.strides[0] // 8, out.strides[1] // 8, out.ctypes.data, *self._places
            _compiled(lanes, self._copies)(_PACKED.pack(*given))


@functools.cache
def _compiled(lanes: int, copies: int) -> Any:
    return ctypes.CFUNCTYPE(None, ctypes.c_void_p)(compiled(_text(lanes, copies), _NAME))


def _vector(kind: str, lanes: int, value: int | str) -> str:
    return f"<{', '.join([f'{kind} {value}'] * lanes)}>"


def _next_text(lanes: int) -> list[str]:
    """The generators' next states ``%next_lo`` and ``%next_hi`` from ``%lo`` and ``%hi``, and their ``%bits``."""
    kind = f"<{lanes} x i64>"

    def of(value: int) -> str:
        return _vector("i64", lanes, value)

    low, high = MULTIPLIER & 0xFFFF_FFFF_FFFF_FFFF, MULTIPLIER >> 64
    half, mask = of(32), of(0xFFFF_FFFF)
    lines = [f"  %a_0 = and {kind} %lo, {mask}", f"  %a_1 = lshr {kind} %lo, {half}"]
    for k, part in enumerate((low & 0xFFFF_FFFF, low >> 32)):
        lines += [f"  %p_{j}{k} = mul {kind} %a_{j}, {of(part)}" for j in range(2)]
    return [
        *lines,
        f"  %p_00_up = lshr {kind} %p_00, {half}",
        f"  %p_01_low = and {kind} %p_01, {mask}",
        f"  %p_10_low = and {kind} %p_10, {mask}",
        f"  %middle_some = add {kind} %p_00_up, %p_01_low",
        f"  %middle = add {kind} %middle_some, %p_10_low",
        f"  %middle_up = lshr {kind} %middle, {half}",
        f"  %p_01_up = lshr {kind} %p_01, {half}",
        f"  %p_10_up = lshr {kind} %p_10, {half}",
        f"  %upper_some = add {kind} %p_01_up, %p_10_up",
        f"  %upper_more = add {kind} %p_11, %middle_up",
        f"  %upper = add {kind} %upper_some, %upper_more",
        f"  %lower_up = shl {kind} %middle, {half}",
        f"  %p_00_low = and {kind} %p_00, {mask}",
        f"  %lower = or {kind} %lower_up, %p_00_low",
        f"  %cross_lo = mul {kind} %lo, {of(high)}",
        f"  %cross_hi = mul {kind} %hi, {of(low)}",
        f"  %cross = add {kind} %cross_lo, %cross_hi",
        f"  %next_lo = add {kind} %lower, %increment_lo",
        f"  %carries = icmp ult {kind} %next_lo, %lower",
        f"  %carry = zext <{lanes} x i1> %carries to {kind}",
        f"  %hi_some = add {kind} %upper, %cross",
        f"  %hi_more = add {kind} %increment_hi, %carry",
        f"  %next_hi = add {kind} %hi_some, %hi_more",
        f"  %mixed = xor {kind} %next_hi, %next_lo",
        f"  %turn = lshr {kind} %next_hi, {of(58)}",
        f"  %bits = call {kind} @llvm.fshr.v{lanes}i64({kind} %mixed, {kind} %mixed, {kind} %turn)",
    ]


def _sized_text(kind: str, real: str, number: Any, name: str = "") -> list[str]:
    """Layer, whole number in it and sign of the raw number ``%bits``."""
    return [
        f"  %{name}layer = and {kind} %{name}bits, {number(255)}",
        f"  %{name}layer_at = shl {kind} %{name}layer, {number(2)}",
        f"  %{name}sized = lshr {kind} %{name}bits, {number(9)}",
        f"  %{name}size = and {kind} %{name}sized, {number(2**BITS - 1)}",
        f"  %{name}real = sitofp {kind} %{name}size to {real}",
        f"  %{name}signed = shl {kind} %{name}bits, {number(55)}",
        f"  %{name}sign = and {kind} %{name}signed, {number(-(2**63))}",
    ]


def _lane_text() -> list[str]:
    """What a lane draws whose number falls beside the inner part of its layer: another state, and a number."""
    return [
        "define internal double @of_lane(ptr %state, i64 %bits, ptr %layers, ptr %log1p, ptr %exp) noinline {",
        "entry:",
        "  %increment_place = getelementptr i64, ptr %state, i64 2",
        "  %increment = load i128, ptr %increment_place, align 8",
        "  br label %look",
        "look:",
        "  %now_bits = phi i64 [ %bits, %entry ], [ %next_bits, %draw ]",
        *_sized_text("i64", "double", str, "now_"),
        "  %entry_place = getelementptr i64, ptr %layers, i64 %now_layer_at",
        "  %width_place = getelementptr i64, ptr %entry_place, i64 1",
        "  %width = load double, ptr %width_place, align 8",
        "  %positive = fmul double %now_real, %width",
        "  %as_bits = bitcast double %positive to i64",
        "  %with_sign = xor i64 %as_bits, %now_sign",
        "  %x = bitcast i64 %with_sign to double",
        "  %inside = load i64, ptr %entry_place, align 8",
        "  %accepted = icmp ult i64 %now_size, %inside",
        "  br i1 %accepted, label %found, label %rare",
        "rare:",
        "  %other = call double @beside(ptr %state, ptr %entry_place, i64 %now_layer, i64 %now_size, double %x, "
        "ptr %log1p, ptr %exp)",
        "  %there = fcmp ord double %other, %other",
        "  br i1 %there, label %found, label %draw",
        "draw:",
        "  %now = load i128, ptr %state, align 8",
        *raw_text("now", "next"),
        "  store i128 %next, ptr %state, align 8",
        "  br label %look",
        "found:",
        "  %normal = phi double [ %x, %look ], [ %other, %rare ]",
        "  ret double %normal",
        "}",
    ]


def _beside_lanes_text(lanes: int) -> list[str]:
    """Each lane whose flag is set in ``%beside_bits`` draws for itself; ``%apart_0`` (3, W): states and raw numbers.

    What it draws goes into the vectors by registers: memory that is written lane by lane would be waited for.
    """
    kind, real, flags = f"<{lanes} x i64>", f"<{lanes} x double>", f"<{lanes} x i1>"
    numbers = f"<{', '.join(f'i64 {k}' for k in range(lanes))}>"
    zeros = f"<{lanes} x i32> zeroinitializer"

    def of_lane(name: str, row: int) -> list[str]:
        return [
            f"  %{name}_at = add i64 %j, {row * lanes}",
            f"  %{name}_from = getelementptr i64, ptr %apart_0, i64 %{name}_at",
            f"  %{name} = load i64, ptr %{name}_from, align 8",
        ]

    def put(name: str, one: str, of: str) -> list[str]:
        return [
            f"  %{name}_first = insertelement {of} poison, {one} %one_{name}, i64 0",
            f"  %{name}_all = shufflevector {of} %{name}_first, {of} poison, {zeros}",
            f"  %after_{name} = select {flags} %here, {of} %{name}_all, {of} %some_{name}",
        ]

    return [
        "rare:",
        *(
            f"  store {of} %{name}, ptr %apart_{row}, align 8"
            for row, (name, of) in enumerate((("next_lo", kind), ("next_hi", kind), ("bits", kind)))
        ),
        f"  %flags = zext i{lanes} %beside_bits to i64",
        "  br label %lane",
        "lane:",
        "  %left = phi i64 [ %flags, %rare ], [ %fewer, %lane ]",
        f"  %some_lo = phi {kind} [ %next_lo, %rare ], [ %after_lo, %lane ]",
        f"  %some_hi = phi {kind} [ %next_hi, %rare ], [ %after_hi, %lane ]",
        f"  %some_x = phi {real} [ %x, %rare ], [ %after_x, %lane ]",
        "  %j = call i64 @llvm.cttz.i64(i64 %left, i1 true)",
        *(line for row, name in enumerate(("old_lo", "old_hi", "bits_here")) for line in of_lane(name, row)),
        *(
            line
            for row, name in ((2, "increment_lo"), (3, "increment_hi"))
            for line in (
                f"  %{name}_at = add i64 %j, {row * lanes}",
                f"  %{name}_from = getelementptr i64, ptr %state, i64 %{name}_at",
                f"  %{name}_here = load i64, ptr %{name}_from, align 8",
            )
        ),
        *(
            f"  store i64 %{name}, ptr %own_{k}, align 8"
            for k, name in enumerate(("old_lo", "old_hi", "increment_lo_here", "increment_hi_here"))
        ),
        "  %one_x = call double @of_lane(ptr %own_0, i64 %bits_here, ptr %layers, ptr %log1p, ptr %exp)",
        "  %one_lo = load i64, ptr %own_0, align 8",
        "  %one_hi = load i64, ptr %own_1, align 8",
        f"  %j_first = insertelement {kind} poison, i64 %j, i64 0",
        f"  %j_all = shufflevector {kind} %j_first, {kind} poison, {zeros}",
        f"  %here = icmp eq {kind} %j_all, {numbers}",
        *put("lo", "i64", kind),
        *put("hi", "i64", kind),
        *put("x", "double", real),
        "  %less_one = sub i64 %left, 1",
        "  %fewer = and i64 %left, %less_one",
        "  %more = icmp ne i64 %fewer, 0",
        "  br i1 %more, label %lane, label %found",
    ]


def _text(lanes: int, copies: int) -> str:
    """The module: the function that fills, and what single lanes need."""
    kind, real, flags = f"<{lanes} x i64>", f"<{lanes} x double>", f"<{lanes} x i1>"

    def of(value: int) -> str:
        return _vector("i64", lanes, value)

    def loaded(name: str, pointer: str, row: int) -> list[str]:
        return [
            f"  %{name}_place = getelementptr i64, ptr %{pointer}, i64 {row * lanes}",
            f"  %{name} = load {kind}, ptr %{name}_place, align 8",
        ]

    def spread(name: str) -> list[str]:
        zeros = f"<{lanes} x i32> zeroinitializer"
        return [
            f"  %{name}_one = insertelement {kind} poison, i64 %{name}, i64 0",
            f"  %{name}_all = shufflevector {kind} %{name}_one, {kind} poison, {zeros}",
        ]

    def gathered(name: str, of_kind: str, suffix: str, pointers: str) -> str:
        every = _vector("i1", lanes, "true")
        call = f"@llvm.masked.gather.v{lanes}{suffix}.v{lanes}p0(<{lanes} x ptr> %{pointers}"
        return f"  %{name} = call {of_kind} {call}, i32 8, {flags} {every}, {of_kind} poison)"

    given = [
        line
        for at, name in enumerate(_ARGUMENTS)
        for line in (
            f"  %place_{name} = getelementptr i64, ptr %given, i64 {at}",
            f"  %{name} = load {'i64' if at < _NUMBERS else 'ptr'}, ptr %place_{name}",
        )
    ]
    places = [f"i32 {k // copies}" for k in range(lanes * copies)]
    pointers = f"<{lanes} x ptr>"
    lines = [
        "declare i64 @llvm.fshr.i64(i64, i64, i64)",
        "declare i64 @llvm.cttz.i64(i64, i1)",
        f"declare {kind} @llvm.fshr.v{lanes}i64({kind}, {kind}, {kind})",
        f"declare {kind} @llvm.masked.gather.v{lanes}i64.v{lanes}p0({pointers}, i32, {flags}, {kind})",
        f"declare {real} @llvm.masked.gather.v{lanes}f64.v{lanes}p0({pointers}, i32, {flags}, {real})",
        f"define void @{_NAME}(ptr %given) #0 {{",
        "entry:",
        *given,
        f"  %apart_0 = alloca i64, i64 {3 * lanes}, align 64",
        *(f"  %apart_{k} = getelementptr i64, ptr %apart_0, i64 {k * lanes}" for k in (1, 2)),
        "  %own_0 = alloca i64, i64 4, align 16",
        *(f"  %own_{k} = getelementptr i64, ptr %own_0, i64 {k}" for k in (1, 2, 3)),
        *loaded("begin_lo", "state", 0),
        *loaded("begin_hi", "state", 1),
        *loaded("increment_lo", "state", 2),
        *loaded("increment_hi", "state", 3),
        *loaded("from", "first", 0),
        *loaded("to", "until", 0),
        "  br label %row",
        "row:",
        "  %r = phi i64 [ %begin, %entry ], [ %r_next, %row_end ]",
        f"  %row_lo = phi {kind} [ %begin_lo, %entry ], [ %moved_lo, %row_end ]",
        f"  %row_hi = phi {kind} [ %begin_hi, %entry ], [ %moved_hi, %row_end ]",
        *spread("r"),
        f"  %begun = icmp sge {kind} %r_all, %from",
        f"  %going = icmp slt {kind} %r_all, %to",
        f"  %active = and {flags} %begun, %going",
        "  %row_at = mul i64 %r, %row_step",
        "  %row_place = getelementptr double, ptr %out, i64 %row_at",
        "  br label %column",
        "column:",
        "  %c = phi i64 [ 0, %row ], [ %c_next, %found ]",
        f"  %lo = phi {kind} [ %row_lo, %row ], [ %moved_lo, %found ]",
        f"  %hi = phi {kind} [ %row_hi, %row ], [ %moved_hi, %found ]",
        *_next_text(lanes),
        *_sized_text(kind, real, of),
        f"  %entries = getelementptr i64, ptr %layers, {kind} %layer_at",
        f"  %widths = getelementptr i64, {pointers} %entries, i64 1",
        gathered("inside", kind, "i64", "entries"),
        gathered("width", real, "f64", "widths"),
        f"  %positive = fmul {real} %real, %width",
        f"  %as_bits = bitcast {real} %positive to {kind}",
        f"  %with_sign = xor {kind} %as_bits, %sign",
        f"  %x = bitcast {kind} %with_sign to {real}",
        f"  %beyond = icmp sge {kind} %size, %inside",
        f"  %beside = and {flags} %beyond, %active",
        f"  %beside_bits = bitcast {flags} %beside to i{lanes}",
        f"  %none = icmp eq i{lanes} %beside_bits, 0",
        "  br i1 %none, label %found, label %rare, !prof !0",
        *_beside_lanes_text(lanes),
        "found:",
        f"  %found_lo = phi {kind} [ %next_lo, %column ], [ %after_lo, %lane ]",
        f"  %found_hi = phi {kind} [ %next_hi, %column ], [ %after_hi, %lane ]",
        f"  %normal = phi {real} [ %x, %column ], [ %after_x, %lane ]",
        f"  %moved_lo = select {flags} %active, {kind} %found_lo, {kind} %lo",
        f"  %moved_hi = select {flags} %active, {kind} %found_hi, {kind} %hi",
        f"  %scale_at = mul i64 %c, {lanes}",
        "  %scale_place = getelementptr double, ptr %scale, i64 %scale_at",
        f"  %factor = load {real}, ptr %scale_place, align 8",
        f"  %scaled = fmul {real} %normal, %factor",
        f"  %copied = shufflevector {real} %scaled, {real} poison, <{len(places)} x i32> <{', '.join(places)}>",
        "  %column_at = mul i64 %c, %column_step",
        "  %out_place = getelementptr double, ptr %row_place, i64 %column_at",
        f"  store <{len(places)} x double> %copied, ptr %out_place, align 8",
        "  %c_next = add i64 %c, 1",
        "  %more_columns = icmp slt i64 %c_next, %columns",
        "  br i1 %more_columns, label %column, label %row_end",
        "row_end:",
        "  %r_next = add i64 %r, 1",
        "  %more_rows = icmp slt i64 %r_next, %end",
        "  br i1 %more_rows, label %row, label %finish",
        "finish:",
        f"  store {kind} %moved_lo, ptr %begin_lo_place, align 8",
        f"  store {kind} %moved_hi, ptr %begin_hi_place, align 8",
        "  ret void",
        "}",
        *_lane_text(),
        *beside_text(),
        'attributes #0 = { "prefer-vector-width"="512" "min-legal-vector-width"="512" }',
        '!0 = !{!"branch_weights", i32 10, i32 1}',
        "",
    ]
    return "\n".join(lines)
