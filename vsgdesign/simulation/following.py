"""Scheduled gains in a run: the gains at its start, those for a grid and the measured powers, and new ones within a run
with what they do to the power loops, of a table's scheduler and of a closed form."""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import Any, Protocol

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.notation import Count
from vsgdesign.equations.power_flow import scheduled_jacobian
from vsgdesign.equations.power_loops import PowerLoopGains, References, gain_transfer
from vsgdesign.equations.scheduler_data import (
    LIMITED,
    ScheduleLaw,
    SchedulerInput,
    SchedulerLimits,
    SchedulerState,
    ScheduleTable,
    grid_at,
    normalised_at,
)
from vsgdesign.equations.scheduling import told_and_updated
from vsgdesign.errors import ArtifactError, InfeasibleStudyError, NoOperatingPointError
from vsgdesign.identification import Estimator
from vsgdesign.linear.operating_point.many_rests import rest_with_measured_gains
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.runtime.scheduler import Scheduler, scheduler_of
from vsgdesign.runtime.updating import Covariance
from vsgdesign.simulation.circuits import circuit_at_rest, connection_at
from vsgdesign.simulation.compiled_schedulers import strict_scheduler_of
from vsgdesign.simulation.timeline import Timeline, build_timeline
from vsgdesign.study.parameters.grid import Grid, GridSource
from vsgdesign.study.parameters.study import ControllerSpec, Study

KnownFirst = dict[Hashable, tuple[PowerLoopGains, SchedulerState | None]]
"""First gains of one controller of one converter, and the state of its table's scheduler that goes on from there: by
the grid that it is told, and where it begins."""


class MeasuredPowers(Protocol):
    """What a schedule takes of a window, SI."""

    @property
    def t_s(self) -> float:
        """End of the window."""
        ...

    @property
    def P(self) -> float:
        """Powers and voltage (rms) as the power loops see them."""
        ...

    @property
    def Q(self) -> float:
        """var"""
        ...

    @property
    def V_rms(self) -> float:
        """V"""
        ...

    @property
    def limited(self) -> int:
        """In how many samples of the window the current was limited."""
        ...


class ScheduledAnswers:
    """Gains of a scheduled controller for a grid and the measured P, Q, V.

    With a table they come from the scheduler of the runtime with all its guards, otherwise from the closed form. The
    scheduler has a state, so the object must not be shared by two runs at a time.
    """

    def __init__(
        self,
        study: Study,
        spec: ControllerSpec,
        ready: Ready = NOTHING,
        estimator: Estimator | None = None,
    ) -> None:
        self._study, self._spec, self._law = study, spec, gain_law(study, spec, ready)
        table = ready.table(spec)
        self._grid = study.grid
        scheduler = strict_scheduler_of if study.simulation.strict else scheduler_of
        self._runtime = None if table is None else scheduler(table, estimator)

    @property
    def runtime(self) -> Scheduler | None:
        """The scheduler of a table; None without one."""
        return self._runtime

    @property
    def rate(self) -> float | None:
        """The scheduler's limit of |d ln SCR/dt| and |d ln(R/X)/dt|, 1/s; None without a table."""
        return None if self._runtime is None else self._runtime.settings.rate

    @property
    def grid(self) -> Grid:
        """The grid for which the present gains are made. For a table it is the place of its scheduler."""
        if self._runtime is not None and self._runtime.grid != (self._grid.R_g, self._grid.L_g):
            self._grid = Grid(*self._runtime.grid)
        return self._grid

    def first(
        self, told: Grid | None = None, *, known: bool = True, before: KnownFirst | None = None
    ) -> PowerLoopGains:
        """Gains at the start: of the known grid, in the steady state that they are part of; without load for a cold
        start.

        ``told`` is the grid that the controller takes the true one for; None: it knows the true one. A table begins
        where its updates would hold it: at the nearest place of its box. With ``known`` false it begins at its safe
        place, whatever the grid is. ``before``: what is known of runs before, which gets what this one adds. Raises
        InfeasibleStudyError where there is no steady state, or a closed form has no gains.
        """
        timeline, before = build_timeline(self._study), {} if before is None else before
        begins = connection_at(timeline, 0.0), timeline.source_at(0.0), timeline.references_at(0.0)
        asked = told, known, self._study.simulation.start, *begins
        if asked not in before:
            gains = self._first(timeline, told, known)
            before[asked] = gains, None if self._runtime is None else self._runtime.present
        gains, state = before[asked]
        self._grid = timeline.grid_at(0.0) if told is None else told
        if self._runtime is not None and state is not None:
            self._runtime.go_on(state)
        return gains

    def _first(self, timeline: Timeline, told: Grid | None, known: bool) -> PowerLoopGains:
        study, spec = self._study, self._spec
        true, source = timeline.grid_at(0.0), timeline.source_at(0.0)
        grid = true if told is None else told
        if self._runtime is not None and not known:
            self._runtime = type(self._runtime)(self._runtime.lookup, self._runtime.settings)
        elif self._runtime is not None:
            try:
                self._runtime.start(grid.R_g, grid.L_g, nearest=True)
            except ArtifactError:  # the table has no design there: from the safe place, as in the field
                known = False
        elif not self._law.measured:
            return self._at_design_point(grid.R_g, grid.L_g)

        def gains_of(P: float, Q: float, V_rms: float) -> PowerLoopGains:
            if self._runtime is None:
                return _numbers(self._law(grid.R_g, grid.L_g, P, Q, V_rms))
            if known:
                return self._runtime.update_estimate(grid.R_g, grid.L_g, P, Q, V_rms, 0).gains
            return self._runtime.hold(P, Q, V_rms, 0).gains

        if study.simulation.start == "cold" or not source.steady:
            return gains_of(0.0, 0.0, study.converter.V_rated_rms)
        at_start = GridSource(source.V_g_rms, source.omega)
        try:
            circuit = circuit_at_rest(study, connection_at(timeline, 0.0))
            refs = timeline.references_at(0.0)
            return rest_with_measured_gains(study, true, at_start, refs, gains_of, circuit=circuit)[1]
        except InfeasibleStudyError as error:
            raise InfeasibleStudyError(f"controller {spec.name}, the start: {error}") from error

    def to(
        self,
        window: MeasuredPowers,
        R_g: float,
        L_g: float,
        *,
        surprised: bool = False,
        changed: bool = False,
        covariance: Covariance | None = None,
    ) -> tuple[PowerLoopGains | None, bool]:
        """Gains from the end of a window on for a grid, NaN: not known; None to go on as before. And whether the
        scheduler's rate limit held them back.

        The scheduler of a table is told what the estimator decided (``surprised``, ``changed``) and the ``covariance``
        of its error, as in :meth:`vsgdesign.runtime.scheduler.Scheduler.update_estimate`.
        """
        known = math.isfinite(R_g) and math.isfinite(L_g)
        if self._runtime is None:
            found = _numbers(self._law(R_g, L_g, window.P, window.Q, window.V_rms)) if known else None
            if found is None or not all(map(math.isfinite, found)):
                return None, False
            self._grid = Grid(R_g, L_g)
            return found, False
        measured = (window.P, window.Q, window.V_rms, round(window.t_s / self._runtime.settings.tick))
        self._runtime.tell(limited=window.limited > 0, surprised=surprised, changed=changed)
        if known:
            answer = self._runtime.update_estimate(R_g, L_g, *measured, covariance=covariance)
        else:
            answer = self._runtime.hold(*measured)
        return answer.gains, bool(answer.status & LIMITED)

    def _at_design_point(self, R_g: float, L_g: float) -> PowerLoopGains:
        try:
            return self._law.schedule.gains(R_g, L_g)
        except NoOperatingPointError as error:
            raise InfeasibleStudyError(f"controller {self._spec.name}, grid at the start: {error}") from error


