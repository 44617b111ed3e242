"""Taylor forms: numbers that vary over a box, as a polynomial of second order and a bound on all that is left.

They pass through the project's equations like floats or symbols do, so what is enclosed is what is simulated. Taylor
models: Makino and Berz (1996), here of second order. What is left is kept by dimension, so that a box that is too
large can be cut where it hurts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TINY = 1e-300


class TaylorForm:
    """x = centre + Σ_k t_k linear_k + Σ_{i≤j} t_i t_j square_ij + r with every |t_k| ≤ 1 and |r| ≤ Σ_k rest_k,
    for N boxes at once (:eq:`taylor-form`).

    ``centre`` (N,), ``linear`` and ``rest`` (d, N), ``square`` (d(d + 1)/2, N) in the order of
    ``np.triu_indices``; rest ≥ 0. Where a function has no bound on the box the rest is infinite or NaN, and whoever
    uses the form must take that as a no. Rounding is not enclosed: it is 1e-15 of the values.
    """

    __slots__ = ("centre", "linear", "rest", "square")

    def __init__(self, centre: Array, linear: Array, square: Array, rest: Array) -> None:
        self.centre, self.linear, self.square, self.rest = centre, linear, square, rest

    @property
    def limits(self) -> tuple[Array, Array]:
        """Bounds below and above, (N,) each: t_k² lies between 0 and 1, all other terms between −1 and 1."""
        i, j = np.triu_indices(len(self.linear))
        own, cross = self.square[i == j], self.square[i != j]
        around = np.abs(self.linear).sum(axis=0) + np.abs(cross).sum(axis=0) + self.rest.sum(axis=0)
        low, high = np.minimum(own, 0.0).sum(axis=0), np.maximum(own, 0.0).sum(axis=0)
        return self.centre + low - around, self.centre + high + around

    def without(self, dimensions: NDArray[np.bool_]) -> TaylorForm:
        """The same enclosure with no more than bounds on what some dimensions (d,) do: cut them, not follow them."""
        if not dimensions.any():
            return self
        i, j = np.triu_indices(len(self.linear))
        rest = self.rest.copy()
        rest[dimensions] += np.abs(self.linear[dimensions])
        one, other = dimensions[i], dimensions[j]
        for index, mask in ((i, one), (j, other & ~one)):
            np.add.at(rest, index[mask], np.abs(self.square[mask]))
        keep = ~(one | other)
        return TaylorForm(self.centre, self.linear * ~dimensions[:, None], self.square * keep[:, None], rest)

    def as_one(self, dimensions: NDArray[np.bool_]) -> TaylorForm:
        """What is left in some dimensions as one new quantity between −1 and 1, in the place of the first of them.

        For forms that are :meth:`without` these dimensions; nothing else may then use the place.
        """
        if not dimensions.any():
            return self
        linear, rest = self.linear.copy(), self.rest.copy()
        linear[np.argmax(dimensions)] = rest[dimensions].sum(axis=0)
        rest[dimensions] = 0.0
        return TaylorForm(self.centre, linear, self.square, rest)

    def _sizes(self) -> tuple[Array, Array, Array]:
        return np.abs(self.linear).sum(axis=0), np.abs(self.square).sum(axis=0), self.rest.sum(axis=0)

    def __neg__(self) -> TaylorForm:
        return TaylorForm(-self.centre, -self.linear, -self.square, self.rest)

    def __add__(self, other: Any) -> TaylorForm:
        if isinstance(other, TaylorForm):
            return TaylorForm(
                self.centre + other.centre, self.linear + other.linear, self.square + other.square,
                self.rest + other.rest,
            )  # fmt: skip
        return TaylorForm(self.centre + other, self.linear, self.square, self.rest)

    __radd__ = __add__

    def __sub__(self, other: Any) -> TaylorForm:
        return self + (-other)

    def __rsub__(self, other: Any) -> TaylorForm:
        return (-self) + other

    def __mul__(self, other: Any) -> TaylorForm:
        if not isinstance(other, TaylorForm):
            return TaylorForm(self.centre * other, self.linear * other, self.square * other, self.rest * np.abs(other))
        a, b = self.centre, other.centre
        i, j = np.triu_indices(len(self.linear))
        cross = self.linear[i] * other.linear[j]
        cross[i != j] += (self.linear[j] * other.linear[i])[i != j]
        (a_1, a_2, _), (b_1, b_2, b_3) = self._sizes(), other._sizes()
        # Third order and more of both polynomials, shared out by how much each dimension moves either factor.
        higher = a_1 * b_2 + a_2 * (b_1 + b_2)
        share = np.abs(self.linear) / (a_1 + _TINY) + np.abs(other.linear) / (b_1 + _TINY)
        share = share / (share.sum(axis=0) + _TINY)
        rest = self.rest * (np.abs(b) + b_1 + b_2 + b_3) + other.rest * (np.abs(a) + a_1 + a_2)
        return TaylorForm(
            a * b, a * other.linear + b * self.linear, a * other.square + b * self.square + cross,
            rest + higher * share + _unshared(higher, share),
        )  # fmt: skip

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> TaylorForm:
        return self * other.reciprocal() if isinstance(other, TaylorForm) else self * (1.0 / other)

    def __rtruediv__(self, other: Any) -> TaylorForm:
        return self.reciprocal() * other

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **_: Any) -> Any:
        operation = _UFUNCS.get(ufunc.__name__) if method == "__call__" else None
        return NotImplemented if operation is None else operation(*inputs)

    def reciprocal(self) -> TaylorForm:
        """1/x, x > 0. Beyond second order: −d³/(c³x)."""
        return self._function(lambda c: (1.0 / c, -1.0 / c**2, 1.0 / c**3), lambda c, low, _: 1.0 / (c**3 * low), 0.0)

    def sin(self) -> TaylorForm:
        """sin x. Beyond second order: at most d³/6."""
        return self._function(lambda c: (np.sin(c), np.cos(c), -0.5 * np.sin(c)), lambda c, _, __: 0.0 * c + 1.0 / 6.0)

    def cos(self) -> TaylorForm:
        """cos x. Beyond second order: at most d³/6."""
        return self._function(lambda c: (np.cos(c), -np.sin(c), -0.5 * np.cos(c)), lambda c, _, __: 0.0 * c + 1.0 / 6.0)

    def sqrt(self, least: float = 0.0) -> TaylorForm:
        """√x, x > ``least`` ≥ 0: points where x is below that are of no interest and are not enclosed. Beyond second
        order: d³/(16 ξ^{5/2})."""
        return self._function(
            lambda c: (np.sqrt(c), 0.5 / np.sqrt(c), -0.125 / c**1.5), lambda _, low, __: 0.0625 / low**2.5, 0.0, least
        )

    def _function(
        self, series: Callable[[Array], tuple[Array, Array, Array]], third: Callable[[Array, Array, Array], Array],
        domain: float = -np.inf, least: float = -np.inf,
    ) -> TaylorForm:  # fmt: skip
        """f by its Taylor series about the centre; ``third`` times the cube of the deviation bounds what is left."""
        low, high = self.limits
        low = np.maximum(low, least)
        high = np.maximum(high, low)
        bad = ~((low > domain) & (high < np.inf))
        low, high = np.where(bad, 1.0, low), np.where(bad, 1.0, high)
        about = np.clip(np.where(bad, 1.0, self.centre), low, high)
        value, slope, bend = series(about)
        deviation = self - about
        furthest = np.maximum(high - about, about - low)
        left = np.where(bad, np.inf, third(about, low, high) * furthest**3)
        share = np.abs(self.linear)
        share = share / (share.sum(axis=0) + _TINY)
        found = deviation * slope + deviation * deviation * bend + value
        return TaylorForm(found.centre, found.linear, found.square, found.rest + left * share + _unshared(left, share))


def _unshared(amount: Array, share: Array) -> Array:
    """What the shares do not add up to (a form without a linear part), spread evenly."""
    return np.maximum(1.0 - share.sum(axis=0), 0.0) * amount / len(share) * np.ones_like(share)


def box_variables(low: Array, high: Array) -> list[TaylorForm]:
    """The coordinates of N boxes (limits (N, n)) as forms in those that have a width anywhere."""
    moving = np.flatnonzero((high > low).any(axis=0))
    d, count = len(moving), len(low)
    found = []
    for k, (middle, radius) in enumerate(zip(0.5 * (low + high).T, 0.5 * (high - low).T, strict=True)):
        linear = (moving == k)[:, None] * radius
        found.append(TaylorForm(middle, linear, np.zeros((d * (d + 1) // 2, count)), np.zeros((d, count))))
    return found


_UFUNCS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: b + a if isinstance(b, TaylorForm) else a + b,
    "subtract": lambda a, b: a - b if isinstance(a, TaylorForm) else (-b) + a,
    "multiply": lambda a, b: b * a if isinstance(b, TaylorForm) else a * b,
    "divide": lambda a, b: a / b if isinstance(a, TaylorForm) else b.reciprocal() * a,
    "sin": lambda a: a.sin(),
    "cos": lambda a: a.cos(),
    "sqrt": lambda a: a.sqrt(),
}
