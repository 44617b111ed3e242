"""The largest and smallest frequency and voltage, the rate of change of frequency, and what the dc link gives."""

from __future__ import annotations

import numpy as np

from vsgdesign.compliance.measuring import Measured, MeasureInput, measure, not_known
from vsgdesign.metrics.step_response import cycle_mean


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
    "energy of the dc link",
    "pu·s",
    "Largest energy that the dc link has given beyond its power before the first event, or has taken, whichever is "
    "larger in magnitude (taken is negative).",
)
def energy_pu_s(run: MeasureInput) -> Measured:
    """∫(P_dc − P_dc before) dt; what storage behind a constant infeed must hold (:eq:`storage-energy`)."""
    first = run.first_row(run.first_s)
    extra = run.trace.P_dc_pu[first + 1 :] - run.rest_before(run.trace.P_dc_pu, run.first_s)
    energy = np.cumsum(extra) * run.step_s
    return Measured(float(energy[np.argmax(np.abs(energy))]))


@measure(
    "peak power of the dc link", "pu", "Largest power that the dc link gives, as a mean over a row, after the event."
)
def P_dc_peak_pu(run: MeasureInput) -> Measured:
    """Over the rating."""
    return Measured(float(np.max(run.trace.P_dc_pu[run.first_row(run.first_s) + 1 :], initial=-np.inf)))


EXTREMES = (f_min_hz, f_max_hz, rocof_hz_s, energy_pu_s, P_dc_peak_pu)
