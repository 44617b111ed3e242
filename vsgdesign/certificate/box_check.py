"""One look at many boxes, compiled: is there anything of the region in a box, and does the inequality hold on it?

The bounds of a program on boxes, and a region cut into boxes until a statement is decided on every one, are here too.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vsgdesign.certificate.boxes import Boxes
from vsgdesign.certificate.taylor_kernel import LANES, SEEN, limits, negative, rows, run_program, sum_up
from vsgdesign.certificate.tracing import Program
from vsgdesign.execution.signals import interrupts_deferred

COORDINATES = 6
"""Of a box: estimated grid (2), P, Q, both errors."""

FOLLOWED = 4
"""The coordinates that are followed through the inequality; what the errors do to V is one quantity between bounds."""

_MEANS = 0.2, 0.5, 0.8
"""Weights of the second of two limits in their mean."""

_STILL = 1e-12
"""What moves less is not measured in units of what moves it."""

_OFF = 1e-14
"""Of the size of a sum of a few bounds: more than what floating-point is off by."""

_DRAWS = 2
"""How often all conditions draw a box in, one after another."""

_DRAWN_OFF = 1e-9
"""Of half a width, how far a box is drawn in less: much more than its arithmetic is off by."""

KERNEL = "7ccee86dbcc4d79f"
"""Fingerprint of ``taylor_kernel.py``. Numba keeps the machine code of the functions here with all that they call, and
makes it again when this file changes, and this one alone: so this file has to change with the other."""

_compiled: Any = njit(cache=True, nogil=True, error_model="numpy")


def compile_ahead() -> None:
    """Compile what a proof calls, or load it from Numba's cache: with no box, so that nothing is looked at."""
    boxes, none, places = np.zeros((0, COORDINATES)), np.zeros(0), np.zeros(0, dtype=np.int64)
    program = (np.zeros((0, 4), dtype=np.int64), none, places, none, places, 0)
    parameters, truth = np.zeros((0, 0)), np.zeros(0, dtype=np.bool_)
    forms = np.zeros((0, 0, rows(FOLLOWED + 1)))
    signs = np.zeros((0, 0), dtype=np.int64)
    draw_in(boxes, boxes, parameters, program, np.zeros((0, 2)), truth)
    survey(boxes, boxes, parameters, program, np.zeros((0, 2)), signs, truth, np.zeros((0, 0), np.bool_), forms)
    judge(boxes, boxes, parameters, program, forms, 3, truth, np.zeros((0, FOLLOWED + 1)))


@_compiled
def survey(
    low: Any,
    high: Any,
    parameters: Any,
    situation: Any,
    conditions: Any,
    signs: Any,
    empty: Any,
    applies: Any,
    forms: Any,
) -> None:
    """What N boxes hold, limits (N, 6), ``parameters`` (m, N).

    ``situation``: program over the six coordinates; its first outputs are 1/V and what else the inequality needs of
    the true grid, its last those of ``conditions`` (c, 2): limits outside of which there is nothing of interest, and
    the box is ``empty`` (N,). Those between tell which cases of the schedule occur, ``applies`` (cases, N): one with
    −1 in ``signs`` (cases, outputs) is where the output is negative, with 1 where it is positive. ``forms``
    (N, first outputs, rows(5)): these over the first four coordinates and one of their own.
    """
    code, number, places, factors, outputs, count = situation
    d = low.shape[1]  # not the constant: Numba would compile every function for it once more
    registers = np.zeros((count, rows(d), LANES))
    own = np.zeros((len(parameters), LANES))
    least, most = np.empty(LANES), np.empty(LANES)
    carried = forms.shape[1]
    between = signs.shape[1]
    beyond, mean = np.empty((2 * len(conditions), rows(d), LANES)), np.empty((rows(d), LANES))
    nothing, crossed = np.empty(LANES, dtype=np.bool_), np.empty((2 * len(conditions), LANES), dtype=np.bool_)
    for start in range(0, len(low), LANES):
        width = min(LANES, len(low) - start)
        load_boxes(registers, own, low, high, parameters, start, d, d)
        run_program(code, number, places, factors, registers, own, d)
        which_occur(registers, outputs[carried:], signs, start, width, least, most, applies, d)
        none_within(registers, outputs[carried + between :], conditions, beyond, crossed, nothing, mean, d)
        # By element here, too: assigned as parts, it is the words of an error about shapes that are compiled.
        for lane in range(width):
            empty[start + lane] |= nothing[lane]
        for n in range(carried):
            for lane in range(width):
                _carry(forms[start + lane, n], registers[outputs[n], :, lane], n == 0)


