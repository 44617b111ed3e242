"""Programs on boxes, compiled: every register is a polynomial of second order over a box and a bound on all else.

Taylor models: Makino and Berz (1996), here of second order. What is left is kept by dimension, so that a box
that is too large can be cut where it hurts. ``LANES`` boxes go through an instruction at once.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from vsgdesign.certificate.tracing import Operation

LANES = 64

SEEN = 0.3
"""How much what is followed exactly counts, beside what is unknown, in the choice of where to cut a box."""

_ROUNDING = 4e-15
"""Of the size of an operation's operands: more than what the floating-point sums of an operation are off by."""

_AFFINE, _BLEND, _PRODUCT = int(Operation.AFFINE), int(Operation.BLEND), int(Operation.PRODUCT)
_RECIPROCAL, _SINE, _COSINE = int(Operation.RECIPROCAL), int(Operation.SINE), int(Operation.COSINE)

_compiled: Any = njit(cache=True, nogil=True, error_model="numpy")


@_compiled
def rows(d: int) -> int:
    """Rows of a register over d dimensions (:eq:`taylor-form`): centre, d linear, d(d + 1)/2 square in the order of
    ``np.triu_indices``, d of rest; then the sums of absolute values of linear, square and rest."""
    return 1 + d + d * (d + 1) // 2 + d + 3


@_compiled
def sum_up(form: Any, d: int) -> None:
    """The last three rows of a register."""
    last = 1 + d + d * (d + 1) // 2
    total = last + d
    for lane in range(LANES):
        form[total, lane] = 0.0
        form[total + 1, lane] = 0.0
        form[total + 2, lane] = 0.0
    for k in range(1, 1 + d):
        for lane in range(LANES):
            form[total, lane] += abs(form[k, lane])
    for k in range(1 + d, last):
        for lane in range(LANES):
            form[total + 1, lane] += abs(form[k, lane])
    for k in range(last, total):
        for lane in range(LANES):
            form[total + 2, lane] += form[k, lane]


@_compiled
def run_program(code: Any, number: Any, places: Any, factors: Any, registers: Any, parameters: Any, d: int) -> None:
    """All instructions on registers (R, rows(d), LANES) whose inputs are set; ``parameters`` (m, LANES)."""
    scratch = np.zeros((4, rows(d), LANES))
    for n in range(len(code)):
        target, first, last = registers[code[n, 1]], code[n, 2], code[n, 3]
        operation = code[n, 0]
        if operation <= _BLEND:
            _combine(
                target,
                operation == _BLEND,
                number[n],
                places[first:last],
                factors[first:last],
                registers,
                parameters,
                d,
            )
        elif operation == _PRODUCT:
            _multiply(target, registers[first], registers[last], d)
        else:
            _apply(target, registers[first], operation, number[n], scratch, d)


@_compiled
def _combine(
    target: Any, blend: bool, offset: float, places: Any, factors: Any, registers: Any, parameters: Any, d: int
) -> None:
    last = 1 + d + d * (d + 1) // 2
    total = last + d
    scale = np.empty(LANES)
    target[:total] = 0.0
    for lane in range(LANES):
        target[0, lane] = offset
        target[last, lane] = _ROUNDING * abs(offset)
    for n in range(len(places)):
        source = registers[places[n]]
        for lane in range(LANES):
            scale[lane] = factors[n]
        if blend:
            index = int(factors[n])
            for lane in range(LANES):
                scale[lane] = parameters[index, lane]
        for k in range(last):
            for lane in range(LANES):
                target[k, lane] += scale[lane] * source[k, lane]
        for k in range(last, total):
            for lane in range(LANES):
                target[k, lane] += abs(scale[lane]) * source[k, lane]
        for lane in range(LANES):
            size = abs(source[0, lane]) + source[total, lane] + source[total + 1, lane] + source[total + 2, lane]
            target[last, lane] += _ROUNDING * abs(scale[lane]) * size
    sum_up(target, d)


