"""What the controllers of many runs are told of their grids over time: late, and wrong."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.simulation.feeds import Told, told_of
from vsgdesign.simulation.lanes.cases import LaneCases, study_of_case
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.grid import GridEstimate
from vsgdesign.study.parameters.study import Study

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
        self.silent_since = np.full(len(self.R_g), np.nan)
        """s, (N,); NaN where a grid is told."""

    def move_to(self, now_s: float) -> None:
        """Moves on to an instant of the run."""
        told = self._told
        while len(lanes := np.flatnonzero(self._next <= now_s)):
            column = self._column[lanes] + 1
            start, self._column[lanes] = self._next[lanes], column
            self._next[lanes] = told.starts[lanes, column + 1]
            self.R_g[lanes], self.L_g[lanes] = told.R_g[lanes, column], told.L_g[lanes, column]
            since = self.silent_since[lanes]
            since = np.where(np.isnan(since), start, since)
            self.silent_since[lanes] = np.where(told.silent[lanes, column], since, np.nan)

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


def told_grids(study: Study, cases: LaneCases) -> ToldGrids:
    """What the controllers of the cases are told.

    An estimate is R_g (1 + error_R) and L_g (1 + error_X) at all times. From a change of the grid or its source on
    there is none for ``silent_s``; if the next change comes before it, the silence goes on from there.
    """
    if cases.networks is not None and max(map(len, cases.networks), default=0) > 1:
        return ToldGrids.of([_told_with_network(study, cases, k) for k in range(len(cases))])
    events, count = cases.events, len(cases)
    error_R, error_L = 1.0 + cases.error_R, 1.0 + cases.error_X
    shape = count, 2 + 2 * events.count
    starts, R_told, L_told = np.full(shape, np.inf), np.full(shape, np.nan), np.full(shape, np.nan)
    starts[:, 0], R_told[:, 0], L_told[:, 0] = -np.inf, cases.R_g * error_R, cases.L_g * error_L
    of_grid = np.isfinite(events.R_g) | np.isfinite(events.V_g_rms) | np.isfinite(events.omega_g)
    of_grid |= events.phase_jump != 0.0
    changes = np.where(of_grid, events.t_s, np.inf)
    following = np.full((count, events.count), np.inf)
    for k in range(events.count - 2, -1, -1):
        following[:, k] = np.minimum(changes[:, k + 1], following[:, k + 1])
    R_g, L_g = cases.R_g, cases.L_g
    for k in range(events.count):
        changed = np.isfinite(events.R_g[:, k])
        R_g, L_g = np.where(changed, events.R_g[:, k], R_g), np.where(changed, events.L_g[:, k], L_g)
        answer = changes[:, k] + cases.silent_s
        answer = np.where(answer < following[:, k], answer, np.inf)
        starts[:, 1 + 2 * k], starts[:, 2 + 2 * k] = changes[:, k], answer
        R_told[:, 2 + 2 * k], L_told[:, 2 + 2 * k] = R_g * error_R, L_g * error_L
    order = np.argsort(starts, axis=1, kind="stable")
    return ToldGrids(*(np.take_along_axis(values, order, axis=1) for values in (starts, R_told, L_told)))


def _told_with_network(study: Study, cases: LaneCases, k: int) -> Told:
    """What one controller is told where load, fault or breaker change."""
    errors = float(cases.error_R[k]), float(cases.error_X[k])
    knows = GridEstimate(error_R=errors[0], error_X=errors[1], silent_s=float(cases.silent_s[k]))
    own = study_of_case(study, cases, k, 1)
    return told_of(own, knows, build_timeline(own))
