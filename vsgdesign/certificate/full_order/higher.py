"""Programs on boxes in polynomials of third order, compiled: what the power loops are made of.

These are the programs of :mod:`~vsgdesign.certificate.taylor_kernel` with one order more, and one radius for all else.
A box has them once, and not for each arc, so that they may take longer; what a second order leaves out of them was most
of what was not known of f.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import Any

import numpy as np
from numba import njit

from vsgdesign.certificate.tracing import Operation

ORDER = 3
_VARIABLES = 6
_WIDTH = 64
"""Boxes that go through an instruction at once."""

_ROUNDING = 4e-15
"""Of the size of an operation's operands. A coefficient of a product is a sum of at most eight products: less than
10·2⁻⁵³ = 1.2e-15 of the sum of their sizes."""

_UP = 1.0 + 1e-13
"""More than what sums of a few hundred sizes are off by."""

_AFFINE, _BLEND, _PRODUCT = int(Operation.AFFINE), int(Operation.BLEND), int(Operation.PRODUCT)
_RECIPROCAL, _SINE, _COSINE = int(Operation.RECIPROCAL), int(Operation.SINE), int(Operation.COSINE)

_compiled: Any = njit(cache=True, nogil=True, error_model="numpy")


@functools.cache
def tables() -> tuple[Any, ...]:
    """Exponents (C, 6), the degree of each (C,), which coefficients multiply to which (m, 3), the places of the squares
    (6,), and the row of each coefficient of at most second order in a form of seven dimensions (C,), else −1."""
    every = [
        e
        for degree in range(ORDER + 1)
        for e in itertools.product(range(degree, -1, -1), repeat=_VARIABLES)
        if sum(e) == degree
    ]
    place = {e: k for k, e in enumerate(every)}
    pairs = []
    for (i, a), (j, b) in itertools.product(enumerate(every), repeat=2):
        if sum(a) + sum(b) <= ORDER:
            pairs.append((i, j, place[tuple(x + y for x, y in zip(a, b, strict=True))]))
    unit = np.eye(_VARIABLES, dtype=int)
    squares = [place[tuple(row)] for row in (2 * unit).tolist()]
    d = _VARIABLES + 1
    second = {(int(i), int(j)): 1 + d + n for n, (i, j) in enumerate(zip(*np.triu_indices(d), strict=True))}
    row = []
    for e in every:
        own = [k for k, power in enumerate(e) for _ in range(power)]
        row.append(0 if not own else 1 + own[0] if len(own) == 1 else second[own[0], own[1]] if len(own) == 2 else -1)
    exponents = np.array(every, dtype=np.int64)
    found = (exponents, exponents.sum(axis=1), np.array(pairs, dtype=np.uint32), np.array(squares, dtype=np.int64))
    return (*found, np.array(row, dtype=np.int64))


@_compiled
def _measure(form: Any, degree: Any) -> None:
    """The sizes by degree, after the coefficients; the radius comes last."""
    count = len(degree)
    for k in range(count, count + ORDER):
        for lane in range(_WIDTH):
            form[k, lane] = 0.0
    for k in range(1, count):
        row = count + degree[k] - 1
        for lane in range(_WIDTH):
            form[row, lane] += abs(form[k, lane])


@_compiled
def _size(form: Any, count: int, lane: int) -> float:
    total = abs(form[0, lane])
    for k in range(count, count + ORDER + 1):
        total += form[k, lane]
    return total


@_compiled
def _multiply(target: Any, a: Any, b: Any, has: Any, degree: Any, pairs: Any) -> None:
    """``has``: which coefficients are not zero, of target, a and b."""
    t_has, a_has, b_has = has
    count = len(degree)
    last = count + ORDER
    for k in range(count):
        t_has[k] = False
    for k in range(count):
        for lane in range(_WIDTH):
            target[k, lane] = 0.0
    for n in range(len(pairs)):  # unsigned: Numba then does not look for negative places
        i, j, k = pairs[n, 0], pairs[n, 1], pairs[n, 2]
        if a_has[i] and b_has[j]:
            t_has[k] = True
            for lane in range(_WIDTH):
                target[k, lane] += a[i, lane] * b[j, lane]
    for lane in range(_WIDTH):
        beyond = 0.0
        for m in range(1, ORDER + 1):
            for n in range(ORDER + 1 - m, ORDER + 1):
                beyond += a[count + m - 1, lane] * b[count + n - 1, lane]
        size_a, size_b = _size(a, count, lane), _size(b, count, lane)
        radius = beyond + a[last, lane] * size_b + b[last, lane] * (size_a - a[last, lane])
        target[last, lane] = (radius + _ROUNDING * size_a * size_b) * _UP
    _measure(target, degree)


@_compiled
def _combine(
    target: Any, blend: bool, offset: float, terms: Any, registers: Any, parameters: Any, has: Any, degree: Any
) -> None:
    own, every = has
    places, factors = terms
    count = len(degree)
    last = count + ORDER
    scale = np.empty(_WIDTH)
    for k in range(last + 1):
        for lane in range(_WIDTH):
            target[k, lane] = 0.0
    for lane in range(_WIDTH):
        target[0, lane] = offset
        target[last, lane] = _ROUNDING * abs(offset)
    now = np.zeros(count, dtype=np.bool_)
    now[0] = True
    for n in range(len(places)):
        source = registers[places[n]]
        for k in range(count):
            now[k] |= every[places[n], k]
        for lane in range(_WIDTH):
            scale[lane] = parameters[int(factors[n]), lane] if blend else factors[n]
        for k in range(count):
            for lane in range(_WIDTH):
                target[k, lane] += scale[lane] * source[k, lane]
        for lane in range(_WIDTH):
            more = source[last, lane] + _ROUNDING * _size(source, count, lane)
            target[last, lane] += abs(scale[lane]) * more
    # One by one, here and below: for a slice, Numba also compiles the words in which it refuses slices that do not fit.
    for k in range(count):
        own[k] = now[k]
    for lane in range(_WIDTH):
        target[last, lane] *= _UP
    _measure(target, degree)


@_compiled
def _series(operation: int, c: float, lowest: float, terms: Any, lane: int) -> float:
    """The Taylor coefficients of f at c; returns those of the first term that is left out, at its largest. 1/x: of
    d⁴/(c⁴x); sine and cosine: of d⁴/4!; √x: of binomial(½, 4)·d⁴ξ^(½ − 4)."""
    if operation == _RECIPROCAL:
        terms[0, lane] = 1.0 / c
        for k in range(1, ORDER + 1):
            terms[k, lane] = -terms[k - 1, lane] / c
        return abs(terms[ORDER, lane]) / lowest
    if operation in (_SINE, _COSINE):
        sine, cosine = math.sin(c), math.cos(c)
        terms[0, lane], terms[1, lane] = (sine, cosine) if operation == _SINE else (cosine, -sine)
        for k in range(2, ORDER + 1):
            terms[k, lane] = -terms[k - 2, lane] / (k * (k - 1))
        left = 1.0
        for k in range(2, ORDER + 2):
            left /= k
        return left
    terms[0, lane] = math.sqrt(c)
    left = math.sqrt(lowest)
    for k in range(1, ORDER + 2):
        factor = (1.5 - k) / k
        left *= abs(factor) / lowest
        if k <= ORDER:
            terms[k, lane] = terms[k - 1, lane] * factor / c
    return left


@_compiled
def _prepare(
    source: Any, operation: int, least: float, degree: Any, squares: Any, deviation: Any, terms: Any, left: Any
) -> None:
    """The series of f about the centre, how far the operand is from there, and what is left out, see ``taylor_kernel``:
    outside of its domain a function has no bound, and is infinite."""
    count = len(degree)
    positive = operation not in (_SINE, _COSINE)
    for k in range(count + ORDER + 1):
        for lane in range(_WIDTH):
            deviation[k, lane] = source[k, lane]
    for lane in range(_WIDTH):
        around = (_size(source, count, lane) - abs(source[0, lane])) * _UP + 4e-16 * abs(source[0, lane])
        lowest, highest = source[0, lane] - around, source[0, lane] + around
        for k in squares:  # of a square, one sign only
            lowest += max(source[k, lane], 0.0) * (1.0 - 1e-13)
            highest -= max(-source[k, lane], 0.0) * (1.0 - 1e-13)
        if positive:
            lowest = max(lowest, least)
            highest = max(highest, lowest)
        bad = not (highest < math.inf and lowest > (0.0 if positive else -math.inf))
        if bad:
            lowest, highest = 1.0, 1.0
        c = min(max(source[0, lane] if not bad else 1.0, lowest), highest)
        furthest = max(highest - c, c - lowest) * (1.0 + 1e-12)
        beyond = _series(operation, c, lowest, terms, lane) * (1.0 + 1e-12)
        for _ in range(ORDER + 1):
            beyond *= furthest
        left[lane] = math.inf if bad else beyond
        deviation[0, lane] -= c


@_compiled
def _apply(
    target: Any, source: Any, operation: int, least: float, scratch: Any, has: Any, degree: Any, lists: Any
) -> None:
    """f by its Taylor series about the centre, from its last term on."""
    pairs, squares = lists
    own, of_source = has
    now = np.zeros((3, len(degree)), dtype=np.bool_)
    count = len(degree)
    for k in range(count):
        now[2, k] = of_source[k]
    now[:, 0] = True  # the deviation has a constant where the centre is not the operand's own
    last = count + ORDER
    deviation, other = scratch[0], scratch[1]
    terms, left = np.empty((ORDER + 1, _WIDTH)), np.empty(_WIDTH)
    _prepare(source, operation, least, degree, squares, deviation, terms, left)
    for k in range(last + 1):
        for lane in range(_WIDTH):
            target[k, lane] = terms[ORDER, lane] if k == 0 else 0.0
    for lane in range(_WIDTH):
        target[last, lane] = _ROUNDING * abs(terms[ORDER, lane])
    for turn in range(ORDER):
        _multiply(other, target, deviation, (now[1], now[0], now[2]), degree, pairs)
        for k in range(count):
            now[0, k] = now[1, k] or k == 0
        for k in range(last + 1):
            for lane in range(_WIDTH):
                target[k, lane] = other[k, lane]
        for lane in range(_WIDTH):
            term = terms[ORDER - 1 - turn, lane]
            target[0, lane] += term
            target[last, lane] += _ROUNDING * (abs(term) + abs(target[0, lane]))
    for k in range(count):
        own[k] = now[0, k]
    for lane in range(_WIDTH):
        target[last, lane] = (target[last, lane] + left[lane]) * _UP


@_compiled
def _run(program: Any, registers: Any, parameters: Any, has: Any, degree: Any, lists: Any) -> None:
    """All instructions on registers whose inputs are set, see ``taylor_kernel.run_program``."""
    code, number, places, factors = program
    scratch = np.zeros((2, registers.shape[1], _WIDTH))
    for n in range(len(code)):
        operation, own, first, last = code[n]
        target = registers[own]
        if operation <= _BLEND:
            terms = (places[first:last], factors[first:last])
            _combine(target, operation == _BLEND, number[n], terms, registers, parameters, (has[own], has), degree)
        elif operation == _PRODUCT:
            of = (has[own], has[first], has[last])
            _multiply(target, registers[first], registers[last], of, degree, lists[0])
        else:
            _apply(target, registers[first], operation, number[n], scratch, (has[own], has[first]), degree, lists)


@_compiled
def _load(target: Any, lane: int, small: Any, imaginary: bool, exponents: Any, degree: Any) -> None:
    """A form of the grid's two coordinates, ``small`` (11,) complex in the order of ``forms.EXPONENTS``."""
    for k in range(len(degree)):
        a, b = exponents[k, 0], exponents[k, 1]
        if degree[k] > 2 or a + b < degree[k]:
            continue
        place = a + 2 * b if degree[k] < 2 else 4 if a == 2 else 5 if a == 1 else 7
        target[k, lane] = small[place].imag if imaginary else small[place].real
    target[len(degree) + ORDER, lane] = small[10].real


