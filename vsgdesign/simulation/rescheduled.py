"""New gains within a run, with what they do to the power loops: of a table's scheduler, and of a closed form."""

from __future__ import annotations

from typing import Any

from vsgdesign.equations.notation import Count
from vsgdesign.equations.power_flow import scheduled_jacobian
from vsgdesign.equations.power_loops import PowerLoopGains, References, gain_transfer
from vsgdesign.equations.scheduled_gains import grid_at, normalised_at
from vsgdesign.equations.scheduler_data import (
    ScheduleLaw,
    SchedulerInput,
    SchedulerLimits,
    SchedulerState,
    ScheduleTable,
)
from vsgdesign.equations.scheduling import told_and_updated


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
