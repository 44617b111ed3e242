"""Tapes of forms, compiled: every operation on many columns, in blocks that stay in the processor's cache."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vsgdesign.certificate.full_order.forms import (
    ADD,
    ALL,
    CONJUGATE,
    COUNT,
    DEGREES,
    EXPONENTS,
    MOVE,
    MULTIPLY,
    ORDER,
    RECIPROCAL,
    ROWS,
    SCALE,
    SUBTRACT,
    WIDEN,
    Form,
    Tape,
    Values,
    kind_of,
)

Array = NDArray[np.float64]

_BLOCK = 16

_ROUNDING = 2e-14
"""Of the size of an operation's operands. A coefficient of a product is a sum of at most 18 complex products: 36 real
ones and their sum are off by less than 38·2⁻⁵³ = 4.2e-15 of the sum of their sizes."""

_MOST_OFF = 0.95
"""Of a reciprocal's operand, relative to its centre."""

_compiled: Any = njit(cache=True, nogil=True, error_model="numpy")


@dataclass(frozen=True)
class Program:
    """A tape with its registers used again. ``code`` (n, 6): operation, kinds of both operands, target and operands
    (or the place of a parameter); ``numbers`` (n,)."""

    code: NDArray[np.int64]
    numbers: NDArray[np.complex128]
    inputs: tuple[int, ...]
    """Kinds of the forms that are given."""
    outputs: NDArray[np.int64]
    kinds: tuple[int, ...]
    """Of the outputs."""
    registers: int


def program_of(tape: Tape, results: list[Form]) -> Program:
    """What computes the results, and nothing else."""
    wanted = [form.place for form in results]
    last = dict.fromkeys(wanted, len(tape.kinds))
    for operation, target, one, other, _ in reversed(tape.steps):
        if target in last:
            last.setdefault(one, target)
            if operation in (ADD, SUBTRACT, MULTIPLY):
                last.setdefault(other, target)
    register = {k: k for k in range(tape.inputs)}
    free: list[int] = []
    count = tape.inputs
    code, numbers = [], []
    for operation, target, one, other, number in tape.steps:
        if target not in last:
            continue
        if free:
            register[target] = free.pop()
        else:
            register[target], count = count, count + 1
        two = operation in (ADD, SUBTRACT, MULTIPLY)
        kinds = tape.kinds[one], tape.kinds[other] if two else tape.kinds[one]
        code.append((operation, *kinds, register[target], register[one], register[other] if two else other))
        numbers.append(number)
        for operand in {one, other} if two else {one}:
            if operand >= tape.inputs and last.get(operand) == target:
                free.append(register[operand])
    return Program(
        np.array(code, dtype=np.int64).reshape(-1, 6),
        np.array(numbers, dtype=complex),
        tuple(tape.kinds[: tape.inputs]),
        np.array([register[k] for k in wanted], dtype=np.int64),
        tuple(tape.kinds[k] for k in wanted),
        count,
    )


def run(program: Program, given: list[Values], count: int, parameters: Array | None = None) -> list[Values]:
    """The outputs for ``count`` columns. ``parameters`` (m, count): radii that are added."""
    tables = _tables()
    re, im = np.zeros((len(given), COUNT, count)), np.zeros((len(given), COUNT, count))
    radius = np.zeros((len(given), count))
    for k, values in enumerate(given):
        rows = len(ROWS[values.kind])
        re[k, :rows], im[k, :rows], radius[k] = values.re, values.im, values.radius
    out = len(program.outputs)
    found = np.zeros((out, COUNT, count)), np.zeros((out, COUNT, count)), np.zeros((out, count))
    more = np.zeros((1, count)) if parameters is None else parameters
    kinds = np.array(program.inputs, dtype=np.int64)
    all_given = (re, im, radius, more)
    _run(program.code, program.numbers, kinds, program.outputs, program.registers, all_given, tables, found)
    results = []
    for k, kind in enumerate(program.kinds):
        rows = len(ROWS[kind])
        results.append(Values(found[0][k, :rows], found[1][k, :rows], found[2][k], kind))
    return results


