"""How soon the converter responds, with which impedance, when it is at rest again; the largest and smallest current,
frequency and voltage; and what the dc link gives."""

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


_ABOVE = 1.05
"""A current is above its limit from this share of the limit on: the limiter itself is not exact."""


@measure("peak phase current", "pu", "Largest magnitude of a phase current of the bridge from the first event on.")
def peak_pu(run: MeasureInput) -> Measured:
    """Over the rated peak; every sample counts, because a row holds the largest of its interval."""
    return Measured(float(np.max(run.trace.i_phase_pu[run.rows(run.first_s)], initial=0.0)))


@measure(
    "peak phase current after 5 ms",
    "pu",
    "Largest magnitude of a phase current of the bridge later than 5 ms after each event.",
)
def peak_after_5ms_pu(run: MeasureInput, after_s: float = 5e-3) -> Measured:
    """No sampled loop acts at once, so that the first milliseconds belong to the filter alone."""
    late = np.ones(len(run.trace.t_s), dtype=bool)
    late[: run.first_row(run.first_s)] = False
    for event_s in run.events_s:
        # A row holds the largest since the row before, so the row right after the end belongs to both.
        late[run.first_row(event_s) : run.first_row(event_s + after_s) + 1] = False
    if not late.any():
        return not_known(f"the trace ends within {1e3 * after_s:g} ms of the last event")
    return Measured(float(np.max(run.trace.i_phase_pu[late])))


@measure("time above the limit", "s", "Time for which a phase current is above 1.05 times the limit.")
def above_limit_s(run: MeasureInput, share: float = _ABOVE) -> Measured:
    """A row counts with its whole interval, so it is the upper end of what may be."""
    limit = run.ratings.i_limit_pu
    if limit is None:
        return not_known("the converter has no current limit")
    above = run.trace.i_phase_pu[run.rows(run.first_s)] > share * limit
    begins = int(np.sum(above[1:] & ~above[:-1])) + int(above[:1].sum())
    return Measured(float(np.sum(above)) * run.step_s, plus_minus=2.0 * begins * run.step_s)


@measure("time in the limiter", "s", "Time for which the current limiter acts after the first event.")
def limited_s(run: MeasureInput) -> Measured:
    """Sum of the limiter's share of each interval."""
    first = run.first_row(run.first_s)
    return Measured(float(np.sum(run.trace.limited[first + 1 :])) * run.step_s)


CURRENTS = (peak_pu, peak_after_5ms_pu, above_limit_s, limited_s)


@measure("lowest frequency", "Hz", "Lowest frequency of the converter's frame from the first event on.")
def f_min_hz(run: MeasureInput) -> Measured:
    """Not filtered: what the converter itself imposes."""
    return Measured(float(np.min(run.trace.f_hz[run.rows(run.first_s)], initial=np.inf)))


@measure("highest frequency", "Hz", "Highest frequency of the converter's frame from the first event on.")
def f_max_hz(run: MeasureInput) -> Measured:
    """Not filtered: what the converter itself imposes."""
    return Measured(float(np.max(run.trace.f_hz[run.rows(run.first_s)], initial=-np.inf)))


@measure(
    "rate of change of frequency", "Hz/s", "Largest change of the frame's frequency within a window, over the window."
)
def rocof_hz_s(run: MeasureInput, window_s: float = 0.1) -> Measured:
    """(f(t) − f(t − window))/window of the one-cycle mean, from the first event on."""
    lag = max(round(window_s / run.step_s), 1)
    rows = run.rows(run.first_s)
    f = cycle_mean(run.trace.f_hz, run.rows_per_cycle)[max(rows.start - 1, 0) :]
    if len(f) <= lag:
        return not_known(f"the trace is shorter than the window of {window_s:g} s")
    return Measured(float(np.max(np.abs(f[lag:] - f[:-lag]))) / (lag * run.step_s))


@measure(
    "energy given by the dc link",
    "pu·s",
    "Largest energy that the dc link has given beyond its power before the first event, at any instant after it.",
)
def energy_given_pu_s(run: MeasureInput) -> Measured:
    """max ∫(P_dc − P_dc before) dt; what storage behind a constant infeed must give (:eq:`storage-energy`)."""
    return Measured(max(float(np.max(run.once(_energy), initial=0.0)), 0.0))


@measure(
    "energy taken by the dc link",
    "pu·s",
    "Largest energy that the dc link has taken beyond its power before the first event, at any instant after it.",
)
def energy_taken_pu_s(run: MeasureInput) -> Measured:
    """max −∫(P_dc − P_dc before) dt; what storage behind a constant infeed must take (:eq:`storage-energy`)."""
    return Measured(max(float(-np.min(run.once(_energy), initial=0.0)), 0.0))


def _energy(run: MeasureInput) -> NDArray[np.float64]:
    """∫(P_dc − P_dc before) dt at each row after the first event, pu·s."""
    first = run.first_row(run.first_s)
    extra = run.trace.P_dc_pu[first + 1 :] - run.rest_before(run.trace.P_dc_pu, run.first_s)
    return np.cumsum(extra) * run.step_s


@measure(
    "peak power of the dc link",
    "pu",
    "Largest power that the dc link gives, as a mean over a row, after the event.",
    values=(-10.0, 10.0),
)
def P_dc_peak_pu(run: MeasureInput) -> Measured:
    """Over the rating."""
    return Measured(float(np.max(run.trace.P_dc_pu[run.first_row(run.first_s) + 1 :], initial=-np.inf)))


EXTREMES = (f_min_hz, f_max_hz, rocof_hz_s, energy_given_pu_s, energy_taken_pu_s, P_dc_peak_pu)
