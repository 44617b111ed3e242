"""One sample of an inverter of any kind, and of the dc link of a unit, with its derivative: for the map of a plant."""

from __future__ import annotations

import functools
from typing import NamedTuple

import casadi as ca

from vsgdesign.equations.controller import Measurement
from vsgdesign.equations.grid_following import SetPoints
from vsgdesign.linear.model.dc_link import LinkInModel
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


class LinkMap(NamedTuple):
    """``linear(z, p)`` gives the states of the link at a sample and their derivative by z.

    z are these states at the sample before, ``names``; i_s, v_c and i_g of the filter then and now, 6 numbers each; and
    the bridge voltage in between, 2, all in one frame. p are the constants of the link."""

    names: tuple[str, ...]
    linear: ca.Function


@functools.cache
def link_map(link: LinkInModel) -> LinkMap:
    """The step of a link whose bridge compensates its voltage (:eq:`dc-step`)."""
    count = len(link.states)
    z, p = ca.SX.sym("z", count + 14), ca.SX.sym("p", len(link.parameters))
    values = ca.vertsplit(z)
    state = dict(zip(link.states, values, strict=False))
    before, after, v_b = (values[count + first : count + end] for first, end in ((0, 6), (6, 12), (12, 14)))
    with numpy_on_symbols():
        constants = dict(zip(link.parameters, ca.vertsplit(p), strict=True))
        found = link.following(state, constants, before, after, v_b)
    result = ca.vertcat(*(found[name] for name in link.states))
    outputs = [result, ca.densify(ca.jacobian(result, z))]
    return LinkMap(link.states, ca.Function("link", [z, p], outputs, {"cse": True}))
