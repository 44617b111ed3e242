"""The circuit of the reference EMT: Kirchhoff's laws, and SciPy's DOP853 from one discontinuity to the next."""

from __future__ import annotations

import cmath
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

from tests.oracles.network_reference import network_matrices, states
from vsgdesign.study.parameters import Grid, Study
from vsgdesign.study.parameters.grid import PLAIN, Network

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


class Powers:
    """What a step of DOP853 needs of a circuit dx/dt = A x + A' x* + b v_b + b' v_b* + e v_g + e' v_g*.

    The circuit is linear, so that a step of length h from x with the source's voltages g at the stages is a polynomial:
    h w·K = Σ_j h^{j+1} A^j (w a^j) (A x + b v_b + e g), for weights w of the slopes K in the tableau a. Where the axes
    differ, the state is x and x* together.
    """

    def __init__(self, matrices: tuple) -> None:
        A, b, e, A_unequal, b_unequal, e_unequal = self.matrices = matrices
        self.alike = not (A_unequal.any() or b_unequal.any() or e_unequal.any())
        inputs = [b, e]
        if not self.alike:
            A = np.block([[A, A_unequal], [A_unequal.conj(), A.conj()]])
            inputs = [np.concatenate([b, b_unequal.conj()]), np.concatenate([e, e_unequal.conj()])]
            inputs += [np.concatenate([b_unequal, b.conj()]), np.concatenate([e_unequal, e.conj()])]
        self.n = len(A)
        powers = [np.eye(self.n, dtype=complex)]
        for _ in range(len(_TABLEAU)):
            powers.append(A @ powers[-1])
        self.of_state = np.array(powers[1:]).reshape(-1, self.n**2)
        self.of_inputs = [np.array([power @ one for power in powers[:-1]]) for one in inputs]


def integrate_pieces(
    x: NDArray[np.complex128], pieces: Sequence[tuple], circuit: Powers, atol: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """The state after one piece after another: (length, v_b, source) each, as for :func:`integrate`.

    One step of DOP853 for every piece, all at once. Where the method's own estimate of the error would reject a step,
    SciPy's solver does the piece.
    """
    h = np.array([length for length, *_ in pieces])
    v_g = _stage_voltages(h, [source for *_, source in pieces])
    v_b = np.array([v for _, v, _ in pieces])
    powers = h[:, None, None] ** _EXPONENTS
    whole = powers * _SUMS  # (pieces, weights, j)
    drives = [whole * v_b[:, None, None], powers * (v_g @ _WEIGHTS).reshape(len(h), 3, -1)]
    if not circuit.alike:
        drives += [drive.conj() for drive in drives]
    forced: Any = sum(drive @ of for drive, of in zip(drives, circuit.of_inputs, strict=True))
    moving = (whole @ circuit.of_state).reshape(len(h), 3, circuit.n, circuit.n)
    n, states = len(x), [x if circuit.alike else np.concatenate([x, x.conj()])]
    for move, push in zip(moving[:, 0], forced[:, 0], strict=True):
        states.append(states[-1] + move @ states[-1] + push)
    before = np.array(states[:-1])
    sizes = np.abs(np.array(states)[:, :n])
    errors = (moving[:, 1:, :n] @ before[:, None, :, None])[..., 0] + forced[:, 1:, :n]
    errors /= (atol + _RELATIVE * np.maximum(sizes[:-1], sizes[1:]))[:, None]
    fifth, third = np.sum(errors.real**2 + errors.imag**2, axis=2).T
    # SciPy's rule, as in DOP853._estimate_error_norm; h is in the errors already.
    rejected = fifth >= np.sqrt(n * (fifth + 0.01 * third))
    rejected &= fifth + third > 0.0
    if not rejected.any():
        return states[-1][:n]
    first = int(np.argmax(rejected))
    length, v, source = pieces[first]
    x = integrate(states[first][:n], length, v, source, circuit.matrices, atol)
    return integrate_pieces(x, pieces[first + 1 :], circuit, atol) if first + 1 < len(pieces) else x


def _stage_voltages(h: NDArray[np.float64], sources: Sequence[tuple]) -> NDArray[np.complex128]:
    """v_g at the stages of every piece, (pieces, stages)."""
    t = h[:, None] * _STAGES
    peak, peak_slope, phase, omega, omega_slope = np.array([source[:5] for source in sources]).T[:, :, None]
    turned = phase + t * (omega + 0.5 * omega_slope * t)
    v_g = (peak + peak_slope * t) * np.exp(1j * turned)
    for k, (*_, others, lines, (begin, rise)) in enumerate(sources):
        for order, size, angle in others:
            v_g[k] += size * np.exp(1j * (order * turned[k] + angle))
        for own, size, angle in lines:
            v_g[k] += size * np.exp(1j * (own * t[k] + angle))
        if begin or rise:
            v_g[k] += begin + rise * t[k]
    return v_g


_STAGES = np.array([*DOP853.C, 1.0])
_TABLEAU = np.zeros((13, 13))
_TABLEAU[:12, :12], _TABLEAU[12, :12] = DOP853.A, DOP853.B
"""The twelve stages, and the slope at the step's end, which counts in the estimate of the error alone."""

_WEIGHTS = np.array(
    [
        np.array([[*DOP853.B, 0.0], DOP853.E5, DOP853.E3]) @ np.linalg.matrix_power(_TABLEAU, j)
        for j in range(len(_TABLEAU))
    ]
)
_SUMS = _WEIGHTS.sum(axis=2).T
_WEIGHTS = _WEIGHTS.transpose(2, 1, 0).reshape(len(_TABLEAU), -1)
"""w a^j of the step and of the two estimates of its error: (stage, weights × j), and their sums (weights, j)."""
_EXPONENTS = np.arange(1, len(_TABLEAU) + 1)


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
        self._powers: dict[int, Powers] = {}

    def at(self, instant: float) -> tuple:
        return [(matrices, jump) for t, matrices, jump in self.listed if t <= instant][-1]

    def begun(self, plant: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """The first state: where nothing but a grid is there, it has the current into the PCC everywhere."""
        x = np.zeros(len(self.names), complex)
        x[: len(plant)] = plant
        if len(plant) == 3:
            x[[k for k, name in enumerate(self.names) if name.startswith("i_g")]] = plant[2]
        return x

    def bridge_limit(self, before: float) -> float:
        """The largest voltage that the bridge makes at a sample: that of an ideal dc link stays."""
        return before

    def modulating(self, study: Study) -> Study:
        """The study with the voltage by which the modulation divides in a sample."""
        return study

    def acting(self, asked: complex) -> complex:
        """What acts of a voltage that the controller asked for."""
        return asked

    def moved(
        self, x: NDArray[np.complex128], pieces: Sequence[tuple], atol: NDArray[np.float64], _begin: float = 0.0
    ) -> Any:
        """The state after some pieces, the first of which begins at ``_begin``, with the jumps between them."""
        for _, some in itertools.groupby(pieces, lambda piece: id(piece[-1][0])):
            part = list(some)
            matrices, P = part[0][-1]
            if P is not None and P is not self.now:
                x, self.now = P[0] @ x + P[1] @ x.conj(), P
            x = integrate_pieces(x, [piece[:-1] for piece in part], self._powers_of(matrices), atol)
        return x

    def _powers_of(self, matrices: tuple) -> Powers:
        """Kept with the matrices, so that their identity stays theirs."""
        if id(matrices) not in self._powers:
            self._powers[id(matrices)] = Powers(matrices)
        return self._powers[id(matrices)]
