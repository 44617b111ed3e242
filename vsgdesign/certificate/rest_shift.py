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
    """Step of the resting point (δ, ω_r, V) when a reference or the grid source changes a little (:eq:`rest-shift`).

    The changes are those of P_ref (W), Q_ref (var), the source's voltage V_g as a share of itself, and its frequency
    omega_g (rad/s). P, Q and V are those at rest, ``jacobian`` is A, B, C, D there. ω_i is continuous, so that a step
    of P_ref or Q_ref moves ω_r instead of its rest. P and Q are homogeneous of second degree in (V, V_g); their
    derivatives with respect to ln V_g are therefore 2P − BV and 2Q − DV. Returns (delta, omega_r, V) in rad, rad/s
    and V: what the state lacks to its new rest right after the step.
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
