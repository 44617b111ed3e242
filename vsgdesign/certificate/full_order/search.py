"""The region cut into cells and boxes until f has no zero on the circle over any of them
(:eq:`full-order-exclusion`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.full_order.boxes import DrawnTo, Part, Pieces, pieces_of, whole
from vsgdesign.certificate.full_order.cells import GOOD, INNER_UNSTABLE, Arcs, Cell, cells_of
from vsgdesign.certificate.full_order.inner import InnerLoop, InnerTapes, fastest_step
from vsgdesign.certificate.full_order.looking import ARC, EMPTY, PROVED, UNDECIDED, CellGroup, Looks, look_at
from vsgdesign.certificate.full_order.programs import FullOrderPrograms, full_order_programs
from vsgdesign.certificate.full_order.rows import inner_rows, power_filter
from vsgdesign.certificate.region import Region, System
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

_AT_ONCE = 32
"""Cells whose boxes go through the kernel together."""

_BOXES_OF_CELL = 600
"""Boxes that are looked at in a cell before it is cut itself."""

_FLATTEST = 0.125
"""A cell is not cut in a coordinate that is flatter than so much of the other one: what is not known of its functions
counts as that of its first coordinate, also where it comes from the other."""

_DEEPEST = 20
"""Cuts of a cell after which what is left of it is not decided."""


@dataclass(frozen=True)
class Problem:
    """What is to be proved: a study's loops in a region, and the circle."""

    system: System
    region: Region
    loop: InnerLoop
    tapes: InnerTapes
    programs: FullOrderPrograms
    pieces: Pieces

    @classmethod
    def of(cls, study: Study, system: System, region: Region, alpha: float, drawn_to: DrawnTo | None = None) -> Problem:
        """With the circle \\|z\\| = exp(−alpha T_s); alpha in 1/s. ``drawn_to``: limits of a table's scheduler."""
        filters = power_filter(study, True), power_filter(study, False)
        fastest = fastest_step(study.circuit(), study.converter.T_s, *_corners(study, system, region))
        divisor = max(4.0, 3.0 * alpha)
        loop = InnerLoop.of(study, inner_rows(study), filters, alpha, divisor, fastest, system.apart)
        pieces = pieces_of(system, region, drawn_to)
        programs = full_order_programs(system, region, pieces.drawn, filters[0] != filters[1])
        return cls(system, region, loop, InnerTapes.of(loop), programs, pieces)

    def look(self, group: CellGroup, part: Part) -> Looks:
        """One look at some boxes."""
        return look_at(self.programs, self.pieces, group, part)


def _corners(study: Study, system: System, region: Region) -> tuple[Array, Array]:
    """R_g (Ω) and L_g (H) at the corners of the region, and of no grid where the loop is one of units."""
    c = study.converter
    scr, ratio = (np.array(axis) for axis in (np.repeat(region.scr, 2), np.tile(region.x_over_r, 2)))
    R_g, L_g = SCR_BASES[study.scr_basis].grid(scr, ratio, c.Z_base, c.omega_n)
    return (np.append(R_g, 0.0), np.append(L_g, 0.0)) if system.apart else (R_g, L_g)


@dataclass
class Waiting:
    """A cell whose functions are not known yet, with its boxes."""

    low: Array
    high: Array
    depth: int
    boxes: Part
    arcs: Arcs
    """That its functions begin with."""


@dataclass
class Found:
    """What a search has found so far. ``cells`` (limits) and, for each, its edges of arcs and proved boxes."""

    cells: list[tuple[Array, Array, Array]] = field(default_factory=list)
    boxes: list[Part] = field(default_factory=list)
    nothing: list[Part] = field(default_factory=list)
    """Boxes without a point that counts."""
    proved: float = 0.0
    empty: float = 0.0
    left: list[tuple[Waiting, str]] = field(default_factory=list)
    values: int = 0
    looked: int = 0


def beginning(problem: Problem) -> list[Waiting]:
    """All of the region."""
    low, high, boxes = whole(problem.system, problem.region, problem.pieces)
    arcs = Arcs.coarsest(problem.loop.T_s)
    return [Waiting(low[k], high[k], 0, boxes.take(boxes.cell == k), arcs) for k in range(len(low))]


