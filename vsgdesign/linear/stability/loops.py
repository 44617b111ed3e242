"""Transfer matrices, the loops that are made of them, and the converter as seen from the grid.

The power loop of either model is S(jω), broken at the plant's output (P, Q) or at its input (δ, V); the paper's
decoupled loops are systems of python-control, and so is one cell of either model, whole or opened at the power loops.
The impedance follows in closed form from the sampled model, in the dq frame of the grid source, with peak components.
Current is positive into the grid, so that i = −Y v at the PCC.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.grid import FilterGrid, pcc_voltage
from vsgdesign.equations.power_flow import Lags
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.model import decoupled_loops
from vsgdesign.linear.model.coupled import INPUTS as REDUCED_INPUTS
from vsgdesign.linear.model.coupled import OUTPUTS as REDUCED_OUTPUTS
from vsgdesign.linear.model.coupled import CoupledModel, coupled_model
from vsgdesign.linear.model.full_order import INPUTS, OUTPUTS, PARAMETERS, POWER_LOOP_STATES
from vsgdesign.linear.operating_point import OperatingPoint
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.operating_point.plant import plant_step, state_matrices
from vsgdesign.metrics.modes import partial_fractions

if TYPE_CHECKING:
    import control


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


BREAKS = ("output", "input")


class SensitivityLoop(Protocol):
    """S(jω) = (I + L)⁻¹ of N cells, on a grid or at single points."""

    def on(self, omega: Array) -> Complex:
        """S (N, F, 2, 2) on a frequency grid in rad/s."""
        ...

    def at(self, cells: NDArray[np.intp], omega: Array) -> Complex:
        """S (k, 2, 2) of cells at frequencies, both (k,)."""
        ...


class ReducedLoop:
    """The loop of a CoupledModel: S = (I − G K)⁻¹ or (I − K G)⁻¹ with K solved at every frequency, and the plant G,
    too, where it is more than its Jacobian J."""

    def __init__(self, model: CoupledModel, broken_at: str = "output") -> None:
        _check(broken_at)
        self._K = TransferMatrix(model.A_K, model.B_K, model.C_K)
        self._G = TransferMatrix(model.A_p, model.B_p, model.C_p) if model.A_p.shape[1] else None
        self._J = model.J_p
        self._at_output = broken_at == "output"

    def on(self, omega: Array) -> Complex:
        """S (N, F, 2, 2) on a frequency grid in rad/s."""
        J, s = self._J[:, None], 1j * omega
        return self._sensitivity(self._K.on(s), J if self._G is None else J + self._G.on(s))

    def at(self, cells: NDArray[np.intp], omega: Array) -> Complex:
        """S (k, 2, 2) of cells at frequencies, both (k,)."""
        J, s = self._J[cells], 1j * omega
        return self._sensitivity(self._K.at(cells, s), J if self._G is None else J + self._G.at(cells, s))

    def _sensitivity(self, K: Complex, G: NDArray) -> Complex:
        # K carries the minus sign of the feedback: I + L = I − G K.
        left, right = (G, K) if self._at_output else (K, G)
        a11, a12 = _row_times(left, 0, right)
        a21, a22 = _row_times(left, 1, right)
        a11, a12, a21, a22 = 1.0 - a11, -a12, -a21, 1.0 - a22
        inverse = 1.0 / (a11 * a22 - a12 * a21)
        S = np.empty(K.shape, dtype=complex)
        S[..., 0, 0], S[..., 0, 1] = a22 * inverse, -a12 * inverse
        S[..., 1, 0], S[..., 1, 1] = -a21 * inverse, a11 * inverse
        return S


def _row_times(left: NDArray, row: int, right: NDArray) -> tuple[NDArray, NDArray]:
    """One row of a product of 2×2 matrices, without the overhead of small matrix products."""
    return (
        left[..., row, 0] * right[..., 0, 0] + left[..., row, 1] * right[..., 1, 0],
        left[..., row, 0] * right[..., 0, 1] + left[..., row, 1] * right[..., 1, 1],
    )


class FullOrderLoop:
    """The loop of a FullOrderModel: S(z) = I + C (zI − A)⁻¹ B between the ports at which the loop is broken.

    S is a sum over modes. A cell with (nearly) defective modes is solved at every frequency instead.
    """

    def __init__(self, model: FullOrderModel, broken_at: str = "output") -> None:
        _check(broken_at)
        ports = ("P_meas", "Q_meas", "P", "Q") if broken_at == "output" else ("theta_cmd", "V_cmd", "delta", "V")
        columns = [INPUTS.index(name) for name in ports[:2]]
        rows = [OUTPUTS.index(name) for name in ports[2:]]
        self._T_s = model.T_s
        self._direct = TransferMatrix(model.A, model.B[:, :, columns], model.C[:, rows])
        self._sum = partial_fractions(self._direct.A, self._direct.B, self._direct.C, model.eigen)
        self._flat = self._sum.residues.reshape(*self._sum.poles.shape, 4)

    def on(self, omega: Array) -> Complex:
        """S (N, F, 2, 2) on a frequency grid in rad/s, below the Nyquist frequency."""
        z = np.exp(1j * omega * self._T_s)
        poles, residues = self._sum.poles, self._flat
        S = np.empty((len(poles), len(omega), 2, 2), dtype=complex)
        for start in range(0, len(S), _CHUNK):
            part = slice(start, start + _CHUNK)
            factors = 1.0 / (z[None, :, None] - poles[part, None, :])
            S[part] = (factors @ residues[part]).reshape(-1, len(omega), 2, 2)
        for cell in np.flatnonzero(~self._sum.usable):
            S[cell] = self._direct.at(np.full(len(z), cell), z)
        S += np.eye(2)
        return S

    def at(self, cells: NDArray[np.intp], omega: Array) -> Complex:
        """S (k, 2, 2) of cells at frequencies, both (k,)."""
        z = np.exp(1j * omega * self._T_s)
        factors = 1.0 / (z[:, None] - self._sum.poles[cells])
        S = (factors[:, None] @ self._flat[cells]).reshape(-1, 2, 2)
        solved = ~self._sum.usable[cells]
        if solved.any():
            S[solved] = self._direct.at(cells[solved], z[solved])
        return S + np.eye(2)


def coupled_loop(
    point: OperatingPoint, gains: PowerLoopGains, V_g_rms: float, path: tuple[float, float], lags: Lags, loop: int
) -> control.TransferFunction:
    """One power's open loop (0: P, 1: Q) with the other closed and the coupling kept, at one operating point."""
    import control

    delta, V_rms, source, R_path, X_path = (np.array([value]) for value in (point.delta, point.V_rms, V_g_rms, *path))
    m, other = coupled_model(delta, V_rms, source, R_path, X_path, gains, lags=lags), 1 - loop
    A = m.A_o[0] + m.B_o[0][:, [other]] @ (m.J_o[0][[other]] @ m.C_o[0])
    opened = control.ss2tf(control.ss(A, m.B_o[0][:, [loop]], -m.J_o[0][[loop]] @ m.C_o[0], 0.0))
    if opened is None:
        raise RuntimeError("python-control gave no transfer function")  # its signature allows it
    return opened


