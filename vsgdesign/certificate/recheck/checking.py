"""The check of a proof's boxes by enclosures of their own: all of them, or a share that is drawn by volume."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsgdesign.artifacts.proof_file import EMPTY, LEFT, PROVED
from vsgdesign.certificate.recheck.changing import difference_of, middles_of, reach_of
from vsgdesign.certificate.recheck.inner import Arcs, arcs_of, cells_of
from vsgdesign.certificate.recheck.loops import OMEGA, Boxes, Loops, boxes_of, f_of, jacobians, made_of
from vsgdesign.certificate.recheck.polynomials import Polynomial
from vsgdesign.certificate.recheck.reading import Leaves, cells_of_table, where

Array = Any

SMALL = 400
"""Boxes up to which all are looked at."""
LEAST_SAMPLE, LEAST_SECONDS = 200, 60.0
"""Of a larger proof."""

_AT_ONCE = 12
_DEEPEST = 18
"""Halvings of a box or of its arcs after which it is not confirmed."""
_MOST_PIECES = 4_000
"""Of one box."""


@dataclass
class Piece:
    """A part of a box, with arcs of its own."""

    leaf: int
    low: Array
    high: Array
    estimates: Array
    edges: Array
    depth: int


@dataclass(frozen=True)
class Checked:
    """How many of the boxes were looked at, their share of the volume, how many pieces that took, and the boxes that
    were not confirmed, in words."""

    boxes: int
    of: int
    share: float
    pieces: int
    not_confirmed: tuple[str, ...]


def check_boxes(
    loops: Sequence[Loops],
    leaves: Leaves,
    seed: int = 0,
    most_seconds: float = LEAST_SECONDS,
    tell: Callable[[float], None] | None = None,
) -> Checked:
    """Each box that is looked at is enclosed on its arcs; where that does not do, it is halved, or its arcs are.
    ``loops``: those of each block, or one for all.

    A proof of at most SMALL boxes is checked whole. Of a larger one so many are drawn by volume as ``most_seconds``
    allow, and at least LEAST_SAMPLE.
    """
    counted = np.flatnonzero(leaves.symbol != LEFT)
    whole = len(counted) <= SMALL
    order = counted if whole else _drawn(leaves, np.random.default_rng(seed))
    begin, done, pieces = time.monotonic(), 0, 0
    broken: list[str] = []
    while done < len(order) and not broken:  # one is enough to refuse
        if not whole and done >= LEAST_SAMPLE and time.monotonic() - begin > most_seconds:
            break
        some = order[done : done + _AT_ONCE]
        for block in np.unique(leaves.block[some] % len(loops)):
            if not broken:
                count, broken = _confirm(loops[block], leaves, some[leaves.block[some] % len(loops) == block])
                pieces += count
        done += len(some)
        if tell is not None:
            tell(done / (len(order) if whole else max(LEAST_SAMPLE, done)))
    return Checked(done, len(counted), float(leaves.share[order[:done]].sum()), pieces, tuple(broken))


_MOST_DRAWN = 20_000


def _drawn(leaves: Leaves, rng: np.random.Generator) -> Array:
    """Boxes in the order in which they are looked at: drawn by volume, three proved ones and then an empty one, because
    most of the volume may be empty."""
    found = []
    for symbol, most in ((PROVED, 3 * _MOST_DRAWN // 4), (EMPTY, _MOST_DRAWN // 4)):
        own = np.flatnonzero(leaves.symbol == symbol)
        weight = leaves.share[own]
        found.append(rng.choice(own, min(most, len(own)), replace=False, p=weight / weight.sum()) if len(own) else own)
    proved, empty = found
    turn = np.concatenate([np.arange(len(proved)) / 3.0, np.arange(len(empty)) + 0.9])
    return np.concatenate(found)[np.argsort(turn, kind="stable")]


def _confirm(loops: Loops, leaves: Leaves, some: Array) -> tuple[int, list[str]]:
    """How many pieces some boxes took, and which of them were not confirmed."""
    stack, broken, count = [], [], 0
    spent = dict.fromkeys(some.tolist(), 0)
    for k in some.tolist():
        edges = leaves.arcs[leaves.cell[k]] if leaves.cell[k] >= 0 else np.zeros(0)
        for limits in cells_of_table(loops, leaves.low[k], leaves.high[k], leaves.estimates[k]):
            stack.append(Piece(k, leaves.low[k], leaves.high[k], limits, edges, 0))
    while stack and not broken:
        now = [stack.pop() for _ in range(min(_AT_ONCE, len(stack)))]
        count += len(now)
        for piece, smaller in zip(now, _look(loops, leaves, now), strict=True):
            spent[piece.leaf] += 1
            if smaller and (piece.depth >= _DEEPEST or spent[piece.leaf] > _MOST_PIECES):
                broken.append(where(piece.low, piece.high))
                break
            stack += smaller
    return count, broken


def _look(loops: Loops, leaves: Leaves, now: list[Piece]) -> list[list[Piece]]:
    """For each piece, the smaller ones that are left to be looked at; none where it is confirmed."""
    low, high = np.array([p.low for p in now]), np.array([p.high for p in now])
    limits, index = np.unique(np.concatenate([low[:, :2], high[:, :2]], axis=1), axis=0, return_inverse=True)
    with np.errstate(all="ignore"):
        cells = cells_of(loops.inner, limits[:, :2], limits[:, 2:])
        at = boxes_of(loops, cells, index, low, high, np.array([p.estimates for p in now]))
        empty = np.zeros(len(now), dtype=np.bool_)
        for condition in at.conditions:
            empty |= lower(condition) > 0.0
        found: list[list[Piece]] = [[] for _ in now]
        for k in np.flatnonzero(~empty).tolist():
            if leaves.symbol[now[k].leaf] == EMPTY:
                found[k] = _halved(now[k], _widest(now[k], _crossing(at.conditions, k)))
        live = [k for k in np.flatnonzero(~empty).tolist() if not found[k]]
        if live:
            arcs, owner = _arcs_of(loops, cells, [now[k] for k in live], index[live])
            _judge(loops, arcs, owner, at, now, live, found)
            held = [(k, own) for k, own in zip(live, owner, strict=True) if not found[k]]
            if loops.ball is not None and held:
                live, owner = [k for k, _ in held], [own for _, own in held]
                boxes = low, high, np.array([p.estimates for p in now])
                _judge_gain(loops, arcs, owner, (cells, index, boxes, at), now, live, found)
    return found


def _arcs_of(loops: Loops, cells: Any, pieces: list[Piece], index: Array) -> tuple[Arcs, list[Array]]:
    """The functions on the arcs of some pieces, each cell's arcs once, and where those of each piece are."""
    keys: dict[tuple[int, bytes], int] = {}
    low, high, of, owner, spans = [], [], [], [], []
    at = 0
    for piece, cell in zip(pieces, index.tolist(), strict=True):
        key = (cell, piece.edges.tobytes())
        if key not in keys:
            keys[key] = len(spans)
            spans.append(np.arange(at, at + len(piece.edges) - 1))
            at += len(piece.edges) - 1
            low.append(piece.edges[:-1])
            high.append(piece.edges[1:])
            of.append(np.full(len(piece.edges) - 1, cell))
        owner.append(spans[keys[key]])
    every = arcs_of(loops.inner, cells, np.concatenate(of), np.concatenate(low), np.concatenate(high), loops.alpha)
    return every, owner


