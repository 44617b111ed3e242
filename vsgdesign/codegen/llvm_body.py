"""One sample of a loop as LLVM's text, with what is computed once before the loop or before a stretch of it.

A matrix times numbers of the state is a loop over the columns, some rows at a time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from vsgdesign.codegen.expressions import Expression, Number, Numbers, Operation, Variable
from vsgdesign.codegen.flat import PACKED, TAKEN, Block, needed_lets
from vsgdesign.codegen.llvm_values import Printer, Scope, Value
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


@dataclass(frozen=True)
class Level:
    """What a value depends on: the lane, the number of the sample or the state."""

    lane: bool
    sample: bool


ONCE, STRETCH, SAMPLE, STATE = Level(False, False), Level(True, False), Level(False, True), Level(True, True)


class Kept:
    """Values that are computed before a loop and wait in memory until a sample needs them.

    There are far more of them than registers, and a load costs a sample nothing.
    """

    def __init__(self, pointer: str, printer: Printer, scope: Scope, wide: bool) -> None:
        self.pointer, self.printer, self.scope, self.wide = pointer, printer, scope, wide
        self.places: dict[str, int] = {}

        self._end = 0

    def place(self, value: Value) -> int:
        """Where the value waits, in doubles behind the pointer."""
        if value.text not in self.places:
            printer = self.printer.of(value)
            wide = self.wide or value.abreast > 0
            size = printer.width if wide else 1
            self.places[value.text] = at = -(-self._end // size) * size  # a vector on one line of the cache
            self._end = at + size
            where = printer.line(self.scope, f"getelementptr double, ptr {self.pointer}, i64 {at}")
            self.scope.lines.append(f"  store {printer.type(wide)} {value.text}, ptr {where}, align 8")
        return self.places[value.text]

    @property
    def size(self) -> int:
        """Doubles that it needs, at least one."""
        return max(1, self._end)


@dataclass(frozen=True)
class Surroundings:
    """Scopes and places that all bodies of a loop share."""

    spec: LoopSpec
    printer: Printer
    entry: Scope
    stretch: Scope
    once: Kept
    lanes: Kept

    @cached_property
    def places(self) -> dict[str, tuple[str, int, bool]]:
        """Where the value of every input is in memory: behind which pointer, how many doubles, and whether there is one
        for each lane."""
        spec = self.spec
        rings = tuple(ring for ring, _ in spec.rings)
        found: dict[str, tuple[str, int, bool]] = {}
        for names, pointer, wide in (
            (spec.rows, "%base", True),
            (spec.uniform, "%uniform", False),
            (spec.cyclic, "%cyclic_now", False),
            (spec.fed, "%fed_now", True),
            (rings, "%ring", True),
            (spec.multiplied, "%products", True),
        ):
            found |= {name: (pointer, at * (spec.width if wide else 1), wide) for at, name in enumerate(names)}
        return found


class Body:
    """The text of one kind of sample."""

    def __init__(self, around: Surroundings, block: Block) -> None:
        self.around, self.block = around, block
        self.spec, self.printer = around.spec, around.printer
        self.scope = Scope(around.stretch)
        self.levels = self._levels()
        self._lets: dict[str, Expression] = dict(block.lets)
        self._values: dict[tuple[str, int], Value] = {}

    def _levels(self) -> dict[str, Level]:
        spec = self.spec
        found = dict.fromkeys(spec.uniform, ONCE) | dict.fromkeys(spec.constant, STRETCH)
        found |= dict.fromkeys(spec.cyclic, SAMPLE) | ({spec.index: SAMPLE} if spec.index else {})
        found |= dict.fromkeys((*spec.fed, *(name for name, _ in (*spec.state, *spec.rings)), *spec.multiplied), STATE)
        for name, value in self.block.lets:
            read = [found[one.name] for one in _arguments(value) if isinstance(one, Variable)]
            found[name] = Level(any(one.lane for one in read), any(one.sample for one in read))
        return found

    def print(self) -> tuple[list[Value], Value | None, Value | None]:
        """Prints the sample without its log; the values to be logged, the lanes' slots, and the one that stops the
        loop."""
        spec, outputs = self.spec, dict(self.block.outputs)
        inputs = {name for name, _ in spec.state}
        targets = [*spec.state, *spec.rings]
        wanted = [outputs[output] for _, output in targets]
        logs = [outputs.get(name, Variable(name)) for name in spec.logged]
        slots, stops = ([outputs[name]] if name else [] for name in (spec.slot, spec.stop))
        for name, value in needed_lets(self.block.lets, [*wanted, *logs, *slots, *stops]):
            self._let(name, value)
        # Everything is read before anything is written: an output may be the input of another row.
        results = [self._at_sample(value) for value in (*wanted, *logs, *slots, *stops)]
        moved, logged = results[: len(targets)], results[len(targets) : len(targets) + len(logs)]
        for at, ((name, _), value) in enumerate(zip(targets, moved, strict=True)):
            if at < len(spec.state):
                if wanted[at] != Variable(name):
                    self.printer.store(self.scope, "%base", at * spec.width, value)
            else:
                self.printer.store(self.scope, "%ring", (at - len(inputs)) * spec.width, value)
        logged = [self.printer.widened(self.scope, value) for value in logged]
        others = [self.printer.widened(self.scope, value) for value in results[len(targets) + len(logs) :]]
        return logged, others[0] if slots else None, others[-1] if stops else None

    def _let(self, name: str, value: Expression) -> None:
        if not isinstance(value, Operation):
            raise TypeError(f"let {name}: {value!r} is no operation.")
        scope = self._scope(self.levels[name])
        if value.name == "/" and not self.spec.strict:
            value = self._product(value, name, scope)
        self._values[name, id(scope)] = self._made(value, scope)

    def _made(self, value: Operation, scope: Scope) -> Value:
        printer, first = self.printer, value.arguments[0]
        if isinstance(first, Numbers):
            return printer.read(scope, first, self._seen(value.arguments[1], scope))
        if value.name == TAKEN and isinstance(value.arguments[1], Number):
            return printer.taken(scope, self._seen(first, scope), int(value.arguments[1].value))
        given = [self._seen(one, scope) for one in value.arguments]
        return printer.packed(scope, given) if value.name == PACKED else printer.operation(scope, value.name, *given)

    def _scope(self, level: Level) -> Scope:
        return {ONCE: self.around.entry, STRETCH: self.around.stretch}.get(level, self.scope)

    def _product(self, quotient: Operation, name: str, scope: Scope) -> Operation:
        """A quotient as a product with one over its divisor, where that is faster: where the divisor changes less often
        than the quotient, or is a root and the vectors are long."""
        dividend, divisor = quotient.arguments
        if not isinstance(divisor, Variable):
            return quotient
        inverse = Variable(f"1/{divisor.name}")
        if inverse.name not in self._lets:
            here = self._scope(self.levels[divisor.name])
            if self.levels[divisor.name] != self.levels[name]:
                made = self.printer.operation(here, "/", self._seen(Number(1.0), here), self._seen(divisor, here))
            elif self.spec.lanes >= 8 and scope is self.scope and (under := self._positive_under(divisor)):
                made = self.printer.inverse_root(here, self._seen(under, here))
            else:
                return quotient
            self._lets[inverse.name] = Operation("/", (Number(1.0), divisor))
            self.levels[inverse.name] = self.levels[divisor.name]
            self._values[inverse.name, id(here)] = made
        return Operation("*", (dividend, inverse))

    def _positive_under(self, root: Variable) -> Expression | None:
        """What stands under a root, where it is the larger of two of which one is a square that is no NaN."""
        value = self._lets.get(root.name)
        if not isinstance(value, Operation) or value.name != "sqrt":
            return None
        under = value.arguments[0]
        largest = self._lets.get(under.name) if isinstance(under, Variable) else None
        if not isinstance(largest, Operation) or largest.name != "max":
            return None
        for one in largest.arguments:
            square = self._lets.get(one.name) if isinstance(one, Variable) else None
            if isinstance(square, Operation) and square.name == "*" and square.arguments[0] == square.arguments[1]:
                return under
        return None

    def _at_sample(self, value: Expression) -> Value:
        return self._seen(value, self.scope)

    def _seen(self, value: Expression, scope: Scope) -> Value:
        """A number, an input or a let as a scope sees it."""
        if isinstance(value, Number):
            return self.printer.number(value, False)
        if not isinstance(value, Variable):
            raise TypeError(f"{value!r} is not a number, an input or a let.")
        key = value.name, id(scope)
        if key not in self._values:
            self._values[key] = self._fetched(value.name, scope)
        return self._values[key]

    def _fetched(self, name: str, scope: Scope) -> Value:
        around, printer, spec = self.around, self.printer, self.spec
        if name in self._lets:  # of an outer scope
            level = self.levels[name]
            outer = around.entry if level is ONCE or not level.lane else around.stretch
            made = self._values[name, id(outer)]
            if made.flag or scope is not self.scope:
                return made
            kept = around.lanes if made.wide else around.once
            text = printer.of(made).load(scope, kept.pointer, kept.place(made), made.wide)
            return Value(text, made.wide, sound=made.sound, abreast=made.abreast)
        if name == spec.index:
            return Value("%index", False, sound=True)
        if name in around.places:
            pointer, at, wide = around.places[name]
            return Value(printer.load(scope, pointer, at, wide), wide, sound=pointer == "%uniform")
        raise ValueError(f"input {name}: has no place.")


def _arguments(value: Expression) -> tuple[Expression, ...]:
    return value.arguments if isinstance(value, Operation) else ()  # type: ignore[return-value]
