"""What a function costs: the operations in its expression trees, those of the functions that it calls among them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from vsgdesign.codegen.expressions import (
    ADVANCED,
    BITS,
    COMPARISONS,
    Build,
    Choose,
    Evaluate,
    Expression,
    Function,
    Invocation,
    Let,
    Operation,
    RecordName,
    parts,
)
from vsgdesign.codegen.reader import Library


@dataclass(frozen=True)
class Cost:
    """Operations of one call, with both sides of every choice."""

    products: int
    sums: int
    divisions: int
    functions: int
    """Square roots, sines and the like."""
    choices: int
    """Comparisons, selections, maxima, minima and magnitudes."""

    @property
    def multiply_adds(self) -> int:
        """Multiplications with an addition each, or the additions where there are more of them."""
        return max(self.products, self.sums)


def cost_of(function: Any, fixed: Mapping[str, Any] | None = None) -> Cost:
    """The operations of one call of a function of the restricted language.

    Raises UntranslatableError as :func:`vsgdesign.codegen.c_functions` does.
    """
    counted = _Counting().function(Library().read(function, fixed))
    choices = ("select", "and", "or", "not", "max", "min", "abs", "to real", "length", *BITS.values(), *COMPARISONS)
    plain = ("+", "-", "neg", "*", "/", ADVANCED, *choices)
    return Cost(
        products=counted["*"],
        sums=counted["+"] + counted["-"] + counted[ADVANCED],
        divisions=counted["/"],
        functions=sum(count for name, count in counted.items() if name not in plain),
        choices=sum(counted[name] for name in choices),
    )


class _Counting:
    def __init__(self) -> None:
        self._known: dict[int, Counter[str]] = {}

    def function(self, function: Function) -> Counter[str]:
        if id(function) not in self._known:
            found: Counter[str] = Counter()
            for statement in function.body:
                if isinstance(statement, Let):
                    found += self.values([statement.value])
                elif isinstance(statement, Choose):
                    if statement.condition is not None:
                        found += self.values([statement.condition]) + Counter({"select": 1})
                elif isinstance(statement, Build):
                    found += self.values(value for _, value in statement.fields)
                elif isinstance(statement, Evaluate):
                    found += self.values(statement.arguments) + self.function(statement.function)
            found += self.values(value for output in function.outputs for _, value in output.values)
            self._known[id(function)] = found + self.values([] if function.result is None else [function.result])
        return self._known[id(function)]

    def values(self, values: Iterable[Expression | RecordName]) -> Counter[str]:
        found: Counter[str] = Counter()
        for part in (part for value in values for part in parts(value)):
            if isinstance(part, Operation):
                found[part.name] += 1
            elif isinstance(part, Invocation):
                found += self.function(part.function)
        return found
