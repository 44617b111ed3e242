"""The quadratic function whose sublevel sets reach furthest, by a small semidefinite program with a log-determinant."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.lyapunov import Family, cone_triangle, residual, symmetric_basis

Array = NDArray[np.float64]

_ROUNDS = 30
_WORST = 4
_STRICT = 1e-7


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
        Y = _largest_inverse(A[active], decay, V_limits_pu, V_share)
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


def _largest_inverse(A: Array, decay: float, V_limits_pu: tuple[float, float], V_share: float) -> Array | None:
    """Y = P⁻¹ for a few cells, or None where there is none: the inequality is linear in it, and log det Y is the set's
    volume.

    Variables: the triangle of Y, a lower triangular Z and t (3). With D the diagonal of Z and [[Y, Z], [Zᵀ, D]] ⪰ 0,
    det Y ≥ Z_11 Z_22 Z_33, with equality where Z is largest; so Σ t with t_i ≤ log Z_ii has the largest log det Y.
    """
    from importlib import import_module

    from scipy import sparse

    clarabel: Any = import_module("clarabel")  # compiled, without types

    n = A.shape[1]
    basis, eye = symmetric_basis(n), np.eye(n)
    m = len(basis)
    rows, offsets, cones = [], [], []

    def keep(of_Y: Array, of_Z: Array | None, offset: Array, cone: Any) -> None:
        """offset + Σ of_Y[k] y_k + Σ of_Z[k] z_k lies in the cone."""
        block = np.zeros((len(offset), 2 * m + n))
        block[:, :m] = -of_Y.T
        if of_Z is not None:
            block[:, m : 2 * m] = -of_Z.T
        rows.append(block)
        offsets.append(offset)
        cones.append(cone)

    for a in A:
        falls = -(a @ basis + basis @ a.T + 2.0 * decay * basis) / np.linalg.norm(a)
        keep(cone_triangle(falls), None, cone_triangle(-_STRICT * eye), clarabel.PSDTriangleConeT(n))
    for V in V_limits_pu:
        turn = np.array([[V, 0.0, 0.0], [0.0, 0.0, 1.0]])
        keep(cone_triangle(-turn @ basis @ turn.T), None, cone_triangle(np.eye(2)), clarabel.PSDTriangleConeT(2))
    keep(-basis[:, 2:, 2], None, np.array([V_share]), clarabel.NonnegativeConeT(1))
    whole_Y, whole_Z = np.zeros((m, 2 * n, 2 * n)), np.zeros((m, 2 * n, 2 * n))
    whole_Y[:, :n, :n] = basis
    whole_Z[:, :n, n:] = np.tril(basis)
    whole_Z += np.swapaxes(whole_Z, 1, 2)
    whole_Z[:, n:, n:] = basis * eye
    zero = np.zeros((2 * n, 2 * n))
    keep(cone_triangle(whole_Y), cone_triangle(whole_Z), cone_triangle(zero), clarabel.PSDTriangleConeT(2 * n))
    for i in range(n):
        # (t_i, 1, Z_ii): e to the power t_i is at most Z_ii.
        of_Z = np.zeros((m, 3))
        of_Z[:, 2] = basis[:, i, i]
        keep(np.zeros((m, 3)), of_Z, np.array([0.0, 1.0, 0.0]), clarabel.ExponentialConeT())
        rows[-1][0, 2 * m + i] = -1.0
    cost = np.zeros(2 * m + n)
    cost[2 * m :] = -1.0
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix((len(cost), len(cost))),
        cost,
        sparse.csc_matrix(np.concatenate(rows)),
        np.concatenate(offsets),
        cones,
        settings,
    ).solve()
    # What is almost solved is checked by the caller like any other.
    if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        return None
    return np.tensordot(np.array(solution.x)[:m], basis, 1)
