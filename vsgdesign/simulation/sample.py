"""What a run does in every sample besides :mod:`vsgdesign.simulation.circuit_sample`: sensors, controller, probe, one
interval whose source is on a ramp of its voltage or its frequency, and what finds the instants that only the run can
tell.

Of these, the current of a fault passes through zero, a breaker may close, or the converter has set itself to the grid
behind it.

Plain functions of the restricted language: the loop of a run is made of their text, and so is an interval that an event
cuts into pieces.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller import (
    ControllerSettings,
    ControllerState,
    GridWatch,
    Measurement,
    controller_step,
    in_step,
    synchronised,
    watch_grid,
)
from vsgdesign.equations.field import FieldSettings, LockIn, listen, probe_value
from vsgdesign.equations.field.lock_in import probe_offset
from vsgdesign.equations.frames import clarke, clarke_inverse, rotate
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.integration import within_a_turn
from vsgdesign.equations.limiters import GridEstimate, LimiterLaw
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.simulation.circuit_sample import BridgeVoltage, PlantRow, SourcePhasor

AT_LIMIT = 1.0 - 1e-9
"""Square of the share of its limit from which on the bridge's voltage is at it."""


class SensorChannel(NamedTuple):
    """One phase of one quantity: gain, offset, step of the quantisation (0: none), and where it saturates."""

    gain: Any
    offset: Any
    step: Any
    limit: Any


class Sensors(NamedTuple):
    """The sensors of v, i_s and i_g, one for each phase, and by how many sampling periods voltages and currents are
    late, 0 to 1."""

    v_a: SensorChannel
    v_b: SensorChannel
    v_c: SensorChannel
    i_s_a: SensorChannel
    i_s_b: SensorChannel
    i_s_c: SensorChannel
    i_g_a: SensorChannel
    i_g_b: SensorChannel
    i_g_c: SensorChannel
    late_v: Any
    late_i: Any


class Noise(NamedTuple):
    """What is added to each reading in one sample."""

    v_a: Any
    v_b: Any
    v_c: Any
    i_s_a: Any
    i_s_b: Any
    i_s_c: Any
    i_g_a: Any
    i_g_b: Any
    i_g_c: Any


def reading(value: Any, noise: Any, channel: SensorChannel) -> Any:
    """What one sensor makes of a value (:eq:`sensors`): gain, offset, noise, saturation, steps."""
    raw = value * channel.gain + channel.offset + noise
    held = np.minimum(np.maximum(raw, -channel.limit), channel.limit)
    step = np.where(channel.step > 0.0, channel.step, 1.0)
    stepped = np.minimum(np.floor(held / step + 0.5) * step, channel.limit - step)
    return np.where(channel.step > 0.0, stepped, held)


def sensed(true: Measurement, before: Measurement, noise: Noise, sensors: Sensors) -> Measurement:
    """What the sensors say (:eq:`sensors`); ``before`` is what was true one sample before. Returns (measured)."""
    v_a, v_b, v_c = clarke_inverse(
        true.v_alpha + sensors.late_v * (before.v_alpha - true.v_alpha),
        true.v_beta + sensors.late_v * (before.v_beta - true.v_beta),
    )
    i_s_a, i_s_b, i_s_c = clarke_inverse(
        true.i_s_alpha + sensors.late_i * (before.i_s_alpha - true.i_s_alpha),
        true.i_s_beta + sensors.late_i * (before.i_s_beta - true.i_s_beta),
    )
    i_g_a, i_g_b, i_g_c = clarke_inverse(
        true.i_g_alpha + sensors.late_i * (before.i_g_alpha - true.i_g_alpha),
        true.i_g_beta + sensors.late_i * (before.i_g_beta - true.i_g_beta),
    )
    v_alpha, v_beta = clarke(
        reading(v_a, noise.v_a, sensors.v_a),
        reading(v_b, noise.v_b, sensors.v_b),
        reading(v_c, noise.v_c, sensors.v_c),
    )
    i_s_alpha, i_s_beta = clarke(
        reading(i_s_a, noise.i_s_a, sensors.i_s_a),
        reading(i_s_b, noise.i_s_b, sensors.i_s_b),
        reading(i_s_c, noise.i_s_c, sensors.i_s_c),
    )
    i_g_alpha, i_g_beta = clarke(
        reading(i_g_a, noise.i_g_a, sensors.i_g_a),
        reading(i_g_b, noise.i_g_b, sensors.i_g_b),
        reading(i_g_c, noise.i_g_c, sensors.i_g_c),
    )
    return Measurement(v_alpha, v_beta, i_s_alpha, i_s_beta, i_g_alpha, i_g_beta)


