"""Normal random numbers with the streams of NumPy, written where they are needed.

The raw numbers are those of NumPy's PCG64 (O'Neill 2014), and so is the way from them to normal numbers, the ziggurat
of 256 layers (Marsaglia and Tsang 2000). The numbers of a seed are therefore those of ``Generator.standard_normal``
but for 2e-14 of each, because the layers are computed here with all their digits. A compiled function draws and scales
the numbers and puts each into its place, in half of the time that NumPy takes to draw them alone.
"""

from __future__ import annotations

import ctypes
import functools
import struct
import sys
from decimal import Decimal, localcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm_values import bits_of
from vsgdesign.codegen.machine_code import compiled

Floats = NDArray[np.float64]

LAYERS = 256
TAIL = "3.6541528853610087963519472518"
"""Where the lowest layer ends and the tail of the distribution begins."""
AREA = "0.00492867323397465493159091343185"
"""Of each layer, the tail being part of the lowest: TAIL·f(TAIL) + ∫ f from TAIL on, with f(x) = exp(−x²/2)."""
BITS = 52

MULTIPLIER = 0x2360ED051FC65DA44385DF649FCCF645
"""Of PCG64's congruence."""

_NAME = "normals"
_ARGUMENTS = ("state", "out", "rows", "columns", "row_step", "column_step", "scale", "layers", "log1p", "exp")
_PACKED = struct.Struct(f"{len(_ARGUMENTS)}q")


class NormalStream:
    """The normal numbers of a bit generator, one after the other. It serves one thread."""

    def __init__(self, bits: np.random.BitGenerator) -> None:
        """``bits``: a PCG64, which stays as it is. Raises ValueError for any other."""
        found: Any = bits.state
        if found["bit_generator"] != "PCG64":
            raise ValueError(f"bits is a {found['bit_generator']}: give a PCG64.")
        whole = found["state"]["state"], found["state"]["inc"]
        words = [number >> shift & 0xFFFF_FFFF_FFFF_FFFF for number in whole for shift in (0, 64)]
        self.state = np.array(words, dtype=np.uint64)
        """Of the generator now, and its increment: two words each, the lower one first."""

    def put(self, out: Floats, scale: Floats) -> None:
        """Puts the next numbers, row after row, each times the ``scale`` (n,) of its column, into ``out`` (m, n), which
        may lie anywhere."""
        rows, columns = out.shape
        steps = out.strides[0] // 8, out.strides[1] // 8
        if (out.dtype, scale.dtype, scale.shape) != (np.float64, np.float64, (columns,)) or scale.strides != (8,):
            raise ValueError(f"out is {out.shape} of {out.dtype}, scale {scale.shape}: give float64, and (n,).")
        if rows and columns:
            state, to, of = self.state.ctypes.data, out.ctypes.data, scale.ctypes.data
            _compiled()(_PACKED.pack(state, to, rows, columns, *steps, of, *fixed_places()))

    def skip(self, count: int) -> None:
        """Goes past so many numbers."""
        if count:
            nowhere = np.zeros(1)
            self.put(np.lib.stride_tricks.as_strided(nowhere, (count, 1), (0, 0)), np.zeros(1))


@functools.cache
def layers() -> NDArray[np.void]:
    """The ziggurat: of each layer the limit of the whole numbers that are surely inside it, its width over 2^52, and
    the density at its upper and its lower edge. Every value is rounded once."""
    found = np.zeros(LAYERS, dtype=[("inside", np.int64), ("width", float), ("upper", float), ("lower", float)])
    with localcontext() as context:
        context.prec = 40
        edge, area, whole = Decimal(TAIL), Decimal(AREA), Decimal(2**BITS)

        def density(x: Decimal) -> Decimal:
            return (-x * x / 2).exp()

        lowest = area / density(edge)  # as wide as a rectangle of this area would be
        edges = [lowest, *([edge] * (LAYERS - 1))]
        for k in range(LAYERS - 2, 0, -1):
            edges[k] = (-2 * (area / edges[k + 1] + density(edges[k + 1])).ln()).sqrt()
        heights = [Decimal(1), *map(density, edges[1:])]
        found["width"] = [float(one / whole) for one in edges]
        found["lower"] = [float(one) for one in heights]
        found["upper"][1:] = found["lower"][:-1]
        found["inside"][0], found["inside"][1] = int(edge / lowest * whole), 0
        found["inside"][2:] = [int(edges[k - 1] / edges[k] * whole) for k in range(2, LAYERS)]
    return found


