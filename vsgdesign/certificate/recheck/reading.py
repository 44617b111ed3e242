"""What a proof's file says, read without the code that wrote it, and whether its boxes and arcs cover region and
circle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from vsgdesign.artifacts.proof_file import CUTS, LEFT, PROVED, ProofFile, unpacked
from vsgdesign.certificate.recheck.loops import SINGLE, Loops
from vsgdesign.equations.frames import PHASES
from vsgdesign.runtime.guards import settings_of

Array = Any

_CLOSE = 1e-9
"""Relative to a limit, by which a box may miss it: more than rounding, and far less than a box."""


class NotCoveredError(ValueError):
    """Boxes or arcs that leave something out."""


@dataclass(frozen=True)
class Leaves:
    """All boxes of a proof: limits (N, 6), their symbol, the limits of their estimates (N, 4), and their share of the
    volume. ``cell`` (N,): where their arcs are in ``arcs``; −1 for none."""

    low: Array
    high: Array
    symbol: Array
    estimates: Array
    share: Array
    cell: Array
    arcs: tuple[Array, ...]
    block: Array
    """The number of the block of each, (N,)."""

    def __len__(self) -> int:
        return len(self.symbol)


def leaves_of(proof: ProofFile) -> tuple[Leaves, Array, Array]:
    """The boxes, and limits of those that the trees begin with and of their estimates, (R, 12) and (R, 4).

    Raises NotCoveredError where a tree does not come out even, a box has no arcs, or arcs do not reach around.
    """
    coarse = np.array(proof.coarse_arcs)
    found, roots, limits, arcs = [], [], [], []
    for number, block in enumerate(proof.blocks):
        arrays = unpacked(block)
        root, estimates = arrays["roots"], arrays["estimates"]
        sound = len(estimates) == len(root) and bool((root[:, :6] <= root[:, 6:]).all())
        if not (sound and (estimates[:, 0] <= estimates[:, 1]).all() and (estimates[:, 2] <= estimates[:, 3]).all()):
            raise NotCoveredError(f"block {number}: its roots are not boxes")
        low, high, symbol, own, depth, place = _unfolded(number, root, arrays["tree"])
        own_arcs = _arcs(number, arrays["cells"], arrays["arcs"], coarse)
        number_of = {key: len(arcs) + k for k, key in enumerate(own_arcs)}
        arcs += own_arcs.values()
        # Roots of one cell share their first two limits, and come one after another.
        edges = np.concatenate([[True], (np.diff(root[:, [0, 1, 6, 7]], axis=0) != 0.0).any(axis=1)])
        cell_of_root = np.cumsum(edges) - 1
        keys = np.column_stack([cell_of_root[own], depth[:, 0], place[:, 0], depth[:, 1], place[:, 1]])
        of = np.array([number_of.get(tuple(key), -1) for key in keys.tolist()])
        if ((symbol == PROVED) & (of < 0)).any():
            k = int(np.argmax((symbol == PROVED) & (of < 0)))
            raise NotCoveredError(f"block {number}: a proved box has no arcs ({_where(low[k], high[k])})")
        found.append((low, high, symbol, estimates[own], of, np.full(len(low), number)))
        roots.append(root)
        limits.append(estimates)
    if not found:
        raise NotCoveredError("the proof has no boxes")
    low, high, symbol, estimates, of, block = (np.concatenate([one[k] for one in found]) for k in range(6))
    every, every_estimates = np.concatenate(roots), np.concatenate(limits)
    share = np.where(high > low, high - low, 1.0).prod(axis=1)
    return Leaves(low, high, symbol, estimates, share / share.sum(), of, tuple(arcs), block), every, every_estimates


def _unfolded(number: int, root: Array, tree: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Limits, symbols and root of all leaves, and how their first two coordinates were halved."""
    low, high = root[:, :6].copy(), root[:, 6:].copy()
    own = np.arange(len(root))
    depth, place = (np.zeros((len(root), 2), dtype=np.int64) for _ in range(2))
    at, parts = 0, []
    while len(own):
        symbol = tree[at : at + len(own)]
        at += len(own)
        if len(symbol) < len(own) or (symbol > LEFT).any():
            raise NotCoveredError(f"block {number}: the tree of boxes is cut short or has a symbol that is none")
        leaf = symbol >= CUTS
        parts.append((low[leaf], high[leaf], symbol[leaf], own[leaf], depth[leaf], place[leaf]))
        low, high, own, depth, place = (np.repeat(v[~leaf], 2, axis=0) for v in (low, high, own, depth, place))
        cut = np.repeat(symbol[~leaf], 2).astype(np.intp)
        rows, upper = np.arange(len(cut)), np.arange(len(cut)) % 2 == 1
        middle = 0.5 * (low[rows, cut] + high[rows, cut])
        low[rows[upper], cut[upper]] = middle[upper]
        high[rows[~upper], cut[~upper]] = middle[~upper]
        grid = cut < 2
        depth[rows[grid], cut[grid]] += 1
        place[rows[grid], cut[grid]] = 2 * place[rows[grid], cut[grid]] + upper[grid]
    if at != len(tree):
        raise NotCoveredError(f"block {number}: the tree of boxes has {len(tree) - at} symbols too many")
    return tuple(np.concatenate([part[k] for part in parts]) for k in range(6))  # type: ignore[return-value]


