"""Events of a plant to a timeline: what is connected, what the sources do, and what each unit is asked for and told."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace

from vsgdesign.equations.grid_following import SetPoints
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.circuit_of_units import Topology, grid_of_unit, names_of_states
from vsgdesign.linear.operating_point.flow_of_units import clock_of_study
from vsgdesign.simulation.field_feed import with_pair
from vsgdesign.simulation.timeline import SourceSegment, Timeline, build_timeline
from vsgdesign.simulation.wander import Replay, Wander
from vsgdesign.study.parameters.dc_link import DcLink, not_of
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.grid import PLAIN, SourceComponent
from vsgdesign.study.parameters.network_fields import CLOSED, NOTHING_SAID, OPEN
from vsgdesign.study.parameters.power_plant import GRID, Inverter, PowerPlant, behind_its_path, with_fixed_gains
from vsgdesign.study.parameters.study import ControllerSpec, Study


@dataclass(frozen=True)
class PlantSegment:
    """A plant from t_s on, until the next segment."""

    t_s: float
    topology: Topology
    source: SourceSegment
    """Of the grid."""
    components: tuple[SourceComponent, ...] = ()
    """What it has besides its fundamental."""

    @property
    def moved(self) -> SourceSegment:
        """What the matrices of the loop move of the grid's source. One on a ramp is fed (:eq:`plant-added`), so it has
        no voltage here, and its phasor turns with the frequency at the beginning."""
        return self.source if self.source.steady else replace(self.source.held, V_g_rms=0.0)


@dataclass(frozen=True)
class PlantTimeline:
    """Everything that is known of a plant's run beforehand."""

    segments: tuple[PlantSegment, ...]
    units: tuple[Study, ...]
    """Each unit as a study of one converter on the grid that it sees where all units move alike: with the events of
    its set points and of this grid."""
    timelines: tuple[Timeline, ...]
    """Of these."""
    asked: tuple[tuple[tuple[float, SetPoints], ...], ...]
    """Of each inverter: from when on it is asked for what."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the circuit's states over the run."""
        plant = self.plant
        return names_of_states(plant, [one.topology for one in self.segments])

    plant: PowerPlant
    shared: Timeline
    """Of the grid and its source, whose background or record takes a step in each period of the plant's clock."""

    @property
    def blocked(self) -> frozenset[str]:
        """Names of the units whose bridges block, which an event says."""
        names = {event.name for unit in self.units for event in unit.events}
        return frozenset(one.name for one in self.plant.units if blocks(one.name) in names)

    def asked_at(self, inverter: int, t_s: float) -> SetPoints:
        """What an inverter is asked for from an instant on."""
        own = self.asked[inverter]
        return own[max(bisect_right(own, t_s, key=lambda one: one[0]) - 1, 0)][1]

    def segment_at(self, t_s: float) -> PlantSegment:
        """The segment from an instant on."""
        return self.segments[max(bisect_right(self.segments, t_s, key=lambda one: one.t_s) - 1, 0)]


def plant_timeline(study: Study, spec: ControllerSpec | None = None) -> PlantTimeline:
    """The timeline of a study with a plant. ``spec``: the controller of all units, whose current limit they have.
    Raises ValueError where there is no plant."""
    plant = study.plant
    if plant is None:
        raise ValueError("the study has no plant")
    shared = build_timeline(replace(study, events=tuple(one for one in study.events if one.element is None)))
    period = clock_of_study(study).period
    if shared.wander is not None:
        shared = replace(shared, wander=Wander(shared.wander.spec, period, study.converter.omega_n))
    if shared.replay is not None:
        shared.replay.spec.check_usable(study.simulation.duration + 4.0 * period, study.converter)
        shared = replace(shared, replay=Replay(shared.replay.spec, period))
    of_elements = sorted((one for one in study.events if one.element is not None), key=lambda one: one.t_s)
    switching = (one for one in of_elements if one.switched != NOTHING_SAID or not (one.set_points or one.of_dc))
    changes = {0.0, *shared.plant_changes(), *(one.t_s for one in switching)}
    segments: list[PlantSegment] = []
    opened, faults = set(plant.opened), dict[str, float]()
    waiting = list(of_elements)
    for t_s in sorted(changes):
        while waiting and waiting[0].t_s <= t_s:
            _switch(waiting.pop(0), opened, faults)
        network = shared.network_at(t_s)
        there = faults if network.fault is None else faults | {plant.pcc: network.fault.R}
        topology = Topology(
            shared.grid_at(t_s),
            frozenset(opened if network.connected else opened | {GRID}),
            network.load,
            tuple(sorted(there.items())),
        )
        segments.append(PlantSegment(t_s, topology, shared.source_at(t_s), shared.components_at(t_s)))
    units = tuple(_alone(study, plant, k, segments) for k in range(len(plant.units)))
    if spec is not None:
        units = tuple(one.with_limit_of(spec_of(one, spec)) for one in units)
    asked = tuple(_asked(one, of_elements) for one in plant.inverters)
    return PlantTimeline(tuple(segments), units, tuple(map(build_timeline, units)), asked, plant, shared)


