"""Modes of a linear model: damping ratios, participation factors, sensitivities."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complexfloating[Any, Any]]
Array = NDArray[np.float64]


def damping_ratio(eigenvalues: Complex) -> Array:
    """−Re s/|s| of continuous-time eigenvalues; 1 for s = 0 and s = −∞ (neither oscillates)."""
    size = np.abs(eigenvalues)
    moves = (size > 0.0) & np.isfinite(size)
    return np.where(moves, -np.where(moves, eigenvalues.real, -1.0) / np.where(moves, size, 1.0), 1.0).astype(float)


def to_continuous(z: NDArray[Any], T_s: float) -> Complex:
    """s = ln(z)/T_s of discrete-time eigenvalues; −∞ for z = 0 (gone within a sample)."""
    with np.errstate(divide="ignore"):
        rate = np.log(np.abs(z)) / T_s
    return np.asarray(rate + 1j * (np.angle(z) / T_s), dtype=complex)  # a complex quotient makes NaN of −∞


def participation_factors(A: Array) -> tuple[Complex, Array]:
    """Eigenvalues (…, n) and participation |p_ki| (…, n states, n modes), each mode's column summing to one.

    p_ki = v_ki w_ik with right eigenvectors v and left eigenvectors w scaled to w v = I (:eq:`participation`).
    """
    eigenvalues, right = np.linalg.eig(A)
    left = np.linalg.inv(right)
    factors = np.abs(right * np.swapaxes(left, -1, -2))
    return eigenvalues, factors / factors.sum(axis=-2, keepdims=True)


def eigenvalue_sensitivity(A: Array, dA: Array) -> tuple[Complex, Complex]:
    """Eigenvalues and their derivatives w dA v (:eq:`eigenvalue-sensitivity`) for matrices (…, n, n)."""
    eigenvalues, right = np.linalg.eig(A)
    left = np.linalg.inv(right)
    return eigenvalues, np.einsum("...ij,...jk,...ki->...i", left, dA, right)
