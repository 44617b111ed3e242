"""How far the resting point of the power loops moves when a reference or the grid source changes."""

from __future__ import annotations

from typing import Any

from vsgdesign.equations.power_loops import PowerLoopGains


def rest_shift(
    jacobian: tuple[Any, Any, Any, Any],
    P: Any,
    Q: Any,
    V_rms: Any,
    gains: PowerLoopGains,
    *,
    P_ref: Any = 0.0,
    Q_ref: Any = 0.0,
    V_g: Any = 0.0,
    omega_g: Any = 0.0,
) -> tuple[Any, Any, Any]:
    """From the old to the new resting point (δ, ω_r, V), for small changes, by the Jacobian at rest (:eq:`rest-shift`).

    At rest both errors of the power loops are zero, and ω and ω_r are the grid's frequency. The changes are those of
    P_ref (W), Q_ref (var), the source's voltage V_g as a share of itself, and its frequency omega_g (rad/s). ω_i does
    not change at the step, so that a step of P_ref or Q_ref moves ω_r itself. P, Q and V are those at rest. P and Q are homogeneous of second degree in (V, V_g), so their derivatives with respect to ln V_g are
    2P − BV and 2Q − DV. Returns (delta, omega_r, V) in rad, rad/s and V: what the state is short of its new
    rest right after the step.
    """
    A, B, C, D = jacobian
    P_rest = P_ref - gains.D_p * omega_g
    P_shift = P_rest - V_g * (2.0 * P - B * V_rms)
    Q_shift = Q_ref - V_g * (2.0 * Q - D * V_rms)
    D_loop = D + gains.D_q
    determinant = A * D_loop - B * C
    delta = (D_loop * P_shift - B * Q_shift) / determinant
    V = (A * Q_shift - C * P_shift) / determinant
    omega_r = omega_g + (gains.k_P * P_ref + gains.k_Q * Q_ref) / (1.0 - gains.k_P * gains.D_p)
    return delta, omega_r, V