def _check(broken_at: str) -> None:
    if broken_at not in BREAKS:
        raise ValueError(f'broken_at = "{broken_at}": must be "output" or "input"')


def output_admittance(model: FullOrderModel, cell: int, omega: Array) -> Complex:
    """dq output admittance Y (F, 2, 2) in S at the PCC, at frequencies ω (rad/s) in the dq frame.

    The converter is linearised in its steady state on its grid, and a small phasor is added to the source. The
    sampled states follow exactly from the one-period map. Between the samples, the held bridge voltage drives the
    circuit; only its component at the frequency of the perturbation is kept (:eq:`admittance`).
    """
    v, i = _port_phasors(model, cell, omega)
    return -i @ np.linalg.inv(v)


def _port_phasors(model: FullOrderModel, cell: int, omega: Array) -> tuple[Complex, Complex]:
    """v_pcc and i_g (F, 2, 2): dq phasors (rows) for a unit source phasor on d and on q (columns)."""
    p = dict(zip(PARAMETERS, model.p[cell], strict=False))
    circuit = FilterGrid(*(p[name] for name in FilterGrid._fields))
    omega_g, T_s = p["omega_g"], model.T_s
    A, b, e = state_matrices(circuit)
    transition = plant_step(circuit, T_s, omega_g, edges=False).transition
    count, n = len(omega), model.A.shape[1]
    source = _to_sequences(np.broadcast_to(np.eye(2, dtype=complex), (count, 2, 2)))

    # What the source adds to the sampled plant in one period, per sequence: frequencies ω_g ± ω in αβ.
    driven = []
    for sign, sequence in zip((1.0, -1.0), source, strict=True):
        Omega = omega_g + sign * omega
        inner = np.linalg.solve(1j * Omega[:, None, None] * np.eye(3) - A, np.broadcast_to(e[:, None], (count, 3, 1)))
        g = np.exp(1j * Omega * T_s)[:, None, None] * inner - transition @ inner
        g = g * np.exp(-1j * omega_g * T_s)
        driven.append((g if sign > 0.0 else g.conj()) @ sequence[:, None, :])
    forcing = np.zeros((count, n, 2), dtype=complex)
    forcing[:, 0:6:2], forcing[:, 1:6:2] = _from_sequences(*driven)
    states = np.linalg.solve(np.exp(1j * omega * T_s)[:, None, None] * np.eye(n) - model.A[cell], forcing)
    rows = [OUTPUTS.index("v_b_d"), OUTPUTS.index("v_b_q")]
    bridge = _to_sequences(model.C[cell, rows] @ states)

    ports = []
    for sign, v_b, v_g in zip((1.0, -1.0), bridge, source, strict=True):
        Omega = omega_g + sign * omega
        hold = np.exp(-0.5j * Omega * T_s) * np.sinc(0.5 * Omega * T_s / np.pi)
        resolvent = np.linalg.inv(1j * Omega[:, None, None] * np.eye(3) - A)
        if sign < 0.0:
            hold, resolvent = hold.conj(), resolvent.conj()
        x = resolvent @ (b[:, None] * (hold[:, None] * v_b)[:, None, :] + e[:, None] * v_g[:, None, :])
        ports.append((pcc_voltage(x[:, 0], x[:, 1], x[:, 2], v_g, circuit), x[:, 2]))
    v, i = (np.stack(_from_sequences(ports[0][k], ports[1][k]), axis=1) for k in (0, 1))
    return v, i


