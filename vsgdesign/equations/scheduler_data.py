"""The data of the gain scheduler: its table, its limits, its state, and the bits and reasons of an answer; and the
gains of a place in the table: coordinates, interpolation (:eq:`bilinear`), structure.

docs/theory/runtime.md derives the guards.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.notation import Count, Numbers
from vsgdesign.equations.power_flow import scheduled_jacobian
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import NormalisedGains

FRESH, HELD, CLAMPED, LIMITED, FALLBACK, REFUSED, DOUBT, PARTLY = 1, 2, 4, 8, 16, 32, 64, 128
"""Bits of a status. Every answer is either fresh (an estimate was accepted) or held (no estimate was accepted)."""

TOLD_LIMITED, TOLD_SURPRISED, TOLD_CHANGED = 1, 2, 4
"""Bits of what a scheduler is told with an update: since the last one the converter limited its current, or the
estimator or anything else was surprised, or the estimator decided that the grid has changed. All mean that the place
may not be that of the grid. The last one stays set until an estimate is accepted."""

SURPRISED_BEFORE = 8
"""Bit of the state: the last update was told TOLD_SURPRISED, so that the same again is no new surprise."""

NO_REASON, TIME, NOT_FINITE, RANGE, SATURATED, NO_ESTIMATE, IMPLAUSIBLE, JUMP, UNDESIGNED = range(9)
"""Reasons why an estimate was not accepted. The reason is that of the first guard that refused it."""

NO_DESIGN = -1.0
"""k_1 or H of a node without a design."""


class ScheduleTable(NamedTuple):
    """Normalised gains over SCR and R/X, and the converter for which they are made."""

    scr: Numbers
    """Nodes of SCR on the table's basis, ascending."""
    r_over_x: Numbers
    """Nodes of R/X, ascending."""
    nodes: Numbers
    """k_1 or H, d_1 or zeta, k_2, q, share_P, share_Q of each node in SI: the nodes of R/X of the first SCR, then those
    of the next. NO_DESIGN where there is no design."""
    Z_base: Any
    """Base impedance, Ω."""
    omega: Any
    """Nominal angular frequency, rad/s."""
    R_2: Any
    """Resistance of the filter's grid side, Ω."""
    L_2: Any
    """Inductance of the filter's grid side, H."""
    S_rated: Any
    """Rated power, VA."""
    D_p: Any
    """P–f droop, W·s/rad; 0 where the gains determine it."""
    D_q: Any
    """Q–V droop, var/V; 0 where the gains determine it."""
    V_n: Any
    """Voltage that is assumed before the first measurement, V phase rms."""


class ScheduleLaw(NamedTuple):
    """What is known of a schedule before it runs: functions of its SCR's basis and of its structure."""

    scr: Callable[[Any, Any, Any, Any], Any]
    """SCR of R_g, L_g, Z_base and omega."""
    grid: Callable[[Any, Any, Any, Any], tuple[Any, Any]]
    """R_g and L_g of SCR, X/R, Z_base and omega."""
    normalised: Callable[[ScheduleTable, Any, Any], tuple[NormalisedGains, Count]]
    """:func:`vsgdesign.equations.scheduler_data.normalised_at`. Python remembers its last results."""
    gains: Callable[..., PowerLoopGains]
    """Gains of the structure from the Jacobian and the normalised gains."""
    by_inertia: bool
    """Whether the law is ``inertia``."""


