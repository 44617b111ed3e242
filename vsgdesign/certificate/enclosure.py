"""The certificate's inequality as programs for boxes of grids, powers and estimate errors.

A box is one of *estimates*. With the estimate, P, Q and V held, the gains are held, and the state matrix is affine in
the true (b, g): all true grids that an error allows are covered by the corners of a polygon around them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.boxes import ERROR_PARAMETERS, basis_of, drop_sq
from vsgdesign.certificate.region import OMEGA_SCALE, Region, System
from vsgdesign.certificate.tracing import Program, Symbol, Tracer, program_of
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import LEAST_SHARE, POWER_MARGIN
from vsgdesign.equations.structures import NormalisedGains, decoupling, poles_of_inertia, voltage_row
from vsgdesign.frames import PHASES
from vsgdesign.runtime.table import TableSchedule

Array = NDArray[np.float64]

Weights = Callable[[Any, Any], tuple[list[Any], list[list[Any]]]]
"""1/SCR and R/X of a grid to the weights 1, ρ of P_0 … P_K and to their rates, one list for each way of moving."""


@dataclass(frozen=True)
class BoxPrograms:
    """What :mod:`~vsgdesign.certificate.box_check` runs: the programs of its ``survey`` and, for each case of
    the schedule, of its ``judge``."""

    situation: Program
    conditions: Array
    inequalities: tuple[Program, ...]
    signs: NDArray[np.int64]


def programs(system: System, region: Region, weights: Weights, P: Array, decay: float) -> BoxPrograms:
    """The inequality of :eq:`affine-lyapunov` with functions P (K, 3, 3) at a decay, for all boxes of the region."""
    tracer = Tracer(6)
    first, angle, p, q, e_R, e_L = tracer.symbols()
    here = _Estimate.of(system, first, angle)
    true_r, true_x = here.direction[0] / (1.0 + e_R), here.direction[1] / (1.0 + e_L)
    path = (true_r + here.fixed[0], (true_x + here.fixed[1]) * here.share)
    inverse_V, conditions = _voltage(system, region, p, q, path, here.base)
    counted = SCR_BASES[system.study.scr_basis].counted(true_r, true_x)
    weakness, r_over_x = here.size * counted, true_r / true_x
    for value, (least, most) in ((weakness, region.scr), (r_over_x, region.x_over_r)):
        conditions.append((value, 1.0 / most, 1.0 / least))
    carried = [inverse_V, weakness, r_over_x] if len(P) > 1 else [inverse_V]
    drawn = here.size_sq * (p * p + q * q) * (POWER_MARGIN / PHASES) ** 2 - 1.0
    spare = [q - side * (1.0 - LEAST_SHARE) * here.estimated(p, q, way)[0] for way in (False, True) for side in (1, -1)]
    situation = program_of(tracer, [*carried, drawn, *spare, *(value for value, _, _ in conditions)])
    between = np.array([[low, high] for _, low, high in conditions])
    # From here on errors act through the polygon, and on V as one quantity of its own between bounds.
    inequalities = []
    for case in _CASES:
        tracer = Tracer(4 + len(carried))
        first, angle, p, q, inverse_V, *grid = tracer.symbols()
        here = _Estimate.of(system, first, angle)
        matrices = _state_matrices(system, tracer, here, p, q, inverse_V, region.error > 0.0, case)
        functions, ways = weights(*(grid or (0.0, 0.0)))
        outputs = [entry for A in matrices for way in ways for entry in _inequality(A, functions, way, P, decay)]
        inequalities.append(program_of(tracer, outputs))
    return BoxPrograms(situation, between, tuple(inequalities), np.array([case.signs for case in _CASES]))


class _Case(NamedTuple):
    """One of the smooth pieces of the schedule's Jacobian: as it is or drawn in (:eq:`drawn-in`), Q as it is or on a
    limit (:eq:`well-posed`)."""

    drawn_in: bool
    Q_limit: int
    """1: held at the upper limit, −1: at the lower, 0: free."""

    @property
    def signs(self) -> list[int]:
        """What is negative (−1) or positive (1) in this case: what is drawn in less 1, then Q less its upper and less
        its lower limit as it is, and drawn in."""
        own = {1: [1, 0], -1: [0, -1], 0: [-1, 1]}[self.Q_limit]
        return [1, 0, 0, *own] if self.drawn_in else [-1, *own, 0, 0]


_CASES = tuple(_Case(drawn_in, side) for drawn_in in (False, True) for side in (0, 1, -1))


@dataclass(frozen=True)
class _Estimate:
    """An estimated grid in units of |Ẑ_g| and V_rated²/|Ẑ_g|: most of what strong and weak grids differ in is gone
    (:eq:`grid-units`). ``fixed``: the grid-side inductor; ``share``: the grid's speed over the rated one; ``base``:
    |Ẑ_g|·S/V_rated², per unit powers to these units."""

    size: Symbol
    direction: tuple[Symbol, Symbol]
    fixed: tuple[Any, Any]
    share: float
    base: Symbol
    size_sq: Any
    """|Z|² of the path."""
    normalised: Callable[[Tracer], NormalisedGains]

    @classmethod
    def of(cls, system: System, first: Symbol, angle: Symbol) -> _Estimate:
        c, f = system.study.converter, system.study.filter
        direction = np.cos(angle), np.sin(angle)
        size = basis_of(system).magnitude(first, direction[1])
        r_2, x_2 = f.R_2 / c.Z_base, c.omega_n * f.L_2 / c.Z_base
        inverse = size.reciprocal() if r_2 or x_2 else 0.0
        schedule = system.schedule

        def normalised(tracer: Tracer) -> NormalisedGains:
            if not isinstance(schedule, TableSchedule):
                return schedule.normalised(0.0, 0.0)  # type: ignore[attr-defined]
            x, y = first.reciprocal(), direction[0] / direction[1]
            terms = [tracer.constant(1.0), x, y, x * y]
            found = []
            for k, values in enumerate(schedule.columns):
                if np.ptp(values) == 0.0:  # a constant column needs no parameters
                    found.append(float(values.flat[0]))
                    continue
                found.append(tracer.blend(range(ERROR_PARAMETERS + 4 * k, ERROR_PARAMETERS + 4 * k + 4), terms))
            return NormalisedGains(*found)

        # Z_base·S = PHASES·V_rated²
        share = system.study.grid_source.omega_g / c.omega_n
        r, x = inverse * r_2, inverse * x_2
        size_sq = 1.0 if not (r_2 or x_2) else 1.0 + 2.0 * (direction[0] * r + direction[1] * x) + (r * r + x * x)
        return cls(size, direction, (r, x), share, size * PHASES, size_sq, normalised)

    def estimated(self, p: Symbol, q: Symbol, drawn_in: bool) -> tuple[Symbol, Symbol]:
        """b and g of the estimated path."""
        inverse = PHASES if isinstance(self.size_sq, float) else PHASES * self.size_sq.reciprocal()
        b, g = (self.direction[1] + self.fixed[1]) * inverse, (self.direction[0] + self.fixed[0]) * inverse
        if not drawn_in:
            return b, g
        stretch = (self.size_sq * (p * p + q * q)).sqrt((PHASES / POWER_MARGIN) ** 2) * (POWER_MARGIN / PHASES)
        return b * stretch, g * stretch


def _voltage(
    system: System, region: Region, p: Symbol, q: Symbol, path: Any, base: Symbol
) -> tuple[Symbol, list[tuple[Any, float, float]]]:
    """1/V per unit within the static limits, and the conditions for those and for P and Q (:eq:`box-coordinates`,
    :eq:`static-limits`): each a quantity with its limits."""
    c = system.study.converter
    V_g = system.study.grid_source.V_g_rms / c.V_rated_rms
    r, x = path
    drop = drop_sq(r, x, p, q)
    reach = (r * r + x * x) * (p * p + q * q) * (1.0 / PHASES**2)
    least, most = (V_g / c.V_max_pu) ** 2, (V_g / c.V_min_pu) ** 2
    conditions: list[tuple[Any, float, float]] = [(reach, -np.inf, POWER_MARGIN**-2), (drop, least, most)]
    for power, (low, high) in ((p, region.P), (q, region.Q)):
        # P = p V²/|Ẑ|, and V² is V_g² over the drop.
        own, scale = power * V_g**2, base * drop
        conditions += [(own - scale * (high / c.S_rated), -np.inf, 0.0), (own - scale * (low / c.S_rated), 0.0, np.inf)]
    return drop.sqrt(least) * (1.0 / V_g), conditions


def _state_matrices(
    system: System, tracer: Tracer, here: _Estimate, p: Symbol, q: Symbol, inverse_V: Symbol, wrong: bool, case: _Case
) -> list[list[list[Any]]]:
    """A of the scaled states at each corner of the true grids' polygon, or of the exact estimate
    (:eq:`certificate-matrix`), in one case of the schedule."""
    b_hat, g_hat = here.estimated(p, q, case.drawn_in)
    Q_hat = q if case.Q_limit == 0 else case.Q_limit * (1.0 - LEAST_SHARE) * b_hat
    nominal = _Nominal.of(system, here.normalised(tracer), (p, Q_hat, inverse_V), (b_hat, g_hat), here.base)
    if wrong:
        corners = _polygon(tracer, here)
    elif here.share == 1.0 and case == _CASES[0]:
        return [nominal.matrix(None)]
    else:  # the estimate is exact in R and L, and taken at the rated frequency
        r, x = here.direction[0] + here.fixed[0], (here.direction[1] + here.fixed[1]) * here.share
        inverse = (r * r + x * x).reciprocal()
        corners = [(x * inverse, r * inverse)]
    # What is off: b − q of the true grid less b − q of the schedule, and so on.
    return [nominal.matrix((b * PHASES - b_hat, g * PHASES - g_hat, Q_hat - q)) for b, g in corners]


def _polygon(tracer: Tracer, here: _Estimate) -> list[tuple[Any, Any]]:
    """Corners (b, g)/3V² that enclose all true grids of an estimate (:eq:`estimate-polygon`).

    The image of a rectangle of (R, X) under (R, X)/|Z|²: its corners, and where the tangents of the two arcs that
    bulge outwards meet.
    """
    r_1, r_2 = (tracer.blend((k,), (here.direction[0],)) + here.fixed[0] for k in (0, 1))
    x_1, x_2 = ((tracer.blend((k,), (here.direction[1],)) + here.fixed[1]) * here.share for k in (2, 3))
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
    """The loops about an exact estimate: what is enclosed is the small part that the error adds. V as its logarithm,
    powers in V²/|Ẑ_g|."""

    W: tuple[Any, Any, Any, Any]
    poles: tuple[Any, Any]
    kept: tuple[Any, Any, Any]
    """Coupling B and C that the shares leave in, and what the V row takes off A."""
    pull: Any
    across: Any
    k_d: Any
    inverse_V: Symbol

    @classmethod
    def of(cls, system: System, normalised: NormalisedGains, at: Any, estimated: Any, base: Any) -> _Nominal:
        """From the measured p, q, 1/V and the estimated b and g, as the schedule makes its gains."""
        s: Any = system.schedule
        c = system.study.converter
        p, q, inverse_V = at
        k_1, d_1, k_2, q_share, share_P, share_Q = normalised
        b_hat, g_hat = estimated
        A, B, C, D = b_hat - q, p + g_hat, p - g_hat, b_hat + q
        droop = q_share * D
        if s.structure != "published" and s.D_q:
            droop = droop + base * inverse_V * (s.D_q * c.V_rated_rms / c.S_rated)
        powers = base * (inverse_V * inverse_V) * (1.0 / c.S_rated)  # W and W·s/rad to these units
        if s.law == "inertia":
            k_1, d_1 = poles_of_inertia(A, k_1, d_1, powers * s.S_rated, s.omega)
        W, sigma = decoupling(A, B, C, D, droop, share_P, share_Q), 0.0
        if s.structure == "angle_damped":
            D_p = powers * s.D_p
            row_D_p = 0.0 if s.law == "inertia" else D_p
            sigma, *row = voltage_row(A, B, C, D, k_2, row_D_p, droop, share_P, share_Q)
            W = (W[0], W[1], *row)
            pull, across = W[0] * D_p * k_1, W[2] * D_p * k_2
            k_d = d_1 - pull
        else:
            pull, k_d = d_1, 0.0
            across = W[2] / W[0] * (d_1 / k_1 * k_2) if _is_there(share_Q) else 0.0
        return cls(W, (k_1, k_2), (B * (1.0 - share_P), C * (1.0 - share_Q), sigma), pull, across, k_d, inverse_V)

    def matrix(self, off: Any) -> list[list[Any]]:
        """A of the scaled states where the true b and g are off the estimated ones, and the schedule's Q off the
        true one, by ``off``; None: nowhere."""
        w11, w12, w21, w22 = self.W
        b_off, g_off, q_off = off if off is not None else (0.0, 0.0, 0.0)
        a, b, c, d = b_off + q_off, g_off + self.kept[0], self.kept[1] - g_off, b_off - q_off
        z11, z12 = w11 * a + w12 * c + 1.0, w11 * b + w12 * d
        z21, z22 = w21 * (a + self.kept[2]) + w22 * c, w21 * b + w22 * d + 1.0
        (k_1, k_2), pull, across, k_d, o = self.poles, self.pull, self.across, self.k_d, OMEGA_SCALE
        speed = -(z11 * k_d), -(z12 * k_d)
        to_V, from_V = self.inverse_V.reciprocal(), self.inverse_V
        return [
            [speed[0], o, speed[1] * from_V],
            [-(z11 * k_1 + speed[0] * pull) * (1.0 / o), -pull, -(z12 * k_1 + speed[1] * pull) * (1.0 / o) * from_V],
            [-(z21 * k_2 + speed[0] * across) * to_V, -(across * o) * to_V, -(z22 * k_2 + speed[1] * across)],
        ]


def _is_there(share: Any) -> bool:
    return isinstance(share, Symbol) or bool(share)


def _inequality(A: list[list[Any]], functions: Sequence[Any], way: Sequence[Any], P: Array, decay: float) -> list[Any]:
    """Entries 11, 22, 33, 12, 13, 23 of AᵀP(ρ) + P(ρ)A + dP/dt + 2·decay·P(ρ), in coordinates where P_0 is the unit
    matrix: entries of one size are bounded best."""
    turn = np.linalg.inv(np.linalg.cholesky(P[0]))  # x = turnᵀ z
    back = np.linalg.inv(turn)
    A_z = _times(_times(back.T, A), turn.T)
    total: Any = np.zeros((3, 3)).tolist()
    for matrix, weight, rate in zip(P, functions, way, strict=True):
        P_z = turn @ matrix @ turn.T
        PA = _times(P_z, A_z)
        for i in range(3):
            for j in range(i, 3):
                here = PA[i][j] + PA[j][i] + 2.0 * decay * float(P_z[i, j])
                total[i][j] = total[i][j] + weight * here + rate * float(P_z[i, j])
    return [total[i][j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def _times(left: Any, right: Any) -> list[list[Any]]:
    """Product of 3 × 3 matrices of numbers and symbols."""
    return [[sum((left[i][k] * right[k][j] for k in range(3)), start=0.0) for j in range(3)] for i in range(3)]