def search(
    problem: Problem,
    waiting: list[Waiting],
    found: Found,
    most_looks: float = np.inf,
) -> list[Waiting]:
    """Goes on with what is waiting until nothing is or so many boxes were looked at; returns what then still waits."""
    stack = list(reversed(waiting))
    while stack and found.looked < most_looks:
        now = [stack.pop() for _ in range(min(_AT_ONCE, len(stack)))]
        ready: list[tuple[Waiting, Cell]] = []
        cells = cells_of(
            problem.tapes,
            np.array([one.low for one in now]),
            np.array([one.high for one in now]),
            [one.arcs for one in now],
        )
        for one, cell in zip(now, cells, strict=True):
            if cell.state == GOOD:
                ready.append((one, cell))
            elif cell.state == INNER_UNSTABLE:  # on the whole cell: a smaller one is no better
                found.left.append((one, "inner"))
            elif one.depth >= _DEEPEST:
                found.left.append((one, "functions"))
            else:
                stack.extend(_halved(one, one.boxes, None))
        if ready:
            stack.extend(_look(problem, ready, found))
    return list(reversed(stack))


def _look(problem: Problem, ready: list[tuple[Waiting, Cell]], found: Found) -> list[Waiting]:
    """The boxes of some cells, cut until each is decided or asks for a smaller cell; returns the smaller cells."""
    group = CellGroup.of([cell for _, cell in ready])
    count = len(ready)
    parts = [
        Part(b.low, b.high, np.full(len(b), k), b.piece, b.frequency, b.share)
        for k, b in enumerate(one.boxes for one, _ in ready)
    ]
    part = Part.joined(parts)
    wanting: list[Part] = []
    asks = np.zeros((count, 2))
    long: list[list[Array]] = [[] for _ in ready]
    looked = np.zeros(count, dtype=np.int64)
    kept: list[Part] = []
    while len(part):
        looks = problem.look(group, part)
        found.values += looks.values
        found.looked += len(part)
        np.add.at(looked, part.cell, 1)
        nothing = looks.state == EMPTY
        found.empty += float(part.share[nothing].sum())
        if nothing.any():
            found.nothing.append(part.take(nothing))
        proved = looks.state == PROVED
        found.proved += float(part.share[proved].sum())
        if proved.any():
            kept.append(part.take(proved))
        undecided = looks.state == UNDECIDED
        part = Part(part.low, part.high, part.cell, part.piece, looks.frequency, part.share).take(undecided)
        dimension = looks.dimension[undecided]
        for k in np.unique(part.cell[dimension == ARC]):
            long[k].append(part.frequency[(dimension == ARC) & (part.cell == k)])
        cut_cell = (dimension < 2) | (dimension == ARC) | (looked[part.cell] > _BOXES_OF_CELL)
        np.add.at(asks, (part.cell[dimension < 2], dimension[dimension < 2]), part.share[dimension < 2])
        if cut_cell.any():
            wanting.append(part.take(cut_cell))
        part = part.take(~cut_cell).halves(dimension[~cut_cell])
    first = len(found.cells)
    found.cells += [(cell.low, cell.high, cell.edges) for _, cell in ready]
    for one in kept:
        found.boxes.append(Part(one.low, one.high, one.cell + first, one.piece, one.frequency, one.share))
    smaller: list[Waiting] = []
    if wanting:
        left = Part.joined(wanting)
        for k, (one, cell) in enumerate(ready):
            own = left.take(left.cell == k)
            if len(own) == 0:
                continue
            if one.depth >= _DEEPEST:
                found.left.append((Waiting(one.low, one.high, one.depth, own, one.arcs), "boxes"))
                continue
            if long[k]:
                one.arcs = one.arcs.finer(np.concatenate(long[k]), cell.edges)
            smaller += _halved(one, own, asks[k] if asks[k].any() else None)
    return smaller


def _halved(one: Waiting, boxes: Part, asks: Any) -> list[Waiting]:
    """A cell cut in the dimension that most of its boxes ask for; else in the wider one."""
    half = 0.5 * (one.high - one.low)
    width = np.array([1.5 * half[0] / (0.5 * (one.low[0] + one.high[0])), 2.0 * half[1]])
    ratio = width if asks is None else np.where(half > 0.0, asks, -1.0)
    k = int(np.argmax(ratio))
    k = k if width[k] >= _FLATTEST * width.max() else int(np.argmax(width))
    middle = 0.5 * (one.low[k] + one.high[k])
    found = []
    for side in range(2):
        low, high = one.low.copy(), one.high.copy()
        (high if side == 0 else low)[k] = middle
        own_low, own_high = boxes.low.copy(), boxes.high.copy()
        (own_high if side == 0 else own_low)[:, k] = middle
        part = Part(own_low, own_high, boxes.cell, boxes.piece, boxes.frequency, 0.5 * boxes.share)
        found.append(Waiting(low, high, one.depth + 1, part, one.arcs))
    return found
