"""Currents and voltages by sequence during a fault or a sag, and what follows it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsgdesign.campaigns.compliance.measuring import NO_FINAL_VALUE, Measured, MeasureInput, measure, not_known
from vsgdesign.metrics.sequences import Sequences, frame_angle, last_sequences, positive_sequence, sequences
from vsgdesign.metrics.step_response import cycle_mean, first_time
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import Fault

_NO_VOLTAGE = 0.02
"""Below this positive sequence, in pu, a voltage has no angle to which a current could be referred."""

_NO_CURRENT = 0.02
"""A change of the reactive current by less than this, in pu, is none."""


@measure(
    "fault current",
    "pu",
    "Amplitude of the largest phase current into the PCC in the last cycle of the first fault or sag, at the grid's "
    "frequency.",
)
def fault_current_pu(run: MeasureInput) -> Measured:
    """Of both sequences together, by a one-cycle fit that leaves a dc component out (:eq:`sequences`)."""
    found = run.once(_in_fault)
    return not_known(found) if isinstance(found, str) else Measured(float(found[1].largest_phase))


@measure(
    "positive-sequence current",
    "pu",
    "Positive-sequence current into the PCC in the last cycle of the first fault or sag.",
)
def positive_sequence_pu(run: MeasureInput) -> Measured:
    """By a one-cycle fit (:eq:`sequences`)."""
    found = run.once(_in_fault)
    return not_known(found) if isinstance(found, str) else Measured(abs(found[1].positive))


@measure(
    "negative-sequence current",
    "pu",
    "Negative-sequence current into the PCC in the last cycle of the first fault or sag.",
)
def negative_sequence_pu(run: MeasureInput) -> Measured:
    """By a one-cycle fit (:eq:`sequences`)."""
    found = run.once(_in_fault)
    return not_known(found) if isinstance(found, str) else Measured(abs(found[1].negative))


@measure(
    "positive-sequence voltage",
    "pu",
    "Positive-sequence voltage of the capacitor node in the last cycle of the first fault or sag.",
)
def V1_pu(run: MeasureInput) -> Measured:
    """By a one-cycle fit (:eq:`sequences`)."""
    found = run.once(_in_fault)
    return not_known(found) if isinstance(found, str) else Measured(abs(found[0].positive))


@measure(
    "negative-sequence voltage",
    "pu",
    "Negative-sequence voltage of the capacitor node in the last cycle of the first fault or sag.",
)
def V2_pu(run: MeasureInput) -> Measured:
    """By a one-cycle fit (:eq:`sequences`)."""
    found = run.once(_in_fault)
    return not_known(found) if isinstance(found, str) else Measured(abs(found[0].negative))


@measure(
    "lowest voltage",
    "pu",
    "Lowest positive-sequence voltage of the capacitor node from the first event on, each value over a cycle.",
)
def V_min_pu(run: MeasureInput) -> Measured:
    """By a one-cycle fit (:eq:`sequences`)."""
    V = run.once(_voltage_after)
    return Measured(float(np.min(V))) if V.size else not_known("less than a cycle follows the first event")


@measure(
    "highest voltage",
    "pu",
    "Highest positive-sequence voltage of the capacitor node from the first event on, each value over a cycle.",
)
def V_max_pu(run: MeasureInput) -> Measured:
    """By a one-cycle fit (:eq:`sequences`)."""
    V = run.once(_voltage_after)
    return Measured(float(np.max(V))) if V.size else not_known("less than a cycle follows the first event")


@measure(
    "reactive current to 90 %",
    "ms",
    "Time from the first fault or sag until the positive-sequence reactive current has made 90 % of its change, which "
    "has to support the voltage; the one cycle of the measurement is in it.",
)
def Iq_90_ms(run: MeasureInput, share: float = 0.9) -> Measured:
    """The change is that from the cycle before the event to the last cycle of the fault."""
    fault = _fault_of(run)
    if fault is None:
        return not_known("the test has no fault and no sag")
    event, end_s = fault
    before, rows = run.first_row(event.t_s), run.rows(event.t_s, end_s)
    cycle = run.rows_per_cycle
    if rows.stop - rows.start < 2 * cycle:
        return not_known("the fault lasts less than two cycles")
    first = max(before - cycle - 2, 0)
    angle, voltage, current = _both(run, slice(first, rows.stop))
    if len(angle) < rows.stop - rows.start + cycle:
        return not_known("the trace begins less than a cycle before the fault")
    V = voltage.positive
    with np.errstate(invalid="ignore", divide="ignore"):
        Iq = np.imag(V * np.conj(current.positive)) / np.abs(V)
    count = rows.stop - rows.start
    if not np.all(np.abs(V[-count - 1 :]) > _NO_VOLTAGE):
        return not_known(f"the voltage falls below {_NO_VOLTAGE:g} pu, so that the reactive current has no reference")
    start = Iq[-count - 1]
    change = Iq[-1] - start
    if not abs(change) > _NO_CURRENT:
        return not_known(f"the reactive current changes by less than {_NO_CURRENT:g} pu")
    fall = abs(V[-count - 1]) - abs(V[-1])
    if abs(fall) > _NO_VOLTAGE and change * fall < 0.0:  # more of it supports a voltage that falls
        return not_known(f"the reactive current changes by {change:+.2g} pu, which does not support the voltage")
    since = run.trace.t_s[rows.start - 1 : rows.stop] - event.t_s
    found = first_time(since, (Iq[-count - 1 :] - start) / change, share)
    if found is None:
        return not_known("the reactive current does not arrive within the fault")
    return Measured(1e3 * found, plus_minus=1e3 * run.step_s)


@measure(
    "P back",
    "s",
    "Time from the end of the disturbance until the one-cycle mean of P stays within 5 % of the rating of its value "
    "before the first event.",
    void=NO_FINAL_VALUE,
)
def P_back_s(run: MeasureInput, band_pu: float = 0.05) -> Measured:
    """It does not come back if the test changes what P rests at."""
    rows = run.rows(run.cleared_s)
    mean = cycle_mean(run.trace.P_pu, run.rows_per_cycle)[rows]
    if mean.size < run.rows_per_cycle:
        return not_known("less than a cycle follows the disturbance")
    error = np.abs(mean - run.rest_before(run.trace.P_pu, run.first_s))
    return run.settled(run.trace.t_s[rows] - run.cleared_s, error, band_pu, "its value before")


def _is_fault(event: Event) -> bool:
    """Whether an event begins a fault or a sag."""
    dips = event.V_g_rms is not None and event.V_g_rms < 0.9
    return isinstance(event.switched.fault, Fault) or event.sag is not None or dips


def _fault_of(run: MeasureInput) -> tuple[Event, float] | None:
    """The first fault or sag, and when the next event comes, or the trace ends."""
    found = run.event_with(_is_fault)
    if found is None:
        return None
    event, after = found
    return event, min(after, float(run.trace.t_s[-1]) + run.step_s)


def _both(run: MeasureInput, rows: slice) -> tuple[NDArray[np.float64], Sequences, Sequences]:
    """Frame angle, and both sequences of the voltage and of the current into the PCC, at the rows."""
    t = run.trace
    angle = frame_angle(t.f_hz[rows], run.step_s)
    hz = run.ratings.f_n_hz
    return (
        angle,
        sequences(t.v_alpha_pu[rows], t.v_beta_pu[rows], angle, run.step_s, hz),
        sequences(t.i_g_alpha_pu[rows], t.i_g_beta_pu[rows], angle, run.step_s, hz),
    )


def _in_fault(run: MeasureInput) -> tuple[Sequences, Sequences] | str:
    """Voltage and current in the last cycle of the first fault, or why there are none."""
    rows = _rows_in_fault(run)
    if isinstance(rows, str):
        return rows
    t = run.trace
    angle = frame_angle(t.f_hz[rows], run.step_s)
    hz = run.ratings.f_n_hz
    voltage = last_sequences(t.v_alpha_pu[rows], t.v_beta_pu[rows], angle, run.step_s, hz)
    current = last_sequences(t.i_g_alpha_pu[rows], t.i_g_beta_pu[rows], angle, run.step_s, hz)
    if voltage is None or current is None:
        return _TOO_SHORT
    return voltage, current


_TOO_SHORT = "the fault lasts less than a cycle of the trace"


def _rows_in_fault(run: MeasureInput) -> slice | str:
    """The rows of the first fault or sag, or why there are none."""
    fault = _fault_of(run)
    if fault is None:
        return "the test has no fault and no sag"
    event, end_s = fault
    # A row at the clearing itself may show what comes after it.
    return run.rows(event.t_s + 1.5 * run.step_s, end_s)


@measure(
    "ripple of the dc power",
    "pu",
    "Amplitude at twice the grid's frequency of the power of the dc link in the last cycle of the first fault or sag.",
)
def P_dc_ripple_pu(run: MeasureInput) -> Measured:
    """By a one-cycle fit (:eq:`ripple-fit`); what the mean over a row takes away is given back."""
    window = 2.0 * run.ratings.f_n_hz * run.step_s
    return _ripple(run, run.trace.P_dc_pu, 1.0 / float(np.sinc(window)))


@measure(
    "ripple of the dc voltage",
    "pu",
    "Amplitude at twice the grid's frequency of the dc link's voltage, over the nominal one, in the last cycle of the "
    "first fault or sag.",
)
def v_dc_ripple_pu(run: MeasureInput) -> Measured:
    """By a one-cycle fit (:eq:`ripple-fit`)."""
    if bool((run.trace.v_dc_pu == 1.0).all()):
        return not_known("the dc link is ideal")
    return _ripple(run, run.trace.v_dc_pu, 1.0)


def _ripple(run: MeasureInput, values: NDArray[np.float64], scale: float) -> Measured:
    """The amplitude at twice the frame's frequency in the last cycle of the first fault or sag, times ``scale``."""
    rows = _rows_in_fault(run)
    if isinstance(rows, str):
        return not_known(rows)
    count = round(1.0 / (run.ratings.f_n_hz * run.step_s))
    if rows.stop - rows.start < count:
        return not_known(_TOO_SHORT)
    twice = 2.0 * frame_angle(run.trace.f_hz[rows], run.step_s)[-count:]
    line = np.linspace(-1.0, 1.0, count)
    basis = np.stack([np.ones(count), line, np.cos(twice), np.sin(twice)], axis=1)
    fit = np.linalg.lstsq(basis, values[rows][-count:], rcond=None)[0]
    return Measured(scale * float(np.hypot(fit[2], fit[3])))


def _voltage_after(run: MeasureInput) -> NDArray[np.float64]:
    """Positive-sequence voltage over each cycle that ends later than the first event, pu."""
    t, first = run.trace, run.first_row(run.first_s)
    rows = slice(max(first - run.rows_per_cycle - 1, 0), len(t.t_s))
    angle = frame_angle(t.f_hz[rows], run.step_s)
    found = positive_sequence(t.v_alpha_pu[rows], t.v_beta_pu[rows], angle, run.step_s, run.ratings.f_n_hz)
    V = np.abs(found[first - rows.start :])
    return V[np.isfinite(V)]


FAULTS = (
    fault_current_pu,
    positive_sequence_pu,
    negative_sequence_pu,
    V1_pu,
    V2_pu,
    V_min_pu,
    V_max_pu,
    P_dc_ripple_pu,
    v_dc_ripple_pu,
    Iq_90_ms,
    P_back_s,
)
