"""The circuit of the reference EMT: Kirchhoff's laws, and SciPy's DOP853 from one discontinuity to the next."""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from tests.oracles.network_reference import network_matrices, states
from vsgdesign.parameters import Grid, Study
from vsgdesign.parameters.network import PLAIN, Network

_RELATIVE = 1e-10
ABSOLUTE_PU = 1e-13
"""Integration tolerances; one step per restart usually does, with an error far below either."""


def circuit_matrices(study: Study, grid: Grid) -> tuple[NDArray[np.complex128], Any, Any]:
    """Kirchhoff's laws for (i_s, v_c, i_g): L_1 i_s' = v_b − R_1 i_s − v_n, C v_c' = i_s − i_g, (L_2+L_g) i_g' = …"""
    f = study.filter
    L, R = f.L_2 + grid.L_g, f.R_2 + grid.R_g
    matrix = np.array(
        [
            [-(f.R_1 + f.R_c) / f.L_1, -1.0 / f.L_1, f.R_c / f.L_1],
            [1.0 / f.C, 0.0, -1.0 / f.C],
            [f.R_c / L, 1.0 / L, -(R + f.R_c) / L],
        ],
        dtype=complex,
    )
    return matrix, np.array([1.0 / f.L_1, 0.0, 0.0], complex), np.array([0.0, 0.0, -1.0 / L], complex)


