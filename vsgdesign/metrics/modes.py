"""Modes of a linear model: damping ratios, participation factors, sensitivities."""

from __future__ import annotations

from dataclasses import dataclass
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


def least_damping(eigenvalues: Complex) -> Array:
    """The least damping ratio (…) over the modes (…, n) of models: of their power loops or of all modes, as
    :data:`vsgdesign.artifacts.definitions.DEFINITIONS` has it."""
    return np.asarray(damping_ratio(eigenvalues).min(axis=-1))


def to_continuous(z: NDArray[Any], T_s: float) -> Complex:
    """s = ln(z)/T_s of discrete-time eigenvalues; −∞ for z = 0, which decays within one sample."""
    with np.errstate(divide="ignore"):
        rate = np.log(np.abs(z)) / T_s
    return np.asarray(rate + 1j * (np.angle(z) / T_s), dtype=complex)  # a complex quotient makes NaN of −∞


@dataclass(frozen=True)
class PartialFractions:
    """C (zI − A)⁻¹ B of N sampled models as a sum over modes Σ R/(z − p).

    ``poles`` (N, n), ``residues`` (N, n, outputs, inputs). Modes of a (nearly) defective matrix have (nearly)
    parallel eigenvectors: large terms then cancel, or there is no such sum. ``usable`` (N,) is true if the sum keeps
    at least ten of its sixteen digits.
    """

    poles: Complex
    residues: Complex
    usable: NDArray[np.bool_]


_DIGITS_LOST = 1e6


@dataclass(frozen=True)
class Eigen:
    """Eigenvalues (N, n) and eigenvectors of N matrices, right (N, n, n) in columns and left (N, n, n) in rows.

    The left ones are scaled to left·right = I. ``regular`` (N,): whether there are n independent eigenvectors; the
    matrices of the others are those of the identity.
    """

    values: Complex
    right: Complex
    left: Complex
    regular: NDArray[np.bool_]


def taken(found: Eigen, index: Any) -> Eigen:
    """The eigenvectors of some of the matrices, or of one of them."""
    return Eigen(found.values[index], found.right[index], found.left[index], found.regular[index])


def eigen(A: Array) -> Eigen:
    """Eigenvalues and both kinds of eigenvectors of matrices (N, n, n)."""
    values, right = (np.asarray(found, dtype=np.complex128) for found in np.linalg.eig(A))
    try:
        left = np.asarray(np.linalg.inv(right), dtype=np.complex128)
    except np.linalg.LinAlgError:  # one of them is singular to the last bit
        regular = np.linalg.cond(right) < 1.0 / np.finfo(float).eps
        right = np.where(regular[:, None, None], right, np.eye(A.shape[-1], dtype=complex))
        return Eigen(values, right, np.asarray(np.linalg.inv(right), dtype=np.complex128), regular)
    norms = [np.abs(matrix).sum(axis=-2).max(axis=-1) for matrix in (right, left)]
    regular = norms[0] * norms[1] < 1.0 / np.finfo(float).eps
    if not regular.all():
        one = np.eye(A.shape[-1], dtype=complex)
        right, left = (np.where(regular[:, None, None], matrix, one) for matrix in (right, left))
    return Eigen(values, right, left, regular)


def partial_fractions(A: Array, B: Array, C: Array, known: Eigen | None = None) -> PartialFractions:
    """The sum over modes of A (N, n, n), B (N, n, inputs), C (N, outputs, n) with |z| near one.

    ``known``: what :func:`eigen` gives for A, if it was computed before.
    """
    found = eigen(A) if known is None else known
    poles = found.values
    seen, driven = np.swapaxes(C @ found.right, -1, -2), found.left @ B
    residues = np.asarray(seen[..., :, None] * driven[..., None, :], dtype=np.complex128)
    # Terms against their sum, on the unit circle beside every pole, where each is largest; never on a pole.
    z = np.exp(1j * np.minimum(1.001 * np.hypot(np.angle(poles), 1.0 - np.abs(poles)) + 1e-9, 3.14))
    factors = 1.0 / (z[:, :, None] - poles[:, None, :])
    flat = residues.reshape(*poles.shape, C.shape[-2] * B.shape[-1])
    terms, sums = (np.abs(f).max(axis=1) for f in (np.abs(factors) @ np.abs(flat), factors @ flat))
    return PartialFractions(poles, residues, found.regular & np.all(terms <= _DIGITS_LOST * sums, axis=-1))


def participation_factors(A: Array, known: Eigen | None = None) -> tuple[Complex, Array]:
    """Eigenvalues (…, n) and participation |p_ki| (…, n states, n modes), each mode's column summing to one.

    p_ki = v_ki w_ik with right eigenvectors v and left eigenvectors w scaled to w v = I (:eq:`participation`).
    ``known``: what :func:`eigen` gives for A, if it was computed before.
    """
    if known is None:
        eigenvalues, right = np.linalg.eig(A)
        left = np.linalg.inv(right)
    else:
        eigenvalues, right, left = known.values, known.right, known.left
    factors = np.abs(right * np.swapaxes(left, -1, -2))
    return eigenvalues, factors / factors.sum(axis=-2, keepdims=True)


def eigenvalue_sensitivity(A: Array, dA: Array) -> tuple[Complex, Complex]:
    """Eigenvalues and their derivatives w dA v (:eq:`eigenvalue-sensitivity`) for matrices (…, n, n)."""
    eigenvalues, right = np.linalg.eig(A)
    left = np.linalg.inv(right)
    return eigenvalues, np.einsum("...ij,...jk,...ki->...i", left, dA, right)
