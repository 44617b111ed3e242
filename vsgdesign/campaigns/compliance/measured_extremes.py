"""The largest and smallest current, frequency and voltage, how fast the frequency moves, and what the dc link gives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsgdesign.campaigns.compliance.measuring import Measured, MeasureInput, measure, not_known
from vsgdesign.metrics.step_response import cycle_mean

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
