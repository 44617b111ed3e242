"""Updates of a gain table's schedulers for all runs that go side by side."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import Loop, empty_rows
from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.power_loops import PowerLoopGains, References, gain_transfer
from vsgdesign.equations.scheduler_data import (
    NO_ESTIMATE,
    NO_REASON,
    TOLD_LIMITED,
    TOLD_SURPRISED,
    ScheduleLaw,
    SchedulerInput,
    SchedulerLimits,
    SchedulerState,
    ScheduleTable,
    grid_at,
)
from vsgdesign.equations.scheduling import told_and_updated
from vsgdesign.runtime.scheduler import Scheduler
from vsgdesign.runtime.updating import GainLookup
from vsgdesign.simulation.batch import Batch
from vsgdesign.simulation.compiled_schedulers import compiled_once, uniform_of
from vsgdesign.simulation.feeds import ToldGrids, ToldNow
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.run_state import RunState

Array = NDArray[np.float64]

_GAINS = len(PowerLoopGains._fields)


def update_of_run(
    table: ScheduleTable,
    limits: SchedulerLimits,
    s: SchedulerState,
    given: SchedulerInput,
    limited: Any,
    limited_before: Any,
    omega_i: Any,
    refs: References,
    law: ScheduleLaw,
) -> tuple[SchedulerState, Any, Any, Any]:
    """What a late schedule of a table does at an update (:meth:`vsgdesign.simulation.feeds.LateSchedule.update`).

    ``limited`` and ``limited_before``: in how many samples the run has limited its current, now and at the update
    before. The frequency at which the integrator would rest stays (:eq:`gain-transfer`); ``refs`` are those of the
    sample before. Returns (following, moved, R_g, L_g): the state, omega_i with the new gains, and the grid that they
    are for.
    """
    was_limited = TOLD_LIMITED if limited > limited_before else 0
    surprised = TOLD_SURPRISED if given.said == NO_ESTIMATE else 0
    following, _, _ = told_and_updated(table, limits, s, was_limited | surprised, given, law)
    moved = gain_transfer(omega_i, refs, s.gains, following.gains)
    R_g, L_g = grid_at(table, following.scr, following.r_over_x, law)
    return following, moved, R_g, L_g


def updates_of(runs: Sequence[RunState], batch: Batch) -> UpdatesTogether | None:
    """The updates of runs that are at their starts; None where each makes its own (:attr:`.RunState.late`)."""
    schedulers = [run.late.runtime for run in runs if run.late is not None]
    found = [one for one in schedulers if one is not None]
    return UpdatesTogether(runs, batch, found) if len(found) == len(runs) else None


class UpdatesTogether:
    """The updates of all runs of a batch at once. Their numbers lie as those of the runs do: (G, rows, L)."""

    def __init__(self, runs: Sequence[RunState], batch: Batch, schedulers: Sequence[Scheduler]) -> None:
        first = schedulers[0]
        self._runs, self._batch, self._T_s = runs, batch, runs[0].T_s
        self._every, self._tick = runs[0].feed.leave_updates(), first.settings.tick
        loop = _update(first.lookup, batch.build.lanes, batch.build.vectors)
        place = {name: at for at, name in enumerate(loop.spec.rows)}
        self._place = place
        self._rows = empty_rows(loop.spec, len(batch.rows))
        self._found = np.empty((len(self._rows), 1, len(loop.spec.logged), loop.spec.width))
        self._loop = loop.standing(self._rows, uniform_of(loop, first.settings.limits), log=self._found, every=1)
        self._numbers = len(numbers_of(first.present))
        """So many has a state; they are the first rows and the first that is found."""
        seen = {"given.P": "state.P_f", "given.Q": "state.Q_f", "given.V_rms": "state.V", "limited": "limited"}
        seen |= {"omega_i": "state.omega_i"} | {f"refs.{name}": f"refs.{name}" for name in References._fields}
        seen = {name: of_run for name, of_run in seen.items() if name in place}
        self._seen = np.array([place[name] for name in seen]), np.array([batch.place[name] for name in seen.values()])
        found = {name: at for at, name in enumerate(loop.spec.logged)}
        put = {f"power_gains.{name}": found[f"following.gains.{name}"] for name in PowerLoopGains._fields}
        put |= {"state.omega_i": found["moved"], "grid.R_g": found["R_g"], "grid.L_g": found["L_g"]}
        put = {name: at for name, at in put.items() if name in batch.place}
        self._put = np.array([batch.place[name] for name in put]), np.array(list(put.values()))
        for number, one in enumerate(schedulers):
            group, lane = batch.lane(number)
            self._rows[group, : self._numbers, lane:] = np.array(numbers_of(one.present))[:, None]
        self._given: list[tuple[int, Array]] = []
        """The sample of each update, and the gains since then, (G, 8, L)."""

    def hear(self) -> None:
        """What the runs are told follows what they have found."""
        told = ToldGrids.of([run.late.told for run in self._runs if run.late is not None])
        groups, _, width = self._rows.shape
        self._now = ToldNow(told.take(np.minimum(np.arange(groups * width), len(self._runs) - 1)))
        self._tell()

    def _tell(self) -> None:
        """What is told now."""
        now, shape = self._now, self._rows[:, 0].shape
        said = np.where(now.silent, NO_ESTIMATE, NO_REASON), *np.nan_to_num([now.R_g, now.L_g])
        for name, values in zip(("said", "R_g", "L_g"), said, strict=True):
            self._rows[:, self._place[f"given.{name}"]] = values.reshape(shape)

    def marks(self, end: int) -> range:
        """The samples before which there is an update, up to the end."""
        return range(self._every, end, self._every)

    def make(self, sample: int) -> None:
        """The update before a sample, if there is one. References of the samples before belong to the gains before."""
        if sample == 0 or sample % self._every:
            return
        if self._now.move_to(sample * self._T_s - 0.5 * self._T_s):  # what coincides with an update is seen by the next
            self._tell()
        rows, found, of_runs, place = self._rows, self._found, self._batch.rows, self._place
        rows[:, place["limited_before"]] = rows[:, place["limited"]]
        rows[:, self._seen[0]] = of_runs[:, self._seen[1]]
        rows[:, place["given.ticks"]] = round(sample * self._T_s / self._tick) & 0xFFFFFFFF
        self._loop(0, 1)
        rows[:, : self._numbers] = found[:, 0, : self._numbers]
        of_runs[:, self._put[0]] = found[:, 0, self._put[1]]
        self._given.append((sample, rows[:, self._numbers - _GAINS : self._numbers].copy()))

    def hand_over(self) -> None:
        """Gives each run the gains that it has had."""
        for number, run in enumerate(self._runs):
            group, lane = self._batch.lane(number)
            changes = run.feed.changes
            for sample, gains in self._given:
                found = PowerLoopGains(*gains[group, :, lane].tolist())
                if sample < run.ended and found != changes[-1].gains:
                    changes.append(GainChange(sample * self._T_s, found))


@functools.lru_cache(maxsize=16)
def _update(lookup: GainLookup, lanes: int, vectors: int) -> Loop:
    return compiled_once(update_of_run, {"table": lookup.table, "law": lookup.functions}, lanes, vectors)
