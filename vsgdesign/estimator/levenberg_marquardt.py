"""Levenberg–Marquardt: one core for training a network and for any small least-squares problem.

A problem says what it costs and how its damped step is solved; the core chooses the damping, judges the steps,
watches the validation set and stops. It advances by whole epochs from one frozen state to the next, so an
interruption leaves the last whole state, and a run that goes on from there is the undisturbed one, bit by bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import torch
from torch import Tensor

from vsgdesign.execution.progress import Progress, silent

Scores = Callable[[Tensor], tuple[float, float]]
"""Parameters to the mean squared errors of the validation and the test set."""


class Linearised(Protocol):
    """A problem about one point."""

    @property
    def cost(self) -> float: ...

    @property
    def gradient_norm(self) -> float: ...

    def step(self, mu: float) -> Tensor | None:
        """The damped step (:eq:`levenberg-marquardt-step`); None where it cannot be solved."""
        ...


class Problem(Protocol):
    """A sum or mean of squares over a parameter vector (float64)."""

    def cost(self, x: Tensor) -> float:
        """What is minimised; anything not finite is refused as a step."""
        ...

    def linearise(self, x: Tensor) -> Linearised:
        """Cost, gradient and the damped step at x."""
        ...


@dataclass(frozen=True, kw_only=True)
class Damping:
    """How the damping moves and when the search ends. The defaults are the paper's, else those of the field.

    ``goal`` is on the cost, ``least_gradient`` on its gradient's 2-norm; ``checks`` is how often in a row the
    validation error may fail to improve. After an accepted step μ is multiplied by ``decrease``, after a refused
    one by ``increase``; beyond ``mu_max`` there is no better point to be found.
    """

    epochs: int = 500
    goal: float = 1e-5
    least_gradient: float = 1e-7
    mu: float = 1e-6
    increase: float = 10.0
    decrease: float = 0.1
    mu_max: float = 1e10
    checks: int = 6


@dataclass(frozen=True, kw_only=True)
class Epoch:
    """One line of the history: where an epoch begins. Without a set its error is NaN."""

    epoch: int
    cost: float
    validation: float
    test: float
    gradient: float
    mu: float
    checks: int


@dataclass(frozen=True, eq=False)
class State:
    """All that the next epoch depends on. Before the first epoch: x alone."""

    x: Tensor
    mu: float
    epoch: int = 0
    checks: int = 0
    best_x: Tensor | None = None
    best_score: float = math.inf
    best_epoch: int = 0
    history: tuple[Epoch, ...] = ()


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a search ended.

    ``x`` is the best point, of the least validation error or, without a validation set, of the least cost: that is
    ``score``, and ``epoch`` when it was. ``stop`` is one of ``STOPS``. ``state`` is where to go on from.
    """

    x: Tensor
    stop: str
    epoch: int
    score: float
    history: tuple[Epoch, ...]
    state: State


STOPS = {
    "goal": "the cost reached its goal",
    "gradient": "the gradient is below its limit: a stationary point",
    "validation": "the validation error rose too often in a row",
    "damping": "no damping up to mu_max improves the cost: the training has converged to rounding or cannot go on",
    "epochs": "all epochs are used: continue from the state, or allow more",
    "interrupted": "the training was interrupted: continue from the state",
}
"""Why a search ended, and what that means."""


def minimise(
    problem: Problem,
    start: Tensor | State,
    damping: Damping | None = None,
    scores: Scores | None = None,
    progress: Progress = silent,
) -> Fit:
    """Search from a point, or go on from a state, until one of ``STOPS``.

    ``scores`` are computed once an epoch; their first, if it is not NaN, decides what is best and may stop the
    search. ``progress`` is called once an epoch. KeyboardInterrupt, from it or from outside, ends the search as
    ``interrupted``; any other error passes through.
    """
    damping = Damping() if damping is None else damping
    state = start if isinstance(start, State) else State(start.clone(), damping.mu)
    reached = state
    try:
        while True:
            here = problem.linearise(state.x)
            scored = _record(state, here, scores)
            stop = _reason(scored, damping)
            following = None if stop else _advance(problem, scored, here, damping)
            if following is None:
                # Not recorded yet in the state: whoever goes on records this epoch again, and only once.
                return _fit(scored, stop or "damping", state)
            progress(f"epoch {state.epoch}, error {here.cost:.3g}", _share(scored, damping))
            reached, state = scored, following
    except KeyboardInterrupt:
        return _fit(reached, "interrupted", state)