class KnownGridScheduler:
    """An online scheduler that is told the true grid at every update, as it was up to that instant.

    In runs whose breaker opens, :func:`vsgdesign.simulation.feeds.gain_feed` takes another one.
    """

    powers_alone = True

    def __init__(self, study: Study, spec: ControllerSpec, timeline: Timeline, ready: Ready = NOTHING) -> None:
        self._answers, self._timeline = ScheduledAnswers(study, spec, ready), timeline
        self._period, self._T_s = ready.update_period(spec) or study.converter.T_s, study.converter.T_s

    def hear(self, study: Study, timeline: Timeline) -> None:
        """The events of the run are these from now on."""
        del study
        self._timeline = timeline

    @property
    def update_period(self) -> float:
        """That of the controller, s."""
        return self._period

    @property
    def sample_interval(self) -> float:
        """One row a window: nothing is looked at but the powers at its end."""
        return self._period

    @property
    def runtime(self) -> Scheduler | None:
        """The scheduler of a table; None for a closed form."""
        return self._answers.runtime

    def first_gains(self) -> PowerLoopGains:
        """Gains of the grid at the start, as :meth:`ScheduledAnswers.first`."""
        return self._answers.first()

    @property
    def grid(self) -> Grid:
        """The grid that the present gains are for."""
        return self._answers.grid

    def update(self, window: MeasuredPowers) -> PowerLoopGains | None:
        """Gains for the true grid: a change that coincides with the update is seen by the next one."""
        grid = self._timeline.grid_at(window.t_s - 0.5 * self._T_s)
        return self._answers.to(window, grid.R_g, grid.L_g)[0]


def _numbers(gains: PowerLoopGains) -> PowerLoopGains:
    return PowerLoopGains(*(float(value) for value in gains))


def rescheduled(
    table: ScheduleTable,
    limits: SchedulerLimits,
    s: SchedulerState,
    told: Count,
    given: SchedulerInput,
    refs: References,
    omega_i: Any,
    law: ScheduleLaw,
) -> Any:
    """An update before which the scheduler was told something, with the references that have been in force.

    Returns (following, status, reason, R_g, L_g, next_omega_i): its state, the grid that its gains are for (Ω and H),
    and the frequency of the integrator with the new gains, rad/s.
    """
    following, status, reason = told_and_updated(table, limits, s, told, given, law)
    R_g, L_g = grid_at(table, following.scr, following.r_over_x, law)
    next_omega_i = gain_transfer(omega_i, refs, s.gains, following.gains)
    return following, status, reason, R_g, L_g, next_omega_i


def refollowed(
    table: ScheduleTable,
    R_g: Any,
    L_g: Any,
    P: Any,
    Q: Any,
    V_rms: Any,
    before: PowerLoopGains,
    refs: References,
    omega_i: Any,
    law: ScheduleLaw,
) -> Any:
    """Gains of a closed form, a table of one node, for a grid and the measured powers, in place of those before.

    Returns (gains, next_omega_i).
    """
    normalised, _ = normalised_at(table, table.scr[0], table.r_over_x[0])
    A, B, C, D = scheduled_jacobian(P, Q, V_rms, R_g + table.R_2, table.omega * (L_g + table.L_2))
    gains = law.gains(A, B, C, D, normalised, table.D_p, table.D_q, table.S_rated, table.omega, law.by_inertia)
    return gains, gain_transfer(omega_i, refs, before, gains)
