"""What a search has decided: the parts that are left, and trees of cuts and arcs that a proof's file keeps.

A tree is written level by level: for each box that is open, the coordinate in which it is cut, or what it is. Both
halves of a cut come next to each other in the following level, the lower one first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.proof_file import EMPTY, LEFT, PROVED
from vsgdesign.certificate.full_order.boxes import Part, Pieces
from vsgdesign.certificate.full_order.search import Found, Problem, Waiting
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.grid import SCR_BASES

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

_MOST_CUTS = 48


@dataclass(frozen=True, kw_only=True)
class LeftPart:
    """A part of the region that is not proved: its limits (P in W, Q in var), its share of the boxes' volume, and
    why."""

    scr: tuple[float, float]
    x_over_r: tuple[float, float]
    P: tuple[float, float]
    Q: tuple[float, float]
    share: float
    reason: str
    """``inner``: the inner loops alone are not inside the circle; ``functions``: they are not enclosed well enough;
    ``boxes``: the power loops are not enclosed well enough; ``time``: not looked at in the time that was given."""
    frequency: tuple[float, float] | None = None
    """Between which frequencies, rad/s, f is not known; None where it was not looked at."""
    least_decay: float | None = None
    """The least decay that random points and a search find there, 1/s; None: not looked for, or no point keeps the
    static limits."""


def arrays_of(roots: list[Waiting], pieces: Pieces, found: Found, coarse: Array) -> dict[str, NDArray[Any]]:
    """The arrays of a block (:data:`vsgdesign.artifacts.proof_file.COLUMNS`) that began with some cells."""
    low, high = (np.concatenate([getattr(one.boxes, name) for one in roots]) for name in ("low", "high"))
    piece = np.concatenate([one.boxes.piece for one in roots])
    own_cell = np.repeat(np.arange(len(roots)), [len(one.boxes) for one in roots])
    leaves, label = _leaves(found)
    root = np.zeros(0, dtype=np.int64)
    depths = places = np.zeros((0, low.shape[1]), dtype=np.int64)
    if len(label):
        root = _roots_of(leaves, low, high, piece)
        depths, places = _cuts(low[root], high[root], leaves.low, leaves.high)
    tree = _tree(len(low), root, depths, places, label)
    proved = label == PROVED
    # The grids of a box are those of its cell.
    keys = np.column_stack([own_cell[root], depths[:, 0], places[:, 0], depths[:, 1], places[:, 1]])[proved]
    cells, first = np.unique(keys, axis=0, return_index=True) if len(keys) else (np.zeros((0, 5)), np.zeros(0, int))
    arcs = [_halvings(found.cells[k][2], coarse) for k in leaves.cell[proved][first]]
    return {
        "roots": np.concatenate([low, high], axis=1),
        "estimates": np.concatenate([pieces.first, pieces.slope], axis=1)[piece],
        "tree": tree,
        "cells": cells,
        "arcs": np.concatenate([np.zeros(0, dtype=np.uint8), *arcs]),
    }


def _leaves(found: Found) -> tuple[Part, Counts]:
    """All boxes that are decided, and as what."""
    parts = [*found.boxes, *found.nothing]
    label = [np.full(len(part), PROVED if k < len(found.boxes) else EMPTY) for k, part in enumerate(parts)]
    if not parts:
        none = np.zeros((0, 6))
        count = np.zeros(0, dtype=np.int64)
        return Part(none, none, count, count, np.zeros(0), np.zeros(0)), count
    return Part.joined(parts), np.concatenate(label)


def _roots_of(leaves: Part, low: Array, high: Array, piece: Counts) -> Counts:
    """The box of the beginning that holds each leaf."""
    middle = 0.5 * (leaves.low + leaves.high)
    root = np.full(len(leaves), -1)
    for k in range(len(low)):
        inside = (leaves.piece == piece[k]) & ((middle >= low[k]) & (middle <= high[k])).all(axis=1)
        root[inside] = k
    if (root < 0).any():
        raise ValueError("a box lies outside of those of the beginning")
    return root


def _cuts(low: Array, high: Array, own_low: Array, own_high: Array) -> tuple[Counts, Counts]:
    """How often a box (N, 6) was halved in each coordinate to give another one, and at which of the places that is."""
    width, own = high - low, own_high - own_low
    with np.errstate(invalid="ignore", divide="ignore"):
        depths = np.where(width > 0.0, np.round(np.log2(width / own)), 0.0)
        places = np.where(width > 0.0, np.round((own_low - low) / width * 2.0**depths), 0.0)
    again = low + width * places / 2.0**depths
    if (np.abs(again - own_low) > 1e-9 * np.maximum(width, 1e-300)).any():
        raise ValueError("a box is not made by halving one of the beginning")
    return depths.astype(np.int64), places.astype(np.int64)


def _tree(roots: int, root: Counts, depths: Counts, places: Counts, label: Counts) -> NDArray[np.uint8]:
    """The symbols of all trees, from the leaves' roots and cuts."""
    symbols: list[NDArray[np.uint8]] = []
    nodes, node = roots, root.copy()
    done = np.zeros_like(depths)
    for _ in range(_MOST_CUTS * depths.shape[1]):
        if nodes == 0:
            return np.concatenate(symbols) if symbols else np.zeros(0, dtype=np.uint8)
        order = np.argsort(node, kind="stable")
        node, depths, places, label, done = (value[order] for value in (node, depths, places, label, done))
        own = np.full(nodes, LEFT, dtype=np.uint8)
        begin = np.flatnonzero(np.diff(node, prepend=-1))
        if len(node):
            whole = (depths == done).all(axis=1)
            own[node[whole]] = label[whole]
            least = np.minimum.reduceat(depths - done, begin, axis=0)
            dimension = np.argmax(least > 0, axis=1)
            open_ = own[node[begin]] == LEFT
            if not (least[open_] > 0).any(axis=1).all():
                raise ValueError("boxes overlap")
            own[node[begin][open_]] = dimension[open_]
        symbols.append(own)
        cut = own < depths.shape[1]
        child = np.cumsum(cut) - 1
        go = cut[node]
        node, depths, places, label, done = (value[go] for value in (node, depths, places, label, done))
        if len(node):
            k, rows = own[node].astype(np.intp), np.arange(len(node))
            done = done.copy()
            done[rows, k] += 1
            side = (places[rows, k] >> (depths[rows, k] - done[rows, k])) & 1
            node = 2 * child[node] + side
        nodes = 2 * int(cut.sum())
    raise ValueError("boxes were cut too often")