class SchedulerLimits(NamedTuple):
    """Limits of a scheduler. Single precision holds every one of them as it is."""

    scr_low: Any
    """Least SCR of the certified box."""
    scr_high: Any
    """Largest SCR of the certified box."""
    r_over_x_low: Any
    """Least R/X of the certified box."""
    r_over_x_high: Any
    """Largest R/X of the certified box."""
    P_low: Any
    """Least active power of the certified box, W."""
    P_high: Any
    """Largest active power of the certified box, W."""
    Q_low: Any
    """Least reactive power of the certified box, var."""
    Q_high: Any
    """Largest reactive power of the certified box, var."""
    V_low: Any
    """Least voltage of the certified box, V phase rms."""
    V_high: Any
    """Largest voltage of the certified box, V phase rms."""
    R_g_low: Any
    """Least plausible resistance, Ω."""
    R_g_high: Any
    """Largest plausible resistance, Ω."""
    L_g_low: Any
    """Least plausible inductance, H."""
    L_g_high: Any
    """Largest plausible inductance, H."""
    power_range: Any
    """Largest magnitude of P and Q that can be measured, VA."""
    voltage_range: Any
    """Largest voltage that can be measured, V."""
    safe_scr: Any
    """SCR of the safe place (:eq:`safe-place`)."""
    safe_r_over_x: Any
    """R/X of the safe place."""
    rate_per_tick: Any
    """Largest relative change of SCR and of R/X of the place of the gains in a tick."""
    hysteresis: Any
    """Relative change of SCR and R/X up to which an estimate does not move the goal."""
    jump: Any
    """Relative change from which on an estimate must be confirmed."""
    ratio_floor: Any
    """Where R/X is smaller than this, its changes are taken relative to this value."""
    error_R: Any
    """Error of R for which the gains are designed, as a share of R."""
    error_X: Any
    """Error of X for which the gains are designed, as a share of X."""
    error_Z: Any
    """Error of R and of X for which the gains are designed, as a share of the impedance."""
    confirm: Count
    """Number of windows that must agree on a jump."""
    update_ticks: Count
    """Nominal time between two updates, ticks."""
    longest_ticks: Count
    """Longest time for which a single update may move the place, ticks."""
    stale_ticks: Count
    """How long a doubt may last before the place moves to the safe place, ticks."""
    lost_ticks: Count
    """Age of the last good estimate from which on the place moves to the safe place without any doubt, ticks."""


class SchedulerState(NamedTuple):
    """Everything, besides its inputs, on which the next answer depends."""

    started: Count
    """Whether there was an update: 0 until the first one."""
    ticks: Count
    """The caller's counter at the last update, ticks."""
    age: Count
    """Time since the last estimate that was followed, ticks."""
    doubt: Count
    """Time since the grid may have changed, or since the last surprise, without an estimate that was followed. 0:
    there is no doubt, ticks."""
    told: Count
    """What was told since the last update: bits of TOLD_LIMITED, TOLD_SURPRISED and TOLD_CHANGED. The last one stays
    until an estimate is accepted. SURPRISED_BEFORE is kept here, too."""
    agreed: Count
    """Windows that agree on a jump so far. While a confirmed jump is followed in part, it stays at their limit."""
    refuted: Count
    """Time since the estimator decided that the grid has left its place. 0: that place may be returned to, ticks."""
    scr: Any
    r_over_x: Any
    """The place for which the gains are made."""
    goal_scr: Any
    goal_r_over_x: Any
    """The goal: the place to which the present place moves."""
    candidate_scr: Any
    candidate_r_over_x: Any
    """A jump that waits to be confirmed, or is followed in part."""
    left_scr: Any
    left_r_over_x: Any
    """The place that the grid has left."""
    P: Any
    """Last good active power, within the box, W."""
    Q: Any
    """Last good reactive power, within the box, var."""
    V_rms: Any
    """Last good voltage, within the box, V phase rms."""
    gains: PowerLoopGains


class SchedulerInput(NamedTuple):
    """What an update is given."""

    said: Count
    """The reason why there is no estimate; NO_REASON: there is one."""
    R_g: Any
    """The estimate of the grid's resistance, Ω."""
    L_g: Any
    """The estimate of the grid's inductance, H."""
    has_error: Count
    """1 where the covariance of the estimate's error is known, else 0."""
    var_R: Any
    """Variance of R_g, Ω²."""
    cov_RL: Any
    """Covariance of R_g and L_g, Ω·H."""
    var_L: Any
    """Variance of L_g, H²."""
    P: Any
    """Active power of the power loops, W."""
    Q: Any
    """Reactive power of the power loops, var."""
    V_rms: Any
    """Voltage of the power loops, V phase rms."""
    ticks: Count
    """The caller's counter, ticks."""


def place_of(table: ScheduleTable, R_g: Any, L_g: Any, law: ScheduleLaw) -> tuple[Any, Any]:
    """Returns (scr, r_over_x) of a grid with L_g > 0 (:eq:`scr`)."""
    scr = law.scr(R_g, L_g, table.Z_base, table.omega)
    return scr, R_g / (table.omega * L_g)


