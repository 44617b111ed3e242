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

from vsgdesign.codegen.operation_list import OperationList
from vsgdesign.equations.power_flow import Lags, current_of_power, power_flow, yielding_plant
from vsgdesign.equations.power_loops import PowerLoopGains, References, power_loops
from vsgdesign.linear.model.compiled import list_of
from vsgdesign.linear.model.power_loops import numpy_on_symbols

Array = NDArray[np.float64]

INPUTS = ("P_ref", "Q_ref", "omega_g", "V_g")
OUTPUTS = ("P", "Q", "omega", "V")


@dataclass(frozen=True)
class CoupledModel:
    """Linear model of N cells, ẋ = A x + B u, y = C x + D u (:eq:`coupled-model`).

    ``states`` names x: delta, omega_i, V, then P_f and Q_f where the power filters have a time constant, then i_f_d and
    i_f_q with a transient impedance. Inputs are INPUTS, outputs OUTPUTS, in W, var, rad, rad/s and phase rms V. The
    loop itself is K, from measured (P, Q) to (δ, V), K(s) = C_K (sI − A_K)⁻¹ B_K, against the plant
    G(s) = J_p + C_p (sI − A_p)⁻¹ B_p, whose value at rest is the Jacobian J. Without a transient impedance the plant is
    J alone, and A_p has no row. A_o, B_o, C_o and J_o make the loop G K, opened at the powers:
    J_o C_o (sI − A_o)⁻¹ B_o.
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
    A_p: Array
    B_p: Array
    C_p: Array
    J_p: Array
    A_o: Array
    B_o: Array
    C_o: Array
    J_o: Array


PLANT = ("delta", "V", "V_g", "R", "X")


@functools.cache
def coupled_function(filter_P: bool, filter_Q: bool, coupling: bool = True, yields: bool = False) -> ca.Function:
    """(PLANT, PowerLoopGains, Lags) → the matrices of one cell in the order of CoupledModel, dense, for numbers or
    symbols; without a transient impedance the first eight, of which the others are copies.

    ``filter_P``, ``filter_Q``: whether that power filter is a state; its time constant is unused where it is not.
    ``yields``: whether there is a transient impedance.
    """
    delta, V, V_g, R, X = plant = [ca.SX.sym(name) for name in PLANT]
    gains = PowerLoopGains(*(ca.SX.sym(name) for name in PowerLoopGains._fields))
    lags = Lags(*(ca.SX.sym(name) for name in Lags._fields))
    omega_i, P, Q = ca.SX.sym("omega_i"), ca.SX.sym("P"), ca.SX.sym("Q")
    refs = References(*(ca.SX.sym(name) for name in References._fields))
    with numpy_on_symbols():
        powers = ca.vertcat(*power_flow(delta, V, V_g, R, X))
        rates = ca.vertcat(*power_loops(omega_i, V, P, Q, refs, gains))
    J, of_V_g = ca.jacobian(powers, ca.vertcat(delta, V)), ca.jacobian(powers, V_g)
    if not coupling:
        J = J * ca.SX(np.eye(2))
    of_states = ca.jacobian(rates, ca.vertcat(omega_i, V))
    of_powers = ca.jacobian(rates, ca.vertcat(P, Q))
    of_refs = ca.jacobian(rates, ca.vertcat(refs.P_ref, refs.Q_ref))

    # The controller, open at the measurement: δ̇ = ω − ω_g, then dω_i/dt and dV/dt, then the filters.
    taus = lags.tau_P, lags.tau_Q
    filters = [k for k, present in enumerate((filter_P, filter_Q)) if present]
    n = 3 + len(filters)
    A_K, B_K, C_K = ca.SX.zeros(n, n), ca.SX.zeros(n, 2), ca.SX.zeros(2, n)
    A_K[:3, 1:3] = of_states
    B_K[:3, :] = of_powers
    for k, column in enumerate(filters, start=3):
        A_K[:3, k] = B_K[:3, column]
        B_K[:3, column] = 0.0
        A_K[k, k] = -1.0 / taus[column]
        B_K[k, column] = 1.0 / taus[column]
    C_K[0, 0] = C_K[1, 2] = 1.0

    m, plant_alone = 0, []
    source = ca.SX.zeros(0, 1)
    A_o, B_o, C_o, J_o = A_K, B_K, C_K, J
    if yields:
        m = 2
        A_p, B_p, C_p, J_p = _yielding((delta, V, V_g, R, X), lags, powers)
        B_p, source, J_p, of_V_g = B_p[:, :2], B_p[:, 2], J_p[:, :2], J_p[:, 2]
        A_o = ca.blockcat([[A_K, ca.SX.zeros(n, m)], [B_p @ C_K, A_p]])
        B_o, C_o, J_o = ca.vertcat(B_K, ca.SX.zeros(m, 2)), ca.horzcat(J_p @ C_K, C_p), ca.SX.eye(2)
        plant_alone = [A_p, B_p, C_p, J_p, A_o, B_o, C_o, J_o]

    A = A_o + B_o @ J_o @ C_o
    B = ca.SX.zeros(n + m, 4)
    B[:3, :2] = of_refs
    B[0, 2] = -1.0
    B[:n, 3] = B_K @ of_V_g
    B[n:, 3] = source
    C, D = ca.SX.zeros(4, n + m), ca.SX.zeros(4, 4)
    C[:2, :] = J_o @ C_o
    D[:2, 3] = of_V_g
    # ω is the first row of the controller, before ω_g is taken off.
    C[2, :] = A[0, :]
    D[2, :2] = of_refs[0, :]
    D[2, 3] = (B_K @ of_V_g)[0]
    C[3, 2] = 1.0
    found = [A, B, C, D, A_K, B_K, C_K, J, *plant_alone]
    return ca.Function("coupled", [*plant, *gains, *lags], [ca.densify(matrix) for matrix in found])


def _yielding(cell: tuple[ca.SX, ...], lags: Lags, powers: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """A_p, B_p, C_p and J_p of the plant behind a transient impedance at rest, with inputs (δ, V, V_g).

    The capacitor's voltage is what :func:`yielding_plant` leaves of it: its derivatives are those of an implicit
    function.
    """
    delta, V, V_g, R, X = cell
    v, i_f = (ca.SX.sym(name, 2) for name in ("v", "i_f"))
    with numpy_on_symbols():
        found = yielding_plant(delta, V, v[0], v[1], i_f[0], i_f[1], V_g, R, X, lags)
    left = ca.vertcat(found.v_d, found.v_q) - v
    results = ca.vertcat(found.P, found.Q, found.di_f_d, found.di_f_q)
    inputs = ca.vertcat(i_f, delta, V, V_g)
    of_inputs = -ca.inv(ca.jacobian(left, v)) @ ca.jacobian(left, inputs)
    whole = ca.jacobian(results, inputs) + ca.jacobian(results, v) @ of_inputs
    at_rest = ca.vertcat(V, 0.0), ca.vertcat(*current_of_power(powers[0], powers[1], V, 0.0))
    whole = ca.substitute([whole], [v, i_f], list(at_rest))[0]
    return whole[2:, :2], whole[2:, 2:], whole[:2, :2], whole[:2, 2:]


def coupled_model(
    delta: float | Array,
    V_rms: float | Array,
    V_g_rms: float | Array,
    R: float | Array,
    X: float | Array,
    gains: PowerLoopGains,
    *,
    lags: Lags = Lags(),  # noqa: B008
    coupling: bool = True,
) -> CoupledModel:
    """The coupled model at N operating points (arrays of shape (N,), or scalars).

    ``lags``: time constants that are zero leave their state out. ``coupling=False`` drops B and C: the paper's two
    decoupled loops, which have no transient impedance.
    """
    yields = lags.yields and coupling
    columns = [np.atleast_1d(np.asarray(value, dtype=float)) for value in (delta, V_rms, V_g_rms, R, X, *gains, *lags)]
    inputs = np.stack(np.broadcast_arrays(*columns), axis=1)
    count = len(inputs)
    function = coupled_function(lags.tau_P > 0.0, lags.tau_Q > 0.0, coupling, yields)
    names = ("P_f",) * (lags.tau_P > 0.0) + ("Q_f",) * (lags.tau_Q > 0.0) + ("i_f_d", "i_f_q") * yields
    listed, shapes = _packed(function)
    values = listed.of_points(inputs)
    matrices, start = [], 0
    for rows, cols in shapes:
        part = values[:, start : start + rows * cols]
        matrices.append(np.ascontiguousarray(part).reshape(count, rows, cols))
        start += rows * cols
    if not yields:
        none = np.zeros((count, 0, 0)), np.zeros((count, 0, 2)), np.zeros((count, 2, 0))
        matrices += [*none, matrices[7], *matrices[4:8]]
    return CoupledModel(("delta", "omega_i", "V", *names), *matrices)


@functools.cache
def _packed(function: ca.Function) -> tuple[OperationList, list[tuple[int, int]]]:
    """The function with one column in and one out (matrices row by row), and the matrices' shapes."""
    column = ca.SX.sym("column", function.n_in())
    outputs = function.call(ca.vertsplit(column))
    shapes = [out.shape for out in outputs]
    packed = ca.Function("packed", [column], [ca.vertcat(*(ca.vec(out.T) for out in outputs))])
    return list_of(packed), shapes
