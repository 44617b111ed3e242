"""One sample of a loop as LLVM's text, with what is computed once before the loop or before a stretch of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from vsgdesign.codegen.expressions import Expression, Number, Numbers, Operation, Variable
from vsgdesign.codegen.flat import PACKED, TAKEN, Block, needed_lets
from vsgdesign.codegen.llvm_values import Printer, Scope, Value
from vsgdesign.codegen.loop_spec import LoopSpec


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
