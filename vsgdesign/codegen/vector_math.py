"""Sine, cosine and the like as plain functions of + − × ÷, roots and comparisons, for lanes and for single precision.

A library's sine takes one number at a time. These functions take eight, because a compiled loop evaluates every
operation on whole vectors. They are right to about 1e-15 (tests/codegen/test_vector_math.py).

A C library is free in the last bit of a sine, and no two libraries agree. The functions of single precision at the end
give the same bits with every compiler that rounds each operation by itself. They have shorter polynomials and constants
that a number of 24 bits holds (the polynomials are those of the Cephes library), and they are right to 2e-7
(tests/codegen/test_single_math.py).
"""

from __future__ import annotations

from typing import Any

import numpy as np

ROUNDING = 6755399441055744.0
"""1.5·2⁵²: a number below 2⁵¹ loses what is behind its point when this is added, and keeps the rest."""

QUARTERS_A_RADIAN = 0.6366197723675814
QUARTER_HIGH = 1.5707963267341256
QUARTER_MIDDLE = 6.077100506303966e-11
QUARTER_LOW = 2.0222662487959506e-21
"""π/2 in three parts; the first two have 33 bits, so that their multiples are exact up to 2²⁰ quarter turns."""

HALF_PI = 1.5707963267948966
QUARTER_PI = 0.7853981633974483
PI = 3.141592653589793

ANGLE_OF_HALF = 0.4636476090008061
"""The angle with tangent 1/2."""

SMALLEST = 5e-324
"""The smallest positive number."""

LOG_2_HIGH = 0.6931471803691238
LOG_2_LOW = 1.9082149292705877e-10
LOG_2_E = 1.4426950408889634
"""ln 2 in two parts, the first of which has 33 bits, and 1/ln 2."""


def rounded(x: Any) -> Any:
    """The nearest whole number, |x| < 2e15."""
    return (x + ROUNDING) - ROUNDING


def reduced_angle(x: Any) -> Any:
    """An angle without its whole quarter turns, and how many those were, modulo 4 (−2 to 2).

    Returns (rest, quarter).
    """
    count = rounded(x * QUARTERS_A_RADIAN)
    rest = ((x - count * QUARTER_HIGH) - count * QUARTER_MIDDLE) - count * QUARTER_LOW
    return rest, count - 4.0 * rounded(0.25 * count)


def short_sine(x: Any) -> Any:
    """sin x for |x| ≤ π/4."""
    z = x * x
    tail = 8.33333333332248946124e-03 + z * (
        -1.98412698298579493134e-04
        + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))
    )
    return x + (z * x) * (-1.66666666666666324348e-01 + z * tail)


def short_cosine(x: Any) -> Any:
    """cos x for |x| ≤ π/4."""
    z = x * x
    tail = 2.48015872894767294178e-05 + z * (
        -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)
    )
    tail = 4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * tail)
    # What is rounded before the last sum is less than 0.31, so that it counts for a quarter of a last digit.
    return 1.0 + z * (z * tail - 0.5)


def quarter_turns(quarter: Any) -> Any:
    """Cosine and sine of whole quarter turns, −2 to 2. Returns (cosine, sine): 0, 1 or −1."""
    size = np.abs(quarter)
    return 1.0 - size, quarter * (2.0 - size)


def sine(x: Any) -> Any:
    """sin x, |x| < 10⁵ rad; the error is below 2e-16."""
    rest, quarter = reduced_angle(x)
    along, across = quarter_turns(quarter)
    return short_sine(rest) * along + short_cosine(rest) * across


def cosine(x: Any) -> Any:
    """cos x, |x| < 10⁵ rad; the error is below 2e-16."""
    rest, quarter = reduced_angle(x)
    along, across = quarter_turns(quarter)
    return short_cosine(rest) * along - short_sine(rest) * across


def tangent(x: Any) -> Any:
    """tan x, |x| < 10⁵ rad."""
    return sine(x) / cosine(x)


