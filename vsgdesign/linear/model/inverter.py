"""One sample of an inverter of any kind with its derivative, for the map of a plant."""

from __future__ import annotations

import functools

import casadi as ca

from vsgdesign.equations.controller import Measurement
from vsgdesign.equations.grid_following import SetPoints
from vsgdesign.linear.model.full_order import ControllerMap
from vsgdesign.linear.model.power_loops import numpy_on_symbols
from vsgdesign.study.parameters.inverter_kinds import InverterKind

PARAMETERS = ("R_c", *SetPoints._fields)
"""Parameters of the map before the settings of the kind."""

_PENDING = ("pending_d", "pending_q")


@functools.cache
def inverter_map(kind: InverterKind, delay: int) -> ControllerMap:
    """The sample of a kind as :class:`vsgdesign.linear.model.full_order.ControllerMap` has it: of the six states of the
    filter and of the kind's own state, in the frame of the source. ``delay``: 0 or 1 samples."""
    own: tuple[str, ...] = kind.state._fields  # type: ignore[attr-defined]
    settings: tuple[str, ...] = kind.settings._fields  # type: ignore[attr-defined]
    names = (*own, *(_PENDING if delay else ()))
    z = ca.SX.sym("z", 6 + len(names))
    p = ca.SX.sym("p", len(PARAMETERS) + len(settings))
    values = ca.vertsplit(z)
    R_c, P_ref, Q_ref, *constants = ca.vertsplit(p)
    i_s, v_c, i_g = values[0:2], values[2:4], values[4:6]
    v = [v_c[k] + R_c * (i_s[k] - i_g[k]) for k in range(2)]
    with numpy_on_symbols():
        following, said = kind.sample(
            kind.state(*values[6 : 6 + len(own)]),
            Measurement(*v, *i_s, *i_g),
            SetPoints(P_ref, Q_ref),
            kind.settings(*constants),
        )
    asked = said.v_b_alpha, said.v_b_beta
    applied = values[6 + len(own) :] if delay else asked
    result = ca.vertcat(*following, *(asked if delay else ()), *applied)
    derivative = ca.densify(ca.jacobian(result, z))
    return ControllerMap(
        names,
        ca.Function("sample", [z, p], [result], {"cse": True}),
        ca.Function("sample_linear", [z, p], [result, derivative], {"cse": True}),
        angles=kind.angles,
        pairs=(*kind.pairs, *((_PENDING,) if delay else ())),
    )