@_compiled
def _multiply(target: Any, a: Any, b: Any, d: int) -> None:
    """(:eq:`taylor-form`): third order and more is shared out by how much each dimension moves either factor."""
    last = 1 + d + d * (d + 1) // 2
    total = last + d
    size_a, size_b, higher = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    per_a, per_b, even = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    for lane in range(LANES):
        a_1, a_2, b_1, b_2 = a[total, lane], a[total + 1, lane], b[total, lane], b[total + 1, lane]
        size_a[lane] = abs(a[0, lane]) + a_1 + a_2
        size_b[lane] = abs(b[0, lane]) + b_1 + b_2 + b[total + 2, lane]
        higher[lane] = a_1 * b_2 + a_2 * (b_1 + b_2)
        one = 1.0 if a_1 > 0.0 else 0.0
        other = 1.0 if b_1 > 0.0 else 0.0
        movers = max(one + other, 1.0)
        per_a[lane] = one * higher[lane] / ((a_1 + (1.0 - one)) * movers)
        per_b[lane] = other * higher[lane] / ((b_1 + (1.0 - other)) * movers)
        even[lane] = higher[lane] * (1.0 - max(one, other)) / d
    for k in range(1, last):
        for lane in range(LANES):
            target[k, lane] = a[0, lane] * b[k, lane] + b[0, lane] * a[k, lane]
    for lane in range(LANES):
        target[0, lane] = a[0, lane] * b[0, lane]
    k = 1 + d
    for i in range(d):
        for lane in range(LANES):
            target[k, lane] += a[1 + i, lane] * b[1 + i, lane]
        k += 1
        for j in range(i + 1, d):
            for lane in range(LANES):
                target[k, lane] += a[1 + i, lane] * b[1 + j, lane] + a[1 + j, lane] * b[1 + i, lane]
            k += 1
    for i in range(d):
        for lane in range(LANES):
            target[last + i, lane] = (
                a[last + i, lane] * size_b[lane]
                + b[last + i, lane] * size_a[lane]
                + even[lane]
                + abs(a[1 + i, lane]) * per_a[lane]
                + abs(b[1 + i, lane]) * per_b[lane]
            )
    for lane in range(LANES):
        target[last, lane] += _ROUNDING * (size_a[lane] + a[total + 2, lane]) * size_b[lane]
    sum_up(target, d)


@_compiled
def limits(form: Any, d: int, low: Any, high: Any) -> None:
    """Bounds of a register, (LANES,) each: t_k² lies between 0 and 1, all other terms between −1 and 1."""
    last = 1 + d + d * (d + 1) // 2
    total = last + d
    for lane in range(LANES):
        around = form[total, lane] + form[total + 1, lane] + form[total + 2, lane]
        low[lane] = form[0, lane] - around
        high[lane] = form[0, lane] + around
    k = 1 + d
    for i in range(d):
        # Of a square, one sign only.
        for lane in range(LANES):
            low[lane] += max(form[k, lane], 0.0)
            high[lane] -= max(-form[k, lane], 0.0)
        k += d - i


