"""A matrix times numbers of the state as LLVM's text: loops over the columns, some rows at a time."""

from __future__ import annotations

from vsgdesign.codegen.llvm_values import Printer
from vsgdesign.codegen.loop_spec import LoopSpec

_REGISTERS = 8
"""Sums that are under way at once: while one waits for its last addition, the others go on."""

_ROWS = 8
"""Rows in one register of a loop with one lane, where the numbers of a column lie beside each other."""


def product_lines(spec: LoopSpec, printer: Printer) -> list[str]:
    """The text that fills ``%products``, at the beginning of a sample. It ends within a block that goes on."""
    text, done = [], 0
    for number, product in enumerate(spec.products):
        height = len(product.results)
        matrix, factors = spec.rows.index(product.matrix[0]), spec.rows.index(product.factors[0])
        base = "%base"
        if product.turns > 1:
            base, size = f"%base_{number}", height * len(product.factors) * spec.width
            text += [
                f"  %turned_{number} = mul i64 %turn, {size}",
                f"  {base} = getelementptr double, ptr %base, i64 %turned_{number}",
            ]
        step = _ROWS if spec.width == 1 else 1
        parts = [(at, min(step, height - at)) for at in range(0, height, step)]
        for first in range(0, len(parts), _REGISTERS):
            text += _columns(
                spec, printer, f"{number}_{first}", parts[first : first + _REGISTERS], matrix, factors, height,
                len(product.factors), done, base,
            )  # fmt: skip
        done += height
    return text


def _columns(
    spec: LoopSpec,
    printer: Printer,
    name: str,
    parts: list[tuple[int, int]],
    matrix: int,
    factors: int,
    height: int,
    columns: int,
    done: int,
    base: str,
) -> list[str]:
    """The loop over the columns for some parts of them: (first row, rows). ``done``: results of earlier products;
    ``base``: where the rows begin of which the matrix is one."""
    width, flags = spec.width, printer.flags
    before, head, tail = f"%before_{name}", f"column_{name}", f"columns_{name}"
    text = [
        f"  br label {before}",
        f"{before[1:]}:",
        f"  br label %{head}",
        f"{head}:",
        f"  %c_{name} = phi i64 [ 0, {before} ], [ %c_next_{name}, %{head} ]",
    ]
    sums = []
    for at, rows in parts:
        kind = _kind(rows * width)
        zero = "0.0" if rows * width == 1 else "zeroinitializer"
        now, after = f"%sum_{name}_{at}", f"%sum_next_{name}_{at}"
        text.append(f"  {now} = phi {kind} [ {zero}, {before} ], [ {after}, %{head} ]")
        sums.append((at, rows, kind, now, after))
    text += [
        f"  %factor_at_{name} = mul i64 %c_{name}, {width}",
        f"  %factor_cell_{name} = add i64 %factor_at_{name}, {factors * width}",
        f"  %factor_place_{name} = getelementptr double, ptr %base, i64 %factor_cell_{name}",
        f"  %factor_{name} = load {_kind(width)}, ptr %factor_place_{name}, align 8",
        f"  %column_at_{name} = mul i64 %c_{name}, {height * width}",
        f"  %column_cell_{name} = add i64 %column_at_{name}, {matrix * width}",
        f"  %here_{name} = getelementptr double, ptr {base}, i64 %column_cell_{name}",
    ]
    for at, rows, kind, now, after in sums:
        own = f"{name}_{at}"
        factor = f"%factor_{name}"
        if rows > 1:  # one lane: the factor in every row
            mask = f"<{rows} x i32> zeroinitializer"
            text += [
                f"  %first_{own} = insertelement {kind} poison, double {factor}, i64 0",
                f"  %wide_{own} = shufflevector {kind} %first_{own}, {kind} poison, {mask}",
            ]
            factor = f"%wide_{own}"
        text += [
            f"  %place_{own} = getelementptr double, ptr %here_{name}, i64 {at * width}",
            f"  %number_{own} = load {kind}, ptr %place_{own}, align 8",
            f"  %term_{own} = fmul {flags}{kind} %number_{own}, {factor}",
            f"  {after} = fadd {flags}{kind} {now}, %term_{own}",
        ]
    text += [
        f"  %c_next_{name} = add i64 %c_{name}, 1",
        f"  %on_{name} = icmp slt i64 %c_next_{name}, {columns}",
        f"  br i1 %on_{name}, label %{head}, label %{tail}",
        f"{tail}:",
    ]
    for at, _, kind, _, after in sums:
        text += [
            f"  %to_{name}_{at} = getelementptr double, ptr %products, i64 {(done + at) * width}",
            f"  store {kind} {after}, ptr %to_{name}_{at}, align 8",
        ]
    return text


def _kind(numbers: int) -> str:
    return f"<{numbers} x double>" if numbers > 1 else "double"
