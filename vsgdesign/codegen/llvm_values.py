"""Operations on numbers and vectors as lines of LLVM's text."""

from __future__ import annotations

import copy
import itertools
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from vsgdesign.codegen.expressions import Number, Numbers

FAST = "contract nsz arcp"
"""A product and a sum may round as one, the sign of a zero may be lost, a division may become a product with the
reciprocal. Sums are never taken in another order."""

_ARITHMETIC = {"+": "fadd", "-": "fsub", "*": "fmul", "/": "fdiv"}
_COMPARISONS = {"<": "olt", ">": "ogt", "<=": "ole", ">=": "oge", "==": "oeq", "!=": "une"}
_BITS = {"bitand": "and", "bitor": "or"}
_INTRINSICS = {"sqrt": "sqrt", "abs": "fabs", "floor": "floor"}

_HALF_OF_THE_EXPONENT = 0x5FE6EB50C7B537A9
_PARABOLA = 1.8765983235, -1.25210030111, 0.375502190978
"""Of :meth:`Printer.inverse_root`."""


@dataclass(frozen=True)
class Value:
    """A number or a flag in the text: for all lanes at once (wide), or one for all of them."""

    text: str
    wide: bool
    flag: bool = False
    sound: bool = False
    """Whether it cannot be NaN."""
    abreast: int = 0
    """How many numbers of one lane are in it side by side (:func:`vsgdesign.codegen.blocks.abreast`); 0: it is one."""


def bits_of(value: float) -> str:
    """A number as LLVM reads each of its bits."""
    return f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"


@dataclass
class Scope:
    """A block of the text; values of the enclosing ones may be used in it."""

    outer: Scope | None = None
    lines: list[str] = field(default_factory=list)
    known: dict[str, str] = field(default_factory=dict)
    """The register of what was computed already, by the text that computes it."""

    def find(self, text: str) -> str | None:
        """The register that has this already."""
        here: Scope | None = self
        while here is not None:
            if text in here.known:
                return here.known[text]
            here = here.outer
        return None


