"""From points to the whole region: the worst points are searched at random, and the inequality is proved on boxes,
which are cut where they are too large."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.box_check import FOLLOWED, draw_in, judge, survey
from vsgdesign.certificate.boxes import UNIT, Boxes, parameters_of, points_of, whole_region
from vsgdesign.certificate.enclosure import BoxPrograms, Weights, programs
from vsgdesign.certificate.region import Region, System, point_of, with_shares
from vsgdesign.certificate.taylor_kernel import rows
from vsgdesign.certificate.tracing import Program
from vsgdesign.execution.signals import interrupts_deferred

Array = NDArray[np.float64]

_KEPT, _TRIES, _ROUNDS, _SHORTER = 300, 20, 14, 5

_PARTS = np.array([6, 6, 3, 3, 2, 2])
"""Parts of the region along ln SCR, ln X/R, P, Q and the errors, of each of which the worst is kept in a search."""


def worst_points(
    system: System,
    region: Region,
    shortfall: Callable[[Array, Array], Array],
    points: Array,
    A: Array,
    rng: np.random.Generator,
    begin: int = 0,
    kept: int = _KEPT,
    tries: int = _TRIES,
) -> tuple[Array, Array]:
    """The points (``kept``, 6) of largest ``shortfall`` near the worst of ``points`` (N, 6), of all and in each part of
    the region, the worst first, and it; ``tries`` steps from each.

    ``shortfall``: points and their state matrices to a number each. Steps in ln SCR, ln X/R, P, Q and the errors get
    smaller from round to round; what leaves the region ends on its limit. ``begin``: rounds that are left out, where
    the points are known to lie near the worst.
    """
    worth = shortfall(points, A)
    low, high = region.limits
    low[:2], high[:2] = np.log([[region.scr[0], region.x_over_r[0]], [region.scr[1], region.x_over_r[1]]])

    def point(columns: Array) -> Array:
        columns = np.clip(columns, low, high)
        columns[:, :2] = np.exp(columns[:, :2])
        return point_of(columns, region)

    def columns_of(points: Array) -> Array:
        columns = with_shares(points, region)
        columns[:, 0], columns[:, 1] = -np.log(columns[:, 0]), np.log(np.tan(columns[:, 1]))
        return columns

    def best_of(points: Array, worth: Array) -> tuple[Array, Array]:
        # Of each part of the region one, and then of all: or a search from many places ends in one.
        order = np.argsort(-worth, kind="stable")
        place = (columns_of(points[order]) - low) / np.where(high > low, high - low, 1.0) * _PARTS
        part = np.clip(place, 0, _PARTS - 1).astype(np.intp) @ np.cumprod([1, *_PARTS[:-1]])
        first = np.sort(np.unique(part, return_index=True)[1])[: kept // 2]
        best = np.sort(np.concatenate([first, np.setdiff1d(np.arange(len(order)), first)[: kept - len(first)]]))
        return points[order[best]], worth[order[best]]

    points, worth = best_of(points, worth)
    for turn in range(begin, _ROUNDS):
        columns = columns_of(np.repeat(points, tries, axis=0))
        # Some coordinates at a time: the worst is often on a limit of the others.
        moved = rng.random(columns.shape) < 0.5
        step = moved * rng.normal(size=columns.shape) * 0.2 * 0.7**turn * (high - low)
        # The worst is often on a static limit, too: a step beyond it is made shorter until it ends before it.
        beyond = np.arange(len(step))
        for _ in range(_SHORTER):
            beyond = beyond[~system.within_limits(point(columns[beyond] + step[beyond]))]
            if len(beyond) == 0:
                break
            step[beyond] *= 0.5
        tried, A = system.matrices(point(columns + step))
        points, worth = best_of(np.concatenate([points, tried]), np.concatenate([worth, shortfall(tried, A)]))
    return points, worth


UNDECIDED, PROVED, EMPTY = 0, 1, 2

CHUNK = 1024

Failing = Callable[[Array, float], Array]
"""Points (N, 6) and a decay to those points at which the inequality does not hold."""

_SAMPLES = 4000
"""Places in undecided boxes that are looked at by eigenvalues after every round of cuts."""


@dataclass(frozen=True)
class Outcome:
    """The result of the proof on boxes.

    ``decay``: the last one tried, 1/s. ``seen``: how many boxes were looked at; ``proved``: how many hold the
    inequality, or nothing within the static limits. ``left``: those that are undecided, of ``whole``. ``broken``:
    points (M, 6) of the region at which the inequality does not hold at that decay: where there are any, the proof
    was given up.
    """

    decay: float
    seen: int
    proved: int
    left: Boxes
    whole: Boxes
    broken: Array


def prove(
    system: System,
    region: Region,
    weights: Weights,
    failing: Failing,
    P: Array,
    decays: Sequence[float],
    budget: int,
    progress: Callable[[str, float], None] | None = None,
    seed: int = 0,
) -> Outcome:
    """The largest of some decays (falling) at which the inequality holds in all points of the region that lie within
    the static limits (:eq:`box-bound`).

    Boxes are cut in half where the bound is too coarse, the largest first, until none is left or the decay's part of
    ``budget`` boxes was looked at; the next decay goes on with what is left. ``failing`` is asked of places in what is
    left, so that a function that does not hold everywhere is given up as soon as that is seen.
    """
    whole = whole_region(system, region)
    level, proved, seen, decay = whole, 0, 0, decays[0]
    rng = np.random.default_rng(seed)
    broken = np.empty((0, 6))
    for turn, decay in enumerate(decays):
        # Half of the boxes for the first of several decays, the other half for giving way step by step.
        part = 0.5 * (1.0 + turn / (len(decays) - 1)) if len(decays) > 1 else 1.0
        ready = programs(system, region, weights, P, decay)
        while len(level) and seen + len(level) <= budget * part and len(broken) == 0:
            level, state, dimension = look_at(system, ready, level, whole)
            undecided = state == UNDECIDED
            seen += len(level)
            proved += int((~undecided).sum())
            level = level.take(undecided).halves(dimension[undecided])
            broken = failing(points_of(system, region, *_places(level, rng)), decay)
            if progress is not None:
                progress("certificate", min(seen / budget, 1.0))
        if len(level) == 0 or len(broken):
            break
    return Outcome(decay, seen, proved, level, whole, broken)


def _places(boxes: Boxes, rng: np.random.Generator) -> tuple[Boxes, Array]:
    """Some of the boxes, M of them, with corners of them and places in them, (M, 6)."""
    if len(boxes) == 0:
        return boxes, np.empty((0, 6))
    index = rng.choice(len(boxes), _SAMPLES)
    share = rng.uniform(0.0, 1.0, (_SAMPLES, 6))
    share[::2] = np.round(share[::2])
    return boxes.take(index), boxes.low[index] + share * (boxes.high[index] - boxes.low[index])


def look_at(
    system: System, ready: BoxPrograms, boxes: Boxes, pieces: Boxes
) -> tuple[Boxes, NDArray[np.int64], NDArray[np.intp]]:
    """The boxes drawn in to what of them may lie in the region (:eq:`box-drawn-in`), and for each whether the
    inequality is undecided, proved, or asked of no point, and the coordinate to cut.

    Chunks of boxes are shared among the machine's cores; what comes out does not depend on how many there are.
    """
    boxes = replace(boxes, low=boxes.low.copy(), high=boxes.high.copy())
    state, dimension = np.zeros(len(boxes), dtype=np.int64), np.zeros(len(boxes), dtype=np.intp)
    situation = arrays(ready.situation)

    def look(start: int) -> None:
        part = slice(start, start + CHUNK)
        own = boxes.take(part)  # views, drawn in in place
        empty = np.zeros(len(own), dtype=np.bool_)
        draw_in(own.low, own.high, parameters_of(system, own, pieces), situation, ready.conditions, empty)
        state[part], dimension[part] = _look(ready, own.low, own.high, parameters_of(system, own, pieces), empty)

    starts = range(0, len(boxes), CHUNK)
    if len(starts) <= 1:  # the first round always: here the code is compiled
        with interrupts_deferred():
            list(map(look, starts))
        return boxes, state, dimension
    threads = ThreadPoolExecutor(os.cpu_count())
    try:
        list(threads.map(look, starts))
    finally:
        threads.shutdown(cancel_futures=True)
    return boxes, state, dimension


def _look(
    ready: BoxPrograms, low: Array, high: Array, parameters: Array, empty: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    count = len(low)
    signs = ready.signs
    carried = len(ready.situation.outputs) - len(ready.conditions) - signs.shape[1]
    applies = np.zeros((len(signs), count), dtype=np.bool_)
    forms = np.zeros((count, carried, rows(FOLLOWED + 1)))
    survey(low, high, parameters, arrays(ready.situation), ready.conditions, signs, empty, applies, forms)
    proved, score = np.ones(count, dtype=np.bool_), np.zeros((count, FOLLOWED + 1))
    for case, inequality in enumerate(ready.inequalities):
        some = np.flatnonzero(applies[case] & ~empty)
        if len(some) == 0:
            continue
        held, pull = np.zeros(len(some), dtype=np.bool_), np.zeros((len(some), FOLLOWED + 1))
        judge(
            low[some],
            high[some],
            np.ascontiguousarray(parameters[:, some]),
            arrays(inequality),
            forms[some],
            ready.order,
            held,
            pull,
        )
        proved[some] &= held
        score[some] = np.maximum(score[some], pull)  # NaN stays
    return np.where(empty, EMPTY, np.where(proved, PROVED, UNDECIDED)), to_cut(low, high, score)


def to_cut(low: Array, high: Array, score: Array) -> NDArray[np.intp]:
    """The coordinate that leaves most unknown; the widest where there is no bound at all. Of the errors, the wider."""
    width = (high - low) / UNIT
    width[:, 0] = np.log(high[:, 0] / low[:, 0])  # a strong grid is a small impedance
    errors = np.where(width[:, 4] >= width[:, 5], 4, 5)
    followed = np.column_stack([width[:, :FOLLOWED], np.maximum(width[:, 4], width[:, 5])])
    finite = np.isfinite(score).all(axis=1, keepdims=True)
    chosen = np.argmax(np.where(followed > 0.0, np.where(finite, score, followed), -1.0), axis=1)
    return np.where(chosen < FOLLOWED, chosen, errors)


def arrays(program: Program) -> tuple[NDArray[np.int64], Array, NDArray[np.int64], Array, NDArray[np.int64], int]:
    return program.code, program.number, program.places, program.factors, program.outputs, program.registers
