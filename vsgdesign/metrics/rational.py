"""State space to rational matrices, batched: exact at every frequency for the price of a few polynomials."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True)
class RationalMatrix:
    """N(s)/d(s) of N cells: ``den`` (N, n+1) monic, ``num`` (N, n, p, m), both from the highest power down."""

    num: Array
    den: Array

    def at(self, cells: NDArray[np.intp], s: Complex) -> Complex:
        """Values (k, p, m) of the given cells at the given points, both (k,)."""
        return _horner(self.num[cells], s[:, None, None]) / _horner(self.den[cells], s)[:, None, None]

    def on(self, s: Complex) -> Complex:
        """Values (N, F, p, m) of all cells at the same points s (F,)."""
        num, den = self.num[:, :, None], self.den[:, :, None]
        return _horner(num, s[None, :, None, None]) / _horner(den, s[None, :])[..., None, None]


def _horner(coefficients: Array, s: Complex) -> Complex:
    value = coefficients[:, 0] + 0.0 * s
    for k in range(1, coefficients.shape[1]):
        value = value * s + coefficients[:, k]
    return value


def transfer_matrix(A: Array, B: Array, C: Array) -> RationalMatrix:
    """C (sI − A)⁻¹ B of N cells by the Faddeev–LeVerrier recursion.

    Meant for a handful of states (n ≤ 6), where the recursion loses no more than a few digits; time is scaled
    by the cell's spectral size first, which keeps the coefficients of one magnitude.
    """
    count, n, _ = A.shape
    scale = np.maximum(np.abs(A).max(axis=(1, 2)), 1e-12)
    scaled = A / scale[:, None, None]
    den, num = np.ones((count, n + 1)), np.empty((count, n, C.shape[1], B.shape[2]))
    identity = np.eye(n)
    term = np.broadcast_to(identity, A.shape)
    for k in range(1, n + 1):
        num[:, k - 1] = C @ term @ B * (scale ** (k - 1))[:, None, None]
        product = scaled @ term
        trace = -np.trace(product, axis1=1, axis2=2) / k
        den[:, k] = trace * scale**k
        term = product + trace[:, None, None] * identity
    return RationalMatrix(num, den)