@functools.cache
def _tables() -> tuple[Any, ...]:
    """Which coefficients multiply to which for every two kinds, (3, 3, 2) places in (m, 3); numbers of rows; degrees of
    rows (3, COUNT); places of rows among all (3, COUNT)."""
    place = {e: k for k, e in enumerate(EXPONENTS)}
    spans, found = np.zeros((3, 3, 2), dtype=np.int64), []
    for one, other in itertools.product(range(3), repeat=2):
        result = {int(k): n for n, k in enumerate(ROWS[kind_of(one, other)])}
        spans[one, other, 0] = len(found)
        own = []
        for n, k in enumerate(ROWS[one]):
            for m, j in enumerate(ROWS[other]):
                total = tuple(a + b for a, b in zip(EXPONENTS[k], EXPONENTS[j], strict=True))
                if sum(total) <= ORDER:
                    own.append((result[place[total]], n, m))
        found += sorted(own)
        spans[one, other, 1] = len(found)
    counts = np.array([len(rows) for rows in ROWS], dtype=np.int64)
    degrees, places = np.zeros((3, COUNT), dtype=np.int64), np.zeros((3, COUNT), dtype=np.int64)
    for kind, rows in enumerate(ROWS):
        degrees[kind, : len(rows)], places[kind, : len(rows)] = DEGREES[kind], rows
    return spans, np.array(found, dtype=np.int64), counts, degrees, places


@_compiled
def _measure(re: Any, im: Any, rows: int, degrees: Any, sizes: Any) -> None:
    """Sums of the sizes of coefficients by degree, (ORDER + 1, lanes)."""
    sizes[:] = 0.0
    for k in range(rows):
        d = degrees[k]
        for lane in range(re.shape[1]):
            sizes[d, lane] += math.sqrt(re[k, lane] * re[k, lane] + im[k, lane] * im[k, lane])


@_compiled
def _product(a: Any, b: Any, c: Any, d: Any, pairs: Any, rows: int, re: Any, im: Any) -> None:
    """(a + jb)(c + jd)."""
    for k in range(rows):
        for lane in range(re.shape[1]):
            re[k, lane] = 0.0
            im[k, lane] = 0.0
    for m in range(len(pairs)):
        k, i, j = pairs[m, 0], pairs[m, 1], pairs[m, 2]
        for lane in range(re.shape[1]):
            re[k, lane] += a[i, lane] * c[j, lane] - b[i, lane] * d[j, lane]
            im[k, lane] += a[i, lane] * d[j, lane] + b[i, lane] * c[j, lane]


@_compiled
def _left_out(one: Any, other: Any, r_one: Any, r_other: Any, radius: Any) -> None:
    """The radius of a product from sizes by degree and radii, with what rounding adds."""
    most = one.shape[0]
    for lane in range(radius.shape[0]):
        higher, a, b = 0.0, 0.0, 0.0
        for n in range(most):
            a += one[n, lane]
            b += other[n, lane]
            for m in range(most - n, most):
                higher += one[n, lane] * other[m, lane]
        r, s = r_one[lane], r_other[lane]
        radius[lane] = (higher + a * s + b * r + r * s + _ROUNDING * (a + r) * (b + s)) * (1.0 + 1e-12)


@_compiled
def _size(sizes: Any, radius: Any, lane: int) -> float:
    total = radius[lane]
    for n in range(sizes.shape[0]):
        total += sizes[n, lane]
    return total * (1.0 + 1e-12)


@_compiled
def _turned(form: Any, lane: int) -> Any:
    """1/c of the centre c; zero where it has none."""
    c, s = form[0][0, lane], form[1][0, lane]
    size = c * c + s * s
    if 0.0 < size < np.inf:
        return c / size, -s / size
    return 0.0, 0.0


@_compiled
def _off_from_one(form: Any, rows: int, off: Any) -> None:
    """1 − x/c, with c the centre."""
    re, im, radius, sizes = form
    for lane in range(re.shape[1]):
        u, v = _turned(form, lane)
        for k in range(rows):
            off[0][k, lane] = -(re[k, lane] * u - im[k, lane] * v)
            off[1][k, lane] = -(re[k, lane] * v + im[k, lane] * u)
        off[0][0, lane] += 1.0
        scale = math.sqrt(u * u + v * v)
        off[2][lane] = (scale * radius[lane] + _ROUNDING * (1.0 + scale * _size(sizes, radius, lane))) * (1.0 + 1e-12)


