"""What is watched of a run in every sample: the figures of a step, and those of a disturbance.

They are the figures of :mod:`vsgdesign.metrics.step_response` and :mod:`vsgdesign.metrics.survival`, sample by sample,
so that no run has to be logged. Times are numbers of samples, as floats.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import Measurement
from vsgdesign.equations.frames import instantaneous_power
from vsgdesign.equations.grid import FilterGrid, pcc_voltage
from vsgdesign.simulation.circuit_sample import PlantState


class Entry(NamedTuple):
    """When a signal entered its band for the last time."""

    last_out: Any
    """Number of the last sample outside; −1 where there is none."""
    error_out: Any
    """Error of that sample."""
    error_in: Any
    """Error of the sample after it."""
    was_out: Any
    """1 where the present sample is outside, else 0."""


class Load(NamedTuple):
    """What the converter's current did."""

    first_sq: Any
    """Largest squared length of the current within 5 ms of an event, A² peak."""
    later_sq: Any
    """The same later than this."""
    above: Any
    """Samples in which the current was above its limit."""


class LoadDemand(NamedTuple):
    """What counts of the current: whether an event has come (1 or 0), whether it is less than 5 ms ago, and the
    squared limit, A² peak."""

    after: Any
    first: Any
    limit_sq: Any


class StepWatch(NamedTuple):
    """Of a step of a reference, whose power is judged by its mean."""

    most: Any
    """Largest share of the step that the mean reached."""
    entry: Entry
    load: Load
    sum: Any
    """Sum of the power over the samples of the mean, W or var."""
    mean: Any
    """W or var."""
    late: Any
    """Sum of the power since it was last set to zero, W or var: a switched bridge rests where this leads to."""


class StepDemand(NamedTuple):
    """What is watched of it: the mean before the step and the power after it, the band as a share of the step, one over
    the samples of the mean, and the shares of P and Q in the power, of which one is 1 and the other 0."""

    initial: Any
    final: Any
    band: Any
    per_cycle: Any
    of_P: Any
    of_Q: Any


class DisturbanceWatch(NamedTuple):
    """Of any other disturbance."""

    sum_P: Any
    sum_Q: Any
    """Sums over the last cycle, W and var."""
    entry: Entry
    load: Load
    delta: Any
    """Angle of the converter's frame against the source, rad, not wrapped."""
    least: Any
    most: Any
    """Least and largest angle since the last event, rad."""


class DisturbanceDemand(NamedTuple):
    """What is watched of a disturbance: the rest (W and var), one over the rated power, the band as a share of the
    rated power, one over the samples of a cycle, and by how much the source turns in this interval, rad."""

    P_rest: Any
    Q_rest: Any
    per_S: Any
    band: Any
    per_cycle: Any
    turn: Any


def entered(entry: Entry, error: Any, band: Any, k: Any) -> Entry:
    """The entry after a sample with this error (:eq:`last-entry`)."""
    outside = 1.0 * (error > band)
    # The sample after the last one outside: its error closes the interpolation.
    after = (1.0 - outside) * entry.was_out
    return Entry(
        last_out=np.where(outside > 0.5, k, entry.last_out),
        error_out=np.where(outside > 0.5, error, entry.error_out),
        error_in=np.where(after > 0.5, error, entry.error_in),
        was_out=outside,
    )


def loaded(load: Load, of: LoadDemand, x: PlantState) -> Load:
    """The load after a sample."""
    length_sq = x.i_s_alpha * x.i_s_alpha + x.i_s_beta * x.i_s_beta
    return Load(
        first_sq=np.maximum(load.first_sq, of.first * length_sq),
        later_sq=np.maximum(load.later_sq, of.after * (1.0 - of.first) * length_sq),
        above=load.above + of.after * (length_sq > of.limit_sq),
    )


def entered_s(entry: Entry, band: Any, T_s: Any, since_s: Any) -> Any:
    """The time from ``since_s`` on, s, at which a signal entered its band for the last time, interpolated
    (:eq:`last-entry`, as :func:`vsgdesign.metrics.step_response.settling_time` has it); infinite if it ends outside, 0
    if it never was."""
    span = entry.error_out - entry.error_in
    fraction = (entry.error_out - band) / np.where(span > 0.0, span, 1.0)
    entered = (entry.last_out + fraction) * T_s - since_s
    return np.where(entry.was_out > 0.5, np.inf, np.where(entry.last_out < 0.0, 0.0, entered))


def power_at_pcc(x: PlantState, v_g_alpha: Any, v_g_beta: Any, circuit: FilterGrid) -> Any:
    """Powers at the PCC behind a second inductor, W and var. Returns (P, Q)."""
    v_alpha = pcc_voltage(x.i_s_alpha, x.v_c_alpha, x.i_g_alpha, v_g_alpha, circuit)
    v_beta = pcc_voltage(x.i_s_beta, x.v_c_beta, x.i_g_beta, v_g_beta, circuit)
    P, Q = instantaneous_power(v_alpha, v_beta, x.i_g_alpha, x.i_g_beta)
    return P, Q


