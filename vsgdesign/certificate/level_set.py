"""The quadratic function whose sublevel sets reach furthest, by a small semidefinite program with a log-determinant."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.lyapunov import Family, residual

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
    import cvxpy as cp  # heavy: imported where it is used

    family = Family(np.ones((len(A), 1)), np.zeros((len(A), 1, 1)), np.ones((1, 1)))
    active = list(start) or [int(np.argmax(np.linalg.eigvals(A).real.max(axis=1)))]
    for _ in range(_ROUNDS):
        # Y = P⁻¹: the inequality is linear in it, and log det Y is the set's volume.
        Y: Any = cp.Variable((3, 3), symmetric=True)
        conditions = [
            (a @ Y + Y @ a.T + 2.0 * decay * Y) / np.linalg.norm(a) << -_STRICT * np.eye(3) for a in A[active]
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
