"""Numbers that write down what is done with them: plain Python of lists and loops becomes a block.

A function for which a program's shape is known beforehand (the order of a matrix, say) runs with floats, and with
traced numbers it leaves every operation in a :class:`vsgdesign.codegen.blocks.Writer`.
"""

from __future__ import annotations

import math
from typing import Any

from vsgdesign.codegen.blocks import Writer
from vsgdesign.codegen.expressions import Expression, Number


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
