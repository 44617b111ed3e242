"""The circuit between two instants, propagated without step-size error (:eq:`exact-step`): one, or many at once.

Between sampling instants the circuit is linear, its bridge voltage is piecewise constant, and its source is a rotating
phasor. One step is therefore a matrix exponential. A switching edge adds its own step response, which is a short
polynomial in the remaining time, and the source adds its particular solution. If α and β are alike, they share every
real matrix, and complex numbers represent both. If they differ, the matrices are real and twice as large. Of many
circuits ("lanes") the first axis of every array counts them.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsgdesign.equations.grid import FilterGrid, filter_grid_derivative
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_UNIT = np.eye(5).tolist()
_MAX_DEGREE = 64
_LEAST_TERM = 1e-17
"""A term of an edge polynomial below this share of the largest changes no sum."""
_TAYLOR_ORDER = 14
"""Truncates e^{0.5} below 1e-16."""


@dataclass(frozen=True, eq=False)
class PlantSteps:
    """Exact propagation of N circuits with equal axes, each over one interval: arrays for one axis.

    Each is what :class:`vsgdesign.linear.operating_point.plant.PlantStep` has under the same name, with the lane as the
    first axis.
    """

    h: Array
    """(N,), s."""
    transition: Array
    """(N, 3, 3)."""
    bridge: Array
    """(N, 3)."""
    edge: Array
    """(N, degree + 1, 3). Lanes that need a lower degree have zeros above it. Lanes that are too stiff have NaN."""
    source: Complex
    """(N, 3, 3): of each lane the order m = 0, 1, 2 of the source c·s^m·e^{jωs}, then the state."""


def plant_steps(
    study: Study, R_g: ArrayLike, L_g: ArrayLike, h: ArrayLike, omega: ArrayLike, edges: bool = False
) -> PlantSteps:
    """The steps of a study's filter on N grids (R_g in Ω, L_g in H) over intervals h (s), for sources of the angular
    frequency omega (rad/s).

    The four arrays broadcast to (N,). Without ``edges`` the edge polynomial is empty: an averaged bridge has no edges.
    """
    given = [np.asarray(value, dtype=float) for value in (R_g, L_g, h, omega)]
    count = max(value.size for value in given)
    if count == 1:
        R, L, *of_interval = (value.item() for value in given)
        return _steps_alone(study.circuit()._replace(R_g=R, L_g=L), *of_interval, edges)
    R_g, L_g, h, omega = (np.full(count, value) for value in given)
    return _steps(study.circuit()._replace(R_g=R_g, L_g=L_g), h, omega, edges)


@functools.lru_cache(maxsize=64)
def _steps_alone(circuit: FilterGrid, h: float, omega: float, edges: bool) -> PlantSteps:
    """The step of one circuit, which the steady states of a run ask for several times. Nobody may write to it."""
    one = np.ones(1)
    found = _steps(circuit._replace(R_g=circuit.R_g * one, L_g=circuit.L_g * one), h * one, omega * one, edges)
    for values in (found.h, found.transition, found.bridge, found.edge, found.source):
        values.setflags(write=False)
    return found


def _steps(circuit: FilterGrid, h: Array, omega: Array, edges: bool) -> PlantSteps:
    """:func:`plant_steps` of circuits whose R_g and L_g are (N,), as h and omega are."""
    A, b, e = state_matrices(circuit)
    transition, bridge = transitions(A, b[..., None], h)
    edge = edge_polynomials(A, b[..., None], h)[..., 0] if edges else np.empty((len(A), 0, 3))
    source = source_responses(A, e, transition, h, omega)
    return PlantSteps(h, transition, bridge[..., 0], edge, source)


def state_matrices(circuit: FilterGrid) -> tuple[Array, Array, Array]:
    """A (3, 3), b (3) and e (3) of d(i_s, v_c, i_g)/dt = A x + b v_b + e v_g, read off the linear equation.

    If fields of the circuit are arrays of the shape (N,), the results are (N, 3, 3), (N, 3) and (N, 3).
    """
    rates = [filter_grid_derivative(u[0], u[1], u[2], u[3], u[4], circuit) for u in _UNIT]
    shape = max((np.shape(value) for value in circuit), key=len)
    matrix = np.empty((*shape, 3, 5)) if shape else np.array(rates, dtype=float).T
    if shape:
        for column, entries in enumerate(rates):
            for row, rate in enumerate(entries):
                matrix[..., row, column] = rate
    return matrix[..., :3].copy(), matrix[..., 3].copy(), matrix[..., 4].copy()


def transitions(A: Array, inputs: Array, h: ArrayLike) -> tuple[Array, Array]:
    """Φ(h) (N, n, n) and ∫₀ʰ Φ(s) B ds (N, n, m) of A (N, n, n) and B (N, n, m), from one exponential.

    A may be singular (no resistance anywhere). h is a number or (N,).
    """
    n, m = inputs.shape[-2:]
    h = np.asarray(h)[..., None, None]
    augmented = np.zeros((len(A), n + m, n + m))
    augmented[:, :n, :n] = A * h
    augmented[:, :n, n:] = inputs * h
    result = exponentials(augmented)
    return result[:, :n, :n].copy(), result[:, :n, n:].copy()


def exponentials(M: Array) -> Array:
    """e^M of small matrices (N, m, m) by Taylor series of M/2^k, squared k times.

    SciPy's general routine costs the same alone and up to a thousand times more when its threads meet a busy
    machine; a run needs one for every stretch of a ramp, a map one for every cell.
    """
    norms = np.abs(M).sum(axis=1).max(axis=1)
    # k is the least one that brings the norm to a half: log2 of twice the norm, rounded up.
    mantissa, exponent = np.frexp(2.0 * norms)
    squarings = np.maximum(exponent - (mantissa == 0.5), 0)
    if len(squarings) == 0 or (squarings == squarings[0]).all():
        return _squared_series(M, int(squarings[0]) if len(squarings) else 0)
    result = np.empty_like(M)
    for k in np.unique(squarings):
        some = np.flatnonzero(squarings == k)
        result[some] = _squared_series(M[some], int(k))
    return result


def _squared_series(M: Array, squarings: int) -> Array:
    scaled = M / 2.0**squarings
    identity = np.eye(M.shape[-1])
    result = identity
    for k in range(_TAYLOR_ORDER, 0, -1):
        result = identity + scaled @ result / k
    for _ in range(squarings):
        result = result @ result
    return result


def less_one(M: Array) -> Array:
    """e^M − 1 of one matrix, by the same series, squared as (1 + F)² − 1 = 2F + F² (:eq:`less-one`): slow modes keep
    all their digits beside fast ones, which takes many squarings."""
    squarings = max(math.ceil(math.log2(max(2.0 * float(np.abs(M).sum(axis=0).max()), 1.0))), 0)
    scaled = M / 2.0**squarings
    identity = np.eye(len(M))
    series = identity
    for k in range(_TAYLOR_ORDER, 1, -1):
        series = identity + scaled @ series / k
    grown = scaled @ series
    for _ in range(squarings):
        grown = 2.0 * grown + grown @ grown
    return grown


def edge_polynomials(A: Array, inputs: Array, h: ArrayLike) -> Array:
    """Polynomials (N, degree + 1, n, m) in x = 2τ/h − 1 for ∫₀^τ Φ(s) B ds, to the last bit that matters over
    0 ≤ τ ≤ h: the Taylor series about τ = h/2, economised.

    The result is NaN if the series does not converge, because the fastest mode of the lane decays many times within h.
    """
    half = 0.5 * np.asarray(h)
    transition, middle = transitions(A, inputs, half)
    half = half[..., None, None]
    coefficients, largest = [middle], np.abs(middle)
    term = transition @ inputs * half
    active, degree = np.ones(len(A), dtype=bool), 0
    for k in range(1, _MAX_DEGREE):
        coefficients.append(np.where(active[:, None, None], term, 0.0))
        largest = np.maximum(largest, np.abs(term))
        if k > 2:
            small = active & (np.abs(term) <= _LEAST_TERM * largest).all(axis=(-2, -1))
            if small.any():
                active, degree = active & ~small, k
            if not active.any():
                break
        term = A @ term * (half / (k + 1))
    series = np.stack(coefficients[: degree + 1], axis=1)
    series[active] = 0.0
    result = _economised(series)
    result[active] = np.nan
    return result


def _economised(series: Array) -> Array:
    """The series (N, degree + 1, n, m) as a polynomial of the lowest degree that is as good for −1 ≤ x ≤ 1
    (:eq:`economised`): its Chebyshev series without the terms that no longer change the sum."""
    to_chebyshev, back = _bases(series.shape[1])
    found = _changed(to_chebyshev, series)
    matters = (np.abs(found) > _LEAST_TERM * np.abs(series).max(axis=1, keepdims=True)).any(axis=(2, 3))
    # A lane keeps the terms up to its own last one, whatever the others keep.
    kept = np.logical_or.accumulate(matters[:, ::-1], axis=1)[:, ::-1]
    degree = int(np.max(np.flatnonzero(kept.any(axis=0)), initial=0))
    return _changed(back, np.where(kept[:, :, None, None], found, 0.0))[:, : degree + 1]


def _changed(matrix: Array, coefficients: Array) -> Array:
    """Coefficients (N, degree + 1, n, m) in another basis, term by term: lanes do not change each other's bits."""
    found = np.zeros_like(coefficients)
    for k in range(coefficients.shape[1]):
        found += matrix[:, k, None, None] * coefficients[:, k : k + 1]
    return found


