"""The circuit between two instants, propagated without step-size error (:eq:`exact-step`).

Between sampling instants the circuit is linear, its bridge voltage piecewise constant and its source a phasor
that turns. So one step is a matrix exponential; a switching edge adds its own step response, which is a short
polynomial in the time that is left; and the source adds its particular solution. α and β share every real
matrix: complex numbers carry both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.filters import FilterGrid, filter_grid_derivative

_MAX_DEGREE = 64
_TAYLOR_ORDER = 14
"""Truncates e^{0.5} below 1e-16."""


def state_matrices(circuit: FilterGrid) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """A (3×3), b (3) and e (3) of d(i_s, v_c, i_g)/dt = A x + b v_b + e v_g, read off the linear equation."""
    columns = [filter_grid_derivative(u[0], u[1], u[2], u[3], u[4], circuit) for u in np.eye(5)]
    matrix = np.array(columns, dtype=float).T
    return matrix[:, :3].copy(), matrix[:, 3].copy(), matrix[:, 4].copy()


@dataclass(frozen=True)
class PlantStep:
    """Exact propagation of one circuit over one interval of length h."""

    h: float
    transition: NDArray[np.float64]
    """Φ(h), 3×3."""
    bridge: NDArray[np.float64]
    """∫Φ b, 3: what a constant bridge voltage adds."""
    edge: NDArray[np.float64]
    """(degree+1)×3: response to a unit step of the bridge voltage τ before the end, as a polynomial in
    x = 2τ/h − 1."""
    source: NDArray[np.complex128]
    """3×3: rows m = 0, 1, 2: what a source (s^m)·e^{jωs} adds over the interval."""


def plant_step(circuit: FilterGrid, h: float, omega: float, *, edges: bool = True) -> PlantStep:
    """Matrices of :class:`PlantStep` for a circuit, an interval h (s) and a source frequency (rad/s).

    ``edges=False`` leaves the edge polynomial empty: an averaged bridge has no edges.
    """
    A, b, e = state_matrices(circuit)
    transition, bridge = _transition_and_integral(A, b, h)
    edge = _edge_polynomial(A, b, h) if edges else np.empty((0, 3))
    return PlantStep(h, transition, bridge, edge, _source_response(A, e, transition, h, omega))


def _transition_and_integral(A: NDArray[np.float64], b: NDArray[np.float64], h: float) -> tuple:
    """Φ(h) and ∫₀ʰ Φ(s) b ds, from one exponential; A may be singular (no resistance anywhere)."""
    augmented = np.zeros((4, 4))
    augmented[:3, :3] = A * h
    augmented[:3, 3] = b * h
    exponential = _exponential(augmented)
    return exponential[:3, :3].copy(), exponential[:3, 3].copy()


def _exponential(M: NDArray[np.float64]) -> NDArray[np.float64]:
    """e^M of a small matrix by a Taylor series of M/2^k, squared k times.

    SciPy's general routine costs the same alone and up to a thousand times more when its threads meet a busy
    machine; a run needs one for every stretch of a ramp, a map one for every cell.
    """
    squarings = max(0, math.ceil(math.log2(max(np.abs(M).sum(axis=0).max(), 1e-300) / 0.5)))
    scaled = M / 2.0**squarings
    identity = np.eye(len(M))
    result = identity
    for k in range(_TAYLOR_ORDER, 0, -1):
        result = identity + scaled @ result / k
    for _ in range(squarings):
        result = result @ result
    return result


def _edge_polynomial(A: NDArray[np.float64], b: NDArray[np.float64], h: float) -> NDArray[np.float64]:
    """Taylor series of ∫₀^τ Φ(s) b ds about τ = h/2, to the last bit that matters over 0 ≤ τ ≤ h.

    NaN where it does not converge: the fastest mode dies out many times within h.
    """
    half = 0.5 * h
    transition, middle = _transition_and_integral(A, b, half)
    coefficients = [middle]
    term = transition @ b * half
    for k in range(1, _MAX_DEGREE):
        coefficients.append(term)
        if k > 2 and np.all(np.abs(term) <= 1e-17 * np.max(np.abs(coefficients), axis=0)):
            break
        term = A @ term * (half / (k + 1))
    else:
        return np.full((1, 3), np.nan)
    return np.array(coefficients)


def _source_response(
    A: NDArray[np.float64], e: NDArray[np.float64], transition: NDArray[np.float64], h: float, omega: float
) -> NDArray[np.complex128]:
    """What s^m e^{jωs}, m = 0, 1, 2, adds: particular solutions of (jω − A) p = …, started from rest."""
    resolvent = np.linalg.inv(1j * omega * np.eye(3) - A)
    p0 = resolvent @ e.astype(complex)
    q = resolvent @ p0
    r = resolvent @ q
    turn = np.exp(1j * omega * h)
    # s·e^{jωs}: (p0 s − q) e^{jωs};  s²·e^{jωs}: (p0 s² − 2 q s + 2 r) e^{jωs}.
    return np.array(
        [
            p0 * turn - transition @ p0,
            (p0 * h - q) * turn + transition @ q,
            (p0 * h * h - 2.0 * q * h + 2.0 * r) * turn - transition @ (2.0 * r),
        ]
    )
