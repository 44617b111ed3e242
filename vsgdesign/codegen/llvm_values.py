"""Operations on numbers and vectors as lines of LLVM's text."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from vsgdesign.codegen.expressions import Number, Operation

FAST = "contract nsz arcp"
"""A product and a sum may round as one, the sign of a zero may be lost, a division may become a product with the
reciprocal. Sums are never taken in another order."""

_ARITHMETIC = {"+": "fadd", "-": "fsub", "*": "fmul", "/": "fdiv"}
_COMPARISONS = {"<": "olt", ">": "ogt", "<=": "ole", ">=": "oge", "==": "oeq", "!=": "une"}
_INTRINSICS = {"sqrt": "sqrt", "abs": "fabs", "floor": "floor"}


@dataclass(frozen=True)
class Value:
    """A number or a flag in the text: for all lanes at once (wide), or one for all of them."""

    text: str
    wide: bool
    flag: bool = False
    sound: bool = False
    """Whether it cannot be NaN."""


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
        self._count = 0

    def register(self) -> str:
        """A new register."""
        self._count += 1
        return f"%v{self._count}"

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
            one, flag = f"0x{struct.unpack('<Q', struct.pack('<d', number.value))[0]:016X}", False
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

    def operation(self, scope: Scope, operation: Operation, given: list[Value]) -> Value:
        """The value of an operation, wide if any argument is."""
        name, wide = operation.name, any(one.wide for one in given)
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

    def _select(self, scope: Scope, wide: bool, condition: Value, one: Value, other: Value) -> Value:
        kind = self.type(wide, one.flag)
        text = f"select {self.type(wide, True)} {condition.text}, {kind} {one.text}, {kind} {other.text}"
        return Value(self.line(scope, text), wide, one.flag, sound=one.sound and other.sound)

    def _extreme(self, scope: Scope, name: str, wide: bool, a: Value, b: Value) -> Value:
        """The larger or smaller of two: a where a is (≥ or ≤) b or NaN, else b; NaN where either is."""
        kind, beyond = self.type(wide), "olt" if name == "max" else "ogt"
        if b.sound:  # a is left only where b is beyond it
            better = Value(self.line(scope, f"fcmp {beyond} {kind} {a.text}, {b.text}"), wide, flag=True)
            return self._select(scope, wide, better, b, a)
        if a.sound and not self.strict:  # as above, from the other side; of two zeros either may be taken
            better = Value(self.line(scope, f"fcmp {beyond} {kind} {b.text}, {a.text}"), wide, flag=True)
            return self._select(scope, wide, better, a, b)
        reached = self.line(scope, f"fcmp {'oge' if name == 'max' else 'ole'} {kind} {a.text}, {b.text}")
        if not a.sound:
            nothing = self.line(scope, f"fcmp uno {kind} {a.text}, {a.text}")
            reached = self.line(scope, f"or {self.type(wide, True)} {reached}, {nothing}")
        return self._select(scope, wide, Value(reached, wide, flag=True), a, b)