def power_at_node(true: Measurement) -> Any:
    """Powers at the capacitor node, W and var. Returns (P, Q)."""
    P, Q = instantaneous_power(true.v_alpha, true.v_beta, true.i_g_alpha, true.i_g_beta)
    return P, Q


def reached(mean: Any, of: StepDemand) -> Any:
    """The share of the step that a mean has reached."""
    return (mean - of.initial) / (of.final - of.initial)


def watched_step(
    watch: StepWatch,
    of: StepDemand,
    load_of: LoadDemand,
    x: PlantState,
    P_pcc: Any,
    Q_pcc: Any,
    power_ago: Any,
    k: Any,
) -> Any:
    """What is known of a step; ``power_ago`` is the power, W or var, of the sample that leaves the mean.
    Returns (watched, power): the last is the power that is stepped."""
    power = of.of_P * P_pcc + of.of_Q * Q_pcc
    total = watch.sum + (power - power_ago)
    mean = total * of.per_cycle
    progress = reached(mean, of)
    after = StepWatch(
        most=np.maximum(watch.most, progress),
        entry=entered(watch.entry, np.abs(progress - 1.0), of.band, k),
        load=loaded(watch.load, load_of, x),
        sum=total,
        mean=mean,
        late=watch.late + power,
    )
    return after, power


def away_from_rest(
    sum_P: Any, sum_Q: Any, of: DisturbanceDemand, P: Any, Q: Any, P_ago: Any, Q_ago: Any
) -> tuple[Any, Any, Any]:
    """The sums of P and Q over a cycle after a sample, and how far their means are from the rest, as a share of the
    rated power. Returns (next_P, next_Q, error)."""
    next_P = sum_P + (P - P_ago)
    next_Q = sum_Q + (Q - Q_ago)
    error_P = np.abs(next_P * of.per_cycle - of.P_rest)
    error_Q = np.abs(next_Q * of.per_cycle - of.Q_rest)
    return next_P, next_Q, np.maximum(error_P, error_Q) * of.per_S


def watched_disturbance(
    watch: DisturbanceWatch,
    of: DisturbanceDemand,
    load_of: LoadDemand,
    x: PlantState,
    theta: Any,
    next_theta: Any,
    P: Any,
    Q: Any,
    P_ago: Any,
    Q_ago: Any,
    extra: Any,
    k: Any,
) -> DisturbanceWatch:
    """What is known of a disturbance after a sample: the means of P and Q over a cycle against the rest, and the angle.

    P_ago and Q_ago are the powers one cycle ago. ``next_theta`` is the converter's angle at the next sample, before it
    is drawn back by a turn. ``extra``: by how much more than ``of.turn`` the source turns, rad. Returns (watched).
    """
    sum_P, sum_Q, error = away_from_rest(watch.sum_P, watch.sum_Q, of, P, Q, P_ago, Q_ago)
    return DisturbanceWatch(
        sum_P=sum_P,
        sum_Q=sum_Q,
        entry=entered(watch.entry, error, of.band, k),
        load=loaded(watch.load, load_of, x),
        delta=watch.delta + ((next_theta - theta) - (of.turn + extra)),
        least=np.minimum(watch.least, watch.delta),
        most=np.maximum(watch.most, watch.delta),
    )


class Sums(NamedTuple):
    """What the means of the powers are made of: 1 once there is a sample, the powers of the first one (W, var), and the
    sums of what all differ from them."""

    begun: Any
    P_0: Any
    Q_0: Any
    P: Any
    Q: Any


def taken(sums: Sums, P_ago: Any, Q_ago: Any, x: PlantState, v_g_alpha: Any, v_g_beta: Any, circuit: FilterGrid) -> Any:
    """What is taken of a sample: the powers, the squared lengths of i_g and i_s (A² peak), and the sums of the powers
    over the samples of a mean. P_ago and Q_ago are the sums of as many samples before.
    Returns (sums_after, P_pcc, Q_pcc, i_sq, i_s_sq, sum_P, sum_Q)."""
    P, Q = power_at_pcc(x, v_g_alpha, v_g_beta, circuit)
    begins = sums.begun < 0.5
    P_0, Q_0 = np.where(begins, P, sums.P_0), np.where(begins, Q, sums.Q_0)
    after = Sums(1.0, P_0, Q_0, sums.P + (P - P_0), sums.Q + (Q - Q_0))
    i_sq = x.i_g_alpha * x.i_g_alpha + x.i_g_beta * x.i_g_beta
    i_s_sq = x.i_s_alpha * x.i_s_alpha + x.i_s_beta * x.i_s_beta
    return after, P, Q, i_sq, i_s_sq, after.P - P_ago, after.Q - Q_ago
