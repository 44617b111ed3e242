"""The power loops' state matrix over boxes of grids, powers and estimate errors, as Taylor forms.

A box is one of *estimates*. With the estimate, P, Q and V held, the gains are held, and the state matrix is affine in
the true (b, g): all true grids that an error allows are covered by the corners of a polygon around them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.design.certificate.region import OMEGA_SCALE, Region, System
from vsgdesign.design.certificate.taylor_form import TaylorForm, box_variables
from vsgdesign.equations.power_flow import jacobian_from_powers, operating_point_discriminant
from vsgdesign.equations.structures import decoupling, poles_of_inertia
from vsgdesign.frames import PHASES
from vsgdesign.parameters.specification import POWER_MARGIN

Array = NDArray[np.float64]

UNIT = np.array([0.2, 0.5, 1.0, 0.5, 0.5, 0.5])
"""A size for each coordinate, P and Q per unit: how boxes are cut where nothing better is known."""


@dataclass(frozen=True)
class Enclosure:
    """N boxes: the state matrix at each corner of the true grids' polygon, ``empty`` where no point of the box is in
    the region and its static limits, and forms that hold 1/SCR and R/X of the true grid."""

    corners: list[list[list[Any]]]
    empty: NDArray[np.bool_]
    weakness: Any
    r_over_x: Any


def estimate_box(region: Region, system: System) -> tuple[Array, Array]:
    """Limits (6,) of |Z_g|/Z_base and atan(X/R) of all estimates of the region's grids, of P and Q per unit of the
    rating, and of both errors."""
    e, S = region.error, system.study.converter.S_rated
    ratio = region.x_over_r[0] * (1.0 - e) / (1.0 + e), region.x_over_r[1] * (1.0 + e) / (1.0 - e)
    size = np.array([1.0 / region.scr[1], 1.0 / region.scr[0]])
    if system.study.scr_basis == "reactance":
        size *= np.hypot(1.0, 1.0 / np.array(region.x_over_r[::-1]))
    rows = [
        (size[0] * (1.0 - e), size[1] * (1.0 + e)), tuple(np.arctan(ratio)),
        (region.P[0] / S, region.P[1] / S), (region.Q[0] / S, region.Q[1] / S), (-e, e), (-e, e),
    ]  # fmt: skip
    low, high = np.array(rows, dtype=float).T
    return low, high


def enclose(system: System, region: Region, low: Array, high: Array) -> Enclosure:
    """The state matrix over boxes of estimates, limits (N, 6) in the coordinates of :func:`estimate_box`
    (:eq:`certificate-matrix`, :eq:`estimate-polygon`)."""
    c, source, f = system.study.converter, system.study.grid_source, system.study.filter
    size, angle, P, Q, e_R, e_L = box_variables(low, high)
    r_g, x_g = np.cos(angle), np.sin(angle)
    # In units of |Ẑ_g| and V_rated²/|Ẑ_g|: most of what strong and weak grids differ in is gone (:eq:`grid-units`).
    share = source.omega_g / c.omega_n
    r_2, x_2 = f.R_2 / c.Z_base, c.omega_n * f.L_2 / c.Z_base
    fixed = (size.reciprocal() * r_2, size.reciprocal() * x_2) if r_2 or x_2 else (0.0, 0.0)
    path_hat = (r_g + fixed[0], x_g + fixed[1])
    true_r, true_x = r_g / (1.0 + e_R), x_g / (1.0 + e_L)
    base = size * PHASES  # |Ẑ_g|·S/V_rated²: Z_base·S = PHASES·V_rated²
    p, q = P * base, Q * base
    path = (true_r + fixed[0], (true_x + fixed[1]) * share)
    V, outside = _voltage(system, p, q, path)
    weakness = size * (true_x if system.study.scr_basis == "reactance" else np.sqrt(true_r * true_r + true_x * true_x))
    r_over_x = true_r / true_x
    for value, limits in ((weakness, region.scr), (r_over_x, region.x_over_r)):
        least, most = value.limits
        outside |= (least > 1.0 / limits[0]) | (most < 1.0 / limits[1])
    # From here on errors act through the polygon, and on V as one quantity of its own between bounds.
    errors = np.isin(np.flatnonzero((high > low).any(axis=0)), (4, 5))
    V, weakness, r_over_x = (value.without(errors) for value in (V, weakness, r_over_x))
    V = V.as_one(errors)
    nominal = _Nominal.of(system, (p, q, V), path_hat, base)
    corners = []
    V_sq = V * V
    taken = jacobian_from_powers(0.0, 0.0, 1.0, *path_hat)
    for b, g in _polygon((r_g, x_g), fixed, share, low[:, 4:], high[:, 4:]):
        b_off, g_off = b * PHASES - taken[0], g * PHASES - taken[1]
        off = (b_off * V_sq, g_off * V, -(g_off * V_sq), b_off * V)
        corners.append(nominal.matrix(off))
    if not corners:
        corners.append(nominal.matrix(None))
    return Enclosure(corners, outside, weakness, r_over_x)


def _voltage(system: System, p: Any, q: Any, path: Any) -> tuple[TaylorForm, NDArray[np.bool_]]:
    """V per unit where it lies within the static limits, and which boxes hold no such point (:eq:`static-limits`).

    Within the limits V² ≥ V_min² and |Z|²|S|²/9 ≤ V⁴/1.3², so the root of the discriminant, V² less
    |Z|²|S|²/(9V²), is at least V_min²(1 − 1/1.3²): the roots below never meet zero.
    """
    c = system.study.converter
    low, high = c.V_min_pu**2, c.V_max_pu**2
    least = (low * (1.0 - POWER_MARGIN**-2)) ** 2
    b_0, discriminant = operating_point_discriminant(p, q, system.study.grid_source.V_g_rms / c.V_rated_rms, *path)
    V_sq = 0.5 * (b_0 + discriminant.sqrt(least))
    reach = (path[0] * path[0] + path[1] * path[1]) * (p * p + q * q) * (1.0 / PHASES**2)
    V_low, V_high = V_sq.limits
    outside = (discriminant.limits[1] < least) | (V_high < low) | (V_low > high)
    return V_sq.sqrt(low), outside | (np.minimum(V_high, high) ** 2 < POWER_MARGIN**2 * reach.limits[0])


def _polygon(direction: Any, fixed: Any, share: float, low: Array, high: Array) -> list[tuple[Any, Any]]:
    """Corners (b, g)/3V² that enclose all true grids of an estimate (:eq:`estimate-polygon`); none without errors.

    The image of a rectangle of (R, X) under (R, X)/|Z|²: its corners, and where the tangents of the two arcs that
    bulge outwards meet.
    """
    if not (high > low).any():
        return []
    r_1, r_2 = (direction[0] * (1.0 / (1.0 + e)) + fixed[0] for e in (high[:, 0], low[:, 0]))
    x_1, x_2 = ((direction[1] * (1.0 / (1.0 + e)) + fixed[1]) * share for e in (high[:, 1], low[:, 1]))
    found = []
    for r, x in ((r_1, x_1), (r_1, x_2), (r_2, x_1), (r_2, x_2)):
        inverse = (r * r + x * x).reciprocal()
        found.append((x * inverse, r * inverse))
    inverse = (r_1 * r_1 + x_1 * x_2).reciprocal()
    found.append(((x_1 + x_2) * 0.5 * inverse, r_1 * inverse))
    inverse = (x_1 * x_1 + r_1 * r_2).reciprocal()
    found.append((x_1 * inverse, (r_1 + r_2) * 0.5 * inverse))
    return found


@dataclass(frozen=True)
class _Nominal:
    """The loops about an exact estimate: what is enclosed is the small part that the error adds."""

    W: tuple[Any, Any, Any, Any]
    poles: tuple[Any, Any, Any]
    kept: tuple[Any, Any]
    """Coupling B and C that the shares leave in."""
    pull: Any
    across: Any
    k_d: Any

    @classmethod
    def of(cls, system: System, at: Any, path_hat: Any, base: Any) -> _Nominal:
        """From the measured p, q, V and the estimated path, as the closed-form schedule makes its gains."""
        s: Any = system.schedule
        c = system.study.converter
        k_1, d_1, k_2, q_share, share_P, share_Q = s.normalised(0.0, 0.0)
        A, B, C, D = jacobian_from_powers(*at, *path_hat)
        per_unit = base * (1.0 / c.S_rated)  # powers of the schedule, droops and rating, to these units
        droop = q_share * D
        if s.structure != "published":
            droop = droop + per_unit * (s.D_q * c.V_rated_rms)
        if s.law == "inertia":
            k_1, d_1 = poles_of_inertia(A, k_1, d_1, per_unit * s.S_rated, s.omega)
        W = decoupling(A, B, C, D, droop, share_P, share_Q)
        if s.structure == "angle_damped":
            D_p = per_unit * s.D_p
            pull, across = W[0] * D_p * k_1, W[2] * D_p * k_2
            k_d = d_1 - pull
        else:
            pull, k_d = d_1, 0.0
            across = W[2] / W[0] * (d_1 / k_1 * k_2) if share_Q else 0.0
        return cls(W, (k_1, d_1, k_2), (B * (1.0 - share_P), C * (1.0 - share_Q)), pull, across, k_d)

    def matrix(self, off: Any) -> list[list[Any]]:
        """A of the scaled states where the true Jacobian is off the estimated one by ``off``."""
        w11, w12, w21, w22 = self.W
        a, b, c, d = off if off is not None else (0.0, 0.0, 0.0, 0.0)
        b, c = b + self.kept[0], c + self.kept[1]
        z11, z12 = w11 * a + w12 * c + 1.0, w11 * b + w12 * d
        z21, z22 = w21 * a + w22 * c, w21 * b + w22 * d + 1.0
        (k_1, _, k_2), pull, across, k_d, o = self.poles, self.pull, self.across, self.k_d, OMEGA_SCALE
        speed = -(z11 * k_d), -(z12 * k_d)
        return [
            [speed[0], o, speed[1]],
            [-(z11 * k_1 + speed[0] * pull) * (1.0 / o), -pull, -(z12 * k_1 + speed[1] * pull) * (1.0 / o)],
            [-(z21 * k_2 + speed[0] * across), -(across * o), -(z22 * k_2 + speed[1] * across)],
        ]
