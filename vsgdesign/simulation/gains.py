"""The gains of a study's controller over time: fixed ones, or ones scheduled from the true grid impedance."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.power_loops import PowerLoopGains, References, gain_transfer
from vsgdesign.errors import InfeasibleStudyError, NoOperatingPointError
from vsgdesign.identification import Probe
from vsgdesign.runtime.floats import on_floats
from vsgdesign.runtime.of_study import follows_measured, schedule_of
from vsgdesign.runtime.schedule import Schedule
from vsgdesign.simulation.field_observer import FieldMemory, HeldProbe
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
