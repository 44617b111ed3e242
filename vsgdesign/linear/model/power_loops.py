"""The paper's two decoupled power loops, and power flow with its Jacobian A–D, each differentiated from one equation.

CasADi runs the plain NumPy equations on its symbols.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_flow import dQ_dV_as_published, power_flow
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops

_ONE_AT_A_TIME = threading.RLock()
"""CasADi's mode belongs to the whole process: another thread would put it back in the middle of this one's block."""


@contextmanager
def numpy_on_symbols() -> Iterator[None]:
    """Within this block ``np.sin(SX)`` and friends build CasADi expressions. The global mode is put back.

    Another thread that comes to such a block waits until this one has left it.
    """
    with _ONE_AT_A_TIME:
        before = ca.GlobalOptions.getNumpyMode()
        ca.GlobalOptions.setNumpyMode(1)
        try:
            yield
        finally:
            ca.GlobalOptions.setNumpyMode(before)


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


@functools.cache
def power_flow_function() -> ca.Function:
    """(delta, V_rms, V_g_rms, R, X) → (P, Q, J) with J = [[A, B], [C, D]] (:eq:`jacobian`)."""
    names = ["delta", "V_rms", "V_g_rms", "R", "X"]
    symbols = [ca.SX.sym(name) for name in names]
    with numpy_on_symbols():
        P, Q = power_flow(*symbols)
    J = ca.jacobian(ca.vertcat(P, Q), ca.vertcat(symbols[0], symbols[1]))
    return ca.Function("power_flow", symbols, [P, Q, J], names, ["P", "Q", "J"])


def jacobian(
    delta: float, V_rms: float, V_g_rms: float, R: float, X: float, form: str = "exact"
) -> NDArray[np.float64]:
    """[[A, B], [C, D]] at an operating point, W/rad, W/V, var/rad, var/V (V phase rms).

    ``form="published"`` puts the paper's printed expression in the place of D: that is C = ∂Q/∂δ again,
    not ∂Q/∂V, and serves comparison only.
    """
    if form not in ("exact", "published"):
        raise ValueError(f'form = "{form}": must be "exact" or "published"')
    J = np.array(power_flow_function()(delta, V_rms, V_g_rms, R, X)[2])
    if form == "published":
        J[1, 1] = float(dQ_dV_as_published(delta, V_rms, V_g_rms, R, X))
    return J