@functools.cache
def _bases(count: int) -> tuple[Array, Array]:
    """The first powers of x in Chebyshev polynomials, and these in powers of x: each (count, count)."""
    unit = np.eye(count)
    to_chebyshev, back = np.zeros((count, count)), np.zeros((count, count))
    for k in range(count):
        to_chebyshev[: k + 1, k] = np.polynomial.chebyshev.poly2cheb(unit[k, : k + 1])
        back[: k + 1, k] = np.polynomial.chebyshev.cheb2poly(unit[k, : k + 1])
    return to_chebyshev, back


def source_responses(A: Array, e: Array, transition: Array, h: ArrayLike, omega: ArrayLike) -> Complex:
    """What s^m e^{jωs}, m = 0, 1, 2, adds over h (N, 3, n): particular solutions of (jω − A) p = e…, started from rest.

    e is (N, n); h and omega are numbers or (N,).
    """
    h, omega = np.asarray(h), np.asarray(omega)
    resolvent = np.linalg.inv((1j * omega)[..., None, None] * np.eye(A.shape[-1]) - A)
    p0 = resolvent @ e.astype(complex)[..., None]
    q = resolvent @ p0
    r = resolvent @ q
    turn = np.exp(1j * omega * h)[..., None, None]
    h = h[..., None, None]
    # s·e^{jωs}: (p0 s − q) e^{jωs};  s²·e^{jωs}: (p0 s² − 2 q s + 2 r) e^{jωs}.
    responses: tuple[Any, ...] = (
        p0 * turn - transition @ p0,
        (p0 * h - q) * turn + transition @ q,
        (p0 * h * h - 2.0 * q * h + 2.0 * r) * turn - transition @ (2.0 * r),
    )
    return np.concatenate(responses, axis=-1).swapaxes(-1, -2)


