"""Complex polynomials of fifth order in three variables, with a bound on all else.

A form is x = Σ c_abc t_0^a t_1^b t_2^c + r over \\|t_k\\| ≤ 1, a + b + c ≤ 5, \\|r\\| ≤ radius (:eq:`taylor-form` of a
higher order). The variables are the grid's first coordinate, its angle, and the frequency on an arc. Equations take a
:class:`Form` as they take numbers: it is recorded once, and :mod:`~vsgdesign.certificate.full_order.tape` runs the
record for all cells and arcs.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ORDER = 5
VARIABLES = 3
GRID, ARC, ALL = 0, 1, 2
"""What a form depends on: the grid alone, the frequency alone, or both."""

EXPONENTS = tuple(
    e
    for degree in range(ORDER + 1)
    for e in itertools.product(range(degree, -1, -1), repeat=VARIABLES)
    if sum(e) == degree
)
_PLACE = {e: k for k, e in enumerate(EXPONENTS)}
COUNT = len(EXPONENTS)
ROWS = (
    np.array([k for k, e in enumerate(EXPONENTS) if e[2] == 0]),
    np.array([k for k, e in enumerate(EXPONENTS) if e[0] == e[1] == 0]),
    np.arange(COUNT),
)
"""Of each kind, the coefficients that it has, by their places in EXPONENTS."""

DEGREES = tuple(np.array([sum(EXPONENTS[k]) for k in rows]) for rows in ROWS)

ADD, SUBTRACT, MULTIPLY, SCALE, MOVE, CONJUGATE, RECIPROCAL, WIDEN = range(8)

UP = 1.0 + 1e-12
"""More than what sums and products of a few hundred sizes are off by."""


def kind_of(one: int, other: int) -> int:
    """What a sum or a product depends on."""
    return one if one == other else ALL


class Tape:
    """What is computed from forms, in order: (operation, kind, operands, number)."""

    def __init__(self) -> None:
        self.kinds: list[int] = []
        self.steps: list[tuple[int, int, int, int, complex]] = []
        self.inputs = 0

    def given(self, kind: int) -> Form:
        """A form that is given when the tape runs; all of them come first."""
        if self.steps:
            raise ValueError("the forms that are given come before the first operation")
        self.inputs += 1
        self.kinds.append(kind)
        return Form(self, len(self.kinds) - 1)

    def step(self, operation: int, kind: int, one: int, other: int = 0, number: complex = 0.0) -> Form:
        """One operation more."""
        self.steps.append((operation, len(self.kinds), one, other, complex(number)))
        self.kinds.append(kind)
        return Form(self, len(self.kinds) - 1)


class Form:
    """A place on a tape. Behaves like a number in the project's equations."""

    __slots__ = ("place", "tape")

    def __init__(self, tape: Tape, place: int) -> None:
        self.tape, self.place = tape, place

    @property
    def kind(self) -> int:
        """What it depends on."""
        return self.tape.kinds[self.place]

    def _with(self, operation: int, other: Form) -> Form:
        return self.tape.step(operation, kind_of(self.kind, other.kind), self.place, other.place)

    def known_to(self, value: complex, radius: float) -> Form:
        """x + value, where the value is known to within a radius."""
        found = self + value
        return found if radius == 0.0 else self.tape.step(WIDEN, self.kind, found.place, -1, radius)

    def widened(self, parameter: int) -> Form:
        """With a radius more that is given when the tape runs."""
        return self.tape.step(WIDEN, self.kind, self.place, parameter)

    def conjugate(self) -> Form:
        """The conjugate of x, for real t."""
        return self.tape.step(CONJUGATE, self.kind, self.place)

    def reciprocal(self) -> Form:
        """1/x; where the enclosure is not well away from zero the radius is infinite."""
        return self.tape.step(RECIPROCAL, self.kind, self.place)

    def __neg__(self) -> Form:
        return self * -1.0

    def __add__(self, other: Any) -> Form:
        if isinstance(other, Form):
            return self._with(ADD, other)
        return self if other == 0.0 else self.tape.step(MOVE, self.kind, self.place, number=other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Form:
        return self._with(SUBTRACT, other) if isinstance(other, Form) else self + (-other)

    def __rsub__(self, other: Any) -> Form:
        return (-self) + other

    def __mul__(self, other: Any) -> Form:
        if isinstance(other, Form):
            return self._with(MULTIPLY, other)
        return self if other == 1.0 else self.tape.step(SCALE, self.kind, self.place, number=other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Form:
        return self * (other.reciprocal() if isinstance(other, Form) else 1.0 / other)

    def __rtruediv__(self, other: Any) -> Form:
        return self.reciprocal() * other


@dataclass(frozen=True)
class Values:
    """N forms of one kind: coefficients (rows of the kind, N) and radius (N,)."""

    re: Array
    im: Array
    radius: Array
    kind: int

    @property
    def centre(self) -> NDArray[np.complex128]:
        """The values at t = 0 but for the radius."""
        return self.re[0] + 1j * self.im[0]

    @property
    def off(self) -> Array:
        """A bound of how far the value is from the centre."""
        return (np.hypot(self.re[1:], self.im[1:]).sum(axis=0) + self.radius) * UP

    @property
    def size(self) -> Array:
        """A bound of the size."""
        return (np.abs(self.centre) + self.off) * UP

    def take(self, index: Any) -> Values:
        """Some of the columns."""
        re, im, radius = (np.ascontiguousarray(v[..., index]) for v in (self.re, self.im, self.radius))
        return Values(re, im, radius, self.kind)

    def of_second_order(self) -> NDArray[np.complex128]:
        """Coefficients of at most second order in the order of EXPONENTS, then a bound of all else, (N, 11): real and
        imaginary parts each have the whole radius."""
        rows = ROWS[self.kind]
        found = np.zeros((len(self.radius), _SECOND + 1), dtype=complex)
        low = rows < _SECOND
        found[:, rows[low]] = (self.re[low] + 1j * self.im[low]).T
        found[:, -1] = (self.radius + np.hypot(self.re[~low], self.im[~low]).sum(axis=0)) * UP
        return found


_SECOND = sum(sum(e) <= 2 for e in EXPONENTS)


def joined(parts: list[Values]) -> Values:
    """All columns of some values of one kind."""
    re, im, radius = (np.concatenate([getattr(p, n) for p in parts], axis=-1) for n in ("re", "im", "radius"))
    return Values(re, im, radius, parts[0].kind)


def variable(low: Any, high: Any, axis: int) -> Values:
    """The variable of an axis between limits (N,)."""
    low, high = np.atleast_1d(low).astype(float), np.atleast_1d(high).astype(float)
    middle, half = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + 1e-15)
    return _powers([middle, half], axis, 4e-16 * (np.abs(low) + np.abs(high)))


def exponential_less_one(slope: complex, offset: complex, low: Any, high: Any, axis: int) -> Values:
    """exp(offset + slope·x) − 1 of the variable x of an axis between limits (N,)."""
    low, high = np.atleast_1d(low).astype(float), np.atleast_1d(high).astype(float)
    middle, half = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + 1e-15)
    at = offset + slope * middle
    value, step = np.exp(at), slope * half
    terms = [np.expm1(at)] + [value * step**k / math.factorial(k) for k in range(1, ORDER + 1)]
    far = np.abs(step)
    rest = np.abs(value) * far ** (ORDER + 1) / math.factorial(ORDER + 1) * np.exp(far)
    # The argument is off by its own rounding, and so is each function.
    rounding = 1e-15 * (np.abs(at) + np.abs(slope) * np.maximum(np.abs(low), np.abs(high)) + far)
    return _powers(terms, axis, (rest + rounding * (np.abs(value) * np.exp(far)) + 1e-15 * np.abs(terms[0])) * UP)


