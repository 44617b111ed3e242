"""Zero exclusion on boxes, compiled: what a box holds, what its power loops are made of, and det M on every arc.

A form has seven dimensions: the six coordinates of a box, and the frequency on an arc (:eq:`taylor-form`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from vsgdesign.certificate.box_check import load_boxes, none_within, which_occur
from vsgdesign.certificate.taylor_kernel import LANES, rows, run_program, sum_up

KERNEL = "7dd94da03423c20e"
"""Fingerprint of ``taylor_kernel.py`` and ``box_check.py``, whose functions are compiled into those here: Numba makes
them again when this file changes, and this one alone."""

_UP = 1.0 + 1e-13

_TURNS, _TURN = 9, 0.2
"""Directions in which f may lie, and the angle between them, rad."""

_compiled: Any = njit(cache=True, nogil=True, error_model="numpy")


@_compiled
def _square(d: int, i: int, j: int) -> int:
    """The row of t_i t_j, i ≤ j."""
    return 1 + d + i * d - i * (i - 1) // 2 + (j - i)


@_compiled
def _load_small(target: Any, lane: int, small: Any, imaginary: bool, d: int) -> None:
    """A form of the grid's two coordinates and the frequency, ``small`` (11,) complex, as a register."""
    for k in range(target.shape[0]):
        target[k, lane] = 0.0
    last = 1 + d + d * (d + 1) // 2
    w = d - 1
    for k in range(3):
        target[k, lane] = small[k].imag if imaginary else small[k].real
    target[1 + w, lane] = small[3].imag if imaginary else small[3].real
    m = 4
    for i in (0, 1, w):
        for j in (0, 1, w):
            if i <= j:
                target[_square(d, i, j), lane] = small[m].imag if imaginary else small[m].real
                m += 1
    target[last, lane] = small[10].real


