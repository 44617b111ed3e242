"""Cells of grids: the functions of the inner loops on every arc of the circle, and whether the inner loops are
stable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.full_order.forms import joined
from vsgdesign.certificate.full_order.inner import ArcFunctions, InnerLoop, InnerTapes

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_FIRST, _RATIO, _HIGH_RATIO = 0.7, 1.3, 1.17
"""End of the first arc in rad/s, and the ratio of the ends of those that follow, below and above HIGH."""

HIGH = 400.0
"""Frequency in rad/s from which on det M is compared with s³ by sizes alone."""

_KNOWN, _KNOWN_HIGH = 0.02, 0.5
"""How well the functions have to be known on an arc, relative to their size; else it is halved."""

_HALVINGS = 5

GOOD, COARSE, INNER_UNSTABLE = 0, 1, 2


@dataclass(frozen=True)
class Arcs:
    """The circle's upper half, cut at these frequencies in rad/s: (n + 1,), from 0 to beyond π/T_s."""

    edges: Array

    @classmethod
    def coarsest(cls, T_s: float) -> Arcs:
        """Where every cell begins."""
        last = np.pi / T_s * (1.0 + 1e-9)
        edges = [0.0, _FIRST]
        while edges[-1] < last:
            edges.append(min(edges[-1] * (_RATIO if edges[-1] < HIGH else _HIGH_RATIO), last))
        return cls(np.array(edges))

    def finer(self, frequencies: Array, than: Array) -> Arcs:
        """Halved until the arcs of some frequencies are shorter than those of ``than`` (edges)."""
        edges = self.edges
        for frequency in np.unique(frequencies):
            k = int(np.searchsorted(than, frequency, side="right")) - 1
            most = 0.6 * (than[k + 1] - than[k])
            while True:
                n = int(np.searchsorted(edges, frequency, side="right")) - 1
                if edges[n + 1] - edges[n] <= most:
                    break
                edges = np.insert(edges, n + 1, 0.5 * (edges[n] + edges[n + 1]))
        return Arcs(edges)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A cell of grids between limits (2,) with what is known on its arcs.

    ``rest`` (2, 11) and ``functions`` (low arcs, inputs, 11): forms of second order as in
    :meth:`~vsgdesign.certificate.full_order.forms.Values.of_second_order`. ``sizes`` (high arcs, 8): least \\|s\\|,
    the largest size of the six functions over both sequences, and that of the ratio of the filters.
    """

    low: Array
    high: Array
    state: int
    rest: Complex
    functions: Complex
    sizes: Array
    edges: Array
    """Of all arcs, rad/s; the low ones first."""
    switch: complex
    """(s/(s + divisor))³ where the high arcs begin: its argument, and the frequency as the modulus, are of interest."""


def cells_of(tapes: InnerTapes, low: Array, high: Array, arcs: Sequence[Arcs]) -> list[Cell]:
    """The functions of cells between limits (N, 2), on their arcs or on halves of these; ``COARSE`` where they cannot
    be enclosed on so large a cell."""
    forms = tapes.cells(low, high)
    count = len(low)
    rest = np.stack([values.of_second_order() for values in forms.rest], axis=1)
    good_cells: Any = np.isfinite(rest[:, :, -1]).all(axis=1)
    start, end = (np.concatenate([one.edges[side] for one in arcs]) for side in (slice(-1), slice(1, None)))
    index = np.repeat(np.arange(count), [len(one.edges) - 1 for one in arcs])
    kept: list[tuple[Any, Any, Any, Any]] = []
    for turn in range(_HALVINGS + 1):
        live = good_cells[index]
        start, end, index = start[live], end[live], index[live]
        if len(index) == 0:
            break
        found = tapes.functions(forms, index, start, end)
        good = _known(found, start)
        for k in np.unique(index[~good]):
            own = index == k
            if turn == _HALVINGS or _hopeless(turn, good[own], start[own]):
                good_cells[k] = False
        use = good & good_cells[index]
        if use.any():
            kept.append((start[use], end[use], index[use], _take(found, np.flatnonzero(use))))
        start, end, index = start[~good], end[~good], index[~good]
        middle = 0.5 * (start + end)
        start, end = np.concatenate([start, middle]), np.concatenate([middle, end])
        index = np.concatenate([index, index])
    if not kept:
        return [_coarse(low[k], high[k], rest[k], arcs[k]) for k in range(count)]
    starts, ends, owners = (np.concatenate([k[n] for k in kept]) for n in range(3))
    every = ArcFunctions.made_of(
        [joined(list(parts)) for parts in zip(*(k[3].every for k in kept), strict=True)], tapes.loop.ratio
    )
    result = []
    for k in range(count):
        if not good_cells[k]:
            result.append(_coarse(low[k], high[k], rest[k], arcs[k]))
            continue
        own = np.flatnonzero(owners == k)
        own = own[np.argsort(starts[own])]
        edges = np.append(starts[own], ends[own[-1]])
        result.append(_cell(tapes.loop, low[k], high[k], rest[k], edges, _take(every, own)))
    return result


def _coarse(low: Array, high: Array, rest: Complex, arcs: Arcs) -> Cell:
    none = np.zeros((0, 0, 11), dtype=complex)
    return Cell(
        low=low, high=high, state=COARSE, rest=rest, functions=none, sizes=np.zeros((0, 8)), edges=arcs.edges,
        switch=1.0,
    )  # fmt: skip


def _cell(loop: InnerLoop, low: Array, high: Array, rest: Complex, edges: Array, every: ArcFunctions) -> Cell:
    inner = [values.centre for values in every.inner]
    stable = winding(np.concatenate([inner[1][::-1], inner[0]])) == loop.rows.states
    for values, own in zip(every.filters, loop.filters, strict=True):
        turns = winding(np.concatenate([values.centre[::-1].conj(), values.centre])) if not own.plain else 0
        stable &= turns == own.denominator.degree
    below = edges[:-1] < HIGH
    low_part = _take(every, np.flatnonzero(below))
    return Cell(
        low=low,
        high=high,
        state=GOOD if stable else INNER_UNSTABLE,
        rest=rest,
        functions=_compact(low_part),
        sizes=_sizes(_take(every, np.flatnonzero(~below))),
        edges=edges,
        switch=_switch(loop, float(edges[:-1][~below][0])),
    )


def winding(values: Complex) -> int:
    """How often a closed curve turns about zero, from one value on each of its arcs: each arc lies in the half-plane
    of its value, so that from one to the next the angle changes by less than π (:eq:`full-order-winding`)."""
    steps = np.angle(np.roll(values, -1) / values)
    return round(float(steps.sum()) / (2.0 * np.pi))


def _switch(loop: InnerLoop, frequency: float) -> complex:
    s = complex(np.expm1((-loop.alpha + 1j * frequency) * loop.T_s)) / loop.T_s
    angle = 3.0 * (np.angle(s) - np.angle(s + loop.divisor))
    return complex(frequency, float(angle))


def _known(found: ArcFunctions, start: Array) -> NDArray[np.bool_]:
    """On which arcs all functions are known well, and the polynomials keep away from zero."""
    limit = np.where(start < HIGH, _KNOWN, _KNOWN_HIGH)
    good = np.ones(len(start), dtype=np.bool_)
    with np.errstate(invalid="ignore"):
        for values in (*found.inner, *found.filters):
            good &= values.off < np.abs(values.centre)
        for k, values in enumerate(found.functions):
            # The parts with the current at rest are small beside the others.
            good &= np.isfinite(values.radius) if k % 6 in (1, 3) else values.radius <= limit * np.abs(values.centre)
    return good


def _hopeless(turn: int, good: NDArray[np.bool_], start: Array) -> bool:
    """Whether it is the cell that is too large, not its arcs: halving those would help little."""
    if turn == 0:
        return float(good[start < HIGH].mean()) < 0.3
    return len(good) > 8 and float(good.mean()) < 0.4


def _take(found: ArcFunctions, index: Any) -> ArcFunctions:
    return ArcFunctions.made_of([values.take(index) for values in found.every], found.ratio is not None)


def _compact(found: ArcFunctions) -> Complex:
    """s, 1/(s + divisor)³, the functions and, where there is one, the ratio: (arcs, inputs, 11)."""
    values = [found.s, found.divided, *found.functions, *([] if found.ratio is None else [found.ratio])]
    return np.ascontiguousarray(np.stack([one.of_second_order() for one in values], axis=1))


def _sizes(found: ArcFunctions) -> Array:
    functions = [values.size for values in found.functions]
    least = np.abs(found.s.centre) - found.s.off
    ratio = np.ones(len(least)) if found.ratio is None else found.ratio.size
    both = [np.maximum(functions[k], functions[k + 6]) for k in range(6)]
    return np.stack([least, *both, ratio], axis=1)
