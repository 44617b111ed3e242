"""One look at many boxes: which are empty, on which f has no zero on the circle, and where the others should be cut."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.full_order.boxes import NATURAL, SMALLEST, Part, Pieces
from vsgdesign.certificate.full_order.cells import HIGH, Cell
from vsgdesign.certificate.full_order.higher import gains_of, tables
from vsgdesign.certificate.full_order.kernel import exclude, survey
from vsgdesign.certificate.full_order.programs import DIMENSIONS, FullOrderPrograms
from vsgdesign.certificate.proof import arrays
from vsgdesign.certificate.taylor_kernel import rows

Array = NDArray[np.float64]

UNDECIDED, PROVED, EMPTY = 0, 1, 2

_PARTS = 17
"""Numbers that the power loops are made of, in the order of ``programs._gains``."""


_WEIGHT = np.array([0.5, 0.5, 1.0, 1.0, 1.0, 1.0, 0.25])
"""Of the dimensions in the choice of where to cut: to cut a cell of grids, or its arcs, takes longer than to cut a
box."""

ARC = 6
"""The dimension of the frequency."""


@dataclass(frozen=True)
class Looks:
    """Of N boxes: ``state``; where undecided, the ``dimension`` to cut, and the ``frequency`` in rad/s at which f was
    not known; and how many values of f were enclosed."""

    state: NDArray[np.int64]
    dimension: NDArray[np.intp]
    frequency: Array
    values: int


@dataclass(frozen=True)
class CellGroup:
    """Cells side by side, as the kernel takes them."""

    cells: tuple[Cell, ...]
    rest: Any
    functions: Any
    first: NDArray[np.int64]
    counts: NDArray[np.int64]
    order: NDArray[np.int64]

    @classmethod
    def of(cls, cells: list[Cell]) -> CellGroup:
        """Arcs where f is smallest come first."""
        counts = np.array([len(cell.functions) for cell in cells], dtype=np.int64)
        order = []
        for cell in cells:
            middle = np.maximum(cell.functions[:, 0, 0].imag, 0.01)
            order.append(np.argsort(np.abs(np.log(middle / SMALLEST)), kind="stable"))
        return cls(
            tuple(cells),
            np.ascontiguousarray(np.stack([cell.rest for cell in cells])),
            np.ascontiguousarray(np.concatenate([cell.functions for cell in cells])),
            np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64),
            counts,
            np.concatenate(order).astype(np.int64),
        )

    def places(self, cell: NDArray[np.int64], frequency: Array) -> NDArray[np.int64]:
        """Of the low arcs of cells, those of frequencies (N,), by their places in the order."""
        found = np.zeros(len(cell), dtype=np.int64)
        for k in np.unique(cell):
            own, count, first = cell == k, int(self.counts[k]), int(self.first[k])
            arc = np.searchsorted(self.cells[k].edges[1:count], frequency[own], side="right")
            place = np.empty(count, dtype=np.int64)
            place[self.order[first : first + count]] = np.arange(count)
            found[own] = place[arc]
        return found

    def frequencies(self, cell: NDArray[np.int64], place: NDArray[np.int64]) -> Array:
        """The middles of low arcs in rad/s, by their places in the order of their cells."""
        return self.functions[self.first[cell] + self.order[self.first[cell] + place], 0, 0].imag


def look_at(programs: FullOrderPrograms, pieces: Pieces, group: CellGroup, part: Part) -> Looks:
    """For each box of cells that are good; ``part.cell`` is the place of the cell in the group."""
    count, size = len(part), rows(DIMENSIONS)
    low, high = part.low, part.high
    empty, applies = np.zeros(count, dtype=np.bool_), np.zeros((len(programs.signs), count), dtype=np.bool_)
    columns = pieces.parameters(low, high, part.piece)
    situation = arrays(programs.situation)
    boxes = (low, high, part.cell, group.rest, columns)
    survey(boxes, situation, programs.conditions, programs.signs, DIMENSIONS, (empty, applies))
    state = np.where(empty, EMPTY, PROVED).astype(np.int64)
    score = np.zeros((count, DIMENSIONS))
    frequency = part.frequency.copy()
    begin = group.places(part.cell, frequency)
    values = 0
    widest = int(group.counts.max())
    for case in range(len(programs.signs)):
        some = np.flatnonzero(applies[case] & (state == PROVED))
        if len(some) == 0:
            continue
        own_low, own_high, cell = low[some], high[some], part.cell[some]
        program = programs.gains[case]
        gains = np.zeros((len(some), len(program.outputs), size))
        own = np.ascontiguousarray(columns[:, some])
        gains_of((own_low, own_high, cell), group.rest, own, arrays(program), tables(), gains)
        held, where = np.zeros(len(some), dtype=np.int64), np.zeros(len(some), dtype=np.int64)
        pull, middle = np.zeros((len(some), DIMENSIONS)), np.ones((len(some), widest), dtype=complex)
        good = _high(programs.numbers[case], group, own_low, own_high, cell, gains)
        pull[~good] = np.nan
        tried = np.flatnonzero(good)
        if len(tried):
            found = (held[tried], where[tried], pull[tried], middle[tried])
            limits = (own_low[tried], own_high[tried], cell[tried], begin[some][tried])
            arcs = (group.functions, group.first, group.counts, group.order)
            values += exclude(limits, gains[tried], arcs, arrays(programs.arcs[case]), DIMENSIONS, found)
            held[tried], where[tried], pull[tried], middle[tried] = found
        for n in np.flatnonzero(held):
            if not _turns_as_stable(group.cells[cell[n]], middle[n, : group.counts[cell[n]]]):
                held[n] = 0
        failed = some[held == 0]
        state[failed] = UNDECIDED
        frequency[failed] = np.where(good, group.frequencies(cell, where), HIGH)[held == 0]
        score[failed] = pull[held == 0]
    return Looks(state, to_cut(part, score), frequency, values)


@dataclass(frozen=True)
class HighSizes:
    """On the high arcs of some boxes of one cell, each (boxes, arcs): the least \\|s\\|; bounds of what δ and ln V do
    to P, Q; of the four entries of diag(s², s)⁻¹M − 1 (:eq:`full-order-high`); and of the power loops' parts."""

    own: NDArray[np.intp]
    s: Array
    powers: tuple[Array, ...]
    """P and Q of δ, then of ln V."""
    entries: tuple[Array, ...]
    """11, 12, 21, 22."""
    parts: Array
    """(boxes, parts)."""

    @property
    def total(self) -> Array:
        """What bounds \\|det M/s³ − 1\\|."""
        e_11, e_12, e_21, e_22 = self.entries
        return e_11 + e_22 + e_11 * e_22 + e_12 * e_21


