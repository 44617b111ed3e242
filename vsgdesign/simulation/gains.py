"""The gains of a study's controller over time: fixed ones, or ones scheduled from the true grid impedance."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError, NoOperatingPointError
from vsgdesign.parameters.grid import Grid
from vsgdesign.parameters.study import ControllerSpec, Study
from vsgdesign.runtime.of_study import follows_measured, schedule_of
from vsgdesign.runtime.schedule import Schedule
from vsgdesign.simulation.timeline import Timeline


@dataclass(frozen=True)
class GainChange:
    """Power-loop gains from t_s on, until the next change."""

    t_s: float
    gains: PowerLoopGains
    grid: Grid | None = field(default=None, compare=False)
    """The grid for which the gains are made; None for given gains, which belong to no grid."""


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
