"""The whole body of a lane: a sample, the source's ramp, and what is watched."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from vsgdesign.equations.controller import ControllerSettings, ControllerState
from vsgdesign.equations.filters import FilterGrid
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import GridEstimate, LimiterLaw
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.frames import rotate
from vsgdesign.simulation.lanes.sample import (
    BridgeVoltage,
    CarrierPart,
    EdgeRow,
    PlantRow,
    PlantState,
    SourcePhasor,
    averaged_sample,
    drawn_back,
    moved_by_source,
    switched_bridge,
    switched_sample,
)
from vsgdesign.simulation.lanes.watched_sample import (
    DisturbanceDemand,
    DisturbanceWatch,
    LoadDemand,
    MeanStepDemand,
    MeanStepWatch,
    StepDemand,
    StepWatch,
    power_at_pcc,
    watched_disturbance,
    watched_mean_step,
    watched_step,
)


class Ramp(NamedTuple):
    """Where a ramp of the source is: its amplitude (V peak), and by how much its frequency has left the one for which
    the responses are made, rad/s."""

    V_pk: Any
    drift: Any


class RampRow(NamedTuple):
    """The source over one interval of a ramp: what c·s^m·e^{jωs} adds to each state, m = 0, 1, 2, and both slopes in
    V/s and rad/s²."""

    re01: Any
    re02: Any
    re03: Any
    im01: Any
    im02: Any
    im03: Any
    re11: Any
    re12: Any
    re13: Any
    im11: Any
    im12: Any
    im13: Any
    re21: Any
    re22: Any
    re23: Any
    im21: Any
    im22: Any
    im23: Any
    V_slope: Any
    omega_slope: Any


def with_ramp(row: PlantRow, ramp: Ramp, of: RampRow, T_s: Any) -> Any:
    """The interval of a sample on a ramp (:eq:`source-ramp`): to second order in drift and slope. Returns (moved_row,
    ramp_after, extra): the row, the ramp at the next sample, and by how much more the source turns, rad."""
    V = ramp.V_pk
    d = ramp.drift
    a = of.V_slope
    r = of.omega_slope
    one_im = d * V
    two_re = -0.5 * V * d * d
    two_im = 0.5 * V * r + d * a
    extra = d * T_s + 0.5 * r * T_s * T_s
    turn_cos, turn_sin = rotate(row.turn_cos, row.turn_sin, np.cos(extra), np.sin(extra))
    moved_row = PlantRow(
        p11=row.p11,
        p12=row.p12,
        p13=row.p13,
        p21=row.p21,
        p22=row.p22,
        p23=row.p23,
        p31=row.p31,
        p32=row.p32,
        p33=row.p33,
        b1=row.b1,
        b2=row.b2,
        b3=row.b3,
        re1=of.re01 * V + (of.re11 * a - of.im11 * one_im) + (of.re21 * two_re - of.im21 * two_im),
        re2=of.re02 * V + (of.re12 * a - of.im12 * one_im) + (of.re22 * two_re - of.im22 * two_im),
        re3=of.re03 * V + (of.re13 * a - of.im13 * one_im) + (of.re23 * two_re - of.im23 * two_im),
        im1=of.im01 * V + (of.im11 * a + of.re11 * one_im) + (of.im21 * two_re + of.re21 * two_im),
        im2=of.im02 * V + (of.im12 * a + of.re12 * one_im) + (of.im22 * two_re + of.re22 * two_im),
        im3=of.im03 * V + (of.im13 * a + of.re13 * one_im) + (of.im23 * two_re + of.re23 * two_im),
        turn_cos=turn_cos,
        turn_sin=turn_sin,
    )
    return moved_row, Ramp(V_pk=V + a * T_s, drift=d + r * T_s), extra


class SecondPiece(NamedTuple):
    """The rest of an interval in which an event falls: the circuit over it, with what the source adds for the phasor at
    the beginning of the whole interval; its part of the carrier, and the responses to its edges."""

    row: PlantRow
    part: CarrierPart
    edge: EdgeRow


def bridge_sample(
    state: ControllerState,
    x: PlantState,
    pending: BridgeVoltage,
    source: SourcePhasor,
    grid: GridEstimate,
    refs: References,
    power_gains: PowerLoopGains,
    inner_gains: InnerLoopGains,
    settings: ControllerSettings,
    R_c: Any,
    row: PlantRow,
    V_dc: Any,
    part: CarrierPart,
    edge: EdgeRow,
    second: SecondPiece,
    limiter: LimiterLaw,
    delayed: bool,
    switched: bool,
    broken: bool,
    zero_sequence: bool,
    rising: bool,
) -> Any:
    """One sample with either bridge; ``broken``: an event falls inside its interval. Returns (following, output, moved,
    waiting, turned)."""
    if broken:
        following, output, middle, waiting, turned = switched_sample(
            state,
            x,
            pending,
            source,
            grid,
            refs,
            power_gains,
            inner_gains,
            settings,
            R_c,
            row,
            V_dc,
            part,
            edge,
            limiter,
            delayed,
            zero_sequence,
            rising,
        )
        applied = pending if delayed else waiting
        rest = switched_bridge(
            middle, applied.alpha, applied.beta, second.row, V_dc, second.part, second.edge, zero_sequence, rising
        )
        moved = moved_by_source(rest, source, second.row)
    elif switched:
        following, output, moved, waiting, turned = switched_sample(
            state,
            x,
            pending,
            source,
            grid,
            refs,
            power_gains,
            inner_gains,
            settings,
            R_c,
            row,
            V_dc,
            part,
            edge,
            limiter,
            delayed,
            zero_sequence,
            rising,
        )
    else:
        following, output, moved, waiting, turned = averaged_sample(
            state, x, pending, source, grid, refs, power_gains, inner_gains, settings, R_c, row, limiter, delayed
        )
    return following, output, moved, waiting, turned


def lane_of_step(
    state: ControllerState,
    x: PlantState,
    pending: BridgeVoltage,
    source: SourcePhasor,
    grid: GridEstimate,
    refs: References,
    power_gains: PowerLoopGains,
    inner_gains: InnerLoopGains,
    settings: ControllerSettings,
    row: PlantRow,
    V_dc: Any,
    part: CarrierPart,
    edge: EdgeRow,
    second: SecondPiece,
    watch: StepWatch,
    of: StepDemand,
    load_of: LoadDemand,
    circuit: FilterGrid,
    k: Any,
    limiter: LimiterLaw,
    delayed: bool,
    switched: bool,
    broken: bool,
    zero_sequence: bool,
    rising: bool,
    second_inductor: bool,
) -> Any:
    """A lane in which a reference is stepped. Returns (following, moved, waiting, turned, watched)."""
    after, output, moved, waiting, turned = bridge_sample(
        state,
        x,
        pending,
        source,
        grid,
        refs,
        power_gains,
        inner_gains,
        settings,
        circuit.R_c,
        row,
        V_dc,
        part,
        edge,
        second,
        limiter,
        delayed,
        switched,
        broken,
        zero_sequence,
        rising,
    )
    watched = watched_step(watch, of, load_of, x, source, output, circuit, k, second_inductor)
    following = drawn_back(after)
    return following, moved, waiting, turned, watched


def lane_of_mean_step(
    state: ControllerState,
    x: PlantState,
    pending: BridgeVoltage,
    source: SourcePhasor,
    grid: GridEstimate,
    refs: References,
    power_gains: PowerLoopGains,
    inner_gains: InnerLoopGains,
    settings: ControllerSettings,
    row: PlantRow,
    V_dc: Any,
    part: CarrierPart,
    edge: EdgeRow,
    second: SecondPiece,
    watch: MeanStepWatch,
    of: MeanStepDemand,
    load_of: LoadDemand,
    circuit: FilterGrid,
    power_ago: Any,
    k: Any,
    limiter: LimiterLaw,
    delayed: bool,
    switched: bool,
    broken: bool,
    zero_sequence: bool,
    rising: bool,
    second_inductor: bool,
) -> Any:
    """A lane in which a reference is stepped and a probe ripples the powers. Returns (following, moved, waiting,
    turned, watched, power)."""
    after, output, moved, waiting, turned = bridge_sample(
        state,
        x,
        pending,
        source,
        grid,
        refs,
        power_gains,
        inner_gains,
        settings,
        circuit.R_c,
        row,
        V_dc,
        part,
        edge,
        second,
        limiter,
        delayed,
        switched,
        broken,
        zero_sequence,
        rising,
    )
    P, Q = power_at_pcc(x, source, output, circuit, of.V_g_pk, second_inductor)
    power = of.of_P * P + of.of_Q * Q
    watched = watched_mean_step(watch, of, load_of, power, power_ago, x, output.limited, k)
    following = drawn_back(after)
    return following, moved, waiting, turned, watched, power


def lane_of_disturbance(
    state: ControllerState,
    x: PlantState,
    pending: BridgeVoltage,
    source: SourcePhasor,
    grid: GridEstimate,
    refs: References,
    power_gains: PowerLoopGains,
    inner_gains: InnerLoopGains,
    settings: ControllerSettings,
    R_c: Any,
    row: PlantRow,
    V_dc: Any,
    part: CarrierPart,
    edge: EdgeRow,
    second: SecondPiece,
    watch: DisturbanceWatch,
    of: DisturbanceDemand,
    load_of: LoadDemand,
    P_ago: Any,
    Q_ago: Any,
    k: Any,
    limiter: LimiterLaw,
    delayed: bool,
    switched: bool,
    broken: bool,
    zero_sequence: bool,
    rising: bool,
) -> Any:
    """A lane in which something else happens. Returns (following, moved, waiting, turned, watched, P, Q)."""
    after, output, moved, waiting, turned = bridge_sample(
        state,
        x,
        pending,
        source,
        grid,
        refs,
        power_gains,
        inner_gains,
        settings,
        R_c,
        row,
        V_dc,
        part,
        edge,
        second,
        limiter,
        delayed,
        switched,
        broken,
        zero_sequence,
        rising,
    )
    watched = watched_disturbance(watch, of, load_of, x, state, after, output, P_ago, Q_ago, 0.0, k)
    following = drawn_back(after)
    P, Q = output.P, output.Q
    return following, moved, waiting, turned, watched, P, Q


def lane_with_ramp(
    state: ControllerState,
    x: PlantState,
    pending: BridgeVoltage,
    source: SourcePhasor,
    ramp: Ramp,
    grid: GridEstimate,
    refs: References,
    power_gains: PowerLoopGains,
    inner_gains: InnerLoopGains,
    settings: ControllerSettings,
    R_c: Any,
    row: PlantRow,
    ramp_of: RampRow,
    V_dc: Any,
    part: CarrierPart,
    edge: EdgeRow,
    second: SecondPiece,
    watch: DisturbanceWatch,
    of: DisturbanceDemand,
    load_of: LoadDemand,
    P_ago: Any,
    Q_ago: Any,
    k: Any,
    limiter: LimiterLaw,
    delayed: bool,
    switched: bool,
    broken: bool,
    zero_sequence: bool,
    rising: bool,
) -> Any:
    """A lane in which the source is ramped. Returns (following, moved, waiting, turned, ramp_after, watched, P, Q)."""
    own_row, ramp_after, extra = with_ramp(row, ramp, ramp_of, settings.T_s)
    after, output, moved, waiting, turned = bridge_sample(
        state,
        x,
        pending,
        source,
        grid,
        refs,
        power_gains,
        inner_gains,
        settings,
        R_c,
        own_row,
        V_dc,
        part,
        edge,
        second,
        limiter,
        delayed,
        switched,
        broken,
        zero_sequence,
        rising,
    )
    watched = watched_disturbance(watch, of, load_of, x, state, after, output, P_ago, Q_ago, extra, k)
    following = drawn_back(after)
    P, Q = output.P, output.Q
    return following, moved, waiting, turned, ramp_after, watched, P, Q
