"""What is known of a batch beforehand, as records of the loop's program: before which sample which rows change."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsgdesign.codegen.llvm import Program

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class ProgramWriter:
    """Collects records of lanes, in any order of time. Records of one lane and sample are done in the order in which
    they were added."""

    def __init__(self) -> None:
        self._parts: list[tuple[Index, Index, Index, Index, Index]] = []
        self._values: list[Array] = []
        self._size = 0

    def put(self, lane: ArrayLike, at: ArrayLike, row: int, values: Array) -> None:
        """Before sample ``at`` (n,) of a lane (n,), the rows from ``row`` on take values (n, count), or (n,)."""
        values = np.asarray(values, dtype=float)
        values = values[:, None] if values.ndim == 1 else values
        count = values.shape[1]
        source = self._size + count * np.arange(len(values))
        self._values.append(values.ravel())
        self._size += values.size
        self._add(lane, at, row, count, source)

    def copy(self, lane: ArrayLike, at: ArrayLike, row: int, count: int, origin: int) -> None:
        """Before sample ``at`` (n,) of a lane (n,), ``count`` rows from ``row`` on take those from ``origin`` on."""
        self._add(lane, at, row, count, np.full(np.shape(lane), -1 - origin))

    def _add(self, lane: ArrayLike, at: ArrayLike, row: int, count: int, source: Index) -> None:
        lane, at = np.asarray(lane, dtype=np.int64), np.asarray(at, dtype=np.int64)
        same = np.broadcast_to(np.int64(row), lane.shape), np.broadcast_to(np.int64(count), lane.shape)
        self._parts.append((lane, at, *same, source.astype(np.int64)))

    def program(self, groups: int, width: int) -> Program:
        """The program of so many groups of ``width`` lanes."""
        nothing = np.zeros(0, dtype=np.int64)
        parts = self._parts or [(nothing,) * 5]
        lane, at, row, count, source = (np.concatenate(values) for values in zip(*parts, strict=True))
        group = lane // width
        order = np.lexsort((np.arange(len(lane)), at, group))
        first = np.searchsorted(group[order], np.arange(groups + 1)).astype(np.int64)
        return Program(
            first=first,
            at=at[order],
            lane=(lane % width)[order],
            row=row[order],
            count=count[order],
            source=source[order],
            values=np.concatenate([np.zeros(0), *self._values]),
            done=first[:-1].copy(),
        )
