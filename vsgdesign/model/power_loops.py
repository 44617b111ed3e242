"""The paper's two decoupled power loops, linearised from the power-loop equation itself."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops
from vsgdesign.model.tracing import numpy_on_symbols

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LoopMatrices:
    """One loop, open at the power measurement: ẋ = A x + b·u, y = c x, closed by u = ref − y."""

    A: Array
    b: Array
    c: Array


@functools.cache
def _linearised() -> ca.Function:
    """Jacobians of (ω, dω/dt, dV/dt) with respect to (ω_i, V), (P, Q) and (P_ref, Q_ref)."""
    omega_i, V, P, Q, P_ref, Q_ref = (ca.SX.sym(n) for n in ("omega_i", "V", "P", "Q", "P_ref", "Q_ref"))
    constants = [ca.SX.sym(n) for n in ("omega_0", "V_n")]
    gains = [ca.SX.sym(n) for n in PowerLoopGains._fields]
    with numpy_on_symbols():
        rates = power_loops(omega_i, V, P, Q, References(P_ref, Q_ref, *constants), PowerLoopGains(*gains))
    outputs = ca.vertcat(*rates)
    states, powers, refs = ca.vertcat(omega_i, V), ca.vertcat(P, Q), ca.vertcat(P_ref, Q_ref)
    derivatives = [ca.jacobian(outputs, group) for group in (states, powers, refs)]
    return ca.Function("power_loops", [states, powers, refs, *constants, *gains], derivatives)


def decoupled_loops(gains: PowerLoopGains, A: float, D: float) -> tuple[LoopMatrices, LoopMatrices]:
    """P loop (states δ, ω) and Q loop (state V) without the coupling B and C (:eq:`decoupled-loops`).

    A = ∂P/∂δ in W/rad and D = ∂Q/∂V in var/V close the loops. The loops' inputs are the power errors.
    """
    zero = np.zeros(2)
    of_states, _, of_refs = (np.array(m) for m in _linearised()(zero, zero, zero, 0.0, 0.0, *gains))
    A_P = np.array([[0.0, of_states[0, 0]], [0.0, of_states[1, 0]]])
    loop_P = LoopMatrices(A_P, np.array([[0.0], [of_refs[1, 0]]]), np.array([[A, 0.0]]))
    loop_Q = LoopMatrices(of_states[2:3, 1:2], of_refs[2:3, 1:2], np.array([[D]]))
    return loop_P, loop_Q
