"""The whole controller as one sampled step: measurement in, bridge voltage and next state out.

This is the function that the EMT compiles, that the sampled-data model differentiates and that ships.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.inner_loops import InnerLoopGains, current_loop, transient_impedance, voltage_loop
from vsgdesign.equations.integration import advanced
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops
from vsgdesign.frames import instantaneous_power, rms_to_peak, rotate, rotate_back


class ControllerState(NamedTuple):
    """Everything that the controller remembers from one sample to the next."""

    theta: Any
    """Angle of the converter's d axis against the stationary α axis, rad."""
    omega_i: Any
    """Frequency integrator of the P loop, rad/s."""
    V: Any
    """Voltage integrator of the Q loop, phase rms V."""
    P_f: Any
    """Filtered active power, W."""
    Q_f: Any
    """Filtered reactive power, var."""
    xi_vd: Any
    xi_vq: Any
    """Voltage-loop integrators, A peak."""
    xi_id: Any
    xi_iq: Any
    """Current-loop integrators, V peak."""
    i_f_d: Any = 0.0
    i_f_q: Any = 0.0
    """Grid current behind the low-pass of the transient impedance, A peak."""
    u_alpha: Any = 0.0
    u_beta: Any = 0.0
    """Bridge voltage of the last sample, V peak; with a delay of one sample it acts from this sample on."""


class Measurement(NamedTuple):
    """Sampled αβ components (peak): capacitor-node voltage, converter current, grid current."""

    v_alpha: Any
    v_beta: Any
    i_s_alpha: Any
    i_s_beta: Any
    i_g_alpha: Any
    i_g_beta: Any


class ControllerSettings(NamedTuple):
    """What does not change while the controller runs, SI."""

    T_s: Any
    """Sampling period, s."""
    smoothing_P: Any
    smoothing_Q: Any
    """1 − exp(−T_s/τ) of the power filters; 1 without filter."""
    omega_C: Any
    omega_L: Any
    """Cross-coupling ω₀C (S) and ω₀L_1 (Ω)."""
    i_max_pk: Any
    v_max_pk: Any
    """Current and bridge-voltage limits, peak."""
    advance_cos: Any
    advance_sin: Any
    """cos and sin of the angle ω₀(d + ½)T_s by which the output leads, d samples of delay."""
    smoothing_t: Any = 0.0
    """1 − exp(−ω_t T_s) of the transient impedance's low-pass."""
    half_cos: Any = 1.0
    half_sin: Any = 0.0
    """cos and sin of ω₀T_s/2, by which the frame turns in half a period."""
    T_over_L: Any = 0.0
    """T_s/L_1 of the current prediction, s/H."""


class ControllerOutput(NamedTuple):
    """Bridge voltage in αβ (V peak), the frequency used (rad/s), unfiltered P (W) and Q (var)."""

    v_b_alpha: Any
    v_b_beta: Any
    omega: Any
    P: Any
    Q: Any


def power_stage(
    state: ControllerState, P: Any, Q: Any, refs: References, gains: PowerLoopGains, settings: ControllerSettings
) -> Any:
    """Power filters and power loops of one sample: ω, then the next (θ, ω_i, V, P_f, Q_f).

    Integrators advance by forward Euler with period T_s; the angle by the frequency of this sample.
    """
    P_f = state.P_f + settings.smoothing_P * (P - state.P_f)
    Q_f = state.Q_f + settings.smoothing_Q * (Q - state.Q_f)
    omega, domega_dt, dV_dt = power_loops(state.omega_i, state.V, P_f, Q_f, refs, gains)
    theta = advanced(state.theta, settings.T_s * omega)
    omega_i = advanced(state.omega_i, settings.T_s * domega_dt)
    V = advanced(state.V, settings.T_s * dV_dt)
    return omega, theta, omega_i, V, P_f, Q_f


def voltage_stage(
    theta: Any,
    V_rms: Any,
    state: ControllerState,
    measured: Measurement,
    gains: InnerLoopGains,
    settings: ControllerSettings,
) -> Any:
    """Inner loops of one sample for the voltage V∠θ: v_b_alpha, v_b_beta, then the next (ξ_v, ξ_i, i_f), each d, q."""
    cosine = np.cos(theta)
    sine = np.sin(theta)
    v_d, v_q = rotate_back(measured.v_alpha, measured.v_beta, cosine, sine)
    i_s_d, i_s_q = rotate_back(measured.i_s_alpha, measured.i_s_beta, cosine, sine)
    i_g_d, i_g_q = rotate_back(measured.i_g_alpha, measured.i_g_beta, cosine, sine)
    drop_d, drop_q, i_f_d, i_f_q = transient_impedance(
        i_g_d, i_g_q, state.i_f_d, state.i_f_q, gains, settings.smoothing_t
    )
    i_ref_d, i_ref_q, xi_vd, xi_vq = voltage_loop(
        rms_to_peak(V_rms),
        drop_d,
        drop_q,
        v_d,
        v_q,
        i_g_d,
        i_g_q,
        state.xi_vd,
        state.xi_vq,
        gains,
        settings.omega_C,
        settings.i_max_pk,
        settings.T_s,
    )
    # The voltage stands still in αβ while the frame turns: in the middle of its period it is half a period behind.
    u_d, u_q = rotate_back(state.u_alpha, state.u_beta, cosine, sine)
    u_d, u_q = rotate_back(u_d, u_q, settings.half_cos, settings.half_sin)
    v_b_d, v_b_q, xi_id, xi_iq = current_loop(
        i_ref_d,
        i_ref_q,
        i_s_d,
        i_s_q,
        v_d,
        v_q,
        u_d,
        u_q,
        state.xi_id,
        state.xi_iq,
        gains,
        settings.omega_L,
        settings.T_over_L,
        settings.v_max_pk,
        settings.T_s,
    )
    lead_d, lead_q = rotate(v_b_d, v_b_q, settings.advance_cos, settings.advance_sin)
    v_b_alpha, v_b_beta = rotate(lead_d, lead_q, cosine, sine)
    return v_b_alpha, v_b_beta, xi_vd, xi_vq, xi_id, xi_iq, i_f_d, i_f_q


def controller_step(
    state: ControllerState,
    measured: Measurement,
    refs: References,
    power_gains: PowerLoopGains,
    inner_gains: InnerLoopGains,
    settings: ControllerSettings,
) -> Any:
    """One sample of the controller (:eq:`controller-step`): the next state, and the output of this one."""
    P, Q = instantaneous_power(measured.v_alpha, measured.v_beta, measured.i_g_alpha, measured.i_g_beta)
    omega, theta, omega_i, V, P_f, Q_f = power_stage(state, P, Q, refs, power_gains, settings)
    v_b_alpha, v_b_beta, xi_vd, xi_vq, xi_id, xi_iq, i_f_d, i_f_q = voltage_stage(
        state.theta, state.V, state, measured, inner_gains, settings
    )
    following = ControllerState(
        theta, omega_i, V, P_f, Q_f, xi_vd, xi_vq, xi_id, xi_iq, i_f_d, i_f_q, v_b_alpha, v_b_beta
    )
    return following, ControllerOutput(v_b_alpha, v_b_beta, omega, P, Q)
