"""Polynomials over a box with a bound on all else, for many boxes at once, in NumPy.

x = Σ c_k t^e_k + r with \\|t_i\\| ≤ 1 and \\|r\\| ≤ radius. What a product has beyond the order of its space goes into
the radius, and so does more than rounding can be.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = Any

_ROUNDING = 1e-14
"""Of the sizes of the operands. A coefficient of a product is a sum of fewer than 40 complex products, each of which is
off by less than 4·2⁻⁵³ of its size."""

_FEW = 48
"""Columns up to which all products are taken at once, and not one after another."""

_FAR = 0.9
"""Of a quotient's or a root's operand from its centre, relative to that, beyond which it is not enclosed."""


@dataclass(frozen=True)
class Space:
    """Polynomials of some variables up to an order."""

    variables: int
    order: int

    @functools.cached_property
    def exponents(self) -> tuple[tuple[int, ...], ...]:
        """Of the monomials, by degree."""
        every = itertools.product(range(self.order + 1), repeat=self.variables)
        return tuple(sorted((e for e in every if sum(e) <= self.order), key=lambda e: (sum(e), e[::-1])))

    @functools.cached_property
    def place(self) -> dict[tuple[int, ...], int]:
        """Of each monomial."""
        return {e: k for k, e in enumerate(self.exponents)}

    @functools.cached_property
    def starts(self) -> Array:
        """Of the monomials of each degree."""
        degrees = [sum(e) for e in self.exponents]
        return np.array([degrees.index(d) for d in range(self.order + 1)])

    @functools.cached_property
    def products(self) -> dict[tuple[int, int], int]:
        """The place of the product of two monomials, where its degree is not beyond the order."""
        found = {}
        for (i, a), (j, b) in itertools.product(enumerate(self.exponents), repeat=2):
            if sum(a) + sum(b) <= self.order:
                found[i, j] = self.place[tuple(x + y for x, y in zip(a, b, strict=True))]
        return found

    @functools.cached_property
    def pairs(self) -> tuple[Array, Array, Array, Array]:
        """The products as arrays by their places: first and second factor, then each place once, and its first pair."""
        every = np.array(sorted((k, i, j) for (i, j), k in self.products.items()))
        target, first = np.unique(every[:, 0], return_index=True)
        return every[:, 1], every[:, 2], target, first

    def powers(self, terms: list[Any], variable: int, radius: Any) -> Polynomial:
        """Σ terms_k t^k of one variable, each (N,)."""
        kind = complex if any(np.iscomplexobj(term) for term in terms) else float
        c = np.zeros((len(self.exponents), len(terms[0])), dtype=kind)
        for k, term in enumerate(terms[: self.order + 1]):
            c[self.place[tuple(k if i == variable else 0 for i in range(self.variables))]] = term
        for term in terms[self.order + 1 :]:
            radius = radius + np.abs(term)
        return Polynomial(self, c, np.broadcast_to(radius, c.shape[1:]) + 0.0)

    def variable(self, low: Array, high: Array, variable: int) -> Polynomial:
        """What lies between limits (N,)."""
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        return self.powers([middle, half], variable, 1e-15 * (np.abs(low) + np.abs(high)))

    def exponential(self, factor: complex, offset: complex, low: Array, high: Array, variable: int) -> Polynomial:
        """exp(offset + factor·x) − 1 for x between limits (N,)."""
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        at, step = offset + factor * middle, factor * half
        value, far = np.exp(at), np.abs(step)
        terms = [np.expm1(at), *(value * step**k / math.factorial(k) for k in range(1, self.order + 1))]
        n = self.order + 1
        rest = np.abs(value) * (far**n / math.factorial(n) * np.exp(far) + 1e-14 * (1.0 + np.abs(at)) * np.exp(far))
        return self.powers(terms, variable, rest)

    def sine(self, low: Array, high: Array, variable: int, quarter: int) -> Polynomial:
        """sin(x + quarter·π/2) for x between limits (N,)."""
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        wave = np.sin(middle), np.cos(middle), -np.sin(middle), -np.cos(middle)
        terms = [wave[(k + quarter) % 4] * half**k / math.factorial(k) for k in range(self.order + 1)]
        n = self.order + 1
        return self.powers(terms, variable, half**n / math.factorial(n) + 1e-14)


class Polynomial:
    """N polynomials of a space: ``c`` (monomials, N), real or complex, and ``radius`` (N,)."""

    __slots__ = ("_rows", "_sizes", "c", "radius", "space")

    def __init__(self, space: Space, c: Array, radius: Array) -> None:
        self.space, self.c, self.radius = space, c, radius
        self._rows: list[int] | None = None
        self._sizes: Array | None = None

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **_: Any) -> Any:
        """NumPy's own functions, as equations call them."""
        if ufunc is np.sqrt:
            return self.sqrt()
        other = inputs[0]
        named = {"add": self.__radd__, "multiply": self.__rmul__, "subtract": self.__rsub__}
        name = "divide" if ufunc is np.true_divide else ufunc.__name__
        if name == "divide":
            return self.reciprocal() * other
        return named[name](other)

    @property
    def rows(self) -> list[int]:
        """The monomials that are not zero everywhere."""
        if self._rows is None:
            self._rows = np.flatnonzero(self.c.any(axis=1)).tolist()
        return self._rows

    def sizes(self) -> Array:
        """Sums of the sizes of coefficients by degree, (order + 1, N)."""
        if self._sizes is None:
            self._sizes = np.add.reduceat(np.abs(self.c), self.space.starts, axis=0)
        return self._sizes

    @property
    def most(self) -> Array:
        """A bound of the size, (N,)."""
        return (self.sizes().sum(axis=0) + self.radius) * (1.0 + 1e-13)

    @property
    def off(self) -> Array:
        """A bound of the distance from the centre, (N,)."""
        return (self.sizes()[1:].sum(axis=0) + self.radius) * (1.0 + 1e-13)

    @property
    def centre(self) -> Array:
        """The value at t = 0, but for the radius."""
        return self.c[0]

    def limits(self) -> tuple[Array, Array]:
        """Least and largest value of a real one. The square of a variable is never negative."""
        return self.centre.real - self.off, self.centre.real + self.off

    def take(self, index: Any) -> Polynomial:
        """Some of the columns."""
        return Polynomial(self.space, self.c[:, index], self.radius[index])

    def conjugate(self) -> Polynomial:
        """For real variables."""
        return Polynomial(self.space, self.c.conj(), self.radius)

    def widened(self, radius: Any) -> Polynomial:
        """With a radius more."""
        return Polynomial(self.space, self.c, self.radius + radius)

    def into(self, space: Space, variables: tuple[int, ...]) -> Polynomial:
        """As one of another space, in which the variables have these numbers."""
        c = np.zeros((len(space.exponents), self.c.shape[1]), dtype=self.c.dtype)
        radius = self.radius.copy()
        for k in self.rows:
            e = [0] * space.variables
            for own, to in zip(self.space.exponents[k], variables, strict=True):
                e[to] += own
            if sum(e) > space.order:
                radius += np.abs(self.c[k])
            else:
                c[space.place[tuple(e)]] += self.c[k]
        return Polynomial(space, c, radius * (1.0 + 1e-13))

    def __neg__(self) -> Polynomial:
        return Polynomial(self.space, -self.c, self.radius)

    def __add__(self, other: Any) -> Polynomial:
        if isinstance(other, Polynomial):
            radius = self.radius + other.radius + _ROUNDING * (self.most + other.most)
            return Polynomial(self.space, self.c + other.c, radius)
        c = self.c.astype(np.result_type(self.c, other))
        c[0] = c[0] + other
        return Polynomial(self.space, c, self.radius + _ROUNDING * (np.abs(self.c[0]) + np.abs(other)))

    __radd__ = __add__

    def __sub__(self, other: Any) -> Polynomial:
        return self + (-other)

    def __rsub__(self, other: Any) -> Polynomial:
        return (-self) + other

    def __mul__(self, other: Any) -> Polynomial:
        if isinstance(other, Polynomial):
            return self._times(other)
        size = np.abs(other)
        return Polynomial(self.space, self.c * other, size * (self.radius + _ROUNDING * self.most))

    __rmul__ = __mul__

    def _times(self, other: Polynomial) -> Polynomial:
        space = self.space
        if self.c.shape[1] <= _FEW:
            one, two, target, first = space.pairs
            c = np.zeros((len(space.exponents), self.c.shape[1]), dtype=np.result_type(self.c, other.c))
            c[target] = np.add.reduceat(self.c[one] * other.c[two], first, axis=0)
        else:
            c = np.zeros((len(space.exponents), self.c.shape[1]), dtype=np.result_type(self.c, other.c))
            for i in self.rows:
                for j in other.rows:
                    k = space.products.get((i, j))
                    if k is not None:
                        c[k] += self.c[i] * other.c[j]
        a, b = self.sizes(), other.sizes()
        A, B = a.sum(axis=0), b.sum(axis=0)
        beyond = sum(a[d] * b[space.order + 1 - d :].sum(axis=0) for d in range(1, space.order + 1))
        r, s = self.radius, other.radius
        with np.errstate(invalid="ignore"):
            radius = (beyond + A * s + B * r + r * s + _ROUNDING * (A + r) * (B + s)) * (1.0 + 1e-13)
        return Polynomial(space, c, np.where(np.isnan(radius), np.inf, radius))

    def __truediv__(self, other: Any) -> Polynomial:
        return self * (other.reciprocal() if isinstance(other, Polynomial) else 1.0 / other)

    def __rtruediv__(self, other: Any) -> Polynomial:
        return self.reciprocal() * other

    def reciprocal(self) -> Polynomial:
        """1/x by a geometric series about the centre; the radius is infinite where that is too near zero."""
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = np.where(self.centre == 0.0, 1.0, 1.0 / self.centre)
            turned = 1.0 - self * inverse
            series, far = turned * 0.0 + 1.0, turned.most
            for _ in range(self.space.order):
                series = series * turned + 1.0
            rest = np.where((far < _FAR) & (self.centre != 0.0), far ** (self.space.order + 1) / (1.0 - far), np.inf)
        return series.widened(rest) * inverse

    def sqrt(self) -> Polynomial:
        """The root of what is positive, by its series about the centre; else the radius is infinite."""
        with np.errstate(divide="ignore", invalid="ignore"):
            centre = np.where(self.centre > 0.0, self.centre, 1.0)
            turned, far = self * (1.0 / centre) - 1.0, None
            far = turned.most
            order = self.space.order
            factors = [math.prod((0.5 - i) / (i + 1) for i in range(k)) for k in range(order + 1)]
            series = turned * 0.0 + factors[-1]
            for k in reversed(range(order)):
                series = series * turned + factors[k]
            rest = np.where((far < _FAR) & (self.centre > 0.0), far ** (order + 1) / (1.0 - far), np.inf)
            return series.widened(rest) * np.sqrt(centre)
