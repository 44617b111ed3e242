"""Modes and margins of the coupled reduced model, for any number of cells at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.margins import SensitivityAt
from vsgdesign.metrics.rational import RationalMatrix, transfer_matrix
from vsgdesign.model.coupled import CoupledModel

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


class ReducedLoop:
    """The loop of a CoupledModel as S(jω), broken at the plant's output (P, Q) or its input (δ, V)."""

    def __init__(self, model: CoupledModel, at: str = "output") -> None:
        if at not in ("output", "input"):
            raise ValueError(f'at = "{at}": must be "output" or "input"')
        self._K: RationalMatrix = transfer_matrix(model.A_K, model.B_K, model.C_K)
        self._J = model.J
        self._at_output = at == "output"

    def on(self, omega: Array) -> Complex:
        """S (N, F, 2, 2) on a frequency grid in rad/s."""
        return self._sensitivity(self._K.on(1j * omega), self._J[:, None])

    def at(self, cells: NDArray[np.intp], omega: Array) -> Complex:
        """S (k, 2, 2) of cells at frequencies, both (k,)."""
        return self._sensitivity(self._K.at(cells, 1j * omega), self._J[cells])

    def _sensitivity(self, K: Complex, J: Array) -> Complex:
        # K already carries the minus sign of the feedback: I + L = I − J K.
        if self._at_output:
            a11, a12 = _row_times(J, 0, K)
            a21, a22 = _row_times(J, 1, K)
        else:
            a11, a12 = _row_times(K, 0, J)
            a21, a22 = _row_times(K, 1, J)
        a11, a12, a21, a22 = 1.0 - a11, -a12, -a21, 1.0 - a22
        inverse = 1.0 / (a11 * a22 - a12 * a21)
        S = np.empty(K.shape, dtype=complex)
        S[..., 0, 0], S[..., 0, 1] = a22 * inverse, -a12 * inverse
        S[..., 1, 0], S[..., 1, 1] = -a21 * inverse, a11 * inverse
        return S


def _row_times(left: NDArray, row: int, right: NDArray) -> tuple[NDArray, NDArray]:
    """One row of a product of 2×2 matrices, without the overhead of tiny matmuls."""
    return (
        left[..., row, 0] * right[..., 0, 0] + left[..., row, 1] * right[..., 1, 0],
        left[..., row, 0] * right[..., 0, 1] + left[..., row, 1] * right[..., 1, 1],
    )


def sensitivity_at(loop: ReducedLoop) -> SensitivityAt:
    """The loop's S as a plain function."""
    return loop.at
