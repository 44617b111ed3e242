"""The coupled small-signal model of the power loops: ideal inner loops, quasi-static grid, B and C kept.

Generated from the power-loop and power-flow equations by automatic differentiation, for any number of cells
(grids × operating points × gains) in one call. Arrays carry the cells first.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_flow import power_flow
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops
from vsgdesign.model.tracing import numpy_on_symbols

Array = NDArray[np.float64]

INPUTS = ("P_ref", "Q_ref", "omega_g", "V_g")
OUTPUTS = ("P", "Q", "omega", "V")


@dataclass(frozen=True)
class CoupledModel:
    """Linear model of N cells, ẋ = A x + B u, y = C x + D u (:eq:`coupled-model`).

    ``states`` names x: delta, omega_i, V, then P_f and Q_f where the power filters have a time constant.
    Inputs are INPUTS, outputs OUTPUTS, in W, var, rad, rad/s and phase rms V. The loop itself is K, from
    measured (P, Q) to (δ, V), against the plant's Jacobian J: K(s) = C_K (sI − A_K)⁻¹ B_K.
    """

    states: tuple[str, ...]
    A: Array
    B: Array
    C: Array
    D: Array
    A_K: Array
    B_K: Array
    C_K: Array
    J: Array


@functools.cache
def _power_flow_jacobian() -> ca.Function:
    delta, V, V_g, R, X = (ca.SX.sym(n) for n in ("delta", "V", "V_g", "R", "X"))
    with numpy_on_symbols():
        powers = ca.vertcat(*power_flow(delta, V, V_g, R, X))
    return ca.Function(
        "J", [delta, V, V_g, R, X], [ca.jacobian(powers, ca.vertcat(delta, V)), ca.jacobian(powers, V_g)]
    )


@functools.cache
def _power_loop_jacobian() -> ca.Function:
    """Derivatives of (ω, dω_i/dt, dV/dt) with respect to (ω_i, V), (P, Q), (P_ref, Q_ref)."""
    omega_i, V, P, Q, P_ref, Q_ref, omega_0, V_n = (
        ca.SX.sym(n) for n in ("omega_i", "V", "P", "Q", "P_ref", "Q_ref", "omega_0", "V_n")
    )
    gains = [ca.SX.sym(n) for n in PowerLoopGains._fields]
    with numpy_on_symbols():
        rates = power_loops(omega_i, V, P, Q, References(P_ref, Q_ref, omega_0, V_n), PowerLoopGains(*gains))
    groups = (ca.vertcat(omega_i, V), ca.vertcat(P, Q), ca.vertcat(P_ref, Q_ref))
    derivatives = [ca.jacobian(ca.vertcat(*rates), group) for group in groups]
    return ca.Function("loops", [*groups, omega_0, V_n, *gains], derivatives)


def _batched(function: ca.Function, columns: list[Array], shapes: list[tuple[int, int]]) -> list[Array]:
    """Evaluate a CasADi function for N cells at once; matrix outputs as (N, rows, columns)."""
    count = columns[0].shape[-1]
    if count == 0:
        return [np.empty((0, *shape)) for shape in shapes]
    outputs = function.map(count)(*columns)
    return [
        np.array(out).reshape(rows, count, cols).transpose(1, 0, 2)
        for out, (rows, cols) in zip(outputs, shapes, strict=True)
    ]


def coupled_model(
    delta: Array, V_rms: Array, V_g_rms: Array, R: Array, X: Array, gains: PowerLoopGains,
    *, tau_P: float = 0.0, tau_Q: float = 0.0, coupling: bool = True,
) -> CoupledModel:  # fmt: skip
    """The coupled model at N operating points (arrays of shape (N,), or scalars).

    tau_P, tau_Q: time constants of the power filters in s; zero leaves the state out. ``coupling=False`` drops
    B and C: the paper's two decoupled loops.
    """
    columns = [np.atleast_1d(np.asarray(value, dtype=float)) for value in (delta, V_rms, V_g_rms, R, X, *gains)]
    columns = [np.ascontiguousarray(column) for column in np.broadcast_arrays(*columns)]
    count = columns[0].shape[0]
    J, of_V_g = _batched(_power_flow_jacobian(), [c[None] for c in columns[:5]], [(2, 2), (2, 1)])
    if not coupling:
        J = J * np.eye(2)
    zero = np.zeros((2, count))
    of_states, of_powers, of_refs = _batched(
        _power_loop_jacobian(), [zero, zero, zero, zero[:1], zero[:1], *(c[None] for c in columns[5:])], [(3, 2)] * 3
    )
    filters = [("P_f", 0, tau_P), ("Q_f", 1, tau_Q)]
    filters = [entry for entry in filters if entry[2] > 0.0]
    states = ("delta", "omega_i", "V", *(name for name, _, _ in filters))
    n = len(states)

    # The controller, open at the measurement: δ̇ = ω − ω_g, then dω_i/dt and dV/dt, then the filters.
    A_K, B_K = np.zeros((count, n, n)), np.zeros((count, n, 2))
    A_K[:, :3, 1:3] = of_states
    B_K[:, :3, :] = of_powers
    for k, (_, column, tau) in enumerate(filters, start=3):
        A_K[:, :3, k] = B_K[:, :3, column]
        B_K[:, :3, column] = 0.0
        A_K[:, k, k] = -1.0 / tau
        B_K[:, k, column] = 1.0 / tau
    C_K = np.zeros((count, 2, n))
    C_K[:, 0, 0] = C_K[:, 1, 2] = 1.0

    A = A_K + B_K @ J @ C_K
    B = np.zeros((count, n, 4))
    B[:, :3, :2] = of_refs
    B[:, 0, 2] = -1.0
    B[:, :, 3:] = B_K @ of_V_g
    C, D = np.zeros((count, 4, n)), np.zeros((count, 4, 4))
    C[:, :2] = J @ C_K
    D[:, :2, 3:] = of_V_g
    # ω is the first row of the controller, before ω_g is taken off.
    C[:, 2] = A_K[:, 0] + (B_K[:, :1] @ J @ C_K)[:, 0]
    D[:, 2, :2] = of_refs[:, 0]
    D[:, 2, 3] = (B_K[:, :1] @ of_V_g)[:, 0, 0]
    C[:, 3, 2] = 1.0
    return CoupledModel(states, A, B, C, D, A_K, B_K, C_K, J)