@_compiled
def _one_more(source: Any, rows: int, target: Any) -> None:
    """x + 1."""
    for k in range(rows):
        for lane in range(source[0].shape[1]):
            target[0][k, lane] = source[0][k, lane]
            target[1][k, lane] = source[1][k, lane]
    for lane in range(source[0].shape[1]):
        size = math.hypot(source[0][0, lane], source[1][0, lane])
        target[0][0, lane] += 1.0
        target[2][lane] = source[2][lane] + _ROUNDING * (2.0 + size)


@_compiled
def _invert(form: Any, kind: int, tables: Any, target: Any, off: Any, now: Any) -> None:
    """1/x = 1/c Σ (1 − x/c)^k to the fifth, about the centre c. A form here is its coefficients, its radius and its
    sizes; ``off`` and ``now`` are room for two more."""
    spans, pairs, counts, degrees, _ = tables
    rows = counts[kind]
    first, end = spans[kind, kind, 0], spans[kind, kind, 1]
    _off_from_one(form, rows, off)
    _measure(off[0], off[1], rows, degrees[kind], off[3])
    _one_more(off, rows, target)
    for _ in range(4):
        _measure(target[0], target[1], rows, degrees[kind], target[3])
        _product(target[0], target[1], off[0], off[1], pairs[first:end], rows, now[0], now[1])
        _left_out(target[3], off[3], target[2], off[2], now[2])
        _one_more(now, rows, target)
    _measure(target[0], target[1], rows, degrees[kind], target[3])
    for lane in range(form[0].shape[1]):
        u, v = _turned(form, lane)
        scale = math.sqrt(u * u + v * v)
        far = _size(off[3], off[2], lane)
        rest = far * far * far * far * far * far / (1.0 - far) if far < _MOST_OFF and scale > 0.0 else np.inf
        total = target[2][lane] + rest + _ROUNDING * _size(target[3], target[2], lane)
        for k in range(rows):
            x, y = target[0][k, lane], target[1][k, lane]
            target[0][k, lane] = x * u - y * v
            target[1][k, lane] = x * v + y * u
        target[2][lane] = scale * total * (1.0 + 1e-12) if rest < np.inf else np.inf


@_compiled
def _combine(one: Any, other: Any, sign: float, kinds: Any, tables: Any, target: Any) -> None:
    """x ± y."""
    counts, places = tables[2], tables[4]
    re, im, radius = target[0], target[1], target[2]
    lanes = re.shape[1]
    if kinds[0] == kinds[1]:
        for k in range(counts[kinds[0]]):
            for lane in range(lanes):
                re[k, lane] = one[0][k, lane] + sign * other[0][k, lane]
                im[k, lane] = one[1][k, lane] + sign * other[1][k, lane]
    else:
        re[:] = 0.0
        im[:] = 0.0
        for k in range(counts[kinds[0]]):
            p = places[kinds[0], k]
            for lane in range(lanes):
                re[p, lane] += one[0][k, lane]
                im[p, lane] += one[1][k, lane]
        for k in range(counts[kinds[1]]):
            p = places[kinds[1], k]
            for lane in range(lanes):
                re[p, lane] += sign * other[0][k, lane]
                im[p, lane] += sign * other[1][k, lane]
    for lane in range(lanes):
        rounding = _ROUNDING * (_size(one[3], one[2], lane) + _size(other[3], other[2], lane))
        radius[lane] = (one[2][lane] + other[2][lane] + rounding) * (1.0 + 1e-12)


