"""The gains of a study's controller: its schedule, and the one law from which every page and every run takes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.runtime.guards import SchedulerSettings, settings_of
from vsgdesign.runtime.schedule import Schedule, closed_form_schedule
from vsgdesign.runtime.table import TableSchedule, table_schedule

if TYPE_CHECKING:  # the controller does not read study files
    from vsgdesign.study.parameters.study import ControllerSpec, Study


def schedule_of(study: Study, spec: ControllerSpec, ready: Ready = NOTHING) -> Schedule:
    """The schedule of a controller: that of its table if it has one, otherwise the closed form.

    Raises InfeasibleStudyError if the controller needs a table that is not in ``ready``.
    """
    table = ready.table(spec)
    return closed_form_schedule(study, spec.target) if table is None else table_schedule(table)


def follows_measured(spec: ControllerSpec) -> bool:
    """Whether the gains follow the measured P, Q and V. Those of a table always do; a closed form may ask for it."""
    return spec.kind == "scheduled" and (spec.schedule == "table" or spec.target.follow_references)


@dataclass(frozen=True)
class ControllerGains:
    """The gains of one controller in the steady state, as a function of the grid and the operating point.

    The arguments are arrays or scalars that broadcast: estimated R_g (Ω) and L_g (H), and P (W), Q (var) and V (phase
    rms, V) at the control point. Fixed gains ignore them all. A closed form at its design point ignores P, Q and V
    (:eq:`structure-gains` at P_design, Q_design). All other gains are computed as in the runtime: the place, the powers
    and the voltage of a table are clipped to the box of its scheduler, then gains are made at the measured P, Q and V
    (:eq:`drawn-in`, :eq:`well-posed`). The result is NaN where there are no gains. Gains are held between two updates,
    so a linear model takes them as constants.
    """

    schedule: Schedule
    fixed: PowerLoopGains | None = None
    measured: bool = False
    settings: SchedulerSettings | None = None
    """Settings of the scheduler of a table. With None nothing is clipped."""

    def __call__(self, R_g: Any, L_g: Any, P: Any, Q: Any, V_rms: Any) -> PowerLoopGains:
        if self.fixed is None and self.measured and self.settings is None and type(R_g) is type(P) is float:
            # What a run asks every 20 ms.
            return self.schedule.gains_of_floats(R_g, L_g, P, Q, V_rms)
        given = [np.asarray(value, dtype=float) for value in (R_g, L_g, P, Q, V_rms)]
        R_g, L_g, P, Q, V_rms = np.broadcast_arrays(*given)
        if self.fixed is not None:
            return PowerLoopGains(*(np.full(R_g.shape, float(value)) for value in self.fixed))
        if not self.measured:
            found = self.schedule.gains_over(R_g, L_g)
        elif self.settings is None or not isinstance(self.schedule, TableSchedule):
            found = self.schedule.gains_measured(R_g, L_g, P, Q, V_rms)
        else:
            c = self.settings
            R_g, L_g, designed = self.schedule.drawn_to(R_g, L_g, c.scr, c.r_over_x)
            P, Q, V_rms = np.clip(P, *c.P), np.clip(Q, *c.Q), np.clip(V_rms, *c.V_rms)
            keep = np.where(designed, 1.0, np.nan)
            found = self.schedule.gains_measured(R_g, L_g, P, Q, V_rms)
            found = PowerLoopGains(*(value * keep for value in found))
        return PowerLoopGains(*(np.broadcast_to(np.asarray(value, dtype=float), R_g.shape) for value in found))

    @property
    def why_none(self) -> str:
        """The reason why there are no gains, in words."""
        if self.measured:
            return "no gains: the table has no design there" if self.settings else "no gains: the estimate is no grid"
        return "no gains: the design point does not exist on this grid"


def gain_law(study: Study, spec: ControllerSpec, ready: Ready = NOTHING) -> ControllerGains:
    """The gains of a controller of the study for a known or estimated grid and measured powers.

    Raises the errors of :func:`schedule_of`, and NoOperatingPointError for fixed gains whose design grid cannot carry
    the powers of the design point.
    """
    schedule = schedule_of(study, spec, ready)
    if spec.kind == "fixed":
        grid = spec.design_grid or study.grid
        return ControllerGains(schedule, spec.gains or schedule.gains(grid.R_g, grid.L_g))
    table = ready.table(spec)
    return ControllerGains(schedule, None, follows_measured(spec), None if table is None else settings_of(table))
