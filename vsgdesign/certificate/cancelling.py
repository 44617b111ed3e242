"""Sums of products that cancel before anything is enclosed: what the gains undo is then not there at all.

Gains are made of an inverse, and the loops multiply them with what was inverted. Bounds of the two factors know nothing
of each other; the product, written out, is 1 and a rest. These values take equations as floats do, and write products
out only where something cancels (:eq:`cancelled-quotient`). A sum is otherwise kept whole.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from vsgdesign.certificate.tracing import Symbol, Tracer

Powers = tuple[tuple[int, int], ...]
"""A product: (atom, exponent) in rising order of atoms, no exponent zero. An atom is a node of the tracer or, below
zero, a sum that is kept whole."""

Terms = dict[Powers, float]


class Algebra:
    """Makes values of a tracer's symbols and symbols of values, and remembers the sums that are kept whole."""

    def __init__(self, tracer: Tracer) -> None:
        self.tracer = tracer
        self.sums: dict[int, Terms] = {}
        self._known: dict[frozenset[tuple[Powers, float]], tuple[int, float]] = {}
        self._symbols: dict[int, Symbol] = {}
        self._age: dict[int, int] = {}

    def value(self, x: Any) -> Value:
        """A symbol (kept whole) or a number as a value."""
        if isinstance(x, Value):
            return x
        if not isinstance(x, Symbol):
            return Value(self, {(): float(x)} if x else {})
        if not x.terms:
            return self.value(x.offset)
        factor, one = x.factored()
        atom = self.tracer.place(one)
        self._age.setdefault(atom, len(self._age))
        return Value(self, {((atom, 1),): factor})

    def whole(self, terms: Terms, divided_by: bool = False) -> Terms:
        """A sum as a product of one atom, which multiples of the sum share; ``divided_by``: of a factor above zero, so
        that the atom is above zero where the sum is."""
        if len(terms) < 2:
            return terms
        scale = terms[min(terms)]
        key = frozenset((powers, coefficient / scale) for powers, coefficient in terms.items())
        atom, own = self._known.get(key, (0, 0.0))
        if atom == 0 or (divided_by and scale / own < 0.0):
            atom, own = -1 - len(self.sums), scale
            self._known[key] = atom, own
            self._age[atom] = len(self._age)
            self.sums[atom] = dict(terms)
        return {((atom, 1),): scale / own}

    def reduced(self, powers: Powers, coefficient: float) -> Terms:
        """A product, written as a sum where it holds a sum's first term over that sum."""
        held = dict(powers)
        for atom, exponent in powers:
            if atom >= 0 or exponent >= 0:
                continue
            lead = leading(self.sums[atom])
            if not all(held.get(a, 0) >= e if e > 0 else held.get(a, 0) <= e for a, e in lead):
                continue
            rest = times(powers, inverse(lead))
            total: Terms = {}
            share = coefficient / self.sums[atom][lead]
            for other, c in self.sums[atom].items():
                if other != lead:
                    add(total, self.reduced(times(rest, other), -c * share))
            add(total, self.reduced(times(rest, ((atom, 1),)), share))
            return total
        return {powers: coefficient}

    def product(self, a: Terms, b: Terms) -> Terms:
        """The product of two sums: written out where that cancels something, else each sum whole."""
        if not a or not b:
            return {}
        for one, other in ((a, b), (b, a)):
            if one.keys() == {()}:
                return {powers: one[()] * c for powers, c in other.items()}
        if len(a) == 1 and len(b) == 1:
            ((p, c),), ((q, d),) = a.items(), b.items()
            return self.reduced(times(p, q), c * d)
        first, second = self.whole(a), self.whole(b)
        whole = self.product(first, second)
        if self._cancels(whole, first, second):
            return whole
        written: Terms = {}
        cancels = False
        for p, c in a.items():
            for q, d in b.items():
                part = self.reduced(times(p, q), c * d)
                cancels |= self._cancels(part, {p: c}, {q: d})
                add(written, part)
        return written if cancels else whole

    def symbol(self, value: Value) -> Symbol:
        """A value as a symbol. What at least three products have in common, or two of which one is a part of the other,
        is taken out of their sum: bounds of the sum are then closer than the sum of bounds."""
        return self._summed(value.terms)

    def _summed(self, terms: Terms) -> Symbol:
        left = dict(terms)
        total = self.tracer.constant(left.pop((), 0.0))
        while left:
            group = self._alike(left)
            common = _common(group)
            rest = inverse(common)
            inner = {times(powers, rest): left.pop(powers) for powers in group}
            whole = self._product(common)
            total = total + (whole * inner[()] if len(inner) == 1 else whole * self._summed(inner))
        return total

    def _alike(self, terms: Terms) -> list[Powers]:
        """The largest group of products with a factor in common that is worth taking out; else the first product."""
        counts = Counter((atom, e > 0) for powers in terms for atom, e in powers)
        for (atom, above), count in sorted(counts.items(), key=lambda item: (-item[1], self._age[item[0][0]])):
            group = [powers for powers in terms if any(a == atom and (e > 0) == above for a, e in powers)]
            if count > 2 or (count == 2 and _common(group) in group):
                return group
        return [next(iter(terms))]

    def _product(self, powers: Powers) -> Symbol:
        together = math.gcd(*(exponent for _, exponent in powers)) or 1
        one = self.tracer.constant(1.0)
        # The oldest first: what products begin with alike is computed once.
        for atom, exponent in sorted(powers, key=lambda power: self._age[power[0]]):
            for _ in range(abs(exponent) // together):
                one = one * (self._atom(atom) if exponent > 0 else self._atom(atom).reciprocal())
        found = one
        for _ in range(together - 1):
            found = found * one
        return found

    @staticmethod
    def _cancels(found: Terms, a: Terms, b: Terms) -> bool:
        """Whether a product of two products has lost a factor of either."""
        (p,), (q,) = a, b
        return set(found) != {times(p, q)} or len(times(p, q)) < len({atom for atom, _ in (*p, *q)})

    def _atom(self, atom: int) -> Symbol:
        if atom >= 0:
            return Symbol(self.tracer, {atom: 1.0}, 0.0)
        if atom not in self._symbols:
            self._symbols[atom] = self.symbol(Value(self, self.sums[atom]))
        return self._symbols[atom]


class Value:
    """Σ coefficient · product. Behaves like a number in the project's equations."""

    __slots__ = ("algebra", "terms")

    def __init__(self, algebra: Algebra, terms: Mapping[Powers, float]) -> None:
        self.algebra, self.terms = algebra, dict(terms)

    def __neg__(self) -> Value:
        return Value(self.algebra, {powers: -c for powers, c in self.terms.items()})

    def __add__(self, other: Any) -> Value:
        terms = dict(self.terms)
        add(terms, self.algebra.value(other).terms)
        return Value(self.algebra, self._opened(terms))

    __radd__ = __add__

    def __sub__(self, other: Any) -> Value:
        return self + (-other)

    def __rsub__(self, other: Any) -> Value:
        return (-self) + other

    def __mul__(self, other: Any) -> Value:
        return Value(self.algebra, self.algebra.product(self.terms, self.algebra.value(other).terms))

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Value:
        return self * self.algebra.value(other).reciprocal()

    def __rtruediv__(self, other: Any) -> Value:
        return self.reciprocal() * other

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **_: Any) -> Any:
        operation = _UFUNCS.get(ufunc.__name__) if method == "__call__" else None
        return NotImplemented if operation is None else operation(*inputs)

    def reciprocal(self) -> Value:
        """1/x for x whose factors are all > 0."""
        if not self.terms:
            raise ZeroDivisionError("an equation divides by what is zero everywhere")
        ((powers, coefficient),) = self.algebra.whole(self.terms, divided_by=True).items()
        return Value(self.algebra, {inverse(powers): 1.0 / coefficient})

    def sqrt(self) -> Value:
        """√x for x > 0."""
        return self.algebra.value(self.algebra.symbol(self).sqrt())

    def _opened(self, terms: Terms) -> Terms:
        """Sums in products are written out where a part of one term then cancels another or a part of it, or leaves
        of it what one factor differs from 1."""
        ways: dict[Powers, list[tuple[Powers, int | None, float]]] = {}
        for powers, coefficient in terms.items():
            ways.setdefault(powers, []).append((powers, None, coefficient))
            for atom, exponent in powers:
                if atom < 0 < exponent:
                    rest = times(powers, ((atom, -1),))
                    for part, c in self.algebra.sums[atom].items():
                        ways.setdefault(times(rest, part), []).append((powers, atom, coefficient * c))
        for part, found in ways.items():
            near = [way for atom, e in part if e == 1 for way in ways.get(times(part, ((atom, -1),)), ())]
            for (one, atom, c), (other, another, d) in itertools.combinations([*found, *near], 2):
                if one != other and c == -d and atom != another:
                    opened = dict(terms)
                    for powers, which in ((one, atom), (other, another)):
                        if which is not None:
                            coefficient, rest = opened.pop(powers), times(powers, ((which, -1),))
                            parts = self.algebra.sums[which].items()
                            add(opened, {times(rest, p): coefficient * c for p, c in parts})
                    return self._opened(opened)
        return terms


