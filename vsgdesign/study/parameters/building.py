"""Builds a Study of its TOML sections, and checks what several sections say together.

The limits of all fields are plausibility limits: wide enough for any real converter, narrow enough that a wrong unit
(1 for 1 mH) falls outside.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from vsgdesign.equations.grid import FilterGrid, filter_grid_derivative
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import LIMITERS
from vsgdesign.equations.placing import settling_margin
from vsgdesign.errors import Fault
from vsgdesign.identification.interface import ESTIMATORS
from vsgdesign.study.parameters.background import BACKGROUND, BackgroundSpec, read_background
from vsgdesign.study.parameters.controllers import CONTROLLER, mean_time, read_controllers, read_limiter
from vsgdesign.study.parameters.converter import (
    CONVERTER,
    FILTER,
    Converter,
    Filter,
    LimiterChoice,
    check_plausible,
    read_converter,
    read_filter,
    scope_of,
)
from vsgdesign.study.parameters.dc_link import DC, check_links, read_dc
from vsgdesign.study.parameters.estimator import EstimatorSpec, read_estimator
from vsgdesign.study.parameters.events import event_fields, read_events
from vsgdesign.study.parameters.fields import (
    DURATION,
    F_N,
    V_RATED,
    Scope,
    fields_of,
    number,
    picked,
    subtable,
    text,
    values,
    whole,
)
from vsgdesign.study.parameters.grid import Grid, GridSource, Impedance, basis_field, read_grid
from vsgdesign.study.parameters.inner_loops import INNER_LOOPS, InnerLoopSource, read_inner_loops, request_of
from vsgdesign.study.parameters.power_plant import with_path
from vsgdesign.study.parameters.power_plant_fields import NETWORK, PlantFields
from vsgdesign.study.parameters.power_plant_reading import (
    Around,
    check_estimators,
    check_plant,
    on_all_units,
    read_plant,
    units_asked,
)
from vsgdesign.study.parameters.reader import REQUIRED, Asked, TableReader
from vsgdesign.study.parameters.replay import ReplayFields, read_replay
from vsgdesign.study.parameters.scenario import (
    Component,
    SimulationSpec,
    read_components,
    read_network,
    read_simulation,
)
from vsgdesign.study.parameters.sensors import SENSORS, SensorSpec, read_sensors
from vsgdesign.study.parameters.specification import (
    SPECIFICATION,
    StabilitySpec,
    SurvivalSpec,
    default_axes,
    of_a_unit,
    read_specification,
    read_stability,
    read_survival,
)
from vsgdesign.study.parameters.study import Event, InnerLoopRequest, Study
from vsgdesign.study.parameters.targets import POWER_LOOPS, Filters, read_target
from vsgdesign.study.parameters.verification import read_verification, verification_fields

SCHEMA = 1


_BELOW = "the defaults below"


class Identity:
    """The fields of [study]."""

    name: str = text(
        kind="name",
        limits="letters, digits, `-` `_` `.`, a name of a file; at most 100 bytes",
        shown="the file's name, or its folder's for `study.toml`",
    )
    """Short name."""
    title: str = text(limits="not empty", shown="`name`")
    """Title of reports."""
    source: str = text(limits="not empty", default="", shown="none")
    """Where the data are from."""


class _Basis:
    """What SCR is taken on."""

    scr_basis: str = basis_field(default="impedance")
    """What every `scr` in the file is taken on (:eq:`scr`)."""


class _Source:
    """The source behind the grid's impedance."""

    V_g_rms: float = number("1", 0.1, 2.0, default=1.0, name="V_g_pu", scale=V_RATED)
    """Source voltage, pu of rated."""
    omega_g: float = number("Hz", 0.8 * F_N, 1.2 * F_N, default=F_N, shown="`f_n`", name="f_g", scale=2.0 * math.pi)
    """Source frequency."""


class _Components:
    """What the source contains besides."""

    components: Any = subtable(Component, kind="tables", shown="none")
    """Negative sequence and harmonics of the source."""


GRID = tuple(one for of in (_Basis, Impedance, _Source, _Components) for one in fields_of(of))
"""The fields of [grid]."""


