"""The whole body of a lane: a sample, the source's ramp, and what is watched."""

from __future__ import annotations

from typing import Any, NamedTuple

from vsgdesign.equations.controller import ControllerSettings, ControllerState
from vsgdesign.equations.filters import FilterGrid
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import GridEstimate, LimiterLaw
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.simulation.lanes.ramp_sample import Ramp, RampRow, with_ramp
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
    """A lane in which a reference is stepped and the powers ripple. Returns (following, moved, waiting,
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
