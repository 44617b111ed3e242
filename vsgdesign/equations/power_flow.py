"""Power flow between the control point (V∠δ) and the grid source (V_g∠0) behind R + jX.

V and V_g are phase rms voltages in V. P and Q are three-phase powers in W and var, positive into the grid. For an LCL
filter, R and X include the grid-side inductor, because the control point is the filter capacitor.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vsgdesign.equations.frames import PHASES

POWER_MARGIN = 1.3
"""Least ratio of the grid's limit 3V²/|Z| to |S| (:eq:`static-limits`)."""

LEAST_SHARE = 0.2
"""Least share of b that A and D·V keep where gains are made of them (:eq:`well-posed`)."""


def power_flow(delta: Any, V_rms: Any, V_g_rms: Any, R: Any, X: Any) -> tuple[Any, Any]:
    """P and Q that leave the control point (:eq:`power-flow`, the paper's eqs. 1 and 2)."""
    Z_sq = R * R + X * X
    sine = V_rms * V_g_rms * np.sin(delta)
    cosine = V_rms * V_g_rms * np.cos(delta)
    V_sq = V_rms * V_rms
    P = PHASES / Z_sq * (R * V_sq - R * cosine + X * sine)
    Q = PHASES / Z_sq * (X * V_sq - X * cosine - R * sine)
    return P, Q


def operating_point_discriminant(P: Any, Q: Any, V_g_rms: Any, R: Any, X: Any) -> tuple[Any, Any]:
    """Returns (b_0, discriminant) of :eq:`operating-point` in V² and V⁴.

    A negative discriminant means that there is no operating point.
    """
    Z_sq = R * R + X * X
    b_0 = 2.0 * (R * P + X * Q) / PHASES + V_g_rms * V_g_rms
    return b_0, b_0 * b_0 - 4.0 * Z_sq * (P * P + Q * Q) / (PHASES * PHASES)


def operating_point(P: Any, Q: Any, V_g_rms: Any, R: Any, X: Any) -> tuple[Any, Any]:
    """The voltage V∠δ that delivers P and Q. It is the high-voltage root of :eq:`operating-point`.

    Returns (V_rms, delta) in V and rad. Both are NaN where the power flow has no real root.
    """
    b_0, discriminant = operating_point_discriminant(P, Q, V_g_rms, R, X)
    V_sq = 0.5 * (b_0 + np.sqrt(discriminant))
    return np.sqrt(V_sq), power_angle(P, Q, V_sq, R, X)


def power_angle(P: Any, Q: Any, V_sq: Any, R: Any, X: Any) -> Any:
    """The angle δ in rad of a voltage that delivers P and Q (:eq:`operating-point`). V_sq is its square in V²."""
    return np.arctan2(X * P - R * Q, PHASES * V_sq - R * P - X * Q)


def source_behind(P: Any, Q: Any, V_rms: Any, R: Any, X: Any) -> tuple[Any, Any]:
    """The source behind a path to which a voltage delivers P and Q: the inverse of :func:`operating_point`.

    Returns (V_g_rms, delta) in V and rad.
    """
    along = V_rms - (R * P + X * Q) / (PHASES * V_rms)
    across = (X * P - R * Q) / (PHASES * V_rms)
    return np.sqrt(along * along + across * across), np.arctan2(across, along)


def largest_scale(P: Any, Q: Any, V_g_rms: Any, R: Any, X: Any) -> Any:
    """The largest s for which s·(P, Q) has an operating point; scaling R and X by s has the same effect.

    As a function of s, the discriminant of :eq:`operating-point` is (V_g² + s c)² − 4 s² Z²S²/9 with
    c = 2(RP + XQ)/3, which is the product of two linear factors. (P, Q) must be neither zero nor proportional to
    (R, X): there is no limit in these cases.
    """
    c = 2.0 * (R * P + X * Q) / PHASES
    return V_g_rms * V_g_rms / (2.0 * np.hypot(R, X) * np.hypot(P, Q) / PHASES - c)


def admittance(V_rms: Any, R: Any, X: Any, Z_sq: Any) -> tuple[Any, Any]:
    """Returns (b, g) in W: 3V² times the susceptance X/Z² and the conductance R/Z² of a path. Z_sq is R² + X²."""
    scale = PHASES * V_rms * V_rms / Z_sq
    return scale * X, scale * R


