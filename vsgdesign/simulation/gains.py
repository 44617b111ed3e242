"""The gains of a study's controller over time: fixed ones, or ones scheduled from the true grid impedance; and gains as
a run takes them, listed over time, or answers of an online scheduler to windows out of the log."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.grid import FilterGrid, capacitor_node_voltage
from vsgdesign.equations.power_loops import PowerLoopGains, References, gain_transfer, power_loops
from vsgdesign.errors import InfeasibleStudyError, NoOperatingPointError
from vsgdesign.identification import Probe
from vsgdesign.runtime.of_study import follows_measured, schedule_of
from vsgdesign.runtime.schedule import Schedule, on_floats
from vsgdesign.simulation.every_sample import AtPcc
from vsgdesign.simulation.field_observer import FieldMemory, HeldProbe
from vsgdesign.simulation.online import MeasuredWindow, OnlineScheduler, WindowPowers, grid_of, probe_hold_of, wanted_of
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

_gain_transfer = on_floats(gain_transfer)


@dataclass(frozen=True)
class GainChange:
    """Power-loop gains from t_s on, until the next change."""

    t_s: float
    gains: PowerLoopGains
    grid: Grid | None = field(default=None, compare=False)
    """The grid for which the gains are made; None for given gains, which belong to no grid."""


class RunFeed:
    """What gives a run its gains. The run sets the last four attributes, and asks before each stretch.

    This class says nothing: its gains never change, it sends no probe and needs no rows of the log.
    """

    memory: FieldMemory | None = None
    """The numbers of a field estimator, which the loop of the run moves."""
    closed = False
    """Whether a cycle of the field estimator has ended that is not concluded."""
    log_samples = 0
    """The spacing of the rows of the log that it looks at, in samples; 0: it looks at none."""
    probe_hold: float | None = None
    """For how long each value of its probes is held, s; None: it sends none."""
    held: HeldProbe | None = None
    """The run's probe, if it sends one."""
    limited_samples = 0
    """In how many samples the run has limited its current so far."""
    sensed: Array | None = None
    """What the sensors say of the capacitor node's voltage and of i_g, (rows of the log, 4); no rows: the sensors are
    ideal."""
    more: Array | None = None
    """The circuit's states besides i_s, v_c and i_g, (rows of the log, m)."""
    changes: list[GainChange]
    """The gains so far, from t = 0 on."""

    def first(self) -> PowerLoopGains:
        """Gains from t = 0 on."""
        return self.changes[0].gains

    def wanted(self) -> Probe | None:
        """The probe that it wants since its last update."""
        return None

    def cuts(self, samples: int) -> set[int]:
        """Samples of a run of so many at which gains may change."""
        del samples
        return set()

    def quiet(self, samples: int) -> set[int]:
        """Those of the cuts at which the gains stay, whatever is measured."""
        del samples
        return set()

    def grid(self, sample: int) -> Grid | None:
        """The grid that the gains of a sample are for; None where nothing says which."""
        del sample
        return None

    def leave_updates(self) -> int:
        """Leaves the updates to whoever makes those of all runs side by side, who puts what they give into ``changes``.
        Returns after how many samples there is one; 0: there is none that it can leave."""
        return 0

    def update(
        self, sample: int, present: PowerLoopGains, state: ControllerState, refs: References, log: Array, log_every: int
    ) -> PowerLoopGains:
        """Gains from a sample on; ``log`` has a row every ``log_every`` samples."""
        del sample, state, refs, log, log_every
        return present

    def follow(self, timeline: Timeline, changes: Sequence[GainChange]) -> None:
        """The run has another timeline now, with these changes of listed gains."""
        del timeline, changes

    def conclude(self, sample: int, present: PowerLoopGains, state: ControllerState) -> PowerLoopGains:
        """Gains from a sample on, before which a cycle of the field estimator has ended."""
        del sample, state
        return present

    def finish(
        self, sample: int, present: PowerLoopGains, state: ControllerState, refs: References, log: Array, log_every: int
    ) -> None:
        """The run is over."""
        del sample, present, state, refs, log, log_every


