"""Power flow and its Jacobian A–D by automatic differentiation of the one equation."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_flow import dQ_dV_as_published, power_flow
from vsgdesign.model.tracing import numpy_on_symbols


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
