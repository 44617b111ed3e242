"""The cutting planes against one semidefinite program with all cells at once, written in cvxpy."""

from __future__ import annotations

import warnings
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from vsgdesign.certificate.lyapunov import Family, best_fit, fit, largest_level_set, residual

CELLS, ORDER = 25, 3


def cells(seed: int) -> np.ndarray:
    """Random stable matrices around one, so that they have a function in common, but not at their own decay."""
    rng = np.random.default_rng(seed)
    middle = np.array([[0.0, 4.0, 0.0], [-4.0, -7.0, 0.0], [0.0, 0.0, -4.0]])
    return middle + 0.65 * rng.standard_normal((CELLS, ORDER, ORDER))


def family(A: np.ndarray) -> Family:
    ones = np.ones((len(A), 1))
    return Family(ones, np.zeros((len(A), 1, 1)), np.ones((1, 1)))


def exists(A: np.ndarray, decay: float) -> bool:
    """Whether P ⪰ I with AᵀP + PA + 2·decay·P ⪯ 0 for all cells exists, by cvxpy's own modelling and checks."""
    P = cp.Variable((ORDER, ORDER), symmetric=True)
    inequalities = [a.T @ P + P @ a + 2.0 * decay * P << 0 for a in A]
    problem = cp.Problem(cp.Minimize(cp.trace(P)), [P >> np.eye(ORDER), *inequalities])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # "may be inaccurate": at the limit it is, and counts as a no
        problem.solve(solver=cp.CLARABEL)
    return problem.status == cp.OPTIMAL


@pytest.mark.parametrize("seed", range(4))
def test_the_largest_decay_is_that_of_the_whole_program(seed: int) -> None:
    """To the bisection's 1 % of the limit, and what asking for strictness costs."""
    A = cells(seed)
    limit = float(-np.linalg.eigvals(A).real.max())
    found, _ = best_fit(A, family(A), limit, 0.01)
    assert found is not None
    assert exists(A, 0.98 * found.decay)
    assert not exists(A, found.decay + 0.03 * limit)
    # And it is one: the residual is a decay relative to P, checked here by generalised eigenvalues.
    P = found.P[0]
    for a in A:
        half = np.linalg.cholesky(P)
        inverse = np.linalg.inv(half)
        assert np.linalg.eigvalsh(inverse @ (a.T @ P + P @ a) @ inverse.T).max() < -2.0 * found.decay + 1e-9
    assert residual(A, family(A), found.P, found.decay).max() < 0.0


@pytest.mark.parametrize("seed", range(4))
def test_the_largest_set_is_that_of_the_whole_program(seed: int) -> None:
    """Its volume to the solver's accuracy, and a bound on V that is reached."""
    A, decay, limits, share = cells(seed), 0.1, (0.8, 1.2), 0.3
    Y = cp.Variable((ORDER, ORDER), symmetric=True)
    kept = [a @ Y + Y @ a.T + 2.0 * decay * Y << 0 for a in A] + [Y[2, 2] <= share]
    for V in limits:
        turn = np.array([[V, 0.0, 0.0], [0.0, 0.0, 1.0]])
        kept.append(turn @ Y @ turn.T << np.eye(2))
    problem = cp.Problem(cp.Maximize(cp.log_det(Y)), kept)
    problem.solve(solver=cp.CLARABEL)
    assert problem.status == cp.OPTIMAL
    P, active = largest_level_set(A, decay, limits, share)
    assert P is not None
    assert len(active) < CELLS
    assert -np.linalg.slogdet(P)[1] == pytest.approx(problem.value, abs=1e-3)
    assert np.linalg.inv(P)[2, 2] <= share * (1.0 + 1e-6)


def test_a_function_of_the_solver_is_not_believed_before_its_eigenvalues(monkeypatch: pytest.MonkeyPatch) -> None:
    """A solver that calls 'solved' what is not positive at a corner between which no cell lies."""
    A = cells(0)[:1]
    moving = Family(np.array([[1.0, 0.0]]), np.zeros((1, 1, 2)), np.array([[1.0, -1.0], [1.0, 1.0]]))
    honest = fit(A, moving, 0.1)[0]
    assert honest is not None

    class Wrong:
        def __init__(self, *given: Any) -> None:
            self.solver = clarabel_solver(*given)

        def solve(self) -> Any:
            solution = self.solver.solve()
            x = np.array(solution.x)
            x[6:12] = 2.0 * x[:6]  # P_1 = 2 P_0: P_0 − P_1 is negative
            return SimpleNamespace(status=solution.status, x=x)

    clarabel: Any = import_module("clarabel")  # compiled, without types
    clarabel_solver = clarabel.DefaultSolver
    monkeypatch.setattr(clarabel, "DefaultSolver", Wrong)
    assert fit(A, moving, 0.1)[0] is None
