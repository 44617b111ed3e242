"""The dc link of a unit from one of its samples to the next with its derivative, for the map of a plant."""

from __future__ import annotations

import functools
from typing import NamedTuple

import casadi as ca

from vsgdesign.linear.model.dc_link import LinkInModel
from vsgdesign.linear.model.power_loops import numpy_on_symbols


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
