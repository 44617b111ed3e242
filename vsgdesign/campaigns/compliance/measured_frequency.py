"""What a converter gives when the grid's phase or frequency changes, and how it oscillates: power at once, inertia,
droop, modes, and how it follows the frequency over frequency."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vsgdesign.campaigns.compliance.measuring import LOST, Measured, MeasureInput, measure, not_known
from vsgdesign.metrics.oscillation import Oscillation, RampFit, dominant_oscillation, fit_ramp
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


LOW_HZ, HIGH_HZ = 0.1, 50.0
"""Where oscillations and the peak of the network frequency perturbation are looked for."""

_MOVES = 2e-3
"""Smallest oscillation of P that counts, pu."""

_MISFIT_OF_MODES = 0.2
"""Largest share of P that the modes may leave unexplained."""

_POINTS = 30
"""Frequencies of a search for the peak, which is repeated between the neighbours of the largest."""


@measure(
    "damping ratio of the oscillation",
    "",
    "Damping ratio of the oscillation of P that has the largest energy between 0.1 and 50 Hz after the disturbance; "
    "1 if P comes to rest without oscillating.",
    void=LOST,
)
def damping_ratio(run: MeasureInput) -> Measured:
    """By the matrix pencil (:eq:`matrix-pencil`), from when the disturbance is over and the limiter is silent."""
    found = run.once(_oscillation)
    if isinstance(found, str):
        return not_known(found)
    if found is None:
        return Measured(1.0, "P does not oscillate")
    return Measured(found.damping)


@measure("frequency of the oscillation", "Hz", "Frequency of the oscillation whose damping ratio is given.", void=LOST)
def oscillation_hz(run: MeasureInput) -> Measured:
    """That of the damped oscillation, Im s/2π."""
    found = run.once(_oscillation)
    if isinstance(found, str):
        return not_known(found)
    return not_known("P does not oscillate") if found is None else Measured(found.hz)


def _oscillation(run: MeasureInput) -> Oscillation | str | None:
    """The dominant oscillation; None: there is none; a text: why it is not known."""
    trace = run.trace
    begin = run.first_row(run.cleared_s) + 1
    limited = np.flatnonzero(trace.limited[begin:] > 0.0)
    if limited.size:
        begin += int(limited[-1]) + 1
    if len(trace.t_s) - begin < 10 * run.rows_per_cycle:
        late = " and the limiter has acted for the last time" if limited.size else ""
        return f"less than ten cycles follow after the disturbance{late}"
    if not np.isfinite(trace.P_pu[begin:]).all():
        return "the run diverged"
    values = trace.P_pu[begin:] - run.end(trace.P_pu)
    if float(np.max(np.abs(cycle_mean(values, run.rows_per_cycle)[run.rows_per_cycle :]))) < _MOVES:
        return f"P moves by less than {_MOVES:g} pu"
    found = dominant_oscillation(values, run.step_s, LOW_HZ, HIGH_HZ, 1.0 / run.ratings.f_n_hz)
    if found is None or found.amplitude < _MOVES:
        return None
    if not found.misfit <= _MISFIT_OF_MODES:
        return f"modes that decay or grow leave {100.0 * found.misfit:.2g} % of P unexplained"
    return found


@measure(
    "peak of the NFP",
    "dB",
    "Largest network frequency perturbation |ΔP/Δω| per unit between 0.1 and 50 Hz, from the linear model at the "
    "test's first grid and operating point.",
)
def nfp_peak_db(run: MeasureInput) -> Measured:
    """20 log₁₀ of ΔP over the rating per Δω over nominal (:eq:`nfp`)."""
    found = run.once(_nfp_peak)
    return not_known(found) if isinstance(found, str) else Measured(found[1])


@measure("frequency of the NFP's peak", "Hz", "Frequency at which the network frequency perturbation is largest.")
def nfp_at_hz(run: MeasureInput) -> Measured:
    """From the linear model."""
    found = run.once(_nfp_peak)
    return not_known(found) if isinstance(found, str) else Measured(found[0])


@measure(
    "peak of the NFP in the run",
    "dB",
    "Largest network frequency perturbation between 0.1 and 50 Hz as the trace shows it: the Fourier transform of P "
    "over that of the frequency deviation that the test imposes.",
)
def nfp_run_peak_db(run: MeasureInput, at_least_hz: float = 0.5) -> Measured:
    """(:eq:`nfp-in-time`). Only of a test that changes nothing but phase and frequency, and without the limiter."""
    found = run_nfp(run)
    if isinstance(found, str):
        return not_known(found)
    hz, size = found
    inside = (hz >= max(LOW_HZ, at_least_hz)) & (hz <= HIGH_HZ)
    if not inside.any():
        return not_known(f"the trace is shorter than a period of {at_least_hz:g} Hz")
    return Measured(20.0 * math.log10(float(np.max(size[inside]))))


def _nfp_peak(run: MeasureInput) -> tuple[float, float] | str:
    if run.nfp is None:
        return "there is no linear model"
    hz = np.geomspace(LOW_HZ, HIGH_HZ, _POINTS)
    found = run.nfp(2.0 * math.pi * hz)
    if isinstance(found, str):
        return found
    k = int(np.argmax(np.abs(found)))
    hz = np.geomspace(hz[max(k - 1, 0)], hz[min(k + 1, _POINTS - 1)], _POINTS)
    size = np.abs(np.asarray(run.nfp(2.0 * math.pi * hz)))
    k = int(np.argmax(size))
    return float(hz[k]), 20.0 * math.log10(float(size[k]))


def run_nfp(run: MeasureInput) -> tuple[NDArray[np.float64], NDArray[np.float64]] | str:
    """Frequencies (Hz) and |ΔP/Δω| (pu) of the run, or why there is none (:eq:`nfp-in-time`)."""
    trace, n = run.trace, run.ratings.f_n_hz
    for event in run.test.events:
        of_phase = Event(event.t_s, omega_g=event.omega_g, over=event.over, phase_jump=event.phase_jump, per_unit=True)
        if event != of_phase:
            return "the test changes more than the grid's phase and frequency"
    rows = run.rows(run.first_s)
    if run.limiter_acts(rows):
        return "the current limiter acts"
    P = trace.P_pu[max(rows.start - 1, 0) :]
    change = float(np.max(np.abs(P - P[0])))
    if change < _MOVES or not np.isfinite(P).all():
        return f"P moves by less than {_MOVES:g} pu"
    if float(np.ptp(P[-(len(P) // 10) :])) > 0.02 * change:
        return "P is not at rest at the end, as the Fourier transform asks for"
    size = 1 << (2 * len(P)).bit_length()  # with zeros behind: finer steps of the frequency
    hz = np.arange(math.floor(HIGH_HZ * size * run.step_s) + 1, dtype=np.float64) / (size * run.step_s)
    # dP/dt in intervals, each at its middle, from the first event on.
    output = np.fft.rfft(np.diff(P), size)[: len(hz)] * np.exp(1j * math.pi * hz * run.step_s)
    omega, deviation = 2.0 * math.pi * hz, run.test.df_hz
    driven = np.zeros(len(hz), dtype=complex)
    for event in run.test.events:
        at = np.exp(-1j * omega * (event.t_s - run.first_s))
        if event.df_hz is not None:
            spread = np.sinc(hz * event.over) * np.exp(-0.5j * omega * event.over)
            driven += (event.df_hz - deviation) / n * spread * at
            deviation = event.df_hz
        driven += 1j * omega * math.radians(event.phase_deg) / (2.0 * math.pi * n) * at
    good = np.abs(driven) > 1e-3 * np.max(np.abs(driven))
    return hz[good], np.abs(output[good] / driven[good]).astype(np.float64)


OSCILLATIONS = (damping_ratio, oscillation_hz, nfp_peak_db, nfp_at_hz, nfp_run_peak_db)