@_compiled
def _apply(target: Any, source: Any, operation: int, least: float, scratch: Any, d: int) -> None:
    """f by its Taylor series about the centre. What is left of third order: 1/x: |d|³/(c³x); sine and cosine: |d|³/6;
    √x: |d|³/(16 ξ^{5/2}). Outside of its domain a function has no bound: infinite."""
    last = 1 + d + d * (d + 1) // 2
    total = last + d
    deviation, square, low, high = scratch[0], scratch[1], scratch[2, 0], scratch[2, 1]
    slope, bend, left, about = scratch[3, 0], scratch[3, 1], scratch[3, 2], scratch[3, 3]
    limits(source, d, low, high)
    for k in range(total + 3):
        for lane in range(LANES):
            deviation[k, lane] = source[k, lane]
    positive = operation != _SINE and operation != _COSINE
    for lane in range(LANES):
        lowest, highest = low[lane], high[lane]
        if positive:
            lowest = max(lowest, least)
            highest = max(highest, lowest)
        bad = not (highest < math.inf and lowest > (0.0 if positive else -math.inf))
        if bad:
            lowest, highest = 1.0, 1.0
        c = min(max(source[0, lane] if not bad else 1.0, lowest), highest)
        furthest = max(highest - c, c - lowest)
        if operation == _RECIPROCAL:
            value, slope[lane] = 1.0 / c, -1.0 / (c * c)
            bend[lane] = 1.0 / (c * c * c)
            third = 1.0 / (c * c * c * lowest)
        elif operation == _SINE:
            value, slope[lane] = math.sin(c), math.cos(c)
            bend[lane], third = -0.5 * value, 1.0 / 6.0
        elif operation == _COSINE:
            value, slope[lane] = math.cos(c), -math.sin(c)
            bend[lane], third = -0.5 * value, 1.0 / 6.0
        else:
            value = math.sqrt(c)
            slope[lane], bend[lane] = 0.5 / value, -0.125 / (value * c)
            third = 0.0625 / (lowest * lowest * math.sqrt(lowest))
        left[lane] = math.inf if bad else third * furthest * furthest * furthest
        deviation[0, lane] -= c
        about[lane] = value
    _multiply(square, deviation, deviation, d)
    for k in range(last):
        for lane in range(LANES):
            target[k, lane] = slope[lane] * deviation[k, lane] + bend[lane] * square[k, lane]
    for i in range(d):
        for lane in range(LANES):
            moved = source[total, lane]
            share = abs(source[1 + i, lane]) / moved if moved > 0.0 else 1.0 / d
            target[last + i, lane] = (
                abs(slope[lane]) * deviation[last + i, lane]
                + abs(bend[lane]) * square[last + i, lane]
                + left[lane] * share
            )
    for lane in range(LANES):
        size = (
            abs(deviation[0, lane]) + deviation[total, lane] + deviation[total + 1, lane] + deviation[total + 2, lane]
        )
        target[0, lane] += about[lane]
        target[last, lane] += _ROUNDING * (abs(about[lane]) + abs(slope[lane]) * size + abs(bend[lane]) * size * size)
    sum_up(target, d)