@_compiled
def survey(boxes: Any, situation: Any, conditions: Any, signs: Any, d: int, found: Any) -> None:
    """What N boxes hold: low and high limits (N, 6), the cell of each (N,), the cells' rest (cells, 2, 11), parameters
    (m, N).

    ``found``: whether they are empty (N,), and which pieces of the schedule occur (pieces, N).
    """
    low, high, cell, rest, parameters = boxes
    empty, applies = found
    code, number, places, factors, outputs, count = situation
    coordinates = low.shape[1]
    registers = np.zeros((count, rows(d), LANES))
    own = np.zeros((len(parameters), LANES))
    least, most = np.empty(LANES), np.empty(LANES)
    between = signs.shape[1]
    beyond, mean = np.empty((2 * len(conditions), rows(d), LANES)), np.empty((rows(d), LANES))
    nothing, crossed = np.empty(LANES, dtype=np.bool_), np.empty((2 * len(conditions), LANES), dtype=np.bool_)
    for start in range(0, len(low), LANES):
        width = min(LANES, len(low) - start)
        load_boxes(registers, own, low, high, parameters, start, coordinates, d)
        for k in range(4):
            for lane in range(LANES):
                box = min(start + lane, len(low) - 1)
                _load_small(registers[coordinates + k], lane, rest[cell[box], k // 2], k % 2 == 1, d)
            sum_up(registers[coordinates + k], d)
        run_program(code, number, places, factors, registers, own, d)
        which_occur(registers, outputs, signs, start, width, least, most, applies, d)
        none_within(registers, outputs[between:], conditions, beyond, crossed, nothing, mean, d)
        for lane in range(width):
            empty[start + lane] |= nothing[lane]


@_compiled
def _load(registers: Any, limits_: Any, gains: Any, functions: Any, box: Any, arc: Any, d: int) -> None:
    """p and q of the lanes' boxes, the functions of their arcs, and their gains."""
    low, high = limits_
    coordinates, inputs = low.shape[1], functions.shape[1]
    for m in range(2):
        axis = coordinates - 2 + m
        for lane in range(LANES):
            least, most = low[box[lane], axis], high[box[lane], axis]
            for k in range(rows(d)):
                registers[m, k, lane] = 0.0
            registers[m, 0, lane] = 0.5 * (least + most)
            registers[m, 1 + axis, lane] = 0.5 * (most - least) * (1.0 + 1e-15) + 1e-16 * abs(least + most)
        sum_up(registers[m], d)
    for m in range(2 * inputs):
        for lane in range(LANES):  # m % 2 == 1 in place of True: Numba would compile the function for it once more
            _load_small(registers[2 + m], lane, functions[arc[lane], m // 2], m % 2 == 1, d)
        sum_up(registers[2 + m], d)
    for m in range(gains.shape[1]):
        for lane in range(LANES):
            for k in range(rows(d)):
                registers[2 + 2 * inputs + m, k, lane] = gains[box[lane], m, k]


@_compiled
def _fill(alive: Any, done: Any, begin: Any, count: Any, box: Any, place: Any) -> int:
    """The next arcs of the boxes that are alive, in turn, until the lanes are full; returns how many lanes that are."""
    width = 0
    left = True
    while left and width < LANES:
        left = False
        for k in alive:
            if done[k] < count[k] and width < LANES:
                box[width], place[width] = k, (begin[k] + done[k]) % count[k]
                done[k] += 1
                width += 1
                left = True
    for lane in range(width, LANES):
        box[lane], place[lane] = box[0], place[0]
    return width


@_compiled
def _excluded(re: Any, im: Any, lane: int, d: int) -> complex:
    """A w with Re(f/w) > 0 on all of the box and the arc, 0 where none is found: the value in the middle, or this
    turned by some angle."""
    last = 1 + d + d * (d + 1) // 2
    size = math.sqrt(re[0, lane] * re[0, lane] + im[0, lane] * im[0, lane])
    for turn in range(_TURNS):
        angle = _TURN * (0.5 - (turn % 2)) * (turn + turn % 2)
        cosine, sine = math.cos(angle), math.sin(angle)
        u = (re[0, lane] * cosine - im[0, lane] * sine) / size
        v = (re[0, lane] * sine + im[0, lane] * cosine) / size
        around = 0.0
        for m in range(1, last):
            around += abs(u * re[m, lane] + v * im[m, lane])
        m = 1 + d
        for i in range(d):  # of a square, one sign only
            around -= max(u * re[m, lane] + v * im[m, lane], 0.0)
            m += d - i
        for m in range(last, last + d):
            around += abs(u) * re[m, lane] + abs(v) * im[m, lane]
        if size * cosine > around * _UP + 1e-13 * size:
            return complex(u, v)
    return 0.0


@_compiled
def _score(re: Any, im: Any, lane: int, d: int, score: Any) -> None:
    """What each dimension adds to what is not known of f, relative to f, (d,)."""
    last = 1 + d + d * (d + 1) // 2
    size = math.sqrt(re[0, lane] * re[0, lane] + im[0, lane] * im[0, lane])
    u, v = re[0, lane] / size, im[0, lane] / size
    for i in range(d):
        pull = abs(u * re[1 + i, lane] + v * im[1 + i, lane])
        pull += re[last + i, lane] + im[last + i, lane]
        for j in range(d):
            row = _square(d, min(i, j), max(i, j))
            share = 1.0 if i == j else 0.5
            pull += share * math.sqrt(re[row, lane] * re[row, lane] + im[row, lane] * im[row, lane])
        score[i] = pull / size


@_compiled
def exclude(boxes: Any, gains: Any, arcs: Any, program: Any, d: int, found: Any) -> int:
    """Whether f has no zero on any arc of a box's cell, for N boxes; returns how many values of f were enclosed.

    ``boxes``: limits (N, 6) each, the cell of each (N,), and from which place of its order its arcs are looked at (N,).
    ``gains`` (N, outputs, rows(d)): ``higher.gains_of``. ``arcs``: the functions (arcs, inputs, 11) of all cells, where
    a cell's begin, how many they are, and in which order they are looked at. ``found``: 1 or 0 (N,); the place at which
    it failed (N,); what each dimension adds to what is not known there (N, d); and the direction of f (N, most
    arcs).
    """
    low, high, cell, begin = boxes
    functions, first, counts, order = arcs
    state, where, score, middle = found
    code, number, places, factors, outputs, registers_ = program
    registers, own = np.zeros((registers_, rows(d), LANES)), np.zeros((0, LANES))
    done, alive = np.zeros(len(low), dtype=np.int64), np.arange(len(low))
    box, place = np.zeros(LANES, dtype=np.int64), np.zeros(LANES, dtype=np.int64)
    arc = np.zeros(LANES, dtype=np.int64)
    count = counts[cell]
    seen = 0
    state[:] = 1
    while len(alive) > 0:
        width = _fill(alive, done, begin, count, box, place)
        seen += width
        for lane in range(LANES):
            start = first[cell[box[lane]]]
            arc[lane] = start + order[start + place[lane]]
        _load(registers, (low, high), gains, functions, box, arc, d)
        run_program(code, number, places, factors, registers, own, d)
        re, im = registers[outputs[0]], registers[outputs[1]]
        for lane in range(width):
            k = box[lane]
            if state[k] == 0:
                continue
            way = _excluded(re, im, lane, d)
            middle[k, arc[lane] - first[cell[k]]] = way
            if way == 0.0:
                state[k], where[k] = 0, place[lane]
                _score(re, im, lane, d, score[k])
        kept = 0
        for k in alive:
            if state[k] == 1 and done[k] < count[k]:
                alive[kept] = k
                kept += 1
        alive = alive[:kept]
    return seen


@_compiled
def enclosed(boxes: Any, gains: Any, functions: Any, arc: Any, program: Any, d: int, found: Any) -> None:
    """The forms of Re f and Im f, ``found`` (N, 2, rows(d)), on boxes with limits (N, 6) and their arcs (N,)."""
    code, number, places, factors, outputs, count = program
    registers, own = np.zeros((count, rows(d), LANES)), np.zeros((0, LANES))
    box, which = np.zeros(LANES, dtype=np.int64), np.zeros(LANES, dtype=np.int64)
    for start in range(0, len(arc), LANES):
        width = min(LANES, len(arc) - start)
        for lane in range(LANES):
            box[lane] = min(start + lane, len(arc) - 1)
            which[lane] = arc[box[lane]]
        _load(registers, boxes, gains, functions, box, which, d)
        run_program(code, number, places, factors, registers, own, d)
        for lane in range(width):
            for n in range(2):
                for k in range(rows(d)):
                    found[start + lane, n, k] = registers[outputs[n], k, lane]
