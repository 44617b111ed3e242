"""The whole controller as one sampled step: measurement in, bridge voltage and next state out; and its connection to a
live grid.

The EMT compiles this function, the sampled-data model differentiates it, and the exported C is generated from it. The C
has guards as well: a sample that is no measurement is left out and cannot spoil the integrators. A simulation does not
need them and runs ``controller_step`` alone. ``runtime.guarded_step`` puts both together.

While the breaker is open, :func:`watch_grid` follows the fundamental of the grid's voltage and its frequency, and
:func:`synchronised` sets the power loops to them before every sample. The voltage loop then makes the grid's voltage at
the capacitor, so that no current flows when the breaker closes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller_data import ControllerOutput, ControllerSettings, ControllerState, Measurement
from vsgdesign.equations.frames import instantaneous_power, peak_to_rms, rms_to_peak, rotate, rotate_back
from vsgdesign.equations.inner_loops import (
    InnerLoopGains,
    current_loop,
    limit_length,
    transient_impedance,
    voltage_integrators,
    voltage_loop,
)
from vsgdesign.equations.integration import TURN, advanced
from vsgdesign.equations.limiter_interface import GridEstimate, IntegratorSteps, LimiterLaw, LimiterView
from vsgdesign.equations.power_loops import PowerLoopGains, References, notch, power_loops

AT_THE_LIMIT = 0.9999
"""Share of the square of its limit from which on a bridge voltage is at it: more than the rounding takes away."""


def power_stage(
    state: ControllerState, P: Any, Q: Any, refs: References, gains: PowerLoopGains, settings: ControllerSettings
) -> Any:
    """Power filters and power loops of one sample: the frequency ω, the new P_f and Q_f, and the steps.

    P and Q come from the notch. P_f and Q_f are those of the next sample. The steps are the changes of θ, ω_i and V by
    forward Euler with period T_s. The step of θ uses the frequency of this sample.
    """
    P_f = state.P_f + settings.smoothing_P * (P - state.P_f)
    Q_f = state.Q_f + settings.smoothing_Q * (Q - state.Q_f)
    omega, domega_dt, dV_dt = power_loops(state.omega_i, state.V, P_f, Q_f, refs, gains)
    steps = IntegratorSteps(theta=settings.T_s * omega, omega_i=settings.T_s * domega_dt, V=settings.T_s * dV_dt)
    return omega, P_f, Q_f, steps


def controller_sample(
    state: ControllerState,
    measured: Measurement,
    P: Any,
    Q: Any,
    theta: Any,
    V_rms: Any,
    grid: GridEstimate,
    refs: References,
    power_gains: PowerLoopGains,
    inner_gains: InnerLoopGains,
    settings: ControllerSettings,
    limiter: LimiterLaw,
) -> Any:
    """:func:`controller_step` with its power loops open, for given powers P and Q and a commanded voltage V∠θ.

    The linear model adds its disturbances at these inputs.
    """
    cosine = np.cos(theta)
    sine = np.sin(theta)
    v_d, v_q = rotate_back(measured.v_alpha, measured.v_beta, cosine, sine)
    i_s_d, i_s_q = rotate_back(measured.i_s_alpha, measured.i_s_beta, cosine, sine)
    i_g_d, i_g_q = rotate_back(measured.i_g_alpha, measured.i_g_beta, cosine, sine)
    drop_d, drop_q, i_f_d, i_f_q = transient_impedance(
        i_g_d, i_g_q, state.i_f_d, state.i_f_q, inner_gains, settings.smoothing_t
    )
    e_d, e_q, i_want_d, i_want_q = voltage_loop(
        rms_to_peak(V_rms),
        drop_d,
        drop_q,
        v_d,
        v_q,
        i_g_d,
        i_g_q,
        state.xi_vd,
        state.xi_vq,
        inner_gains,
        settings.omega_C,
    )
    passed_P, ripple_P, mean_P = notch(
        P, state.ripple_P, state.mean_P, settings.notch_gain, settings.notch_step, settings.notch_back
    )
    passed_Q, ripple_Q, mean_Q = notch(
        Q, state.ripple_Q, state.mean_Q, settings.notch_gain, settings.notch_step, settings.notch_back
    )
    view = LimiterView(
        v_d=v_d,
        v_q=v_q,
        i_s_d=i_s_d,
        i_s_q=i_s_q,
        i_g_d=i_g_d,
        i_g_q=i_g_q,
        e_d=e_d,
        e_q=e_q,
        i_want_d=i_want_d,
        i_want_q=i_want_q,
        V=V_rms,
        omega_i=state.omega_i,
        P=passed_P,
        Q=passed_Q,
        K_pv=inner_gains.K_pv,
        full=1.0
        * (
            state.u_alpha * state.u_alpha + state.u_beta * state.u_beta
            >= AT_THE_LIMIT * settings.v_max_pk * settings.v_max_pk
        ),
    )
    sample = limiter.limit(state.limiter, view, grid, refs, power_gains, settings)
    xi_vd, xi_vq = voltage_integrators(
        sample.e_d,
        sample.e_q,
        sample.i_ref_d - i_want_d,
        sample.i_ref_q - i_want_q,
        state.xi_vd,
        state.xi_vq,
        inner_gains,
        settings.T_s,
    )
    # The bridge voltage is constant in αβ during a period while the dq frame turns. In the middle of the period it is
    # therefore half a period behind the frame.
    u_d, u_q = rotate_back(state.u_alpha, state.u_beta, cosine, sine)
    u_d, u_q = rotate_back(u_d, u_q, settings.half_cos, settings.half_sin)
    v_b_d, v_b_q, xi_id, xi_iq = current_loop(
        sample.i_ref_d,
        sample.i_ref_q,
        i_s_d,
        i_s_q,
        v_d,
        v_q,
        u_d,
        u_q,
        state.xi_id,
        state.xi_iq,
        inner_gains,
        settings.omega_L,
        settings.T_over_L,
        settings.v_max_pk,
        settings.T_s,
    )
    lead_d, lead_q = rotate(v_b_d, v_b_q, settings.advance_cos, settings.advance_sin)
    v_b_alpha, v_b_beta = rotate(lead_d, lead_q, cosine, sine)
    omega, P_f, Q_f, wanted = power_stage(state, sample.P, sample.Q, refs, power_gains, settings)
    steps, remembered = limiter.move(state.limiter, sample, view, omega, wanted, settings)
    following = ControllerState(
        theta=advanced(state.theta, steps.theta),
        omega_i=advanced(state.omega_i, steps.omega_i),
        V=advanced(state.V, steps.V),
        P_f=P_f,
        Q_f=Q_f,
        xi_vd=xi_vd,
        xi_vq=xi_vq,
        xi_id=xi_id,
        xi_iq=xi_iq,
        i_f_d=i_f_d,
        i_f_q=i_f_q,
        u_alpha=v_b_alpha,
        u_beta=v_b_beta,
        ripple_P=ripple_P,
        ripple_Q=ripple_Q,
        mean_P=mean_P,
        mean_Q=mean_Q,
        limiter=remembered,
    )
    output = ControllerOutput(v_b_alpha=v_b_alpha, v_b_beta=v_b_beta, omega=omega, P=P, Q=Q, limited=sample.limited)
    return following, output


def controller_step(
    state: ControllerState,
    measured: Measurement,
    grid: GridEstimate,
    refs: References,
    power_gains: PowerLoopGains,
    inner_gains: InnerLoopGains,
    settings: ControllerSettings,
    limiter: LimiterLaw,
) -> Any:
    """One sample of the controller (:eq:`controller-step`): the next state, and the output of this one."""
    P, Q = instantaneous_power(measured.v_alpha, measured.v_beta, measured.i_g_alpha, measured.i_g_beta)
    return controller_sample(
        state, measured, P, Q, state.theta, state.V, grid, refs, power_gains, inner_gains, settings, limiter
    )


__all__ = [
    "ControllerOutput",
    "ControllerSettings",
    "ControllerState",
    "Measurement",
    "controller_sample",
    "controller_step",
    "power_stage",
]


V_PLAUSIBLE = 5.0
"""Largest component of a measured voltage over the voltage limit of the bridge."""

I_PLAUSIBLE = 20.0
"""Largest component of a measured current over the current limit."""

TIMES_NOMINAL = 10.0
"""Largest frequency and voltage of the power loops over their nominal values."""

LARGEST_STATE = 1e12
"""Largest sum of the magnitudes of all state variables, in their SI units."""


def plausible(measured: Measurement, settings: ControllerSettings) -> Any:
    """1 if six numbers can be a measurement, 0 if one of them is NaN, infinite or far beyond every limit."""
    v = np.maximum(np.abs(measured.v_alpha), np.abs(measured.v_beta))
    i_s = np.maximum(np.abs(measured.i_s_alpha), np.abs(measured.i_s_beta))
    i_g = np.maximum(np.abs(measured.i_g_alpha), np.abs(measured.i_g_beta))
    return (
        1.0
        * (v <= V_PLAUSIBLE * settings.v_max_pk)
        * (i_s <= I_PLAUSIBLE * settings.i_max_pk)
        * (i_g <= I_PLAUSIBLE * settings.i_max_pk)
    )


def sound(state: ControllerState, omega: Any, refs: References, settings: ControllerSettings) -> Any:
    """1 if the frequency and the integrators of a state are where a converter can be, 0 if one is NaN or far beyond.

    A step that would leave this range is not taken, so that gains or references that make no sense leave nothing
    behind in the integrators.
    """
    xi_v = np.maximum(np.abs(state.xi_vd), np.abs(state.xi_vq))
    xi_i = np.maximum(np.abs(state.xi_id), np.abs(state.xi_iq))
    return (
        1.0
        * (np.abs(omega) <= TIMES_NOMINAL * refs.omega_0)
        * (np.abs(state.omega_i) <= TIMES_NOMINAL * refs.omega_0)
        * (np.abs(state.V) <= TIMES_NOMINAL * refs.V_n)
        * (xi_v <= I_PLAUSIBLE * settings.i_max_pk)
        * (xi_i <= V_PLAUSIBLE * settings.v_max_pk)
    )


def skipped_step(state: ControllerState, refs: References, gains: PowerLoopGains, settings: ControllerSettings) -> Any:
    """A sample without a measurement (:eq:`skipped-step`): the next state, and the output of this one.

    The frame and the bridge voltage go on turning at the frequency that the filtered powers ask for. All other state
    variables keep their values.
    """
    omega, _, _ = power_loops(state.omega_i, state.V, state.P_f, state.Q_f, refs, gains)
    # At most half a turn in a sample: gains that make no sense may ask for any frequency.
    fastest = 0.5 * TURN / settings.T_s
    omega = np.minimum(np.maximum(omega, -fastest), fastest)
    turn = settings.T_s * omega
    u_alpha, u_beta = limit_length(state.u_alpha, state.u_beta, settings.v_max_pk)
    u_alpha, u_beta = rotate(u_alpha, u_beta, np.cos(turn), np.sin(turn))
    following = state._replace(theta=advanced(state.theta, turn), u_alpha=u_alpha, u_beta=u_beta)
    output = ControllerOutput(v_b_alpha=u_alpha, v_b_beta=u_beta, omega=omega, P=state.P_f, Q=state.Q_f, limited=0.0)
    return following, output


WATCH_BANDWIDTH = 30.0
"""Natural frequency of the loop that follows the grid's voltage, rad/s: it settles within 0.2 s, and passes a tenth of
a negative sequence."""

WATCH_RANGE = 0.1
"""Largest deviation of the grid's frequency that is followed, over the nominal frequency."""

