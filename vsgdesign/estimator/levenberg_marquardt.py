"""Levenberg–Marquardt: a search for the least sum of squares, with which networks are trained.

A problem defines its cost and the solution of its damped step. This module chooses the damping, accepts or refuses the
steps, watches the validation set and ends the search.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import torch
from torch import Tensor

from vsgdesign.execution.executors import Progress, silent

Scores = Callable[[Tensor], tuple[float, float]]
"""Function of the parameters (n,) that returns the mean squared errors of the validation and of the test set."""


class Linearised(Protocol):
    """A problem linearised at one point x."""

    @property
    def cost(self) -> float:
        """The cost at x."""
        ...

    @property
    def gradient_norm(self) -> float:
        """The 2-norm of the gradient of the cost at x."""
        ...

    def step(self, mu: float) -> Tensor | None:
        """The damped step (n,) for the damping μ (:eq:`levenberg-marquardt-step`); None if it cannot be solved."""
        ...


class Problem(Protocol):
    """A sum or mean of squares over a parameter vector (float64)."""

    def cost(self, x: Tensor) -> float:
        """The cost at x (n,). A step to a cost that is not finite is refused."""
        ...

    def linearise(self, x: Tensor) -> Linearised:
        """The cost, its gradient and the damped step at x (n,)."""
        ...


@dataclass(frozen=True, kw_only=True)
class Damping:
    """How the damping μ changes and when the search ends. The defaults are those of the paper, or else the usual ones.

    The search ends if the cost is at most ``goal``, if the 2-norm of its gradient is below ``least_gradient``, if the
    validation error has failed to improve ``checks`` times in a row, or after ``epochs``. μ begins at ``mu``. It is
    multiplied by ``decrease`` after an accepted step and by ``increase`` after a refused one. Above ``mu_max`` the
    search ends, since no step improves the cost.
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
    """One line of the history: the values at the beginning of an epoch. The error of an empty set is NaN."""

    epoch: int
    cost: float
    validation: float
    test: float
    gradient: float
    mu: float
    checks: int


@dataclass(frozen=True, eq=False)
class _State:
    """All that the next epoch depends on. Before the first epoch, only x and μ are set."""

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
    """The result of a search.

    ``x`` (n,) is the best point: that of the least validation error or, without a validation set, of the least cost.
    ``score`` is this error or cost, and ``epoch`` the epoch in which it was found. ``stop`` says why the search ended:
    ``goal``, ``gradient``, ``validation``, ``damping`` (none up to mu_max improves the cost) or ``epochs``.
    """

    x: Tensor
    stop: str
    epoch: int
    score: float
    history: tuple[Epoch, ...]


def minimise(
    problem: Problem,
    start: Tensor,
    damping: Damping | None = None,
    scores: Scores | None = None,
    progress: Progress = silent,
) -> Fit:
    """Searches from a point x (n,) until one of the ends that :class:`Damping` describes.

    ``scores`` is called once an epoch. Its first value, if it is not NaN, decides which point is the best and may end
    the search. ``progress`` is called once an epoch. What it raises is not caught.
    """
    damping = Damping() if damping is None else damping
    state = _State(start.clone(), damping.mu)
    while True:
        here = problem.linearise(state.x)
        state = _record(state, here, scores)
        stop = _reason(state, damping)
        following = None if stop else _advance(problem, state, here, damping)
        if following is None:
            best = state.x if state.best_x is None else state.best_x
            return Fit(best, stop or "damping", state.best_epoch, state.best_score, state.history)
        progress(f"epoch {state.epoch}, error {here.cost:.3g}", _share(state, damping))
        state = following


def _record(state: _State, here: Linearised, scores: Scores | None) -> _State:
    """The state with the line of history of its epoch and with the best point so far."""
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


def _reason(state: _State, damping: Damping) -> str:
    line = state.history[-1]
    if line.cost <= damping.goal:
        return "goal"
    if line.gradient < damping.least_gradient:
        return "gradient"
    if line.checks >= damping.checks:
        return "validation"
    return "epochs" if line.epoch >= damping.epochs else ""


def _advance(problem: Problem, state: _State, here: Linearised, damping: Damping) -> _State | None:
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


def _share(state: _State, damping: Damping) -> float:
    """The share that is done: of the epochs, or of the decades of the cost down to the goal if that is more."""
    first, now = state.history[0].cost, state.history[-1].cost
    by_epochs = state.epoch / max(damping.epochs, 1)
    if not 0.0 < damping.goal < first or now <= 0.0:
        return min(by_epochs, 1.0)
    return min(max(by_epochs, math.log(first / now) / math.log(first / damping.goal)), 1.0)


def damped_cholesky(hessian: Tensor, gradient: Tensor, mu: float) -> Tensor | None:
    """−(H + μI)⁻¹ g (n,) by Cholesky; None if rounding makes H + μI indefinite."""
    damped = hessian.clone()
    damped.diagonal().add_(mu)
    factor, info = torch.linalg.cholesky_ex(damped)
    if int(info) != 0:
        return None
    return -torch.cholesky_solve(gradient[:, None], factor)[:, 0]