def times(a: Powers, b: Powers) -> Powers:
    """The product of two products."""
    if not (a and b):
        return a or b
    total = dict(a)
    for atom, exponent in b:
        total[atom] = total.get(atom, 0) + exponent
    return tuple(sorted([power for power in total.items() if power[1]]))


def inverse(a: Powers) -> Powers:
    """1 over a product."""
    return tuple((atom, -exponent) for atom, exponent in a)


def _common(terms: Iterable[Powers]) -> Powers:
    """The largest product that is part of all."""
    first, *others = (dict(powers) for powers in terms)
    found = []
    for atom, exponent in first.items():
        sign = 1 if exponent > 0 else -1
        least = min([abs(exponent), *(max(sign * other.get(atom, 0), 0) for other in others)])
        found += [(atom, sign * least)] if least else []
    return tuple(sorted(found))


def add(terms: Terms, more: Mapping[Powers, float]) -> None:
    """Adds to a sum in place; what is zero is left out."""
    for powers, coefficient in more.items():
        total = terms.get(powers, 0.0) + coefficient
        if total != 0.0:
            terms[powers] = total
        else:
            terms.pop(powers, None)


def leading(terms: Mapping[Powers, float]) -> Powers:
    """The first term of a sum: that which was there first, so that a sum begins as the equation does."""
    return next(iter(terms))


_UFUNCS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: b + a if isinstance(b, Value) else a + b,
    "subtract": lambda a, b: a - b if isinstance(a, Value) else (-b) + a,
    "multiply": lambda a, b: b * a if isinstance(b, Value) else a * b,
    "divide": lambda a, b: a / b if isinstance(a, Value) else b.reciprocal() * a,
    "sqrt": lambda a: a.sqrt(),
}
