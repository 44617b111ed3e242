"""Quadratic Lyapunov functions for many cells at once: a cutting plane over small semidefinite programs.

Thousands of cells, and a function of six or eighteen numbers: few cells decide. The program is handed to Clarabel as
matrices; through a modelling layer most of the time would go into compiling it anew in every round. How fast a function
changes while the grid moves, and the function whose sublevel sets reach furthest, are here too.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.region import Region
from vsgdesign.equations.frames import SQRT_2

Array = NDArray[np.float64]

_ROUNDS = 60
_STRICT = 1e-6
"""How far below zero the inequality is asked of the solver, where the function's least eigenvalue is 1."""

_WORST = 4
"""Cells that join in a round."""

_CONDITION_LIMIT = 1e8

_LITTLE = 1e-9
"""How little the largest eigenvalue of a smallest function counts."""


@dataclass(frozen=True)
class Family:
    """Functions P(ρ) = P_0 + Σ_k ρ_k P_k that are looked for, at N cells with W ways of moving each
    (:eq:`affine-lyapunov`).

    ``weights`` (N, K): 1, then ρ of each cell. ``rates`` (N, W, K): 0, then dρ/dt. ``corners`` (C, K): the
    weights between which all others lie: there P is kept positive.
    """

    weights: Array
    rates: Array
    corners: Array

    def take(self, index: Any) -> Family:
        """Some of the cells."""
        return Family(self.weights[index], self.rates[index], self.corners)

    def constant(self) -> Family:
        """Those of its functions that do not follow the grid."""
        return Family(self.weights[:, :1], self.rates[:, :1, :1], self.corners[:1, :1])

    @property
    def alike(self) -> bool:
        """Whether it is one function P_0 for all cells."""
        return self.size == 1 and bool((self.weights == 1.0).all())

    @property
    def size(self) -> int:
        """How many matrices P_k."""
        return self.weights.shape[1]


def residual(A: Array, family: Family, P: Array, decay: float) -> Array:
    """Largest eigenvalue of AᵀP(ρ) + P(ρ)A + dP/dt + 2·decay·P(ρ) of each cell, relative to P(ρ): twice the
    shortfall of its decay in 1/s (:eq:`certificate`, :eq:`affine-lyapunov`). ``P`` (K, n, n)."""
    # One function for all cells is factorised once.
    here = P if family.alike else np.tensordot(family.weights, P, 1)
    half = np.linalg.inv(np.linalg.cholesky(here))
    product = here @ A
    still = np.swapaxes(product, 1, 2) + product + 2.0 * decay * here
    worst = np.full(len(A), -np.inf)
    for way in range(family.rates.shape[1]):
        rates = family.rates[:, way]
        moving = still + np.tensordot(rates, P, 1) if rates.any() else still
        worst = np.maximum(worst, np.linalg.eigvalsh(half @ moving @ np.swapaxes(half, 1, 2))[:, -1])
    return worst


@dataclass(frozen=True)
class Fit:
    """P (K, n, n) that holds at all cells at a decay, and the cells that decide."""

    P: Array
    decay: float
    active: tuple[int, ...]


Level = tuple[Array, Array]
"""Of a function that is to be small: matrices (M, n, n) that it is not below, and W (n, n) of tr(WP)."""


def fit(
    A: Array, family: Family, decay: float, start: tuple[int, ...] = (), level: Level | None = None
) -> tuple[Fit | None, tuple[int, ...]]:
    """A function for all cells (N, n, n) at a decay, or None where there is none; and the cells that were in play.

    ``start``: cells to begin with, from an earlier fit. ``level``: the smallest one of these, not the one of the best
    condition.
    """
    active = list(start) or [int(np.argmax(np.linalg.eigvals(A).real.max(axis=1)))]
    for _ in range(_ROUNDS):
        P = _solve(A[active], family.take(active), decay, level)
        if P is None:
            return None, tuple(active)
        try:
            worst = residual(A, family, P, decay)
        except np.linalg.LinAlgError:
            return None, tuple(active)
        if worst.max() < 0.0:
            return Fit(P, decay, tuple(active)), tuple(active)
        added = [int(k) for k in np.argsort(-worst)[:_WORST] if worst[k] >= 0.0 and k not in active]
        if not added:
            return None, tuple(active)  # the solver's accuracy is spent
        active += added
    return None, tuple(active)