def short_arctangent(x: Any) -> Any:
    """The angle with tangent x, |x| ≤ 7/16."""
    z = x * x
    tail = 4.97687799461593236017e-02 + z * (-3.65315727442169155270e-02 + z * 1.62858201153657823623e-02)
    tail = 6.66107313738753120669e-02 + z * (-5.83357013379057348645e-02 + z * tail)
    tail = 9.09088713343650656196e-02 + z * (-7.69187620504482999495e-02 + z * tail)
    tail = 1.42857142725034663711e-01 + z * (-1.11111104054623557880e-01 + z * tail)
    tail = 3.33333333333329318027e-01 + z * (-1.99999999998764832476e-01 + z * tail)
    return x - x * (z * tail)


def arctangent_2(y: Any, x: Any) -> Any:
    """The angle of the vector (x, y), −π to π; 0 of the vector (0, 0). A negative zero counts as zero."""
    across, along = np.abs(y), np.abs(x)
    most, least = np.maximum(across, along), np.minimum(across, along)
    # The angle is taken from the nearest of three directions, whose tangents are 0, 1/2 and 1.
    half, eighth = least > 0.4375 * most, least > 0.6875 * most
    slope = 1.0 if eighth else (0.5 if half else 0.0)
    from_there = QUARTER_PI if eighth else (ANGLE_OF_HALF if half else 0.0)
    top, bottom = least - slope * most, most + slope * least
    angle = from_there + short_arctangent(top / np.maximum(bottom, SMALLEST))
    angle = HALF_PI - angle if across > along else angle
    angle = PI - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


def length(x: Any, y: Any) -> Any:
    """The length of the vector (x, y) where its square is a number, neither too large nor too small."""
    return np.sqrt(x * x + y * y)


def power_of_two(count: Any) -> Any:
    """2 to a whole number, −1022 to 1023."""
    left = np.abs(count)
    found = 1.0
    found, left = (1.3407807929942597e154 * found, left - 512.0) if left >= 512.0 else (found, left)
    found, left = (1.157920892373162e77 * found, left - 256.0) if left >= 256.0 else (found, left)
    found, left = (3.402823669209385e38 * found, left - 128.0) if left >= 128.0 else (found, left)
    found, left = (1.8446744073709552e19 * found, left - 64.0) if left >= 64.0 else (found, left)
    found, left = (4294967296.0 * found, left - 32.0) if left >= 32.0 else (found, left)
    found, left = (65536.0 * found, left - 16.0) if left >= 16.0 else (found, left)
    found, left = (256.0 * found, left - 8.0) if left >= 8.0 else (found, left)
    found, left = (16.0 * found, left - 4.0) if left >= 4.0 else (found, left)
    found, left = (4.0 * found, left - 2.0) if left >= 2.0 else (found, left)
    found = 2.0 * found if left >= 1.0 else found
    return 1.0 / found if count < 0.0 else found


def exponential(x: Any) -> Any:
    """eˣ, −700 ≤ x ≤ 700; beyond, its value at that end. The relative error is below 3e-16."""
    x = np.minimum(np.maximum(x, -700.0), 700.0)
    count = rounded(x * LOG_2_E)
    rest = (x - count * LOG_2_HIGH) - count * LOG_2_LOW
    z = rest * rest
    odd = rest * ((1.26177193074810590878e-4 * z + 3.02994407707441961300e-2) * z + 9.99999999999999999910e-1)
    even = (3.00198505138664455042e-6 * z + 2.52448340349684104192e-3) * z + 2.27265548208155028766e-1
    even = even * z + 2.0
    return (1.0 + 2.0 * (odd / (even - odd))) * power_of_two(count)


