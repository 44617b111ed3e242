"""How the converter oscillates after a disturbance, and how it follows the grid's frequency over frequency."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vsgdesign.campaigns.compliance.measuring import LOST, Measured, MeasureInput, measure, not_known
from vsgdesign.metrics.oscillation import Oscillation, dominant_oscillation
from vsgdesign.metrics.step_response import cycle_mean
from vsgdesign.study.parameters.event import Event

LOW_HZ, HIGH_HZ = 0.1, 50.0
"""Where oscillations and the peak of the network frequency perturbation are looked for."""

_MOVES = 2e-3
"""Smallest oscillation of P that counts, pu."""

_MISFIT = 0.2
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
    if not found.misfit <= _MISFIT:
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