class Sections:
    """The top level of a study file."""

    base: str | None = text(default=None)
    """Another document underneath this one."""
    schema: int = whole(SCHEMA, SCHEMA, default=SCHEMA)
    """Version of this format."""
    study: Any = subtable(Identity)
    """Identity."""
    converter: Any = subtable(CONVERTER, default=REQUIRED)
    """Ratings, bridge, sampling."""
    filter: Any = subtable(FILTER, default=REQUIRED)
    """LC or LCL filter."""
    inner_loops: Any = subtable(INNER_LOOPS, shown="designed")
    """Voltage and current loop."""
    grid: Any = subtable(GRID, default=REQUIRED)
    """Grid at t = 0."""
    network: Any = subtable(NETWORK, shown="plain")
    """Load, fault and breaker at t = 0, and the network of a plant."""
    plant: Any = subtable(PlantFields, shown="one converter")
    """Several equal converters at one node."""
    power_loops: Any = subtable(POWER_LOOPS, shown="all defaults")
    """Structure and design target of the power loops."""
    simulation: Any = subtable(SimulationSpec, default=REQUIRED)
    """One EMT run."""
    controllers: Any = subtable(CONTROLLER, kind="tables", default=REQUIRED, limits="at least one")
    """What to simulate and compare."""
    events: Any = subtable(event_fields, kind="tables")
    """What changes, and when."""
    stability: Any = subtable(StabilitySpec, shown=_BELOW)
    """Axes of the margin maps, and gates."""
    specification: Any = subtable(SPECIFICATION)
    """What a designed gain table has to keep, and over what."""
    estimator: Any = subtable(EstimatorSpec)
    """The network that estimates the grid for controllers with `estimate = "neural"`."""
    survival: Any = subtable(SurvivalSpec, shown=_BELOW)
    """Random disturbances of a survival measurement."""
    verification: Any = subtable(verification_fields, shown=_BELOW)
    """Random cases with which promises are tested."""
    background: Any = subtable(BACKGROUND)
    """What the voltage of a real grid does besides the events."""
    sensors: Any = subtable(SENSORS, shown="ideal")
    """Noise, bits and errors between the circuit and the controller."""
    replay: Any = subtable(ReplayFields)
    """A recorded voltage as the source."""
    dc: Any = subtable(DC, shown="ideal")
    """The capacitor of the dc link and what feeds it."""