@_compiled
def which_occur(
    registers: Any,
    outputs: Any,
    signs: Any,
    start: int,
    width: int,
    least: Any,
    most: Any,
    applies: Any,
    d: int,
) -> None:
    """Which cases of the schedule occur in the boxes of the lanes, ``applies`` (cases, N). ``signs`` (cases, outputs):
    those of :func:`survey`."""
    applies[:, start : start + width] = True
    for n in range(signs.shape[1]):
        limits(registers[outputs[n]], d, least, most)
        for lane in range(width):
            for case in range(len(signs)):
                if signs[case, n] < 0 and least[lane] > 0.0:
                    applies[case, start + lane] = False
                if signs[case, n] > 0 and most[lane] < 0.0:
                    applies[case, start + lane] = False


@_compiled
def draw_in(low: Any, high: Any, parameters: Any, situation: Any, conditions: Any, empty: Any) -> None:
    """Draws the limits of N boxes (N, 6) in to what the ``conditions`` leave of them (:eq:`box-drawn-in`), in place.

    ``parameters``, ``situation`` and ``conditions`` are those of :func:`survey`, whose last outputs the conditions are;
    ``empty`` (N,) is set where nothing is left.
    """
    code, number, places, factors, outputs, count = situation
    d = low.shape[1]
    registers = np.zeros((count, rows(d), LANES))
    own = np.zeros((len(parameters), LANES))
    least, most = np.empty((d, LANES)), np.empty((d, LANES))
    first = len(outputs) - len(conditions)
    for start in range(0, len(low), LANES):
        load_boxes(registers, own, low, high, parameters, start, d, d)
        run_program(code, number, places, factors, registers, own, d)
        least[:] = -1.0
        most[:] = 1.0
        for _ in range(_DRAWS):
            for n in range(len(conditions)):
                form = registers[outputs[first + n]]
                if conditions[n, 1] < np.inf:
                    _draw(least, most, form, conditions[n, 1], 1.0, d)
                if conditions[n, 0] > -np.inf:
                    _draw(least, most, form, -conditions[n, 0], -1.0, d)
        for lane in range(min(LANES, len(low) - start)):
            box = start + lane
            for k in range(d):
                if least[k, lane] > most[k, lane]:
                    empty[box] = True
            for k in range(d):
                middle, radius = 0.5 * (low[box, k] + high[box, k]), 0.5 * (high[box, k] - low[box, k])
                if not empty[box] and least[k, lane] > -1.0:
                    low[box, k] = middle + radius * least[k, lane]
                if not empty[box] and most[k, lane] < 1.0:
                    high[box, k] = middle + radius * most[k, lane]


