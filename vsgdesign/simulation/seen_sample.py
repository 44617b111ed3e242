"""What is seen of a run in the log of its samples, where a host without arrays judges it, such as a page.

What these functions have in common with runs side by side is in :mod:`vsgdesign.simulation.watched_sample`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.grid import FilterGrid, capacitor_node_voltage
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.simulation.circuit_sample import PlantState
from vsgdesign.simulation.outcome import NEAR, SAME
from vsgdesign.simulation.watched_sample import (
    DisturbanceDemand,
    Entry,
    Load,
    LoadDemand,
    StepDemand,
    away_from_rest,
    entered,
    loaded,
    reached,
)

TURN = 6.283185307179586


class SeenDisturbance(NamedTuple):
    """Of a disturbance: the sums of P and Q over a cycle, W and var, when their means entered the band, what the
    current did, and the angle against the source, its least and its largest value, rad, not wrapped."""

    sum_P: Any
    sum_Q: Any
    entry: Entry
    load: Load
    delta: Any
    least: Any
    most: Any


class Need(NamedTuple):
    """Of a step: the largest error of the mean, as a share of the step, and how long the window must be, s
    (:eq:`window-needed`)."""

    worst: Any
    needed_s: Any


class End(NamedTuple):
    """Of the end of a run: sums of the powers (W, var) and of the samples in which each limit acts, and the number of
    samples up to here in which the current's limiter acted."""

    P: Any
    Q: Any
    current: Any
    bridge: Any
    voltage: Any
    limited: Any


class Limits(NamedTuple):
    """The limit of the current, A² peak, and the voltages to which a limiter holds the Q loop, phase rms V; each −1
    without one."""

    current_sq: Any
    V_low: Any
    V_high: Any


class GuardedVoltage(NamedTuple):
    """Of a protection against voltages: the sum of the lengths of the voltage's vector over a cycle, V peak, in how
    many samples without interruption its mean has been above and below the limits, and the number of samples up to the
    first one in which it tripped because of each; 0 where it has not."""

    sum_V: Any
    above: Any
    below: Any
    at_high: Any
    at_low: Any


class GuardedFrequency(NamedTuple):
    """Of a protection against changes of the frequency: the number of samples up to the first one in which it tripped,
    0 where it has not, and the rate there, Hz/s."""

    at_rate: Any
    rate: Any


class VoltageGuard(NamedTuple):
    """Limits of the mean voltage, pu, and for how long it may be beyond them, s; ``per_V``: what the mean is per V of
    the sum; ``on``: 1 from the event on, before it 0."""

    V_high: Any
    high_s: Any
    V_low: Any
    low_s: Any
    per_V: Any
    T_s: Any
    on: Any


class FrequencyGuard(NamedTuple):
    """The limit of the rate, Hz/s, and the window, s; ``on``: 1 from the event and the end of the first window on."""

    rocof: Any
    window_s: Any
    on: Any


class SeenEnd(NamedTuple):
    """Of the powers: sums over a cycle, and sums of their means over a cycle since they were last set to zero, W and
    var."""

    sum_P: Any
    sum_Q: Any
    late_P: Any
    late_Q: Any


def seen_rest(rest: SeenEnd, per_cycle: Any, P: Any, Q: Any, P_ago: Any, Q_ago: Any) -> Any:
    """What is known of the rest to which a switched bridge comes after a sample of its log, as
    :func:`vsgdesign.simulation.survival.running.own_rest_of` has it. ``P_ago`` and ``Q_ago``: the powers a cycle ago.
    Returns (rested, P_now, Q_now)."""
    sum_P = rest.sum_P + (P - P_ago)
    sum_Q = rest.sum_Q + (Q - Q_ago)
    return SeenEnd(sum_P, sum_Q, rest.late_P + sum_P * per_cycle, rest.late_Q + sum_Q * per_cycle), P, Q


