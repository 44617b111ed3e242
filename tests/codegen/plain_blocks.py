"""Blocks run in plain Python, operation by operation: the oracle of what is compiled of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from vsgdesign.codegen.expressions import Expression, Number, Numbers, Operation, Variable
from vsgdesign.codegen.flat import Block


class Plain:
    """A block that plain Python runs, operation by operation: what a strict loop computes, to the last bit."""

    def __init__(self, block: Block) -> None:
        self._inputs = block.inputs
        places = {name: at for at, name in enumerate(block.inputs)}
        self._numbers: list[Any] = []
        first = len(places) + len(block.lets)  # numbers that are known stand behind all values

        def place(value: Expression) -> int:
            if isinstance(value, Variable):
                return places[value.name]
            if isinstance(value, Number):
                self._numbers.append(value.value)
                return first + len(self._numbers) - 1
            if isinstance(value, Numbers):
                self._numbers.append(value.values)
                return first + len(self._numbers) - 1
            raise TypeError(f"{value!r} is no number, input or let of a block.")

        self._steps: list[tuple[Callable[..., Any], tuple[int, ...]]] = []
        for name, value in block.lets:
            if not isinstance(value, Operation):
                raise TypeError(f"{name} = {value!r} is no operation of a block.")
            self._steps.append((_DOES[value.name], tuple(place(one) for one in value.arguments)))
            places[name] = len(places)
        self._outputs = [(name, place(value)) for name, value in block.outputs]

    def __call__(self, values: Mapping[str, float]) -> dict[str, float]:
        """The outputs for these values of the inputs. One that nothing reads may be missing."""
        here: list[Any] = [values.get(name, math.nan) for name in self._inputs]
        count = len(here)
        here += [None] * len(self._steps)
        here += self._numbers
        for at, (does, places) in enumerate(self._steps, count):
            here[at] = does(*[here[place] for place in places])
        return {name: float(here[place]) for name, place in self._outputs}


def _quotient(a: float, b: float) -> float:
    if b != 0.0:
        return a / b
    return math.nan if a == 0.0 or a != a else math.copysign(math.inf, a) * math.copysign(1.0, b)


def _floor(x: float) -> float:
    return float(math.floor(x)) if math.isfinite(x) else x


_DOES: dict[str, Callable[..., Any]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": _quotient,
    "neg": lambda a: -a,
    "abs": abs,
    "sqrt": lambda a: math.sqrt(a) if a >= 0.0 else math.nan,
    "floor": _floor,
    "max": lambda a, b: a if a >= b or a != a else b,
    "min": lambda a, b: a if a <= b or a != a else b,
    "select": lambda condition, one, other: one if condition else other,
    "bitand": lambda a, b: float(int(a) & int(b)),
    "bitor": lambda a, b: float(int(a) | int(b)),
    "read": lambda row, at: row[int(at)],
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
    "<": lambda a, b: a < b,
    ">": lambda a, b: a > b,
    "<=": lambda a, b: a <= b,
    ">=": lambda a, b: a >= b,
    "==": lambda a, b: a == b,
    "!=": lambda a, b: a != b,
}
