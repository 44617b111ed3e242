"""One look at many boxes, compiled: is there anything of the region in a box, and does the inequality hold on it?"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from vsgdesign.design.certificate.taylor_kernel import LANES, SEEN, limits, negative, rows, run_program, sum_up

UNDECIDED, PROVED, EMPTY = 0, 1, 2

COORDINATES = 6
"""Of a box: estimated grid (2), P, Q, both errors. The first four are followed through the inequality; what the errors
do to V is one quantity between bounds."""

_FOLLOWED = 4

_compiled: Any = njit(cache=True, nogil=True, error_model="numpy")


@_compiled
def check_boxes(
    low: Any, high: Any, parameters: Any, unit: Any, situation: Any, conditions: Any, inequalities: Any, signs: Any,
    state: Any, dimension: Any,
) -> None:  # fmt: skip
    """``state`` and ``dimension`` (N,) of N boxes, limits (N, 6), ``parameters`` (m, N) (:eq:`box-bound`).

    ``situation``: program over the six coordinates; its first outputs are 1/V and what else the inequality needs of
    the true grid, its last those of ``conditions`` (c, 2): limits outside of which there is nothing of interest. Those
    between tell which of the ``inequalities`` is asked for: one with −1 in ``signs`` (cases, outputs) is where the
    output is negative, with 1 where it is positive. They are programs over the first four coordinates and the first
    outputs; their outputs are matrices by their six entries. ``dimension``: the coordinate to
    cut. ``unit`` (6,): a size for each.
    """
    code, number, places, factors, outputs, count = situation
    d, d_2 = COORDINATES, _FOLLOWED + 1
    registers = np.zeros((count, rows(d), LANES))
    count_2 = 0
    for case in range(len(inequalities)):
        count_2 = max(count_2, inequalities[case][5])
    registers_2 = np.zeros((count_2, rows(d_2), LANES))
    entries = np.zeros((6, rows(d_2), LANES))
    own = np.zeros((len(parameters), LANES))
    least, most = np.empty(LANES), np.empty(LANES)
    score, all_scores = np.empty((d_2, LANES)), np.empty((d_2, LANES))
    held, applies = np.empty(LANES, dtype=np.bool_), np.empty((len(inequalities), LANES), dtype=np.bool_)
    empty, proved = np.empty(LANES, dtype=np.bool_), np.empty(LANES, dtype=np.bool_)
    carried = len(outputs) - len(conditions) - signs.shape[1]
    for start in range(0, len(low), LANES):
        for lane in range(LANES):
            box = min(start + lane, len(low) - 1)
            for k in range(len(parameters)):
                own[k, lane] = parameters[k, box]
            for k in range(d):
                _variable(registers[k], k, lane, low[box, k], high[box, k], d)
                if k < _FOLLOWED:
                    _variable(registers_2[k], k, lane, low[box, k], high[box, k], d_2)
            empty[lane] = False
            proved[lane] = True
        for k in range(d):
            sum_up(registers[k], d)
        run_program(code, number, places, factors, registers, own, d)
        for n in range(len(conditions)):
            limits(registers[outputs[carried + signs.shape[1] + n]], d, least, most)
            for lane in range(LANES):
                empty[lane] |= least[lane] > conditions[n, 1] or most[lane] < conditions[n, 0]
        if empty.all():
            state[start : start + LANES] = EMPTY
            continue
        for k in range(_FOLLOWED):
            sum_up(registers_2[k], d_2)
        for n in range(carried):
            _carry(registers_2[_FOLLOWED + n], registers[outputs[n]], n == 0)
        for lane in range(LANES):
            applies[:, lane] = not empty[lane]
        for n in range(signs.shape[1]):
            limits(registers[outputs[carried + n]], d, least, most)
            for case in range(len(inequalities)):
                for lane in range(LANES):
                    if signs[case, n] < 0 and least[lane] > 0.0:
                        applies[case, lane] = False
                    if signs[case, n] > 0 and most[lane] < 0.0:
                        applies[case, lane] = False
        all_scores[:] = 0.0
        for case in range(len(inequalities)):
            if not applies[case].any():
                continue
            code_2, number_2, places_2, factors_2, outputs_2, _ = inequalities[case]
            run_program(code_2, number_2, places_2, factors_2, registers_2, own, d_2)
            score[:] = 0.0
            held[:] = True
            for n in range(0, len(outputs_2), 6):
                for m in range(6):
                    entries[m] = registers_2[outputs_2[n + m]]
                negative(entries, d_2, held, score)
            _add_spread(score[_FOLLOWED], registers_2, outputs_2)
            for lane in range(LANES):
                if applies[case, lane]:
                    proved[lane] &= held[lane]
                    for k in range(d_2):
                        if not score[k, lane] <= all_scores[k, lane]:  # NaN stays
                            all_scores[k, lane] = score[k, lane]
        for lane in range(min(LANES, len(low) - start)):
            box = start + lane
            state[box] = EMPTY if empty[lane] else PROVED if proved[lane] else UNDECIDED
            dimension[box] = _to_cut(low[box], high[box], unit, all_scores[:, lane])


@_compiled
def _variable(form: Any, k: int, lane: int, low: float, high: float, d: int) -> None:
    """A coordinate of a box as a form; its width is rounded up."""
    for row in range(rows(d)):
        form[row, lane] = 0.0
    middle = 0.5 * (low + high)
    form[0, lane] = middle
    form[1 + k, lane] = 0.5 * (high - low) * (1.0 + 1e-15) + (1e-16 * abs(middle) if high > low else 0.0)


@_compiled
def _carry(target: Any, source: Any, as_one: bool) -> None:
    """A form over all coordinates as one over the first four; what the others do is bounded, and that bound becomes a
    quantity of its own (``as_one``) or rest."""
    d, d_2 = COORDINATES, _FOLLOWED + 1
    target[:] = 0.0
    for lane in range(LANES):
        target[0, lane] = source[0, lane]
        bound = 0.0
        for k in range(d):
            if k < _FOLLOWED:
                target[1 + k, lane] = source[1 + k, lane]
            else:
                bound += abs(source[1 + k, lane])
        n, n_2 = 1 + d, 1 + d_2
        for i in range(d):
            for j in range(i, d):
                if j < _FOLLOWED:
                    target[n_2, lane] = source[n, lane]
                else:
                    bound += abs(source[n, lane])
                n += 1
                if i <= _FOLLOWED and j <= _FOLLOWED:
                    n_2 += 1
        for k in range(d):
            if k < _FOLLOWED:
                target[n_2 + k, lane] = source[n + k, lane]
            else:
                bound += source[n + k, lane]
        target[1 + _FOLLOWED if as_one else n_2 + _FOLLOWED, lane] = bound
    sum_up(target, d_2)


@_compiled
def _add_spread(score: Any, registers: Any, outputs: Any) -> None:
    """How far the matrices of the polygon's corners lie apart: what smaller errors would buy."""
    for m in range(6):
        for lane in range(LANES):
            least, most = np.inf, -np.inf
            for n in range(m, len(outputs), 6):
                value = registers[outputs[n], 0, lane]
                least, most = min(least, value), max(most, value)
            score[lane] += SEEN * 0.5 * (most - least)


@_compiled
def _to_cut(low: Any, high: Any, unit: Any, score: Any) -> int:
    """The dimension that leaves most unknown; the widest where there is no bound at all. Of the errors, the wider."""
    errors = 4 if high[4] - low[4] >= high[5] - low[5] else 5
    best, found = -1.0, 0
    finite = True
    for k in range(len(score)):
        finite = finite and score[k] < np.inf
    for k in range(len(score)):
        at = k if k < _FOLLOWED else errors
        width = (high[at] - low[at]) / unit[at]
        value = (score[k] if width > 0.0 else -1.0) if finite else width
        if value > best:
            best, found = value, at
    return found
