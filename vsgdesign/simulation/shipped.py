"""The scheduler of a controller in the loop of a run: that of Python, or its compiled C."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.runtime.updating import Answer
from vsgdesign.simulation.estimated import window_channels
from vsgdesign.simulation.online import MeasuredWindow
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.study.parameters.grid import Grid

GridEstimate = Callable[[MeasuredWindow], tuple[float, float] | None]
"""Function of a window that returns R_g (Ω) and L_g (H), or None if it has no estimate."""


class Runtime(Protocol):
    """What :class:`vsgdesign.runtime.Scheduler` and :class:`vsgdesign.export.CompiledC` have in common."""

    @property
    def gains(self) -> PowerLoopGains:
        """The present gains."""
        ...

    @property
    def grid(self) -> tuple[float, float]:
        """R_g (Ω) and L_g (H) for which they are made."""
        ...

    def tell(self, *, limited: bool = False, surprised: bool = False) -> None:
        """Tells the scheduler what has happened since the last update."""
        ...

    def update_estimate(self, R_g: float, L_g: float, P: float, Q: float, V_rms: float, ticks: int) -> Answer:
        """Gains from an estimate."""
        ...

    def hold(self, P: float, Q: float, V_rms: float, ticks: int) -> Answer:
        """An update without an estimate."""
        ...

    def update(self, v: Any, i: Any, P: float, Q: float, V_rms: float, ticks: int) -> Answer:
        """Gains from a window."""
        ...


class ShippedScheduler:
    """An online scheduler (:class:`vsgdesign.simulation.online.OnlineScheduler`) that asks a runtime.

    ``estimate`` gives the grid of a window. Without it, the runtime's own network is used, with windows of ``channels``
    that are ``synchronised`` with the grid's phase or not. ``tick`` is that of the runtime's settings, s. The object
    serves one run only, because the runtime has a state. ``answers`` are those of the runtime, in order.
    """

    def __init__(
        self,
        runtime: Runtime,
        *,
        estimate: GridEstimate | None = None,
        channels: str = "phase_a",
        synchronised: bool = False,
        update_period: float = 20e-3,
        sample_interval: float = 200e-6,
        tick: float = 1e-6,
    ) -> None:
        self._runtime, self._estimate = runtime, estimate
        self._channels, self._synchronised = channels, synchronised
        self._period, self._interval, self._tick = update_period, sample_interval, tick
        self.answers: list[Answer] = []

    @property
    def update_period(self) -> float:
        """Time between two updates, s."""
        return self._period

    @property
    def sample_interval(self) -> float:
        """Spacing of a window's samples, s."""
        return self._interval

    @property
    def grid(self) -> Grid:
        """The grid for which the present gains are made. The current limiter uses it."""
        return Grid(*self._runtime.grid)

    def first_gains(self) -> PowerLoopGains:
        """The runtime's present gains."""
        self.answers.clear()
        return self._runtime.gains

    def update(self, window: MeasuredWindow) -> PowerLoopGains:
        """The gains of the runtime after a window."""
        measured = (window.P, window.Q, window.V_rms, round(window.t_s / self._tick))
        self._runtime.tell(limited=window.limited > 0)
        if self._estimate is None:
            v, i = window_channels(window, self._channels, self._synchronised)
            answer = self._runtime.update(v, i, *measured)
        else:
            grid = self._estimate(window)
            answer = self._runtime.hold(*measured) if grid is None else self._runtime.update_estimate(*grid, *measured)
        self.answers.append(answer)
        return answer.gains


def true_grid(timeline: Timeline) -> GridEstimate:
    """Returns an estimator without error: it gives the true grid at the end of a window, or None without a grid."""

    def estimate(window: MeasuredWindow) -> tuple[float, float] | None:
        grid = timeline.true_grid_at(window.t_s - 0.5 * window.sample_interval)
        return None if math.isnan(grid.R_g) else (grid.R_g, grid.L_g)

    return estimate