def _to_sequences(dq: Complex) -> tuple[Complex, Complex]:
    """Split (F, 2, m) dq phasors into the positive and the (conjugated) negative sequence of d + jq."""
    return 0.5 * (dq[:, 0] + 1j * dq[:, 1]), 0.5 * (dq[:, 0] - 1j * dq[:, 1])


def _from_sequences(positive: Complex, negative: Complex) -> tuple[Complex, Complex]:
    """Convert the two sequences back to d and q phasors."""
    return positive + negative, -1j * (positive - negative)


def grid_impedance(R_g: float, L_g: float, omega_g: float, omega: Array) -> Complex:
    """dq impedance (F, 2, 2) of an R–L grid in a frame that rotates with ω_g."""
    Z = np.empty((len(omega), 2, 2), dtype=complex)
    Z[:, 0, 0] = Z[:, 1, 1] = R_g + 1j * omega * L_g
    Z[:, 0, 1], Z[:, 1, 0] = -omega_g * L_g, omega_g * L_g
    return Z


def passivity_index(Y: Complex) -> Array:
    """Smallest eigenvalue of (Y + Yᴴ)/2 (F,), in S; negative where the converter can feed an oscillation."""
    hermitian = 0.5 * (Y + np.conj(np.swapaxes(Y, -1, -2)))
    return np.linalg.eigvalsh(hermitian)[..., 0].astype(float)


