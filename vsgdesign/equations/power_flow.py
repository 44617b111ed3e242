"""Power flow between the control point (V∠δ) and the grid source (V_g∠0) behind R + jX, and what stands between it and
the power loops: lags of the powers, and a voltage that yields.

V and V_g are phase rms voltages in V. P and Q are three-phase powers in W and var, positive into the grid. For an LCL
filter, R and X include the grid-side inductor, because the control point is the filter capacitor.

The plant of the power loops is slow: the inner loops are ideal and the grid's current follows its voltage at once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.inner_loops import InnerLoopGains, transient_impedance

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


class Lags(NamedTuple):
    """Time constants of the power filters in s, and the transient impedance R_t + jX_t in Ω with its corner in
    rad/s."""

    tau_P: Any = 0.0
    tau_Q: Any = 0.0
    R_t: Any = 0.0
    X_t: Any = 0.0
    omega_t: Any = 0.0

    @property
    def yields(self) -> bool:
        """Whether the voltage yields to changes of the current."""
        return bool(self.R_t != 0.0 or self.X_t != 0.0)


class Yielding(NamedTuple):
    """The plant behind a transient impedance: powers in W and var, the voltage that the impedance leaves and the rates
    of the current behind its low-pass, in V and A/s, d and q in the converter's frame, rms."""

    P: Any
    Q: Any
    v_d: Any
    v_q: Any
    di_f_d: Any
    di_f_q: Any


def current_of_power(P: Any, Q: Any, v_d: Any, v_q: Any) -> tuple[Any, Any]:
    """The current in A rms that carries P and Q at a voltage in V rms. Returns (i_d, i_q)."""
    scale = PHASES * (v_d * v_d + v_q * v_q)
    return (P * v_d + Q * v_q) / scale, (P * v_q - Q * v_d) / scale


def yielding_plant(
    delta: Any,
    V_rms: Any,
    v_d: Any,
    v_q: Any,
    i_f_d: Any,
    i_f_q: Any,
    V_g_rms: Any,
    R: Any,
    X: Any,
    lags: Lags,
) -> Yielding:
    """The power loops' plant with a transient impedance (:eq:`yielding-plant`).

    ``v_d`` and ``v_q`` are the capacitor's voltage in V rms, ``i_f_d`` and ``i_f_q`` the current behind the low-pass in
    A rms, both in the frame of δ. It holds where the voltage is the one that is returned.
    """
    P, Q = power_flow(delta + np.arctan2(v_q, v_d), np.sqrt(v_d * v_d + v_q * v_q), V_g_rms, R, X)
    i_d, i_q = current_of_power(P, Q, v_d, v_q)
    gains = InnerLoopGains(0.0, 0.0, 0.0, 0.0, R_t=lags.R_t, X_t=lags.X_t)
    # The low-pass of a sample of one second with the share ω_t is that of the rate.
    drop_d, drop_q, next_d, next_q = transient_impedance(i_d, i_q, i_f_d, i_f_q, gains, lags.omega_t)
    return Yielding(P, Q, V_rms - drop_d, 0.0 - drop_q, next_d - i_f_d, next_q - i_f_q)


class YieldingColumns(NamedTuple):
    """What one unit of δ (rad), of V (relative) and of the current behind the low-pass (d, then q; as a power 3V i_f)
    does, one column for each: ΔP and ΔQ, and the current less the one behind the low-pass (d, q), as a power."""

    P_delta: Any
    Q_delta: Any
    P_V: Any
    Q_V: Any
    P_d: Any
    Q_d: Any
    P_q: Any
    Q_q: Any
    d_delta: Any
    q_delta: Any
    d_V: Any
    q_V: Any
    d_d: Any
    q_d: Any
    d_q: Any
    q_q: Any

    @property
    def powers(self) -> tuple[tuple[Any, Any], ...]:
        """(ΔP, ΔQ) of each column."""
        return (self.P_delta, self.Q_delta), (self.P_V, self.Q_V), (self.P_d, self.Q_d), (self.P_q, self.Q_q)

    @property
    def change(self) -> tuple[tuple[Any, Any], ...]:
        """The change of the current (d, q) of each column."""
        return (self.d_delta, self.q_delta), (self.d_V, self.q_V), (self.d_d, self.q_d), (self.d_q, self.q_q)


def power_of_change(P: Any, Q: Any, r: Any, x: Any, d: Any, q: Any) -> tuple[Any, Any]:
    """Powers of a change d, q of the current: h − s̄ (r − jx) h̄ with h = d + jq. Returns (change_P, change_Q)."""
    own_re, own_im = P * r - Q * x, 0.0 - (P * x + Q * r)
    return d - (own_re * d + own_im * q), 0.0 - (q - (own_im * d - own_re * q))


def yielding_columns(P: Any, Q: Any, b: Any, g: Any, r: Any, x: Any) -> YieldingColumns:
    """The derivatives of :func:`yielding_plant` at rest in closed form (:eq:`yielding-columns`).

    ``b`` and ``g`` are those of :func:`~vsgdesign.equations.power_flow.admittance` for the path and the transient
    impedance in series, ``r`` and ``x`` are R_t and X_t over 3V². All four columns are affine in b and g.
    """
    # k = 1 − (r + jx)(g − jb), what is left of the current's own voltage; j s̄ = Q + jP turns with the frame.
    k_re, k_im = 1.0 - (r * g + x * b), r * b - x * g
    d_delta, q_delta = b - (k_re * Q - k_im * P), g - (k_re * P + k_im * Q)
    # What the voltage and the current behind the low-pass do at once comes to what the change of the current does.
    P_delta, Q_delta = power_of_change(P, Q, r, x, d_delta, q_delta)
    P_V, Q_V = power_of_change(P, Q, r, x, g, 0.0 - b)
    P_d, Q_d = power_of_change(P, Q, r, x, 0.0 - k_re, 0.0 - k_im)
    P_q, Q_q = power_of_change(P, Q, r, x, k_im, 0.0 - k_re)
    return YieldingColumns(
        P_delta=P_delta,
        Q_delta=Q_delta,
        P_V=P + P_V,
        Q_V=Q + Q_V,
        P_d=1.0 + P_d,
        Q_d=Q_d,
        P_q=P_q,
        Q_q=Q_q - 1.0,
        d_delta=d_delta,
        q_delta=q_delta,
        d_V=g,
        q_V=0.0 - b,
        d_d=0.0 - k_re,
        q_d=0.0 - k_im,
        d_q=k_im,
        q_q=0.0 - k_re,
    )
