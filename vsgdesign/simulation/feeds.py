"""The gains that a run of a controller is given, and what controllers are told of their grids, alone and side by
side."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.identification import estimator_kind
from vsgdesign.linear.stability.maps import GainLaw
from vsgdesign.linear.stability.safe_place import closed_form_place
from vsgdesign.runtime.guards import SchedulerSettings, settings_of
from vsgdesign.runtime.of_study import follows_measured
from vsgdesign.runtime.scheduler import Scheduler
from vsgdesign.simulation.estimated import EstimatedScheduler
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.following import KnownFirst, KnownGridScheduler, MeasuredPowers, ScheduledAnswers
from vsgdesign.simulation.gains import GainChange, gain_changes
from vsgdesign.simulation.online import OnlineScheduler
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.grid import Grid, GridEstimate, Place
from vsgdesign.study.parameters.study import UPDATE_PERIOD, ControllerSpec, Study


def feed_of(
    study: Study, spec: ControllerSpec, timeline: Timeline, ready: Ready, known: KnownFirst | None = None
) -> EstimatedScheduler | FieldScheduler | OnlineScheduler | tuple[GainChange, ...]:
    """The gains that a run of a controller is given, or the scheduler that is asked for them. ``study`` has the
    controller's current limit. ``known``: first gains of this controller of this converter that are known, which get
    those of this run. Raises InfeasibleStudyError where there are no gains on a grid of the scenario."""
    if spec.estimate == "truth":
        return gain_feed(study, spec, timeline, ready, known)
    kind = FieldScheduler if estimator_kind(spec.estimate).by_sample else EstimatedScheduler
    return kind(study, spec, ready)


STALE_S = SchedulerSettings.stale_ticks * SchedulerSettings.tick
"""Time without an answer from which on gains are those of a safe place, s: as a table's scheduler has it."""


Told = Sequence[tuple[float, Grid | None]]
"""(s, grid) from each instant on; None where the estimator gives no answer. The first entry is a grid, at t = 0."""


def knowledge_of(spec: ControllerSpec, timeline: Timeline) -> GridEstimate | None:
    """How late and with which error a controller is told its grid; None if it always knows the true one.

    While the breaker is open, a schedule gets no answer, even if it has no error or delay of its own.
    """
    if spec.knowledge is None and spec.kind == "scheduled" and timeline.islanded:
        return GridEstimate()
    return spec.knowledge


def gain_feed(
    study: Study, spec: ControllerSpec, timeline: Timeline, ready: Ready = NOTHING, known: KnownFirst | None = None
) -> tuple[GainChange, ...] | OnlineScheduler:
    """The gains of a run for a controller without an estimator: changes that are known beforehand, or a scheduler that
    follows the grid that it is told and the measured values. Raises InfeasibleStudyError if there are no gains."""
    knowledge = knowledge_of(spec, timeline)
    if knowledge is not None:
        told, safe = told_of(study, knowledge, timeline), safe_grid(study, spec, ready)
        return LateSchedule(study, spec, told, ready, safe=safe, known=known)
    if follows_measured(spec):
        return KnownGridScheduler(study, spec, timeline, ready)
    return gain_changes(study, spec, timeline)


def safe_grid(study: Study, spec: ControllerSpec, ready: Ready = NOTHING) -> Grid | None:
    """The grid whose gains a schedule takes once its estimate is stale (:eq:`safe-place`): that of the settings of its
    table's scheduler, or the safe place of its closed form.

    None for fixed gains, and for a closed form without a specification: it goes on with what it was told last.
    """
    if spec.kind == "fixed":
        return None
    table = ready.table(spec)
    if table is None:
        place = closed_form_place(study, spec)
        return None if place is None else place.grid(study.converter)
    settings = settings_of(table)
    return Place(settings.safe_scr, 1.0 / settings.safe_r_over_x, table.base.scr_basis).grid(study.converter)


def told_of(study: Study, knowledge: GridEstimate, timeline: Timeline) -> Told:
    """What a controller with this knowledge is told over a run.

    It is told nothing for a time after each event that changes the grid or its source. The end of a ramp is not such an
    event. If the next event comes before an answer, this time begins again. While the breaker is open, it is told
    nothing. In a run that begins with an open breaker, the first grid is the one behind the breaker.
    """
    told: list[tuple[float, Grid | None]] = [(0.0, knowledge.of(timeline.grid_at(0.0)))]
    if not timeline.network_at(0.0).connected:
        told.append((0.0, None))
    instants = sorted({event.t_s for event in study.events if event.of_grid and event.t_s > 0.0})
    for k, instant in enumerate(instants):
        told.append((instant, None))
        if not timeline.network_at(instant).connected:
            continue
        answer_s = instant + knowledge.silent_s
        if k + 1 == len(instants) or answer_s < instants[k + 1]:
            told.append((answer_s, knowledge.of(timeline.grid_at(instant))))
    return tuple(told)


