"""Operating points: closed form for given P and Q, one scalar equation with voltage droop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import root_scalar

from vsgdesign.equations.power_flow import (
    jacobian_from_powers,
    operating_point,
    operating_point_discriminant,
    power_flow,
)
from vsgdesign.errors import NoOperatingPointError
from vsgdesign.frames import PHASES


@dataclass(frozen=True)
class OperatingPoint:
    """Where the converter sits: powers (W, var), V (phase rms), δ (rad) and the Jacobian there.

    A = ∂P/∂δ, B = ∂P/∂V, C = ∂Q/∂δ, D = ∂Q/∂V. ``V_within_limits`` is a flag, not an error.
    """

    P: float
    Q: float
    V_rms: float
    delta: float
    A: float
    B: float
    C: float
    D: float
    V_within_limits: bool = True


def solve_operating_point(
    P: float, Q: float, V_g_rms: float, R: float, X: float, V_limits_rms: tuple[float, float] = (0.0, np.inf)
) -> OperatingPoint:
    """The operating point that delivers P and Q, in closed form (:eq:`operating-point`).

    R and X in Ω from the control point to the source. Raises NoOperatingPointError where the power flow has no
    real solution, saying by how much the request is too large and what to change.
    """
    _, discriminant = operating_point_discriminant(P, Q, V_g_rms, R, X)
    if not discriminant >= 0.0:
        raise _no_operating_point(P, Q, V_g_rms, R, X)
    V_rms, delta = (float(value) for value in operating_point(P, Q, V_g_rms, R, X))
    return _at(P, Q, V_rms, delta, R, X, V_limits_rms)


def solve_with_droop(
    P: float, Q_ref: float, D_q: float, V_n_rms: float, V_g_rms: float, R: float, X: float
) -> OperatingPoint:
    """The operating point where Q = Q_ref + D_q (V_n − V): the Q loop at rest. D_q in var/V rms.

    For each V the angle that delivers P is known in closed form, so one scalar equation in V is left; its
    highest root is taken (the lower one is the far side of the nose curve).
    """
    if D_q == 0.0:
        return solve_operating_point(P, Q_ref, V_g_rms, R, X)

    def surplus(V: float) -> float:
        return Q_ref + D_q * (V_n_rms - V) - float(power_flow(_angle(P, V, V_g_rms, R, X), V, V_g_rms, R, X)[1])

    grid = np.linspace(0.05, 4.0, 400) * max(V_g_rms, V_n_rms)
    values = np.array([surplus(float(V)) for V in grid])
    # The last sign change between points where an angle exists.
    signs = np.isfinite(values[:-1]) & np.isfinite(values[1:]) & (values[:-1] * values[1:] <= 0.0)
    if not signs.any():
        raise _no_operating_point(P, Q_ref, V_g_rms, R, X)
    k = int(np.flatnonzero(signs)[-1])
    solution = root_scalar(surplus, bracket=(grid[k], grid[k + 1]), method="brentq", xtol=1e-13 * V_n_rms, rtol=1e-15)
    V_rms = float(solution.root)
    delta = _angle(P, V_rms, V_g_rms, R, X)
    Q = float(power_flow(delta, V_rms, V_g_rms, R, X)[1])
    return _at(P, Q, V_rms, delta, R, X, (0.0, np.inf))


def _angle(P: float, V: float, V_g_rms: float, R: float, X: float) -> float:
    """The stable δ that delivers P at voltage V: R V² + |Z| V V_g sin(δ − atan(R/X)) = P|Z|²/3; NaN if none."""
    Z = np.hypot(R, X)
    ratio = (P * Z * Z / PHASES - R * V * V) / (Z * V * V_g_rms)
    return float(np.arctan2(R, X) + np.arcsin(ratio)) if abs(ratio) <= 1.0 else np.nan


def _at(P: float, Q: float, V_rms: float, delta: float, R: float, X: float, limits: tuple) -> OperatingPoint:
    A, B, C, D = (float(entry) for entry in jacobian_from_powers(P, Q, V_rms, R, X))
    return OperatingPoint(P, Q, V_rms, delta, A, B, C, D, bool(limits[0] <= V_rms <= limits[1]))


def _no_operating_point(P: float, Q: float, V_g_rms: float, R: float, X: float) -> NoOperatingPointError:
    """By how much, and which quantity to change."""
    P_max = largest_power(P, Q, V_g_rms, R, X)
    Z = float(np.hypot(R, X))
    S = float(np.hypot(P, Q))
    shrink = largest_scale(P, Q, V_g_rms, R, X)
    message = (
        f"no operating point: P = {P / 1e3:.4g} kW, Q = {Q / 1e3:.4g} kvar cannot cross |Z| = {Z:.4g} Ω "
        f"(R = {R:.4g} Ω, X = {X:.4g} Ω) from {V_g_rms:.4g} V rms. "
    )
    if np.isfinite(P_max):
        message += f"At this Q the most is P = {P_max / 1e3:.4g} kW, {(abs(P) - abs(P_max)) / 1e3:.4g} kW less. "
    message += (
        f"Change one: scale P and Q to {100.0 * shrink:.3g} % ({S * shrink / 1e3:.4g} kVA), reduce |Z| to "
        f"{Z * shrink:.4g} Ω (raise the SCR {1.0 / shrink:.3g} times), or raise Q."
    )
    shortfall = abs(P) - abs(P_max) if np.isfinite(P_max) else S * (1.0 - shrink)
    return NoOperatingPointError(message, shortfall_w=shortfall)


def largest_power(P: float, Q: float, V_g_rms: float, R: float, X: float) -> float:
    """The largest P of the sign of P that the grid carries at this Q, in W; NaN if it carries none.

    The discriminant of :eq:`operating-point` is a quadratic in P with leading coefficient −4X²/9.
    """
    Z_sq = R * R + X * X
    b_0 = 2.0 * X * Q / PHASES + V_g_rms * V_g_rms
    constant = b_0 * b_0 - 4.0 * Z_sq * Q * Q / PHASES**2
    roots = np.roots([-4.0 * X * X / PHASES**2, 4.0 * R * b_0 / PHASES, constant])
    real = roots.real[np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots.real))]
    side = real[real >= 0.0] if P >= 0.0 else real[real <= 0.0]
    return float(max(side, key=abs)) if side.size else np.nan


def largest_scale(P: float, Q: float, V_g_rms: float, R: float, X: float) -> float:
    """The largest s for which s·(P, Q) has an operating point; scaling Z by s instead has the same effect."""
    # With s: (V_g² + s c)² − 4 s² d = 0 where c = 2(RP + XQ)/3, d = Z²S²/9: linear factors in s.
    c = 2.0 * (R * P + X * Q) / PHASES
    root_d = float(np.hypot(R, X) * np.hypot(P, Q)) / PHASES
    return float(V_g_rms * V_g_rms / (2.0 * root_d - c)) if 2.0 * root_d > c else np.inf
