"""How soon the converter responds, with which impedance, and when it is at rest again."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vsgdesign.campaigns.compliance.measuring import NO_FINAL_VALUE, Measured, MeasureInput, measure, not_known
from vsgdesign.metrics.step_response import SETTLING_BAND, cycle_mean, onset, phasor_change


@measure(
    "survived",
    "",
    "1 if the converter is at its new rest in time and stays there, 0 if not.",
    of_trace=False,
    values=(0.0, 1.0),
    yes_or_no=True,
)
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
    void=NO_FINAL_VALUE,
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
    void=NO_FINAL_VALUE,
)
def settling_s(run: MeasureInput, band_pu: float = SETTLING_BAND) -> Measured:
    """The value at the end is the mean of the last cycles, up to a tenth of the trace after the disturbance."""
    after = run.rows(run.cleared_s)
    mean = cycle_mean(run.trace.P_pu, run.rows_per_cycle)[after]
    if len(mean) < 2 * run.rows_per_cycle:
        return not_known("the trace ends less than two cycles after the disturbance")
    error = np.abs(mean - run.end(run.trace.P_pu))
    return run.settled(run.trace.t_s[after] - run.cleared_s, error, band_pu, "its value at the end")


@measure(
    "overshoot of P",
    "pu",
    "How far the one-cycle mean of P goes beyond its final value, seen from where it was when the disturbance ended.",
    void=NO_FINAL_VALUE,
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


_MOVES = 0.01
"""A swing of less than this, in pu, is none."""


@measure(
    "response of P",
    "ms",
    "Time from the first event until P has moved by a share (10 %) of its largest change within the next 50 ms.",
)
def response_ms(run: MeasureInput, share: float = 0.1, within_s: float = 0.05) -> Measured:
    """Interpolated between rows; the uncertainty is the interval of the trace."""
    return _onset(run, run.trace.P_pu - run.rest_before(run.trace.P_pu, run.first_s), "P", share, within_s)


@measure(
    "response of Q",
    "ms",
    "Time from the first event until Q has moved by a share (10 %) of its largest change within the next 50 ms.",
)
def response_Q_ms(run: MeasureInput, share: float = 0.1, within_s: float = 0.05) -> Measured:
    """As ``response_ms``."""
    return _onset(run, run.trace.Q_pu - run.rest_before(run.trace.Q_pu, run.first_s), "Q", share, within_s)


@measure(
    "response of the current",
    "ms",
    "Time from the first event until the current into the PCC, as a phasor, has moved by a share (10 %) of its largest "
    "change within the next 50 ms.",
)
def response_i_ms(run: MeasureInput, share: float = 0.1, within_s: float = 0.05) -> Measured:
    """Active and reactive current together: the length of the vector's change."""
    hz, t = run.grid_hz(run.first_s), run.trace
    rows = run.rows(run.first_s - 1.0 / hz, run.first_s + within_s + 2.0 * run.step_s)
    turned = (t.i_g_alpha_pu[rows] + 1j * t.i_g_beta_pu[rows]) * np.exp(-2j * math.pi * hz * t.t_s[rows])
    count = max(run.first_row(run.first_s) - rows.start, 1)
    change = np.zeros(len(t.t_s))
    change[rows] = np.abs(turned - np.mean(turned[:count]))
    return _onset(run, change, "the current", share, within_s)


@measure(
    "effective impedance",
    "pu",
    "Magnitude of the change of the PCC's voltage over the change of the current into it, as phasors in the first "
    "cycle after the first jump of the grid's phase.",
)
def Z_effective_pu(run: MeasureInput, begin_s: float = 0.0, end_s: float = 0.02) -> Measured:
    """(:eq:`effective-impedance`): the impedance behind which the converter's own voltage stands. ``begin_s`` and
    ``end_s`` are counted from the jump."""
    jump = run.event_with(lambda event: event.phase_deg != 0.0)
    if jump is None:
        return not_known("the test has no jump of the phase")
    event, after = jump
    if not end_s > begin_s:
        return not_known(f"end_s = {end_s:g} s is not later than begin_s = {begin_s:g} s")
    if event.t_s + end_s > after:
        return not_known("the next event comes before the end of the measurement")
    if run.limiter_acts(run.rows(event.t_s, event.t_s + end_s)):
        return not_known("the current limiter acts, so that the current is the limit's and not the impedance's")
    t, hz = run.trace, run.grid_hz(event.t_s)
    rows = run.rows(event.t_s - 1.5 / hz, event.t_s + end_s + 2.0 * run.step_s)
    window = (t.t_s[rows], hz, event.t_s, begin_s, end_s)
    dI = phasor_change(t.i_g_alpha_pu[rows] + 1j * t.i_g_beta_pu[rows], *window)
    dV = phasor_change(t.v_alpha_pu[rows] + 1j * t.v_beta_pu[rows], *window)
    if not abs(dI) > _MOVES:
        return not_known(
            "the trace has fewer than six rows in the window, or no cycle before the jump"
            if math.isnan(abs(dI))
            else f"the current changes by less than {_MOVES:g} pu"
        )
    return Measured(abs(-dV / dI + complex(run.ratings.R_2_pu, run.ratings.X_2_pu)))


def _onset(run: MeasureInput, change: NDArray[np.float64], what: str, share: float, within_s: float) -> Measured:
    """Onset of a change from its value before the first event."""
    first = run.first_row(run.first_s)
    rows = slice(max(first - 1, 0), run.first_row(run.first_s + within_s) + 1)
    since, part = (
        run.trace.t_s[rows] - run.first_s,
        np.where(run.trace.t_s[rows] < run.first_s - 1e-9, 0.0, change[rows]),
    )
    if since.size == 0 or since[-1] < within_s - 1.5 * run.step_s:
        return not_known(f"the trace ends within {1e3 * within_s:g} ms of the event")
    if not float(np.max(np.abs(part))) > _MOVES:
        return not_known(f"{what} moves by less than {_MOVES:g} pu")
    found = onset(since, part, share)
    return not_known(f"{what} does not move") if found is None else Measured(1e3 * found, plus_minus=1e3 * run.step_s)


RESPONSES = (response_ms, response_Q_ms, response_i_ms, Z_effective_pu)
