"""A matrix times numbers of the state as LLVM's text: loops over the columns, some rows at a time."""

from __future__ import annotations

from vsgdesign.codegen.llvm_values import Printer
from vsgdesign.codegen.loop_spec import LoopSpec, Product

_REGISTERS = 8
"""Sums that are under way at once: while one waits for its last addition, the others go on."""

_ROWS = 8
"""Rows in one register of a loop with one lane, where the numbers of a column lie beside each other."""


def product_lines(spec: LoopSpec, printer: Printer) -> list[str]:
    """The text that fills ``%products``, at the beginning of a sample. It ends within a block that goes on."""
    text, done = [], 0
    alike: dict[tuple[tuple[str, ...], int], list[tuple[Product, int]]] = {}
    for product in spec.products:
        alike.setdefault((product.matrix, product.turns), []).append((product, done))
        done += len(product.results)
    for number, some in enumerate(alike.values()):
        text += _of_one_matrix(spec, printer, number, some)
    return text


def _of_one_matrix(spec: LoopSpec, printer: Printer, number: int, some: list[tuple[Product, int]]) -> list[str]:
    """Products with one matrix, each with the place of its first result: its numbers are read once for all."""
    product, text = some[0][0], []
    height, columns, width = len(product.results), len(product.factors), spec.width
    base, matrix = "%base", spec.rows.index(product.matrix[0])
    if product.turns > 1:
        base = f"%base_{number}"
        text += [
            f"  %turned_{number} = mul i64 %turn, {height * columns * width}",
            f"  {base} = getelementptr double, ptr %base, i64 %turned_{number}",
        ]
    factors = [(spec.rows.index(one.factors[0]), done) for one, done in some]
    step = min(_ROWS, height) if width == 1 else 1
    # The last rows are a whole register, too: some of them are in two of them, with the same sums.
    parts = [(min(at, height - step), step) for at in range(0, height, step)]
    most = max(_REGISTERS // len(some), 1)
    for first in range(0, len(parts), most):
        own = parts[first : first + most]
        text += _columns(spec, printer, f"{number}_{first}", own, matrix, factors, height, columns, base)
    return text


def _columns(
    spec: LoopSpec,
    printer: Printer,
    name: str,
    parts: list[tuple[int, int]],
    matrix: int,
    factors: list[tuple[int, int]],
    height: int,
    columns: int,
    base: str,
) -> list[str]:
    """The loop over the columns for some parts of them: (first row, rows). ``factors``: the first row of the factors of
    each product, and the place of its first result; ``base``: where the rows begin of which the matrix is one."""
    width, flags = spec.width, printer.flags
    before, head, tail = f"%before_{name}", f"column_{name}", f"columns_{name}"
    text = [
        f"  br label {before}",
        f"{before[1:]}:",
        f"  br label %{head}",
        f"{head}:",
        f"  %c_{name} = phi i64 [ 0, {before} ], [ %c_next_{name}, %{head} ]",
    ]
    sums = [(at, rows, which, f"{name}_{which}_{at}") for at, rows in parts for which in range(len(factors))]
    for _, rows, _, own in sums:
        zero = "0.0" if rows * width == 1 else "zeroinitializer"
        text.append(f"  %sum_{own} = phi {_kind(rows * width)} [ {zero}, {before} ], [ %sum_next_{own}, %{head} ]")
    text += [
        f"  %factor_at_{name} = mul i64 %c_{name}, {width}",
        f"  %column_at_{name} = mul i64 %c_{name}, {height * width}",
        f"  %column_cell_{name} = add i64 %column_at_{name}, {matrix * width}",
        f"  %here_{name} = getelementptr double, ptr {base}, i64 %column_cell_{name}",
    ]
    wide = max(rows for _, rows in parts)
    for which, (first, _) in enumerate(factors):
        own = f"{name}_{which}"
        text += [
            f"  %factor_cell_{own} = add i64 %factor_at_{name}, {first * width}",
            f"  %factor_place_{own} = getelementptr double, ptr %base, i64 %factor_cell_{own}",
            f"  %factor_{own} = load {_kind(width)}, ptr %factor_place_{own}, align 8",
        ]
        if wide > 1:  # one lane: the factor in every row
            kind, mask = _kind(wide), f"<{wide} x i32> zeroinitializer"
            text += [
                f"  %first_{own} = insertelement {kind} poison, double %factor_{own}, i64 0",
                f"  %wide_{own} = shufflevector {kind} %first_{own}, {kind} poison, {mask}",
            ]
    for at, rows in parts:
        text += [
            f"  %place_{name}_{at} = getelementptr double, ptr %here_{name}, i64 {at * width}",
            f"  %number_{name}_{at} = load {_kind(rows * width)}, ptr %place_{name}_{at}, align 8",
        ]
    for at, rows, which, own in sums:
        kind, factor = _kind(rows * width), f"%{'wide' if wide > 1 else 'factor'}_{name}_{which}"
        text += [
            f"  %term_{own} = fmul {flags}{kind} %number_{name}_{at}, {factor}",
            f"  %sum_next_{own} = fadd {flags}{kind} %sum_{own}, %term_{own}",
        ]
    text += [
        f"  %c_next_{name} = add i64 %c_{name}, 1",
        f"  %on_{name} = icmp slt i64 %c_next_{name}, {columns}",
        f"  br i1 %on_{name}, label %{head}, label %{tail}",
        f"{tail}:",
    ]
    for at, rows, which, own in sums:
        text += [
            f"  %to_{own} = getelementptr double, ptr %products, i64 {(factors[which][1] + at) * width}",
            f"  store {_kind(rows * width)} %sum_next_{own}, ptr %to_{own}, align 8",
        ]
    return text


def _kind(numbers: int) -> str:
    return f"<{numbers} x double>" if numbers > 1 else "double"
