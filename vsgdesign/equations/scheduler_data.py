"""The data of the gain scheduler: its table, its limits, its state, and the bits and reasons of an answer.

docs/theory/runtime.md derives the guards.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from vsgdesign.equations.notation import Count, Numbers
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
    """:func:`vsgdesign.equations.scheduled_gains.normalised_at`. Python remembers its last results."""
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
