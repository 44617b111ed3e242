"""Gains that are decided while the simulation runs: the inputs of a scheduler and the time at which its answer acts.

A scheduler is called at every whole multiple of its period, with the samples of the period that ends at this time.
Windows do not overlap, and the first begins at t = 0. The answer acts from this sample on; :class:`HeldBack` delays it
by whole windows.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, runtime_checkable

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
from vsgdesign.simulation.probing import HeldProbe
from vsgdesign.simulation.timeline import Timeline

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class MeasuredWindow:
    """The samples of one period in SI units, and the controller's own quantities at its end.

    Arrays have one row for each sample. The first is at the beginning of the period, the last one interval before its
    end.
    """

    index: int
    """0 for the window that begins at t = 0."""
    t_s: float
    """End of the window: the sample at which an answer acts."""
    sample_interval: float
    v_pcc: Array
    """(n, 2): α and β of the voltage at the PCC, V peak, as the sensors say. α is phase A."""
    i_pcc: Array
    """(n, 2): α and β of the current into the grid, A peak, as the sensors say."""
    theta: Array
    """(n): angle of the converter's d axis against α, rad."""
    P: float
    Q: float
    """Powers at the control point as the power loops see them (filtered), W and var."""
    V_rms: float
    """The Q loop's voltage, phase rms V."""
    omega: float
    """The converter's frequency, rad/s."""
    refs: References
    gains: PowerLoopGains
    """What the power loops have been run with."""
    source_phase: float
    """Angle of the grid source's space vector at the first sample, rad. No converter can measure it: it is what
    a window that is synchronised with the grid is given."""
    sent: NDArray[np.complex128] | None = None
    """The probe (n) as it was injected; None if there was none."""
    limited: int = 0
    """In how many of the controller's samples within the window it limited its current. The controller may sample more
    often than the window does."""

    @property
    def sent_values(self) -> NDArray[np.complex128]:
        """(n): the probe as it was sent, zeros where none was."""
        return np.zeros(len(self.theta), dtype=complex) if self.sent is None else self.sent


class OnlineScheduler(Protocol):
    """An object that decides the power-loop gains during a run."""

    @property
    def update_period(self) -> float:
        """Time between two updates, s: a whole multiple of ``sample_interval``."""
        ...

    @property
    def sample_interval(self) -> float:
        """Spacing of a window's samples, s: a whole multiple of the controller's sampling period."""
        ...

    def first_gains(self) -> PowerLoopGains:
        """Gains from t = 0 on, before anything has been measured."""
        ...

    def update(self, window: MeasuredWindow) -> PowerLoopGains | None:
        """Gains from the end of the window on. None means that they do not change."""
        ...


@runtime_checkable
class ProbingScheduler(Protocol):
    """A scheduler that also asks for a probe."""

    @property
    def probe_hold(self) -> float | None:
        """For how long each value of its probes is held, s; None: it asks for none."""
        ...

    def wanted(self) -> Probe | None:
        """The probe from now on."""
        ...


class WindowPowers(NamedTuple):
    """What a scheduler that says ``powers_alone`` gets in place of a :class:`MeasuredWindow`."""

    t_s: float
    """End of the window: the sample at which an answer acts."""
    P: float
    Q: float
    """Powers at the control point as the power loops see them (filtered), W and var."""
    V_rms: float
    """The Q loop's voltage, phase rms V."""
    limited: int
    """In how many of the controller's samples within the window it limited its current."""


class KnowsItsGrid(Protocol):
    """An online scheduler that says which grid its gains are made for: what a current limiter is told of the grid.

    A scheduler is one by having the attribute.
    """

    @property
    def grid(self) -> Grid | None:
        """The grid in force; None before there is one."""
        ...


@dataclass(frozen=True)
class FixedGains:
    """The scheduler that never changes anything; wrapped in a :class:`Recorder`, it collects windows."""

    gains: PowerLoopGains
    update_period: float = 20e-3
    sample_interval: float = 200e-6

    def first_gains(self) -> PowerLoopGains:
        """The gains."""
        return self.gains

    def update(self, window: MeasuredWindow) -> PowerLoopGains | None:  # noqa: ARG002
        """Nothing new."""
        return None