@_compiled
def _draw(least: Any, most: Any, form: Any, limit: float, sign: float, d: int) -> None:
    """Draws −1 ≤ least ≤ t_k ≤ most ≤ 1 (d, LANES) in to where ``sign`` times a form can be at most ``limit``: by what
    all other terms leave it at least."""
    last = 1 + d + d * (d + 1) // 2
    total = last + d
    for lane in range(LANES):
        # The least that the form can be, without its linear terms.
        rest = sign * form[0, lane] - form[total + 1, lane] - form[total + 2, lane]
        k = 1 + d
        for i in range(d):
            rest += max(sign * form[k, lane], 0.0)  # of a square, one sign only
            k += d - i
        moved = abs(form[0, lane]) + abs(limit) + form[total, lane] + form[total + 1, lane] + form[total + 2, lane]
        rest -= _OFF * moved
        for i in range(d):
            slope = sign * form[1 + i, lane]
            rest += min(slope * least[i, lane], slope * most[i, lane])
        if not rest > -np.inf:
            continue
        for i in range(d):
            slope = sign * form[1 + i, lane]
            reach = (limit - rest) / abs(slope) if abs(slope) > _STILL * moved else np.inf
            if slope > 0.0:
                most[i, lane] = min(most[i, lane], least[i, lane] + reach + _DRAWN_OFF)
            else:
                least[i, lane] = max(least[i, lane], most[i, lane] - reach - _DRAWN_OFF)
        if rest > limit:
            least[0, lane], most[0, lane] = 1.0, -1.0


@_compiled
def none_within(
    registers: Any, outputs: Any, conditions: Any, beyond: Any, crossed: Any, nothing: Any, mean: Any, d: int
) -> None:
    """Boxes without a point that keeps all ``conditions``, ``nothing`` (LANES,): one limit leaves none, or two."""
    least, most = np.empty(LANES), np.empty(LANES)
    nothing[:] = False
    count = 0
    for n in range(len(conditions)):
        for side in range(2):
            limit = conditions[n, side]
            if abs(limit) < np.inf:
                _beyond(beyond[count], registers[outputs[n]], limit, side == 0, d)
                limits(beyond[count], d, least, most)
                for lane in range(LANES):
                    nothing[lane] |= least[lane] > 0.0
                    crossed[count, lane] = most[lane] > 0.0
                count += 1
    _none_in_common(beyond[:count], crossed, nothing, mean, d)


@_compiled
def _beyond(target: Any, form: Any, limit: float, below: bool, d: int) -> None:
    """By how much a form is beyond a limit, in units of what moves it; where nothing is known, without a bound."""
    last = 1 + d + d * (d + 1) // 2
    total = last + d
    for k in range(total):
        for lane in range(LANES):
            moved = form[total, lane] + form[total + 1, lane] + form[total + 2, lane]
            scale = 1.0 / moved if moved > _STILL else 1.0
            target[k, lane] = (-scale if below and k < last else scale) * form[k, lane]
            if k == 0:
                target[k, lane] += scale * (limit if below else -limit)
            if k == last:
                target[k, lane] += _OFF * scale * (abs(form[0, lane]) + abs(limit) + moved)
    sum_up(target, d)


@_compiled
def _none_in_common(beyond: Any, crossed: Any, nothing: Any, mean: Any, d: int) -> None:
    """Boxes in which each of two limits leaves some points, but both together none: a weighted mean of what is beyond
    them (rows(d), LANES) is positive on the whole box (:eq:`box-emptiness`)."""
    least, most = np.empty(LANES), np.empty(LANES)
    for i in range(len(beyond)):
        for j in range(i):
            asked = False
            for lane in range(LANES):
                asked |= crossed[i, lane] and crossed[j, lane] and not nothing[lane]
            if not asked:
                continue
            for share in _MEANS:
                for k in range(mean.shape[0]):
                    for lane in range(LANES):
                        mean[k, lane] = (1.0 - share) * beyond[i, k, lane] + share * beyond[j, k, lane]
                sum_up(mean, d)
                limits(mean, d, least, most)
                for lane in range(LANES):
                    nothing[lane] |= least[lane] > 0.0


