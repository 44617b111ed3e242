"""Equations as lists of instructions: what is written for numbers, run once on symbols, ready to be enclosed on boxes.

The project's equations are plain arithmetic, so they take these symbols as they take floats. A symbol is an affine
combination of nodes; sums and factors are collected before anything is enclosed, so what cancels leaves no trace.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Operation(IntEnum):
    """What an instruction does."""

    INPUT = -1  # nothing: the register is set
    AFFINE = 0  # offset + Σ coefficient · register
    BLEND = 1  # Σ parameter of the box · register
    PRODUCT = 2
    RECIPROCAL = 3
    SINE = 4
    COSINE = 5
    ROOT = 6  # of what is not below a least value


class Node(NamedTuple):
    """Something that is not affine in what came before."""

    operation: Operation
    operands: tuple[int, ...]
    numbers: tuple[float, ...]
    """AFFINE: offset, then coefficients. BLEND: indices of parameters. ROOT: the least value."""


class Tracer:
    """Collects nodes; equal ones once.

    An equation that takes the larger or the smaller of two values is traced on one of its smooth pieces:
    :meth:`choosing`.
    """

    def __init__(self, inputs: int) -> None:
        self._first: Iterator[bool] = iter(())
        self._choices: list[Symbol] = []
        self.nodes: list[Node] = [Node(Operation.INPUT, (k,), ()) for k in range(inputs)]
        self._known: dict[Node, int] = {}
        self.inputs = inputs

    def symbols(self) -> list[Symbol]:
        """The inputs."""
        return [Symbol(self, {k: 1.0}, 0.0) for k in range(self.inputs)]

    def constant(self, value: float) -> Symbol:
        """A number as a symbol."""
        return Symbol(self, {}, value)

    def node(self, operation: Operation, operands: tuple[int, ...], numbers: tuple[float, ...] = ()) -> Symbol:
        """A node, new or known."""
        key = Node(operation, operands, numbers)
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(key)
        return Symbol(self, {self._known[key]: 1.0}, 0.0)

    @contextmanager
    def choosing(self, first: Sequence[bool]) -> Iterator[list[Symbol]]:
        """On which piece equations are traced: ``first`` says of each choice between two values, in order, whether it
        falls on the first. The list then has what is negative on that piece."""
        self._first, self._choices = iter(first), []
        yield self._choices
        if next(self._first, None) is not None:
            raise ValueError("an equation has fewer choices than pieces were named for")

    def chosen(self, one: Any, other: Any, larger: bool) -> Any:
        """The larger or the smaller of two symbols or numbers, on the piece that is traced."""
        first = next(self._first, None)
        if first is None:
            raise ValueError("an equation chooses between two values: name its pieces by Tracer.choosing")
        self._choices.append(other - one if first == larger else one - other)
        taken, left = (one, other) if first else (other, one)
        if larger and isinstance(taken, Symbol) and not isinstance(left, Symbol):
            return Symbol(self, taken.terms, taken.offset, float(left))
        return taken

    def blend(self, parameters: Sequence[int], values: Sequence[Symbol]) -> Symbol:
        """Σ parameter_k · value_k with parameters that differ from box to box, by their place."""
        return self.node(Operation.BLEND, tuple(self.place(v) for v in values), tuple(float(k) for k in parameters))

    def place(self, symbol: Symbol) -> int:
        """The node that is a symbol; an affine combination becomes one."""
        if symbol.offset == 0.0 and len(symbol.terms) == 1:
            ((node, coefficient),) = symbol.terms.items()
            if coefficient == 1.0:
                return node
        operands = tuple(sorted(symbol.terms))
        found = self.node(Operation.AFFINE, operands, (symbol.offset, *(symbol.terms[k] for k in operands)))
        return next(iter(found.terms))


class Symbol:
    """offset + Σ coefficient · node. Behaves like a number in the project's equations."""

    __slots__ = ("least", "offset", "terms", "tracer")

    def __init__(self, tracer: Tracer, terms: dict[int, float], offset: float, least: float = 0.0) -> None:
        self.tracer, self.terms, self.offset = tracer, terms, offset
        self.least = least
        """What it is not below, known from a choice; for the root alone."""

    def _scaled(self, factor: float) -> Symbol:
        if factor == 0.0:
            return Symbol(self.tracer, {}, 0.0)
        return Symbol(self.tracer, {k: factor * c for k, c in self.terms.items()}, factor * self.offset)

    def __neg__(self) -> Symbol:
        return self._scaled(-1.0)

    def __add__(self, other: Any) -> Symbol:
        if not isinstance(other, Symbol):
            return Symbol(self.tracer, self.terms, self.offset + float(other))
        terms = dict(self.terms)
        for node, coefficient in other.terms.items():
            total = terms.pop(node, 0.0) + coefficient
            if total != 0.0:
                terms[node] = total
        return Symbol(self.tracer, terms, self.offset + other.offset)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Symbol:
        return self + (-other)

    def __rsub__(self, other: Any) -> Symbol:
        return (-self) + other

    def __mul__(self, other: Any) -> Symbol:
        if not isinstance(other, Symbol):
            return self._scaled(float(other))
        if not other.terms:
            return self._scaled(other.offset)
        if not self.terms:
            return other._scaled(self.offset)
        (one, left), (two, right) = self.factored(), other.factored()
        places = sorted((self.tracer.place(left), self.tracer.place(right)))
        return self.tracer.node(Operation.PRODUCT, tuple(places))._scaled(one * two)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Symbol:
        return self * (other.reciprocal() if isinstance(other, Symbol) else 1.0 / float(other))

    def __rtruediv__(self, other: Any) -> Symbol:
        return self.reciprocal() * other

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **_: Any) -> Any:
        operation = _UFUNCS.get(ufunc.__name__) if method == "__call__" else None
        return NotImplemented if operation is None else operation(*inputs)

    def factored(self) -> tuple[float, Symbol]:
        """A factor taken out of a multiple of one node."""
        if self.offset == 0.0 and len(self.terms) == 1:
            ((node, coefficient),) = self.terms.items()
            return coefficient, Symbol(self.tracer, {node: 1.0}, 0.0)
        return 1.0, self

    def _of(self, operation: Operation, *numbers: float) -> Symbol:
        return self.tracer.node(operation, (self.tracer.place(self),), numbers)

    def whole(self) -> Symbol:
        """The same as one node, where it is a combination of several."""
        return Symbol(self.tracer, {self.tracer.place(self): 1.0}, 0.0) if len(self.terms) > 1 else self

    def reciprocal(self) -> Symbol:
        """1/x for x > 0."""
        factor, one = self.factored()
        node = self.tracer.nodes[self.tracer.place(one)]
        if node.operation == Operation.RECIPROCAL:
            return Symbol(self.tracer, {node.operands[0]: 1.0 / factor}, 0.0)
        return self._of(Operation.RECIPROCAL)

    def sin(self) -> Symbol:
        """sin x."""
        return self._of(Operation.SINE)

    def cos(self) -> Symbol:
        """cos x."""
        return self._of(Operation.COSINE)

    def sqrt(self, least: float | None = None) -> Symbol:
        """√x, x > ``least`` ≥ 0: points where x is below that are of no interest and are not enclosed."""
        least = self.least if least is None else least
        factor, one = self.factored()
        if factor <= 0.0:
            return self._of(Operation.ROOT, least)
        return one._of(Operation.ROOT, least / factor)._scaled(math.sqrt(factor))