def _halvings(edges: Array, coarse: Array) -> NDArray[np.uint8]:
    """How often each arc of a cell was halved."""
    of = np.clip(np.searchsorted(coarse, 0.5 * (edges[:-1] + edges[1:])) - 1, 0, len(coarse) - 2)
    return np.round(np.log2((coarse[of + 1] - coarse[of]) / np.diff(edges))).astype(np.uint8)


def left_row(problem: Problem, one: Waiting, why: str) -> list[Any]:
    """A part that is left, as a journal keeps it: limits of the grids, of P and Q, and of the frequencies."""
    c, boxes = problem.system.study.converter, one.boxes
    basis = SCR_BASES[problem.system.study.scr_basis]
    sizes = [float(basis.magnitude(first, np.sin(angle))) for first in (one.low[0], one.high[0])
             for angle in (one.low[1], one.high[1])]  # fmt: skip
    powers: list[float] = []
    for k, own in ((4, problem.region.P), (5, problem.region.Q)):
        ends = float(boxes.low[:, k].min()), float(boxes.high[:, k].max())
        every = [end * V**2 / size * c.S_rated / PHASES
                 for end in ends for V in (c.V_min_pu, c.V_max_pu) for size in (min(sizes), max(sizes))]  # fmt: skip
        powers += np.clip([min(every), max(every)], *own).tolist()
    looked = why == "boxes"
    frequency = [float(boxes.frequency.min()), float(boxes.frequency.max())] if looked else None
    return [*one.low.tolist(), *one.high.tolist(), *powers, frequency, float(boxes.share.sum()), why]


def left_parts(proved: float, rest: Sequence[list[Any]]) -> tuple[float, list[LeftPart]]:
    """The volume of what is not empty, and the rows of :func:`left_row` as parts, the largest first."""
    total = max(proved + sum(row[-2] for row in rest), 1e-300)
    return total, [
        LeftPart(
            scr=(1.0 / row[2], 1.0 / row[0]),
            x_over_r=(float(np.tan(row[1])), float(np.tan(row[3]))),
            P=(row[4], row[5]),
            Q=(row[6], row[7]),
            frequency=None if row[8] is None else (row[8][0], row[8][1]),
            share=row[-2] / total,
            reason=row[-1],
        )
        for row in sorted(rest, key=lambda row: -row[-2])
    ]
