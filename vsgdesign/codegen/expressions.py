"""What the reader makes of a function: expressions and statements that every printer can print."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

ADVANCED = "advanced"
"""The integrator's step: the one operation that is not pure in every target, since a target with single precision keeps
a compensated sum."""

COMPARISONS = ("<", ">", "<=", ">=", "==", "!=")

INTEGRATED = "integrated"
"""Mark of a function that moves an integrator: ``Annotated[Any, INTEGRATED]`` is what it returns."""

REAL, FLAG, COUNT, NUMBERS = "real", "flag", "count", "numbers"
"""What a value is: a number, true or false, a whole number of 32 bits, a row of numbers."""

BITS = {"&": "bitand", "|": "bitor"}
"""Operations on counts, bit by bit."""

WHOLE = 0xFFFFFFFF
"""The largest count."""

_EXACT: dict[str, Callable[..., Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "neg": operator.neg,
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "not": operator.not_,
    "max": max,
    "min": min,
    "abs": abs,
    "sqrt": math.sqrt,
    "bitand": lambda a, b: int(a) & int(b),
    "bitor": lambda a, b: int(a) | int(b),
    "to real": float,
}
"""What is folded: results that every target rounds alike."""


@dataclass(frozen=True)
class Number:
    """A number, a count (an int) or a flag that is known when the text is generated; ``name`` of a constant that keeps
    its own."""

    value: float | bool | int
    name: str = ""


@dataclass(frozen=True)
class Variable:
    """A scalar argument or local, or a row of numbers."""

    name: str
    kind: str = field(default=REAL, compare=False)


@dataclass(frozen=True)
class Field:
    """A field of a record that has a name in the target, no record itself; ``path`` is ``theta`` or
    ``limiter.energy``."""

    record: str
    path: str
    kind: str = field(default=REAL, compare=False)


@dataclass(frozen=True)
class Numbers:
    """A row of numbers that is known when the text is generated."""

    values: tuple[float, ...]


@dataclass(frozen=True)
class Operation:
    """An operator or a mathematical function of expressions.

    ADVANCED has two arguments, the integrator as it came in and its change.
    """

    name: str
    arguments: tuple[Expression, ...]


@dataclass(frozen=True)
class Invocation:
    """A function of the project that returns one scalar."""

    function: Function
    arguments: tuple[Argument, ...]


Expression = Number | Variable | Field | Operation | Invocation | Numbers


@dataclass(frozen=True)
class RecordName:
    """A record with a name in the target, as an argument; ``path`` where it is within another one."""

    name: str
    path: str = ""


Argument = Expression | RecordName


@dataclass(frozen=True)
class Comment:
    """A comment of the source, whole sentences in one line."""

    text: str


@dataclass(frozen=True)
class Let:
    """A local that is given its value once."""

    name: str
    value: Expression


@dataclass(frozen=True)
class Build:
    """A local record, made so that a function can be given it."""

    name: str
    record: type
    fields: tuple[tuple[str, Expression], ...]

    @property
    def read(self) -> set[str]:
        """Names that it is made of."""
        return set().union(*(names_in(value) for _, value in self.fields))


@dataclass(frozen=True)
class Choose:
    """A local record that is one of two others, or a copy of one."""

    name: str
    record: type
    one: RecordName
    condition: Expression | None = None
    other: RecordName | None = None

    @property
    def read(self) -> set[str]:
        """Names that it is made of."""
        parts = (self.one, self.condition, self.other)
        return set().union(*(names_in(part) for part in parts if part is not None))


@dataclass(frozen=True)
class Evaluate:
    """A function of the project whose results become locals or, in the last statement, the caller's own results."""

    function: Function
    arguments: tuple[Argument, ...]
    targets: tuple[str, ...]
    declare: bool = True
    """False where the targets are the caller's outputs."""


Statement = Comment | Let | Build | Choose | Evaluate


@dataclass(frozen=True)
class Parameter:
    """``kind``: REAL, FLAG, COUNT, NUMBERS, or the NamedTuple's class."""

    name: str
    kind: str | type


@dataclass(frozen=True)
class Output:
    """A result that is written through a name of its own; ``values`` are (path, value), path "" for a scalar, and empty
    where the last statement writes it."""

    name: str
    kind: str | type
    values: tuple[tuple[str, Expression], ...]
    empty: bool = False
    """Whether it is a record without a number."""