WATCH_LEAST = 0.1
"""Voltage over nominal below which the frequency is not followed at full gain: there is no grid to follow."""

IN_STEP = 0.03
"""Largest difference between both voltages with which the breaker may close, over the nominal voltage."""

IN_STEP_V_LOW = 0.8
IN_STEP_V_HIGH = 1.2
"""Grid voltages to which the breaker may close, over the nominal voltage."""


class GridWatch(NamedTuple):
    """The fundamental of the grid's voltage. Zero and the nominal frequency at first."""

    v_alpha: Any
    v_beta: Any
    """V peak."""
    omega: Any
    """Frequency, rad/s."""


def watch_grid(watch: GridWatch, v_alpha: Any, v_beta: Any, refs: References, T_s: Any) -> GridWatch:
    """One sample of the grid's voltage in V peak (:eq:`grid-watch`)."""
    turn = T_s * watch.omega
    ahead_alpha, ahead_beta = rotate(watch.v_alpha, watch.v_beta, np.cos(turn), np.sin(turn))
    e_alpha = v_alpha - ahead_alpha
    e_beta = v_beta - ahead_beta
    least = WATCH_LEAST * rms_to_peak(refs.V_n)
    length_sq = np.maximum(ahead_alpha * ahead_alpha + ahead_beta * ahead_beta, least * least)
    slip = (ahead_alpha * e_beta - ahead_beta * e_alpha) / length_sq
    omega = watch.omega + WATCH_BANDWIDTH * WATCH_BANDWIDTH * T_s * slip
    share = 2.0 * WATCH_BANDWIDTH * T_s
    lowest = (1.0 - WATCH_RANGE) * refs.omega_0
    highest = (1.0 + WATCH_RANGE) * refs.omega_0
    return GridWatch(
        v_alpha=ahead_alpha + share * e_alpha,
        v_beta=ahead_beta + share * e_beta,
        omega=np.minimum(np.maximum(omega, lowest), highest),
    )


