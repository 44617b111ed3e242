"""The certificate's inequality as programs for boxes of grids, powers and estimate errors.

A box is one of *estimates*. With the estimate, P, Q and V held, the gains are held, and the state matrix is affine in
the true (b, g): all true grids that an error allows are covered by the corners of a polygon around them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.boxes import ERROR_PARAMETERS, basis_of, drop_sq, first_extra
from vsgdesign.certificate.cancelling import Algebra
from vsgdesign.certificate.region import OMEGA_SCALE, Region, System
from vsgdesign.certificate.tracing import Program, Symbol, Tracer, program_of
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import (
    POWER_MARGIN,
    YieldingColumns,
    admittance,
    carried_share,
    jacobian_from_admittance,
    well_posed_power,
    yielding_columns,
)
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops_about_rest
from vsgdesign.equations.structures import STRUCTURES, NormalisedGains
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
    order: int
    """Rows of the matrices."""


def programs(system: System, region: Region, weights: Weights, P: Array, decay: float) -> BoxPrograms:
    """The inequality of :eq:`affine-lyapunov` with functions P (K, n, n) at a decay, for all boxes of the region."""
    tracer = Tracer(6)
    first, angle, p, q, e_R, e_L = tracer.symbols()
    here = Estimate.of(system, first, angle)
    true_r, true_x = true_grid(system, region, tracer, here, (e_R, e_L))
    path = (true_r + here.fixed[0], (true_x + here.fixed[1]) * here.share)
    inverse_V, conditions = voltage_conditions(system, region, p, q, path, here.base)
    counted = SCR_BASES[system.study.scr_basis].counted(true_r, true_x)
    weakness, r_over_x = here.size * counted, true_r / true_x
    for value, (least, most) in ((weakness, region.scr), (r_over_x, region.x_over_r)):
        conditions.append((value, 1.0 / most, 1.0 / least))
    if region.error_Z:
        conditions += _within_errors_of_Z(system, tracer, here, (true_r, true_x))
    carried = [inverse_V, weakness, r_over_x] if len(P) > 1 else [inverse_V]
    choices = [here.scheduled(p, q, first)[1] for first in PIECES]
    asked = distinct_choices(choices)
    situation = program_of(tracer, [*carried, *asked, *(value for value, _, _ in conditions)])
    between = np.array([[low, high] for _, low, high in conditions])
    # From here on errors act through the polygon, and on V as one quantity of its own between bounds.
    inequalities = []
    for piece in PIECES:
        tracer = Tracer(4 + len(carried))
        first, angle, p, q, inverse_V, *grid = tracer.symbols()
        here = Estimate.of(system, first, angle)
        matrices = _state_matrices(system, region, tracer, here, p, q, inverse_V, piece)
        functions, ways = weights(*(grid or (0.0, 0.0)))
        outputs = [entry for A in matrices for way in ways for entry in _inequality(A, functions, way, P, decay)]
        inequalities.append(program_of(tracer, outputs))
    return BoxPrograms(situation, between, tuple(inequalities), signs_of(choices, asked), P.shape[1])


PIECES = tuple((drawn_in, *side) for drawn_in in (False, True) for side in ((True, True), (True, False), (False, True)))
"""The smooth pieces of the schedule's Jacobian by its choices, each whether the first of two values is taken: the
impedance that is wanted for drawing in (:eq:`drawn-in`), then Q before its lower and before its upper limit
(:eq:`well-posed`)."""

_FREE = 0, 3
"""The pieces on which every choice has its say: on a limit, the other limit has none."""


def distinct_choices(choices: Sequence[Sequence[Symbol]]) -> list[Symbol]:
    """What tells the pieces apart, each once."""
    found: list[Symbol] = []
    for k in _FREE:
        found += [one for one in choices[k] if not any(_same(one, other) or _same(-one, other) for other in found)]
    return found


def signs_of(choices: Sequence[Sequence[Symbol]], asked: Sequence[Symbol]) -> NDArray[np.int64]:
    """(pieces, outputs): −1 where an output is negative on a piece, 1 where it is positive, 0 where it has no say."""
    signs = np.zeros((len(choices), len(asked)), dtype=np.int64)
    for piece, own in enumerate(choices):
        for k, output in enumerate(asked):
            signs[piece, k] -= any(_same(one, output) for one in own)
            signs[piece, k] += any(_same(-one, output) for one in own)
    return signs


def _same(one: Symbol, other: Symbol) -> bool:
    return one.terms == other.terms and one.offset == other.offset


@dataclass(frozen=True)
class Estimate:
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
    first: Symbol
    """First coordinate of :func:`~vsgdesign.certificate.boxes.whole_region`, pu."""
    slope: Symbol
    """R̂/X̂."""

    @classmethod
    def of(cls, system: System, first: Symbol, angle: Symbol) -> Estimate:
        """An estimate by its first coordinate and its angle, in units of |Ẑ_g|."""
        direction = np.cos(angle), np.sin(angle)
        size = basis_of(system).magnitude(first, direction[1])
        r, x = _grid_side(system, size)
        size_sq = 1.0 if not (r or x) else 1.0 + 2.0 * (direction[0] * r + direction[1] * x) + (r * r + x * x)
        return cls._with(system, size, direction, (r, x), size_sq, first)

    @classmethod
    def about(
        cls,
        system: System,
        size: Symbol,
        direction: tuple[Symbol, Symbol],
        first: Symbol | None = None,
        slope: Symbol | None = None,
    ) -> Estimate:
        """An estimate R̂ + jX̂ = ``direction`` in units of any impedance of ``size`` (pu), such as the true grid's.

        ``first`` and ``slope``: the estimate's first coordinate and R̂/X̂, where they are symbols of their own.
        """
        r, x = _grid_side(system, size)
        along, across = direction[0] + r, direction[1] + x
        size_sq = along * along + across * across
        own: Symbol = basis_of(system).counted(*direction) * size if first is None else first
        return cls._with(system, size, direction, (r, x), size_sq, own, slope)

    @classmethod
    def _with(
        cls,
        system: System,
        size: Symbol,
        direction: Any,
        fixed: Any,
        size_sq: Any,
        first: Symbol,
        slope: Symbol | None = None,
    ) -> Estimate:
        schedule = system.schedule
        ratio: Symbol = direction[0] / direction[1] if slope is None else slope

        def normalised(tracer: Tracer) -> NormalisedGains:
            if not isinstance(schedule, TableSchedule):
                return schedule.normalised(0.0, 0.0)  # type: ignore[attr-defined]
            x_axis = first.reciprocal()
            terms = [tracer.constant(1.0), x_axis, ratio, x_axis * ratio]
            found = []
            for k, values in enumerate(schedule.columns):
                if np.ptp(values) == 0.0:  # a constant column needs no parameters
                    found.append(float(values.flat[0]))
                    continue
                found.append(tracer.blend(range(ERROR_PARAMETERS + 4 * k, ERROR_PARAMETERS + 4 * k + 4), terms))
            return NormalisedGains(*found)

        # Z_base·S = PHASES·V_rated²
        share = system.study.grid_source.omega_g / system.study.converter.omega_n
        return cls(size, direction, fixed, share, size * PHASES, size_sq, normalised, first, ratio)

    def scheduled(self, p: Symbol, q: Symbol, first: Sequence[bool]) -> tuple[tuple[Any, ...], list[Symbol]]:
        """The Jacobian that gains are made of (:func:`~vsgdesign.equations.power_flow.scheduled_jacobian`) on one of
        its pieces, and what is negative there."""
        with self.size.tracer.choosing(first) as choices:
            share = carried_share(p, q, 1.0, self.size_sq)
            r, x = self.direction[0] + self.fixed[0], self.direction[1] + self.fixed[1]
            # A share of an impedance has so much more of the admittance.
            b, g = (value / share for value in admittance(1.0, r, x, self.size_sq))
            return jacobian_from_admittance(p, well_posed_power(q, b), 1.0, b, g), choices


def _grid_side(system: System, size: Symbol) -> tuple[Any, Any]:
    """The grid-side inductor in units of an impedance of ``size``."""
    c, f = system.study.converter, system.study.filter
    r_2, x_2 = f.R_2 / c.Z_base, c.omega_n * f.L_2 / c.Z_base
    inverse = size.reciprocal() if r_2 or x_2 else 0.0
    return inverse * r_2, inverse * x_2


def voltage_conditions(
    system: System, region: Region, p: Symbol, q: Symbol, path: Any, base: Symbol, drop: Symbol | None = None
) -> tuple[Symbol, list[tuple[Any, float, float]]]:
    """1/V per unit within the static limits, and the conditions for those and for P and Q (:eq:`box-coordinates`,
    :eq:`static-limits`): each a quantity with its limits. ``drop``: (V_g/V)², where it is not that of the path."""
    c = system.study.converter
    V_g = system.study.grid_source.V_g_rms / c.V_rated_rms
    r, x = path
    loss: Symbol = drop_sq(r, x, p, q) if drop is None else drop
    reach = (r * r + x * x) * (p * p + q * q) * (1.0 / PHASES**2)
    least, most = (V_g / c.V_max_pu) ** 2, (V_g / c.V_min_pu) ** 2
    conditions: list[tuple[Any, float, float]] = [(reach, -np.inf, POWER_MARGIN**-2), (loss, least, most)]
    # V²/|Ẑ| is V² over the base, and V² is V_g² over the drop.
    unit = base * base * loss * V_g**-2
    conditions += [(one, -np.inf, 0.0) for one in system.beyond_converter(p, q, base, unit)]
    for power, (low, high) in ((p, region.P), (q, region.Q)):
        # P = p V²/|Ẑ|, and V² is V_g² over the drop.
        own, scale = power * V_g**2, base * loss
        conditions += [(own - scale * (high / c.S_rated), -np.inf, 0.0), (own - scale * (low / c.S_rated), 0.0, np.inf)]
    return loss.sqrt(least) * (1.0 / V_g), conditions


def _state_matrices(
    system: System,
    region: Region,
    tracer: Tracer,
    here: Estimate,
    p: Symbol,
    q: Symbol,
    inverse_V: Symbol,
    piece: Sequence[bool],
) -> list[list[list[Any]]]:
    """A of the scaled states at each corner of the true grids' polygon, or of the exact estimate
    (:eq:`certificate-matrix`), on one piece of the schedule."""
    J_hat, _ = here.scheduled(p, q, piece)
    loops = Loops.of(system, here.normalised(tracer), J_hat, inverse_V, here.base)
    lags, Z_base = system.lags, system.study.converter.Z_base
    # Behind a transient impedance the loops are affine in the admittance of path and impedance in series.
    more: tuple[Any, Any] = (0.0, 0.0)
    if lags.yields:
        inverse = here.size.reciprocal()
        more = inverse * (lags.R_t / Z_base), inverse * (lags.X_t / Z_base)
    if system.apart:  # nothing but the grid-side inductor, which is known
        r, x = here.fixed[0] + more[0], here.fixed[1] * here.share + more[1]
        corners = [admittance(1.0, r, x, r * r + x * x)]
    elif region.largest_error > 0.0:
        corners = _polygon(system, region, tracer, here, more)
    elif here.share == 1.0 and piece == PIECES[0] and not lags.yields:
        return [loops.matrix(None)]
    else:  # the estimate is exact in R and L, and taken at the rated frequency
        r, x = here.direction[0] + here.fixed[0], (here.direction[1] + here.fixed[1]) * here.share
        r, x = r + more[0], x + more[1]
        corners = [admittance(1.0, r, x, r * r + x * x)]
    if lags.yields:
        r_t, x_t = more[0] * (1.0 / PHASES), more[1] * (1.0 / PHASES)
        yielding = [yielding_columns(p, q, b, g, r_t, x_t) for b, g in corners]
        return [loops.yielding_matrix(found, J_hat, here.base * inverse_V, lags.omega_t) for found in yielding]
    true = [jacobian_from_admittance(p, q, 1.0, b, g) for b, g in corners]
    return [loops.matrix([one - hat for one, hat in zip(J, J_hat, strict=True)]) for J in true]


def true_grid(
    system: System, region: Region, tracer: Tracer, here: Estimate, errors: tuple[Symbol, Symbol]
) -> tuple[Any, Any]:
    """The true R and X behind an estimate, in |Ẑ_g|, by the coordinates of the errors."""
    if not region.error_Z:
        return here.direction[0] / (1.0 + errors[0]), here.direction[1] / (1.0 + errors[1])
    found, one = [], tracer.constant(1.0)
    for k, (estimate, c) in enumerate(zip(here.direction, errors, strict=True)):
        a, b, m = (first_extra(system) + 4 + 3 * k + n for n in range(3))
        off = tracer.blend((m,), (one,)) - tracer.blend((b,), (c,))
        found.append(estimate / (1.0 + tracer.blend((a,), (c,))) + off)
    return found[0], found[1]


def _within_errors_of_Z(
    system: System, tracer: Tracer, here: Estimate, truth: tuple[Any, Any]
) -> list[tuple[Any, float, float]]:
    """What lies outside the error set: (R̂ − R)² is more than a chord over both errors (:eq:`error-chord`)."""
    conditions, size_sq = [], truth[0] * truth[0] + truth[1] * truth[1]
    for k, (estimate, value) in enumerate(zip(here.direction, truth, strict=True)):
        off, first = estimate - value, first_extra(system) + 10 + 2 * k
        most = tracer.blend((first, first + 1), (size_sq, value * value))
        conditions.append((off * off - most, -np.inf, 0.0))
    return conditions


def _polygon(
    system: System, region: Region, tracer: Tracer, here: Estimate, series: tuple[Any, Any]
) -> list[tuple[Any, Any]]:
    """Corners (b, g) that enclose all true grids of an estimate, with an impedance in ``series``
    (:eq:`estimate-polygon`).

    The image of a rectangle of (R, X) under 3V²(X, R)/|Z|²: its corners, and where the tangents of the two arcs that
    bulge outwards meet.
    """
    one, more = tracer.constant(1.0), first_extra(system)
    limits = []
    for k in range(4):
        limit = tracer.blend((k,), (here.direction[k // 2],))
        if region.error_Z:
            limit = limit + tracer.blend((more + k,), (one,))
        limits.append(limit + here.fixed[k // 2])
    r_1, r_2 = (limit + series[0] for limit in limits[:2])
    x_1, x_2 = (limit * here.share + series[1] for limit in limits[2:])
    found = [admittance(1.0, r, x, r * r + x * x) for r, x in ((r_1, x_1), (r_1, x_2), (r_2, x_1), (r_2, x_2))]
    found.append(admittance(1.0, r_1, (x_1 + x_2) * 0.5, r_1 * r_1 + x_1 * x_2))
    found.append(admittance(1.0, (r_1 + r_2) * 0.5, x_1, x_1 * x_1 + r_1 * r_2))
    return found


@dataclass(frozen=True)
class Loops:
    """The power loops with the gains of an estimate, V as its logarithm and powers in V²/|Ẑ_g|. What is enclosed are
    the loops about an exact estimate, with all that cancels there, and the small part that the error adds."""

    algebra: Algebra
    gains: PowerLoopGains
    J: tuple[Any, ...]
    """That the gains are made of."""
    inverse_V: Symbol

    @classmethod
    def of(cls, system: System, normalised: NormalisedGains, J_hat: Any, inverse_V: Symbol, base: Symbol) -> Loops:
        """With the gains that the schedule makes of a Jacobian in these units."""
        s: Any = system.schedule
        c = system.study.converter
        algebra = Algebra(inverse_V.tracer)
        structure = STRUCTURES[s.structure]
        D_p, D_q = structure.droops(s.D_p, s.D_q)
        powers = base * (inverse_V * inverse_V) * (1.0 / c.S_rated)  # W and W·s/rad to these units
        D_p, D_q = powers * D_p, base * inverse_V * (D_q * c.V_rated_rms / c.S_rated)
        A, B, C, D = J = tuple(algebra.value(entry) for entry in J_hat)
        gains = structure.gains(
            A,
            B,
            C,
            D,
            NormalisedGains(*map(algebra.value, normalised)),
            algebra.value(D_p),
            algebra.value(D_q),
            algebra.value(powers * s.S_rated),
            s.omega,
            s.law == "inertia",
        )
        return cls(algebra, PowerLoopGains(*map(algebra.value, gains)), J, inverse_V)

    def matrix(self, off: Sequence[Any] | None) -> list[list[Any]]:
        """A of the scaled states where the true Jacobian is off the estimated one by ``off``; None: nowhere."""
        columns = list(self._exact)
        if off is not None:
            a, b, c, d = map(self.algebra.value, off)
            for k, more in ((0, self._answer(0.0, 0.0, a, c)), (2, self._answer(0.0, 0.0, b, d))):
                columns[k] = [one + other for one, other in zip(columns[k], more, strict=True)]
        columns = [[one.whole() for one in column] for column in columns]
        to_V, from_V, o = self.inverse_V.reciprocal(), self.inverse_V, OMEGA_SCALE
        (a11, a21, a31), (a12, a22, a32), (a13, a23, a33) = columns
        return [
            [a11, a12 * o, a13 * from_V],
            [a21 * (1.0 / o), a22, a23 * (1.0 / o) * from_V],
            [a31 * to_V, a32 * o * to_V, a33],
        ]

    def yielding_matrix(self, found: YieldingColumns, J_hat: Sequence[Any], unit: Symbol, omega_t: float) -> Any:
        """A of the scaled states behind a transient impedance; ``unit``: the power of the rated current."""
        A, B, C, D = J_hat
        (p_1, q_1), (p_2, q_2), *currents = found.powers
        rows = [row[:] for row in self.matrix((p_1 - A, p_2 - B, q_1 - C, q_2 - D))]
        to_V, from_V, o = self.inverse_V.reciprocal(), self.inverse_V, 1.0 / OMEGA_SCALE
        for p, q in currents:
            column = self._answer(0.0, 0.0, *(self.algebra.value(one * unit) for one in (p, q)))
            for row, entry, scale in zip(rows, column, (1.0, o, to_V), strict=True):
                row.append(entry.whole() * scale)
        inverse = unit.reciprocal() * omega_t
        (d_1, q_1), (d_2, q_2), *own = found.change
        for k, (first, second) in enumerate(((d_1, d_2), (q_1, q_2))):
            rows.append([first * inverse, 0.0, second * inverse * from_V, *(one[k] * omega_t for one in own)])
        return rows

    @functools.cached_property
    def _exact(self) -> list[list[Any]]:
        """The law is linear: its answers to one unit of each state are the columns of the matrix, here of the loops
        about an exact estimate."""
        A, B, C, D = self.J
        return [self._answer(0.0, 0.0, A, C), self._answer(1.0, 0.0, 0.0, 0.0), self._answer(0.0, 1.0, B, D)]

    def _answer(self, offset: float, V: float, P: Any, Q: Any) -> list[Any]:
        """dδ/dt, dω_r/dt and dV/dt by :func:`~vsgdesign.equations.power_loops.power_loops_about_rest`."""
        answers = power_loops_about_rest(offset, V, P, Q, References(0.0, 0.0, 0.0, 0.0), self.gains)
        return [self.algebra.symbol(self.algebra.value(x)) for x in answers]


def _inequality(A: list[list[Any]], functions: Sequence[Any], way: Sequence[Any], P: Array, decay: float) -> list[Any]:
    """Entries 11, 22, 33, …, 12, 13, …, 23, … of AᵀP(ρ) + P(ρ)A + dP/dt + 2·decay·P(ρ), in coordinates where P_0 is the
    unit matrix: entries of one size are bounded best."""
    turn = np.linalg.inv(np.linalg.cholesky(P[0]))  # x = turnᵀ z
    back = np.linalg.inv(turn)
    A_z = _times(_times(back.T, A), turn.T)
    n = len(A)
    total: Any = np.zeros((n, n)).tolist()
    for matrix, weight, rate in zip(P, functions, way, strict=True):
        P_z = turn @ matrix @ turn.T
        PA = _times(P_z, A_z)
        for i in range(n):
            for j in range(i, n):
                here = PA[i][j] + PA[j][i] + 2.0 * decay * float(P_z[i, j])
                total[i][j] = total[i][j] + weight * here + rate * float(P_z[i, j])
    return [*(total[i][i] for i in range(n)), *(total[i][j] for i in range(n) for j in range(i + 1, n))]


def _times(left: Any, right: Any) -> list[list[Any]]:
    """Product of square matrices of numbers and symbols."""
    n = len(left)
    return [[sum((left[i][k] * right[k][j] for k in range(n)), start=0.0) for j in range(n)] for i in range(n)]