@_compiled
def negative(entries: Any, d: int, proved: Any, score: Any, weight: Any) -> None:
    """Whether a symmetric n × n matrix of registers (n(n + 1)/2, rows(d), LANES; 11, 22, 33, …, 12, 13, …, 23, …) is
    negative definite on the whole box, ``proved`` (LANES,) and-ed; ``score`` (d, LANES) is raised to what each
    dimension leaves unknown (:eq:`box-bound`), ``weight`` (n(n + 1)/2, LANES) to how much an entry counts in that.

    t_k² is 1/2 ± 1/2; without that, and without the rest, the matrix is affine in each t_k, and definite where it is
    at all corners. What is left is an interval of every entry: definite where four sign patterns are (Rohn, 1994), or,
    for more than three rows, where it is with what the widths can do on its diagonal.
    """
    last = 1 + d + d * (d + 1) // 2
    size = len(entries)
    middle, unknown, corner = np.empty((size, LANES)), np.empty((size, LANES)), np.empty((size, LANES))
    linear, cross = np.empty((size, d, LANES)), np.empty((size, d * (d - 1) // 2, LANES))
    live = np.zeros(d, dtype=np.bool_)
    pull, counts = np.zeros((d, LANES)), np.ones((size, LANES))
    for m in range(size):
        form = entries[m]
        for lane in range(LANES):
            middle[m, lane] = form[0, lane]
        k = 1 + d
        for i in range(d):
            for lane in range(LANES):
                middle[m, lane] += 0.5 * form[k, lane]
            k += d - i
    _weigh(middle, counts)
    for m in range(size):
        form = entries[m]
        for lane in range(LANES):
            unknown[m, lane] = 0.0
            weight[m, lane] = max(weight[m, lane], counts[m, lane])
        k, n = 1 + d, 0
        for i in range(d):
            for lane in range(LANES):
                left = abs(0.5 * form[k, lane]) + form[last + i, lane]
                unknown[m, lane] += left
                linear[m, i, lane] = form[1 + i, lane]
                pull[i, lane] += counts[m, lane] * (left + SEEN * abs(form[1 + i, lane]))
                live[i] |= form[1 + i, lane] != 0.0
            k += 1
            for j in range(i + 1, d):
                for lane in range(LANES):
                    cross[m, n, lane] = form[k, lane]
                    if form[k, lane] != 0.0:
                        live[i] = True
                        live[j] = True
                k += 1
                n += 1
    for i in range(d):
        for lane in range(LANES):
            if not pull[i, lane] <= score[i, lane]:  # NaN stays
                score[i, lane] = pull[i, lane]
    signs = np.ones(d)
    for index in range(2**d):
        skip = True
        for lane in range(LANES):  # where no box can be proved any more, there is nothing to look at
            skip &= not proved[lane]
        for i in range(d):
            up = (index >> i) & 1 == 1
            skip |= up and not live[i]
            signs[i] = -1.0 if up else 1.0
        if skip:
            continue
        for m in range(size):
            for lane in range(LANES):
                corner[m, lane] = middle[m, lane]
            n = 0
            for i in range(d):
                if live[i]:
                    for lane in range(LANES):
                        corner[m, lane] += signs[i] * linear[m, i, lane]
                for j in range(i + 1, d):
                    if live[i] and live[j]:
                        both = signs[i] * signs[j]
                        for lane in range(LANES):
                            corner[m, lane] += both * cross[m, n, lane]
                    n += 1
        if size == 6:
            _definite(corner, unknown, proved)
        else:
            _definite_by_rows(corner, unknown, proved)


@_compiled
def _definite(centre: Any, radius: Any, proved: Any) -> None:
    """Pivots of −(centre ± radius) in the four worst sign patterns, all above what rounding can do to them."""
    for lane in range(LANES):
        a = -centre[0, lane] - radius[0, lane]
        b = -centre[1, lane] - radius[1, lane]
        c = -centre[2, lane] - radius[2, lane]
        shift = 1e-13 * (abs(a) + abs(b) + abs(c))
        a, b, c = a - shift, b - shift, c - shift
        x, y, z = -centre[3, lane], -centre[4, lane], -centre[5, lane]
        u, v, w = radius[3, lane], radius[4, lane], radius[5, lane]
        good = a > 0.0
        for pattern in range(4):
            s = 1.0 if pattern & 1 else -1.0
            t = 1.0 if pattern & 2 else -1.0
            # −(centre) − T radius T: entry ij less s_i s_j radius, with signs 1, s, t.
            f, g, h = x - s * u, y - t * v, z - s * t * w
            second = b - f * f / a
            rest = h - f * g / a
            third = c - g * g / a - rest * rest / second
            good = good and second > 0.0 and third > 0.0
        if not good:
            proved[lane] = False


@_compiled
def _definite_by_rows(centre: Any, radius: Any, proved: Any) -> None:
    """Whether −centre is definite with what the radius can do taken off its diagonal.

    2|x_i x_j| is at most w x_i² + x_j²/w for every w > 0. The least definite direction has elements about as large as
    the roots of the inverse's diagonal: with w their ratio, a fast state carries most of what is not known of its
    coupling to a slow one.
    """
    n = _rows_of(len(centre))
    pivots = np.zeros((n, n, LANES))
    reach, good = np.zeros((n, LANES)), np.ones(LANES, dtype=np.bool_)
    _fill(pivots, centre)
    _reach(pivots, reach, good)
    _fill(pivots, centre)
    m = n
    for i in range(n):
        for lane in range(LANES):
            pivots[i, i, lane] -= radius[i, lane]
        for j in range(i + 1, n):
            for lane in range(LANES):
                weight = math.sqrt(reach[j, lane] / reach[i, lane]) if good[lane] else 1.0
                pivots[i, i, lane] -= radius[m, lane] * weight
                pivots[j, j, lane] -= radius[m, lane] / weight
            m += 1
    shift = np.zeros(LANES)
    for i in range(n):
        for lane in range(LANES):
            shift[lane] += abs(pivots[i, i, lane])
    for k in range(n):
        for lane in range(LANES):
            pivots[k, k, lane] -= 1e-13 * shift[lane]
    _eliminate(pivots, good)
    for lane in range(LANES):
        if not good[lane]:
            proved[lane] = False


@_compiled
def _weigh(centre: Any, counts: Any) -> None:
    """How much what is not known of each entry (n(n + 1)/2, LANES) counts beside how definite −centre is: the size of
    the entry's two elements in the least definite direction. Where −centre is not definite, of its diagonal."""
    n = _rows_of(len(centre))
    pivots, reach, good = np.zeros((n, n, LANES)), np.zeros((n, LANES)), np.ones(LANES, dtype=np.bool_)
    _fill(pivots, centre)
    _reach(pivots, reach, good)
    for i in range(n):
        for lane in range(LANES):
            own = abs(centre[i, lane])
            reach[i, lane] = math.sqrt(reach[i, lane] if good[lane] else (1.0 / own if own > 0.0 else 1.0))
    m = n
    for i in range(n):
        for lane in range(LANES):
            counts[i, lane] = reach[i, lane] * reach[i, lane]
        for j in range(i + 1, n):
            for lane in range(LANES):
                counts[m, lane] = 2.0 * reach[i, lane] * reach[j, lane]
            m += 1


@_compiled
def _rows_of(size: int) -> int:
    """Rows of a symmetric matrix with so many entries on and above its diagonal."""
    n = 3
    while n * (n + 1) // 2 < size:
        n += 1
    return n


@_compiled
def _reach(pivots: Any, reach: Any, good: Any) -> None:
    """The diagonal of the inverse, (n, LANES), of a matrix by its lower triangle (n, n, LANES), which is eliminated."""
    n = len(pivots)
    inverse = np.zeros((n, n, LANES))
    _eliminate(pivots, good)
    # The columns of the inverse of the unit lower factor; the diagonal of the inverse follows from them.
    for i in range(n):
        for lane in range(LANES):
            inverse[i, i, lane] = 1.0
        for j in range(i + 1, n):
            for k in range(i, j):
                for lane in range(LANES):
                    inverse[j, i, lane] -= pivots[j, k, lane] / pivots[k, k, lane] * inverse[k, i, lane]
        for j in range(i, n):
            for lane in range(LANES):
                reach[i, lane] += inverse[j, i, lane] * inverse[j, i, lane] / pivots[j, j, lane]


@_compiled
def _fill(matrix: Any, entries: Any) -> None:
    """The lower triangle of a matrix (n, n, LANES) with the opposite of its entries (n(n + 1)/2, LANES)."""
    n = len(matrix)
    m = n
    for i in range(n):
        for lane in range(LANES):
            matrix[i, i, lane] = -entries[i, lane]
        for j in range(i + 1, n):
            for lane in range(LANES):
                matrix[j, i, lane] = -entries[m, lane]
            m += 1


@_compiled
def _eliminate(matrix: Any, good: Any) -> None:
    """Pivots on the diagonal of a lower triangle (n, n, LANES); ``good`` (LANES,) is and-ed with whether all are
    positive."""
    n = len(matrix)
    for k in range(n):
        for lane in range(LANES):
            good[lane] &= matrix[k, k, lane] > 0.0
        for i in range(k + 1, n):
            for j in range(k + 1, i + 1):
                for lane in range(LANES):
                    matrix[i, j, lane] -= matrix[i, k, lane] * matrix[j, k, lane] / matrix[k, k, lane]