def gain_changes(study: Study, spec: ControllerSpec, timeline: Timeline) -> tuple[GainChange, ...]:
    """All changes of a controller's gains in a scenario, from t = 0 on, for gains that depend on the grid alone.

    A scheduled controller updates at whole multiples of its period. It then knows the grid up to that instant, so the
    next update is the first to see a change of grid at this instant. Raises ValueError for gains that follow
    measurements (:func:`vsgdesign.simulation.feeds.gain_feed`).
    """
    if follows_measured(spec):
        raise ValueError(f"controller {spec.name}: its gains follow the measured P, Q and V; give simulate a gain_feed")
    schedule = schedule_of(study, spec)
    if spec.kind == "fixed":
        if spec.gains is not None:
            return (GainChange(0.0, spec.gains),)
        grid = spec.design_grid or study.grid
        return (GainChange(0.0, _gains(schedule, grid, f"controller {spec.name}, design grid"), grid),)
    period = spec.update_period or study.converter.T_s
    changes: list[GainChange] = []
    for t_event in sorted({t for t, _ in timeline.grids}):
        updates = 0 if t_event == 0.0 else math.floor(t_event / period + 1e-9) + 1
        grid, where = timeline.grid_at(t_event), f"controller {spec.name}, grid from {t_event:g} s"
        change = GainChange(updates * period, _gains(schedule, grid, where), grid)
        # Two changes between two updates: only the last is ever seen.
        changes = [earlier for earlier in changes if earlier.t_s < change.t_s] + [change]
    return tuple(changes)


def settled_changes(changes: Sequence[GainChange], instants: Sequence[float], end_s: float) -> tuple[GainChange, ...]:
    """Few of many changes: the first, and whatever holds right before each instant and at the end, once each."""
    starts = [change.t_s for change in changes]
    held = {0}
    for t_s in (*instants, end_s):
        held.add(max(bisect_left(starts, t_s - 1e-9) - 1, 0))
    return tuple(changes[k] for k in sorted(held))


def _gains(schedule: Schedule, grid: Grid, where: str) -> PowerLoopGains:
    try:
        return schedule.gains(grid.R_g, grid.L_g)
    except NoOperatingPointError as error:
        raise InfeasibleStudyError(f"{where}: {error}") from error


def with_gains(
    state: ControllerState, refs: References, before: PowerLoopGains, after: PowerLoopGains
) -> ControllerState:
    """The state with other gains; the frequency at which the integrator would rest stays (:eq:`gain-transfer`)."""
    if after is before:
        return state
    return state._replace(omega_i=_gain_transfer(state.omega_i, refs, before, after))


def sensed_vectors(log: Array, sensed: Array, v_pcc: Array, circuit: FilterGrid) -> tuple[Array, Array]:
    """v_pcc and i_pcc, (n, 2) each, with the errors of the controller's own sensors: the PCC's voltage is measured as
    wrongly as that of the capacitor node, which is the same voltage where the filter has no second inductor."""
    node = capacitor_node_voltage(log[:, 0:2], log[:, 2:4], log[:, 4:6], circuit)
    return v_pcc + (sensed[:, 0:2] - node), sensed[:, 2:4]


class ListedGains(RunFeed):
    """Gains over time that are known beforehand, as a run takes them."""

    def __init__(self, changes: Sequence[GainChange], T_s: float) -> None:
        self._T_s = T_s
        self._take(changes)

    def follow(self, timeline: Timeline, changes: Sequence[GainChange]) -> None:
        del timeline
        if changes:
            self._take(changes)

    def _take(self, changes: Sequence[GainChange]) -> None:
        T_s = self._T_s
        if not changes or changes[0].t_s > 0.0:
            raise ValueError("the first gain change must be at or before t = 0")
        self.changes = list(changes)
        # What the controller is told takes effect at the first sample at or after its time.
        starts = [max(math.ceil(change.t_s / T_s - 1e-6), 0) for change in changes]
        self._at = dict(zip(starts, changes, strict=True))

    def first(self) -> PowerLoopGains:
        return self._at[0].gains

    def cuts(self, samples: int) -> set[int]:
        return {k for k in self._at if k <= samples}

    def grid(self, sample: int) -> Grid | None:
        return self._at[max(k for k in self._at if k <= sample)].grid

    def update(
        self, sample: int, present: PowerLoopGains, state: ControllerState, refs: References, log: Array, log_every: int
    ) -> PowerLoopGains:
        del state, refs, log, log_every
        return self._at[sample].gains if sample in self._at else present


