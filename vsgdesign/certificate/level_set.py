"""The quadratic function whose sublevel sets reach furthest, by a small semidefinite program with a log-determinant."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from vsgdesign.certificate.lyapunov import Family, residual, triangle

Array = NDArray[np.float64]

_ROUNDS = 30
_WORST = 4
_STRICT = 1e-7

_SIZE = 3
_PLACES = tuple((i, j) for i in range(_SIZE) for j in range(i, _SIZE))
"""Of an upper triangle, row by row."""

_BASIS = np.zeros((len(_PLACES), _SIZE, _SIZE))
for _k, (_i, _j) in enumerate(_PLACES):
    _BASIS[_k, _i, _j] = _BASIS[_k, _j, _i] = 1.0


def largest_level_set(
    A: Array, decay: float, V_limits_pu: tuple[float, float], V_share: float, start: tuple[int, ...] = ()
) -> tuple[Array | None, tuple[int, ...]]:
    """P (3, 3) of the set {xᵀPx ≤ 1} of largest volume that decays in all cells, and the cells that decide.

    ``A`` (N, 3, 3): state matrices over the scaled states (δ, ω_r, V). The set keeps |Δv| ≤ 1 for every resting
    voltage between ``V_limits_pu`` and ΔV² ≤ ``V_share``, and the inequality at ``decay`` (1/s) holds in every cell
    (:eq:`largest-level-set`). None where there is no such function. ``start``: cells to begin with.
    """
    family = Family(np.ones((len(A), 1)), np.zeros((len(A), 1, 1)), np.ones((1, 1)))
    active = list(start) or [int(np.argmax(np.linalg.eigvals(A).real.max(axis=1)))]
    for _ in range(_ROUNDS):
        Y = _solve(A[active], decay, V_limits_pu, V_share)
        if Y is None:
            return None, tuple(active)
        try:
            # What the solver returns is not believed.
            P = np.asarray(np.linalg.inv(Y), dtype=float)
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


def _solve(A: Array, decay: float, V_limits_pu: tuple[float, float], V_share: float) -> Array | None:
    """Y = P⁻¹ for a few cells, or None where there is none: the inequality is linear in it, and log det Y is the set's
    volume.

    Variables: t (3), the triangle of Z and that of Y. The sum of t is largest where [[D, Z], [Zᵀ, Y]] ⪰ 0 with an upper
    triangular Z whose diagonal is D, and t_k ≤ log D_kk: then it is log det Y.
    """
    clarabel: Any = import_module("clarabel")  # compiled, without types

    n, m = _SIZE, len(_BASIS)
    width = n + 2 * m
    of_t, of_Y = slice(0, n), slice(n + m, width)

    blocks: list[tuple[Array, Array, Any]] = []  # rows, offset and cone: offset - rows·x lies in the cone

    def keep_positive(matrices: Array, columns: slice, offset: Array) -> None:
        """Σ_k x_k matrices_k + offset ⪰ 0."""
        upper = triangle(offset)
        rows = np.zeros((len(upper), width))
        rows[:, columns] = -triangle(matrices).T
        blocks.append((rows, upper, clarabel.PSDTriangleConeT(len(offset))))

    share = np.zeros((1, width))
    share[0, -1] = 1.0  # Y_33
    blocks.append((share, np.array([V_share]), clarabel.NonnegativeConeT(1)))
    whole = np.zeros((2 * m, 2 * n, 2 * n))
    whole[m:, n:, n:] = _BASIS
    for k, (i, j) in enumerate(_PLACES):
        whole[k, i, n + j] = whole[k, n + j, i] = 1.0
        whole[k, i, i] = float(i == j)
    keep_positive(whole, slice(n, width), np.zeros((2 * n, 2 * n)))
    for a in A:
        decays = (a @ _BASIS + _BASIS @ a.T + 2.0 * decay * _BASIS) * (1.0 / np.linalg.norm(a))
        keep_positive(-decays, of_Y, -_STRICT * np.eye(n))
    for V in V_limits_pu:
        turn = np.array([[V, 0.0, 0.0], [0.0, 0.0, 1.0]])
        keep_positive(-(turn @ _BASIS @ turn.T), of_Y, np.eye(2))
    for k, (i, j) in enumerate(_PLACES):
        if i == j:
            rows = np.zeros((3, width))
            rows[0, i] = rows[2, n + k] = -1.0
            blocks.append((rows, np.array([0.0, 1.0, 0.0]), clarabel.ExponentialConeT()))
    cost = np.zeros(width)
    cost[of_t] = -1.0
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix((width, width)),
        cost,
        sparse.csc_matrix(np.concatenate([rows for rows, _, _ in blocks])),
        np.concatenate([offset for _, offset, _ in blocks]),
        [cone for _, _, cone in blocks],
        settings,
    ).solve()
    # An inaccurate solution is checked like any other.
    if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        return None
    return np.tensordot(np.array(solution.x)[of_Y], _BASIS, 1)