def converter_side(P: Any, Q: Any, V_sq: Any, shunt: tuple[Any, Any], series: tuple[Any, Any]) -> tuple[Any, Any]:
    """Squares of the converter's current and of the bridge's voltage, each times V² (:eq:`converter-side`).

    All in per unit. ``shunt``: conductance and susceptance of the capacitor, ``series``: R and X of the inductor on the
    side of the bridge. Both are homogeneous of second degree in P, Q and V². Returns (current, voltage).
    """
    along, across = P + shunt[0] * V_sq, Q - shunt[1] * V_sq
    drop_along = V_sq + series[0] * along + series[1] * across
    drop_across = series[1] * along - series[0] * across
    return along * along + across * across, drop_along * drop_along + drop_across * drop_across


def jacobian_from_admittance(P: Any, Q: Any, V_rms: Any, b: Any, g: Any) -> tuple[Any, Any, Any, Any]:
    """The Jacobian of :eq:`jacobian-from-powers` for b and g of :func:`admittance`. Returns (A, B, C, D)."""
    return b - Q, (P + g) / V_rms, P - g, (b + Q) / V_rms


def jacobian_from_powers(P: Any, Q: Any, V_rms: Any, R: Any, X: Any) -> tuple[Any, Any, Any, Any]:
    """The Jacobian from measured P, Q and V; neither δ nor a solver is needed (:eq:`jacobian-from-powers`).

    Returns (A, B, C, D): A = ∂P/∂δ (W/rad), B = ∂P/∂V (W/V), C = ∂Q/∂δ (var/rad), D = ∂Q/∂V (var/V). V is phase rms.
    """
    b, g = admittance(V_rms, R, X, R * R + X * X)
    return jacobian_from_admittance(P, Q, V_rms, b, g)


def carried_share(P: Any, Q: Any, V_rms: Any, Z_sq: Any) -> Any:
    """Largest share of an impedance, at most 1, that carries P and Q with POWER_MARGIN (:eq:`drawn-in`)."""
    limit = PHASES * V_rms * V_rms
    wanted_sq = POWER_MARGIN * POWER_MARGIN * (P * P + Q * Q) * Z_sq
    return limit / np.sqrt(np.maximum(wanted_sq, limit * limit))


def well_posed_power(Q: Any, b: Any) -> Any:
    """Limits Q in both directions, so that A and D·V are at least LEAST_SHARE of b (:eq:`well-posed`)."""
    most = (1.0 - LEAST_SHARE) * b
    return np.minimum(np.maximum(Q, -most), most)


def scheduled_jacobian(P: Any, Q: Any, V_rms: Any, R: Any, X: Any) -> tuple[Any, Any, Any, Any]:
    """The Jacobian A, B, C, D from which gains are made, for an estimated impedance with X > 0 that may be wrong.

    An impedance that cannot carry the measured P and Q with POWER_MARGIN is too large. R and X are then drawn in: they
    are reduced at constant angle until they carry P and Q with this margin (:eq:`drawn-in`). Q is limited so that A and
    D·V are at least LEAST_SHARE of b (:eq:`well-posed`). Without these two measures the gains would grow without bound
    near the power limit of a grid. The Jacobian is that of :func:`jacobian_from_powers`.
    """
    share = carried_share(P, Q, V_rms, R * R + X * X)
    R, X = share * R, share * X
    b, g = admittance(V_rms, R, X, R * R + X * X)
    return jacobian_from_admittance(P, well_posed_power(Q, b), V_rms, b, g)


def dQ_dV_as_published(delta: Any, V_rms: Any, V_g_rms: Any, R: Any, X: Any) -> Any:
    """The expression that the paper prints for D. It is C = ∂Q/∂δ, and it is here for comparison only.

    The derivative of :eq:`power-flow` with respect to V is 3/Z²·(X(2V − V_g cos δ) − R V_g sin δ).
    """
    Z_sq = R * R + X * X
    return PHASES / Z_sq * V_rms * V_g_rms * (X * np.sin(delta) - R * np.cos(delta))
