"""What controllers of runs side by side are told of their grids."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.simulation.feeds import Told

Array = NDArray[np.float64]


class ToldGrids(NamedTuple):
    """What N controllers are told: arrays (N, M) over the instants of each, as
    :class:`vsgdesign.simulation.feeds.LateSchedule` takes them.

    The first instant is −inf. Instants that are not used are inf and stand at the end; the last column is never used.
    """

    starts: Array
    """s of the run, ascending."""
    R_g: Array
    """Ω and H from the instant on. NaN: there is no estimate."""
    L_g: Array

    @property
    def silent(self) -> NDArray[np.bool_]:
        """Where there is no estimate."""
        return np.isnan(self.L_g)

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which instants there are."""
        return self.starts < np.inf

    def at_the_end(self) -> tuple[Array, Array, NDArray[np.bool_]]:
        """The last grid that is told (R_g in Ω, L_g in H), and whether nothing is told any more at the end."""
        columns = np.arange(self.starts.shape[1])
        last = np.where(self.used, columns, 0).max(axis=1)
        last_grid = np.where(self.used & ~self.silent, columns, 0).max(axis=1)
        rows = np.arange(len(last))
        return self.R_g[rows, last_grid], self.L_g[rows, last_grid], self.silent[rows, last]

    def take(self, chosen: NDArray[Any]) -> ToldGrids:
        """The same of some lanes."""
        return ToldGrids(*(values[chosen] for values in self))

    @classmethod
    def of(cls, said: Sequence[Told]) -> ToldGrids:
        """What each controller is told from which instants on, the first of which is at or before the start."""
        found = np.full((3, len(said), max(map(len, said), default=0) + 1), np.nan)
        found[0] = np.inf
        for lane, entries in enumerate(said):
            for k, (start_s, grid) in enumerate(entries):
                found[0, lane, k] = start_s if k else -np.inf
                if grid is not None:
                    found[1:, lane, k] = grid.R_g, grid.L_g
        return cls(*found)


class ToldNow:
    """What is told at an instant that only moves on."""

    def __init__(self, told: ToldGrids) -> None:
        self._told = told
        self._column = np.zeros(len(told.starts), dtype=np.int64)
        self._next = told.starts[:, 1].copy()
        self.R_g, self.L_g = told.R_g[:, 0].copy(), told.L_g[:, 0].copy()
        """Ω and H, (N,). NaN: nothing is told."""
        self._earliest = -np.inf
        """Nothing else is told before this instant."""
        self.silent_since = np.full(len(self.R_g), np.nan)
        """s, (N,); NaN where a grid is told."""

    def move_to(self, now_s: float) -> bool:
        """Moves on to an instant of the run. Returns whether anything else is told then."""
        told, moved = self._told, False
        if now_s < self._earliest:
            return False
        while len(lanes := np.flatnonzero(self._next <= now_s)):
            column, moved = self._column[lanes] + 1, True
            start, self._column[lanes] = self._next[lanes], column
            self._next[lanes] = told.starts[lanes, column + 1]
            self.R_g[lanes], self.L_g[lanes] = told.R_g[lanes, column], told.L_g[lanes, column]
            since = self.silent_since[lanes]
            since = np.where(np.isnan(since), start, since)
            self.silent_since[lanes] = np.where(told.silent[lanes, column], since, np.nan)
        self._earliest = float(self._next.min(initial=np.inf))
        return moved

    @property
    def silent(self) -> NDArray[np.bool_]:
        """Where nothing is told, (N,)."""
        return np.isnan(self.L_g)

    def take(self, chosen: NDArray[Any]) -> ToldNow:
        """The same of some lanes."""
        some = ToldNow(self._told.take(chosen))
        for name in ("_column", "_next", "R_g", "L_g", "silent_since"):
            setattr(some, name, getattr(self, name)[chosen])
        return some