def _arcs(number: int, cells: Array, halvings: Array, coarse: Array) -> dict[tuple[int, ...], Array]:
    """The edges of the arcs of each cell: every arc of the beginning, halved until it is used up."""
    found, at = {}, 0
    for cell in cells.tolist():
        edges = [coarse[0]]
        for a, b in pairwise(coarse):
            done = 0.0
            while done < 1.0:
                if at == len(halvings):
                    raise NotCoveredError(f"block {number}: an arc is missing")
                done += 0.5 ** int(halvings[at])
                at += 1
                if done > 1.0:
                    raise NotCoveredError(f"block {number}: arcs do not end where the next one begins")
                edges.append(a + (b - a) * done)
        found[tuple(cell)] = np.array(edges)
    if at != len(halvings):
        raise NotCoveredError(f"block {number}: there are {len(halvings) - at} arcs too many")
    return found


def check_covered(loops: Loops, proof: ProofFile, roots: Array, estimates: Array) -> None:
    """Whether the boxes that the trees begin with hold every grid, estimate and power of the region, and the arcs half
    of the circle. Raises NotCoveredError."""
    region = loops.region
    if proof.coarse_arcs[0] != 0.0 or proof.coarse_arcs[-1] < np.pi / loops.inner.T:
        raise NotCoveredError(f"the arcs end at {proof.coarse_arcs[-1]:.6g} rad/s, before the half circle does")
    low, high = roots[:, :6], roots[:, 6:]
    grids = (1.0 / region.scr[1], 1.0 / region.scr[0]), tuple(np.arctan(region.x_over_r))
    _rectangle(low[:, :2], high[:, :2], grids, "grids")
    for cell in np.unique(roots[:, [0, 1, 6, 7]], axis=0):
        own = (roots[:, [0, 1, 6, 7]] == cell).all(axis=1)
        powers = _powers(loops, cell)
        for k, (least, most) in zip((4, 5), powers, strict=True):
            if (low[own, k] > least + _CLOSE).any() or (high[own, k] < most - _CLOSE).any():
                raise NotCoveredError(f"powers beyond {low[own, k].max():.4g} to {high[own, k].min():.4g} are left out")
        ball, most = loops.ball, region.largest_error
        if ball is not None:  # the others are those of the ball
            if (low[own, 2:4] != ball.middle).any() or (high[own, 2:4] != ball.middle).any():
                raise NotCoveredError(f"the errors of the middle are not {ball.middle:.4g}")
        elif (low[own, 2:4] > -most + _CLOSE).any() or (high[own, 2:4] < most - _CLOSE).any():
            raise NotCoveredError(f"errors beyond {high[own, 2:4].min():.4g} are left out")
        e, e_Z = region.error, region.error_Z
        for one, two in ((np.cos(cell[1]), np.cos(cell[3])), (np.sin(cell[1]), np.sin(cell[3]))):
            if e_Z and (e * one - e_Z) * (e * two - e_Z) < -_CLOSE:
                raise NotCoveredError("a cell of grids has both kinds of errors")
        if loops.table is not None:
            _check_estimates(loops, cell, estimates[own])