def sine(low: Any, high: Any, axis: int, quarter: int = 0) -> Values:
    """sin(x + quarter·π/2) of the variable x of an axis between limits (N,)."""
    low, high = np.atleast_1d(low).astype(float), np.atleast_1d(high).astype(float)
    middle, half = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + 1e-15)
    wave = np.sin(middle), np.cos(middle), -np.sin(middle), -np.cos(middle)
    terms = [wave[(k + quarter) % 4] * half**k / math.factorial(k) for k in range(ORDER + 1)]
    rest = half ** (ORDER + 1) / math.factorial(ORDER + 1) + 4e-15 * (1.0 + np.abs(middle))
    return _powers(terms, axis, rest * UP)


def _powers(terms: Any, axis: int, radius: Array) -> Values:
    """Σ terms_k t_axis^k with a radius."""
    kind = ARC if axis == VARIABLES - 1 else GRID
    place = {int(k): n for n, k in enumerate(ROWS[kind])}
    re, im = np.zeros((len(place), len(radius))), np.zeros((len(place), len(radius)))
    for k, term in enumerate(terms):
        e = [0] * VARIABLES
        e[axis] = k
        row = place[_PLACE[tuple(e)]]
        re[row], im[row] = np.real(term), np.imag(term)
    return Values(re, im, radius, kind)
