"""Bounds of a program's outputs on boxes, and a region cut into boxes until a statement is decided on every one."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vsgdesign.certificate.box_check import load_boxes
from vsgdesign.certificate.boxes import Boxes
from vsgdesign.certificate.taylor_kernel import LANES, limits, rows, run_program
from vsgdesign.certificate.tracing import Program
from vsgdesign.execution.interrupts import interrupts_deferred

Array = NDArray[np.float64]

_CHUNK = 1024

_compiled: Any = njit(cache=True, nogil=True, error_model="numpy")


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