@dataclass(frozen=True, eq=False)
class TwoAxisCircuit:
    """A linear circuit whose axes may differ: dx/dt = A x + B (v_b,α, v_b,β) + E (v_g,α, v_g,β), SI, peak.

    x has 2n entries, α and β in turn. The first three pairs are i_s, v_c and i_g, which the sensors measure. Other
    states may follow, and they are the same in every circuit of a run.
    """

    A: NDArray[np.float64]
    """2n×2n, 1/s."""
    B: NDArray[np.float64]
    E: NDArray[np.float64]
    """2n×2."""
    onto: NDArray[np.float64] | None = None
    """2n×2n: the factor that makes the states of this circuit from those before it. It does not change states that are
    possible in this circuit. None: all values are possible."""


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

    For a :class:`FilterGrid` the arrays belong to one axis, since both are alike: n = 3, and there is no last dimension
    for the axis of an input. For a :class:`TwoAxisCircuit` they belong to both axes, with 2n in place of n.
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
    """What a source c·s^m·e^{jωs} adds over the interval, m = 0, 1, 2 (:eq:`source-response`): complex 3×n, to be
    multiplied by c; or real 3×2n×2, to be multiplied by (Re c, Im c) (:eq:`two-axes`)."""


def plant_step(circuit: FilterGrid | TwoAxisCircuit, h: float, omega: float, *, edges: bool = True) -> PlantStep:
    """Matrices of :class:`PlantStep` for a circuit, an interval h (s) and a source frequency (rad/s).

    ``edges=False`` leaves the edge polynomial empty: an averaged bridge has no edges.
    """
    if isinstance(circuit, TwoAxisCircuit) and circuit.onto is not None:
        return _stiff_step(circuit, circuit.onto, h, omega, edges=edges)
    equal = isinstance(circuit, FilterGrid)
    if equal:
        A, b, e, transition, bridge = _moved_by(circuit, h)
    else:
        A, b, e = circuit.A, circuit.B, circuit.E
        transition, bridge = transitions(A[None], b[None], h)
    stacked, inputs = A[None], b.reshape(1, len(A), -1)
    edge = edge_polynomials(stacked, inputs, h)[0] if edges else np.empty((0, *inputs.shape[1:]))
    if equal:
        source = source_responses(stacked, e[None], transition, h, omega)[0]
    else:
        alpha, beta = (source_responses(stacked, e[None, :, axis], transition, h, omega)[0] for axis in range(2))
        # (:eq:`two-axes`): c = 1 is cos on α and sin on β; c = j is −sin on α and cos on β.
        source = np.stack([alpha.real + beta.imag, beta.real - alpha.imag], axis=-1)
    return PlantStep(h, transition[0], bridge[0].reshape(b.shape), edge.reshape(len(edge), *b.shape), source)