@dataclass(eq=False)
class Function:
    """A function of the source with everything known folded in."""

    name: str
    doc: str
    parameters: tuple[Parameter, ...]
    body: list[Statement] = field(default_factory=list)
    result: Expression | None = None
    """Of a function that returns one scalar."""
    outputs: tuple[Output, ...] = ()
    """Of every other."""
    lost: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """What the integrators need to keep compensated sums: name of a scalar parameter to (), of a record to its fields
    that are integrated, here or in what is called."""

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(output.name for output in self.outputs)

    @property
    def written(self) -> tuple[Output, ...]:
        """Outputs that the target has: a record without a number is nothing there."""
        return tuple(output for output in self.outputs if not output.empty)


def operation(name: str, *arguments: Expression) -> Expression:
    """The operation, or its value where everything in it is an unnamed number and every target agrees on it."""
    if name == "select":
        condition, one, other = arguments
        if isinstance(condition, Number):
            return one if condition.value else other
        if one == other:
            return one
    elif name in ("and", "or") and isinstance(arguments[0], Number):
        decided = bool(arguments[0].value) is (name == "or")
        return arguments[0] if decided else arguments[1]
    elif name in _EXACT and all(isinstance(each, Number) for each in arguments):
        numbers = [each for each in arguments if isinstance(each, Number)]
        if name in (*COMPARISONS, "not") or not any(each.name for each in numbers):
            with suppress(ArithmeticError, ValueError):  # a division by zero stays for the target
                return Number(_EXACT[name](*(each.value for each in numbers)))
    return Operation(name, arguments)


def is_flag(expression: Expression) -> bool:
    """Whether the value is true or false rather than a number."""
    if isinstance(expression, Number):
        return isinstance(expression.value, bool)
    if isinstance(expression, Operation):
        if expression.name == "select":
            return is_flag(expression.arguments[1])
        return expression.name in (*COMPARISONS, "and", "or", "not")
    if isinstance(expression, Invocation):
        return expression.function.result is not None and is_flag(expression.function.result)
    return False


def kind_of(expression: Expression) -> str:
    """REAL, FLAG, COUNT or NUMBERS."""
    if isinstance(expression, Number):
        return {bool: FLAG, int: COUNT}.get(type(expression.value), REAL)
    if isinstance(expression, Variable | Field):
        return expression.kind
    if isinstance(expression, Numbers):
        return NUMBERS
    if isinstance(expression, Invocation):
        return REAL if expression.function.result is None else kind_of(expression.function.result)
    if expression.name in ("select", "+", "-", "*", "max", "min"):
        return kind_of(expression.arguments[-1])
    if expression.name in (*BITS.values(), "search", "length"):
        return COUNT
    return FLAG if is_flag(expression) else REAL


def alike(*arguments: Expression) -> tuple[Expression, ...]:
    """Numbers of one kind: beside a real number, a count becomes one."""
    kinds = [kind_of(argument) for argument in arguments]
    if COUNT not in kinds or all(kind == COUNT for kind in kinds):
        return arguments
    return tuple(as_real(one) for one in arguments)


def as_real(value: Expression) -> Expression:
    """A count as a real number; any other value as it is."""
    if isinstance(value, Number) and kind_of(value) == COUNT:
        return Number(float(value.value), value.name)
    return operation("to real", value) if kind_of(value) == COUNT else value


def parts(expression: Expression | RecordName) -> Iterator[Expression | RecordName]:
    """The expression and everything in it."""
    yield expression
    if isinstance(expression, Operation | Invocation):
        for argument in expression.arguments:
            yield from parts(argument)


def names_in(expression: Expression | RecordName) -> set[str]:
    """Names of arguments, locals and records that the value is made of."""
    found = set()
    for part in parts(expression):
        if isinstance(part, Variable | RecordName):
            found.add(part.name)
        elif isinstance(part, Field):
            found.add(part.record)
    return found


def advances(expression: Expression | RecordName) -> bool:
    """Whether an integrator moves in it, so that it must be evaluated exactly once."""
    return any(
        (isinstance(part, Operation) and part.name == ADVANCED) or (isinstance(part, Invocation) and part.function.lost)
        for part in parts(expression)
    )
