"""The gains of many runs over time: what their controllers are told of the grid, and what they make of it.

For each lane this is what a run of its own has: ``ListedGains`` of :func:`vsgdesign.simulation.gains.gain_changes` for
gains that are known beforehand, and ``OnlineGains`` of a ``KnownGridScheduler`` or a ``LateSchedule`` for those that
follow the measured powers. The windows, and the sample from which an answer acts, are the same.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.identification import estimator_kind
from vsgdesign.runtime.guards import SchedulerSettings
from vsgdesign.runtime.many import ManySchedulers
from vsgdesign.runtime.of_study import ControllerGains, follows_measured, gain_law
from vsgdesign.runtime.scheduler import scheduler_of
from vsgdesign.runtime.updating import GainLookup
from vsgdesign.simulation.compiled_schedulers import CompiledSchedulers
from vsgdesign.simulation.feeds import STALE_S, Told, ToldGrids, ToldNow, safe_grid, told_of
from vsgdesign.simulation.gains import whole_multiple
from vsgdesign.simulation.lanes.cases import LaneCases, study_of_case
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.grid import Grid, GridEstimate
from vsgdesign.study.parameters.study import UPDATE_PERIOD, ControllerSpec, Study

Array = NDArray[np.float64]
Whole = NDArray[np.int64]
ManyGainsOf = Callable[[Array, Array, Array], PowerLoopGains]
"""Function of P (W), Q (var) and V (phase rms, V) of the lanes that returns gains of arrays; NaN if there are none."""

NEVER = np.iinfo(np.int64).max
"""The sample of what never happens."""


class KnownChanges(NamedTuple):
    """Changes of gains that are known before the run, in the order of lane and sample: arrays (m,)."""

    lane: Whole
    sample: Whole
    """From which the gains act."""
    gains: PowerLoopGains
    R_g: Array
    """The grid for which they are made, Ω and H."""
    L_g: Array


class GainsAtRest(Protocol):
    """The gains of N lanes where they rest."""

    def first(self, P: Array, Q: Array, V_rms: Array) -> PowerLoopGains:
        """Gains from the start on, for the rest that they are part of (``gains_of`` of a rest); NaN: there are none."""
        ...

    def known_at_end(self) -> ManyGainsOf:
        """Gains once everything has come to rest after the last change."""
        ...


class Telling(GainsAtRest, Protocol):
    """The gains of N lanes over time. An object has a state, so it serves one run of its lanes."""

    @property
    def update_samples(self) -> int:
        """:meth:`update` is called at every whole multiple of so many samples; 0: never."""
        ...

    @property
    def changes(self) -> KnownChanges:
        """What changes without an update."""
        ...

    def update(
        self, sample: int, P: Array, Q: Array, V_rms: Array, limited: NDArray[Any] | None = None
    ) -> PowerLoopGains | None:
        """Gains from a sample on, arrays (N,), for the powers and the voltage that the power loops see in it.

        ``limited`` says in how many samples since the last update the current was limited; None: in none. None as the
        result means that the gains of no lane change.
        """
        ...

    def estimate(self) -> tuple[Array, Array]:
        """R_g (Ω) and L_g (H) of the grids that the present gains are for: what a current limiter is told."""
        ...

    def take(self, chosen: NDArray[Any]) -> Telling:
        """The same of some lanes, by index or by mask."""
        ...


def learns(spec: ControllerSpec) -> bool:
    """Whether a controller estimates its grid by itself, in every sample."""
    return spec.kind == "scheduled" and spec.estimate != "truth" and estimator_kind(spec.estimate).by_sample


def told_controller(spec: ControllerSpec) -> ControllerSpec:
    """The controller that is told its grid in place of an estimator of windows, which is not run. One that estimates in
    every sample runs as it is."""
    if spec.kind == "fixed" or spec.estimate == "truth" or learns(spec):
        return spec
    return replace(spec, estimate="truth", update_period=spec.update_period or UPDATE_PERIOD)


def telling(
    study: Study, spec: ControllerSpec, ready: Ready, cases: LaneCases, said: ToldGrids | None = None
) -> Telling:
    """The gains of a controller of the study in each of the cases.

    An estimator of windows is not run: its controller is told what the cases say, or what is ``said``. Raises
    InfeasibleStudyError if the update period is no whole number of samples, or a table is missing, and ValueError for a
    controller that learns its grid (:func:`learns`), which is told nothing.
    """
    if learns(spec):
        raise ValueError(f'estimate = "{spec.estimate}": this controller learns its grid and is told nothing.')
    law = gain_law(study, spec, ready)
    if spec.kind == "fixed":
        return _Fixed(study, spec, law, cases)
    T_s = study.converter.T_s
    period = ready.update_period(spec) or UPDATE_PERIOD
    every = whole_multiple(period, T_s, "update_period", "the controller's sampling period")
    told = told_grids(study, cases) if said is None else said
    updates = Updates(every, T_s, safe_grid(study, spec, ready))
    table = ready.table(spec)
    if table is not None:
        scheduler = scheduler_of(table)
        return _OfTable(scheduler.lookup, scheduler.settings, law, told, updates)
    if follows_measured(spec):
        return _Following(law, told, updates)
    exact = (cases.error_R == 0.0) & (cases.error_X == 0.0) & (cases.silent_s == 0.0) & (said is None)
    if cases.networks is not None:  # behind an open breaker nobody knows the grid
        exact &= np.array([all(network.connected for _, network in listed) for listed in cases.networks], dtype=bool)
    return _AtDesignPoint(law, told, exact, updates)


class Updates(NamedTuple):
    """The updates of a controller, at every whole multiple of ``every`` samples, and what it does in silence."""

    every: int
    T_s: float
    safe: Grid | None
    """The grid whose gains a closed form takes after a long silence; None: it goes on."""

    def instant(self, sample: Any) -> Any:
        """Up to when an update sees what is told, s: what coincides with it is seen by the next one."""
        return sample * self.T_s - 0.5 * self.T_s

    def first_that_sees(self, start_s: Array, after_s: float = 0.0) -> Whole:
        """The sample of the first update that lies at least ``after_s`` after an instant."""
        reach = np.where(np.isfinite(start_s), start_s, 0.0)
        number = np.maximum(np.floor((reach + after_s) / (self.every * self.T_s)), 1.0).astype(np.int64)
        for _ in range(2):
            number += self.instant(number * self.every) - reach < after_s
        return number * self.every

    def next_after(self, start_s: Array) -> Whole:
        """The sample of the first update after an instant, as :func:`vsgdesign.simulation.gains.gain_changes` has it
        for a controller that knows the grid."""
        reach = np.where(np.isfinite(start_s), start_s, 0.0)
        return (np.floor(reach / (self.every * self.T_s) + 1e-9).astype(np.int64) + 1) * self.every


class OfTrueGrid:
    """Gains of a controller that knows its grid, once it has learnt it."""

    def __init__(self, law: ControllerGains, cases: LaneCases) -> None:
        self._law, self._start = law, (cases.R_g, cases.L_g)
        R_g, L_g = cases.R_g.copy(), cases.L_g.copy()
        for k in range(cases.events.count):
            moved = np.isfinite(cases.events.R_g[:, k]) & np.isfinite(cases.events.t_s[:, k])
            R_g[moved], L_g[moved] = cases.events.R_g[moved, k], cases.events.L_g[moved, k]
        self.grid_at_end = R_g, L_g

    def first(self, P: Array, Q: Array, V_rms: Array) -> PowerLoopGains:
        return self._law(*self._start, P, Q, V_rms)

    def known_at_end(self) -> ManyGainsOf:
        return lambda P, Q, V_rms: self._law(*self.grid_at_end, P, Q, V_rms)


class _NeverAsked:
    """Gains that do not follow what is measured."""

    update_samples = 0

    def update(
        self, sample: int, P: Array, Q: Array, V_rms: Array, limited: NDArray[Any] | None = None
    ) -> PowerLoopGains | None:
        del sample, P, Q, V_rms, limited
        return None


class _Fixed(_NeverAsked):
    """Fixed gains."""

    def __init__(self, study: Study, spec: ControllerSpec, law: ControllerGains, cases: LaneCases) -> None:
        self._law = law
        if spec.gains is not None:  # given gains are made for no grid: a limiter is told the one of the start
            self._grid = cases.R_g, cases.L_g
        else:
            made_for = spec.design_grid or study.grid
            self._grid = np.full(len(cases), made_for.R_g), np.full(len(cases), made_for.L_g)

    @property
    def changes(self) -> KnownChanges:
        return _changes(self._law, [])

    def first(self, P: Array, Q: Array, V_rms: Array) -> PowerLoopGains:
        return self._law(*self._grid, P, Q, V_rms)

    def estimate(self) -> tuple[Array, Array]:
        return self._grid

    def known_at_end(self) -> ManyGainsOf:
        return self.first

    def take(self, chosen: NDArray[Any]) -> Telling:
        some = copy(self)
        some._grid = self._grid[0][chosen], self._grid[1][chosen]
        return some


class _AtDesignPoint(_NeverAsked):
    """A closed form at its design point: what is told decides alone, so every change is known before the run."""

    def __init__(self, law: ControllerGains, told: ToldGrids, exact: NDArray[np.bool_], updates: Updates) -> None:
        self._law, self._told, self._exact, self._updates = law, told, exact, updates

    @property
    def changes(self) -> KnownChanges:
        told, updates = self._told, self._updates
        seen = np.where(self._exact[:, None], updates.next_after(told.starts), updates.first_that_sees(told.starts))
        seen[:, 0] = 0
        seen[~told.used] = NEVER
        found, next_grid = [], np.full(len(seen), NEVER)
        for k in range(seen.shape[1] - 2, 0, -1):  # what is told between two updates is never seen
            grid, silent = told.used[:, k] & ~told.silent[:, k], told.used[:, k] & told.silent[:, k]
            visible = np.flatnonzero(grid & (seen[:, k] < seen[:, k + 1]))
            found.append((visible, seen[visible, k], told.R_g[visible, k], told.L_g[visible, k]))
            safe = updates.safe
            if safe is not None:
                stale = np.full(len(seen), NEVER)
                begins = np.flatnonzero(silent & ~told.silent[:, k - 1])
                stale[begins] = updates.first_that_sees(told.starts[begins, k], STALE_S)
                lanes = np.flatnonzero(stale < next_grid)
                R_safe, L_safe = np.full(len(lanes), safe.R_g), np.full(len(lanes), safe.L_g)
                found.append((lanes, stale[lanes], R_safe, L_safe))
            next_grid = np.where(grid, seen[:, k], next_grid)
        return _changes(self._law, found)

    def first(self, P: Array, Q: Array, V_rms: Array) -> PowerLoopGains:
        return self._law(*self.estimate(), P, Q, V_rms)

    def estimate(self) -> tuple[Array, Array]:
        """The grids of the start; those of the changes come with them."""
        return self._told.R_g[:, 0], self._told.L_g[:, 0]

    def known_at_end(self) -> ManyGainsOf:
        return _law_at_the_end(self._law, self._told, self._updates.safe)

    def take(self, chosen: NDArray[Any]) -> Telling:
        return _AtDesignPoint(self._law, self._told.take(chosen), self._exact[chosen], self._updates)


class _Following:
    """A closed form that follows the measured powers."""

    def __init__(self, law: ControllerGains, told: ToldGrids, updates: Updates) -> None:
        self._law, self._told, self._now, self._updates = law, told, ToldNow(told), updates
        self.update_samples = updates.every
        self._last = self._grid = told.R_g[:, 0], told.L_g[:, 0]
        self._gains: PowerLoopGains | None = None

    @property
    def changes(self) -> KnownChanges:
        return _changes(self._law, [])

    def first(self, P: Array, Q: Array, V_rms: Array) -> PowerLoopGains:
        self._gains = self._law(*self._grid, P, Q, V_rms)
        return self._gains

    def update(
        self, sample: int, P: Array, Q: Array, V_rms: Array, limited: NDArray[Any] | None = None
    ) -> PowerLoopGains | None:
        del limited  # a closed form has no guards
        now, now_s, safe = self._now, self._updates.instant(sample), self._updates.safe
        now.move_to(now_s)
        silent = now.silent
        R_g, L_g = np.where(silent, self._last[0], now.R_g), np.where(silent, self._last[1], now.L_g)
        if safe is not None and silent.any():
            stale = now_s - now.silent_since >= STALE_S
            R_g, L_g = np.where(stale, safe.R_g, R_g), np.where(stale, safe.L_g, L_g)
        self._last = R_g, L_g
        found = self._law(R_g, L_g, P, Q, V_rms)
        good = np.isfinite(np.stack(found)).all(axis=0)
        if self._gains is not None and not good.all():
            found = PowerLoopGains(*(np.where(good, new, old) for new, old in zip(found, self._gains, strict=True)))
        self._grid = np.where(good, R_g, self._grid[0]), np.where(good, L_g, self._grid[1])
        self._gains = found
        return found

    def estimate(self) -> tuple[Array, Array]:
        return self._grid

    def known_at_end(self) -> ManyGainsOf:
        return _law_at_the_end(self._law, self._told, self._updates.safe)

    def take(self, chosen: NDArray[Any]) -> Telling:
        some = copy(self)
        some._told, some._now = self._told.take(chosen), self._now.take(chosen)
        some._last = self._last[0][chosen], self._last[1][chosen]
        some._grid = self._grid[0][chosen], self._grid[1][chosen]
        if self._gains is not None:
            some._gains = PowerLoopGains(*(values[chosen] for values in self._gains))
        return some


class _OfTable:
    """A table with the scheduler of the runtime. It has a safe place of its own."""

    def __init__(
        self, lookup: GainLookup, settings: SchedulerSettings, law: ControllerGains, told: ToldGrids, updates: Updates
    ) -> None:
        self._law, self._told, self._now, self._updates = law, told, ToldNow(told), updates
        self.update_samples, self._tick = updates.every, settings.tick
        self._safe = Grid(*lookup.grid(settings.safe_scr, settings.safe_r_over_x))
        self._schedulers = ManySchedulers(lookup, settings, len(told.starts), CompiledSchedulers(lookup, settings))
        inside = self._schedulers.start(self._now.R_g, self._now.L_g, nearest=True)
        self._first_R_g = np.where(inside, self._now.R_g, np.nan)

    @property
    def changes(self) -> KnownChanges:
        return _changes(self._law, [])

    def first(self, P: Array, Q: Array, V_rms: Array) -> PowerLoopGains:
        return self._schedulers.update(self._first_R_g, self._now.L_g, P, Q, V_rms, 0)

    def update(
        self, sample: int, P: Array, Q: Array, V_rms: Array, limited: NDArray[Any] | None = None
    ) -> PowerLoopGains | None:
        now = self._now
        now.move_to(self._updates.instant(sample))
        ticks = round(sample * self._updates.T_s / self._tick)
        was_limited = False if limited is None else limited > 0
        return self._schedulers.update(now.R_g, now.L_g, P, Q, V_rms, ticks, limited=was_limited, surprised=now.silent)

    def estimate(self) -> tuple[Array, Array]:
        return self._schedulers.grid

    def known_at_end(self) -> ManyGainsOf:
        return _law_at_the_end(self._law, self._told, self._safe)

    def take(self, chosen: NDArray[Any]) -> Telling:
        some = copy(self)
        some._told, some._now = self._told.take(chosen), self._now.take(chosen)
        some._first_R_g, some._schedulers = self._first_R_g[chosen], self._schedulers.take(chosen)
        return some


def _law_at_the_end(law: ControllerGains, told: ToldGrids, safe: Grid | None) -> ManyGainsOf:
    """Gains for the last grid that is told, or for the safe one where nothing is told any more."""
    R_g, L_g, silent = told.at_the_end()
    if safe is not None:
        R_g, L_g = np.where(silent, safe.R_g, R_g), np.where(silent, safe.L_g, L_g)
    return lambda P, Q, V_rms: law(R_g, L_g, P, Q, V_rms)


def _changes(law: ControllerGains, found: list[tuple[Whole, Whole, Array, Array]]) -> KnownChanges:
    """The changes in their order, without those to a grid for which there are no gains: the present ones then stay."""
    nothing = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0)
    lane, sample, R_g, L_g = (np.concatenate(parts) for parts in zip(nothing, *found, strict=True))
    gains = law(R_g, L_g, 0.0, 0.0, 1.0) if len(lane) else PowerLoopGains(*[np.zeros(0)] * len(PowerLoopGains._fields))
    good = np.isfinite(np.stack(gains)).all(axis=0)
    order = np.lexsort((sample, lane))
    order = order[np.take(good, order)]
    return KnownChanges(lane[order], sample[order], PowerLoopGains(*(g[order] for g in gains)), R_g[order], L_g[order])


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