@_compiled
def _change(form: Any, operation: int, number: complex, more: Any, rows: int, target: Any) -> None:
    """An operation with one form: times a number, plus a number, the conjugate, or a radius more."""
    x, y = number.real, number.imag
    size = math.sqrt(x * x + y * y)
    for k in range(rows):
        for lane in range(form[0].shape[1]):
            u, v = form[0][k, lane], form[1][k, lane]
            if operation == SCALE:
                u, v = u * x - v * y, u * y + v * x
            elif operation == CONJUGATE:
                v = -v
            elif operation == MOVE and k == 0:
                u, v = u + x, v + y
            target[0][k, lane] = u
            target[1][k, lane] = v
    for lane in range(form[0].shape[1]):
        r = form[2][lane]
        if operation == SCALE:
            r = size * (r + _ROUNDING * _size(form[3], form[2], lane))
        elif operation == MOVE:
            r += _ROUNDING * (form[3][0, lane] + size)
        elif operation == WIDEN:
            r += more[lane]
        target[2][lane] = r * (1.0 + 1e-12)


@_compiled
def _step(code: Any, number: complex, registers: Any, more: Any, tables: Any, off: Any, now: Any) -> None:
    """One operation of a tape."""
    operation, kind = code[0], code[1]
    re, im, radius, sizes = registers
    spans, pairs, counts, degrees, _ = tables
    t, a = code[3], code[4]
    two = operation in (ADD, SUBTRACT, MULTIPLY)
    b = code[5] if two else a
    target = (re[t], im[t], radius[t], sizes[t])
    one, other = (re[a], im[a], radius[a], sizes[a]), (re[b], im[b], radius[b], sizes[b])
    if two and code[2] != kind:
        kind = ALL
    if operation == MULTIPLY:
        first, end = spans[code[1], code[2], 0], spans[code[1], code[2], 1]
        _product(one[0], one[1], other[0], other[1], pairs[first:end], counts[kind], target[0], target[1])
        _left_out(one[3], other[3], one[2], other[2], target[2])
    elif two:
        _combine(one, other, 1.0 if operation == ADD else -1.0, code[1:3], tables, target)
    elif operation == RECIPROCAL:
        _invert(one, kind, tables, target, off, now)
    else:
        _change(one, operation, number, more, counts[kind], target)
    _measure(target[0], target[1], counts[kind], degrees[kind], target[3])


@_compiled
def _run(code: Any, numbers: Any, kinds: Any, outputs: Any, count: int, given: Any, tables: Any, found: Any) -> None:
    """All columns of ``given`` (coefficients, radii, parameters) to ``found`` (coefficients, radii), in blocks."""
    given_re, given_im, given_radius, parameters = given
    columns, total = given_radius.shape[1], given_re.shape[1]
    width = min(_BLOCK, columns)
    re, im = np.zeros((count, total, width)), np.zeros((count, total, width))
    radius, sizes = np.zeros((count, width)), np.zeros((count, ORDER + 1, width))
    registers = (re, im, radius, sizes)
    rooms, radii, sums = np.zeros((4, total, width)), np.zeros((2, width)), np.zeros((2, ORDER + 1, width))
    off, now = (rooms[0], rooms[1], radii[0], sums[0]), (rooms[2], rooms[3], radii[1], sums[1])
    more = np.zeros(width)
    for start in range(0, columns, width):
        for n in range(len(kinds)):
            for lane in range(width):
                at = min(start + lane, columns - 1)
                for k in range(total):
                    re[n, k, lane] = given_re[n, k, at]
                    im[n, k, lane] = given_im[n, k, at]
                radius[n, lane] = given_radius[n, at]
            _measure(re[n], im[n], tables[2][kinds[n]], tables[3][kinds[n]], sizes[n])
        for n in range(len(code)):
            if code[n, 0] == WIDEN:
                for lane in range(width):
                    at = min(start + lane, columns - 1)
                    more[lane] = numbers[n].real if code[n, 5] < 0 else parameters[code[n, 5], at]
            _step(code[n], numbers[n], registers, more, tables, off, now)
        for n in range(len(outputs)):
            for lane in range(min(width, columns - start)):
                for k in range(total):
                    found[0][n, k, start + lane] = re[outputs[n], k, lane]
                    found[1][n, k, start + lane] = im[outputs[n], k, lane]
                found[2][n, start + lane] = radius[outputs[n], lane]
