"""The loops of both models as python-control systems, opened in state space: nothing of ``vsgdesign.linear.stability``.

A model that is closed through a port, x' = A x + b·u with u added to what the loop carries there (y = C x), is opened
by taking that path out again: A − b C. The loop is L = −C (sI − A_open)⁻¹ b: negative feedback, python-control's way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray

from vsgdesign.linear.model.coupled import CoupledModel
from vsgdesign.linear.model.full_order import INPUTS, OUTPUTS
from vsgdesign.linear.operating_point.full_order import FullOrderModel

Array = NDArray[np.floating[Any]]
Complex = NDArray[np.complexfloating[Any, Any]]

PORTS = {"output": (("P_meas", "Q_meas"), ("P", "Q")), "input": (("theta_cmd", "V_cmd"), ("delta", "V"))}


@dataclass(frozen=True)
class OpenLoop:
    """A 2×2 loop, open at both channels; dt 0: continuous."""

    A: Array
    b: Array
    C: Array
    dt: float

    def system(self) -> control.StateSpace:
        """L with both channels open."""
        return control.StateSpace(self.A, self.b, -self.C, np.zeros((2, 2)), self.dt)

    def channel(self, k: int) -> control.StateSpace:
        """L of one channel with the other closed."""
        other = 1 - k
        A = self.A + np.outer(self.b[:, other], self.C[other])
        return control.StateSpace(A, self.b[:, [k]], -self.C[[k]], 0.0, self.dt)

    def closed(self, factors: Array | Complex) -> Array | Complex:
        """The loop closed with a (complex) factor in each channel."""
        return self.A + (self.b * factors) @ self.C

    def growth(self, factors: Array | Complex) -> float:
        """How far the worst mode of that is beyond the limit: Re s, or (|z| − 1)/T_s."""
        modes = np.linalg.eigvals(self.closed(factors))
        return float(modes.real.max() if self.dt == 0.0 else (np.abs(modes).max() - 1.0) / self.dt)

    def sensitivity(self, omega: float) -> Complex:
        """S = (I + L)⁻¹ from L itself."""
        point = 1j * omega if self.dt == 0.0 else np.exp(1j * omega * self.dt)
        L = -self.C @ np.linalg.solve(point * np.eye(len(self.A)) - self.A, self.b)
        return np.linalg.inv(np.eye(2) + L)


def open_reduced(model: CoupledModel, cell: int, broken_at: str) -> OpenLoop:
    """The coupled model, opened where P and Q are measured or where δ and V act."""
    A_K, B_K, C_K, J = (m[cell] for m in (model.A_K, model.B_K, model.C_K, model.J))
    return OpenLoop(A_K, B_K, J @ C_K, 0.0) if broken_at == "output" else OpenLoop(A_K, B_K @ J, C_K, 0.0)


def open_full_order(model: FullOrderModel, cell: int, broken_at: str) -> OpenLoop:
    """The sampled model, opened at its measured powers or at the commanded angle and voltage."""
    into, out = PORTS[broken_at]
    b = model.B[cell][:, [INPUTS.index(name) for name in into]]
    C = model.C[cell][[OUTPUTS.index(name) for name in out]]
    return OpenLoop(model.A[cell] - b @ C, b, C, model.T_s)


def balanced(open_: OpenLoop) -> OpenLoop:
    """The same loop in other units of its states, by LAPACK's balancing: polynomials then lose fewer digits."""
    from scipy.linalg import matrix_balance

    A, T = matrix_balance(open_.A, permute=False)
    return OpenLoop(A, np.linalg.solve(T, open_.b), open_.C @ T, open_.dt)
