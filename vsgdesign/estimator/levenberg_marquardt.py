"""Levenberg–Marquardt: a search for the least sum of squares, and the network of one tanh layer that is trained with
it.

A problem defines its cost and the solution of its damped step. The search chooses the damping, accepts or refuses the
steps, watches the validation set and ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
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


Array = NDArray[np.float64]

_ROUNDING = 1e-20
"""Share of the largest variance below which a component is rounding."""

_RESOLUTION = 1e-8
"""Variance below which a component is beyond any sensor, relative to a channel's: 0.01 % of its deviation."""


@dataclass(frozen=True, eq=False)
class Projection:
    """p = (x − centre)·basis. ``basis`` (n, r) has orthogonal columns, which give components of unit deviation."""

    centre: Array
    basis: Array

    def project(self, x: Array) -> Array:
        """The components (N, r) of inputs (N, n)."""
        return (x - self.centre) @ self.basis

    def fold(self, weights: Array, bias: Array) -> tuple[Array, Array]:
        """The first layer on x, (h, n) and (h,), of one on the components, (h, r) and (h,) (:eq:`fold-projection`)."""
        folded = weights @ self.basis.T
        return folded, bias - folded @ self.centre


def principal_components(x: Array, count: int | None = None, margin: float = 10.0) -> Projection:
    """The projection on the ``count`` largest principal components of x (N, n).

    Without a count, those components are taken whose variance is above ``margin`` times the median variance and above
    the resolution of sensors. A window contains a few phasors and ripple in hundreds of samples, so that the median is
    the noise of the sensors. At least one component is kept.
    """
    centre = x.mean(axis=0)
    _, singular, directions = torch.linalg.svd(torch.from_numpy(x - centre), full_matrices=False)
    variance, rows = singular.numpy() ** 2 / len(x), directions.numpy()
    usable = int(np.sum(variance > _ROUNDING * variance[0]))
    if count is None:
        floor = _RESOLUTION * float(np.sum(variance)) / x.shape[1]
        count = int(np.sum(variance > max(margin * float(np.median(variance)), floor)))
    count = max(min(count, usable), 1)
    largest = np.argmax(np.abs(rows[:count]), axis=1)
    # The sign of a component is arbitrary. It is fixed here, so that a seed gives the same network everywhere.
    rows = rows[:count] * np.sign(rows[np.arange(count), largest])[:, None]
    return Projection(centre, rows.T / np.sqrt(variance[:count]))


Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shape:
    """n–h–m: inputs, hidden units, outputs."""

    inputs: int
    hidden: int
    outputs: int

    @property
    def parameters(self) -> int:
        """Number of weights and biases."""
        return self.hidden * (self.inputs + 1) + self.outputs * (self.hidden + 1)

    def layers(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """The parameters as matrices (h, n + 1) and (m, h + 1) with the biases last. They are views."""
        first = self.hidden * (self.inputs + 1)
        return x[:first].view(self.hidden, self.inputs + 1), x[first:].view(self.outputs, self.hidden + 1)


def with_ones(values: Tensor) -> Tensor:
    """The values (N, n) with a last column of ones, which the bias multiplies: (N, n + 1)."""
    return torch.cat([values, torch.ones(len(values), 1, dtype=values.dtype)], dim=1)


def initial_parameters(shape: Shape, seed: int, start: int = 0) -> Tensor:
    """First parameters after Nguyen and Widrow: spread hidden units and a small output layer.

    The weight vector of every hidden unit has the length 0.4·h^(1/n), and the biases distribute the centres of the
    units evenly along it. The factor of the rule is 0.7 for inputs that are uniform over [−1, 1]. 0.4 corresponds to it
    for inputs of unit standard deviation. The same seed and start give the same parameters.
    """
    rng = np.random.default_rng([seed, start])
    n, h, m = shape.inputs, shape.hidden, shape.outputs
    direction = rng.uniform(-1.0, 1.0, (h, n))
    length = 0.4 * h ** (1.0 / n)
    weights = length * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    bias = length * np.linspace(-1.0, 1.0, h) * np.sign(direction[:, 0])
    first = np.column_stack([weights, bias])
    second = rng.uniform(-1.0, 1.0, (m, h + 1)) / math.sqrt(h)
    return torch.from_numpy(np.concatenate([first.ravel(), second.ravel()]))


def outputs(shape: Shape, x: Tensor, inputs: Tensor) -> Tensor:
    """The network's outputs (N, m) for inputs with their column of ones (N, n + 1) (:eq:`network`)."""
    first, second = shape.layers(x)
    return with_ones(torch.tanh(inputs @ first.T)) @ second.T


def mean_squared_error(shape: Shape, x: Tensor, inputs: Tensor, targets: Tensor) -> float:
    """The mean squared error over samples and outputs; NaN without samples."""
    if len(inputs) == 0:
        return math.nan
    return float(torch.mean((outputs(shape, x, inputs) - targets) ** 2))


@dataclass(frozen=True, eq=False)
class NetworkProblem:
    """The mean squared error of a network, regularised by the mean square of its parameters (:eq:`network-cost`).

    ``inputs`` (N, n + 1) with ones last, ``targets`` (N, m), both float64; ``regularisation`` is its share γ.
    """

    shape: Shape
    inputs: Tensor
    targets: Tensor
    regularisation: float = 0.0

    def cost(self, x: Tensor) -> float:
        """(1 − γ)·mse + γ·mean(x²)."""
        return self._regularised(mean_squared_error(self.shape, x, self.inputs, self.targets), x)

    def linearise(self, x: Tensor) -> Linearised:
        """The Gauss–Newton matrix and the gradient, without forming the Jacobian (:eq:`network-normal`).

        The first-layer part of a row of the Jacobian is W_2[k, j]·s_j·(input, 1). Between outputs k it differs only by
        the factor W_2[k, j], so that one product of N rows serves all outputs.
        """
        shape, (_, second) = self.shape, self.shape.layers(x)
        N, m, h = len(self.inputs), shape.outputs, shape.hidden
        first_size = h * (shape.inputs + 1)
        weights = second[:, :h]
        hidden = torch.tanh(self.inputs @ self.shape.layers(x)[0].T)
        slope = 1.0 - hidden * hidden
        extended = with_ones(hidden)
        error = extended @ second.T - self.targets
        slopes_inputs = (slope[:, :, None] * self.inputs[:, None, :]).view(N, first_size)

        hessian = torch.zeros(len(x), len(x), dtype=x.dtype)
        block = hessian[:first_size, :first_size]
        width = shape.inputs + 1
        for j in range(h):  # the upper half by blocks, the lower is its mirror
            here, rest = slice(j * width, (j + 1) * width), slice((j + 1) * width, first_size)
            torch.mm(slopes_inputs[:, here].T, slopes_inputs[:, j * width :], out=block[here, j * width :])
            block[rest, here] = block[here, rest].T
        block.view(h, width, h, width).mul_((weights.T @ weights)[:, None, :, None])
        mixed = (slopes_inputs.T @ extended).view(h, width, h + 1)
        own = extended.T @ extended
        for k in range(m):
            here = slice(first_size + k * (h + 1), first_size + (k + 1) * (h + 1))
            hessian[:first_size, here] = (weights[k][:, None, None] * mixed).view(first_size, h + 1)
            hessian[here, :first_size] = hessian[:first_size, here].T
            hessian[here, here] = own
        gradient = torch.cat([((slope * (error @ weights)).T @ self.inputs).ravel(), (error.T @ extended).ravel()])

        share = (1.0 - self.regularisation) / (N * m)
        hessian *= share
        hessian.diagonal().add_(self.regularisation / len(x))
        gradient = share * gradient + (self.regularisation / len(x)) * x
        return _Normal(self._regularised(float(torch.mean(error**2)), x), hessian, gradient)

    def _regularised(self, mse: float, x: Tensor) -> float:
        if self.regularisation == 0.0:
            return mse
        return (1.0 - self.regularisation) * mse + self.regularisation * float(torch.mean(x * x))


@dataclass(frozen=True, eq=False)
class _Normal:
    """Half the Gauss–Newton Hessian and half the gradient of the cost."""

    cost: float
    hessian: Tensor
    half_gradient: Tensor

    @property
    def gradient_norm(self) -> float:
        return 2.0 * float(torch.linalg.vector_norm(self.half_gradient))

    def step(self, mu: float) -> Tensor | None:
        return damped_cholesky(self.hessian, self.half_gradient, mu)