def best_fit(A: Array, family: Family, limit: float, tolerance: float) -> tuple[Fit | None, tuple[int, ...]]:
    """The fit of largest decay, by bisection up to ``limit`` (1/s) to ``tolerance``·limit; and the cells in play.

    A function that follows the grid is never worse than one that does not, which is one of them: the search begins
    there.
    """
    low, high, best = 0.0, limit, None
    active: tuple[int, ...] = ()
    if family.size > 1:
        best, active = best_fit(A, family.constant(), limit, tolerance)
        if best is not None:
            rest = np.zeros((family.size - 1, *best.P.shape[1:]))
            low, best = best.decay, Fit(np.concatenate([best.P, rest]), best.decay, best.active)
    while high - low > tolerance * limit:
        decay = 0.5 * (low + high)
        found, active = fit(A, family, decay, active)
        if found is None:
            high = decay
        else:
            low, best = decay, found
    return best, active


def _solve(A: Array, family: Family, decay: float, level: Level | None) -> Array | None:
    """The best-conditioned P for a few cells, or the smallest one of a level, or None if there is none.

    Variables: the triangles of P_0 … P_K and t. Least t with I ⪯ P(ρ) ⪯ t·I at the corners and the inequality,
    by a little strict, at every cell and way of moving.
    """
    from importlib import import_module

    from scipy import sparse

    clarabel: Any = import_module("clarabel")  # compiled, without types

    n = A.shape[1]
    basis = _basis(n)
    m = len(basis)
    blocks, offsets = [], []
    eye = _triangle(np.eye(n))
    floors = [np.eye(n)] if level is None else list(level[0])
    for corner in family.corners:
        here = np.concatenate([w * _triangle(basis).T for w in corner], axis=1)
        blocks += [*(np.column_stack([-here, 0.0 * eye]) for _ in floors), np.column_stack([here, -eye])]
        offsets += [*(-_triangle(floor) for floor in floors), 0.0 * eye]
    for a, weights, rates in zip(A, family.weights, family.rates, strict=True):
        still = _triangle(a.T @ basis + basis @ a + 2.0 * decay * basis).T
        shape = _triangle(basis).T
        size = np.linalg.norm(a)
        for rate in rates:
            rows = np.concatenate([w * still + r * shape for w, r in zip(weights, rate, strict=True)], axis=1)
            blocks.append(np.column_stack([rows, 0.0 * eye]) / size)
            offsets.append(-_STRICT * eye)
    width = family.size * m + 1
    cost = np.zeros(width)
    cost[-1] = 1.0
    if level is not None:
        cost[:m], cost[-1] = np.tensordot(basis, level[1], 2), _LITTLE * float(np.trace(level[1]))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix((width, width)),
        cost,
        sparse.csc_matrix(np.concatenate(blocks)),
        np.concatenate(offsets),
        [clarabel.PSDTriangleConeT(n)] * len(blocks),
        settings,
    ).solve()
    if solution.status != clarabel.SolverStatus.Solved:
        return None
    x = np.array(solution.x)
    if level is None and not 1.0 <= x[-1] + 1e-3 <= _CONDITION_LIMIT:
        return None
    P = np.tensordot(x[:-1].reshape(family.size, m), basis, 1)
    # What the solver returns is not believed: positive at the corners, hence at all weights between them.
    return P if np.linalg.eigvalsh(np.tensordot(family.corners, P, 1)).min() > 0.0 else None


def _basis(n: int) -> Array:
    """The symmetric matrices with a one at (i, j), i ≤ j, and at (j, i)."""
    found = []
    for j in range(n):
        for i in range(j + 1):
            matrix = np.zeros((n, n))
            matrix[i, j] = matrix[j, i] = 1.0
            found.append(matrix)
    return np.array(found)


def _triangle(matrices: Array) -> Array:
    """Upper triangles column by column, off-diagonal entries times √2: the solver's cone."""
    n = matrices.shape[-1]
    columns = [matrices[..., i, j] * (1.0 if i == j else SQRT_2) for j in range(n) for i in range(j + 1)]
    return np.stack(columns, axis=-1)


