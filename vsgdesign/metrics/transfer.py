"""Transfer matrices of many small state-space models at once, by solving at every frequency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

_CHUNK = 64


@dataclass(frozen=True)
class TransferMatrix:
    """C (sI − A)⁻¹ B of N cells: A (N, n, n), B (N, n, m), C (N, p, n).

    The system is solved with pivoting at every point. Polynomials in s would be no faster, and they lose all digits
    if the modes are decades apart, such as a power filter of 0.1 ms and a loop of 1 s.
    """

    A: Array
    B: Array
    C: Array

    def at(self, cells: NDArray[np.intp], s: Complex) -> Complex:
        """Values (k, p, m) of the given cells at the given points, both (k,)."""
        return _values(self.A[cells], self.B[cells], self.C[cells], s)

    def on(self, s: Complex) -> Complex:
        """Values (N, F, p, m) of all cells at the same points s (F,)."""
        values = np.empty((len(self.A), len(s), self.C.shape[1], self.B.shape[2]), dtype=complex)
        for start in range(0, len(values), _CHUNK):
            part = slice(start, start + _CHUNK)
            values[part] = _values(self.A[part, None], self.B[part, None], self.C[part, None], s)
        return values


def _values(A: Array, B: Array, C: Array, s: Complex) -> Complex:
    states = np.linalg.solve(s[..., None, None] * np.eye(A.shape[-1]) - A, B.astype(complex))
    values = np.zeros((*states.shape[:-2], C.shape[-2], B.shape[-1]), dtype=complex)
    for row, column in np.argwhere(C.any(axis=tuple(range(C.ndim - 2)))):  # mostly zeros: faster than a product
        values[..., row, :] += C[..., row, column, None] * states[..., column, :]
    return values