def _record(state: State, here: Linearised, scores: Scores | None) -> State:
    """The state with its epoch's line of history, and what is the best by now."""
    validation, test = (math.nan, math.nan) if scores is None else scores(state.x)
    score = here.cost if math.isnan(validation) else validation
    better = score < state.best_score
    checks = 0 if better or math.isnan(validation) else state.checks + 1
    line = Epoch(
        epoch=state.epoch,
        cost=here.cost,
        validation=validation,
        test=test,
        gradient=here.gradient_norm,
        mu=state.mu,
        checks=checks,
    )
    state = replace(state, checks=checks, history=(*state.history, line))
    if better or state.best_x is None:
        state = replace(state, best_x=state.x, best_score=score, best_epoch=state.epoch)
    return state


def _reason(state: State, damping: Damping) -> str:
    line = state.history[-1]
    if line.cost <= damping.goal:
        return "goal"
    if line.gradient < damping.least_gradient:
        return "gradient"
    if line.checks >= damping.checks:
        return "validation"
    return "epochs" if line.epoch >= damping.epochs else ""


def _advance(problem: Problem, state: State, here: Linearised, damping: Damping) -> State | None:
    """One epoch: the least damping from the present one up whose step improves the cost; None beyond mu_max."""
    mu = state.mu
    while mu <= damping.mu_max:
        step = here.step(mu)
        if step is not None:
            x = state.x + step
            if problem.cost(x) < here.cost:  # false for NaN too
                # From zero it could never rise again.
                return replace(state, x=x, mu=max(mu * damping.decrease, 1e-30), epoch=state.epoch + 1)
        mu *= damping.increase
    return None


def _fit(reached: State, stop: str, state: State) -> Fit:
    best = state.x if reached.best_x is None else reached.best_x
    return Fit(best, stop, reached.best_epoch, reached.best_score, reached.history, state)


def _share(state: State, damping: Damping) -> float:
    """How far: by epochs, or by the decades of cost to the goal where that is more."""
    first, now = state.history[0].cost, state.history[-1].cost
    by_epochs = state.epoch / max(damping.epochs, 1)
    if not 0.0 < damping.goal < first or now <= 0.0:
        return min(by_epochs, 1.0)
    return min(max(by_epochs, math.log(first / now) / math.log(first / damping.goal)), 1.0)


def damped_cholesky(hessian: Tensor, gradient: Tensor, mu: float) -> Tensor | None:
    """−(H + μI)⁻¹ g by Cholesky; None where rounding leaves H + μI indefinite."""
    damped = hessian.clone()
    damped.diagonal().add_(mu)
    factor, info = torch.linalg.cholesky_ex(damped)
    if int(info) != 0:
        return None
    return -torch.cholesky_solve(gradient[:, None], factor)[:, 0]


@dataclass(frozen=True, eq=False)
class Residuals:
    """A small dense problem, r(x) with its Jacobian, ½‖r‖² left unhalved: the cost is the sum of squares.

    ``residual`` gives (N,), ``jacobian`` (N, n). The damping is on x in units of the Jacobian's column norms, so
    that parameters may be of any size, and the step is an augmented least-squares problem by QR
    (:eq:`augmented-step`): nothing is squared.
    """

    residual: Callable[[Tensor], Tensor]
    jacobian: Callable[[Tensor], Tensor]

    def cost(self, x: Tensor) -> float:
        """Sum of squares."""
        r = self.residual(x)
        return float(r @ r)

    def linearise(self, x: Tensor) -> Linearised:
        """QR of the scaled Jacobian, once for all dampings."""
        r, J = self.residual(x), self.jacobian(x)
        scale = torch.linalg.vector_norm(J, dim=0)
        scale = torch.where(scale > 0.0, scale, torch.ones_like(scale))
        Q, R = torch.linalg.qr(J / scale)
        gradient = float(torch.linalg.vector_norm(2.0 * (J.T @ r)))
        return _Triangular(float(r @ r), gradient, R, Q.T @ r, scale)


@dataclass(frozen=True, eq=False)
class _Triangular:
    cost: float
    gradient_norm: float
    R: Tensor
    Q_r: Tensor
    scale: Tensor

    def step(self, mu: float) -> Tensor | None:
        n = len(self.scale)
        rows = torch.cat([self.R, math.sqrt(mu) * torch.eye(n, dtype=self.R.dtype)])
        right = torch.cat([-self.Q_r, torch.zeros(n, dtype=self.R.dtype)])
        Q, R = torch.linalg.qr(rows)
        if bool((R.diagonal() == 0.0).any()):
            return None
        return torch.linalg.solve_triangular(R, (Q.T @ right)[:, None], upper=True)[:, 0] / self.scale
