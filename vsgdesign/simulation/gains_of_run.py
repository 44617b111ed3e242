"""Gains as a run takes them: listed over time, or answers of an online scheduler to windows out of the log."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.filters import FilterGrid, capacitor_node_voltage
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.identification import Probe
from vsgdesign.parameters.grid import Grid
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.at_pcc import AtPcc
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.online import MeasuredWindow, OnlineScheduler, WindowPowers, grid_of, probe_hold_of, wanted_of
from vsgdesign.simulation.probing import HeldProbe
from vsgdesign.simulation.timeline import Timeline

Array = NDArray[np.float64]


def sensed_vectors(log: Array, sensed: Array, v_pcc: Array, circuit: FilterGrid) -> tuple[Array, Array]:
    """v_pcc and i_pcc, (n, 2) each, with the errors of the controller's own sensors: the PCC's voltage is measured as
    wrongly as that of the capacitor node, which is the same voltage where the filter has no second inductor."""
    node = capacitor_node_voltage(log[:, 0:2], log[:, 2:4], log[:, 4:6], circuit)
    return v_pcc + (sensed[:, 0:2] - node), sensed[:, 2:4]


class ListedGains:
    """Gains over time that are known beforehand, as a run takes them."""

    memory, closed = None, False

    def __init__(self, changes: Sequence[GainChange], T_s: float) -> None:
        if not changes or changes[0].t_s > 0.0:
            raise ValueError("the first gain change must be at or before t = 0")
        self.changes = list(changes)
        # What the controller is told takes effect at the first sample at or after its time.
        starts = [max(math.ceil(change.t_s / T_s - 1e-6), 0) for change in changes]
        self._at = {k: change.gains for k, change in zip(starts, changes, strict=True)}
        self._grids = {k: change.grid for k, change in zip(starts, changes, strict=True)}
        self.log_samples = 0
        self.probe_hold: float | None = None
        self.held: HeldProbe | None = None
        """The run's probe, if it sends one."""
        self.limited_samples = 0
        self.sensed: Array | None = None
        self.more: Array | None = None

    def wanted(self) -> Probe | None:
        """No probe."""
        return None

    def first(self) -> PowerLoopGains:
        """Gains from t = 0 on."""
        return self._at[0]

    def cuts(self, samples: int) -> set[int]:
        """Samples at which gains may change."""
        return {k for k in self._at if k <= samples}

    def grid(self, sample: int) -> Grid | None:
        """The grid that the gains of a sample are for; None where nothing says which."""
        return self._grids[max(k for k in self._grids if k <= sample)]

    def update(self, sample: int, present: PowerLoopGains, *_: object) -> PowerLoopGains:
        """Gains from a sample on."""
        return self._at.get(sample, present)

    def conclude(self, sample: int, present: PowerLoopGains, *_: object) -> PowerLoopGains:  # noqa: ARG002
        """Nothing: no cycle ever ends."""
        return present

    def finish(self, *_: object) -> None:
        """The run is over."""


class OnlineGains:
    """An online scheduler, as a run takes it: cuts windows out of the log and asks."""

    memory, closed = None, False

    def __init__(self, scheduler: OnlineScheduler, study: Study, timeline: Timeline) -> None:
        self._scheduler, self._study, self._timeline = scheduler, study, timeline
        self._at_pcc = AtPcc(study, timeline)
        T_s = study.converter.T_s
        interval, period = scheduler.sample_interval, scheduler.update_period
        self._every = whole_multiple(interval, T_s, "sample_interval", "the controller's sampling period")
        self._period = self._every * whole_multiple(period, interval, "update_period", "the sample interval")
        self.log_samples = self._every
        self._T_s = T_s
        self._gains = scheduler.first_gains()
        self.changes = [GainChange(0.0, self._gains)]
        self.probe_hold = probe_hold_of(scheduler)
        self.held: HeldProbe | None = None
        """The run's probe, if it sends one."""
        self.limited_samples = 0
        """How many samples the run has limited its current in so far; the run keeps it up to date."""
        self.sensed: Array | None = None
        """What the sensors say of the capacitor node's voltage and of i_g, (rows of the log, 4); no rows: the sensors
        are ideal. The run sets it."""
        self.more: Array | None = None
        """The circuit's states besides i_s, v_c and i_g, (rows of the log, m). The run sets it."""
        self._limited_before = 0
        self._wanted = wanted_of(scheduler)
        self._powers_alone: bool = getattr(scheduler, "powers_alone", False)

    def wanted(self) -> Probe | None:
        """The probe that the scheduler wants since its last update."""
        return self._wanted

    def first(self) -> PowerLoopGains:
        """Gains from t = 0 on."""
        return self._gains

    def cuts(self, samples: int) -> set[int]:
        """Samples at which gains may change."""
        return set(range(self._period, samples + 1, self._period))

    def grid(self, sample: int) -> Grid | None:  # noqa: ARG002
        """The grid that the present gains are for; None where the scheduler does not say."""
        return grid_of(self._scheduler)

    def update(
        self, sample: int, present: PowerLoopGains, state: ControllerState, refs: References, log: Array, log_every: int
    ) -> PowerLoopGains:
        """Ask the scheduler if a window ends at this sample; ``log`` has a row every ``log_every`` samples."""
        if sample == 0 or sample % self._period:
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

    def conclude(self, sample: int, present: PowerLoopGains, *_: object) -> PowerLoopGains:  # noqa: ARG002
        """Nothing: no cycle ever ends."""
        return present

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
