"""Sine, cosine and the angle of a vector in single precision, as plain functions of + − × ÷, roots and comparisons.

A C library is free in the last bit of a sine, and no two libraries agree. These functions give the same bits with
every compiler that rounds each operation by itself. They are those of :mod:`vsgdesign.codegen.vector_math` with shorter
polynomials and with constants that a number of 24 bits holds (the polynomials are those of the Cephes library). They
are right to 2e-7 (tests/codegen/test_single_math.py).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vsgdesign.codegen.vector_math import HALF_PI, PI, QUARTER_PI, QUARTERS_A_RADIAN, length, quarter_turns

ROUNDING_OF_24_BITS = 12582912.0
"""1.5·2²³: a number below 2²² loses what is behind its point when this is added, and keeps the rest."""

QUARTER_FIRST = 1.5703125
QUARTER_SECOND = 4.837512969970703125e-4
QUARTER_THIRD = 7.54978995489188e-8
"""π/2 in three parts; multiples of the first two are exact up to 2¹² quarter turns."""

STEEPEST = 0.4142135679721832
"""tan(π/8)."""

LEAST = 1.1754943508222875e-38
"""The smallest number of single precision with all its digits."""


def nearest_whole(x: Any) -> Any:
    """The nearest whole number, |x| < 4e6."""
    return (x + ROUNDING_OF_24_BITS) - ROUNDING_OF_24_BITS


def within_a_quarter(x: Any) -> Any:
    """An angle without its whole quarter turns, and how many those were, modulo 4 (−2 to 2).

    Returns (rest, quarter).
    """
    count = nearest_whole(x * QUARTERS_A_RADIAN)
    rest = ((x - count * QUARTER_FIRST) - count * QUARTER_SECOND) - count * QUARTER_THIRD
    return rest, count - 4.0 * nearest_whole(0.25 * count)


def near_sine(x: Any) -> Any:
    """sin x for |x| ≤ π/4."""
    z = x * x
    return x + (z * x) * (-1.6666654611e-1 + z * (8.3321608736e-3 + z * -1.9515295891e-4))


def near_cosine(x: Any) -> Any:
    """cos x for |x| ≤ π/4."""
    z = x * x
    tail = 4.166664568298827e-2 + z * (-1.388731625493765e-3 + z * 2.443315711809948e-5)
    return 1.0 + z * (z * tail - 0.5)


def single_sine(x: Any) -> Any:
    """sin x, |x| < 6000 rad."""
    rest, quarter = within_a_quarter(x)
    along, across = quarter_turns(quarter)
    return near_sine(rest) * along + near_cosine(rest) * across


def single_cosine(x: Any) -> Any:
    """cos x, |x| < 6000 rad."""
    rest, quarter = within_a_quarter(x)
    along, across = quarter_turns(quarter)
    return near_cosine(rest) * along - near_sine(rest) * across


def near_arctangent(x: Any) -> Any:
    """The angle with tangent x, |x| ≤ tan(π/8)."""
    z = x * x
    tail = 1.99777106478e-1 + z * (-1.38776856032e-1 + z * 8.05374449538e-2)
    return x + x * (z * (-3.33329491539e-1 + z * tail))


def single_arctangent_2(y: Any, x: Any) -> Any:
    """The angle of the vector (x, y), −π to π; 0 of the vector (0, 0). A negative zero counts as zero."""
    across, along = np.abs(y), np.abs(x)
    most, least = np.maximum(across, along), np.minimum(across, along)
    steep = least > STEEPEST * most
    top = least - most if steep else least
    bottom = most + least if steep else most
    from_there = QUARTER_PI if steep else 0.0
    angle = from_there + near_arctangent(top / np.maximum(bottom, LEAST))
    angle = HALF_PI - angle if across > along else angle
    angle = PI - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


SINGLE = {"sin": single_sine, "cos": single_cosine, "atan2": single_arctangent_2, "hypot": length}
"""What takes the place of an operation in single precision."""
