"""A converter that follows the voltage at its filter: phase-locked loop, references of constant power or current, and
current loop.

It is the second kind of converter of a plant: a photovoltaic inverter, or an active rectifier, which takes a constant
power from the network. It samples as a unit does, and its bridge voltage may wait for one sample.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import Measurement
from vsgdesign.equations.frames import instantaneous_power, rotate, rotate_back
from vsgdesign.equations.inner_loops import limit_length
from vsgdesign.equations.integration import advanced, within_a_turn

POWER_OF_PEAK = 1.5
"""Power of three phases over the product of peak voltage and peak current."""


class SetPoints(NamedTuple):
    """What a converter that is no unit of ours is asked for: P in W and Q in var, out of its filter."""

    P_ref: Any
    Q_ref: Any


class ConverterOutput(NamedTuple):
    """What a sample of such a converter says."""

    v_b_alpha: Any
    v_b_beta: Any
    """Bridge voltage, V peak."""
    P: Any
    Q: Any
    """Measured at the capacitor, W and var."""
    omega: Any
    """Its frequency, rad/s."""
    V: Any
    """Voltage that it takes for that of its capacitor, V peak."""
    theta: Any
    """Its angle against the α axis, rad."""
    limited: Any
    """1 where its current reference is at its limit, else 0."""
    at_bridge: Any
    """1 where its bridge voltage is at its limit, else 0."""


class FollowingState(NamedTuple):
    """What it remembers from one sample to the next."""

    theta: Any
    """Angle of the phase-locked loop, rad."""
    slip: Any
    """Integrator of the phase-locked loop: frequency above nominal, rad/s."""
    v_d: Any
    v_q: Any
    """Voltage of the feed-forward behind its low-pass, V peak."""
    V: Any
    """Length of the voltage behind its low-pass, V peak."""
    xi_d: Any
    xi_q: Any
    """Integrators of the current loop, V peak."""


class FollowingSettings(NamedTuple):
    """Constants of a converter that follows."""

    T_s: Any
    omega_0: Any
    V_nominal: Any
    """Nominal voltage, V peak."""
    V_least: Any
    """Voltage below which references no longer rise, V peak."""
    K_pll: Any
    """Proportional gain of the phase-locked loop, 1/s."""
    K_slip: Any
    """Its integral gain, 1/s²."""
    K_pc: Any
    """Proportional gain of the current loop, V/A."""
    K_ic: Any
    """Its integral gain, V/(A s)."""
    omega_L: Any
    """Reactance of L_1 at nominal frequency, Ω."""
    omega_C: Any
    """Susceptance of C at nominal frequency, S."""
    smoothing_v: Any
    """Share of the way that the voltage of the feed-forward goes in a sample."""
    smoothing_V: Any
    """Share of the way that the length of the voltage goes in a sample."""
    by_power: Any
    """1: powers are kept at any voltage; 0: currents are, which give the powers at nominal voltage."""
    i_max_pk: Any
    v_max_pk: Any
    lead: Any
    """Time from a sample to the middle of the interval in which its bridge voltage acts, s."""


def follow_phase(v_d: Any, v_q: Any, slip: Any, settings: FollowingSettings) -> tuple[Any, Any, Any]:
    """One sample of the phase-locked loop (:eq:`phase-locked`). Returns (omega, slip_after, length): its frequency in
    rad/s, its integrator, and the length of the voltage in V peak."""
    least = settings.V_least
    length = np.sqrt(np.maximum(v_d * v_d + v_q * v_q, 1e-12 * least * least))
    error = v_q / np.maximum(length, least)
    omega = settings.omega_0 + slip + settings.K_pll * error
    return omega, advanced(slip, settings.T_s * settings.K_slip * error), length


def follow_sample(
    state: FollowingState, measured: Measurement, asked: SetPoints, settings: FollowingSettings
) -> tuple[FollowingState, ConverterOutput]:
    """One sample of a converter that follows (:eq:`phase-locked`, :eq:`following-reference`,
    :eq:`following-current`). Returns (following, said)."""
    cosine, sine = np.cos(state.theta), np.sin(state.theta)
    v_d, v_q = rotate_back(measured.v_alpha, measured.v_beta, cosine, sine)
    i_d, i_q = rotate_back(measured.i_s_alpha, measured.i_s_beta, cosine, sine)
    omega, slip, length = follow_phase(v_d, v_q, state.slip, settings)

    V = state.V + settings.smoothing_V * (length - state.V)
    taken = np.maximum(settings.V_nominal + settings.by_power * (V - settings.V_nominal), settings.V_least)
    want_d = asked.P_ref / (POWER_OF_PEAK * taken)
    want_q = settings.omega_C * taken - asked.Q_ref / (POWER_OF_PEAK * taken)
    ref_d, ref_q = limit_length(want_d, want_q, settings.i_max_pk)

    e_d, e_q = ref_d - i_d, ref_q - i_q
    ff_d = state.v_d + settings.smoothing_v * (v_d - state.v_d)
    ff_q = state.v_q + settings.smoothing_v * (v_q - state.v_q)
    u_d = settings.K_pc * e_d + state.xi_d + ff_d - settings.omega_L * i_q
    u_q = settings.K_pc * e_q + state.xi_q + ff_q + settings.omega_L * i_d
    b_d, b_q = limit_length(u_d, u_q, settings.v_max_pk)
    gain = settings.T_s * settings.K_ic
    ahead = state.theta + settings.lead * omega
    v_b_alpha, v_b_beta = rotate(b_d, b_q, np.cos(ahead), np.sin(ahead))
    P, Q = instantaneous_power(measured.v_alpha, measured.v_beta, measured.i_g_alpha, measured.i_g_beta)
    following = FollowingState(
        theta=within_a_turn(advanced(state.theta, settings.T_s * omega)),
        slip=slip,
        v_d=ff_d,
        v_q=ff_q,
        V=V,
        xi_d=advanced(state.xi_d, gain * (e_d + (b_d - u_d) / settings.K_pc)),
        xi_q=advanced(state.xi_q, gain * (e_q + (b_q - u_q) / settings.K_pc)),
    )
    said = ConverterOutput(
        v_b_alpha=v_b_alpha,
        v_b_beta=v_b_beta,
        P=P,
        Q=Q,
        omega=omega,
        V=V,
        theta=state.theta,
        limited=1.0 * (want_d * want_d + want_q * want_q > settings.i_max_pk * settings.i_max_pk),
        at_bridge=1.0 * (u_d * u_d + u_q * u_q > settings.v_max_pk * settings.v_max_pk),
    )
    return following, said
