"""The circuit between two instants, propagated without step-size error (:eq:`exact-step`).

Between sampling instants the circuit is linear, its bridge voltage piecewise constant and its source a phasor
that turns. So one step is a matrix exponential; a switching edge adds its own step response, which is a short
polynomial in the time that is left; and the source adds its particular solution. Where α and β are alike they share
every real matrix, and complex numbers carry both; where they differ the matrices are real and twice as large.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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


@dataclass(frozen=True, eq=False)
class TwoAxisCircuit:
    """A linear circuit whose axes may differ: dx/dt = A x + B (v_b,α, v_b,β) + E (v_g,α, v_g,β), SI, peak.

    x has 2n entries, α and β in turn. The first three pairs are i_s, v_c and i_g, which the sensors see; others may
    follow, the same in every circuit of a run.
    """

    A: NDArray[np.float64]
    """2n×2n, 1/s."""
    B: NDArray[np.float64]
    E: NDArray[np.float64]
    """2n×2."""


def two_axes(alpha: FilterGrid | TwoAxisCircuit, beta: FilterGrid | None = None) -> TwoAxisCircuit:
    """One circuit on the α axis and another one (or the same) on the β axis, uncoupled."""
    if isinstance(alpha, TwoAxisCircuit):
        return alpha
    A, B, E = np.zeros((6, 6)), np.zeros((6, 2)), np.zeros((6, 2))
    for axis, circuit in enumerate((alpha, beta or alpha)):
        A[axis::2, axis::2], B[axis::2, axis], E[axis::2, axis] = state_matrices(circuit)
    return TwoAxisCircuit(A, B, E)


@dataclass(frozen=True, eq=False)
class PlantStep:
    """Exact propagation of one circuit over one interval of length h.

    Of a :class:`FilterGrid` the arrays are for one axis, since both are alike: n = 3, and there is no last dimension
    for the axis of an input. Of a :class:`TwoAxisCircuit` they are for both, with 2n in place of n.
    """

    h: float
    transition: NDArray[np.float64]
    """Φ(h), n×n or 2n×2n."""
    bridge: NDArray[np.float64]
    """∫Φ b, n or 2n×2: what a constant bridge voltage adds."""
    edge: NDArray[np.float64]
    """(degree+1)×n or (degree+1)×2n×2: response to a unit step of the bridge voltage τ before the end, as a polynomial
    in x = 2τ/h − 1."""
    source: NDArray[Any]
    """What a source c·s^m·e^{jωs} adds over the interval, m = 0, 1, 2: complex 3×n, to be multiplied by c; or real
    3×2n×2, to be multiplied by (Re c, Im c)."""


def plant_step(circuit: FilterGrid | TwoAxisCircuit, h: float, omega: float, *, edges: bool = True) -> PlantStep:
    """Matrices of :class:`PlantStep` for a circuit, an interval h (s) and a source frequency (rad/s).

    ``edges=False`` leaves the edge polynomial empty: an averaged bridge has no edges.
    """
    equal = isinstance(circuit, FilterGrid)
    A, b, e = state_matrices(circuit) if equal else (circuit.A, circuit.B, circuit.E)
    transition, bridge = _transition_and_integral(A, b, h)
    edge = _edge_polynomial(A, b, h) if edges else np.empty((0, *b.shape))
    if equal:
        source = _source_response(A, e, transition, h, omega)
    else:
        alpha, beta = (_source_response(A, e[:, axis], transition, h, omega) for axis in range(2))
        # (:eq:`two-axes`): c = 1 is cos on α and sin on β; c = j is −sin on α and cos on β.
        source = np.stack([alpha.real + beta.imag, beta.real - alpha.imag], axis=-1)
    return PlantStep(h, transition, bridge, edge, source)


def straight_line_responses(circuit: FilterGrid | TwoAxisCircuit, h: float) -> NDArray[np.float64]:
    """What a source v + s·t adds over an interval h (s): real (4, 2n), for v_α, v_β, s_α and s_β (:eq:`replay`)."""
    full = two_axes(circuit)
    size = len(full.A)
    augmented = np.zeros((size + 4, size + 4))  # of x, v and s: v is the integral of s
    augmented[:size, :size] = full.A * h
    augmented[:size, size : size + 2] = full.E * h
    augmented[size : size + 2, size + 2 :] = np.eye(2) * h
    return _exponentials(augmented[None])[0][:size, size:].T.copy()


def averaged_steps(circuits: Sequence[FilterGrid], h: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Φ(h) (G, n, n) and ∫Φ b (G, n) of many circuits: transition and bridge of :class:`PlantStep`, to the bit."""
    augmented = []
    for circuit in circuits:
        A, b, _ = state_matrices(circuit)
        augmented.append(_augmented(A, b[:, None], h))
    exponentials = _exponentials(np.array(augmented))
    return exponentials[:, :-1, :-1].copy(), exponentials[:, :-1, -1].copy()


def _transition_and_integral(A: NDArray[np.float64], b: NDArray[np.float64], h: float) -> tuple:
    """Φ(h) and ∫₀ʰ Φ(s) b ds, from one exponential; A may be singular (no resistance anywhere)."""
    n = len(A)
    exponential = _exponentials(_augmented(A, b.reshape(n, -1), h)[None])[0]
    return exponential[:n, :n].copy(), exponential[:n, n:].reshape(b.shape).copy()


def _augmented(A: NDArray[np.float64], inputs: NDArray[np.float64], h: float) -> NDArray[np.float64]:
    n = len(A)
    augmented = np.zeros((n + inputs.shape[1], n + inputs.shape[1]))
    augmented[:n, :n] = A * h
    augmented[:n, n:] = inputs * h
    return augmented


def _exponentials(M: NDArray[np.float64]) -> NDArray[np.float64]:
    """e^M of small matrices (G, m, m) by Taylor series of M/2^k, squared k times.

    SciPy's general routine costs the same alone and up to a thousand times more when its threads meet a busy
    machine; a run needs one for every stretch of a ramp, a map one for every cell.
    """
    norms = np.abs(M).sum(axis=1).max(axis=1)
    squarings = [max(0, math.ceil(math.log2(max(norm, 1e-300) / 0.5))) for norm in norms.tolist()]
    if len(set(squarings)) == 1:
        return _squared_series(M, squarings[0])
    result = np.empty_like(M)
    for k in set(squarings):
        some = np.flatnonzero(np.array(squarings) == k)
        result[some] = _squared_series(M[some], k)
    return result


def _squared_series(M: NDArray[np.float64], squarings: int) -> NDArray[np.float64]:
    scaled = M / 2.0**squarings
    identity = np.eye(M.shape[-1])
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
        return np.full((1, *b.shape), np.nan)
    return np.array(coefficients)


def _source_response(
    A: NDArray[np.float64], e: NDArray[np.float64], transition: NDArray[np.float64], h: float, omega: float
) -> NDArray[np.complex128]:
    """What s^m e^{jωs}, m = 0, 1, 2, adds: particular solutions of (jω − A) p = …, started from rest."""
    resolvent = np.linalg.inv(1j * omega * np.eye(len(A)) - A)
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