class Printer:
    """Prints operations into scopes. Registers have numbers that count through the whole text."""

    def __init__(self, width: int, strict: bool) -> None:
        self.width = width
        self.flags = "" if strict else f"{FAST} "
        self.strict = strict
        self.declared: set[str] = set()
        self.rows: dict[tuple[float, ...], tuple[str, str]] = {}
        """Rows of numbers by what is in them: their names and their texts."""
        self._count = itertools.count(1)

    def register(self) -> str:
        """A new register."""
        return f"%v{next(self._count)}"

    def of(self, value: Value) -> Printer:
        """The printer of a value: of numbers side by side in one lane, one whose lanes they are."""
        if not value.abreast:
            return self
        other = copy.copy(self)
        other.width = value.abreast
        return other

    def type(self, wide: bool, flag: bool = False) -> str:
        """The type of a value."""
        one = "i1" if flag else "double"
        return f"<{self.width} x {one}>" if wide and self.width > 1 else one

    def line(self, scope: Scope, text: str) -> str:
        """The register of a line that has one; the same line is not written twice."""
        found = scope.find(text)
        if found is None:
            found = self.register()
            scope.lines.append(f"  {found} = {text}")
            scope.known[text] = found
        return found

    def load(self, scope: Scope, pointer: str, at: int, wide: bool) -> str:
        """A number, or a vector, that is ``at`` doubles behind a pointer."""
        place = self.line(scope, f"getelementptr double, ptr {pointer}, i64 {at}") if at else pointer
        return self.line(scope, f"load {self.type(wide)}, ptr {place}, align 8")

    def store(self, scope: Scope, pointer: str, at: int, value: Value) -> None:
        """Writes a vector ``at`` doubles behind a pointer."""
        place = self.line(scope, f"getelementptr double, ptr {pointer}, i64 {at}") if at else pointer
        scope.lines.append(f"  store {self.type(True)} {self.widened(scope, value).text}, ptr {place}, align 8")

    def number(self, number: Number, wide: bool) -> Value:
        """A number that is known."""
        if isinstance(number.value, bool):
            one, flag = ("true" if number.value else "false"), True
        else:
            one, flag = bits_of(number.value), False
        many = wide and self.width > 1
        kind = "i1" if flag else "double"
        text = f"<{', '.join([f'{kind} {one}'] * self.width)}>" if many else one
        return Value(text, wide, flag, sound=number.value == number.value)

    def widened(self, scope: Scope, value: Value) -> Value:
        """The value in every lane."""
        if value.wide:
            return value
        if self.width == 1:
            return Value(value.text, True, value.flag, value.sound)
        one, many = self.type(False, value.flag), self.type(True, value.flag)
        first = self.line(scope, f"insertelement {many} poison, {one} {value.text}, i64 0")
        mask = f"<{self.width} x i32> zeroinitializer"
        text = self.line(scope, f"shufflevector {many} {first}, {many} poison, {mask}")
        return Value(text, True, value.flag, value.sound)

    def packed(self, scope: Scope, values: Sequence[Value]) -> Value:
        """Numbers of one lane side by side."""
        kind, found = f"<{len(values)} x double>", "poison"
        for at, one in enumerate(values):
            found = self.line(scope, f"insertelement {kind} {found}, double {one.text}, i64 {at}")
        return Value(found, True, sound=all(one.sound for one in values), abreast=len(values))

    def taken(self, scope: Scope, value: Value, at: int) -> Value:
        """One of the numbers that are side by side."""
        text = self.line(scope, f"extractelement <{value.abreast} x double> {value.text}, i64 {at}")
        return Value(text, True, sound=value.sound)

    def operation(self, scope: Scope, name: str, *values: Value) -> Value:
        """The value of an operation, wide if any argument is; of numbers side by side if any argument is that."""
        first = next((one for one in values if one.abreast), None)
        if first is not None and self.width != first.abreast:
            given = [one if one.abreast else replace(one, wide=False) for one in values]
            return replace(self.of(first).operation(scope, name, *given), abreast=first.abreast)
        given, wide = list(values), any(one.wide for one in values)
        if wide:
            given = [self.widened(scope, one) for one in given]
        texts = [one.text for one in given]
        real, flag = self.type(wide), self.type(wide, True)
        if name in _ARITHMETIC:
            square = name == "*" and texts[0] == texts[1] and given[0].sound
            return Value(
                self.line(scope, f"{_ARITHMETIC[name]} {self.flags}{real} {texts[0]}, {texts[1]}"), wide, sound=square
            )
        if name == "neg":
            return Value(self.line(scope, f"fneg {self.flags}{real} {texts[0]}"), wide, sound=given[0].sound)
        if name in _COMPARISONS:
            return Value(self.line(scope, f"fcmp {_COMPARISONS[name]} {real} {texts[0]}, {texts[1]}"), wide, flag=True)
        if name in ("and", "or"):
            return Value(self.line(scope, f"{name} {flag} {texts[0]}, {texts[1]}"), wide, flag=True)
        if name == "not":
            true = self.number(Number(True), wide).text
            return Value(self.line(scope, f"xor {flag} {texts[0]}, {true}"), wide, flag=True)
        if name in _BITS:
            whole = self.whole(wide)
            a, b = (self.line(scope, f"fptosi {real} {text} to {whole}") for text in texts)
            bits = self.line(scope, f"{_BITS[name]} {whole} {a}, {b}")
            return Value(self.line(scope, f"sitofp {whole} {bits} to {real}"), wide, sound=True)
        if name == "select":
            return self._select(scope, wide, *given)
        if name in ("max", "min"):
            return self._extreme(scope, name, wide, *given)
        if name in _INTRINSICS:
            suffix = f"v{self.width}f64" if wide and self.width > 1 else "f64"
            function = f"@llvm.{_INTRINSICS[name]}.{suffix}"
            self.declared.add(f"declare {real} {function}({real})")
            text = self.line(scope, f"call {self.flags}{real} {function}({real} {texts[0]})")
            return Value(text, wide, sound=name != "sqrt" and given[0].sound)
        raise ValueError(f"Operation {name}: machine code has none. Write it of others in codegen/vector_math.py.")

    def read(self, scope: Scope, row: Numbers, at: Value) -> Value:
        """A number of a row that is known, for each lane its own."""
        if row.values not in self.rows:
            numbers = ", ".join(f"double {bits_of(one)}" for one in row.values)
            name = f"@row.{len(self.rows)}"
            text = f"private constant [{len(row.values)} x double] [{numbers}], align 64"
            self.rows[row.values] = name, f"{name} = {text}"
        if at.abreast and self.width != at.abreast:
            return replace(self.of(at).read(scope, row, at), abreast=at.abreast)
        name, wide = self.rows[row.values][0], at.wide and self.width > 1
        index = self.line(scope, f"fptosi {self.type(at.wide)} {at.text} to {self.whole(at.wide)}")
        if not wide:
            place = self.line(scope, f"getelementptr double, ptr {name}, i64 {index}")
            return Value(self.line(scope, f"load double, ptr {place}, align 8"), at.wide)
        kind, places, flags = self.type(True), f"<{self.width} x ptr>", self.type(True, True)
        place = self.line(scope, f"getelementptr double, ptr {name}, {self.whole(True)} {index}")
        function = f"@llvm.masked.gather.v{self.width}f64.v{self.width}p0"
        self.declared.add(f"declare {kind} {function}({places}, i32, {flags}, {kind})")
        all_lanes = self.number(Number(True), True).text
        call = f"call {kind} {function}({places} {place}, i32 8, {flags} {all_lanes}, {kind} poison)"
        return Value(self.line(scope, call), True)

    def scatter(self, scope: Scope, pointer: str, slot: Value, last: str, at: int, values: Sequence[Value]) -> None:
        """Writes values of all lanes beside each other, each lane into its own ``slot``, from 0 to ``last``, where
        there are ``at`` doubles from one to the next; slot 0 of the lanes lies at ``pointer``."""
        whole, kind, flags = self.whole(True), self.type(True), self.type(True, True)
        zero = "zeroinitializer" if self.width > 1 else "0"
        place = self.line(scope, f"fptosi {kind} {slot.text} to {whole}")
        early = self.line(scope, f"icmp slt {whole} {place}, {zero}")
        place = self.line(scope, f"select {flags} {early}, {whole} {zero}, {whole} {place}")
        late = self.line(scope, f"icmp sgt {whole} {place}, {last}")
        place = self.line(scope, f"select {flags} {late}, {whole} {last}, {whole} {place}")
        many = f"<{', '.join([f'i64 {at}'] * self.width)}>" if self.width > 1 else str(at)
        place = self.line(scope, f"mul {whole} {place}, {many}")
        pointers = f"<{self.width} x ptr>" if self.width > 1 else "ptr"
        to = self.line(scope, f"getelementptr double, {pointers} {pointer}, {whole} {place}")
        for column, value in enumerate(values):
            here = self.line(scope, f"getelementptr double, {pointers} {to}, i64 {column}") if column else to
            if self.width == 1:
                scope.lines.append(f"  store double {value.text}, ptr {here}, align 8")
                continue
            function = f"@llvm.masked.scatter.v{self.width}f64.v{self.width}p0"
            self.declared.add(f"declare void {function}({kind}, {pointers}, i32, {flags})")
            every = self.number(Number(True), True).text
            call = f"call void {function}({kind} {value.text}, {pointers} {here}, i32 8, {flags} {every})"
            scope.lines.append(f"  {call}")

    def whole(self, wide: bool) -> str:
        """The type of whole numbers as many as a value has."""
        return f"<{self.width} x i64>" if wide and self.width > 1 else "i64"

    def _select(self, scope: Scope, wide: bool, condition: Value, one: Value, other: Value) -> Value:
        kind = self.type(wide, one.flag)
        text = f"select {self.type(wide, True)} {condition.text}, {kind} {one.text}, {kind} {other.text}"
        return Value(self.line(scope, text), wide, one.flag, sound=one.sound and other.sound)

    def _extreme(self, scope: Scope, name: str, wide: bool, a: Value, b: Value) -> Value:
        """The larger or smaller of two: a where a is (≥ or ≤) b or NaN, else b; NaN where either is."""
        kind, beyond = self.type(wide), "olt" if name == "max" else "ogt"
        if a.sound and not b.sound and not self.strict:  # of two zeros either may be taken
            a, b = b, a
        better = Value(self.line(scope, f"fcmp {beyond} {kind} {a.text}, {b.text}"), wide, flag=True)
        found = self._select(scope, wide, better, b, a)  # one instruction, which takes a where either is NaN
        if b.sound:
            return found
        if not self.strict:  # 0·b is NaN where b is, and also where b is infinite: that is a run that has diverged
            nothing = self.operation(scope, "*", b, self.number(Number(0.0), False))
            return self.operation(scope, "+", found, nothing)
        nothing = Value(self.line(scope, f"fcmp uno {kind} {b.text}, {b.text}"), wide, flag=True)
        return self._select(scope, wide, nothing, b, found)

    def inverse_root(self, scope: Scope, x: Value) -> Value:
        """1/√x of a vector of positive numbers, to 3e-16, without the unit that divides and takes roots.

        That unit takes forty cycles for a root and a division, which is far more than all that is done here. The
        exponent is halved as a whole number, which gives 1/√x to 3.5 %. A parabola in x·y² makes it 2.5e-5 (minimax),
        and the series of (1 − e)^(−1/2) does the rest. Every processor gives the same bits.
        """
        wide, whole, many = x.wide, "i64", x.wide and self.width > 1
        if many:
            whole = f"<{self.width} x i64>"
        one, magic = (
            f"<{', '.join([f'i64 {n}'] * self.width)}>" if many else str(n) for n in (1, _HALF_OF_THE_EXPONENT)
        )
        bits = self.line(scope, f"bitcast {self.type(wide)} {x.text} to {whole}")
        half = self.line(scope, f"lshr {whole} {bits}, {one}")
        guess = self.line(scope, f"sub {whole} {magic}, {half}")
        y = Value(self.line(scope, f"bitcast {whole} {guess} to {self.type(wide)}"), wide)

        def polynomial(at: Value, *coefficients: float) -> Value:
            total = self.number(Number(coefficients[-1]), False)
            for coefficient in coefficients[-2::-1]:
                total = self.operation(scope, "*", total, at)
                total = self.operation(scope, "+", total, self.number(Number(coefficient), False))
            return total

        near = self.operation(scope, "*", self.operation(scope, "*", y, y), x)
        y = self.operation(scope, "*", y, polynomial(near, *_PARABOLA))
        square = self.operation(scope, "*", self.operation(scope, "*", y, y), x)
        e = self.operation(scope, "-", self.number(Number(1.0), False), square)
        step = self.operation(scope, "*", self.operation(scope, "*", y, e), polynomial(e, 0.5, 0.375, 0.3125))
        return self.operation(scope, "+", y, step)
