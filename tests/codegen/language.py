"""Functions that use everything that the restricted language has. They mean nothing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tests.codegen import other
from vsgdesign.equations.integration import advanced
from vsgdesign.equations.notation import WHOLE, Count

GAIN = 0.7


class Pair(NamedTuple):
    first: Any
    second: Any = 2.0


class Nest(NamedTuple):
    """A record with a record in it."""

    inner: Pair
    last: Any


def two(x: Any, y: Any) -> Any:
    """Returns (total, difference)."""
    return x + y, x - y


def half(x: Any) -> Any:
    """Of another module there is a function of the same name."""
    return 0.5 * x


def branches(x: Any, y: Any) -> Any:
    """Both branches are evaluated, and one is chosen."""
    z, w = x, y
    if x > y and not (y < -3.0 or x == 1.0):
        # The larger one.
        z = x * y
        w = z + 1.0
    elif -2.0 <= y < 2.0:
        z = -y
    w += 0.25 * z
    return z, w


def early(x: Any, y: Any) -> Any:
    """Returns (total, difference)."""
    if x < 0.0:
        return two(x, y)
    total, difference = two(y, half(x))
    return total, other.half(difference)


def flags(x: Any, y: Any, up: bool) -> Any:
    above = x > y
    return 3.0 * above + 2.0 * up - (-above if up else x) + (1.0 if above else -1.0)


def keywords(x: Any, y: Any) -> Any:
    short, exp = half(x), np.sqrt(4.0 + y)
    const = short + exp
    return short * exp - (const - (x - y)) / (1.0 + x * x)


def tuples(x: Any, y: Any) -> Any:
    pair = (x * y, x - y)
    total, _ = two(*pair)
    return pair[0] + pair[1] * total


def choices(x: Any, y: Any) -> Any:
    return np.where(x > y, np.clip(x, -1.0, GAIN), np.maximum(np.abs(y), np.floor(x)))


class Twice(NamedTuple):
    inner: Pair


def records(x: Any, y: Any, nest: Nest) -> Any:
    made = Nest(Pair(x * nest.inner.first), last=half(y))
    taken = inside(made.inner, made.last) if x > 0.0 else inside(nest.inner, y)
    total, difference = two(*nest.inner)
    return Nest(inner=Pair(taken, total), last=difference), made


def inside(pair: Pair, x: Any) -> Any:
    return pair.first * x - pair.second


def kept(nest: Nest, x: Any) -> Any:
    """Returns (nest, made)."""
    other = doubled(nest.inner, x)
    return Nest(inner=nest.inner, last=nest.last + x), Twice(inner=other)


def doubled(pair: Pair, x: Any) -> Pair:
    return Pair(first=2.0 * x, second=pair.second)


def picked(x: Any, nest: Nest) -> Any:
    """Records that are chosen whole, with and without a name of their own."""
    inner = doubled(nest.inner, x) if x > 0.0 and nest.last < 2.0 and x < 3.0 else nest.inner
    last = Pair(first=x, second=inner.first) if nest.last > x else nest.inner
    return Nest(inner=doubled(inner, last.second), last=last.first)


def changed(x: Any, nest: Nest) -> Any:
    """Records that are others but for some fields, also a chosen one and one within another."""
    inner = nest.inner if x > 0.0 else doubled(nest.inner, x)
    return nest._replace(last=half(x) + nest.last, inner=inner._replace(first=inside(nest.inner, x)))


def swapped(one: Pair, other: Pair) -> Any:
    """Returns (first, second)."""
    return other, one


def unfolded(x: Any, rule: str) -> Any:
    if rule == "twice":
        # Only of this branch.
        return 2.0 * x
    # Only of the other.
    return x / 2.0


def integrates(nest: Nest, x: Any) -> Any:
    """A record within a record is integrated."""
    first = advanced(nest.inner.first, x)
    return Nest(inner=moved(nest.inner, first, x), last=nest.last)


def moved(pair: Pair, first: Any, x: Any) -> Any:
    return Pair(first=first, second=advanced(pair.second, half(x)))


def counted(ticks: Count) -> Count:
    """One more, within 32 bits."""
    return (ticks + 1) & WHOLE
