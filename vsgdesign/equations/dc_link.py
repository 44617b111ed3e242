"""The dc link: a capacitor between a source and the bridge, moved from one sample to the next.

An averaged bridge that compensates the link's voltage makes the commanded voltage as long as the link allows it. The
power that it takes in an interval follows from the circuit's states at both ends, whatever is connected to it. Where
the voltage of the link moves that of the bridge, both are moved together
(:mod:`vsgdesign.linear.model.dc_link`), between :func:`held_law` and :func:`link_ends`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.dc_source_interface import DcFlow, DcSourceLaw
from vsgdesign.equations.frames import instantaneous_power

LEAST_VOLTAGE = 0.01
"""Share of its nominal voltage that the link keeps: below, a run has long been lost."""


class FilterSide(NamedTuple):
    """States of the filter, peak: currents in A, voltage in V."""

    i_s_alpha: Any
    i_s_beta: Any
    v_c_alpha: Any
    v_c_beta: Any
    i_g_alpha: Any
    i_g_beta: Any


class ActingVoltage(NamedTuple):
    """The bridge's voltage over an interval, V peak."""

    alpha: Any
    beta: Any


class BridgeCharge(NamedTuple):
    """The integral of the converter's current over an interval, As peak."""

    alpha: Any
    beta: Any


class BridgePower(NamedTuple):
    """Power of the bridge in an interval, W: at its beginning, at its end, its mean, and the value in the middle with
    which Simpson's rule gives the mean."""

    begin: Any
    middle: Any
    end: Any
    mean: Any


class DcState(NamedTuple):
    """What moves."""

    v: Any
    """Voltage of the link, V."""
    p: Any
    """Mean power that the bridge took in the interval before, W."""
    needs: Any
    """Voltage of the link that the bridge needed in the interval before for what was asked of it, V."""
    spare: Any
    """The least of the link's voltage less this, since the start, V."""
    lowest: Any
    highest: Any
    """Least and largest voltage since the start, at samples, V."""
    least: Any
    most: Any
    """Least and largest power that the bridge took in an interval since the start, W."""
    given: Any
    """Energy that the source has given since the start, J."""
    taken: Any
    """Energy that the bridge has taken since the start, J."""
    memory: Any
    """What the source remembers."""


class DcSettings(NamedTuple):
    """Constants of the link."""

    T_s: Any
    over_C: Any
    """1/F."""
    bleed: Any
    """Conductance across the link, S."""
    V_dc: Any
    """Nominal voltage, V."""
    limit: Any
    """Largest peak voltage of the bridge over that of the link."""
    R_1: Any
    over_L_1: Any
    over_C_f: Any
    R_c: Any
    """Of the filter, SI."""
    source: Any
    """The source's own constants."""


def bridge_limit(v: Any, per_volt: Any) -> Any:
    """The largest voltage that the bridge makes, V peak (:eq:`dc-limit`)."""
    return per_volt * v


def acting_voltage(asked: ActingVoltage, v: Any, per_volt: Any) -> ActingVoltage:
    """What becomes of a commanded voltage in the interval in which it acts (:eq:`dc-limit`): the link may have less by
    then than when it was computed."""
    limit = per_volt * v
    length = np.sqrt(np.maximum(asked.alpha * asked.alpha + asked.beta * asked.beta, limit * limit))
    share = np.minimum(limit / length, 1.0)
    return ActingVoltage(asked.alpha * share, asked.beta * share)


def duty_voltage(asked: ActingVoltage, v: Any, per_volt: Any, V_dc: Any) -> ActingVoltage:
    """The voltage of a bridge at the beginning of an interval whose modulation divides by the nominal voltage of the
    link instead of the measured one (:eq:`dc-duty`)."""
    share = v / V_dc
    return acting_voltage(ActingVoltage(asked.alpha * share, asked.beta * share), v, per_volt)


