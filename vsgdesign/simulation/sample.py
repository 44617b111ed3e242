"""What a run does in every sample besides :mod:`vsgdesign.simulation.circuit_sample`: sensors, controller, probe, and
one interval whose source is on a ramp of its voltage or its frequency.

Plain functions of the restricted language: the loop of a run is made of their text, and so is an interval that an event
cuts into pieces.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller import ControllerSettings, ControllerState, Measurement, controller_step
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