def told_at(told: Told, t_s: float) -> tuple[Grid, bool]:
    """The last grid that was told up to an instant, and whether it is still told at this instant."""
    until = [grid for start_s, grid in told if start_s <= t_s]
    return [grid for grid in until if grid is not None][-1], until[-1] is not None


def as_told(law: GainLaw, spec: ControllerSpec) -> GainLaw:
    """The gains of a controller as a function of the true grid, where it knows its grid only with an error."""
    knowledge = spec.knowledge
    if knowledge is None:
        return law

    def of_true(R_g: Any, L_g: Any, P: Any, Q: Any, V_rms: Any) -> PowerLoopGains:
        return law(R_g * (1.0 + knowledge.error_R), L_g * (1.0 + knowledge.error_X), P, Q, V_rms)

    return of_true


class LateSchedule:
    """An online scheduler that is told of the grid what an estimator says, which may be late and wrong.

    The first grid of ``told`` is that for which the run starts. Without an answer a table's scheduler holds its place
    and its age grows, as in the field. A closed form goes on with the grid that it was told last, and after ``stale_s``
    with the grid ``safe``, if there is one. The object has a state, so it serves one run at a time.
    """

    powers_alone = True

    def __init__(
        self,
        study: Study,
        spec: ControllerSpec,
        told: Told,
        ready: Ready = NOTHING,
        *,
        safe: Grid | None = None,
        stale_s: float = STALE_S,
        known: KnownFirst | None = None,
    ) -> None:
        if not told or told[0][0] > 0.0 or told[0][1] is None:
            raise ValueError("told: the first entry must be a grid, at or before t = 0.")
        self._answers, self._known = ScheduledAnswers(study, spec, ready), known
        self._spec = spec
        self._take(told)
        self._first: Grid = told[0][1]
        self._safe, self._stale_s = safe, stale_s
        self._holds = spec.schedule == "table"
        self._follows = follows_measured(spec)
        self._period = ready.update_period(spec) or UPDATE_PERIOD
        self._T_s = study.converter.T_s

    def _take(self, told: Told) -> None:
        self._starts, self._grids = [t_s for t_s, _ in told], [grid for _, grid in told]

    def hear(self, study: Study, timeline: Timeline) -> None:
        """The events of the run are these from now on."""
        knowledge = knowledge_of(self._spec, timeline)
        if knowledge is not None:
            self._take(told_of(study, knowledge, timeline))

    @property
    def update_period(self) -> float:
        """That of the controller, s."""
        return self._period

    @property
    def sample_interval(self) -> float:
        """One row a window: nothing is looked at but the powers at its end."""
        return self._period

    @property
    def told(self) -> Told:
        """What it is told over the run."""
        return tuple(zip(self._starts, self._grids, strict=True))

    @property
    def runtime(self) -> Scheduler | None:
        """The scheduler of a table; None for a closed form."""
        return self._answers.runtime

    @property
    def answers_after(self) -> tuple[float, ...] | None:
        """The instants (s) after which the next update may give other gains than the one before; None: every update
        may. What a closed form is told is known beforehand, and so is when it is stale."""
        if self._holds or self._follows:
            return None
        silent = zip(self._starts, self._grids, strict=True)
        return (*self._starts, *(t_s + self._stale_s for t_s, grid in silent if grid is None))

    @property
    def grid(self) -> Grid:
        """The grid that the present gains are for."""
        return self._answers.grid

    def first_gains(self) -> PowerLoopGains:
        """Gains of the first grid that is told, in the steady state on the true one."""
        self._last = self._first
        return self._answers.first(self._first, before=self._known)

    def update(self, window: MeasuredPowers) -> PowerLoopGains | None:
        """Gains for what is told; an answer that coincides with the update is seen by the next one."""
        now = window.t_s - 0.5 * self._T_s
        k = max(bisect_right(self._starts, now) - 1, 0)
        grid = self._grids[k]
        if grid is None:
            if self._holds:
                return self._answers.to(window, math.nan, math.nan, surprised=True)[0]
            while k > 0 and self._grids[k - 1] is None:
                k -= 1
            stale = self._safe is not None and now - self._starts[k] >= self._stale_s
            grid = self._safe if stale and self._safe is not None else self._last
        elif not self._follows and grid == self._last:
            return None
        self._last = grid
        return self._answers.to(window, grid.R_g, grid.L_g)[0]


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
