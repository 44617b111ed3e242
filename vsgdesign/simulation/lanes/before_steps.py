"""The runs of a part before their steps: up to there a run and its twin are the same, and the runs go alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import Program, aligned_zeros
from vsgdesign.simulation.lanes.part import Part

Array = NDArray[np.float64]


def mains_alone(part: Part) -> Part:
    """The runs of a part whose twins are beside them, alone and from their beginning on. Nothing of them is logged."""
    alone, width = part.apart(), part.spec.width
    alone.count, alone.beside, alone.mains = len(part) // 2, False, slice(None)
    alone.cases, alone.index, alone.ends = part.cases.take(np.arange(0, len(part), 2)), part.index[::2], part.ends[::2]
    groups = -(-alone.count // width)
    alone.rows = aligned_zeros((groups, part.rows.shape[1], width))
    alone.put(0, of_runs(part.rows)[:, : len(part) : 2])
    alone.program = _program_alone(part.program, width, groups)
    alone.slots, others = None, [one for one in part.cut if one.lane % 2 == 0]
    alone.cut_only([one._replace(lane=one.lane // 2) for one in others])
    alone.feed = None if part.feed is None else part.feed.alone(alone)
    return alone


def put_beside(part: Part, alone: Part) -> None:
    """Lets each run of a part, and its twin, be where the runs alone are."""
    part.put(0, np.repeat(of_runs(alone.rows)[:, : len(alone)], 2, axis=1))


def of_runs(rows: Array) -> Array:
    """Numbers (G, R, L) by run, (R, G·L)."""
    return rows.swapaxes(0, 1).reshape(rows.shape[1], -1)


def in_groups(rows: Array, groups: int, width: int) -> Array:
    """Numbers (G, R, L) in other groups of other runs side by side, (groups, R, width)."""
    return of_runs(rows)[:, : groups * width].reshape(-1, groups, width).swapaxes(0, 1)


def _program_alone(program: Program, width: int, groups: int) -> Program:
    """The records of every second run."""
    run = np.repeat(np.arange(len(program.done)), np.diff(program.first)) * width + program.lane
    kept = np.flatnonzero(run % 2 == 0)
    group, lane = np.divmod(run[kept] // 2, width)
    order = np.lexsort((program.at[kept], group))
    first = np.searchsorted(group[order], np.arange(groups + 1)).astype(np.int64)
    parts = {name: getattr(program, name)[kept][order] for name in ("at", "row", "count", "source")}
    return Program(first=first, lane=lane[order], values=program.values, done=first[:-1].copy(), **parts)