def high_sizes(
    numbers: Sequence[float | None], group: CellGroup, low: Array, high: Array, cell: Any, gains: Array
) -> Iterator[HighSizes]:
    """The boxes of each cell, by sizes alone."""
    sizes = _part_sizes(numbers, gains)
    kap_d, iota_d, nu_d, kap_V, iota_V, nu_V, slope, k_P, k_Q, K_ip, K_pq, K_qp, K_iq, A, B, C, D = (
        sizes[:, k, None] for k in range(_PARTS)
    )
    p, q = (np.maximum(np.abs(low[:, k]), np.abs(high[:, k])) for k in (4, 5))
    y = (np.hypot(p, q) / 3.0 * (1.0 + 1e-12))[:, None]
    for k in np.unique(cell):
        own = np.flatnonzero(cell == k)
        s, a_1, a_2, b_1, b_2, c, e, ratio = (column[None] for column in group.cells[k].sizes.T)
        at = y[own]
        P_d = 2.0 * ((a_1 + a_2 * at) * at + b_1 + b_2 * at)
        P_V = 2.0 * (c * at + e)
        Q_d, Q_V = ratio * P_d, ratio * P_V
        powers = P_d, Q_d, P_V, Q_V
        P_d, Q_d, P_V, Q_V = P_d + A[own], Q_d + C[own], P_V + B[own], Q_V + D[own]
        first, second = (k_P[own] + K_ip[own] / s) / s, (k_Q[own] + K_pq[own] / s) / s
        with np.errstate(invalid="ignore", over="ignore"):
            e_11 = kap_d[own] / s + iota_d[own] / s**2 + first * P_d + second * Q_d
            e_12 = kap_V[own] / s + iota_V[own] / s**2 + first * P_V + second * Q_V
            e_21 = slope[own] + (nu_d[own] + K_qp[own] * P_d + K_iq[own] * Q_d) / s
            e_22 = (nu_V[own] + K_qp[own] * P_V + K_iq[own] * Q_V) / s
        yield HighSizes(own, s, powers, (e_11, e_12, e_21, e_22), sizes[own])


def _high(
    numbers: Sequence[float | None], group: CellGroup, low: Array, high: Array, cell: Any, gains: Array
) -> NDArray[np.bool_]:
    """Whether \\|det M/s³ − 1\\| < 1 on every high arc, by sizes alone (:eq:`full-order-high`)."""
    good = np.zeros(len(low), dtype=np.bool_)
    for found in high_sizes(numbers, group, low, high, cell, gains):
        with np.errstate(invalid="ignore", over="ignore"):
            good[found.own] = ((found.total < 1.0 - 1e-9) & (found.s > 0.0)).all(axis=1)
    return good


def _part_sizes(numbers: Sequence[float | None], gains: Array) -> Array:
    """Bounds of what the power loops are made of, (N, parts)."""
    d = DIMENSIONS
    last = 1 + d + d * (d + 1) // 2
    terms, radii = np.abs(gains[:, :, 1:last]), gains[:, :, last : last + d]
    with np.errstate(over="ignore"):  # a box that is far too large
        bounds = np.abs(gains[:, :, 0]) + terms.sum(axis=2) + radii.sum(axis=2)
    found = np.empty((len(gains), len(numbers)))
    k = 0
    for n, number in enumerate(numbers):
        if number is None:
            found[:, n] = bounds[:, k] * (1.0 + 1e-12)
            k += 1
        else:
            found[:, n] = abs(number)
    return found


def _turns_as_stable(cell: Cell, middle: Any) -> bool:
    """Whether det M turns about zero as often as that of a stable loop: three times, as s³ does
    (:eq:`full-order-winding`)."""
    if middle[0].real <= 0.0:
        return False
    angle = float(np.angle(middle[0]) + np.angle(middle[1:] / middle[:-1]).sum())
    return abs(angle - cell.switch.imag) < np.pi * (1.0 - 1e-9)


def to_cut(part: Part, score: Array) -> NDArray[np.intp]:
    """The dimension that leaves most unknown; the widest coordinate where there is no bound."""
    half = 0.5 * (part.high - part.low)
    width = half * NATURAL
    width[:, 0] = half[:, 0] / (0.5 * (part.high[:, 0] + part.low[:, 0])) * NATURAL[0]
    finite = np.isfinite(score).all(axis=1, keepdims=True) & (score.sum(axis=1, keepdims=True) > 0.0)
    none = np.zeros((len(half), 1))
    chosen = np.where(finite, score, np.hstack([width, none])) * _WEIGHT
    return np.argmax(np.where(np.hstack([half, none + 1.0]) > 0.0, chosen, -1.0), axis=1)
