"""The link of a published case against its plot: CRESYM's "Grid Following - Grid Forming DC link", in which a load of
0.5 MW is switched on at the far end of a dc link.

The page's table and its plot do not fit: the table has 1.5 kV, and the plot 66 kV; its gains have no units. With 66 kV,
with both capacitors of 0.15 F, with gains that act on v² (5 W/V², 50 W/(V²s)) and with a power that follows its
reference within 22.5 ms, which is 1.5 times the page's 15 ms, all of the plot follows. A fit to the plot that knows
none of these finds 0.303 F, 5.1 W/V², 50.9 W/(V²s) and 22.6 ms, which leaves 0.0004 V of 0.77 V in the median.
"""
# ruff: noqa: ARG001 - a source is called with all of its arguments

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from vsgdesign.equations.dc_link import BridgePower, DcSettings, DcState, link_step
from vsgdesign.equations.dc_source_interface import DcFlow, DcSourceLaw, Decay, decay_of

V, C, K_P, K_I, TAU = 66e3, 2.0 * 0.15, 5.0, 50.0, 1.5 * 0.015
STEP_W = 0.488e6
"""From 0.992 to 1.480 MW in the plot of the load's power."""
PLOTTED = {"dip_V": 0.766, "at_s": 0.057, "settled_s": 0.156, "second_V": 0.033, "second_at_s": 0.270}
"""Read off the plot of 1920 x 955 points, of which one is 0.9 mV and 1.1 ms: the first extreme, when 5 % of it are
left, and the second extreme on the same side."""
T = 1e-4


class RegulatedConstants(NamedTuple):
    """Of a source whose PI controller holds v²."""

    late: Any
    """What is left of a difference to the wanted power after half an interval."""
    decay: Decay


class RegulatedMemory(NamedTuple):
    """Power, W, and the integral of V² − v², V²s."""

    p: Any
    sum: Any


def regulated_flow(memory: RegulatedMemory, v: Any, p: Any, c: RegulatedConstants) -> DcFlow:
    """The power follows with a lag."""
    wanted = K_P * (V * V - v * v) + K_I * memory.sum
    away = memory.p - wanted
    ends = wanted + c.late * away, wanted + c.late * c.late * away
    return DcFlow(0.0, 0.0, 0.0, p_begin=memory.p, p_middle=ends[0], p_end=ends[1], tilt=0.0, decay=c.decay)


def regulated_remembers(
    memory: RegulatedMemory, flow: DcFlow, v_0: Any, v_1: Any, mean: Any, p: Any, c: RegulatedConstants
) -> RegulatedMemory:
    """The integral by the trapezoidal rule."""
    return RegulatedMemory(flow.p_end, memory.sum + 0.5 * T * (2.0 * V * V - v_0 * v_0 - v_1 * v_1))


def test_the_link_of_a_published_case_falls_and_settles_as_plotted() -> None:
    law = DcSourceLaw(regulated_flow, regulated_remembers, lambda *_: None)
    constants = RegulatedConstants(math.exp(-0.5 * T / TAU), decay_of(0.0, T))
    settings = DcSettings(**dict.fromkeys(DcSettings._fields, 0.0) | {"T_s": T, "over_C": 1.0 / C, "V_dc": V})
    settings = settings._replace(source=constants)
    state = DcState(**dict.fromkeys(DcState._fields, 0.0) | {"v": V, "memory": RegulatedMemory(0.0, 0.0)})
    found = []
    for _ in range(5000):
        found.append(state.v - V)
        state = link_step(state, BridgePower(STEP_W, STEP_W, STEP_W, STEP_W), 0.0, settings, law)
    v, t_s = np.array(found), T * np.arange(5000)
    dip = -v.min()
    second = int(t_s.searchsorted(0.2)) + int(v[t_s.searchsorted(0.2) :].argmin())
    ours = {
        "dip_V": dip,
        "at_s": t_s[v.argmin()],
        "settled_s": t_s[np.flatnonzero(np.abs(v) > 0.05 * dip).max() + 1],
        "second_V": -v[second],
        "second_at_s": t_s[second],
    }
    assert {name: ours[name] for name in PLOTTED} == pytest.approx(PLOTTED, rel=0.05)