def seen_voltage(
    guard: GuardedVoltage, guard_of: VoltageGuard, x: PlantState, circuit: FilterGrid, V_ago: Any, k: Any
) -> Any:
    """What a protection knows of the voltage after a sample of its log, as
    :func:`vsgdesign.metrics.protection.first_trip` has it. ``V_ago``: the length a cycle ago. Returns (guarded, V_now).
    """
    v_alpha = capacitor_node_voltage(x.i_s_alpha, x.v_c_alpha, x.i_g_alpha, circuit)
    v_beta = capacitor_node_voltage(x.i_s_beta, x.v_c_beta, x.i_g_beta, circuit)
    V = np.sqrt(v_alpha * v_alpha + v_beta * v_beta)
    sum_V = guard.sum_V + V - V_ago
    mean = sum_V * guard_of.per_V
    above = np.where(mean > guard_of.V_high, guard.above + guard_of.on, 0.0)
    below = np.where(mean < guard_of.V_low, guard.below + guard_of.on, 0.0)
    slack = 1e-3 * guard_of.T_s
    high = np.where(above * guard_of.T_s > guard_of.high_s + slack, 1.0, 0.0)
    low = np.where(below * guard_of.T_s > guard_of.low_s + slack, 1.0, 0.0)
    at_high = np.where(guard.at_high > 0.0, guard.at_high, high * (k + 1.0))
    at_low = np.where(guard.at_low > 0.0, guard.at_low, low * (k + 1.0))
    return GuardedVoltage(sum_V, above, below, at_high, at_low), V


def seen_frequency(guard: GuardedFrequency, guard_of: FrequencyGuard, omega: Any, omega_ago: Any, k: Any) -> Any:
    """The same of the frequency; ``omega_ago``: that of a window ago, rad/s. Returns (guarded, omega_now)."""
    rate = np.abs(omega - omega_ago) / TURN / guard_of.window_s
    tripped = np.where(rate > guard_of.rocof, guard_of.on, 0.0)
    at_rate = np.where(guard.at_rate > 0.0, guard.at_rate, tripped * (k + 1.0))
    return GuardedFrequency(at_rate, np.where(guard.at_rate > 0.0, guard.rate, rate)), omega


def seen_disturbance(
    seen: SeenDisturbance,
    of: DisturbanceDemand,
    load_of: LoadDemand,
    x: PlantState,
    v_g_alpha: Any,
    v_g_beta: Any,
    P: Any,
    Q: Any,
    theta: Any,
    P_ago: Any,
    Q_ago: Any,
    k: Any,
) -> Any:
    """What is known of a disturbance after a sample of its log. Returns (watched, P_now, Q_now)."""
    sum_P, sum_Q, error = away_from_rest(seen.sum_P, seen.sum_Q, of, P, Q, P_ago, Q_ago)
    angle = theta - np.arctan2(v_g_beta, v_g_alpha)
    delta = angle - TURN * np.floor((angle - seen.delta) / TURN + 0.5)
    after = SeenDisturbance(
        sum_P=sum_P,
        sum_Q=sum_Q,
        entry=entered(seen.entry, error, of.band, k),
        load=loaded(seen.load, load_of, x),
        delta=delta,
        least=np.minimum(seen.least, delta),
        most=np.maximum(seen.most, delta),
    )
    return after, P, Q


def seen_need(need: Need, of: StepDemand, mean: Any, decay: Any, share: Any, T_s: Any, event_s: Any, k: Any) -> Need:
    """What a window needs after a sample with this mean of the stepped power. ``share``: of the band, within which a
    final value must be that is itself a mean of the power."""
    since_s = k * T_s - event_s
    error = np.abs(reached(mean, of) - 1.0)
    worst = np.maximum(need.worst, error)
    needed_s = since_s + np.log(np.maximum(error, SETTLING_BAND) / (share * SETTLING_BAND)) / decay
    return Need(worst, np.where(error > SETTLING_BAND, np.maximum(need.needed_s, needed_s), need.needed_s))


def needs_at_first(error: Any, decay: Any, share: Any) -> Any:
    """How long a window must be at least, s, with this error at its beginning (:eq:`window-needed`)."""
    return np.log(np.maximum(error, 1.0) / (share * SETTLING_BAND)) / decay


def seen_end(
    end: End, limits: Limits, x: PlantState, P_pcc: Any, Q_pcc: Any, limited: Any, at_bridge: Any, V_rms: Any
) -> End:
    """The sums after a sample; ``limited``: the number of samples so far in which the current's limiter acted."""
    length_sq = x.i_s_alpha * x.i_s_alpha + x.i_s_beta * x.i_s_beta
    far = np.where(length_sq < NEAR * NEAR * limits.current_sq, 1.0, 0.0)
    acts = np.where(at_bridge > 0.0, 1.0 - far, 1.0) * (limited - end.limited)
    low = np.where(np.abs(V_rms - limits.V_low) <= SAME * limits.V_low, 1.0, 0.0)
    high = np.where(np.abs(V_rms - limits.V_high) <= SAME * limits.V_high, 1.0, 0.0)
    return End(
        P=end.P + P_pcc,
        Q=end.Q + Q_pcc,
        current=end.current + acts,
        bridge=end.bridge + at_bridge,
        voltage=end.voltage + low + high,
        limited=limited,
    )