def _powers(loops: Loops, cell: Array) -> Iterator[tuple[float, float]]:
    """Between which p and q of a cell (first coordinate and angle, then their ends) lie where they count."""
    c, inner = loops.study.converter, loops.inner
    counted = [cell[0] / np.sin(cell[3]), cell[2] / np.sin(cell[1])] if inner.by_reactance else [cell[0], cell[2]]
    # A grid carries at most 3V²/(1.3 |Z|), and its path is no shorter than |Z| at the grid's frequency.
    most = PHASES / 1.3 / min(inner.omega / inner.omega_n, 1.0)
    for power in (loops.region.P, loops.region.Q):
        every = [
            value * size * inner.Z_base / V**2 for value in power for size in counted for V in c.V_limits_rms
        ]  # fmt: skip
        yield max(min(every), -most), min(max(every), most)


def _rectangle(low: Array, high: Array, limits: Any, what: str) -> None:
    """Whether rectangles (N, 2) hold everything between limits. Raises NotCoveredError."""
    cuts = []
    for k, (least, most) in enumerate(limits):
        slack = _CLOSE * max(abs(least), abs(most), 1e-3)
        edges = np.unique(np.concatenate([low[:, k], high[:, k], [least, most]]))
        edges = edges[(edges >= least) & (edges <= most)]
        wide = np.diff(edges) > slack
        cuts.append(0.5 * (edges[1:] + edges[:-1])[wide] if wide.any() else np.array([0.5 * (least + most)]))
    for at in np.stack(np.meshgrid(*cuts, indexing="ij"), axis=-1).reshape(-1, 2):
        slack = _CLOSE * np.maximum(np.abs(at), 1e-3)
        if not ((low <= at + slack) & (at - slack <= high)).all(axis=1).any():
            raise NotCoveredError(f"no box holds the {what} at {at[0]:.6g}, {at[1]:.6g}")


def _check_estimates(loops: Loops, cell: Array, limits: Array) -> None:
    """Whether pieces of estimates (N, 4) hold all that belong to the grids of a cell, those beyond the scheduler's
    limits drawn to their edge. Raises NotCoveredError."""
    table = loops.table
    if table is None:
        return
    box, e = settings_of(table), loops.region.largest_error
    axes = (1.0 / box.scr[1], 1.0 / box.scr[0]), box.r_over_x
    asked = []
    reach = _reach(loops, np.array([*cell[:2], -e, -e]), np.array([*cell[2:], e, e]))
    for k, (own_reach, axis, nodes) in enumerate(zip(reach, axes, _nodes(loops), strict=True)):
        own = limits[:, 2 * k : 2 * k + 2]
        edges = np.where(np.isinf(own), own[:, ::-1], own)
        drawn = np.isinf(own).any(axis=1)
        ends = np.where(np.isinf(own[:, 0]), axis[0], axis[1])
        if (np.abs(edges[:, 0] - ends)[drawn] > _CLOSE * ends[drawn]).any():
            raise NotCoveredError("estimates are drawn to an edge that is not the scheduler's")
        least, most = max(axis[0], nodes[0]) * (1.0 - SINGLE), min(axis[1], nodes[-1]) * (1.0 + SINGLE)
        if (edges < least).any() or (edges > most).any():
            raise NotCoveredError("a piece of estimates lies beyond the scheduler's limits or the table")
        # With an error of |Z| the statement is about the estimates within the limits.
        inside = max(own_reach[0], axis[0]), min(own_reach[1], axis[1])
        asked.append(inside if loops.region.error_Z else own_reach)
    if all(least <= most for least, most in asked):
        _rectangle(limits[:, [0, 2]], limits[:, [1, 3]], asked, "estimates")