def controlled(
    state: ControllerState,
    measured: Measurement,
    grid: GridEstimate,
    refs: References,
    power_gains: PowerLoopGains,
    inner_gains: InnerLoopGains,
    settings: ControllerSettings,
    limited: Any,
    limiter: LimiterLaw,
) -> Any:
    """The controller's sample. Returns (following, said, limited_samples, at_bridge): its next state, its output, the
    count of limited samples with this one, and whether the bridge's voltage is at its limit; ``limited`` is the count
    before."""
    moved, output = controller_step(state, measured, grid, refs, power_gains, inner_gains, settings, limiter)
    length_sq = output.v_b_alpha * output.v_b_alpha + output.v_b_beta * output.v_b_beta
    # A vector that was cut has the length of the limit but for rounding.
    at_bridge = 1.0 * (length_sq > AT_LIMIT * settings.v_max_pk * settings.v_max_pk)
    return moved, output, limited + output.limited, at_bridge


def kept_angle(theta: Any) -> Any:
    """The angle of the next sample. Returns (next_theta)."""
    return within_a_turn(theta)


def probing(lock: LockIn, theta: Any, V_rms: Any, field: FieldSettings, V_rated_rms: Any, allowed: Any) -> Any:
    """The probe of a field estimator (:eq:`probe-in-the-loop`); ``allowed`` is 0 to send none.

    Returns (commanded_theta, commanded_V, added_theta, added_V, u_d, u_q): what the controller commands, what of it is
    the probe, and the probe relative to the rated voltage.
    """
    d, q = probe_value(lock, allowed, field)
    V, angle = probe_offset(d, q, V_rms, V_rated_rms)
    return theta + angle, V_rms + V, angle, V, d, q


def hearing(
    lock: LockIn, measured: Measurement, theta: Any, u_d: Any, u_q: Any, acted: Any, field: FieldSettings
) -> Any:
    """The field estimator takes in a sample, in which the limiter acted or not. Returns (heard, closed): its lock-in,
    and whether its cycle has ended."""
    sent_alpha, sent_beta = rotate(u_d, u_q, np.cos(theta), np.sin(theta))
    lock_in, closed = taken_in(lock, measured, sent_alpha, sent_beta, acted, field)
    return lock_in, closed


def sent_at(theta: Any, u_d: Any, u_q: Any) -> Any:
    """The probe of a unit on the axes of the network. Returns (turned_x, turned_y): α and β."""
    return rotate(u_d, u_q, np.cos(theta), np.sin(theta))


def taken_in(
    lock: LockIn, measured: Measurement, sent_alpha: Any, sent_beta: Any, acted: Any, field: FieldSettings
) -> Any:
    """:func:`hearing` where the probe is on the axes of the network. Returns (heard, closed)."""
    lock_in = listen(
        lock,
        measured.v_alpha,
        measured.v_beta,
        measured.i_g_alpha,
        measured.i_g_beta,
        sent_alpha,
        sent_beta,
        acted,
        field,
    )
    return lock_in, lock_in.closed


def without_probe(theta: Any, V_rms: Any, added_theta: Any, added_V: Any) -> Any:
    """Angle and voltage of the next sample, from which the probe is taken off. Returns (next_theta, next_V)."""
    return within_a_turn(theta - added_theta), V_rms - added_V


def source_voltage(source: SourcePhasor, V_g: Any) -> Any:
    """The voltage of the source's fundamental, V peak. Returns (v_g_alpha, v_g_beta)."""
    return V_g * source.cosine, V_g * source.sine


def source_voltage_with(source: SourcePhasor, V_g: Any, added: BridgeVoltage) -> Any:
    """The source's voltage with what is added to its fundamental, V peak. Returns (v_g_alpha, v_g_beta)."""
    return V_g * source.cosine + added.alpha, V_g * source.sine + added.beta