@_compiled
def _given(registers: Any, boxes: Any, rest: Any, start: int, exponents: Any, degree: Any) -> None:
    """The coordinates of boxes and the rest of their cells, see ``kernel.survey``, and then any number between −1 and
    1."""
    low, high, cell = boxes
    last, coordinates = len(degree) + ORDER, low.shape[1]
    for n in range(len(registers)):
        for k in range(last + 1):
            for lane in range(_WIDTH):
                registers[n, k, lane] = 0.0
    for lane in range(_WIDTH):
        box = min(start + lane, len(low) - 1)
        for n in range(coordinates):
            least, most = low[box, n], high[box, n]
            registers[n, 0, lane] = 0.5 * (least + most)
            registers[n, 1 + n, lane] = 0.5 * (most - least)
            # More than by what the widths are rounded up elsewhere.
            registers[n, last, lane] = 1e-15 * (abs(least) + abs(most))
        for n in range(4):
            _load(registers[coordinates + n], lane, rest[cell[box], n // 2], n % 2 == 1, exponents, degree)
    if len(registers) > coordinates + 4:
        for lane in range(_WIDTH):
            registers[coordinates + 4, last, lane] = 1.0
    for n in range(len(registers)):
        _measure(registers[n], degree)


@_compiled
def _cut(form: Any, lane: int, lists: Any, degree: Any, found: Any) -> None:
    """A form as one of second order in seven dimensions, ``found`` (rows(7),): what is of a higher order is
    shared out among its dimensions, the radius by how much each moves the form."""
    exponents, row = lists
    count, d = len(degree), _VARIABLES + 1
    last = 1 + d + d * (d + 1) // 2
    for k in range(len(found)):
        found[k] = 0.0
    moved, radius = 0.0, form[count + ORDER, lane] * _UP
    moves = np.zeros(_VARIABLES)
    for k in range(1, count):
        moved += abs(form[k, lane])
        for n in range(_VARIABLES):
            moves[n] += abs(form[k, lane]) * exponents[k, n] / degree[k]
    for k in range(count):
        if row[k] >= 0:
            found[row[k]] = form[k, lane]
        else:
            for n in range(_VARIABLES):
                found[last + n] += abs(form[k, lane]) * exponents[k, n] / degree[k] * _UP
    for n in range(_VARIABLES):
        share = moves[n] / moved if moved > 0.0 else 1.0 / _VARIABLES
        found[last + n] += radius * share * _UP
    for k in range(1, last + d):
        found[last + d + (0 if k <= d else 1 if k < last else 2)] += abs(found[k])


@_compiled
def gains_of(boxes: Any, rest: Any, parameters: Any, program: Any, lists: Any, found: Any) -> None:
    """What the power loops of N boxes are made of, ``found`` (N, outputs, rows(7)). ``boxes``: low and high limits
    (N, 6) and the cell of each (N,); ``rest``: that of the cells (cells, 2, 11); ``lists``: :func:`tables`."""
    low = boxes[0]
    code, number, places, factors, outputs, count = program
    exponents, degree, pairs, squares, row = lists
    registers = np.zeros((count, len(degree) + ORDER + 1, _WIDTH))
    own, has = np.zeros((len(parameters), _WIDTH)), np.zeros((count, len(degree)), dtype=np.bool_)
    given = registers[: _VARIABLES + 5]
    for start in range(0, len(low), _WIDTH):
        _given(given, boxes, rest, start, exponents, degree)
        for lane in range(_WIDTH):
            box = min(start + lane, len(low) - 1)
            for k in range(len(parameters)):
                own[k, lane] = parameters[k, box]
        for n in range(len(given)):
            for k in range(len(degree)):
                has[n, k] = False
                for lane in range(_WIDTH):
                    has[n, k] |= registers[n, k, lane] != 0.0
        _run((code, number, places, factors), registers, own, has, degree, (pairs, squares))
        for lane in range(min(_WIDTH, len(low) - start)):
            for n in range(len(outputs)):
                _cut(registers[outputs[n]], lane, (exponents, row), degree, found[start + lane, n])
