"""Where a plant begins: at the rest of what is connected, and waiting at nominal voltage for the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.controller import ControllerSettings, ControllerState
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.equations.dc_control import clamp_cut
from vsgdesign.equations.field import FieldSettings
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.circuit_of_units import Topology
from vsgdesign.linear.operating_point.flow_of_units import InverterAsked, Situation, UnitAsked
from vsgdesign.linear.operating_point.rest_of_units import UnitsAtRest, rest_of_units
from vsgdesign.linear.operating_point.sampled import cold_start
from vsgdesign.simulation.dc_start import dc_at_start
from vsgdesign.simulation.field_observer import FieldMemory
from vsgdesign.simulation.run_kind import Kind, names_of
from vsgdesign.simulation.units.body import AXES, PlantKind
from vsgdesign.simulation.units.timeline import PlantSegment, PlantTimeline
from vsgdesign.study.parameters.inverter_kinds import Phasors
from vsgdesign.study.parameters.power_plant import Inverter
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


class StartOfPlant:
    """Puts the start of a run into its numbers."""

    def __init__(
        self,
        at: Callable[[str], Array],
        kind: PlantKind,
        study: Study,
        timeline: PlantTimeline,
        gains: Sequence[PowerLoopGains],
    ) -> None:
        """``at``: the numbers of a record or of one number by its name, as an array that moves with the run."""
        self._at, self.kind, self.study, self.timeline, self._gains = at, kind, study, timeline, gains

    def put(self, rest: UnitsAtRest | None = None) -> None:
        """Puts it. ``rest``: that at which the run begins, where it is known. Raises InfeasibleStudyError where there
        is none."""
        phase = self.timeline.segments[0].source.phase
        for k, one in enumerate(self.timeline.units):
            state, held, waits = cold_start(one, phase).controller, 0j, 0j
            self._put_unit(k, state, held, waits)
        for j, one in enumerate(self.timeline.plant.inverters):
            self._put_inverter(j, _waiting(one, self.timeline.segments[0].source.omega, phase), 0j, 0j)
        if self.study.simulation.start != "cold":
            self._put_rest(self.rest() if rest is None else rest, phase)
        for k, one in enumerate(self.timeline.units):
            if one.dc is not None:
                self._put_link(k, one)

    def rest(self) -> UnitsAtRest:
        """The steady state of the units that are connected at the start."""
        on_line, others = self._on_line()
        if not on_line and not others:
            raise InfeasibleStudyError("the start: no unit is connected. Close a breaker, or start cold.")
        situation = situation_at(self.study, self.timeline, self.timeline.segments[0], self._gains, on_line)
        try:
            return rest_of_units(situation)
        except InfeasibleStudyError as error:
            error.args = (f"the start: {error}",)
            raise

    def _on_line(self) -> tuple[list[int], list[int]]:
        """The units and the inverters that are connected at the start."""
        plant, opened = self.timeline.plant, self.timeline.segments[0].topology.opened
        on_line = [k for k, unit in enumerate(plant.units) if unit.name not in opened]
        return on_line, [j for j, one in enumerate(plant.inverters) if one.name not in opened]

    def _put_rest(self, rest: UnitsAtRest, phase: float) -> None:
        """The others wait at nominal voltage, in phase."""
        (on_line, others), plant, omega = self._on_line(), self.timeline.plant, rest.model.situation.omega
        y = rest.circuit(phase)
        for name, value in zip(rest.model.network.names, y.tolist(), strict=True):
            self._at(f"alpha.{name}")[:], self._at(f"beta.{name}")[:] = value.real, value.imag
        for at, k in enumerate(on_line):
            self._put_unit(k, *rest.controller(at, phase))
            # What a unit says that has not sampled yet.
            self._at(f"u{k}.last")[:] = *rest.model.powers(rest.z, at), omega, 0.0
        for at, j in enumerate(others):
            self._put_inverter(j, *rest.inverter(at, phase))
            P, Q = rest.model.powers(rest.z, len(on_line) + at)
            self._at(f"u{len(plant.units) + j}.last")[:] = P, Q, omega, 0.0, 0.0, 0.0, 0.0

    def _put_unit(self, k: int, state: ControllerState, held: complex, waits: complex) -> None:
        self._at(f"u{k}.state")[:] = flat_state(state)
        self._put_bridge(k, held, waits)

    def _put_link(self, k: int, study: Study) -> None:
        """The dc link of a unit, which rests until the unit samples for the first time."""
        names = self.kind.states[3 * k : 3 * k + 3]
        plant = np.concatenate([self._at(f"{axis}.{name}") for name in names for axis in AXES])
        try:
            start = dc_at_start(study, plant, self.timeline.segments[0].source.omega)
        except InfeasibleStudyError as error:
            raise InfeasibleStudyError(f"the start: unit {self.timeline.plant.units[k].name}: {error}") from error
        dc = self.kind.units[k].dc
        given = ("link", "dc") if dc is None or not dc.clamps else ("link", "dc", "clamp", "clamp_of")
        for name in given:
            self._at(f"u{k}.{name}")[:] = numbers_of(getattr(start, name))

    def _put_inverter(self, j: int, state: Any, held: complex, waits: complex) -> None:
        k = len(self.timeline.units) + j
        self._at(f"u{k}.state")[:] = state
        self._put_bridge(k, held, waits)

    def _put_bridge(self, k: int, held: complex, waits: complex) -> None:
        for axis, value, waiting in zip(AXES, (held.real, held.imag), (waits.real, waits.imag), strict=True):
            self._at(f"{axis}.held.{k}")[:] = value
            if self.kind.delayed(k):
                self._at(f"u{k}.pending.{axis}")[:] = waiting
            if self.kind.switches(k):
                self._at(f"u{k}.acts.{axis}")[:] = value


def _waiting(one: Inverter, omega: float, phase: float) -> Any:
    """The state of an inverter that waits at nominal voltage in phase with the grid's source, without current."""
    v = complex(rms_to_peak(one.V_rated_rms) * np.exp(1j * phase))
    return one.kind.at_rest(Phasors(v, 0j, 0j, v, omega), one.settings)


