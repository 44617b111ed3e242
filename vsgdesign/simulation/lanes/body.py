"""The compiled loop of a batch: which numbers are rows of a lane, and which are the same for all."""

from __future__ import annotations

import functools
import typing
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.blocks import with_outputs
from vsgdesign.codegen.flat import Block, flat_block
from vsgdesign.codegen.llvm import Loop, LoopSpec, best_lanes, compiled_loop
from vsgdesign.equations.controller import ControllerSettings, ControllerState
from vsgdesign.equations.filters import FilterGrid
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import Limiter, limiter_named
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.lanes.lane_sample import (
    SecondPiece,
    lane_of_disturbance,
    lane_of_mean_step,
    lane_of_step,
    lane_with_ramp,
)
from vsgdesign.simulation.lanes.listening import LISTENING, SHARED_BY_LISTENERS, listening_body
from vsgdesign.simulation.lanes.names import names_of
from vsgdesign.simulation.lanes.ramp_sample import Ramp, RampRow
from vsgdesign.simulation.lanes.sample import (
    BridgeVoltage,
    CarrierPart,
    EdgeRow,
    PlantRow,
    PlantState,
    SourcePhasor,
    carrier,
)
from vsgdesign.simulation.lanes.watched_sample import (
    DisturbanceDemand,
    DisturbanceWatch,
    LoadDemand,
    MeanStepDemand,
    MeanStepWatch,
    StepDemand,
    StepWatch,
)

Array = NDArray[np.float64]

_VECTORS = 2
"""Vectors of a group: one computes while the other waits. More of them do not fit into the registers."""


class LaneKind(NamedTuple):
    """What decides the text of a loop."""

    limiter: str
    step: bool
    """Whether it watches a step; else a disturbance."""
    ramped: bool
    """Whether the source may be ramped; of a disturbance only."""
    switched: bool
    delayed: bool
    zero_sequence: bool
    samples_per_carrier: int
    second_inductor: bool
    broken: bool = False
    """Whether it runs single samples in whose interval an event falls, on one slope of the carrier; of a switched
    bridge only. An averaged bridge has one interval for both parts."""
    rising: bool = True
    """The slope of these."""
    listening: bool = False
    """Whether a field estimator sends its probe and listens; of an averaged bridge only."""

    @property
    def by_mean(self) -> bool:
        """Whether a step is judged by the mean of its power, because that ripples."""
        return self.listening or self.switched

    @property
    def logged(self) -> tuple[str, ...]:
        """What is logged: the means of a switched bridge, which is judged by the rest that it comes to, and this is
        known at the end alone. Sums stand for the means of a disturbance."""
        if not self.switched or self.broken:
            return ()
        return ("watched.mean",) if self.step else ("watched.sum_P", "watched.sum_Q")

    @property
    def unwatched(self) -> tuple[str, ...]:
        """What of the record of its watch it does not need."""
        if self.switched:
            return ("watch.most", "watch.entry.") if self.step else ("watch.entry.",)
        return ("watch.late",)


class LaneLoop(NamedTuple):
    """A compiled loop and the place of every number in it."""

    loop: Loop
    spec: LoopSpec
    place: dict[str, int]
    """Row of every input of the state and of every constant."""
    spans: dict[str, slice]
    """Rows of every record among them, which are beside each other."""

    def rows(self, prefix: str) -> slice:
        """The rows of a record."""
        return self.spans[prefix]


def kind_of(study: Study, *, step: bool, ramped: bool, bridge: str, listening: bool = False) -> LaneKind:
    """The kind of a study's lanes. ``bridge``: averaged or pwm."""
    c, f = study.converter, study.filter
    return LaneKind(
        limiter=study.current_limiter,
        step=step,
        ramped=ramped,
        switched=bridge == "pwm",
        delayed=c.delay_samples > 0,
        zero_sequence=c.zero_sequence,
        samples_per_carrier=c.samples_per_carrier if bridge == "pwm" else 1,
        second_inductor=f.L_2 + f.R_2 > 0.0,
        listening=listening,
    )