def integrate(
    x: NDArray[np.complex128], length: float, v_b: complex, source: tuple, matrices: tuple, atol: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """The circuit state after ``length`` seconds, by DOP853."""
    A, b, e, A_unequal, b_unequal, e_unequal = matrices
    peak, peak_slope, phase, omega, omega_slope, others, lines, (begin, rise) = source
    forced = b * v_b + b_unequal * complex(v_b).conjugate()

    def voltage(t: float) -> complex:
        turned = phase + t * (omega + 0.5 * omega_slope * t)
        v_g = (peak + peak_slope * t) * cmath.exp(1j * turned)
        v_g += sum(size * cmath.exp(1j * (order * turned + angle)) for order, size, angle in others)
        return v_g + begin + rise * t + sum(size * cmath.exp(1j * (own * t + angle)) for own, size, angle in lines)

    def derivative(t: float, y: NDArray[np.complex128]) -> NDArray[np.complex128]:
        return A @ y + forced + e * voltage(t)

    def unequal(t: float, y: NDArray[np.complex128]) -> NDArray[np.complex128]:
        # Real parts are the α axis, imaginary parts the β axis; the conjugate tells them apart.
        return derivative(t, y) + A_unequal @ y.conj() + e_unequal * voltage(t).conjugate()

    alike = not (A_unequal.any() or e_unequal.any())
    absolute: Any = atol  # an array, which SciPy takes and its stub does not
    solver = DOP853(derivative if alike else unequal, 0.0, x, length, rtol=_RELATIVE, atol=absolute, first_step=length)
    while solver.status == "running":
        solver.step()
    if solver.status != "finished":
        raise RuntimeError("DOP853 failed on the reference circuit")
    return solver.y


def integrate_pieces(x: NDArray[np.complex128], pieces: Sequence[tuple], atol: NDArray[np.float64]) -> Any:
    """The state after one piece after another: (length, v_b, source, matrices) each, as for :func:`integrate`.

    One step of DOP853 for every piece, all at once: the circuit is linear, so that each piece is integrated from unit
    states and from nothing, and these are put together. Where the method's own estimate of the error would reject a
    step, or the axes differ, SciPy's solver does the piece.
    """
    if len(pieces) < 3 or any(part.any() for *_, matrices in pieces for part in matrices[3:]):
        return _one_by_one(x, pieces, atol)
    h = np.array([length for length, *_ in pieces])[:, None, None]
    A = np.array([matrices[0] for *_, matrices in pieces])
    peak, peak_slope, phase, omega, omega_slope = np.array([source[:5] for _, _, source, _ in pieces]).T[:, :, None]
    t = np.array(DOP853.C) * h[:, 0]
    turned = phase + t * (omega + 0.5 * omega_slope * t)
    v_g = (peak + peak_slope * t) * np.exp(1j * turned)
    for k, (_, _, source, _) in enumerate(pieces):
        for order, size, angle in source[5]:
            v_g[k] += size * np.exp(1j * (order * turned[k] + angle))
        for own, size, angle in source[6]:
            v_g[k] += size * np.exp(1j * (own * t[k] + angle))
        v_g[k] += source[7][0] + source[7][1] * t[k]
    forced = np.array([matrices[1] * v_b for _, v_b, _, matrices in pieces])
    drive = forced[:, None] + np.array([matrices[2] for *_, matrices in pieces])[:, None] * v_g[..., None]
    n = len(x)
    start = np.broadcast_to(np.eye(n, n + 1, dtype=complex), (len(pieces), n, n + 1))
    K = np.zeros((len(_STAGES), len(pieces), n, n + 1), complex)
    y: Any = start
    for stage, weights in enumerate(_STAGES):
        if stage:
            y = start + h * np.tensordot(weights[:stage], K[:stage], 1)
        K[stage] = A @ y
        K[stage, :, :, n] += drive[:, min(stage, len(_STAGES) - 2)]
    # The last stage's y is the step's result; its slope counts in the estimate of the error, as SciPy weighs it.
    fifth, third = (np.tensordot(weights, K, 1) for weights in (DOP853.E5, DOP853.E3))
    for k, piece in enumerate(pieces):
        after = y[k, :, :n] @ x + y[k, :, n]
        scale = atol + _RELATIVE * np.maximum(np.abs(x), np.abs(after))
        e_5, e_3 = ((e[k, :, :n] @ x + e[k, :, n]) / scale for e in (fifth, third))
        squares_5, squares_3 = np.vdot(e_5, e_5).real, np.vdot(e_3, e_3).real
        whole = squares_5 + 0.01 * squares_3
        if whole > 0.0 and piece[0] * squares_5 >= math.sqrt(3.0 * whole):
            after = _one_by_one(x, [piece], atol)
        x = after
    return x


_STAGES = (*np.array(DOP853.A), np.array(DOP853.B))
"""What every stage, and the step's result after them, takes of the slopes before it."""


def _one_by_one(x: NDArray[np.complex128], pieces: Sequence[tuple], atol: NDArray[np.float64]) -> Any:
    for length, v_b, source, matrices in pieces:
        x = integrate(x, length, v_b, source, matrices, atol)
    return x


def with_beta(study: Study, grid: Grid, beta: Grid) -> tuple:
    """The circuit with one grid on the α axis and another on the β axis: means, and half the differences."""
    (A, b, e), (A_beta, _, e_beta) = circuit_matrices(study, grid), circuit_matrices(study, beta)
    return 0.5 * (A + A_beta), b, 0.5 * (e + e_beta), 0.5 * (A - A_beta), 0.0 * b, 0.5 * (e - e_beta)


class Changing:
    """The circuit over time. Where its networks change, the state jumps."""

    def __init__(self, study: Study, beta: Callable[[Grid], Grid]) -> None:
        events = sorted(study.events, key=lambda event: event.t_s)
        grids = [(0.0, study.grid), *((e.t_s, e.grid) for e in events if e.grid is not None)]
        networks = [(0.0, study.network), *((e.t_s, e.network) for e in events if e.network is not None)]
        self.instants = sorted({t for t, _ in (*grids, *networks)})
        self.with_networks = any(network != PLAIN for _, network in networks)
        self.names = ["i_s", "v_c", "i_2"]
        self.listed: list[tuple[float, tuple, Any]] = []
        shares = tuple(sorted({n.fault.at for _, n in networks if n.fault is not None} - {0.0}))
        load = any(n.load is not None for _, n in networks)
        if self.with_networks:
            self.names = states(shares, load)
        for instant in self.instants:
            grid = [g for t, g in grids if t <= instant][-1]
            network: Network = [n for t, n in networks if t <= instant][-1]
            if self.with_networks:
                self.listed.append((instant, *network_matrices(study, grid, network, shares, load)))
            else:
                self.listed.append((instant, with_beta(study, grid, beta(grid)), None))
        self.now: Any = self.listed[0][2]

    def at(self, instant: float) -> tuple:
        return [(matrices, jump) for t, matrices, jump in self.listed if t <= instant][-1]

    def begun(self, plant: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """The first state: where nothing but a grid is there, it has the current into the PCC everywhere."""
        x = np.zeros(len(self.names), complex)
        x[: len(plant)] = plant
        if len(plant) == 3:
            x[[k for k, name in enumerate(self.names) if name.startswith("i_g")]] = plant[2]
        return x

    def moved(
        self, x: NDArray[np.complex128], pieces: Sequence[tuple], atol: NDArray[np.float64], _begin: float = 0.0
    ) -> Any:
        """The state after some pieces, the first of which begins at ``_begin``, with the jumps between them."""
        if not self.with_networks:
            return integrate_pieces(x, [(*piece, matrices) for *piece, (matrices, _) in pieces], atol)
        for _, some in itertools.groupby(pieces, lambda piece: id(piece[-1][1])):
            part = list(some)
            P = part[0][-1][1]
            if P is not self.now:
                x, self.now = P[0] @ x + P[1] @ x.conj(), P
            x = integrate_pieces(x, [(*piece, matrices) for *piece, (matrices, _) in part], atol)
        return x
