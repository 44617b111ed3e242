"""Operating points: closed form for given P and Q, a quartic equation with voltage droop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vsgdesign.equations.power_flow import (
    jacobian_from_powers,
    largest_scale,
    operating_point,
    operating_point_discriminant,
    power_flow,
)
from vsgdesign.errors import NoOperatingPointError
from vsgdesign.frames import PHASES
from vsgdesign.operating_point.droop import points_with_droop


@dataclass(frozen=True, kw_only=True)
class OperatingPoint:
    """An operating point: powers (W, var), V (phase rms), δ (rad) and the Jacobian at this point.

    A = ∂P/∂δ, B = ∂P/∂V, C = ∂Q/∂δ, D = ∂Q/∂V. A voltage beyond its limits sets ``V_within_limits`` to False and raises
    no error.
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

    R and X are in Ω, from the control point to the source. Raises NoOperatingPointError if the source has no voltage or
    if the power flow has no real solution. The message then says by how much the request is too large and what to
    change.
    """
    _require_voltage(P, V_g_rms)
    _, discriminant = operating_point_discriminant(P, Q, V_g_rms, R, X)
    if not discriminant >= 0.0:
        raise _no_operating_point(P, Q, V_g_rms, R, X)
    V_rms, delta = (float(value) for value in operating_point(P, Q, V_g_rms, R, X))
    return _at(P, Q, V_rms, delta, R, X, V_limits_rms)


def solve_with_droop(
    P: float, Q_ref: float, D_q: float, V_n_rms: float, V_g_rms: float, R: float, X: float
) -> OperatingPoint:
    """The operating point where Q = Q_ref + D_q (V_n − V), the steady state of the Q loop. D_q is in var/V rms.

    V is the highest root of :eq:`droop-quartic`, since the lower one is on the lower side of the nose curve. Raises
    NoOperatingPointError if there is none. The message then says whether the grid or the droop is the cause, and what
    to change.
    """
    if D_q == 0.0:
        return solve_operating_point(P, Q_ref, V_g_rms, R, X)
    _require_voltage(P, V_g_rms)
    V_rms, delta = _with_droop(P, Q_ref, D_q, V_n_rms, V_g_rms, R, X)
    if np.isnan(V_rms):
        raise _no_point_with_droop(P, Q_ref, D_q, V_n_rms, V_g_rms, R, X)
    Q = float(power_flow(delta, V_rms, V_g_rms, R, X)[1])
    return _at(P, Q, V_rms, delta, R, X, (0.0, np.inf))


def _with_droop(
    P: float, Q_ref: float, D_q: float, V_n_rms: float, V_g_rms: float, R: float, X: float
) -> tuple[float, float]:
    """V and δ; NaN where grid and Q–V droop agree at no voltage."""
    lane = (np.array([value], dtype=float) for value in (P, Q_ref, D_q, V_n_rms, V_g_rms, R, X))
    V_rms, delta = points_with_droop(*lane)
    return float(V_rms[0]), float(delta[0])


def _at(P: float, Q: float, V_rms: float, delta: float, R: float, X: float, limits: tuple) -> OperatingPoint:
    A, B, C, D = (float(entry) for entry in jacobian_from_powers(P, Q, V_rms, R, X))
    return OperatingPoint(
        P=P, Q=Q, V_rms=V_rms, delta=delta, A=A, B=B, C=C, D=D, V_within_limits=bool(limits[0] <= V_rms <= limits[1])
    )


def _require_voltage(P: float, V_g_rms: float) -> None:
    if not V_g_rms > 0.0:
        raise NoOperatingPointError(
            f"no operating point: the grid source has no voltage (V_g = {V_g_rms:.4g} V, a bolted fault). End the "
            "fault after a short time (an event with V_g_pu above 0), or use a source with a voltage.",
            shortfall_w=abs(P),
        )


_BISECTIONS = 20


def _no_point_with_droop(
    P: float, Q_ref: float, D_q: float, V_n_rms: float, V_g_rms: float, R: float, X: float
) -> NoOperatingPointError:
    """Which of grid and droop forbids it, and remedies that were tried."""
    if not operating_point_discriminant(P, Q_ref, V_g_rms, R, X)[1] >= 0.0:
        return _no_operating_point(P, Q_ref, V_g_rms, R, X)
    plain = solve_operating_point(P, Q_ref, V_g_rms, R, X)

    def has_point(share: float, droop: float) -> bool:
        return not np.isnan(_with_droop(share * P, Q_ref, droop, V_n_rms, V_g_rms, R, X)[0])

    remedies, shortfall = [], float("nan")
    share = _largest(lambda s: has_point(s, D_q))
    if share > 0.0:
        remedies.append(f"scale P to {100.0 * share:.3g} % ({share * P / 1e3:.4g} kW)")
        shortfall = (1.0 - share) * abs(P)
    weaker = _largest(lambda s: has_point(1.0, s * D_q))
    if weaker > 0.0:
        remedies.append(f"weaken the droop to D_q = {weaker * D_q:.4g} var/V ({100.0 * weaker:.3g} % of it)")
    change = f" Change one: {', or '.join(remedies)}." if remedies else " Lower P, or weaken the droop."
    drooped = D_q * (V_n_rms - plain.V_rms)
    message = (
        f"no steady state with the Q–V droop: the grid (R = {R:.4g} Ω, X = {X:.4g} Ω, {V_g_rms:.4g} V rms) carries "
        f"P = {P / 1e3:.4g} kW and Q = {Q_ref / 1e3:.4g} kvar at {plain.V_rms:.4g} V rms, but there the droop "
        f"(D_q = {D_q:.4g} var/V about {V_n_rms:.4g} V) asks for {abs(drooped) / 1e3:.4g} kvar "
        f"{'more' if drooped > 0.0 else 'less'}, and at no voltage do grid and droop agree.{change}"
    )
    return NoOperatingPointError(message, shortfall_w=shortfall)


def _largest(holds: Callable[[float], bool]) -> float:
    """The largest share below one for which a condition holds that holds for small ones; zero if not even those."""
    low, high = 0.0, 1.0
    if not holds(1e-6):
        return 0.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _no_operating_point(P: float, Q: float, V_g_rms: float, R: float, X: float) -> NoOperatingPointError:
    """By how much, and which quantity to change."""
    low, high = feasible_powers(Q, V_g_rms, R, X)
    Z, S = float(np.hypot(R, X)), float(np.hypot(P, Q))
    scale = float(largest_scale(P, Q, V_g_rms, R, X))
    shortfall = max(P - high, low - P) if np.isfinite(low) else S * (1.0 - scale)
    message = (
        f"no operating point: P = {P / 1e3:.4g} kW, Q = {Q / 1e3:.4g} kvar cannot cross |Z| = {Z:.4g} Ω "
        f"(R = {R:.4g} Ω, X = {X:.4g} Ω) from {V_g_rms:.4g} V rms. "
    )
    if np.isfinite(low):
        nearest = high if high < P else low
        message += f"At this Q the nearest possible P is {nearest / 1e3:.4g} kW, {shortfall / 1e3:.4g} kW away. "
    b_0, _ = operating_point_discriminant(P, Q, V_g_rms, R, X)
    helps = b_0 * X / PHASES > 2.0 * Z * Z * Q / PHASES**2  # the discriminant grows with Q
    message += (
        f"Change one: scale P and Q to {100.0 * scale:.3g} % ({S * scale / 1e3:.4g} kVA), reduce |Z| to "
        f"{Z * scale:.4g} Ω (raise the SCR {1.0 / scale:.3g} times), or {'raise' if helps else 'lower'} Q."
    )
    return NoOperatingPointError(message, shortfall_w=float(shortfall))


def feasible_powers(Q: float, V_g_rms: float, R: float, X: float) -> tuple[float, float]:
    """Least and largest P in W that the grid carries at this Q; NaN, NaN if it carries none.

    The discriminant of :eq:`operating-point` is a quadratic in P with leading coefficient −4X²/9, positive
    between its roots. Without reactance one side has no limit.
    """
    Z_sq = R * R + X * X
    b_0 = 2.0 * X * Q / PHASES + V_g_rms * V_g_rms
    constant = b_0 * b_0 - 4.0 * Z_sq * Q * Q / PHASES**2
    half_linear, quadratic = 2.0 * R * b_0 / PHASES, -4.0 * X * X / PHASES**2
    inside = half_linear * half_linear - quadratic * constant
    if inside < 0.0:
        return float("nan"), float("nan")
    if quadratic == 0.0:
        return (-constant / (2.0 * half_linear), float("inf")) if half_linear > 0.0 else (float("nan"), float("nan"))
    # The larger root by magnitude first: the other follows from their product without cancellation.
    first = -(half_linear + np.copysign(np.sqrt(inside), half_linear)) / quadratic
    second = constant / (quadratic * first) if first != 0.0 else 0.0
    return float(min(first, second)), float(max(first, second))
