"""Blocks put together and written by hand, or by numbers that write down what is done with them.

A function for which a program's shape is known beforehand (the order of a matrix, say) runs with floats, and with
:class:`Traced` numbers it leaves every operation in a :class:`Writer`: plain Python of lists and loops becomes a block.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from vsgdesign.codegen.expressions import Expression, Number, Operation, Variable
from vsgdesign.codegen.flat import PACKED, TAKEN, Block, needed_lets, value_key


class Part(NamedTuple):
    """A block, and for some of its inputs what they are called where it is put."""

    block: Block
    called: Mapping[str, str] = {}


def joined(*parts: Part) -> Block:
    """Blocks one after the other as one. An input that has the name of an output of an earlier block is this output;
    every other one is an input of the whole. Equal operations are shared."""
    inputs: dict[str, None] = {}
    lets: list[tuple[str, Expression]] = []
    outputs: dict[str, Expression] = {}
    taken = {part.called.get(name, name) for part in parts for name in part.block.inputs}
    shared: dict[Any, Variable] = {}
    for block, called in parts:
        here: dict[str, Expression] = {}
        for name in block.inputs:
            wanted = called.get(name, name)
            if wanted not in outputs:
                inputs[wanted] = None
            here[name] = outputs.get(wanted, Variable(wanted))
        for name, value in block.lets:
            if not isinstance(value, Operation):
                raise TypeError(f"{name} = {value!r} is no operation of a block.")
            # A first run waits for this loop more than for any other: an operation is made only if it is new.
            arguments = [here[one.name] if isinstance(one, Variable) else one for one in value.arguments]
            key = (value.name, *[one.name if isinstance(one, Variable) else value_key(one) for one in arguments])
            known = shared.get(key)
            if known is None:
                own = _free(name, taken)
                lets.append((own, Operation(value.name, tuple(arguments))))
                known = shared[key] = Variable(own)
            here[name] = known
        outputs |= {name: _moved(value, here) for name, value in block.outputs}
    return Block(tuple(inputs), tuple(lets), tuple(outputs.items()))


def renamed(block: Block, name: Callable[[str], str]) -> Block:
    """The block with other names for its inputs and outputs: one unit of several, for example."""
    here: dict[str, Expression] = {one: Variable(name(one)) for one in block.inputs}
    taken, lets = {name(one) for one in block.inputs}, []
    for one, value in block.lets:
        own = _free(one, taken)
        lets.append((own, _moved(value, here)))
        here[one] = Variable(own)
    outputs = tuple((name(one), _moved(value, here)) for one, value in block.outputs)
    return Block(tuple(name(one) for one in block.inputs), tuple(lets), outputs)


def abreast(block: Block, names: Sequence[Callable[[str], str]], width: int) -> Block:
    """The block for several at once, each with its own names for inputs and outputs: their numbers lie side by side, so
    that one operation does it for all of them. What they share is computed once. ``width``: numbers side by side, at
    least as many as there are names; the last one fills up."""
    inputs = dict.fromkeys(name(one) for name in names for one in block.inputs)
    lets: list[tuple[str, Expression]] = []
    here: dict[str, Expression] = {}
    taken, several = set(inputs), set()
    for one in block.inputs:
        own = [name(one) for name in names]
        here[one] = whole = Variable(own[0])
        if len(set(own)) > 1:
            here[one] = whole = Variable(_free(f"all.{one}", taken))
            filled = own + own[-1:] * (width - len(own))
            lets.append((whole.name, Operation(PACKED, tuple(map(Variable, filled)))))
            several.add(whole.name)
    for one, value in block.lets:
        own, moved = _free(one, taken), _moved(value, here)
        lets.append((own, moved))
        here[one] = Variable(own)
        arguments = moved.arguments if isinstance(moved, Operation) else ()
        if any(argument.name in several for argument in arguments if isinstance(argument, Variable)):
            several.add(own)
    outputs: dict[str, Expression] = {}
    for one, value in block.outputs:
        whole = _moved(value, here)
        for at, name in enumerate(names):
            outputs[name(one)] = whole
            if isinstance(whole, Variable) and whole.name in several:
                lets.append((_free(name(one), taken), Operation(TAKEN, (whole, Number(float(at))))))
                outputs[name(one)] = Variable(lets[-1][0])
    return Block(tuple(inputs), tuple(lets), tuple(outputs.items()))


def with_outputs(block: Block, names: tuple[str, ...]) -> Block:
    """The block with these outputs alone, and without what they do not need."""
    outputs = dict(block.outputs)
    kept = tuple((name, outputs[name]) for name in dict.fromkeys(names))
    return Block(block.inputs, tuple(needed_lets(block.lets, [value for _, value in kept])), kept)


class Writer:
    """A block that a loop of Python writes, operation by operation."""

    def __init__(self) -> None:
        self._inputs: dict[str, None] = {}
        self._lets: list[tuple[str, Expression]] = []
        self._outputs: dict[str, Expression] = {}

    def input(self, name: str) -> Variable:
        """An input."""
        self._inputs[name] = None
        return Variable(name)

    def does(self, operation: str, *values: Expression) -> Variable:
        """The value of an operation on numbers, inputs and earlier values."""
        name = f"line_{len(self._lets)}"
        self._lets.append((name, Operation(operation, values)))
        return Variable(name)

    def sum_of(self, *terms: Expression) -> Expression:
        """The terms added from the left."""
        total = terms[0]
        for term in terms[1:]:
            total = self.does("+", total, term)
        return total

    def output(self, name: str, value: Expression) -> None:
        """An output."""
        self._outputs[name] = value

    def block(self) -> Block:
        """What was written."""
        return Block(tuple(self._inputs), tuple(self._lets), tuple(self._outputs.items()))


def _moved(value: Expression, here: Mapping[str, Expression]) -> Expression:
    if isinstance(value, Variable):
        return here[value.name]
    if isinstance(value, Operation):
        return Operation(value.name, tuple(_moved(one, here) for one in value.arguments))
    return value


def _free(name: str, taken: set[str]) -> str:
    found, count = name, 1
    while found in taken:
        count += 1
        found = f"{name}_{count}"
    taken.add(found)
    return found


class Traced:
    """A number of a block, or a flag. Floats beside it become numbers of the block."""

    __slots__ = ("value", "writer")

    def __init__(self, writer: Writer, value: Expression) -> None:
        self.writer = writer
        self.value = value

    def _does(self, operation: str, *values: Any) -> Traced:
        return Traced(self.writer, self.writer.does(operation, *(expression(value) for value in values)))

    def __add__(self, other: Any) -> Traced:
        return self._does("+", self, other)

    def __radd__(self, other: Any) -> Traced:
        return self._does("+", other, self)

    def __sub__(self, other: Any) -> Traced:
        return self._does("-", self, other)

    def __rsub__(self, other: Any) -> Traced:
        return self._does("-", other, self)

    def __mul__(self, other: Any) -> Traced:
        return self._does("*", self, other)

    def __rmul__(self, other: Any) -> Traced:
        return self._does("*", other, self)

    def __truediv__(self, other: Any) -> Traced:
        return self._does("/", self, other)

    def __rtruediv__(self, other: Any) -> Traced:
        return self._does("/", other, self)

    def __neg__(self) -> Traced:
        return self._does("neg", self)

    def __abs__(self) -> Traced:
        return self._does("abs", self)

    def __lt__(self, other: Any) -> Traced:
        return self._does("<", self, other)

    def __gt__(self, other: Any) -> Traced:
        return self._does(">", self, other)


def expression(value: Any) -> Expression:
    """What a number is in a block."""
    return value.value if isinstance(value, Traced) else Number(float(value))


def root(value: Any) -> Any:
    """√x."""
    return value._does("sqrt", value) if isinstance(value, Traced) else math.sqrt(value)


def chosen(condition: Any, one: Any, other: Any) -> Any:
    """One value where the condition holds, the other where not. Both are computed."""
    if isinstance(condition, Traced):
        return condition._does("select", condition, one, other)
    return one if condition else other


def larger(one: Any, other: Any) -> Any:
    """The larger of two; the first where the other is NaN, as Python's ``max``."""
    return chosen(other > one, other, one)