def small_and_whole(x: Any) -> Any:
    """A positive number as m·2ᵏ with 0.7 ≤ m ≤ 1.4. Returns (m, k)."""
    m, k = x, 0.0
    m, k = (7.458340731200207e-155 * m, k + 512.0) if m >= 1.3407807929942597e154 else (m, k)
    m, k = (8.636168555094445e-78 * m, k + 256.0) if m >= 1.157920892373162e77 else (m, k)
    m, k = (2.938735877055719e-39 * m, k + 128.0) if m >= 3.402823669209385e38 else (m, k)
    m, k = (5.421010862427522e-20 * m, k + 64.0) if m >= 1.8446744073709552e19 else (m, k)
    m, k = (2.3283064365386963e-10 * m, k + 32.0) if m >= 4294967296.0 else (m, k)
    m, k = (1.52587890625e-05 * m, k + 16.0) if m >= 65536.0 else (m, k)
    m, k = (0.00390625 * m, k + 8.0) if m >= 256.0 else (m, k)
    m, k = (0.0625 * m, k + 4.0) if m >= 16.0 else (m, k)
    m, k = (0.25 * m, k + 2.0) if m >= 4.0 else (m, k)
    m, k = (0.5 * m, k + 1.0) if m >= 2.0 else (m, k)
    m, k = (1.3407807929942597e154 * m, k - 512.0) if m < 1.4916681462400413e-154 else (m, k)
    m, k = (1.157920892373162e77 * m, k - 256.0) if m < 1.727233711018889e-77 else (m, k)
    m, k = (3.402823669209385e38 * m, k - 128.0) if m < 5.877471754111438e-39 else (m, k)
    m, k = (1.8446744073709552e19 * m, k - 64.0) if m < 1.0842021724855044e-19 else (m, k)
    m, k = (4294967296.0 * m, k - 32.0) if m < 4.656612873077393e-10 else (m, k)
    m, k = (65536.0 * m, k - 16.0) if m < 3.0517578125e-05 else (m, k)
    m, k = (256.0 * m, k - 8.0) if m < 0.0078125 else (m, k)
    m, k = (16.0 * m, k - 4.0) if m < 0.125 else (m, k)
    m, k = (4.0 * m, k - 2.0) if m < 0.5 else (m, k)
    m, k = (2.0 * m, k - 1.0) if m < 1.0 else (m, k)
    return (0.5 * m, k + 1.0) if m > 1.4 else (m, k)


def logarithm(x: Any) -> Any:
    """ln x of a positive number, 1e-307 ≤ x ≤ 1e307; for others it means nothing. The relative error is below 3e-16."""
    m, k = small_and_whole(x)
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    tail = 2.857142874366239149e-01 + z * (
        2.222219843214978396e-01
        + z * (1.818357216161805012e-01 + z * (1.531383769920937332e-01 + z * 1.479819860511658591e-01))
    )
    tail = z * (6.666666666666735130e-01 + z * (3.999999999940941908e-01 + z * tail))
    half = 0.5 * (f * f)
    return k * LOG_2_HIGH - ((half - (s * (half + tail) + k * LOG_2_LOW)) - f)


def hyperbolic_tangent(x: Any) -> Any:
    """tanh x. The relative error is below 3e-16."""
    size = np.abs(x)
    z = x * x
    upper = (-9.64399179425052238628e-1 * z - 9.92877231001918586564e1) * z - 1.61468768441708447952e3
    lower = ((z + 1.12811678491632931402e2) * z + 2.23548839060100448583e3) * z + 4.84406305325125486048e3
    near = x + x * (z * (upper / lower))
    far = 1.0 - 2.0 / (exponential(2.0 * size) + 1.0)
    far = -far if x < 0.0 else far
    return near if size < 0.625 else far


PLAIN = {
    "sin": sine,
    "cos": cosine,
    "tan": tangent,
    "atan2": arctangent_2,
    "hypot": length,
    "exp": exponential,
    "log": logarithm,
    "tanh": hyperbolic_tangent,
}
"""What takes the place of an operation."""


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