def build_study(
    document: dict[str, Any],
    default_name: str,
    content_hash: str,
    faults: list[Fault],
    inner_loops: InnerLoopSource | None = None,
    asked: dict[str, Asked] | None = None,
) -> Study:
    """A Study from a merged document. Faults are appended; the result is meaningless if there are any.

    ``inner_loops`` is asked for gains where the study leaves them to be designed; without it that is a fault.
    ``asked`` collects every quantity that is read, by its full name.
    """
    root = TableReader(document, "", faults, asked)
    _read_schema(root)
    identity = _read_identity(root.child("study"), default_name)
    converter_table = root.section("converter")
    current_limiter = values(picked(LimiterChoice, "current_limiter"), converter_table)["current_limiter"]
    limiter_table = converter_table.child("limiter")
    converter = read_converter(converter_table)
    scope = scope_of(converter)
    filter_ = read_filter(root.section("filter"))
    check_plausible(converter, filter_, faults)
    limiter_given = read_limiter(limiter_table, LIMITERS[current_limiter], converter, filter_)
    inner = read_inner_loops(root.child("inner_loops"), scope, filter_, converter)
    of_grid = on_all_units(converter, units_asked(root))
    grid, source_, basis = _read_grid_section(root.section("grid"), scope, of_grid)
    power = root.child("power_loops") or TableReader({}, "power_loops", faults)
    filters = values(Filters, power)
    if filters["power_filter"] == "low_pass" and power.has("notch_damping"):
        power.fault("notch_damping", power.table["notch_damping"], "there is no notch", 'Add power_filter = "notch".')
    target = read_target(power, scope)
    power.finish()
    simulation = read_simulation(root.section("simulation"), converter)
    scope = scope_of(converter, simulation.reference_limit_pu) | {DURATION.of: simulation.duration}
    network_table = root.child("network")
    network = read_network(network_table, converter)
    case = functools.partial(_case_of_unit, document, default_name)
    dc = read_dc(root.child("dc"), converter)
    plant = read_plant(root, network_table, Around(converter, scope, simulation.P_ref, simulation.Q_ref, case, dc))
    if network_table is not None:
        network_table.finish()
    elements = None if plant is None else plant.names
    events = read_events(root.children("events"), scope, grid, basis, of_grid, source_, network, elements)
    if plant is None:
        check_resonance(filter_, converter, [grid, *(event.grid for event in events if event.grid)], faults)
    limiter, made_for = (current_limiter, limiter_given), grid if plant is None else None
    controllers = read_controllers(root, scope, target, made_for, basis, converter, filter_, limiter)
    specification_table = root.child("specification")
    specification = read_specification(specification_table, scope, converter, source_, target, basis)
    if specification is not None and specification_table is not None and plant is not None:
        specification = of_a_unit(specification, specification_table, plant)
    slowest = target.settling_time if specification is None else specification.settling_time
    axes = default_axes(specification, converter, basis)
    stability = read_stability(root.child("stability"), scope, target, slowest, axes)
    estimator = read_estimator(root.child("estimator"))
    by_sample = [spec for spec in controllers if spec.estimate != "truth" and ESTIMATORS[spec.estimate].by_sample]
    if estimator is not None and estimator.probe is not None and not by_sample:
        root.fault(
            "estimator.probe", None, "no controller has a field estimator", 'Set estimate = "field", or leave it.'
        )
    survival = read_survival(root.child("survival"))
    maps = _axes_given(root, stability)
    verification = read_verification(root.child("verification"), scope, converter, source_, specification, maps, basis)
    background, sensors = read_background(root.child("background")), read_sensors(root.child("sensors"))
    if plant is not None:
        check_plant(root, plant, network, events)
        if by_sample:
            check_estimators(root, plant, None if estimator is None else estimator.probe)
    replay = read_replay(root.child("replay"), converter, simulation.duration)
    if root.has("replay"):
        _check_replay(root, faults)
    check_links(root, dc, plant, events, verification.families)
    if simulation.survival:
        _check_survival(root, source_, events, background, sensors)
    root.finish()
    inner_gains, omega_t, request = inner.gains, inner.omega_t, None
    if inner_gains is None:
        alike = plant is not None and plant.equal
        own = with_path(filter_, plant.units[0]) if plant is not None and alike else filter_
        several = plant is not None and alike and len(plant.units) > 1
        request = request_of(inner, converter, own, basis, target, specification, several)
        inner_gains, omega_t = _designed(request, inner_loops, faults)
    if not faults:
        error = 0.0 if specification is None else specification.error
        placing = mean_time(controllers, converter), settling_margin(error)
        target = target.placed(*placing)
        controllers = tuple(replace(one, target=one.target.placed(*placing)) for one in controllers)
    return Study(
        **identity,
        **filters,
        converter=converter,
        filter=filter_,
        inner_gains=inner_gains,
        grid=grid,
        grid_source=source_,
        scr_basis=basis,
        network=network,
        plant=plant,
        target=target,
        omega_t=omega_t,
        controllers=controllers,
        simulation=simulation,
        events=events,
        stability=stability,
        hash=content_hash,
        specification=specification,
        estimator=estimator,
        inner_request=request,
        current_limiter=current_limiter,
        limiter_given=limiter_given,
        survival=survival,
        verification=verification,
        background=background,
        sensors=sensors,
        replay=replay,
        dc=dc,
    )


_OF_CASE = ("converter", "filter", "inner_loops", "power_loops", "dc")
"""Sections that a unit of a plant takes from its case."""

_OF_STUDY = ("grid", "simulation", "controllers", "specification", "estimator")
"""And from its study."""


def _case_of_unit(
    document: Mapping[str, Any], default_name: str, case: Mapping[str, Any], table: TableReader
) -> Study | None:
    """The study with the converter, filter, inner loops and power loops of a case. Its faults are those of the unit."""
    rest = {name: document[name] for name in _OF_STUDY if name in document}
    own = {name: case[name] for name in _OF_CASE if name in case}
    faults: list[Fault] = []
    study = build_study({**rest, **own}, default_name, "", faults)
    for one in faults:
        table.fault(f"case: {one.field}", None, one.problem, one.advice)
    if faults:
        return None
    specs = zip(study.controllers, document["controllers"], strict=True)  # their grid is the one that the unit sees
    own_grid = tuple(one if "design_grid" in given else replace(one, design_grid=None) for one, given in specs)
    return replace(study, controllers=own_grid)


def _read_schema(root: TableReader) -> None:
    """The version of the format, of which there is one."""
    values(picked(Sections, "schema"), root)
    written = root.table.get("schema")
    if isinstance(written, int) and not isinstance(written, bool) and written > SCHEMA:
        root.faults.pop()  # it has a better answer than its limits
        problem = f"must be a whole number from {SCHEMA} to {SCHEMA}: this version of vsgdesign reads no newer format"
        root.fault("schema", written, problem, "Install a newer version, or write the study in this format.")


def _axes_given(root: TableReader, stability: StabilitySpec) -> dict[str, tuple[float, ...]]:
    """The axes of the margin maps that the study itself gives."""
    written = root.table.get("stability")
    names = [name for name in ("scr", "x_over_r", "P", "Q") if isinstance(written, dict) and name in written]
    return {name: getattr(stability, name) for name in names}


