"""The linear models of one cell as systems of python-control, whole or opened at the power loops."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.model.coupled import INPUTS, OUTPUTS, CoupledModel
from vsgdesign.linear.model.full_order import INPUTS as FULL_INPUTS
from vsgdesign.linear.model.full_order import OUTPUTS as FULL_OUTPUTS
from vsgdesign.linear.model.full_order import POWER_LOOP_STATES
from vsgdesign.linear.operating_point.full_order import FullOrderModel

if TYPE_CHECKING:
    import control

Array = NDArray[np.float64]

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
        return [m.A[k], m.B[k], m.C[k], m.D[k]], m.states, INPUTS, OUTPUTS
    if part == "loop":
        return [m.A_o[k], m.B_o[k], -m.J_o[k] @ m.C_o[k], none], m.states, _POWERS, _BACK
    if part == "plant":
        return [m.A_p[k], m.B_p[k], m.C_p[k], m.J_p[k]], m.states[len(own) :], _COMMANDS, _POWERS
    return [m.A_K[k], m.B_K[k], m.C_K[k], none], own, _POWERS, _COMMANDS


def _sampled(model: FullOrderModel, part: str, cell: int) -> tuple[list[Array], Any, Any, Any]:
    A, B, C, D = (matrix[cell] for matrix in (model.A, model.B, model.C, model.D))
    if part == "closed":
        return [A, B, C, D], model.states, FULL_INPUTS, FULL_OUTPUTS
    measured, pushed = (
        [FULL_INPUTS.index(n) for n in names] for names in (("P_meas", "Q_meas"), ("theta_cmd", "V_cmd"))
    )
    powers, commands = ([FULL_OUTPUTS.index(n) for n in names] for names in (_POWERS, _COMMANDS))
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