def synchronised(state: ControllerState, watch: GridWatch, gains: PowerLoopGains) -> ControllerState:
    """The controller's state with the angle, the voltage and the frequency of the grid, without power
    (:eq:`synchronised`). The inner loops and the limiter keep theirs."""
    V = peak_to_rms(np.hypot(watch.v_alpha, watch.v_beta))
    return state._replace(
        theta=np.arctan2(watch.v_beta, watch.v_alpha),
        omega_i=watch.omega + gains.k_Q * gains.D_q * V,
        V=V,
        P_f=0.0,
        Q_f=0.0,
        ripple_P=0.0,
        ripple_Q=0.0,
        mean_P=0.0,
        mean_Q=0.0,
    )


def in_step(measured: Measurement, watch: GridWatch, refs: References) -> Any:
    """1 if the breaker may close: the converter's voltage is the grid's, which is near the nominal one; else 0."""
    nominal = rms_to_peak(refs.V_n)
    apart = np.hypot(measured.v_alpha - watch.v_alpha, measured.v_beta - watch.v_beta)
    grid = np.hypot(watch.v_alpha, watch.v_beta)
    return 1.0 * (apart <= IN_STEP * nominal) * (grid >= IN_STEP_V_LOW * nominal) * (grid <= IN_STEP_V_HIGH * nominal)