def _judge(
    loops: Loops, arcs: Arcs, owner: list[Array], at: Boxes, now: list[Piece], live: list[int], found: list[Any]
) -> None:
    """Writes what is left of the pieces that are not empty."""
    for k, own in zip(live, owner, strict=True):
        plus, minus = ((lower(x.take(own) * x.centre[own].conj()) > 0.0) for x in arcs.characteristic)
        if not (plus & minus).all():
            found[k] = _finer(now[k], ~(plus & minus))
            continue
        values = np.concatenate([arcs.characteristic[1].centre[own][::-1], arcs.characteristic[0].centre[own]])
        if _turns(values) != loops.inner.zeros:
            found[k] = _halved(now[k], int(np.argmax(_width(now[k])[:2])), 3)
    box = np.concatenate([np.full(len(own), k) for k, own in zip(live, owner, strict=True)])
    arc = np.concatenate(owner)
    for good, J in jacobians(loops, at) if loops.ball is None else middles_of(loops, at):
        some = good[box] & np.array([not found[k] for k in range(len(now))])[box]
        if not some.any():
            continue
        made = made_of(loops, at, J)
        f = f_of(loops, arcs, arc[some], at, made, box[some])
        turned = f * f.centre.conj()
        apart = lower(turned)
        own_box = box[some]
        for k in np.unique(own_box).tolist():
            lanes = np.flatnonzero(own_box == k)
            bad = ~(apart[lanes] > 0.0)
            if not bad.any():
                if _half_turn(f.centre[lanes]) != 0:
                    # A mode is outside in the whole piece, unless none of its points counts: few halves show that.
                    found[k] = _halved(now[k], int(np.argmax(_width(now[k]))), 3)
                continue
            found[k] = _cut(now[k], turned.take(lanes[bad]), bad)