def mean_current(i_0: Any, i_1: Any, v_0: Any, v_1: Any, n_0: Any, n_1: Any, v_b: Any, dc: DcSettings) -> Any:
    """The converter current of one axis in an interval from its ends (:eq:`dc-current`): i_s (A), the voltage of the
    capacitor node without R_c (V), and i_g (A), at the beginning (0) and at the end (1).

    Returns (middle, mean): the value in the middle with which Simpson's rule gives the mean, and the mean.
    """
    T = dc.T_s
    step = (n_1 - n_0) / T  # slope of the grid current
    slope_0 = (v_b - dc.R_1 * i_0 - v_0 - dc.R_c * (i_0 - n_0)) * dc.over_L_1
    slope_1 = (v_b - dc.R_1 * i_1 - v_1 - dc.R_c * (i_1 - n_1)) * dc.over_L_1
    bend_0 = -(dc.R_1 * slope_0 + (i_0 - n_0) * dc.over_C_f + dc.R_c * (slope_0 - step)) * dc.over_L_1
    bend_1 = -(dc.R_1 * slope_1 + (i_1 - n_1) * dc.over_C_f + dc.R_c * (slope_1 - step)) * dc.over_L_1
    half = 0.5 * (i_0 + i_1)
    tilt = T * (slope_0 - slope_1)
    curve = T * T * (bend_0 + bend_1)
    return half + 0.15 * tilt + 0.0125 * curve, half + 0.1 * tilt + curve / 120.0


def source_current(flow: DcFlow, d: Any, over_v: Any, p: Any) -> Any:
    """The part of the current into the link that no decay stands for, A. p: the power of source less bridge, W."""
    return flow.current + p * over_v + (flow.slope + flow.second * d) * d


def better_inverse(over_v: Any, v: Any) -> Any:
    """1/v from a guess that lies near it."""
    once = over_v * (2.0 - v * over_v)
    return once * (2.0 - v * once)


def bridge_power(x: FilterSide, after: FilterSide, v_b: ActingVoltage, dc: DcSettings) -> BridgePower:
    """The power of the bridge over an interval (:eq:`dc-current`), from the circuit's states at both ends."""
    middle_alpha, mean_alpha = mean_current(
        x.i_s_alpha, after.i_s_alpha, x.v_c_alpha, after.v_c_alpha, x.i_g_alpha, after.i_g_alpha, v_b.alpha, dc
    )
    middle_beta, mean_beta = mean_current(
        x.i_s_beta, after.i_s_beta, x.v_c_beta, after.v_c_beta, x.i_g_beta, after.i_g_beta, v_b.beta, dc
    )
    begin, _ = instantaneous_power(v_b.alpha, v_b.beta, x.i_s_alpha, x.i_s_beta)
    middle, _ = instantaneous_power(v_b.alpha, v_b.beta, middle_alpha, middle_beta)
    end, _ = instantaneous_power(v_b.alpha, v_b.beta, after.i_s_alpha, after.i_s_beta)
    mean, _ = instantaneous_power(v_b.alpha, v_b.beta, mean_alpha, mean_beta)
    return BridgePower(begin, middle, end, mean)


def dc_step(
    state: DcState,
    x: FilterSide,
    after: FilterSide,
    v_b: ActingVoltage,
    asked: ActingVoltage,
    dc: DcSettings,
    source: DcSourceLaw,
) -> DcState:
    """The link over one interval, from the circuit's states at both ends. ``v_b`` is what acts of the voltage that was
    ``asked`` for."""
    needs = np.sqrt(asked.alpha * asked.alpha + asked.beta * asked.beta) / dc.limit
    return link_step(state, bridge_power(x, after, v_b, dc), needs, dc, source)


def dc_step_switched(
    state: DcState,
    x: FilterSide,
    after: FilterSide,
    v_b: ActingVoltage,
    asked: ActingVoltage,
    charge: BridgeCharge,
    switched: Any,
    dc: DcSettings,
    source: DcSourceLaw,
) -> DcState:
    """:func:`dc_step`; where the circuit is ``switched`` in the interval (1, else 0), its states may jump there, and
    the mean power is that of the integral of the current, which the circuit gives."""
    power = bridge_power(x, after, v_b, dc)
    energy, _ = instantaneous_power(v_b.alpha, v_b.beta, charge.alpha, charge.beta)
    mean = energy / dc.T_s
    middle = 1.5 * mean - 0.25 * (power.begin + power.end)
    power = BridgePower(
        power.begin,
        power.middle + switched * (middle - power.middle),
        power.end,
        power.mean + switched * (mean - power.mean),
    )
    needs = np.sqrt(asked.alpha * asked.alpha + asked.beta * asked.beta) / dc.limit
    return link_step(state, power, needs, dc, source)