def _check_survival(
    root: TableReader,
    source: GridSource,
    events: tuple[Event, ...],
    background: BackgroundSpec | None,
    sensors: SensorSpec | None,
) -> None:
    """A scenario is judged as one disturbance only where powers come to rest: in a background that does not move, by
    the rest to which the run itself comes."""
    advice = "Leave survival out, or take that away. vsgdesign survive judges such grids."
    restless = ["[replay]"] if root.has("replay") else []
    if background is not None and background.restless:
        restless.append("a [background] that wanders")
    if sensors is not None and sensors.act and (background is None or not background.distorts):
        restless.append("[sensors] and no distorted [background]")
    held = [source.components, *(event.components for event in events if event.components is not None)]
    if held[0] or held[-1]:  # powers must be at rest before and after the events
        restless.append("components of the source")
    for what in restless:
        root.fault("simulation.survival", "true", f"powers do not come to rest with {what}", advice)
    if not any(event.t_s > 0.0 for event in events):
        root.fault("simulation.survival", "true", "nothing happens after t = 0", "Add an event, or leave it out.")


def _check_replay(root: TableReader, faults: list[Fault]) -> None:
    """Beside a record, nothing else may say what the source does."""
    advice = "The record says it: take it away, or take [replay] away."
    if root.has("background"):
        faults.append(Fault("background", "", "there is a recorded source, [replay]", advice))
    events = root.table.get("events", [])
    tables = [("grid", root.table.get("grid")), *((f"events[{k}]", one) for k, one in enumerate(events))]
    for path, table in tables:
        for field in ("V_g_pu", "f_g", "phase_jump", "components", "sag", "over"):
            if isinstance(table, dict) and field in table:
                faults.append(
                    Fault(f"{path}.{field}", str(table[field]), "there is a recorded source, [replay]", advice)
                )


def _designed(
    request: InnerLoopRequest, source: InnerLoopSource | None, faults: list[Fault]
) -> tuple[InnerLoopGains, float]:
    """The gains of a request; meaningless where there are faults, since then there is nothing to design for."""
    if source is not None and not faults:
        return source(request)
    if not faults:
        faults.append(
            Fault(
                "inner_loops",
                "",
                "the gains are to be designed, but load_study does not design gains",
                "Open the study with vsgdesign.verbs.pipeline.open_study, or give the gains.",
            )
        )
    return InnerLoopGains(*[math.nan] * 4), math.nan


def _read_identity(table: TableReader | None, default_name: str) -> dict[str, str]:
    name = values(picked(Identity, "name"), table, defaults={"name": default_name})
    rest = values(picked(Identity, "title", "source"), table, defaults={"title": name["name"]})
    if table is not None:
        table.finish()
    return name | rest


def check_resonance(filter_: Filter, converter: Converter, grids: list[Grid], faults: list[Fault]) -> None:
    """On every grid of the study the circuit must ring below half the sampling rate."""
    if faults:
        return  # the values may not be numbers
    ringing = [np.abs(np.linalg.eigvals(_circuit_matrix(filter_, grid)).imag).max() for grid in grids]
    resonance_hz = float(max(ringing)) / (2.0 * math.pi)
    nyquist_hz = 0.5 / converter.T_s
    if resonance_hz > nyquist_hz:
        problem = (
            f"it resonates with L_1 and the strongest grid at {resonance_hz:.4g} Hz, above half the sampling "
            f"frequency ({nyquist_hz:.4g} Hz)"
        )
        faults.append(Fault("filter.C", f"{filter_.C:.4g} F", problem, "Sample faster, or enlarge L_1 or C."))


def _circuit_matrix(f: Filter, grid: Grid) -> np.ndarray:
    circuit = FilterGrid(f.L_1, f.R_1, f.C, f.R_c, f.L_2, f.R_2, grid.R_g, grid.L_g)
    columns = [filter_grid_derivative(u[0], u[1], u[2], 0.0, 0.0, circuit) for u in np.eye(3)]
    return np.array(columns, dtype=float).T


def _read_grid_section(table: TableReader, scope: Scope, converter: Converter) -> tuple[Grid, GridSource, str]:
    basis = values(_Basis, table)["scr_basis"]
    grid = read_grid(table, scope, converter, basis, None)
    source = values(_Source, table, scope)
    components = read_components(table.children("components"))
    table.finish()
    return grid, GridSource(**source, components=components), basis