class Ramp(NamedTuple):
    """Where a ramp of the source is: its amplitude (V peak), and by how much its frequency has left the one for which
    the responses are made, rad/s."""

    V_pk: Any
    drift: Any


class RampRow(NamedTuple):
    """The source over one interval of a ramp: what c·s^m·e^{jωs} adds to each state, m = 0, 1, 2, and both slopes in
    V/s and rad/s²."""

    re01: Any
    re02: Any
    re03: Any
    im01: Any
    im02: Any
    im03: Any
    re11: Any
    re12: Any
    re13: Any
    im11: Any
    im12: Any
    im13: Any
    re21: Any
    re22: Any
    re23: Any
    im21: Any
    im22: Any
    im23: Any
    V_slope: Any
    omega_slope: Any


def with_ramp(row: PlantRow, ramp: Ramp, ramp_of: RampRow, T_s: Any) -> Any:
    """The interval of a sample on a ramp (:eq:`source-ramp`): to second order in drift and slope. Returns (moved_row,
    ramp_after, extra): the row, the ramp at the next sample, and by how much more the source turns, rad."""
    V = ramp.V_pk
    d = ramp.drift
    a = ramp_of.V_slope
    r = ramp_of.omega_slope
    one_im = d * V
    two_re = -0.5 * V * d * d
    two_im = 0.5 * V * r + d * a
    extra = d * T_s + 0.5 * r * T_s * T_s
    turn_cos, turn_sin = rotate(row.turn_cos, row.turn_sin, np.cos(extra), np.sin(extra))
    moved_row = row._replace(
        re1=ramp_of.re01 * V
        + (ramp_of.re11 * a - ramp_of.im11 * one_im)
        + (ramp_of.re21 * two_re - ramp_of.im21 * two_im),
        re2=ramp_of.re02 * V
        + (ramp_of.re12 * a - ramp_of.im12 * one_im)
        + (ramp_of.re22 * two_re - ramp_of.im22 * two_im),
        re3=ramp_of.re03 * V
        + (ramp_of.re13 * a - ramp_of.im13 * one_im)
        + (ramp_of.re23 * two_re - ramp_of.im23 * two_im),
        im1=ramp_of.im01 * V
        + (ramp_of.im11 * a + ramp_of.re11 * one_im)
        + (ramp_of.im21 * two_re + ramp_of.re21 * two_im),
        im2=ramp_of.im02 * V
        + (ramp_of.im12 * a + ramp_of.re12 * one_im)
        + (ramp_of.im22 * two_re + ramp_of.re22 * two_im),
        im3=ramp_of.im03 * V
        + (ramp_of.im13 * a + ramp_of.re13 * one_im)
        + (ramp_of.im23 * two_re + ramp_of.re23 * two_im),
        turn_cos=turn_cos,
        turn_sin=turn_sin,
    )
    return moved_row, Ramp(V_pk=V + a * T_s, drift=d + r * T_s), extra


class Phases(NamedTuple):
    """1 for a phase whose current into a fault is waited for, else 0."""

    a: Any
    b: Any
    c: Any


class Relay(NamedTuple):
    """A relay that waits for both sides of a breaker (:eq:`synchro-check`)."""

    on: Any
    """1 where the breaker may close, else 0."""
    fresh: Any
    """1 in the first sample in which the relay looks at the voltages, else 0."""
    omega_n: Any
    V_n: Any
    """The frequency (rad/s) and the voltage (phase rms, V) about which it looks for a grid."""
    cosine: Any
    sine: Any
    """Of the lead of the converter's side around which the breaker closes."""
    least: Any
    """Cosine of the largest difference of the angles."""
    V_pk: Any
    omega: Any
    """Largest differences of the amplitudes, V peak, and of the frequencies, rad/s."""


class Setting(NamedTuple):
    """A converter that sets itself to the grid behind its breaker (:eq:`synchronised`)."""

    on: Any
    """1 where it does so, else 0."""
    free: Any
    """0 where a fault keeps the breaker open, else 1."""
    needed: Any
    """After so many samples in step the breaker closes; infinite where it does not wait for that."""