def _judge_gain(
    loops: Loops, arcs: Arcs, owner: list[Array], given: Any, now: list[Piece], live: list[int], found: list[Any]
) -> None:
    """Writes what is left of the pieces on which the ball of gains is not known to leave the loop stable
    (:eq:`moving-difference`)."""
    cells, index, limits, at = given
    middles = middles_of(loops, at)
    reach = reach_of(loops, cells, index, limits, at, middles)
    box, arc = np.concatenate([np.full(len(own), k) for k, own in zip(live, owner, strict=True)]), np.concatenate(owner)
    for good, J in middles:
        some = good[box]
        if not some.any():
            continue
        value = difference_of(loops, arcs, arc[some], at, made_of(loops, at, J), box[some], reach)
        known = lower(value)
        for k in np.unique(box[some]).tolist():
            lanes = np.flatnonzero(box[some] == k)
            bad = ~(known[lanes] > 0.0)
            if bad.any():
                found[k] = _cut(now[k], value.take(lanes[bad]), bad)


def lower(x: Polynomial) -> Array:
    """A bound from below of the real part, (N,)."""
    real = x.c.real
    bound = real[0] - x.radius
    for k in x.rows:
        if k == 0:
            continue
        e = x.space.exponents[k]
        # Even powers alone are between 0 and 1.
        bound = bound + (np.minimum(real[k], 0.0) if all(n % 2 == 0 for n in e) else -np.abs(real[k]))
    return np.where(np.isfinite(bound), bound - 1e-13 * np.abs(real).sum(axis=0), -np.inf)


def _turns(values: Array) -> int:
    """How often a closed curve turns about zero: from one arc to the next the angle changes by less than π."""
    return round(float(np.angle(np.roll(values, -1) / values).sum()) / (2.0 * np.pi))


def _half_turn(values: Array) -> int:
    """By how many half turns f, which is real at both ends of the half circle, turns along it."""
    ends = [1.0 if values[k].real > 0.0 else -1.0 for k in (0, -1)]
    total = np.angle(values[0] / ends[0]) + np.angle(values[1:] / values[:-1]).sum() + np.angle(ends[1] / values[-1])
    return round(float(total) / np.pi) if ends[0] > 0.0 else 1


def _cut(piece: Piece, turned: Polynomial, bad: Array) -> list[Piece]:
    """Halves in the coordinate by which f varies most where it is not known well enough; the arcs where that is the
    frequency."""
    pull = np.zeros(7)
    for k in turned.rows:
        for variable, n in enumerate(turned.space.exponents[k]):
            if n:
                pull[variable] += float(np.nan_to_num(np.abs(turned.c[k].real)).sum())
    # What is beyond second order is no coordinate's alone: it shrinks fastest with the widest one.
    if not np.isfinite(turned.radius).all() or pull.max() <= float(turned.radius.sum()):
        return _halved(piece, int(np.argmax(_width(piece))))
    if int(np.argmax(pull)) == OMEGA:
        return _finer(piece, bad)
    return _halved(piece, int(np.argmax(np.where(piece.high > piece.low, pull[:6], -1.0))))


def _finer(piece: Piece, bad: Array) -> list[Piece]:
    """The same box with some of its arcs halved; the cell as well where that was done before."""
    if piece.depth % 3 == 2:
        return _halved(piece, int(np.argmax(_width(piece)[:2])))
    middle = 0.5 * (piece.edges[:-1] + piece.edges[1:])[bad]
    edges = np.sort(np.concatenate([piece.edges, middle]))
    return [Piece(piece.leaf, piece.low, piece.high, piece.estimates, edges, piece.depth + 1)]


def _halved(piece: Piece, k: int, deeper: int = 1) -> list[Piece]:
    middle = 0.5 * (piece.low[k] + piece.high[k])
    upper, lower_ = piece.low.copy(), piece.high.copy()
    upper[k] = lower_[k] = middle
    return [
        Piece(piece.leaf, piece.low, lower_, piece.estimates, piece.edges, piece.depth + deeper),
        Piece(piece.leaf, upper, piece.high, piece.estimates, piece.edges, piece.depth + deeper),
    ]


def _width(piece: Piece) -> Array:
    width = piece.high - piece.low
    width[0] /= piece.low[0]
    return width * [4.0, 4.0, 2.0, 2.0, 1.0, 1.0]


def _crossing(conditions: tuple[Polynomial, ...], k: int) -> Polynomial:
    """The condition that is nearest to being broken everywhere in a box."""
    bounds = [float(lower(x)[k] / max(float(x.off[k]), 1e-300)) for x in conditions]
    return conditions[int(np.argmax(bounds))].take(np.array([k]))


def _widest(piece: Piece, condition: Polynomial) -> int:
    """The coordinate by which a condition varies most."""
    pull = np.zeros(6)
    for row in condition.rows:
        for variable, n in enumerate(condition.space.exponents[row][:6]):
            if n:
                pull[variable] += float(np.abs(condition.c[row, 0]))
    pull = np.where(piece.high > piece.low, pull, -1.0)
    return int(np.argmax(pull if pull.max() > 0.0 else _width(piece)))