@functools.cache
def fixed_places() -> tuple[int, int, int]:
    """Where the layers lie, and two functions of the C library."""
    library = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    functions = (ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0 for name in ("log1p", "exp"))
    return (layers().ctypes.data, *functions)  # type: ignore[return-value]


@functools.cache
def _compiled() -> Any:
    return ctypes.CFUNCTYPE(None, ctypes.c_void_p)(compiled(_text(), _NAME))


def raw_text(of: str, to: str) -> list[str]:
    """The generator's next state ``%{to}`` from ``%{of}``, and its number ``%{to}_bits``."""
    return [
        f"  %{to}_times = mul i128 %{of}, {MULTIPLIER}",
        f"  %{to} = add i128 %{to}_times, %increment",
        f"  %{to}_lo = trunc i128 %{to} to i64",
        f"  %{to}_shifted = lshr i128 %{to}, 64",
        f"  %{to}_hi = trunc i128 %{to}_shifted to i64",
        f"  %{to}_mixed = xor i64 %{to}_hi, %{to}_lo",
        f"  %{to}_turn = lshr i64 %{to}_hi, 58",
        f"  %{to}_bits = call i64 @llvm.fshr.i64(i64 %{to}_mixed, i64 %{to}_mixed, i64 %{to}_turn)",
    ]


def _uniform(of: str, to: str) -> list[str]:
    """The same, and its number in [0, 1), ``%{to}_u``."""
    return [
        *raw_text(of, to),
        f"  %{to}_53 = lshr i64 %{to}_bits, 11",
        f"  %{to}_whole = uitofp i64 %{to}_53 to double",
        f"  %{to}_u = fmul double %{to}_whole, {bits_of(2.0**-53)}",
    ]


def _text() -> str:
    """The module: the function that fills, and the one for what falls beside the inner part of a layer (1.2 %)."""
    given = [
        line
        for at, name in enumerate(_ARGUMENTS)
        for line in (
            f"  %place_{name} = getelementptr i64, ptr %given, i64 {at}",
            f"  %{name} = load {'i64' if name in _ARGUMENTS[2:6] else 'ptr'}, ptr %place_{name}",
        )
    ]
    lines = [
        "declare i64 @llvm.fshr.i64(i64, i64, i64)",
        f"define void @{_NAME}(ptr %given) {{",
        "entry:",
        *given,
        "  %increment_place = getelementptr i64, ptr %state, i64 2",
        "  %increment = load i128, ptr %increment_place, align 8",
        "  %begin = load i128, ptr %state, align 8",
        "  br label %row",
        "row:",
        "  %r = phi i64 [ 0, %entry ], [ %r_next, %row_end ]",
        "  %of_row = phi i128 [ %begin, %entry ], [ %moved, %row_end ]",
        "  %row_at = mul i64 %r, %row_step",
        "  %row_place = getelementptr double, ptr %out, i64 %row_at",
        "  br label %column",
        "column:",
        "  %c = phi i64 [ 0, %row ], [ %c_next, %found ]",
        "  %of_column = phi i128 [ %of_row, %row ], [ %moved, %found ]",
        "  br label %draw",
        "draw:",
        "  %now = phi i128 [ %of_column, %column ], [ %after, %rare ]",
        *raw_text("now", "next"),
        "  %layer = and i64 %next_bits, 255",
        "  %layer_at = shl i64 %layer, 2",
        "  %entry_place = getelementptr i64, ptr %layers, i64 %layer_at",
        "  %sized = lshr i64 %next_bits, 9",
        f"  %size = and i64 %sized, {2**BITS - 1}",
        "  %width_place = getelementptr i64, ptr %entry_place, i64 1",
        "  %width = load double, ptr %width_place, align 8",
        "  %real = sitofp i64 %size to double",
        "  %positive = fmul double %real, %width",
        "  %signed = shl i64 %next_bits, 55",
        "  %sign = and i64 %signed, -9223372036854775808",
        "  %as_bits = bitcast double %positive to i64",
        "  %with_sign = xor i64 %as_bits, %sign",
        "  %x = bitcast i64 %with_sign to double",
        "  %inside = load i64, ptr %entry_place, align 8",
        "  %accepted = icmp ult i64 %size, %inside",
        "  br i1 %accepted, label %found, label %rare, !prof !0",
        "rare:",
        "  store i128 %next, ptr %state, align 8",
        "  %other = call double @beside(ptr %state, ptr %entry_place, i64 %layer, i64 %size, double %x, ptr %log1p, "
        "ptr %exp)",
        "  %after = load i128, ptr %state, align 8",
        "  %there = fcmp ord double %other, %other",
        "  br i1 %there, label %found, label %draw",
        "found:",
        "  %moved = phi i128 [ %next, %draw ], [ %after, %rare ]",
        "  %normal = phi double [ %x, %draw ], [ %other, %rare ]",
        "  %scale_place = getelementptr double, ptr %scale, i64 %c",
        "  %factor = load double, ptr %scale_place, align 8",
        "  %scaled = fmul double %normal, %factor",
        "  %column_at = mul i64 %c, %column_step",
        "  %to = getelementptr double, ptr %row_place, i64 %column_at",
        "  store double %scaled, ptr %to, align 8",
        "  %c_next = add i64 %c, 1",
        "  %more_columns = icmp slt i64 %c_next, %columns",
        "  br i1 %more_columns, label %column, label %row_end",
        "row_end:",
        "  %r_next = add i64 %r, 1",
        "  %more_rows = icmp slt i64 %r_next, %rows",
        "  br i1 %more_rows, label %row, label %finish",
        "finish:",
        "  store i128 %moved, ptr %state, align 8",
        "  ret void",
        "}",
        *beside_text(),
        '!0 = !{!"branch_weights", i32 100, i32 1}',
        "",
    ]
    return "\n".join(lines)