def passes_zero(begin_alpha: Any, begin_beta: Any, end_alpha: Any, end_beta: Any, phases: Phases) -> Any:
    """1 where the current of a phase into a fault changes its sign between two samples, else 0."""
    begin_a, begin_b, begin_c = clarke_inverse(begin_alpha, begin_beta)
    end_a, end_b, end_c = clarke_inverse(end_alpha, end_beta)
    in_a = phases.a * (begin_a * end_a <= 0.0)
    in_b = phases.b * (begin_b * end_b <= 0.0)
    in_c = phases.c * (begin_c * end_c <= 0.0)
    return np.maximum(in_a, np.maximum(in_b, in_c))


def _relay_watch(before: GridWatch, relay: Relay, v_alpha: Any, v_beta: Any, T_s: Any) -> GridWatch:
    """What a relay follows on one side; at its first sample it begins with the voltage that it sees."""
    at_first = relay.fresh > 0.5
    begun = GridWatch(
        v_alpha=np.where(at_first, v_alpha, before.v_alpha),
        v_beta=np.where(at_first, v_beta, before.v_beta),
        omega=np.where(at_first, relay.omega_n, before.omega),
    )
    refs = References(P_ref=0.0, Q_ref=0.0, omega_0=relay.omega_n, V_n=relay.V_n)
    return watch_grid(begun, v_alpha, v_beta, refs, T_s)


def relay_sees(
    own: GridWatch,
    behind: GridWatch,
    relay: Relay,
    v_alpha: Any,
    v_beta: Any,
    v_g_alpha: Any,
    v_g_beta: Any,
    T_s: Any,
) -> Any:
    """A sample of the voltages on both sides of an open breaker: what the relay follows, and whether both are near each
    other (:eq:`synchro-check`). Returns (followed, followed_behind, near)."""
    seen = _relay_watch(own, relay, v_alpha, v_beta, T_s)
    other = _relay_watch(behind, relay, v_g_alpha, v_g_beta, T_s)
    along = seen.v_alpha * other.v_alpha + seen.v_beta * other.v_beta
    across = seen.v_beta * other.v_alpha - seen.v_alpha * other.v_beta
    turned = along * relay.cosine + across * relay.sine
    length, other_length = np.hypot(seen.v_alpha, seen.v_beta), np.hypot(other.v_alpha, other.v_beta)
    angle = 1.0 * (turned >= relay.least * np.hypot(along, across))
    size = 1.0 * (np.abs(length - other_length) <= relay.V_pk)
    speed = 1.0 * (np.abs(seen.omega - other.omega) <= relay.omega)
    return seen, other, relay.on * angle * size * speed


def set_to_grid(
    state: ControllerState,
    watch: GridWatch,
    ready: Any,
    setting: Setting,
    measured: Measurement,
    v_g_alpha: Any,
    v_g_beta: Any,
    refs: References,
    power_gains: PowerLoopGains,
    T_s: Any,
) -> Any:
    """The state that a converter sets before a sample while it sets itself to the grid behind its breaker, as the
    exported controller does it. Returns (chosen, watched_grid, in_step_for, done): the state, the grid's voltage, for
    how many samples the converter has been in step, and whether the breaker closes before the next sample."""
    acts = setting.on > 0.5
    seen = watch_grid(watch, v_g_alpha, v_g_beta, refs, T_s)
    count = setting.on * setting.free * in_step(measured, seen, refs) * (ready + 1.0)
    made = synchronised(state, seen, power_gains)
    chosen = state._replace(
        theta=np.where(acts, made.theta, state.theta),
        omega_i=np.where(acts, made.omega_i, state.omega_i),
        V=np.where(acts, made.V, state.V),
        P_f=np.where(acts, 0.0, state.P_f),
        Q_f=np.where(acts, 0.0, state.Q_f),
        ripple_P=np.where(acts, 0.0, state.ripple_P),
        ripple_Q=np.where(acts, 0.0, state.ripple_Q),
        mean_P=np.where(acts, 0.0, state.mean_P),
        mean_Q=np.where(acts, 0.0, state.mean_Q),
    )
    return chosen, seen, count, setting.on * (count >= setting.needed)