def link_step(state: DcState, power: BridgePower, needs: Any, dc: DcSettings, source: DcSourceLaw) -> DcState:
    """The link over one interval (:eq:`dc-step`). ``needs``: the voltage of the link that the bridge needs for what was
    asked of it, V."""
    v = state.v
    flow = source.flow(state.memory, v, state.p, dc.source)
    decay = flow.decay
    over_v = 1.0 / v
    half = 0.5 * flow.tilt
    n_0 = dc.over_C * (source_current(flow, 0.0, over_v, flow.p_begin - power.begin) - half)
    v_a = decay.half * v + decay.half_time * n_0
    over_a = better_inverse(over_v, v_a)
    n_a = dc.over_C * source_current(flow, v_a - v, over_a, flow.p_middle - power.middle)
    v_m = decay.half * v + decay.half_time * n_a
    over_m = better_inverse(over_a, v_m)
    n_m = dc.over_C * source_current(flow, v_m - v, over_m, flow.p_middle - power.middle)
    v_c = decay.half * v_a + decay.half_time * (2.0 * n_m - n_0)
    n_c = dc.over_C * (source_current(flow, v_c - v, better_inverse(over_m, v_c), flow.p_end - power.end) + half)
    moved = decay.whole * v + decay.first * n_0 + decay.middle * (n_a + n_m) + decay.last * n_c
    v_1 = np.maximum(moved, LEAST_VOLTAGE * dc.V_dc)
    mean = 0.5 * (v + v_1) + dc.T_s / 12.0 * ((n_0 - decay.rate * v) - (n_c - decay.rate * v_1))
    return link_after(state, v_1, mean, mean * mean, power.mean, needs, dc, source)


def held_law(state: DcState, dc: DcSettings, source: DcSourceLaw) -> Any:
    """The source's current from a sample to the next (:eq:`dc-flow`). Returns (current, slope, second, p_begin,
    p_middle, p_end, tilt, rate)."""
    flow = source.flow(state.memory, state.v, state.p, dc.source)
    powers = flow.p_begin, flow.p_middle, flow.p_end
    return flow.current, flow.slope, flow.second, *powers, flow.tilt, flow.decay.rate


def link_after(
    state: DcState, v_1: Any, mean: Any, square: Any, p: Any, needs: Any, dc: DcSettings, source: DcSourceLaw
) -> DcState:
    """The link at the end of an interval: its voltage there, V, the means of v and v² in between, and the mean power
    that the bridge took, W. ``needs`` as for :func:`link_step`."""
    v = state.v
    flow = source.flow(state.memory, v, state.p, dc.source)
    taken = dc.T_s * p
    bled = dc.T_s * dc.bleed * square
    stored = 0.5 * (v_1 - v) * (v_1 + v) / dc.over_C
    return DcState(
        v=v_1,
        p=p,
        needs=needs,
        spare=np.minimum(state.spare, v - needs),
        lowest=np.minimum(state.lowest, v_1),
        highest=np.maximum(state.highest, v_1),
        least=np.minimum(state.least, p),
        most=np.maximum(state.most, p),
        given=state.given + (taken + bled + stored),
        taken=state.taken + taken,
        memory=source.remember(state.memory, flow, v, v_1, mean, p, dc.source),
    )


def link_ends(
    state: DcState,
    asked: ActingVoltage,
    v_end: Any,
    voltage: Any,
    squares: Any,
    energy: Any,
    dc: DcSettings,
    source: DcSourceLaw,
    compensates: bool,
) -> DcState:
    """:func:`link_after` from the integrals of v and v² over the interval, Vs and V²s, and from the energy that the
    bridge took, J."""
    over_T = 1.0 / dc.T_s
    needs = np.sqrt(asked.alpha * asked.alpha + asked.beta * asked.beta) / dc.limit
    if not compensates:
        needs = needs * (state.v / dc.V_dc)
    v_1 = np.maximum(v_end, LEAST_VOLTAGE * dc.V_dc)
    return link_after(state, v_1, over_T * voltage, over_T * squares, over_T * energy, needs, dc, source)
