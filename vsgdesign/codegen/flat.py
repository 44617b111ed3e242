"""A function as one straight line: every call inlined, every NamedTuple taken apart, every operation bound once.

What is left are scalars and operations: ``+``, ``-``, ``*``, ``/``, ``neg``, ``abs``, ``sqrt``, ``floor``, ``max``,
``min``, ``select``, ``and``, ``or``, ``not``, the comparisons, ``bitand``, ``bitor`` and ``read``. ``max`` and ``min``
give NaN where either is NaN. Counts are whole numbers among the others; ``bitand`` and ``bitor`` are for them. ``read``
takes a number of a row that is known. Sines, exponentials and the like become the plain functions of
:mod:`vsgdesign.codegen.vector_math`, so that running a block in plain Python and running it as machine code give the
same numbers.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from vsgdesign.codegen.expressions import (
    ADVANCED,
    COMPARISONS,
    FLAG,
    Build,
    Choose,
    Evaluate,
    Expression,
    Field,
    Function,
    Invocation,
    Let,
    Number,
    Numbers,
    Operation,
    RecordName,
    Variable,
    operation,
)
from vsgdesign.codegen.reader import Library
from vsgdesign.codegen.vector_math import PLAIN

PACKED, TAKEN = "packed", "taken"
"""Operations of blocks that do the same for several at once: numbers side by side, and one of them. Machine code of a
loop with one lane has them."""

FLAGS = frozenset(("and", "or", "not", *COMPARISONS))
"""Operations whose result is true or false."""

Atom = Number | Variable | Numbers
Values = Atom | dict[str, Atom]
"""A scalar, or the numbers of a record by path."""

_COMMUTE = frozenset(("+", "*", "==", "!=", "and", "or"))


@dataclass(frozen=True)
class Block:
    """A straight line of operations.

    An input is ``state.limiter.v_d`` (argument, then fields) or a scalar argument's name. ``lets`` are in an order in
    which they can be evaluated; each is one operation on numbers, inputs and earlier lets. An output is
    ``following.theta`` (result, then fields) or a scalar result's name; its value is a number, an input or a let.
    """

    inputs: tuple[str, ...]
    lets: tuple[tuple[str, Expression], ...]
    outputs: tuple[tuple[str, Expression], ...]

    @property
    def flags(self) -> frozenset[str]:
        """Lets that are true or false."""
        found: set[str] = set()
        for name, value in self.lets:
            if _is_flag(value, found):
                found.add(name)
        return frozenset(found)


def flat_block(
    function: Any, *, fixed: Mapping[str, Any] | None = None, kinds: Mapping[Any, Mapping[str, Any]] | None = None
) -> Block:
    """The block of a function of the restricted language, with these arguments known.

    Everything known is folded, equal values are shared, and what no output needs is left out. Nothing is reordered:
    plain Python that runs the block rounds as the function does. ``kinds``: NamedTuples in fields whose hint says
    Any. The same question is answered once a process. Raises UntranslatableError with file and line.
    """
    # By their text, too: 0 is not −0, and 1 is not true.
    known = tuple((name, repr(value), value) for name, value in sorted((fixed or {}).items()))
    return _flat_block(function, known, tuple((of, tuple(said.items())) for of, said in (kinds or {}).items()))


@functools.lru_cache(maxsize=256)
def _flat_block(function: Any, fixed: tuple[tuple[str, str, Any], ...], kinds: tuple[tuple[Any, Any], ...]) -> Block:
    library = Library(kinds={record: dict(said) for record, said in kinds})
    read = library.read(function, {name: value for name, _, value in fixed})
    flat, arguments, inputs = _Flat(), [], []
    for parameter in read.parameters:
        if isinstance(parameter.kind, str):
            inputs.append(parameter.name)
            value = Variable(parameter.name)
            arguments.append(flat.apply("!=", value, Number(0.0)) if parameter.kind == FLAG else value)
        else:
            paths = {path: f"{parameter.name}.{path}" for path in library.kinds.paths(parameter.kind)}
            inputs += paths.values()
            arguments.append({path: Variable(name) for path, name in paths.items()})
    flat.taken.update(inputs)
    outputs: list[tuple[str, Expression]] = []
    for name, values in zip(_result_names(read), flat.results(read, arguments), strict=True):
        if isinstance(values, dict):
            outputs += [(f"{name}.{path}", flat.number(value)) for path, value in values.items()]
        else:
            outputs.append((name, flat.number(values)))
    return Block(tuple(inputs), tuple(needed_lets(flat.lets, [value for _, value in outputs])), tuple(outputs))


def _result_names(function: Function) -> list[str]:
    """Names of the results. C adds ``_out`` to one that a local has, too; here only to one that an argument has."""
    if function.result is not None:
        return [function.name]
    given = {parameter.name for parameter in function.parameters}
    names = [output.name.removesuffix("_out") for output in function.outputs]
    return [
        output.name if name in given or names.count(name) > 1 else name
        for output, name in zip(function.outputs, names, strict=True)
    ]


def needed_lets(lets: Sequence[tuple[str, Expression]], values: Sequence[Expression]) -> list[tuple[str, Expression]]:
    """The lets that these values are made of, in their order."""
    read = {value.name for value in values if isinstance(value, Variable)}
    kept = []
    for name, value in reversed(lets):
        if name in read:
            kept.append((name, value))
            for one in getattr(value, "arguments", ()):
                if isinstance(one, Variable):
                    read.add(one.name)
    return kept[::-1]


def _is_flag(value: Expression, flags: set[str]) -> bool:
    if isinstance(value, Number):
        return isinstance(value.value, bool)
    if isinstance(value, Variable):
        return value.name in flags
    if isinstance(value, Operation) and value.name == "select":
        return _is_flag(value.arguments[1], flags)
    return isinstance(value, Operation) and value.name in FLAGS


def value_key(value: Expression) -> Any:
    """Equal for the same value to the last bit; −0 is not 0, and true is not 1."""
    if isinstance(value, Variable):
        return value.name
    if isinstance(value, Number):
        return value.value if isinstance(value.value, bool) else struct.pack("<d", value.value)
    if isinstance(value, Operation):
        return (value.name, *(value_key(one) for one in value.arguments))
    return value


class _Flat:
    """The lets so far. A name is free for as long as nothing has it."""

    def __init__(self) -> None:
        self.lets: list[tuple[str, Expression]] = []
        self.taken: set[str] = set()
        self.flags: set[str] = set()
        self._known: dict[Any, Atom] = {}
        self._made: dict[str, Operation] = {}
        """The operation of every let."""
        self._used: dict[str, int] = {}
        """How often a name was wanted."""

    # Operations.

    def apply(self, name: str, *arguments: Atom, hint: str = "") -> Atom:
        """The operation's value: a number, an input or a let that there is, or a new let."""
        if isinstance(arguments[0], Numbers):
            return self._of_row(name, arguments[0], arguments[1:])
        if name == "to real":
            return arguments[0]
        if name == ADVANCED:
            name = "+"
        if name in PLAIN:
            function = _plain(name)
            return _scalar(self.results(function, list(arguments))[0])
        arguments = self._fitting(name, arguments)
        found = _simplified(name, arguments)
        if not isinstance(found, Operation):
            return _scalar(found)
        chosen = self._of_chosen(name, arguments)
        if chosen is not None:
            return chosen
        keys = [value_key(argument) for argument in arguments]
        key = (name, *(sorted(keys, key=repr) if name in _COMMUTE else keys))
        if key not in self._known:
            own = self._free(hint or "value")
            self.lets.append((own, found))
            self._made[own] = found
            if _is_flag(found, self.flags):
                self.flags.add(own)
            self._known[key] = Variable(own)
        return self._known[key]

    def _of_row(self, name: str, row: Numbers, others: tuple[Atom, ...]) -> Atom:
        """How many numbers a row has, how many of them are not above a value, or one of them."""
        if name == "length":
            return Number(float(len(row.values)))
        if name == "search":
            found: Atom = Number(0.0)
            for one in row.values:
                found = self.apply("+", self.apply("<=", Number(one), others[0]), found)
            return found
        at = others[0]
        if isinstance(at, Number):
            return Number(row.values[int(at.value)])
        key = "read", id(row.values), value_key(at)
        if key not in self._known:
            own = self._free("read")
            self.lets.append((own, Operation("read", (row, at))))
            self._known[key] = Variable(own)
        return self._known[key]

    def _of_chosen(self, name: str, arguments: tuple[Atom, ...]) -> Atom | None:
        """The value of an operation on a number and on one of two numbers that is chosen: again a choice, or the
        condition itself; None where it is none. It has the same bits, and 2·(a > b) takes no product."""
        of = [one for one in arguments if isinstance(one, Variable)]
        choice = self._made.get(of[0].name) if len(of) == 1 else None
        if name == "select" or choice is None or choice.name != "select":
            return None
        condition, *sides = choice.arguments
        found: list[Number] = []
        for side in sides:
            if not isinstance(side, Number):
                return None
            value = _simplified(name, tuple(side if one is of[0] else one for one in arguments))
            if not isinstance(value, Number):
                return None
            found.append(value)
        one, other = found
        if isinstance(one.value, bool) and one.value != other.value:
            return _scalar(condition) if one.value else self.apply("not", _scalar(condition))
        return self.apply("select", _scalar(condition), one, other)

    def _fitting(self, name: str, arguments: tuple[Atom, ...]) -> tuple[Atom, ...]:
        """Numbers where numbers belong, and flags where flags belong."""
        if name in ("and", "or", "not"):
            return tuple(self.flag(one) for one in arguments)
        if name == "select":
            condition, *sides = arguments
            if not all(_is_flag(side, self.flags) for side in sides):
                sides = [self.number(side) for side in sides]
            return (self.flag(condition), *sides)
        return tuple(self.number(one) for one in arguments)

    def number(self, value: Atom) -> Atom:
        """1 or 0 for what is true or false."""
        if not _is_flag(value, self.flags):
            return Number(float(value.value)) if isinstance(value, Number) else value
        if isinstance(value, Number):
            return Number(float(value.value))
        name = value.name if isinstance(value, Variable) else "flag"
        return self.apply("select", value, Number(1.0), Number(0.0), hint=f"{name}_as_number")

    def flag(self, value: Atom) -> Atom:
        """True for what is not zero."""
        if _is_flag(value, self.flags):
            return value
        return Number(bool(value.value)) if isinstance(value, Number) else self.apply("!=", value, Number(0.0))

    def _free(self, hint: str) -> str:
        found, count = hint, self._used.get(hint, 1)
        while found in self.taken:
            count += 1
            found = f"{hint}_{count}"
        self._used[hint] = count
        self.taken.add(found)
        return found

    # Functions.

    def results(self, function: Function, arguments: Sequence[Values]) -> list[Values]:
        """What a function gives for these arguments, in the order of its outputs."""
        names = [parameter.name for parameter in function.parameters]
        here: dict[str, Values] = dict(zip(names, arguments, strict=True))
        for statement in function.body:
            if isinstance(statement, Let):
                here[statement.name] = self.value(statement.value, here, statement.name)
            elif isinstance(statement, Build):
                here[statement.name] = {
                    path: self.value(value, here, path.rpartition(".")[2]) for path, value in statement.fields
                }
            elif isinstance(statement, Choose):
                here[statement.name] = self._chosen(statement, here)
            elif isinstance(statement, Evaluate):
                found = self.results(statement.function, [self._argument(one, here) for one in statement.arguments])
                if not statement.declare:
                    return found
                here.update(zip(statement.targets, found, strict=True))
        if function.result is not None:
            return [self.value(function.result, here, function.name)]
        given: list[Values] = []
        for output in function.outputs:
            values = {
                path: self.value(value, here, path.rpartition(".")[2] or output.name) for path, value in output.values
            }
            given.append(values[""] if isinstance(output.kind, str) else values)
        return given

    def value(self, value: Expression, here: Mapping[str, Values], hint: str = "") -> Atom:
        """An expression as a number, an input or a let."""
        if isinstance(value, Numbers):
            return value
        if isinstance(value, Number):
            return Number(value.value if isinstance(value.value, bool) else float(value.value))
        if isinstance(value, Variable | Field):
            variable = isinstance(value, Variable)
            return _scalar(here[value.name] if variable else self._part(here, value.record, value.path))
        if isinstance(value, Invocation):
            return _scalar(self.results(value.function, [self._argument(one, here) for one in value.arguments])[0])
        return self.apply(value.name, *(self.value(one, here) for one in value.arguments), hint=hint)

    def _argument(self, value: Any, here: Mapping[str, Values]) -> Values:
        return self._part(here, value.name, value.path) if isinstance(value, RecordName) else self.value(value, here)

    @staticmethod
    def _part(here: Mapping[str, Values], record: str, path: str) -> Values:
        """A field of a record, or a record within it."""
        values = _record(here[record])
        if not path:
            return values
        if path in values:
            return values[path]
        inside = f"{path}."
        return {name[len(inside) :]: value for name, value in values.items() if name.startswith(inside)}

    def _chosen(self, statement: Choose, here: Mapping[str, Values]) -> Values:
        one = _record(self._part(here, statement.one.name, statement.one.path))
        if statement.condition is None or statement.other is None:
            return one
        other = _record(self._part(here, statement.other.name, statement.other.path))
        condition = self.value(statement.condition, here)
        return {path: self.apply("select", condition, one[path], other[path], hint=path) for path in one}


@functools.cache
def _plain(name: str) -> Function:
    """The plain function of an operation, read once a process."""
    return Library().read(PLAIN[name])


def _scalar(value: Values | Expression) -> Atom:
    if isinstance(value, Number | Variable | Numbers):
        return value
    raise TypeError(f"{value!r} is not a number, an input or a let.")


def _record(values: Values) -> dict[str, Atom]:
    if isinstance(values, dict):
        return values
    raise TypeError(f"{values!r} is not a record.")


def _simplified(name: str, arguments: tuple[Atom, ...]) -> Expression:
    """The operation, folded where that changes no bit."""
    one = value_key(Number(1.0))
    if name in ("and", "or") and isinstance(arguments[1], Number):
        arguments = arguments[::-1]
    if name == "*" and value_key(arguments[0]) == one:
        return arguments[1]
    if name in ("*", "/") and value_key(arguments[1]) == one:
        return arguments[0]
    if name == "-" and value_key(arguments[1]) == value_key(Number(0.0)):
        return arguments[0]
    if name == "select" and value_key(arguments[1]) == value_key(arguments[2]):
        return arguments[1]
    return operation(name, *arguments)
