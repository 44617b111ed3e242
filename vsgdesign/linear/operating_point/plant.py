"""The circuit between two instants, propagated without step-size error (:eq:`exact-step`).

Between sampling instants the circuit is linear, its bridge voltage is piecewise constant, and its source is a rotating
phasor. One step is therefore a matrix exponential. A switching edge adds its own step response, which is a short
polynomial in the remaining time, and the source adds its particular solution. If α and β are alike, they share every
real matrix, and complex numbers represent both. If they differ, the matrices are real and twice as large.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.filters import FilterGrid
from vsgdesign.linear.operating_point.plants import (
    edge_polynomials,
    exponentials,
    less_one,
    source_responses,
    state_matrices,
    transitions,
)

Array = NDArray[np.float64]


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