def generalised_nyquist(model: FullOrderModel, cell: int, omega: Array) -> Complex:
    """Eigenvalues (F, 2) of Z_g(jω) Y(jω), sorted into two continuous loci."""
    p = dict(zip(PARAMETERS, model.p[cell], strict=False))
    Z = grid_impedance(p["R_g"], p["L_g"], p["omega_g"], omega)
    loci = np.linalg.eigvals(Z @ output_admittance(model, cell, omega))
    for k in range(1, len(loci)):
        straight = abs(loci[k] - loci[k - 1]).sum()
        if abs(loci[k, ::-1] - loci[k - 1]).sum() < straight:
            loci[k] = loci[k, ::-1]
    return loci


def frequency_response(model: FullOrderModel, cell: int, input_: str, output: str, omega: Array) -> Complex:
    """Response (F,) of one output to one input of the sampled model. The input is held over each period."""
    column, row = INPUTS.index(input_), OUTPUTS.index(output)
    z = np.exp(1j * omega * model.T_s)
    n = model.A.shape[1]
    states = np.linalg.solve(z[:, None, None] * np.eye(n) - model.A[cell], model.B[cell, :, [column]].T.astype(complex))
    return (model.C[cell, row] @ states)[:, 0] + model.D[cell, row, column]


def network_frequency_perturbation(
    model: FullOrderModel, cell: int, omega: Array, S_rated: float, omega_n: float
) -> Complex:
    """ΔP over Δω_g in per unit of rating and of nominal frequency (F,), the ordinate of the NFP plot (:eq:`nfp`)."""
    return frequency_response(model, cell, "omega_g", "P", omega) * omega_n / S_rated


_ROUNDING_DB = 200.0
"""A gain margin beyond this is none: rounding moves a pole at s = 0 or a zero at infinity by some 1e-15 of the others,
and the loop then turns by half a turn where its gain is 1e13 or 1e-13."""


@dataclass(frozen=True)
class PowerLoops:
    """G_op and G_cl of both loops, as transfer functions in W/W and var/var."""

    P_open: control.TransferFunction
    P_closed: control.TransferFunction
    Q_open: control.TransferFunction
    Q_closed: control.TransferFunction


@dataclass(frozen=True)
class LoopMargins:
    """Classical margins of one loop; None where the loop crosses no such line."""

    gain_margin_db: float | None
    phase_margin_deg: float | None
    delay_margin_s: float | None
    crossover_rad_s: float | None


def power_loops(gains: PowerLoopGains, A: float, D: float) -> PowerLoops:
    """The decoupled loops (:eq:`decoupled-loops`; the paper's G_op and G_cl) for a Jacobian's A and D."""
    import control

    transfer = []
    for loop in decoupled_loops(gains, A, D):
        open_ = control.ss(loop.A, loop.b, loop.c, 0.0)
        transfer += [control.ss2tf(open_), control.ss2tf(control.feedback(open_, 1))]
    return PowerLoops(*transfer)


def loop_margins(open_loop: control.TransferFunction) -> LoopMargins:
    """Margins of a single loop closed with unity feedback: where it has several, the one nearest to the limit."""
    import control

    gain, phase, _, _, crossover, _ = control.stability_margins(open_loop)
    gain_db = float(20.0 * np.log10(gain))
    crosses = np.isfinite(phase) and np.isfinite(crossover) and crossover > 0.0
    return LoopMargins(
        gain_margin_db=gain_db if abs(gain_db) < _ROUNDING_DB else None,
        phase_margin_deg=float(phase) if crosses else None,
        delay_margin_s=float(np.deg2rad(phase) / crossover) if crosses else None,
        crossover_rad_s=float(crossover) if crosses else None,
    )


PARTS = ("closed", "loop", "plant", "controller")
"""The closed loop; the loop L, broken at the measured powers, for negative feedback; the plant G from the commanded
(delta, V) to (P, Q); the power loops K from (P, Q) to (delta, V), with their sign: L = −G K."""

