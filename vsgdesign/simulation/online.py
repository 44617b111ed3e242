"""Gains that are decided while the simulation runs: the inputs of a scheduler and the time at which its answer acts.

A scheduler is called at every whole multiple of its period, with the samples of the period that ends at this time.
Windows do not overlap, and the first begins at t = 0. The answer acts from this sample on; :class:`HeldBack` delays it
by whole windows.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.identification import Probe
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study

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


@runtime_checkable
class Hears(Protocol):
    """A scheduler that knows its grid, and hears what a run has found of its own events
    (:class:`vsgdesign.simulation.search.Search`)."""

    def hear(self, study: Study, timeline: Timeline) -> None:
        """The events are these from now on; up to now they were the same."""
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
class _Around:
    """A scheduler around another one, whose windows and probe it has."""

    scheduler: OnlineScheduler

    def __post_init__(self) -> None:
        if not hasattr(self.scheduler, "update_period"):
            kind = type(self.scheduler).__name__
            raise TypeError(
                f"{type(self).__name__} counts windows, and {kind} has none: it answers after cycles of its own. Give "
                "it to simulate as it is; its rows keep the answers."
            )

    @property
    def update_period(self) -> float:
        """That of the scheduler."""
        return self.scheduler.update_period

    @property
    def sample_interval(self) -> float:
        """That of the scheduler."""
        return self.scheduler.sample_interval

    @property
    def probe_hold(self) -> float | None:
        """That of the scheduler."""
        return probe_hold_of(self.scheduler)

    def wanted(self) -> Probe | None:
        """What the scheduler wants; a probe is not held back."""
        return wanted_of(self.scheduler)


@dataclass(frozen=True)
class HeldBack(_Around):
    """A scheduler whose answers act ``windows`` updates late, as a model of the computing time.

    With 1, the answer to window k acts from the end of window k + 1 on. The object has a state and serves one run only.
    """

    windows: int = 1
    _waiting: deque[tuple[PowerLoopGains | None, Grid | None]] = field(default_factory=deque)
    _in_force: list[Grid | None] = field(default_factory=lambda: [None])

    def first_gains(self) -> PowerLoopGains:
        """Those of the scheduler, with nothing waiting."""
        self._waiting.clear()
        first = self.scheduler.first_gains()
        self._in_force[0] = grid_of(self.scheduler)
        return first

    @property
    def grid(self) -> Grid | None:
        """The one that came with the gains in force."""
        return self._in_force[0]

    def update(self, window: MeasuredWindow) -> PowerLoopGains | None:
        """What the scheduler said ``windows`` updates ago."""
        answer = self.scheduler.update(window)
        self._waiting.append((answer, grid_of(self.scheduler)))
        if len(self._waiting) <= self.windows:
            return None
        answer, self._in_force[0] = self._waiting.popleft()
        return answer


@dataclass(frozen=True)
class Recorder(_Around):
    """A scheduler that keeps all its inputs and answers in order."""

    windows: list[MeasuredWindow] = field(default_factory=list)
    answers: list[PowerLoopGains | None] = field(default_factory=list)

    def first_gains(self) -> PowerLoopGains:
        """Those of the scheduler, with nothing kept from an earlier run."""
        self.windows.clear()
        self.answers.clear()
        return self.scheduler.first_gains()

    @property
    def grid(self) -> Grid | None:
        """That of the scheduler."""
        return grid_of(self.scheduler)

    def update(self, window: MeasuredWindow) -> PowerLoopGains | None:
        """What the scheduler says."""
        answer = self.scheduler.update(window)
        self.windows.append(window)
        self.answers.append(answer)
        return answer


def probe_hold_of(scheduler: OnlineScheduler) -> float | None:
    """For how long each value of its probe is held, s; None for one that sends none."""
    return scheduler.probe_hold if isinstance(scheduler, ProbingScheduler) else None


def wanted_of(scheduler: OnlineScheduler) -> Probe | None:
    """The probe that it asks for; None for one that sends none."""
    return scheduler.wanted() if isinstance(scheduler, ProbingScheduler) else None


def grid_of(scheduler: OnlineScheduler) -> Grid | None:
    """The grid that its gains are for; None for one that does not say."""
    # Asked at every stretch of a run: what isinstance() does with a protocol takes a third of a run's time there.
    grid: Grid | None = getattr(scheduler, "grid", None)
    return grid
