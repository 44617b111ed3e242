"""One function for all gains at a place, and how far the functions of two places are apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsgdesign.certificate.lyapunov import Family, Level, fit, move_factor

Array = NDArray[np.float64]

_FIRST = 0
"""Of the matrices of a place: that of the middle of its estimates, in whose modes the numbers are of one size."""

_TOGETHER = 10
"""Matrices that the semidefinite program begins with."""


def modal(A: Array) -> Array:
    """The function (n, n) that is the sum of the squares of all modes of A (:eq:`moving-modal`)."""
    _, vectors = np.linalg.eig(A)
    inverse = np.linalg.inv(vectors)
    P = (inverse.conj().T @ inverse).real
    return 0.5 * (P + P.T)


def shortfall(A: Array, P: Array, rho: float) -> float:
    """The largest eigenvalue of AᵀPA − ρ²P over matrices (M, n, n), relative to ρ²P: below zero where P falls."""
    turn = np.linalg.cholesky(P).T
    turned = turn @ A @ np.linalg.inv(turn)
    return float(np.linalg.eigvalsh(np.swapaxes(turned, 1, 2) @ turned).max()) / rho**2 - 1.0


def common_function(A: Array, rho: float, level: Level | None = None) -> Array | None:
    """P (n, n) with AᵀPA ≺ ρ²P for all of A (M, n, n), or None where none is found (:eq:`moving-function`).

    The sum of the squares of the first one's modes is tried, then a semidefinite program: with the bilinear transform
    the inequality is that of :func:`~vsgdesign.certificate.lyapunov.fit`, with the same P. ``level``: the smallest one
    of this kind is looked for.
    """
    try:
        P = modal(A[_FIRST])
        if level is None and shortfall(A, P, rho) < 0.0:
            return P
        turn = np.linalg.cholesky(P).T
    except np.linalg.LinAlgError:
        return None
    back = np.linalg.inv(turn)
    turned = turn @ A @ back / rho
    eye = np.eye(A.shape[1])
    sides = (np.swapaxes(turned + side * eye, 1, 2) for side in (1.0, -1.0))
    rates: Array = np.asarray(np.linalg.solve(*sides).swapaxes(1, 2), dtype=np.float64)
    count = len(A)
    family = Family(np.ones((count, 1)), np.zeros((count, 1, 1)), np.ones((1, 1)))
    own = None if level is None else (back.T @ level[0] @ back, turn @ level[1] @ turn.T)
    if own is not None:  # numbers of one size
        size = max(float(np.linalg.norm(floor, 2)) for floor in own[0])
        own = own[0] / size, own[1] / np.trace(own[1])
    # The solver at times stops before its end: the matrices that it begins with then decide.
    for start in (tuple(range(min(count, _TOGETHER))), ()):
        found, _ = fit(rates, family, 0.0, start, own)
        if found is not None and shortfall(A, P := turn.T @ found.P[0] @ turn, rho) < 0.0:
            return P
    return None


def dwell_time(one: Array, other: Array, decay: float) -> float:
    """How long grids have to last on average when two of them take turns, s (:eq:`moving-dwell`). A function may be
    multiplied by any number, and both ways together do not see it."""
    both = move_factor([one, other * float(np.exp(_offset(one, other)))])
    return float(np.log(both)) / (2.0 * decay)


def _offset(one: Array, other: Array) -> float:
    """Half of the difference of the logarithms of the largest factors, there and back."""
    half, back = (np.linalg.inv(np.linalg.cholesky(P)) for P in (one, other))
    there = np.linalg.eigvalsh(half @ other @ half.T)[-1]
    return 0.5 * float(np.log(np.linalg.eigvalsh(back @ one @ back.T)[-1] / there))