@_compiled
def judge(
    low: Any,
    high: Any,
    parameters: Any,
    inequality: Any,
    forms: Any,
    order: int,
    proved: Any,
    score: Any,
) -> None:
    """Whether the matrices of an ``inequality`` (``order`` rows each) are negative definite on each of N boxes,
    ``proved`` (N,), and what each dimension adds to what is not known, ``score`` (N, 5) (:eq:`box-bound`).

    The program is over the first four coordinates and the ``forms`` of :func:`survey`; its outputs are matrices by
    their entries on and above the diagonal. Entries
    count as they do in the least definite direction.
    """
    code, number, places, factors, outputs, count = inequality
    d = FOLLOWED + 1
    registers = np.zeros((count, rows(d), LANES))
    size = order * (order + 1) // 2
    entries = np.zeros((size, rows(d), LANES))
    own = np.zeros((len(parameters), LANES))
    held, pull, weight = np.empty(LANES, dtype=np.bool_), np.empty((d, LANES)), np.empty((size, LANES))
    for start in range(0, len(low), LANES):
        width = min(LANES, len(low) - start)
        load_boxes(registers, own, low, high, parameters, start, d - 1, d)
        # By element: assigned whole, Numba compiles the words of an error about shapes, for seconds.
        for n in range(forms.shape[1]):
            for k in range(forms.shape[2]):
                for lane in range(LANES):
                    registers[FOLLOWED + n, k, lane] = forms[min(start + lane, len(low) - 1), n, k]
            sum_up(registers[FOLLOWED + n], d)
        run_program(code, number, places, factors, registers, own, d)
        pull[:] = 0.0
        weight[:] = 0.0
        held[:] = True
        for n in range(0, len(outputs), size):
            for m in range(size):
                for k in range(entries.shape[1]):
                    for lane in range(LANES):
                        entries[m, k, lane] = registers[outputs[n + m], k, lane]
            negative(entries, d, held, pull, weight)
        _add_spread(pull[FOLLOWED], weight, registers, outputs, size)
        for lane in range(width):
            proved[start + lane] = held[lane]
            for k in range(d):
                score[start + lane, k] = pull[k, lane]


@_compiled
def load_boxes(
    registers: Any, own: Any, low: Any, high: Any, parameters: Any, start: int, coordinates: int, d: int
) -> None:
    """The coordinates of boxes as forms, their widths rounded up, and the boxes' parameters."""
    for lane in range(LANES):
        box = min(start + lane, len(low) - 1)
        for k in range(len(parameters)):
            own[k, lane] = parameters[k, box]
        for k in range(coordinates):
            least, most = low[box, k], high[box, k]
            middle = 0.5 * (least + most)
            registers[k, :, lane] = 0.0
            registers[k, 0, lane] = middle
            rounding = 1e-16 * abs(middle) if most > least else 0.0
            registers[k, 1 + k, lane] = 0.5 * (most - least) * (1.0 + 1e-15) + rounding
    for k in range(coordinates):
        sum_up(registers[k], d)


@_compiled
def _carry(target: Any, source: Any, as_one: bool) -> None:
    """A form (rows(6),) over all coordinates as one (rows(5),) over the first four; what the others do is bounded, and
    that bound becomes a quantity of its own (``as_one``) or rest."""
    d, d_2 = COORDINATES, FOLLOWED + 1
    target[:] = 0.0
    target[0] = source[0]
    bound = 0.0
    for k in range(d):
        if k < FOLLOWED:
            target[1 + k] = source[1 + k]
        else:
            bound += abs(source[1 + k])
    n, n_2 = 1 + d, 1 + d_2
    for i in range(d):
        for j in range(i, d):
            if j < FOLLOWED:
                target[n_2] = source[n]
            else:
                bound += abs(source[n])
            n += 1
            if j <= FOLLOWED:
                n_2 += 1
    for k in range(d):
        if k < FOLLOWED:
            target[n_2 + k] = source[n + k]
        else:
            bound += source[n + k]
    target[1 + FOLLOWED if as_one else n_2 + FOLLOWED] = bound


@_compiled
def _add_spread(score: Any, weight: Any, registers: Any, outputs: Any, size: int) -> None:
    """How far the matrices of the polygon's corners lie apart: what smaller errors would buy."""
    for m in range(size):
        for lane in range(LANES):
            least, most = np.inf, -np.inf
            for n in range(m, len(outputs), size):
                value = registers[outputs[n], 0, lane]
                least, most = min(least, value), max(most, value)
            score[lane] += SEEN * 0.5 * weight[m, lane] * (most - least)


