"""Principal components of the inputs: a network is trained on few of them and then becomes one on all inputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

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