def _nodes(loops: Loops) -> tuple[Array, Array]:
    """Of a table, in the first coordinate of the estimates and in R̂/X̂."""
    table = loops.table
    return (np.zeros(0), np.zeros(0)) if table is None else (1.0 / table.scr[::-1], 1.0 / table.x_over_r[::-1])


def cells_of_table(loops: Loops, low: Array, high: Array, estimates: Array) -> Array:
    """The limits (4,) of a box's estimates cut at the nodes of the table, (M, 4): those cells that the estimates of the
    box, between limits (6,), may lie in."""
    if loops.table is None:
        return estimates[None]
    parts: list[list[tuple[float, float]]] = []
    for k, (reach, nodes) in enumerate(zip(_reach(loops, low, high), _nodes(loops), strict=True)):
        least, most = estimates[2 * k : 2 * k + 2].tolist()
        cuts = [] if np.isinf([least, most]).any() else [node for node in nodes.tolist() if least < node < most]
        slack = _CLOSE * max(abs(reach[0]), abs(reach[1]))
        every = pairwise([least, *cuts, most])
        parts.append([(a, b) for a, b in every if reach[0] - slack <= b and a <= reach[1] + slack])
    return np.array([(*one, *other) for one in parts[0] for other in parts[1]]).reshape(-1, 4)


def _reach(loops: Loops, low: Array, high: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """Between which first coordinates and R̂/X̂ the estimates of grids and errors between limits lie, which begin with
    those of a box."""
    e, e_Z, largest = loops.region.error, loops.region.error_Z, loops.region.largest_error
    R, X = (np.cos(high[1]), np.cos(low[1])), (np.sin(low[1]), np.sin(high[1]))
    hats = []
    for value, k in ((R, 2), (X, 3)):
        by_size = bool(e_Z) and e * (value[0] + value[1]) < 2.0 * e_Z
        a, b = (0.0, e_Z / largest) if by_size else (e / largest if e_Z else 1.0, 0.0)
        hats.append([v * (1.0 + a * c) + b * c for v, c in zip(value, (low[k], high[k]), strict=True)])
    R_hat, X_hat = hats
    slopes = min(r / x for r in R_hat for x in X_hat), max(r / x for r in R_hat for x in X_hat)
    if not e_Z:
        # At given errors a size of the estimate only rises or only falls from one end of the angles to the other.
        ends = [[_first_of(loops, side, angle) for angle in (low[1], high[1])] for side in (low, high)]
        return (min(ends[0]), max(ends[1])), slopes
    sizes = [first / (sine if loops.inner.by_reactance else 1.0) for first in (low[0], high[0]) for sine in X]
    if loops.estimate_by_reactance:
        first = X_hat
    else:
        first = [np.hypot(max(R_hat[0], 0.0), X_hat[0]), np.hypot(max(-R_hat[0], R_hat[1]), X_hat[1])]
    return (float(first[0] * min(sizes)), float(first[1] * max(sizes))), slopes


def _first_of(loops: Loops, place: Array, angle: float) -> float:
    """The first coordinate of an estimate with the relative errors of a place, of a grid with its first coordinate and
    an angle."""
    size = place[0] / np.sin(angle) if loops.inner.by_reactance else place[0]
    R, X = np.cos(angle) * (1.0 + place[2]), np.sin(angle) * (1.0 + place[3])
    return float(size * (X if loops.estimate_by_reactance else np.hypot(R, X)))


def _where(low: Array, high: Array) -> str:
    return (
        f"SCR {1.0 / high[0]:.4g} to {1.0 / low[0]:.4g}, X/R {np.tan(low[1]):.4g} to {np.tan(high[1]):.4g}, "
        f"p {low[4]:.3g} to {high[4]:.3g}, q {low[5]:.3g} to {high[5]:.3g}"
    )


where = _where
