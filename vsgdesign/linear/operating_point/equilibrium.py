"""Operating points: closed form for given P and Q, a quartic equation with voltage droop (:eq:`droop-quartic`), for one
converter or many, and how much of each static limit they use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import StaticLimits
from vsgdesign.equations.frames import PHASES, rated_current_rms, rms_to_peak
from vsgdesign.equations.power_flow import (
    POWER_MARGIN,
    admittance,
    converter_side,
    jacobian_from_powers,
    largest_scale,
    operating_point,
    operating_point_discriminant,
    power_angle,
    power_flow,
)
from vsgdesign.equations.sampled_path import droop_step
from vsgdesign.errors import NoOperatingPointError
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.study import Study

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
            V_rms[index], delta[index] = _largest_roots(*taken)
        missing = np.isnan(V_rms) | ~(V_g_rms > 0.0)
        V_rms[missing], delta[missing] = np.nan, np.nan
    return V_rms, delta


def _largest_roots(
    P: Array, Q_ref: Array, D_q: Array, V_n: Array, V_g: Array, R: Array, X: Array
) -> tuple[Array, Array]:
    Q_0 = Q_ref + D_q * V_n  # Q at no voltage
    V = _highest_root(P, Q_0, D_q, V_g, R, X)
    delta = power_angle(P, Q_0 - D_q * V, V * V, R, X)
    for _ in range(_NEWTON_STEPS):
        V, delta, _ = droop_step(V, delta, P, Q_0, D_q, V_g, R, X)
    found = (droop_step(V, delta, P, Q_0, D_q, V_g, R, X)[2] <= _AGREEMENT) & (LEAST_VOLTAGE * V_g < V)
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
    return point_at(P, Q, V_rms, delta, R, X, V_limits_rms)


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
    return point_at(P, Q, V_rms, delta, R, X)


def _with_droop(
    P: float, Q_ref: float, D_q: float, V_n_rms: float, V_g_rms: float, R: float, X: float
) -> tuple[float, float]:
    """V and δ; NaN where grid and Q–V droop agree at no voltage."""
    lane = (np.array([value], dtype=float) for value in (P, Q_ref, D_q, V_n_rms, V_g_rms, R, X))
    V_rms, delta = points_with_droop(*lane)
    return float(V_rms[0]), float(delta[0])


def point_at(
    P: float,
    Q: float,
    V_rms: float,
    delta: float,
    R: float,
    X: float,
    V_limits_rms: tuple[float, float] = (0.0, np.inf),
) -> OperatingPoint:
    """A known operating point with its Jacobian."""
    A, B, C, D = (float(entry) for entry in jacobian_from_powers(P, Q, V_rms, R, X))
    within = bool(V_limits_rms[0] <= V_rms <= V_limits_rms[1])
    return OperatingPoint(P=P, Q=Q, V_rms=V_rms, delta=delta, A=A, B=B, C=C, D=D, V_within_limits=within)


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


_SAMPLED_SHARE = 0.995
"""Of the bridge's voltage limit and of the current: the rest is for the sampled bridge, which makes its fundamental in
steps."""


def static_limits(study: Study) -> StaticLimits:
    """The static limits of a study: those of V and of the grid, the current from which on a limiter acts, and the
    voltage of the bridge."""
    return limits_of_converter(study.converter, acting_current_pk(study))


def limits_of_converter(c: Converter, acting_pk: float) -> StaticLimits:
    """The same of a converter whose limiter acts from a current on, A peak; infinite where it has none."""
    return StaticLimits(
        V_low=c.V_min_pu,
        V_high=c.V_max_pu,
        power_transfer=POWER_MARGIN,
        current=_SAMPLED_SHARE * acting_pk / c.I_rated_pk if np.isfinite(acting_pk) else None,
        bridge_voltage=_SAMPLED_SHARE * c.v_max_pk / rms_to_peak(c.V_rated_rms),
    )


class HasFilter(Protocol):
    """What has a converter with its filter: a study, or what a gain table keeps of one."""

    @property
    def converter(self) -> Converter: ...

    @property
    def filter(self) -> Filter: ...


def static_limit_uses(study: Study, R: Any, X: Any, omega_g: Any, P: Any, Q: Any, V_rms: Any) -> dict[str, Array]:
    """:func:`uses_of` of a study's own limits."""
    return uses_of(static_limits(study), study, R, X, omega_g, P, Q, V_rms)


def uses_of(
    limits: StaticLimits, of: HasFilter, R: Any, X: Any, omega_g: Any, P: Any, Q: Any, V_rms: Any
) -> dict[str, Array]:
    """The share of each static limit that operating points use, (N,) each; 1 is on the limit (:eq:`static-limits`).

    R and X in Ω lead from the control point to the source at omega_g (rad/s). P (W), Q (var) and V (phase rms, V) are
    those at the control point. A share is NaN where one of them is, and zero where there is no such limit.
    """
    c = of.converter
    V_pu = V_rms / c.V_rated_rms
    P, Q = P / c.S_rated, Q / c.S_rated
    carried = V_pu * V_pu * c.Z_base / np.hypot(R, X)

    def used(value: Any, limit: float | None) -> Array:
        return 0.0 * value if limit is None else value / limit

    with np.errstate(invalid="ignore"):
        current, bridge = converter_side(P, Q, V_pu * V_pu, *converter_side_of(of, omega_g))
        return {
            "power transfer": (limits.power_transfer or 0.0) * np.hypot(P, Q) / carried,
            "least voltage": (limits.V_low or 0.0) / V_pu,
            "largest voltage": used(V_pu, limits.V_high),
            "current": used(np.sqrt(current) / V_pu, limits.current),
            "bridge voltage": used(np.sqrt(bridge) / V_pu, limits.bridge_voltage),
        }


def converter_side_of(of: HasFilter, omega_g: Any) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Per unit of :func:`vsgdesign.equations.power_flow.converter_side`: conductance and susceptance of the capacitor,
    R and X of the inductor before it, at a frequency (rad/s)."""
    f, Z_base = of.filter, of.converter.Z_base
    shunt = Z_base * 1j * omega_g * f.C / (1.0 + 1j * omega_g * f.C * f.R_c)
    return (shunt.real, shunt.imag), (f.R_1 / Z_base, omega_g * f.L_1 / Z_base)


def acting_current_pk(study: Study) -> float:
    """The converter current from which on the study's limiter acts, A peak: its soft limit, where it has one.

    No steady state may lie above it. Infinite without a current limit.
    """
    if study.converter.current_limit_pu is None:
        return np.inf
    settings = study.controller_settings()
    return float(min(settings.i_max_pk, getattr(settings.limiter, "i_soft_pk", np.inf)))


def converter_current_rms(study: Study, omega_g: Any, P: Any, Q: Any, V_rms: Any) -> Any:
    """The current through L_1 as a phasor against the voltage at the control point, A rms: that into the grid and
    that of the capacitor."""
    f = study.filter
    shunt = 1j * omega_g * f.C / (1.0 + 1j * omega_g * f.C * f.R_c)
    return rated_current_rms(P - 1j * Q, V_rms) + shunt * V_rms
