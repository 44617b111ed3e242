"""What a converter gives when the grid's phase or frequency changes: power at once, inertia, droop."""

from __future__ import annotations

import numpy as np

from vsgdesign.campaigns.compliance.measuring import LOST, Measured, MeasureInput, measure, not_known
from vsgdesign.metrics.inertia import RampFit, fit_ramp
from vsgdesign.metrics.step_response import cycle_mean
from vsgdesign.study.parameters.event import Event

_MISFIT = 0.02
"""Largest share of ΔP that an inertia and a droop may leave unexplained."""

_SPREAD = 0.25
"""Largest distance of two fits of H from each other, over H."""

_NO_DROOP = 1e-3
"""A change of P by less than this, in pu, says nothing of a droop."""


@measure(
    "power after a jump",
    "pu",
    "Largest change of the one-cycle mean of P after the first jump of the grid's phase or change of its frequency, "
    "positive if it opposes the change.",
    values=(-10.0, 10.0),
)
def dP_pu(run: MeasureInput, within_s: float = 0.1) -> Measured:
    """A grid that falls back in phase or frequency is opposed by more power."""
    found = run.event_with(lambda event: event.phase_deg != 0.0 or _frequency_changes(run, event))
    if found is None:
        return not_known("the test has no jump of the phase and no change of the frequency")
    event, _ = found
    sense = event.phase_deg or (event.df_hz or 0.0) - (run.grid_hz(event.t_s) - run.ratings.f_n_hz)
    rows = run.rows(event.t_s, event.t_s + within_s + 0.5 * run.step_s)
    mean = cycle_mean(run.trace.P_pu, run.rows_per_cycle)[rows]
    if mean.size == 0:
        return not_known("the trace ends before the event")
    return Measured(float(np.max(-np.sign(sense) * (mean - run.rest_before(run.trace.P_pu, event.t_s)))))


@measure(
    "inertia constant",
    "s",
    "H for which ΔP = −(2H/f_n)·df/dt besides the droop's power, fitted to P and the converter's frequency during and "
    "after the first ramp of the grid's frequency.",
    values=(-1e3, 1e3),
)
def H_s(run: MeasureInput) -> Measured:
    """The project's one definition of H (:eq:`effective-inertia`), as :eq:`ramp-fit` finds it in the trace."""
    fit = run.once(_ramp_fit)
    return not_known(fit) if isinstance(fit, str) else Measured(fit.H_s, plus_minus=fit.spread_s)


@measure(
    "inertial power",
    "pu",
    "Power that the inertia gives while the grid's frequency falls (or takes while it rises) at the rate of the first "
    "ramp: 2H/f_n times the rate, positive if it opposes the ramp.",
    values=(-10.0, 10.0),
)
def inertial_power_pu(run: MeasureInput) -> Measured:
    """H is that of ``H_s``; the power of the droop is not in it."""
    fit, ramp = run.once(_ramp_fit), run.event_with(lambda event: _ramps(run, event))
    if isinstance(fit, str) or ramp is None:
        return not_known(str(fit))
    event = ramp[0]
    rate = abs((event.df_hz or 0.0) + run.ratings.f_n_hz - run.grid_hz(event.t_s)) / event.over
    per_H = 2.0 * rate / run.ratings.f_n_hz
    return Measured(per_H * fit.H_s, plus_minus=per_H * fit.spread_s)


@measure(
    "droop of the frequency",
    "pu",
    "Change of the frequency over the change of P that it causes at rest, both per unit, for the first change of the "
    "grid's frequency; the deviation that changes P by the rating.",
    values=(-10.0, 10.0),
    void=LOST,
)
def droop_pu(run: MeasureInput, band_pu: float = 0.005) -> Measured:
    """(:eq:`measured-droop`). Rest: the one-cycle mean of P stays within the band for the last fifth of the time."""
    found = run.event_with(lambda event: _frequency_changes(run, event))
    if found is None:
        return not_known("the test has no change of the frequency")
    event, end_s = found
    # The last row would belong to the next event already.
    rows = run.rows(event.t_s + event.over, end_s)
    if rows.stop - rows.start < 10 * run.rows_per_cycle:
        return not_known("less than ten cycles follow the change of the frequency")
    last = slice(rows.stop - max((rows.stop - rows.start) // 5, run.rows_per_cycle), rows.stop)
    P = cycle_mean(run.trace.P_pu, run.rows_per_cycle)[last]
    if float(np.ptp(P)) > 2.0 * band_pu:
        return not_known("P has not come to rest after the change of the frequency")
    if run.limiter_acts(last):
        return not_known("the current limiter acts at the new rest, so that P is the limit's and not the droop's")
    cycle = slice(last.stop - run.rows_per_cycle, last.stop)
    dP = float(P[-1]) - run.rest_before(run.trace.P_pu, event.t_s)
    df = float(np.mean(run.trace.f_hz[cycle])) - run.rest_before(run.trace.f_hz, event.t_s)
    if abs(dP) < _NO_DROOP:
        return not_known(f"P does not change by {_NO_DROOP:g} pu: there is no droop")
    return Measured(-df / run.ratings.f_n_hz / dP)


def _frequency_changes(run: MeasureInput, event: Event) -> bool:
    return event.df_hz is not None and event.df_hz != run.grid_hz(event.t_s) - run.ratings.f_n_hz


def _ramps(run: MeasureInput, event: Event) -> bool:
    return _frequency_changes(run, event) and event.over > 0.0


def _ramp_fit(run: MeasureInput) -> RampFit | str:
    """The fit of the first ramp of the frequency, or why there is none."""
    ramp = run.event_with(lambda event: _ramps(run, event))
    if ramp is None:
        return "the test has no ramp of the frequency"
    event, end_s = ramp
    rows = run.rows(event.t_s, end_s)
    trace, rest = run.trace, (run.rest_before(run.trace.P_pu, event.t_s), run.rest_before(run.trace.f_hz, event.t_s))
    fit = fit_ramp(
        trace.P_pu[rows],
        trace.Q_pu[rows],
        trace.V_pu[rows],
        trace.f_hz[rows],
        run.step_s,
        run.ratings.f_n_hz,
        run.rows_per_cycle,
        rest,
        run.ratings.lag_P_s,
        trace.limited[rows] > 0.0,
    )
    if fit is None:
        limited = run.limiter_acts(rows)
        return "the current limiter acts nearly all the time" if limited else "the trace is too short, or nothing moves"
    if not fit.misfit <= _MISFIT:
        return f"an inertia and a droop leave {100.0 * fit.misfit:.2g} % of the change of P unexplained"
    if not fit.spread_s <= _SPREAD * abs(fit.H_s):
        return (
            f"the ramp does not tell H from the converter's other responses: fits give {fit.H_s:.3g} s and "
            f"{fit.spread_s:.2g} s more or less"
        )
    return fit


FREQUENCY = (dP_pu, H_s, inertial_power_pu, droop_pu)