@functools.cache
def lane_loop(kind: LaneKind, strict: bool = False, target: str = "native") -> LaneLoop:
    """The compiled loop of a kind of lane."""
    limiter = limiter_named(kind.limiter)
    memory, constants = (typing.get_type_hints(made)["return"] for made in (limiter.at_rest, limiter.build))
    # A switched bridge has one edge a leg in an interval that lies on one slope of the carrier.
    slopes = (True, False) if kind.switched and not kind.broken else (kind.rising,)
    bodies = tuple(_body(kind, limiter, memory, constants, rising) for rising in slopes)
    inputs = set().union(*(body.inputs for body in bodies))
    watch, demand = _watched(kind)
    watched = [
        (before, after)
        for before, after in zip(names_of(watch, "watch"), names_of(watch, "watched"), strict=True)
        if not before.startswith(kind.unwatched)
    ]
    moving = [
        *zip(names_of(ControllerState, "state", {"limiter": memory}),
             names_of(ControllerState, "following", {"limiter": memory}), strict=True),
        *zip(names_of(PlantState, "x"), names_of(PlantState, "moved"), strict=True),
        *zip(names_of(BridgeVoltage, "pending"), names_of(BridgeVoltage, "waiting"), strict=True),
        *zip(names_of(SourcePhasor, "source"), names_of(SourcePhasor, "turned"), strict=True),
        *(zip(names_of(Ramp, "ramp"), names_of(Ramp, "ramp_after"), strict=True) if kind.ramped else ()),
        *watched,
    ]  # fmt: skip
    rings = (("power_ago", "power"),) if kind.step else (("P_ago", "P"), ("Q_ago", "Q"))
    rings = () if kind.step and not kind.by_mean else rings
    if kind.switched:  # what it does not watch has no place
        outputs = tuple(output for _, output in (*moving, *rings)) + kind.logged
        bodies = tuple(with_outputs(body, outputs) for body in bodies)
    if kind.listening:
        bodies = tuple(listening_body(body, tuple(moving), rings) for body in bodies)
        moving += LISTENING
        inputs |= set(bodies[0].inputs)
    shared_demand = {"of.band", "of.per_S", "of.per_cycle", "load_of.limit_sq"}
    lane = [
        *names_of(PlantRow, "row"),
        *(names_of(RampRow, "ramp_of") if kind.ramped else ()),
        *names_of(demand, "of"),
        *names_of(LoadDemand, "load_of"),
        *names_of(References, "refs"),
        *names_of(PowerLoopGains, "power_gains"),
        "grid.R_g",
        "grid.L_g",
        *(["circuit.R_g", "circuit.L_g"] if kind.step else []),
        *(names_of(EdgeRow, "edge") if kind.switched else []),
        *([*names_of(CarrierPart, "part"), *names_of(SecondPiece, "second")] if kind.broken else []),
        *(name for name, _ in (rings if kind.broken else ())),
    ]
    lane = [name for name in lane if name not in shared_demand]
    uniform = [
        *names_of(InnerLoopGains, "inner_gains"),
        *names_of(ControllerSettings, "settings", {"limiter": constants}),
        *sorted(shared_demand),
        *([f"circuit.{name}" for name in FilterGrid._fields if name not in ("R_g", "L_g")] if kind.step else ["R_c"]),
        *(["V_dc"] if kind.switched else []),
        *(SHARED_BY_LISTENERS if kind.listening else []),
    ]
    lanes = best_lanes(target)
    spec = LoopSpec(
        bodies=bodies,
        state=tuple(moving),
        constant=tuple(name for name in lane if name in inputs),
        uniform=tuple(name for name in uniform if name in inputs),
        cyclic=tuple(names_of(CarrierPart, "part")) if kind.switched and not kind.broken else (),
        rings=() if kind.broken else rings,
        logged=kind.logged,
        index="" if kind.listening or kind.switched else "k",
        lanes=lanes,
        vectors=_VECTORS,
        strict=strict,
    )
    place = {name: row for row, name in enumerate(spec.rows)}
    return LaneLoop(compiled_loop(spec, target), spec, place, _spans(place))


def _spans(place: dict[str, int]) -> dict[str, slice]:
    """The rows of every record, and of every record within one."""
    found: dict[str, slice] = {}
    for name, row in place.items():
        parts = name.split(".")
        for length in range(1, len(parts)):
            record = ".".join(parts[:length])
            found[record] = slice(found[record].start if record in found else row, row + 1)
    return found


def _watched(kind: LaneKind) -> tuple[type[Any], type[Any]]:
    """What is watched of a lane, and what is demanded of it: records."""
    if not kind.step:
        return DisturbanceWatch, DisturbanceDemand
    return (MeanStepWatch, MeanStepDemand) if kind.by_mean else (StepWatch, StepDemand)


def _body(kind: LaneKind, limiter: Limiter, memory: Any, constants: Any, rising: bool) -> Block:
    of_step = lane_of_mean_step if kind.by_mean else lane_of_step
    function = of_step if kind.step else (lane_with_ramp if kind.ramped else lane_of_disturbance)
    fixed: dict[str, Any] = {
        "limiter": limiter.law,
        "delayed": kind.delayed,
        "switched": kind.switched,
        "broken": kind.broken,
        "zero_sequence": kind.zero_sequence,
        "rising": rising,
    }
    if kind.step:
        fixed["second_inductor"] = kind.second_inductor
    kinds = {ControllerState: {"limiter": memory}, ControllerSettings: {"limiter": constants}}
    return flat_block(function, fixed=fixed, kinds=kinds)


def uniform_values(spec: LoopSpec, study: Study, **others: float) -> Array:
    """The uniform numbers of a study in the order of the spec. ``others``: those of the demand, by name with ``__``
    for the dot."""
    settings = study.controller_settings()
    known: dict[str, float] = {
        "R_c": study.filter.R_c,
        "V_dc": study.converter.V_dc,
        **_flat(study.inner_gains, "inner_gains"),
        **_flat(settings, "settings"),
        **_flat(study.circuit(), "circuit"),
        **{name.replace("__", "."): value for name, value in others.items()},
    }
    return np.array([float(known[name]) for name in spec.uniform])


def carrier_part(begin: Array, end: Array) -> Array:
    """:class:`CarrierPart` of intervals, (n, 3)."""
    return np.column_stack([begin, end, carrier(begin)])


def carrier_values(samples_per_carrier: int) -> tuple[Array, NDArray[np.int64]]:
    """What depends on the place on the carrier: (n, 3) of :class:`CarrierPart`, and the body (n): 0 where the carrier
    rises, 1 where it falls."""
    n = samples_per_carrier
    begin = np.arange(n) / n
    return carrier_part(begin, begin + 1.0 / n), (begin >= 0.5).astype(np.int64)


def _flat(record: Any, prefix: str) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, value in record._asdict().items():
        if hasattr(value, "_fields"):
            found |= _flat(value, f"{prefix}.{name}")
        elif not isinstance(value, Sequence):
            found[f"{prefix}.{name}"] = float(value)
    return found
