"""Random cases of a plant: the cases of one converter are those of the mean of all units, and seven more numbers say
how many units are on line, how they differ, and which of them has the event.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.campaigns.verification.blocks import Batch, SingleRun
from vsgdesign.campaigns.verification.draws import UNIFORMS, Index, cases_of, uniforms_of, verification_of
from vsgdesign.campaigns.verification.emt import TABLE, base_document, controller_document, figures_of_run
from vsgdesign.codegen.machine_code import instruction_set
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.metrics.survival import REST_SHARE
from vsgdesign.simulation.lanes.cases import STEP, LaneCases, segments_of
from vsgdesign.simulation.lanes.own_rest import pieces
from vsgdesign.simulation.lanes.rests import ends_of
from vsgdesign.simulation.lanes.results import (
    BLOCKED,
    DIVERGED,
    IN_NOISE,
    JUDGED,
    LATCHED,
    NO_REST,
    NOT_AT_REST,
    OVER_LIMIT,
    SLIPPED,
    TRIPPED,
    LaneResults,
)
from vsgdesign.simulation.lanes.units import Plants, run_plants
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of
from vsgdesign.simulation.units.scenario import run_plant
from vsgdesign.simulation.units.timeline import plant_timeline
from vsgdesign.study.given_files import toml_text
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.case_families import LOSS, families
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.event_kinds import DC_QUANTITIES
from vsgdesign.study.parameters.grid import Grid, GridEstimate
from vsgdesign.study.parameters.network_fields import OPEN, Said
from vsgdesign.study.parameters.power_plant import Element, PowerPlant, Unit
from vsgdesign.study.parameters.ranges import uniform_of
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

OF_PLANT = ("units", "who", "P_apart", "P_place", "Q_apart", "Q_place", "reactance")
"""What the numbers of a case decide besides :data:`vsgdesign.campaigns.verification.draws.COORDINATES`."""

ALL = -1
"""All units have the event."""

_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
"""Units take numbers of one draw that are this far apart, so that they lie evenly between 0 and 1."""

_PCC = "pcc"


@dataclass(frozen=True, kw_only=True)
class PlantCases(LaneCases):
    """Cases of a plant. Grid, references and events are those of the mean of all units, with the grid's impedance as a
    unit would see it with all N units of the plant on line."""

    units: NDArray[np.int64]
    """On line at the start, (N,)."""
    who: NDArray[np.int64]
    """The unit that steps, whose dc source changes, or that is lost; ALL."""
    lost: NDArray[np.bool_]
    """Whether it is lost."""
    P_apart: Array
    Q_apart: Array
    """By how much P and Q of each unit differ from the mean, W and var, (N, most units)."""
    more_L: Array
    """What the transformer of each unit has besides that of the plant, H, (N, most units)."""

    def besides(self, k: int) -> tuple[str, str]:
        """How many units there are, and which of them has the event."""
        units, who = int(self.units[k]), int(self.who[k])
        on_line = "one unit is on line" if units == 1 else f"{units} units are on line"
        if self.lost[k]:
            return on_line, f"unit {who + 1} is lost"
        return on_line, "" if who == ALL else f"this is unit {who + 1} alone"


def draw_plants(
    study: Study, spec: ControllerSpec, first: int, count: int, ready: Ready = NOTHING
) -> tuple[PlantCases, Index]:
    """Cases ``first`` to ``first + count`` of a plant, as :func:`vsgdesign.campaigns.verification.draws.draw_cases`."""
    seed = verification_of(study, spec, ready).seed
    return plants_of(study, spec, uniforms_of(seed, first, count, len(OF_PLANT)), ready=ready)


def plants_of(
    study: Study,
    spec: ControllerSpec,
    uniforms: ArrayLike,
    family: int | NDArray[np.integer] | None = None,
    ready: Ready = NOTHING,
) -> tuple[PlantCases, Index]:
    """The cases of numbers in [0, 1), (N, UNIFORMS + 7), and the family of each."""
    plant, asked = plant_of(study), verification_of(study, spec, ready)
    unit = replace(plant_timeline(study).units[0], verification=asked)
    numbers = np.asarray(uniforms, dtype=float)
    u = dict(zip(OF_PLANT, np.ascontiguousarray(numbers[:, UNIFORMS:].T), strict=True))
    most, least = len(plant.units), plant.least or len(plant.units)
    loss, step = families().index(LOSS), families().index("step")

    def units_of(kind: Index) -> NDArray[np.int64]:
        lowest = np.where(kind == loss, max(least, 2), least)
        return (lowest + np.floor(u["units"] * (most - lowest + 1))).astype(np.int64)

    def share_of(kind: Index) -> tuple[Array, Array]:
        units = units_of(kind)
        return units / most, (units - (kind == loss)) / most

    cases, kind = cases_of(unit, spec, numbers[:, :UNIFORMS], family, ready, share_of)
    units, lost = units_of(kind), kind == loss
    alone = np.floor((2.0 * u["who"] - 1.0) * units).astype(np.int64)  # every other event is one of all units
    of_one = [step, *(families().index(name) for name in DC_QUANTITIES)]
    who = np.where(np.isin(kind, of_one), np.maximum(alone, ALL), ALL)
    who = np.where(lost, np.floor(u["who"] * units).astype(np.int64), who)
    before, after = units / most, (units - lost) / most
    events = replace(cases.events, R_g=cases.events.R_g / after[:, None], L_g=cases.events.L_g / after[:, None])
    drawn = {f.name: getattr(cases, f.name) for f in fields(LaneCases)}
    drawn |= {"events": events, "R_g": cases.R_g / before, "L_g": cases.L_g / before}
    P_apart, Q_apart = _apart(unit, asked.units_apart, cases, units, most, u)
    place = np.mod(u["reactance"][:, None] + _GOLDEN * np.arange(most), 1.0)
    more_L = uniform_of(asked.more_reactance, place) * unit.converter.Z_base / unit.converter.omega_n
    found = PlantCases(**drawn, units=units, who=who, lost=lost, P_apart=P_apart, Q_apart=Q_apart, more_L=more_L)
    return found, kind


def _apart(
    unit: Study, share: float, cases: LaneCases, units: NDArray[np.int64], most: int, u: Mapping[Any, Array]
) -> tuple[Array, Array]:
    """By how much P and Q of each unit differ from their mean. The differences of a case add up to zero, and what they
    ask of a unit is within its current limit."""
    c = unit.converter
    place = np.arange(most)[None, :] / units[:, None]
    there = (np.arange(most)[None, :] < units[:, None]) & (units[:, None] > 1)
    found = []
    for name in ("P", "Q"):
        wave = np.cos(2.0 * math.pi * (place + u[f"{name}_place"][:, None]))
        found.append(np.where(there, share * c.S_rated * u[f"{name}_apart"][:, None] * wave, 0.0))
    if c.current_limit_pu is None:
        return found[0], found[1]
    reached = np.hypot(np.abs(cases.P_ref), np.abs(cases.Q_ref)) / c.S_rated
    room = np.maximum(_ROOM * REST_SHARE * c.current_limit_pu - reached, 0.0) * c.S_rated
    length = np.hypot(np.abs(found[0]).max(axis=1), np.abs(found[1]).max(axis=1))
    factor = np.where(length > room, room / np.where(length > 0.0, length, 1.0), 1.0)[:, None]
    return found[0] * factor, found[1] * factor


_ROOM = 0.9
"""Apparent power of a unit, as a share of what its limit allows at nominal voltage: the voltage may be lower."""


def plant_of(study: Study) -> PowerPlant:
    """The plant of a study. Raises InfeasibleStudyError where there is none."""
    if study.plant is None:
        raise InfeasibleStudyError("the study has one converter, and no plant.")
    return study.plant


def study_of_plant(study: Study, cases: PlantCases, k: int, samples: int) -> Study:
    """One case as a study, which runs for so many samples and logs each of them."""
    plant, T_s = plant_of(study), study.converter.T_s
    most, count = len(plant.units), int(cases.units[k])
    nodes, elements, units = [_PCC], [], []
    for j, one in enumerate(plant.units[:count]):
        more = float(cases.more_L[k, j])
        node = f"{one.name}_node" if more > 0.0 else _PCC
        if more > 0.0:
            nodes.append(node)
            elements.append(Element(f"{one.name}_more", f"{one.name}_more", node, _PCC, L=more))
        units.append(_unit(one, cases, k, j, node))
    return replace(
        study,
        plant=PowerPlant(nodes=tuple(nodes), elements=tuple(elements), sources=(), units=tuple(units), pcc=_PCC),
        grid=Grid(float(cases.R_g[k]) / most, float(cases.L_g[k]) / most),
        events=_events(study, cases, k),
        background=None,
        sensors=None,
        simulation=replace(
            study.simulation,
            duration=samples * T_s,
            start="steady_state",
            log_interval=T_s,
            survival=bool(cases.kind[k] != STEP),
            P_ref=float(cases.P_ref[k]),
            Q_ref=float(cases.Q_ref[k]),
        ),
    )


def _unit(one: Unit, cases: PlantCases, k: int, j: int, node: str) -> Unit:
    P, Q = cases.P_ref[k] + cases.P_apart[k, j], cases.Q_ref[k] + cases.Q_apart[k, j]
    return replace(one, node=node, P_ref=float(P), Q_ref=float(Q))


def _events(study: Study, cases: PlantCases, k: int) -> tuple[Event, ...]:
    """The source of the case, of which a closed form does not know, and what happens."""
    most, found = len(plant_of(study).units), []
    V_g_rms, omega_g = float(cases.V_g_rms[k]), float(cases.omega_g[k])
    if (V_g_rms, omega_g) != (study.grid_source.V_g_rms, study.grid_source.omega_g):
        found.append(Event(0.0, V_g_rms=V_g_rms, omega_g=omega_g))
    names = [one.name for one in plant_of(study).units[: int(cases.units[k])]]
    who = int(cases.who[k])
    for at, event in enumerate(cases.events.events(k)):
        if at == 0 and cases.lost[k]:
            found.append(Event(event.t_s, element=names[who], switched=Said(None, None, OPEN)))
            continue
        for j, name in enumerate(names) if event.set_points or event.of_dc else ():
            if who in (ALL, j):
                apart = {"P_ref": float(cases.P_apart[k, j]), "Q_ref": float(cases.Q_apart[k, j])}
                moved = {one: value + apart.get(one, 0.0) for one, value in event.set_points.items()}
                found.append(replace(Event(event.t_s, element=name), **moved, **event.of_dc))
        grid = None if event.grid is None else Grid(event.grid.R_g / most, event.grid.L_g / most)
        rest = replace(event, grid=grid, **dict.fromkeys((*event.set_points, *event.of_dc)))
        if rest.of_grid:
            found.append(rest)
    return tuple(found)


def run_drawn(
    study: Study,
    spec: ControllerSpec,
    ready: Ready,
    cases: PlantCases,
    *,
    bridge: str = "averaged",
    strict: bool = True,
) -> LaneResults:
    """Runs every case, as :func:`vsgdesign.simulation.lanes.run.run_lanes`: a figure is that of the worst unit. Of a
    step it is that of the units that step, and what is lost is not judged. The loop is always strict."""
    del strict
    results = LaneResults.of_none(len(cases))
    ends = _ends(study, spec, ready, cases, bridge)
    own_rest = bridge == "pwm"
    units = len(plant_of(study).units)
    some = pieces(ends, cases, study.converter.T_s, own_rest=own_rest, units=units) if own_rest else ()
    for one in some:
        results.fill(one, _run_together(study, spec, ready, cases.take(one), ends[one], bridge))
    if own_rest or not len(cases):
        return results
    return _run_together(study, spec, ready, cases, ends, bridge)


def _run_together(
    study: Study, spec: ControllerSpec, ready: Ready, cases: PlantCases, ends: NDArray[np.int64], bridge: str
) -> LaneResults:
    """The cases whose logs have room together."""
    results = LaneResults.of_none(len(cases))
    studies = tuple(study_of_plant(study, cases, k, int(end)) for k, end in enumerate(ends))
    found = run_plants(spec, ready, Plants(studies=studies, cases=cases, ends=ends), bridge=bridge)
    own, order = found.results, np.array([_SEVERITY.index(status) for status in range(len(_SEVERITY))])
    who = cases.who[found.case]
    steps = (cases.kind[found.case] == STEP) & ~((who == ALL) | (who == found.unit))
    begin = np.searchsorted(found.case, np.arange(len(cases)))
    severity = np.where(found.on_line, order[own.status], -1)
    results.status[:] = np.array(_SEVERITY, dtype=np.int8)[np.maximum.reduceat(severity, begin)]
    results.fault[:] = np.maximum.reduceat(own.fault, begin)
    for name in _FIGURES:
        values = np.where(found.on_line & ~(steps & (name in _OF_STEP)), getattr(own, name), -np.inf)
        worst = np.maximum.reduceat(np.where(np.isnan(values), -np.inf, values), begin)
        getattr(results, name)[:] = np.where(np.isneginf(worst), np.nan, worst)
    return results


_SEVERITY = (JUDGED, NOT_AT_REST, LATCHED, SLIPPED, DIVERGED, OVER_LIMIT, NO_REST, TRIPPED, IN_NOISE, BLOCKED)
"""Statuses from the best to the worst; two of the last three are not those of a plant."""

_OF_STEP = ("overshoot", "settling_s", "noise")
_FIGURES = tuple(f.name for f in fields(LaneResults) if f.name not in ("status", "fault"))


def _ends(study: Study, spec: ControllerSpec, ready: Ready, cases: PlantCases, bridge: str) -> NDArray[np.int64]:
    demand = demand_of(study.with_limit_of(spec).converter, settling_time_of(spec, ready))
    return ends_of(study, cases, segments_of(cases), demand, bridge)[0]


def written(
    study: Study, spec: ControllerSpec, ready: Ready, cases: PlantCases, index: int, place: Path, bridge: str
) -> str:
    """The text of a study that is one of the cases, for a file ``place``: its plant is written out unit by unit."""
    name = f"{study.name}_{place.stem}".replace("-", "_")
    document, _ = base_document(study, spec, place.parent, name, f"{study.title}: {place.stem.replace('-', ' ')}")
    own = study_of_plant(study, cases, index, int(_ends(study, spec, ready, cases.take(np.array([index])), bridge)[0]))
    plant, c = plant_of(own), study.converter
    of_plant = document.pop("plant", {})
    document["grid"] = {
        "scr_basis": study.scr_basis,
        "R_g": own.grid.R_g,
        "L_g": own.grid.L_g,
        "V_g_pu": study.grid_source.V_g_rms / c.V_rated_rms,
        "f_g": study.grid_source.omega_g / (2.0 * math.pi),
    }
    document["network"] = {
        "nodes": [{"name": node} for node in plant.nodes],
        "units": [
            {"name": one.name, "node": one.node, "P_ref": one.P_ref, "Q_ref": one.Q_ref}
            | {key: of_plant[key] for key in ("reactance", "resistance") if key in of_plant}
            for one in plant.units
        ],
    }
    if plant.elements:
        of = ({"name": e.name, "from": e.start, "to": e.end, "L": e.L} for e in plant.elements)
        document["network"]["branches"] = list(of)
    simulation = own.simulation
    document["simulation"] = {
        "duration": simulation.duration,
        "bridge": bridge,
        "log_interval": simulation.log_interval,
        "reference_limit_pu": 100.0,  # the droops take away what a reference is beyond the drawn power
        "P_ref": simulation.P_ref,
        "Q_ref": simulation.Q_ref,
    } | ({"survival": True} if simulation.survival else {})
    told = float(cases.error_R[index]), float(cases.error_X[index]), float(cases.silent_s[index])
    table = None if ready.table(spec) is None else f"../{TABLE}"
    knowledge = GridEstimate(*told) if any(told) else None
    document["controllers"] = [controller_document(study, spec, document, knowledge, table)]
    document["events"] = [event.document(c) for event in own.events]
    return toml_text(document, (document["study"]["title"],))


def simulated(path: Path, ready: Ready) -> SingleRun:
    """The study of a case as ``vsgdesign simulate`` runs it, with the figures of its worst unit."""
    controller = run_plant(load_study(path), ready).controllers[0]
    last = controller.rests[-1]
    on_line = [
        one
        for unit, one in zip(controller.timeline.plant.units, controller.units, strict=True)
        if unit.name in last.on_line
    ]
    figures: dict[str, float] = {}
    for one in on_line:
        for name, value in figures_of_run(one).items():
            figures[name] = max(value, figures.get(name, value))
    P, Q = (float(np.mean([one.simulation.column(name)[0] for one in controller.units])) for name in ("P", "Q"))
    return SingleRun(figures, P, Q, -float(last.modes[0].s.real) if last.modes else math.nan)


def share_seen(cases: LaneCases) -> float:
    """The share of the impedance of the grid with all units on line that a unit sees in the first case."""
    return float(cases.units[0]) / cases.P_apart.shape[1] if isinstance(cases, PlantCases) else 1.0


PLANTS = Batch(draw_plants, plants_of, run_drawn, instruction_set, written, simulated, len(OF_PLANT), share_seen)
"""How the cases of a plant are drawn and run."""

__all__ = ["OF_PLANT", "PLANTS", "PlantCases", "draw_plants", "plants_of", "run_drawn", "study_of_plant"]
