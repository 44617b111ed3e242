"""Operating points under the Q–V droop for many converters at once (:eq:`droop-quartic`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_flow import (
    admittance,
    jacobian_from_powers,
    operating_point,
    power_angle,
    power_flow,
)
from vsgdesign.frames import PHASES

Array = NDArray[np.float64]

LEAST_VOLTAGE = 1e-3
"""Voltages below this share of the source's are no operating point."""

_ROUNDING = 1e-5
"""Imaginary part, as a share of the root, up to which a root of the quartic may be a real one; Newton's steps then
decide. The two roots of a fold lose half of the digits."""
_NEWTON_STEPS = 4
_AGREEMENT = 1e-9
"""Largest error of P and Q, as a share of the powers in the equation, of a point that counts as one."""


def points_with_droop(
    P: Array, Q_ref: Array, D_q: Array, V_n_rms: Any, V_g_rms: Array, R: Array, X: Array
) -> tuple[Array, Array]:
    """V (phase rms, V) and δ (rad) at which P is delivered and Q = Q_ref + D_q (V_n − V); NaN if there is no point.

    All arrays are (N,), and V_n may be a number. With droop, the result is the highest voltage at which a larger angle
    gives more power (∂P/∂δ ≥ 0). Lower ones are on the lower side of the nose curve. Without droop it is that of
    :func:`vsgdesign.equations.power_flow.operating_point`.
    """
    with np.errstate(all="ignore"):
        V_rms, delta = operating_point(P, Q_ref, V_g_rms, R, X)
        solvable = (D_q != 0.0) & (V_g_rms > 0.0)
        for value in (P, Q_ref, D_q, V_g_rms, R, X):
            solvable = solvable & np.isfinite(value)
        index = np.flatnonzero(solvable)
        V_rms[D_q != 0.0] = np.nan
        if index.size:
            V_n = np.full(P.shape, V_n_rms)
            taken = (np.asarray(value)[index] for value in (P, Q_ref, D_q, V_n, V_g_rms, R, X))
            V_rms[index], delta[index] = _with_droop(*taken)
        missing = np.isnan(V_rms) | ~(V_g_rms > 0.0)
        V_rms[missing], delta[missing] = np.nan, np.nan
    return V_rms, delta


def _with_droop(P: Array, Q_ref: Array, D_q: Array, V_n: Array, V_g: Array, R: Array, X: Array) -> tuple[Array, Array]:
    Q_0 = Q_ref + D_q * V_n  # Q at no voltage
    V = _highest_root(P, Q_0, D_q, V_g, R, X)
    delta = power_angle(P, Q_0 - D_q * V, V * V, R, X)
    for _ in range(_NEWTON_STEPS):
        P_is, Q_is = power_flow(delta, V, V_g, R, X)
        A, B, C, D = jacobian_from_powers(P_is, Q_is, V, R, X)
        D = D + D_q
        e_P, e_Q = P - P_is, Q_0 - D_q * V - Q_is
        determinant = A * D - B * C
        delta = delta + (D * e_P - B * e_Q) / determinant
        V = V + (A * e_Q - C * e_P) / determinant
    P_is, Q_is = power_flow(delta, V, V_g, R, X)
    b, g = admittance(V, R, X, R * R + X * X)
    error = np.maximum(np.abs(P - P_is), np.abs(Q_0 - D_q * V - Q_is))
    found = (error <= _AGREEMENT * (np.hypot(b, g) + np.abs(Q_0))) & (LEAST_VOLTAGE * V_g < V)
    return np.where(found, V, np.nan), np.where(found, delta, np.nan)


def _highest_root(P: Array, Q_0: Array, D_q: Array, V_g: Array, R: Array, X: Array) -> Array:
    """The highest root of :eq:`droop-quartic` with ∂P/∂δ ≥ 0, in V; NaN if there is none."""
    Z_sq = R * R + X * X
    companion = np.zeros((len(P), 4, 4))
    companion[:, 1, 0] = companion[:, 2, 1] = companion[:, 3, 2] = 1.0
    # The coefficients of 1, v, v² and v³ in v = V/V_g, with a sign.
    companion[:, 0, 3] = -Z_sq * (P * P + Q_0 * Q_0) / (PHASES * V_g * V_g) ** 2
    companion[:, 1, 3] = 2.0 * Z_sq * Q_0 * D_q / (PHASES * PHASES * V_g**3)
    companion[:, 2, 3] = 1.0 + 2.0 * (R * P + X * Q_0) / (PHASES * V_g * V_g) - Z_sq * (D_q / (PHASES * V_g)) ** 2
    companion[:, 3, 3] = -2.0 * X * D_q / (PHASES * V_g)
    roots = np.linalg.eigvals(companion)
    V = roots.real * V_g[:, None]
    b, _ = admittance(V, R[:, None], X[:, None], Z_sq[:, None])
    Q = Q_0[:, None] - D_q[:, None] * V
    real = np.abs(roots.imag) <= _ROUNDING * np.abs(roots)
    fits = real & (roots.real > LEAST_VOLTAGE) & (b + _ROUNDING * np.abs(b) >= Q)
    highest = np.max(np.where(fits, V, -np.inf), axis=1)
    return np.where(np.isfinite(highest), highest, np.nan)
