"""A network of one tanh layer and a linear output, as a Levenberg–Marquardt problem with an analytic Jacobian."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vsgdesign.estimator.levenberg_marquardt import Linearised, damped_cholesky

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