def beside_text() -> list[str]:
    """The function for what falls beside the inner part of a layer: a number, or NaN where another one is needed."""
    tail, back = bits_of(float(TAIL)), bits_of(-1.0 / float(TAIL))
    return [
        "define internal double @beside(ptr %state, ptr %entry_place, i64 %layer, i64 %size, double %x, ptr %log1p, "
        "ptr %exp) noinline {",
        "entry:",
        "  %increment_place = getelementptr i64, ptr %state, i64 2",
        "  %increment = load i128, ptr %increment_place, align 8",
        "  %begin = load i128, ptr %state, align 8",
        "  %lowest = icmp eq i64 %layer, 0",
        "  br i1 %lowest, label %tail, label %edge",
        "edge:",
        *_uniform("begin", "edged"),
        "  store i128 %edged, ptr %state, align 8",
        "  %upper_place = getelementptr i64, ptr %entry_place, i64 2",
        "  %upper = load double, ptr %upper_place, align 8",
        "  %lower_place = getelementptr i64, ptr %entry_place, i64 3",
        "  %lower = load double, ptr %lower_place, align 8",
        "  %height = fsub double %upper, %lower",
        "  %share = fmul double %height, %edged_u",
        "  %above = fadd double %share, %lower",
        f"  %half = fmul double %x, {bits_of(-0.5)}",
        "  %squared = fmul double %half, %x",
        "  %density = call double %exp(double %squared)",
        "  %under = fcmp olt double %above, %density",
        "  %kept = select i1 %under, double %x, double 0x7FF8000000000000",
        "  ret double %kept",
        "tail:",
        "  %again = phi i128 [ %begin, %entry ], [ %second, %tail ]",
        *_uniform("again", "first"),
        "  %minus_first = fneg double %first_u",
        "  %log_first = call double %log1p(double %minus_first)",
        f"  %beyond = fmul double %log_first, {back}",
        *_uniform("first", "second"),
        "  %minus_second = fneg double %second_u",
        "  %log_second = call double %log1p(double %minus_second)",
        "  %minus_twice = fadd double %log_second, %log_second",
        "  %twice = fneg double %minus_twice",
        "  %beyond_squared = fmul double %beyond, %beyond",
        "  %fits = fcmp ogt double %twice, %beyond_squared",
        "  br i1 %fits, label %told, label %tail",
        "told:",
        "  store i128 %second, ptr %state, align 8",
        f"  %far = fadd double %beyond, {tail}",
        "  %sized = lshr i64 %size, 8",
        "  %odd = and i64 %sized, 1",
        "  %negative = icmp eq i64 %odd, 1",
        "  %minus_far = fneg double %far",
        "  %end = select i1 %negative, double %minus_far, double %far",
        "  ret double %end",
        "}",
    ]