@dataclass(frozen=True)
class Motion:
    """How P depends on the grid within a region (:eq:`certificate-coordinates`)."""

    region: Region
    moving: bool
    """Whether P depends on the grid. With False there is one P for all grids."""

    @property
    def _middle(self) -> Array:
        low, high = self._limits
        return 0.5 * (low + high)

    @property
    def _radius(self) -> Array:
        low, high = self._limits
        return np.maximum(0.5 * (high - low), 1e-9)

    @property
    def _limits(self) -> tuple[Array, Array]:
        (scr_low, scr_high), (ratio_low, ratio_high) = self.region.scr, self.region.x_over_r
        return np.array([1.0 / scr_high, 1.0 / ratio_high]), np.array([1.0 / scr_low, 1.0 / ratio_low])

    def weights(self, weakness: Any, r_over_x: Any) -> tuple[list[Any], list[list[Any]]]:
        """1, ρ_1, ρ_2 from 1/SCR and R/X of points or boxes, and 0, dρ_1/dt, dρ_2/dt for the four ways of moving."""
        if not self.moving:
            return [1.0], [[0.0]]
        raw = [weakness, r_over_x]
        rho = [(raw[k] - self._middle[k]) * (1.0 / self._radius[k]) for k in range(2)]
        speed = [raw[k] * (self.region.rate / self._radius[k]) for k in range(2)]
        ways = [[0.0, speed[0] * one, speed[1] * other] for one in (-1.0, 1.0) for other in (-1.0, 1.0)]
        return [1.0, *rho], ways

    def family(self, points: Array) -> Family:
        """The same for many points, for the solver."""
        here, ways = self.weights(points[:, 0], 1.0 / np.tan(points[:, 1]))
        count = len(points)

        def column(values: list[Any]) -> Array:
            return np.stack([np.broadcast_to(np.asarray(v, dtype=float), (count,)) for v in values], axis=-1)

        corners = np.array([[1.0, a, b] for a in (-1.0, 1.0) for b in (-1.0, 1.0)]) if self.moving else np.ones((1, 1))
        return Family(column(here), np.stack([column(way) for way in ways], axis=1), corners)


def move_factor(functions: Sequence[Array]) -> float:
    """The largest μ ≥ 1 by which the value of one function (n, n) may exceed that of another (:eq:`place-move`)."""
    halves = [np.linalg.inv(np.linalg.cholesky(P)) for P in functions]
    return max(1.0, *(float(np.linalg.eigvalsh(half @ P @ half.T)[-1]) for half in halves for P in functions))


_SET_ROUNDS, _SET_STRICT = 30, 1e-7
"""The same of the search for the largest level set."""


def largest_level_set(
    A: Array, decay: float, V_limits_pu: tuple[float, float], V_share: float, start: tuple[int, ...] = ()
) -> tuple[Array | None, tuple[int, ...]]:
    """P (3, 3) of the set {xᵀPx ≤ 1} of largest volume that decays in all cells, and the cells that decide.

    ``A`` (N, 3, 3): state matrices over the scaled states (δ, ω_r, V). The set keeps |Δv| ≤ 1 for every resting
    voltage between ``V_limits_pu`` and ΔV² ≤ ``V_share``, and the inequality at ``decay`` (1/s) holds in every cell
    (:eq:`largest-level-set`). None where there is no such function. ``start``: cells to begin with.
    """
    import cvxpy as cp  # heavy: imported where it is used

    family = Family(np.ones((len(A), 1)), np.zeros((len(A), 1, 1)), np.ones((1, 1)))
    active = list(start) or [int(np.argmax(np.linalg.eigvals(A).real.max(axis=1)))]
    for _ in range(_SET_ROUNDS):
        # Y = P⁻¹: the inequality is linear in it, and log det Y is the set's volume.
        Y: Any = cp.Variable((3, 3), symmetric=True)
        conditions = [
            (a @ Y + Y @ a.T + 2.0 * decay * Y) / np.linalg.norm(a) << -_SET_STRICT * np.eye(3) for a in A[active]
        ]
        for V in V_limits_pu:
            turn = np.array([[V, 0.0, 0.0], [0.0, 0.0, 1.0]])
            conditions.append(turn @ Y @ turn.T << np.eye(2))
        conditions.append(Y[2, 2] <= V_share)
        problem = cp.Problem(cp.Maximize(cp.log_det(Y)), conditions)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # an inaccurate solution is checked below like any other
                problem.solve(solver=cp.CLARABEL, max_threads=1)
        except cp.SolverError:
            return None, tuple(active)
        if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE) or Y.value is None:
            return None, tuple(active)
        try:
            # What the solver returns is not believed.
            P = np.asarray(np.linalg.inv(0.5 * (Y.value + Y.value.T)), dtype=float)
            worst = residual(A, family, P[None], decay)
        except np.linalg.LinAlgError:
            return None, tuple(active)
        if worst.max() < 1e-5 * max(decay, 1.0):
            return P, tuple(active)
        added = [int(k) for k in np.argsort(-worst)[:_WORST] if worst[k] >= 0.0 and k not in active]
        if not added:
            return P, tuple(active)
        active += added
    return None, tuple(active)