@dataclass(frozen=True)
class Program:
    """Instructions (n, 4) of operation, target and operands; ``outputs``: the registers of the results.

    PRODUCT: operands a and b. The functions: operand a; ``number`` holds the root's least value. AFFINE and BLEND:
    operands a to b of ``places`` and ``factors`` (coefficients, or indices of parameters); ``number`` the offset.
    The first ``inputs`` registers hold the inputs and stay.
    """

    code: NDArray[np.int64]
    number: Array
    places: NDArray[np.int64]
    factors: Array
    outputs: NDArray[np.int64]
    registers: int


def program_of(tracer: Tracer, results: Sequence[Any]) -> Program:
    """What computes the results (symbols or numbers) from the tracer's inputs, and nothing else.

    A register is used again when its node is no longer needed, but never for the target of an instruction that
    still reads it.
    """
    outputs = [tracer.place(value if isinstance(value, Symbol) else tracer.constant(float(value))) for value in results]
    last = _last_uses(tracer, outputs)
    register = {k: k for k in range(tracer.inputs)}
    free: list[int] = []
    count = tracer.inputs
    code: list[tuple[int, int, int, int]] = []
    number: list[float] = []
    places: list[int] = []
    factors: list[float] = []
    for k in range(tracer.inputs, len(tracer.nodes)):
        if k not in last:
            continue
        operation, operands, numbers = tracer.nodes[k]
        if free:
            target = free.pop()
        else:
            target, count = count, count + 1
        register[k] = target
        if operation in (Operation.AFFINE, Operation.BLEND):
            first = len(places)
            places += [register[m] for m in operands]
            factors += numbers[1:] if operation == Operation.AFFINE else numbers
            code.append((int(operation), target, first, len(places)))
            number.append(numbers[0] if operation == Operation.AFFINE else 0.0)
        else:
            code.append((int(operation), target, register[operands[0]], register[operands[-1]]))
            number.append(numbers[0] if numbers else 0.0)
        free += [register[m] for m in set(operands) if m >= tracer.inputs and last[m] == k]
    return Program(
        np.array(code, dtype=np.int64).reshape(-1, 4),
        np.array(number),
        np.array(places, dtype=np.int64),
        np.array(factors),
        np.array([register[k] for k in outputs], dtype=np.int64),
        count,
    )


def _last_uses(tracer: Tracer, outputs: Sequence[int]) -> dict[int, int]:
    """For every node that the outputs need: the node that uses it last, beyond all for outputs themselves."""
    last = dict.fromkeys(outputs, len(tracer.nodes))
    for k in range(len(tracer.nodes) - 1, tracer.inputs - 1, -1):
        if k in last:
            for operand in tracer.nodes[k].operands:
                last.setdefault(operand, k)
    return last


def _tracer_of(*values: Any) -> Tracer:
    return next(value.tracer for value in values if isinstance(value, Symbol))


_UFUNCS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: b + a if isinstance(b, Symbol) else a + b,
    "subtract": lambda a, b: a - b if isinstance(a, Symbol) else (-b) + a,
    "multiply": lambda a, b: b * a if isinstance(b, Symbol) else a * b,
    "divide": lambda a, b: a / b if isinstance(a, Symbol) else b.reciprocal() * a,
    "sin": lambda a: a.sin(),
    "cos": lambda a: a.cos(),
    "sqrt": lambda a: a.sqrt(),
    "hypot": lambda a, b: (a * a + b * b).sqrt(),
    "maximum": lambda a, b: _tracer_of(a, b).chosen(a, b, larger=True),
    "minimum": lambda a, b: _tracer_of(a, b).chosen(a, b, larger=False),
}
