"""Principal components of the inputs: train in few dimensions, then fold back to all of them exactly."""

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
    """p = ((x − centre)·basis): ``basis`` (n, r) is orthogonal with columns scaled to unit deviation."""

    centre: Array
    basis: Array

    def project(self, x: Array) -> Array:
        """(N, n) to (N, r)."""
        return (x - self.centre) @ self.basis

    def fold(self, weights: Array, bias: Array) -> tuple[Array, Array]:
        """A first layer on the components, (h, r) and (h,), as one on x, (h, n) and (h,) (:eq:`fold-projection`)."""
        folded = weights @ self.basis.T
        return folded, bias - folded @ self.centre


def principal_components(x: Array, count: int | None = None, margin: float = 10.0) -> Projection:
    """The projection on the ``count`` largest principal components of x (N, n).

    Without a count: those with a variance above ``margin`` times the median one and above what sensors resolve. A
    window is a few phasors and ripple among hundreds of samples, so that the median is the sensors' noise; windows
    without noise have none to stand out of. At least one is kept.
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
    # The sign of a component is anybody's choice: made here, so that a seed means one network everywhere.
    rows = rows[:count] * np.sign(rows[np.arange(count), largest])[:, None]
    return Projection(centre, rows.T / np.sqrt(variance[:count]))