_POWERS, _COMMANDS, _BACK = ("P", "Q"), ("delta", "V"), ("P_back", "Q_back")
_ROUNDING = 1e-9


def system_of(model: CoupledModel | FullOrderModel, part: str = "closed", cell: int = 0) -> control.StateSpace:
    """A part of PARTS of one cell of either model, with the names of its states, inputs and outputs. That of the
    sampled model is discrete with its T_s.

    Raises ValueError for another part, and InfeasibleStudyError where a limiter couples power loops and plant.
    """
    if part not in PARTS:
        raise ValueError(f'part = "{part}": must be one of {", ".join(PARTS)}')
    import control

    if isinstance(model, FullOrderModel):
        (matrices, states, inputs, outputs), step = _sampled(model, part, cell), model.T_s
    else:
        (matrices, states, inputs, outputs), step = _reduced(model, part, cell), 0.0
    names: dict[str, Any] = {"states": list(states), "inputs": list(inputs), "outputs": list(outputs)}
    return control.StateSpace(*matrices, step, name=part, **names)


def _reduced(model: CoupledModel, part: str, cell: int) -> tuple[list[Array], Any, Any, Any]:
    m, k, none = model, cell, np.zeros((2, 2))
    own = m.states[: m.A_K.shape[1]]
    if part == "closed":
        return [m.A[k], m.B[k], m.C[k], m.D[k]], m.states, REDUCED_INPUTS, REDUCED_OUTPUTS
    if part == "loop":
        return [m.A_o[k], m.B_o[k], -m.J_o[k] @ m.C_o[k], none], m.states, _POWERS, _BACK
    if part == "plant":
        return [m.A_p[k], m.B_p[k], m.C_p[k], m.J_p[k]], m.states[len(own) :], _COMMANDS, _POWERS
    return [m.A_K[k], m.B_K[k], m.C_K[k], none], own, _POWERS, _COMMANDS


def _sampled(model: FullOrderModel, part: str, cell: int) -> tuple[list[Array], Any, Any, Any]:
    A, B, C, D = (matrix[cell] for matrix in (model.A, model.B, model.C, model.D))
    if part == "closed":
        return [A, B, C, D], model.states, INPUTS, OUTPUTS
    measured, pushed = ([INPUTS.index(n) for n in names] for names in (("P_meas", "Q_meas"), ("theta_cmd", "V_cmd")))
    powers, commands = ([OUTPUTS.index(n) for n in names] for names in (_POWERS, _COMMANDS))
    # S = I + C (zI − A)⁻¹ B, so that L = S⁻¹ − I = −C (zI − A + B C)⁻¹ B.
    opened, none = A - B[:, measured] @ C[powers], np.zeros((2, 2))
    if part == "loop":
        return [opened, B[:, measured], -C[powers], none], model.states, _POWERS, _BACK
    own = np.array([name in POWER_LOOP_STATES for name in model.states])
    _check_apart(opened, A, own, [model.states.index(name) for name in _COMMANDS])
    rows = ~own if part == "plant" else own
    states = tuple(name for name, taken in zip(model.states, rows, strict=True) if taken)
    inside = opened[np.ix_(rows, rows)]
    if part == "plant":
        return [inside, B[rows][:, pushed], C[powers][:, rows], none], states, _COMMANDS, _POWERS
    return [inside, B[rows][:, measured], C[commands][:, rows], none], states, _POWERS, _COMMANDS


def _check_apart(opened: Array, closed: Array, own: NDArray[np.bool_], commands: list[int]) -> None:
    """Whether the power loops see the plant by its powers alone, and the plant them by delta and V."""
    others = own.copy()
    others[commands] = False
    for rows, columns in ((own, ~own), (~own, others)):
        left, whole = (np.abs(matrix[np.ix_(rows, columns)]) for matrix in (opened, closed))
        if np.any(left > _ROUNDING * whole.max(initial=0.0)):
            raise InfeasibleStudyError(
                "The current limiter couples the power loops to the plant, so that neither stands alone: take the "
                'whole model (part = "closed" or "loop"), or a limiter without a memory of the powers.'
            )