@dataclass(frozen=True)
class HeldBack:
    """A scheduler whose answers act ``windows`` updates late, as a model of the computing time.

    With 1, the answer to window k acts from the end of window k + 1 on. The object has a state and serves one run only.
    """

    scheduler: OnlineScheduler
    windows: int = 1
    _waiting: deque[tuple[PowerLoopGains | None, Grid | None]] = field(default_factory=deque)
    _in_force: list[Grid | None] = field(default_factory=lambda: [None])

    def __post_init__(self) -> None:
        _check_windows(self.scheduler, "HeldBack")

    @property
    def update_period(self) -> float:
        """That of the scheduler."""
        return self.scheduler.update_period

    @property
    def sample_interval(self) -> float:
        """That of the scheduler."""
        return self.scheduler.sample_interval

    def first_gains(self) -> PowerLoopGains:
        """Those of the scheduler, with nothing waiting."""
        self._waiting.clear()
        first = self.scheduler.first_gains()
        self._in_force[0] = _grid(self.scheduler)
        return first

    @property
    def grid(self) -> Grid | None:
        """The one that came with the gains in force."""
        return self._in_force[0]

    @property
    def probe_hold(self) -> float | None:
        """That of the scheduler."""
        return _probe_hold(self.scheduler)

    def wanted(self) -> Probe | None:
        """What the scheduler wants; a probe is not held back."""
        return _wanted(self.scheduler)

    def update(self, window: MeasuredWindow) -> PowerLoopGains | None:
        """What the scheduler said ``windows`` updates ago."""
        answer = self.scheduler.update(window)
        self._waiting.append((answer, _grid(self.scheduler)))
        if len(self._waiting) <= self.windows:
            return None
        answer, self._in_force[0] = self._waiting.popleft()
        return answer


@dataclass(frozen=True)
class Recorder:
    """A scheduler that keeps all its inputs and answers in order."""

    scheduler: OnlineScheduler
    windows: list[MeasuredWindow] = field(default_factory=list)
    answers: list[PowerLoopGains | None] = field(default_factory=list)

    def __post_init__(self) -> None:
        _check_windows(self.scheduler, "Recorder")

    @property
    def update_period(self) -> float:
        """That of the scheduler."""
        return self.scheduler.update_period

    @property
    def sample_interval(self) -> float:
        """That of the scheduler."""
        return self.scheduler.sample_interval

    def first_gains(self) -> PowerLoopGains:
        """Those of the scheduler, with nothing kept from an earlier run."""
        self.windows.clear()
        self.answers.clear()
        return self.scheduler.first_gains()

    @property
    def probe_hold(self) -> float | None:
        """That of the scheduler."""
        return _probe_hold(self.scheduler)

    def wanted(self) -> Probe | None:
        """What the scheduler wants."""
        return _wanted(self.scheduler)

    @property
    def grid(self) -> Grid | None:
        """That of the scheduler."""
        return _grid(self.scheduler)

    def update(self, window: MeasuredWindow) -> PowerLoopGains | None:
        """What the scheduler says."""
        answer = self.scheduler.update(window)
        self.windows.append(window)
        self.answers.append(answer)
        return answer


def _check_windows(scheduler: OnlineScheduler, who: str) -> None:
    if not hasattr(scheduler, "update_period"):
        kind = type(scheduler).__name__
        raise TypeError(
            f"{who} counts windows, and {kind} has none: it answers after cycles of its own. Give it to simulate as it "
            "is; its rows keep the answers."
        )


def _probe_hold(scheduler: OnlineScheduler) -> float | None:
    return scheduler.probe_hold if isinstance(scheduler, ProbingScheduler) else None


def _wanted(scheduler: OnlineScheduler) -> Probe | None:
    return scheduler.wanted() if isinstance(scheduler, ProbingScheduler) else None


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
        self.probe_hold = _probe_hold(scheduler)
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
        self._wanted = _wanted(scheduler)
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
        return _grid(self._scheduler)

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
            self._wanted = _wanted(self._scheduler)
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


def _grid(scheduler: OnlineScheduler) -> Grid | None:
    # Asked at every stretch of a run: what isinstance() does with a protocol takes a third of a run's time there.
    grid: Grid | None = getattr(scheduler, "grid", None)
    return grid


def whole_multiple(value: float, unit: float, what: str, of: str) -> int:
    """How many units a value is. Raises InfeasibleStudyError if it is no whole number of them."""
    count = round(value / unit) if value > 0.0 and math.isfinite(value) else 0
    if count < 1 or abs(value / unit - count) > 1e-6:
        raise InfeasibleStudyError(
            f"online schedule: {what} = {value:.6g} s is not a whole multiple of {of}, {unit:.6g} s. "
            "Choose one that is, or another carrier frequency (f_sw, samples_per_carrier)."
        )
    return count