class OnlineGains(RunFeed):
    """An online scheduler, as a run takes it: cuts windows out of the log and asks."""

    def __init__(self, scheduler: OnlineScheduler, study: Study, timeline: Timeline) -> None:
        self._scheduler, self._study, self._timeline = scheduler, study, timeline
        self._at_pcc = AtPcc(study, timeline)
        T_s = study.converter.T_s
        interval, period = scheduler.sample_interval, scheduler.update_period
        self._every = whole_multiple(interval, T_s, "sample_interval", "the controller's sampling period")
        self._period = self._every * whole_multiple(period, interval, "update_period", "the sample interval")
        self.log_samples = self._every
        self._T_s = T_s
        self.changes = [GainChange(0.0, scheduler.first_gains())]
        self.probe_hold = probe_hold_of(scheduler)
        self._limited_before = 0
        self._wanted = wanted_of(scheduler)
        self._powers_alone: bool = getattr(scheduler, "powers_alone", False)
        self._left = False

    def wanted(self) -> Probe | None:
        return self._wanted

    def follow(self, timeline: Timeline, changes: Sequence[GainChange]) -> None:
        del changes
        self._timeline, self._at_pcc = timeline, AtPcc(self._study, timeline)

    def cuts(self, samples: int) -> set[int]:
        return set(range(self._period, samples + 1, self._period))

    def leave_updates(self) -> int:
        self._left = self._powers_alone
        return self._period if self._left else 0

    def quiet(self, samples: int) -> set[int]:
        if self._left:
            return self.cuts(samples)
        instants: Sequence[float] | None = getattr(self._scheduler, "answers_after", None)
        if instants is None or not self._powers_alone or self.probe_hold is not None:
            return set()
        # Rounding decides which update is the first one after an instant: its neighbours are asked as well.
        last = [math.floor(t_s / (self._period * self._T_s)) for t_s in instants]
        return self.cuts(samples) - {(k + near) * self._period for k in last for near in (-1, 0, 1, 2)}

    def grid(self, sample: int) -> Grid | None:
        del sample
        return grid_of(self._scheduler)

    def update(
        self, sample: int, present: PowerLoopGains, state: ControllerState, refs: References, log: Array, log_every: int
    ) -> PowerLoopGains:
        if sample == 0 or sample % self._period or self._left:
            return present
        if self._powers_alone:
            answer = self._scheduler.update(self._powers(sample, state))  # type: ignore[arg-type]
        else:
            answer = self._scheduler.update(self._window(sample, present, state, refs, log, log_every))
        if self.held is not None:
            self._wanted = wanted_of(self._scheduler)
        if answer is None or answer == present:
            return present
        self.changes.append(GainChange(sample * self._T_s, answer))
        return answer

    def finish(
        self, sample: int, present: PowerLoopGains, state: ControllerState, refs: References, log: Array, log_every: int
    ) -> None:
        """Hand over the window that ends with the run, if one does; there is nothing left for its answer to act on."""
        if sample % self._period == 0 and not self._powers_alone:
            self._scheduler.update(self._window(sample, present, state, refs, log, log_every))

    def _powers(self, sample: int, state: ControllerState) -> WindowPowers:
        limited, self._limited_before = self.limited_samples - self._limited_before, self.limited_samples
        return WindowPowers(sample * self._T_s, state.P_f, state.Q_f, state.V, limited)

    def _window(
        self, sample: int, gains: PowerLoopGains, state: ControllerState, refs: References, log: Array, log_every: int
    ) -> MeasuredWindow:
        begin = sample - self._period
        limited, self._limited_before = self.limited_samples - self._limited_before, self.limited_samples
        over = slice(begin // log_every, sample // log_every, self._every // log_every)
        rows, times = log[over], np.arange(begin, sample, self._every, dtype=np.float64) * self._T_s
        more = np.empty((len(rows), 0)) if self.more is None else self.more[over]
        v_pcc, i_pcc = self._at_pcc.rows(times, rows, more)
        if self.sensed is not None and len(self.sensed):
            v_pcc, i_pcc = sensed_vectors(rows, self.sensed[over], v_pcc, self._study.circuit())
        omega, _, _ = power_loops(state.omega_i, state.V, state.P_f, state.Q_f, refs, gains)
        return MeasuredWindow(
            index=sample // self._period - 1,
            t_s=sample * self._T_s,
            sample_interval=self._every * self._T_s,
            v_pcc=v_pcc,
            i_pcc=i_pcc.copy(),
            theta=rows[:, 12].copy(),
            P=state.P_f,
            Q=state.Q_f,
            V_rms=state.V,
            omega=omega,
            refs=refs,
            gains=gains,
            source_phase=float(self._timeline.source_phase(np.array([(begin + 1e-6) * self._T_s]))[0]),
            sent=None if self.held is None else self.held.sent_over(begin, sample, self._every),
            limited=limited,
        )


def whole_multiple(value: float, unit: float, what: str, of: str) -> int:
    """How many units a value is. Raises InfeasibleStudyError if it is no whole number of them."""
    count = round(value / unit) if value > 0.0 and math.isfinite(value) else 0
    if count < 1 or abs(value / unit - count) > 1e-6:
        raise InfeasibleStudyError(
            f"online schedule: {what} = {value:.6g} s is not a whole multiple of {of}, {unit:.6g} s. "
            "Choose one that is, or another carrier frequency (f_sw, samples_per_carrier)."
        )
    return count
