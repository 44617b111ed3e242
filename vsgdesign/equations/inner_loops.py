"""Inner voltage and current loops in the converter's own dq frame, sampled, with both limits and anti-windup.

dq components are peak. The published loops are these with the limits out of reach.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.integration import advanced


class InnerLoopGains(NamedTuple):
    """Gains of the voltage loop and the current loop.

    K_ff is the share of the grid current that is fed forward: 1 as published. With a computation delay a little
    less damps the network better; much less leaves the voltage loop without strength on a strong grid. R_t + jX_t is
    the transient impedance, κ the share of one period by which the converter current is predicted (with a delay of
    one sample alone): both 0 as published.
    """

    K_pv: Any
    """A/V"""
    K_iv: Any
    """A/(V·s)"""
    K_pc: Any
    """V/A"""
    K_ic: Any
    """V/(A·s)"""
    K_ff: Any = 1.0
    """1"""
    R_t: Any = 0.0
    """Ω"""
    X_t: Any = 0.0
    """Ω"""
    kappa: Any = 0.0
    """1"""


def limit_length(x: Any, y: Any, limit: Any) -> Any:
    """The vector (x, y), shortened to ``limit`` where it is longer. Returns (short_x, short_y)."""
    # Compared as squares: the root is then never taken at zero, where it has no derivative.
    scale = limit / np.sqrt(np.maximum(x * x + y * y, limit * limit))
    return x * scale, y * scale


def transient_impedance(i_g_d: Any, i_g_q: Any, i_f_d: Any, i_f_q: Any, gains: InnerLoopGains, smoothing: Any) -> Any:
    """Voltage that a change of the grid current takes off the reference (:eq:`transient-impedance`).

    i_f is the grid current behind its low-pass. Returns (drop_d, drop_q, i_f_d, i_f_q): V, and the new i_f in A.
    """
    h_d = i_g_d - i_f_d
    h_q = i_g_q - i_f_q
    drop_d = gains.R_t * h_d - gains.X_t * h_q
    drop_q = gains.R_t * h_q + gains.X_t * h_d
    return drop_d, drop_q, i_f_d + smoothing * h_d, i_f_q + smoothing * h_q


def predicted_current(
    i_d: Any, i_q: Any, v_d: Any, v_q: Any, u_d: Any, u_q: Any, kappa: Any, omega_L: Any, T_over_L: Any
) -> Any:
    """Converter current a share κ of one period ahead (:eq:`current-prediction`).

    u is the bridge voltage that acts from this sample on, computed one sample ago. With κ = 0 the current is returned
    as it is, to the bit. Returns (i_d, i_q) in A peak.
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
) -> Any:
    """Error of the voltage and the converter current that is wanted for it (:eq:`voltage-loop`).

    PI per axis, grid-current feed-forward, ωC cross-coupling. Returns (e_d, e_q, i_want_d, i_want_q): V and A.
    """
    # The drop comes last: where it is zero it then changes no rounding, and published figures stay to the bit.
    e_d = v_ref - v_d - drop_d
    e_q = -v_q - drop_q
    i_want_d = gains.K_pv * e_d + xi_d + gains.K_ff * i_g_d - omega_C * v_q
    i_want_q = gains.K_pv * e_q + xi_q + gains.K_ff * i_g_q + omega_C * v_d
    return e_d, e_q, i_want_d, i_want_q


def voltage_integrators(
    e_d: Any, e_q: Any, cut_d: Any, cut_q: Any, xi_d: Any, xi_q: Any, gains: InnerLoopGains, T_s: Any
) -> Any:
    """The next integrators ξ_v of the voltage loop (:eq:`voltage-loop`).

    They take up the error, and what the limiter has added to the wanted current: cut = i_ref − i*, in A. Returns
    (xi_d, xi_q).
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

    PI per axis, capacitor-voltage feed-forward, ωL cross-coupling, circular voltage limit with the same
    anti-windup. Returns (v_b_d, v_b_q, xi_d, xi_q) with the new integrators.
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