def situation_at(
    study: Study,
    timeline: PlantTimeline,
    segment: PlantSegment,
    gains: Sequence[PowerLoopGains],
    on_line: Sequence[int],
    at_s: float | None = None,
) -> Situation:
    """The plant in a segment with the units that are on line, with what they are asked for at an instant (None: when
    the segment begins)."""
    plant, t_s = timeline.plant, segment.t_s if at_s is None else at_s
    others = [j for j, one in enumerate(plant.inverters) if one.name not in segment.topology.opened]
    inverters = tuple(InverterAsked(plant.inverters[j], timeline.asked_at(j, t_s)) for j in others)
    units = tuple(plant.units[k] for k in on_line)
    some = replace(plant, units=units, inverters=tuple(one.inverter for one in inverters))
    opened = segment.topology.opened - {one.name for one in plant.converters}
    topology: Topology = segment.topology._replace(opened=frozenset(opened))
    asked = tuple(_unit_asked(timeline, k, gains[k], segment.source.omega, t_s) for k in on_line)
    sources = ((segment.source.V_g_rms, 0.0), *((one.V_rms, one.phase) for one in plant.sources))
    return Situation(replace(study, plant=some), topology, asked, segment.source.omega, sources, inverters)


def _unit_asked(timeline: PlantTimeline, k: int, gains: PowerLoopGains, omega: float, t_s: float) -> UnitAsked:
    """What a unit is asked for at an instant, with the source that its dc link then has: of no more power than that can
    give, where its controller clamps it."""
    of, study = timeline.timelines[k], timeline.units[k]
    refs, link = of.references_at(t_s), of.link_at(t_s)
    if link is not None:
        study = study if link == study.dc else replace(study, dc=link)
        if link.clamps:
            limits = link.can_give(study.converter, study.filter)
            own = link.clamp(study.converter, study.filter).own
            refs = refs._replace(P_ref=refs.P_ref + float(clamp_cut(omega, refs, gains, limits, own)))
    return UnitAsked(study, gains, refs, of.grid_at(t_s))


def uniform_of(
    timeline: PlantTimeline, kinds: Sequence[Kind], memories: Sequence[FieldMemory | None], names: Sequence[str]
) -> Array:
    """What never changes: gains of the inner loops and constants of the controllers and estimators."""
    known: dict[str, float] = {}
    for k, one in enumerate(timeline.plant.inverters, len(kinds)):
        known[f"u{k}.R_c"] = one.filter.R_c
        known |= dict(zip(names_of(one.kind.settings, f"u{k}.settings"), one.settings, strict=True))
    for k, (study, kind, memory) in enumerate(zip(timeline.units, kinds, memories, strict=True)):
        known |= {f"u{k}.R_c": study.filter.R_c, f"u{k}.V_rated_rms": study.converter.V_rated_rms}
        known[f"u{k}.V_dc"] = study.converter.V_dc
        if memory is not None:
            settings = numbers_of(memory.settings)
            known |= dict(zip(names_of(FieldSettings, f"u{k}.field"), settings, strict=True))
            known[f"u{k}.allowed"] = memory.allowed
        for head, record, value in (
            ("inner_gains", InnerLoopGains, study.inner_gains),
            ("settings", ControllerSettings, study.controller_settings()),
        ):
            known |= dict(zip(kind.names(record, f"u{k}.{head}"), numbers_of(value), strict=True))
    return np.array([float(known[name]) for name in names])