def sources_of_grid(circuit: FilterGrid, h: float, omega: Sequence[float]) -> NDArray[Any]:
    """``source`` of :class:`PlantStep` at several frequencies (rad/s), complex (N, 3, n)."""
    A, _, e, transition, _ = _moved_by(circuit, h)
    return source_responses(A[None], e[None], transition, h, np.array(omega))


@functools.lru_cache(maxsize=64)
def _moved_by(circuit: FilterGrid, h: float) -> tuple[Array, Array, Array, Array, Array]:
    """A, b and e of a circuit, and both of :func:`transitions`: they are the same for every frequency of a ramp, and
    nobody may write to them."""
    A, b, e = state_matrices(circuit)
    found = A, b, e, *transitions(A[None], b[None, :, None], h)
    for one in found:
        one.setflags(write=False)
    return found


def _stiff_step(
    circuit: TwoAxisCircuit, onto: NDArray[np.float64], h: float, omega: float, *, edges: bool
) -> PlantStep:
    """The step of a circuit whose fast modes may die out many times within h (:eq:`less-one`): a small resistance of a
    fault across a capacitor, or a large one of a load behind an inductor."""
    n = len(circuit.A)
    # States, bridge, and three pairs for the source. The first drives the circuit; the second drives the first, so that
    # it makes (s/h) e^{jωs} of it; the third drives the second, so that it makes (s/h)² e^{jωs} of the first.
    M = np.zeros((n + 8, n + 8))
    M[:n, :n], M[:n, n : n + 2], M[:n, n + 2 : n + 4] = circuit.A, circuit.B, circuit.E
    turn = np.array([[0.0, -omega], [omega, 0.0]])
    for m in range(3):
        at = n + 2 + 2 * m
        M[at : at + 2, at : at + 2] = turn
    M[n + 2 : n + 4, n + 4 : n + 6] = np.eye(2) / h
    M[n + 4 : n + 6, n + 6 : n + 8] = 2.0 * np.eye(2) / h
    grown = less_one(M * h)
    source = np.stack([grown[:n, n + 2 + 2 * m : n + 4 + 2 * m] * h**m for m in range(3)])
    edge = np.empty((0, n, 2))
    if edges:
        with np.errstate(over="ignore", invalid="ignore"):  # of a circuit too stiff to switch: NaN
            edge = edge_polynomials(circuit.A[None], circuit.B[None], h)[0]
    return PlantStep(h, onto + grown[:n, :n] @ onto, grown[:n, n : n + 2], edge, source)


def straight_line_responses(circuit: FilterGrid | TwoAxisCircuit, h: float) -> NDArray[np.float64]:
    """What a source v + s·t adds over an interval h (s): real (4, 2n), for v_α, v_β, s_α and s_β (:eq:`replay`)."""
    full = two_axes(circuit)
    size = len(full.A)
    augmented = np.zeros((size + 4, size + 4))  # of x, v and s: v is the integral of s
    augmented[:size, :size] = full.A * h
    augmented[:size, size : size + 2] = full.E * h
    augmented[size : size + 2, size + 2 :] = np.eye(2) * h
    if full.onto is not None:
        return less_one(augmented)[:size, size:].T.copy()
    return exponentials(augmented[None])[0][:size, size:].T.copy()


def averaged_steps(circuits: Sequence[FilterGrid], h: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Φ(h) (G, n, n) and ∫Φ b (G, n) of many circuits: transition and bridge of :class:`PlantStep`, to the bit."""
    A, b, _ = state_matrices(FilterGrid(*np.array(circuits, dtype=float).T))
    transition, bridge = transitions(A, b[..., None], h)
    return transition, bridge[..., 0]