def _asked(inverter: Inverter, events: Sequence[Event]) -> tuple[tuple[float, SetPoints], ...]:
    """What an inverter is asked for over time. Events of all units are not meant for it."""
    found = [(0.0, inverter.asked)]
    for event in events:
        if event.element == inverter.name and event.set_points:
            found.append((event.t_s, found[-1][1]._replace(**event.set_points)))
    return tuple(found)


def blocks(unit: str) -> str:
    """The name of the event by which the breaker of a unit opens whose bridge blocks."""
    return f"{unit}: its bridge blocks"


def without_blocked(study: Study, unit: str, t_s: float) -> Study:
    """The study in which the breaker of a unit opens at an instant, because its bridge blocks, and does not close
    again."""
    opens = Event(t_s, blocks(unit), element=unit, switched=NOTHING_SAID._replace(breaker=OPEN))
    left = (one for one in study.events if one.t_s <= t_s or one.element != unit or one.switched == NOTHING_SAID)
    return replace(study, events=tuple(sorted((*left, opens), key=lambda one: one.t_s)))


def spec_of(unit: Study, spec: ControllerSpec) -> ControllerSpec:
    """A controller as a unit has it, whose case may have other targets."""
    return next(one for one in unit.controllers if one.name == spec.name)


def _switch(event: Event, opened: set[str], faults: dict[str, float]) -> None:
    """What an event of an element does to what is connected."""
    name, said = event.element or "", event.switched
    if said.breaker is not None and event.synchro_check is None:
        (opened.discard if said.breaker == CLOSED else opened.add)(name)
    if said.fault is not None:
        faults.pop(name, None)
        if not isinstance(said.fault, str):
            faults[name] = said.fault.R


def _as_of_unit(event: Event, name: str, dc: DcLink | None) -> Event:
    """What an event is to a unit that sees the grid alone: its set points, what the grid's source does, and what
    changes of the source of its dc link."""
    if event.element not in (None, name):
        return Event(event.t_s, event.name)
    of_dc = {one: value for one, value in event.of_dc.items() if not_of(dc, one) is None}
    of_source = {one: getattr(event, one) for one in ("V_g_rms", "omega_g", "over", "phase_jump", "components")}
    return replace(Event(event.t_s, event.name), **event.set_points, **of_source, **of_dc)


def _alone(study: Study, plant: PowerPlant, k: int, segments: Sequence[PlantSegment]) -> Study:
    """A unit as one converter, with a probe on its own lines (:eq:`plant-seen`) and with sensors of its own. What it is
    told of the network does not follow faults, nor an open breaker of the grid."""
    unit, sensors = plant.units[k], study.sensors
    told: list[Event] = []
    grid = None
    names = {event.t_s: event.name for event in study.events}
    for one in segments:
        topology = one.topology._replace(faults=())
        if GRID in topology.opened and grid is not None:
            continue
        try:
            seen = grid_of_unit(study, unit, topology)
        except InfeasibleStudyError:
            if grid is None:
                raise
            continue
        if seen != grid:
            told.append(Event(one.t_s, names.get(one.t_s, ""), grid=seen))
            grid = seen
    own = [_as_of_unit(one, unit.name, unit.dc) for one in study.events]
    first, shared = told[0].grid, plant.common_estimate
    base = replace(behind_its_path(study, unit), estimator=study.estimator)
    alone = replace(
        with_pair(base, unit.pair, k, neighbours=len(plant.units) > 1) if unit.pair > 0 and not shared else base,
        name=f"{study.name}.{unit.name}",
        plant=None,
        sensors=sensors if sensors is None or k == 0 else sensors.redrawn(sensors.seed + k),
        network=PLAIN,
        grid=base.grid if first is None else first,
        grid_source=study.grid_source,
        simulation=replace(study.simulation, P_ref=unit.P_ref, Q_ref=unit.Q_ref),
        events=tuple(sorted((*told[1:], *own), key=lambda one: one.t_s)),
    )
    return with_fixed_gains(alone)