Array = NDArray[np.float64]

_CHUNK = 1024


def bounds(program: Program, low: Array, high: Array, parameters: Array) -> tuple[Array, Array, Array]:
    """Bounds of each output on N boxes, limits (N, d), ``parameters`` (m, N).

    Returns the least and the largest value, (outputs, N), and the part of what lies between them that each coordinate
    moves, (outputs, d, N). A point is a box without width. Where an output has no bound, its limits are not finite.
    """
    count, d = low.shape
    least, most = np.empty((len(program.outputs), count)), np.empty((len(program.outputs), count))
    moved = np.empty((len(program.outputs), d, count))
    code = (program.code, program.number, program.places, program.factors, program.outputs, program.registers)

    def part(start: int) -> None:
        here = slice(start, start + _CHUNK)
        own = np.ascontiguousarray(parameters[:, here])
        least[:, here], most[:, here], moved[:, :, here] = _bounds(low[here], high[here], own, code)

    starts = range(0, count, _CHUNK)
    if len(starts) <= 1:  # the first call always: here the code is compiled
        with interrupts_deferred():
            list(map(part, starts))
        return least, most, moved
    threads = ThreadPoolExecutor(os.cpu_count())
    try:
        list(threads.map(part, starts))
    finally:
        threads.shutdown(cancel_futures=True)
    return least, most, moved


@_compiled
def _bounds(low: Any, high: Any, parameters: Any, program: Any) -> Any:
    code, number, places, factors, outputs, count = program
    d = low.shape[1]
    registers = np.zeros((count, rows(d), LANES))
    own = np.zeros((len(parameters), LANES))
    least, most = np.empty((len(outputs), len(low))), np.empty((len(outputs), len(low)))
    moved = np.zeros((len(outputs), d, len(low)))
    one, other = np.empty(LANES), np.empty(LANES)
    last = 1 + d + d * (d + 1) // 2
    for start in range(0, len(low), LANES):
        load_boxes(registers, own, low, high, parameters, start, d, d)
        run_program(code, number, places, factors, registers, own, d)
        for n in range(len(outputs)):
            form = registers[outputs[n]]
            limits(form, d, one, other)
            for lane in range(min(LANES, len(low) - start)):
                box = start + lane
                least[n, box], most[n, box] = one[lane], other[lane]
                k = 1 + d
                for i in range(d):
                    moved[n, i, box] += abs(form[1 + i, lane]) + form[last + i, lane]
                    for j in range(i, d):
                        moved[n, i, box] += 0.5 * abs(form[k, lane])
                        moved[n, j, box] += 0.5 * abs(form[k, lane])
                        k += 1
    return least, most, moved


UNDECIDED, PROVED, EMPTY = 0, 1, 2

Look = Callable[[Boxes], tuple[NDArray[np.int64], NDArray[np.intp]]]
"""Boxes to UNDECIDED, PROVED or EMPTY (nothing of the region lies in the box) for each, and the coordinate to cut."""


@dataclass(frozen=True)
class Cover:
    """How far a statement was decided. ``seen``: boxes that were looked at; ``proved``: those that hold it; ``left``:
    those that are undecided."""

    seen: int
    proved: int
    left: Boxes


def cover(look: Look, boxes: Boxes, budget: int, stop: Callable[[Boxes], bool]) -> Cover:
    """Cuts boxes in half until the statement is decided on all, the budget is used, or ``stop`` says of those that are
    left that it need not go on."""
    seen = proved = 0
    while len(boxes) and seen + len(boxes) <= budget:
        state, dimension = look(boxes)
        seen += len(boxes)
        proved += int((state == PROVED).sum())
        undecided = state == UNDECIDED
        boxes, dimension = boxes.take(undecided), dimension[undecided]
        if len(boxes) == 0 or stop(boxes):
            break
        boxes = boxes.halves(dimension)
    return Cover(seen, proved, boxes)
