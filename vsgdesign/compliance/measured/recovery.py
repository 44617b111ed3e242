"""Whether and when the converter is at rest again."""

from __future__ import annotations

import numpy as np

from vsgdesign.compliance.measuring import Measured, MeasureInput, measure, not_known
from vsgdesign.metrics.step_response import SETTLING_BAND, cycle_mean, settling_time


@measure("survived", "", "1 if the converter is at its new rest in time and stays there, 0 if not.", of_trace=False)
def survived(run: MeasureInput) -> Measured:
    """:func:`vsgdesign.metrics.survival.judge_survival` decides."""
    if run.survival is None:
        return not_known("the run was not judged")
    if not run.survival.judged:
        return not_known(run.survival.reason or run.survival.status)
    return Measured(float(run.survival.survived), run.survival.reason or "")


@measure(
    "recovery time",
    "s",
    "Time from the end of the disturbance until the means of P and Q stay at the new rest.",
    of_trace=False,
)
def recovery_s(run: MeasureInput) -> Measured:
    """The means are those over a cycle, and the band is 2 % of the rating, as the survival judge has them."""
    if run.survival is None:
        return not_known("the run was not judged")
    if run.survival.recovery_s is None:
        return not_known(run.survival.reason or run.survival.status)
    return Measured(run.survival.recovery_s, plus_minus=run.step_s)


@measure(
    "settling time of P",
    "s",
    "Time from the end of the disturbance until the one-cycle mean of P stays within 2 % of the rating of its value at "
    "the end.",
)
def settling_s(run: MeasureInput, band_pu: float = SETTLING_BAND) -> Measured:
    """The value at the end is the mean of the last cycles, up to a tenth of the trace after the disturbance."""
    after = run.rows(run.cleared_s)
    mean = cycle_mean(run.trace.P_pu, run.rows_per_cycle)[after]
    if len(mean) < 2 * run.rows_per_cycle:
        return not_known("the trace ends less than two cycles after the disturbance")
    found = settling_time(run.trace.t_s[after] - run.cleared_s, np.abs(mean - run.end(run.trace.P_pu)), band_pu)
    if found is None:
        return not_known("P has not settled at the end of the trace")
    return Measured(found, plus_minus=run.step_s)


@measure(
    "overshoot of P",
    "pu",
    "How far the one-cycle mean of P goes beyond its final value, seen from where it was when the disturbance ended.",
)
def overshoot_pu(run: MeasureInput) -> Measured:
    """The final value is as in ``settling_s``. If P is within 2 % of the rating of it when the disturbance ends, there
    is no step, and the largest distance either way counts."""
    after = run.rows(run.cleared_s)
    mean = cycle_mean(run.trace.P_pu, run.rows_per_cycle)[after]
    if len(mean) < 2 * run.rows_per_cycle:
        return not_known("the trace ends less than two cycles after the disturbance")
    beyond = mean - run.end(run.trace.P_pu)
    if abs(beyond[0]) <= SETTLING_BAND:
        return Measured(float(np.max(np.abs(beyond))))
    return Measured(max(float(np.max(-np.sign(beyond[0]) * beyond)), 0.0))


RECOVERY = (survived, recovery_s, settling_s, overshoot_pu)
