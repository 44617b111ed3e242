"""What the converter's current does: its peaks, and how long it is above or at its limit."""

from __future__ import annotations

import numpy as np

from vsgdesign.compliance.measuring import Measured, MeasureInput, measure, not_known

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