def grid_at(table: ScheduleTable, scr: Any, r_over_x: Any, law: ScheduleLaw) -> tuple[Any, Any]:
    """Returns (R_g, L_g) of a place in Ω and H (:eq:`scr`)."""
    R_g, L_g = law.grid(scr, 1.0 / r_over_x, table.Z_base, table.omega)
    return R_g, L_g


def interval(axis: Numbers, value: Any) -> tuple[Count, Count, Any]:
    """Returns (low, high, fraction): between which nodes of an axis a value is, and how far on the way.

    Beyond the ends it is at the end. An axis with one node has this node for every value.
    """
    low = np.minimum(np.maximum(np.searchsorted(axis, value, side="right"), 1), np.maximum(len(axis), 2) - 1) - 1
    high = np.minimum(low + 1, len(axis) - 1)
    width = axis[high] - axis[low] if high > low else 1.0
    inside = np.clip(value, axis[0], axis[len(axis) - 1])
    return low, high, (inside - axis[low]) / width


class Corners(NamedTuple):
    """The corners of the cell around a place: where their numbers begin, and their weights (:eq:`bilinear`)."""

    low_low: Count
    low_high: Count
    high_low: Count
    high_high: Count
    """The first word is the row, the second the column."""
    w00: Any
    w01: Any
    w10: Any
    w11: Any
    """Weights in the same order."""


def blend(nodes: Numbers, at: Corners, column: Count) -> Any:
    """The weighted sum of the corners in a column of the table (:eq:`bilinear`)."""
    low = at.w00 * nodes[at.low_low + column] + at.w01 * nodes[at.low_high + column]
    return (low + at.w10 * nodes[at.high_low + column]) + at.w11 * nodes[at.high_high + column]


def outside(nodes: Numbers, corner: Count, weight: Any) -> bool:
    """Whether a corner has a weight, but no design."""
    return nodes[corner] < 0.0 and weight > 0.0


def normalised_at(table: ScheduleTable, scr: Any, r_over_x: Any) -> tuple[NormalisedGains, Count]:
    """Returns (normalised, designed) at a place (:eq:`bilinear`). designed is 0 where a node with a weight has no
    design; then the first result means nothing."""
    row, next_row, r = interval(table.scr, scr)
    column, next_column, c = interval(table.r_over_x, r_over_x)
    r_left, c_left = 1.0 - r, 1.0 - c
    w00, w01, w10, w11 = r_left * c_left, r_left * c, r * c_left, r * c
    columns, nodes = len(table.r_over_x), table.nodes
    a, b = (row * columns + column) * 6, (row * columns + next_column) * 6
    d, e = (next_row * columns + column) * 6, (next_row * columns + next_column) * 6
    at = Corners(a, b, d, e, w00, w01, w10, w11)
    normalised = NormalisedGains(
        k_1_or_H=blend(nodes, at, 0),
        d_1_or_zeta=blend(nodes, at, 1),
        k_2=blend(nodes, at, 2),
        q=blend(nodes, at, 3),
        share_P=blend(nodes, at, 4),
        share_Q=blend(nodes, at, 5),
    )
    low = outside(nodes, a, w00) or outside(nodes, b, w01)
    high = outside(nodes, d, w10) or outside(nodes, e, w11)
    designed = 0 if low or high else 1
    return normalised, designed


def gains_at(
    table: ScheduleTable,
    normalised: NormalisedGains,
    scr: Any,
    r_over_x: Any,
    P: Any,
    Q: Any,
    V_rms: Any,
    law: ScheduleLaw,
) -> PowerLoopGains:
    """Gains on the grid of a place at measured powers and voltage (:eq:`structure-gains`). Returns (gains)."""
    R_g, L_g = grid_at(table, scr, r_over_x, law)
    R, X = R_g + table.R_2, table.omega * (L_g + table.L_2)
    A, B, C, D = scheduled_jacobian(P, Q, V_rms, R, X)
    return law.gains(A, B, C, D, normalised, table.D_p, table.D_q, table.S_rated, table.omega, law.by_inertia)
