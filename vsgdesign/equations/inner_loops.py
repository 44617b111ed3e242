"""Inner voltage and current loops in the converter's own dq frame, sampled, with both limits and anti-windup.

dq components are peak values. With limits that are never reached, these are the published loops.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.integration import advanced


class InnerLoopGains(NamedTuple):
    """Gains of the voltage loop and the current loop.

    K_ff is the share of the grid current that is fed forward; the published value is 1. With a computation delay, a
    slightly smaller value damps the network better, but a much smaller one makes the voltage loop weak on a strong
    grid. R_t + jX_t is the transient impedance. κ is the share of one period by which the converter current is
    predicted; it is used only with a delay of one sample. The published loops have R_t = X_t = κ = 0.
    """

    K_pv: Any
    """Proportional gain of the voltage loop, A/V"""
    K_iv: Any
    """Integral gain of the voltage loop, A/(V·s)"""
    K_pc: Any
    """Proportional gain of the current loop, V/A"""
    K_ic: Any
    """Integral gain of the current loop, V/(A·s)"""
    K_ff: Any = 1.0
    """Share of the grid current that is fed forward"""
    R_t: Any = 0.0
    """Transient resistance, Ω"""
    X_t: Any = 0.0
    """Transient reactance, Ω"""
    kappa: Any = 0.0
    """Share of a period by which the converter current is predicted"""


def limit_length(x: Any, y: Any, limit: Any) -> tuple[Any, Any]:
    """Shortens the vector (x, y) to the length ``limit`` if it is longer. Returns (short_x, short_y)."""
    # The squares are compared, so that the root is never taken at zero, where it has no derivative.
    scale = limit / np.sqrt(np.maximum(x * x + y * y, limit * limit))
    return x * scale, y * scale


def transient_impedance(
    i_g_d: Any, i_g_q: Any, i_f_d: Any, i_f_q: Any, gains: InnerLoopGains, smoothing: Any
) -> tuple[Any, Any, Any, Any]:
    """Voltage that is subtracted from the reference while the grid current changes (:eq:`transient-impedance`).

    i_f is the grid current behind its low-pass. Returns (drop_d, drop_q, i_f_d, i_f_q): the drop in V, the new i_f
    in A.
    """
    h_d = i_g_d - i_f_d
    h_q = i_g_q - i_f_q
    drop_d = gains.R_t * h_d - gains.X_t * h_q
    drop_q = gains.R_t * h_q + gains.X_t * h_d
    return drop_d, drop_q, i_f_d + smoothing * h_d, i_f_q + smoothing * h_q


def predicted_current(
    i_d: Any, i_q: Any, v_d: Any, v_q: Any, u_d: Any, u_q: Any, kappa: Any, omega_L: Any, T_over_L: Any
) -> tuple[Any, Any]:
    """Converter current a share κ of one period ahead (:eq:`current-prediction`).

    u is the bridge voltage that was computed one sample ago and acts from this sample on. With κ = 0 the function
    returns the current unchanged to the last bit. Returns (i_d, i_q) in A peak.
    """
    ahead = kappa * T_over_L
    return i_d + ahead * (u_d - v_d + omega_L * i_q), i_q + ahead * (u_q - v_q - omega_L * i_d)


def voltage_loop(
    v_ref: Any,
    drop_d: Any,
    drop_q: Any,
    v_d: Any,
    v_q: Any,
    i_g_d: Any,
    i_g_q: Any,
    xi_d: Any,
    xi_q: Any,
    gains: InnerLoopGains,
    omega_C: Any,
) -> tuple[Any, Any, Any, Any]:
    """Voltage error and the converter current that the loop asks for (:eq:`voltage-loop`).

    Each axis has a PI controller, feed-forward of the grid current and ωC cross-coupling. Returns (e_d, e_q, i_want_d,
    i_want_q), the errors in V and the currents in A.
    """
    # The drop is subtracted last. Where it is zero it then changes no rounding, so published figures keep every bit.
    e_d = v_ref - v_d - drop_d
    e_q = -v_q - drop_q
    i_want_d = gains.K_pv * e_d + xi_d + gains.K_ff * i_g_d - omega_C * v_q
    i_want_q = gains.K_pv * e_q + xi_q + gains.K_ff * i_g_q + omega_C * v_d
    return e_d, e_q, i_want_d, i_want_q


def voltage_integrators(
    e_d: Any, e_q: Any, cut_d: Any, cut_q: Any, xi_d: Any, xi_q: Any, gains: InnerLoopGains, T_s: Any
) -> tuple[Any, Any]:
    """The integrators ξ_v of the voltage loop for the next sample (:eq:`voltage-loop`).

    They integrate the error and ``cut``, the change that the limiter made to the requested current: cut = i_ref − i*
    in A. Returns (xi_d, xi_q).
    """
    unwind = gains.K_iv / gains.K_pv
    xi_d = advanced(xi_d, T_s * (gains.K_iv * e_d + unwind * cut_d))
    xi_q = advanced(xi_q, T_s * (gains.K_iv * e_q + unwind * cut_q))
    return xi_d, xi_q


def current_loop(
    i_ref_d: Any,
    i_ref_q: Any,
    i_d: Any,
    i_q: Any,
    v_d: Any,
    v_q: Any,
    u_d: Any,
    u_q: Any,
    xi_d: Any,
    xi_q: Any,
    gains: InnerLoopGains,
    omega_L: Any,
    T_over_L: Any,
    v_max_pk: Any,
    T_s: Any,
) -> Any:
    """Bridge voltage from the error of the predicted current (:eq:`current-loop`).

    Each axis has a PI controller, feed-forward of the capacitor voltage and ωL cross-coupling. The voltage limit is
    circular and has the same anti-windup. Returns (v_b_d, v_b_q, xi_d, xi_q) with the new integrators.
    """
    ahead_d, ahead_q = predicted_current(i_d, i_q, v_d, v_q, u_d, u_q, gains.kappa, omega_L, T_over_L)
    e_d = i_ref_d - ahead_d
    e_q = i_ref_q - ahead_q
    want_d = gains.K_pc * e_d + xi_d + v_d - omega_L * i_q
    want_q = gains.K_pc * e_q + xi_q + v_q + omega_L * i_d
    v_b_d, v_b_q = limit_length(want_d, want_q, v_max_pk)
    unwind = gains.K_ic / gains.K_pc
    xi_d = advanced(xi_d, T_s * (gains.K_ic * e_d + unwind * (v_b_d - want_d)))
    xi_q = advanced(xi_q, T_s * (gains.K_ic * e_q + unwind * (v_b_q - want_q)))
    return v_b_d, v_b_q, xi_d, xi_q
