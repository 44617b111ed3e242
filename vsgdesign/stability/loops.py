"""The power loop of either model as S(jω): broken at the plant's output (P, Q) or at its input (δ, V)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.metrics.modes import partial_fractions
from vsgdesign.metrics.transfer import TransferMatrix
from vsgdesign.model.coupled import CoupledModel, coupled_model
from vsgdesign.model.full_order import INPUTS, OUTPUTS
from vsgdesign.operating_point import OperatingPoint
from vsgdesign.operating_point.full_order import FullOrderModel

if TYPE_CHECKING:
    import control

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

BREAKS = ("output", "input")
_CHUNK = 64


class SensitivityLoop(Protocol):
    """S(jω) = (I + L)⁻¹ of N cells, on a grid or at single points."""

    def on(self, omega: Array) -> Complex:
        """S (N, F, 2, 2) on a frequency grid in rad/s."""
        ...

    def at(self, cells: NDArray[np.intp], omega: Array) -> Complex:
        """S (k, 2, 2) of cells at frequencies, both (k,)."""
        ...


class ReducedLoop:
    """The loop of a CoupledModel: S = (I − J K)⁻¹ or (I − K J)⁻¹ with K solved at every frequency."""

    def __init__(self, model: CoupledModel, broken_at: str = "output") -> None:
        _check(broken_at)
        self._K = TransferMatrix(model.A_K, model.B_K, model.C_K)
        self._J = model.J
        self._at_output = broken_at == "output"

    def on(self, omega: Array) -> Complex:
        """S (N, F, 2, 2) on a frequency grid in rad/s."""
        return self._sensitivity(self._K.on(1j * omega), self._J[:, None])

    def at(self, cells: NDArray[np.intp], omega: Array) -> Complex:
        """S (k, 2, 2) of cells at frequencies, both (k,)."""
        return self._sensitivity(self._K.at(cells, 1j * omega), self._J[cells])

    def _sensitivity(self, K: Complex, J: Array) -> Complex:
        # K carries the minus sign of the feedback: I + L = I − J K.
        left, right = (J, K) if self._at_output else (K, J)
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
    point: OperatingPoint, gains: PowerLoopGains, V_g_rms: float, R: float, X: float, loop: int
) -> control.TransferFunction:
    """One power's open loop (0: P, 1: Q) with the other closed and the coupling kept, at one operating point."""
    import control

    delta, V_rms, source, R_path, X_path = (np.array([value]) for value in (point.delta, point.V_rms, V_g_rms, R, X))
    m, other = coupled_model(delta, V_rms, source, R_path, X_path, gains), 1 - loop
    A = m.A_K[0] + m.B_K[0][:, [other]] @ (m.J[0][[other]] @ m.C_K[0])
    opened = control.ss2tf(control.ss(A, m.B_K[0][:, [loop]], -m.J[0][[loop]] @ m.C_K[0], 0.0))
    if opened is None:
        raise RuntimeError("python-control gave no transfer function")  # its signature allows it
    return opened


def _check(broken_at: str) -> None:
    if broken_at not in BREAKS:
        raise ValueError(f'broken_at = "{broken_at}": must be "output" or "input"')
