"""Builds each part of a Study from its TOML section. The limits of every field stand here.

The limits are plausibility limits: wide enough for any real converter, narrow enough that a wrong unit
(1 for 1 mH) falls outside.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from vsgdesign.equations.filters import FilterGrid, filter_grid_derivative
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import CIRCULAR, LIMITERS
from vsgdesign.errors import Fault
from vsgdesign.frames import ll_to_phase, rms_to_peak
from vsgdesign.identification.registry import ESTIMATORS
from vsgdesign.parameters.background import read_background
from vsgdesign.parameters.controllers import read_controllers, read_limit, read_limiter, read_target
from vsgdesign.parameters.converter import Converter, Filter
from vsgdesign.parameters.estimator import read_estimator
from vsgdesign.parameters.events import read_events
from vsgdesign.parameters.grid import Grid
from vsgdesign.parameters.inner_loops import InnerLoopSource, read_inner_loops, request_of
from vsgdesign.parameters.plausible import check_plausible
from vsgdesign.parameters.reader import Asked, TableReader
from vsgdesign.parameters.replay import read_replay
from vsgdesign.parameters.scenario import read_components, read_grid, read_network, read_simulation
from vsgdesign.parameters.sensors import read_sensors
from vsgdesign.parameters.source import GridSource
from vsgdesign.parameters.specification import read_specification
from vsgdesign.parameters.stability import StabilitySpec, read_stability
from vsgdesign.parameters.study import NOTCH_DAMPING, POWER_FILTERS, ClosedFormTarget, Event, InnerLoopRequest, Study
from vsgdesign.parameters.survival import read_survival
from vsgdesign.parameters.verification import read_verification

SCHEMA = 1


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
    name, title, source = _read_identity(root.child("study"), default_name)
    converter_table = root.section("converter")
    current_limiter = converter_table.choice("current_limiter", tuple(LIMITERS), default=CIRCULAR.name)
    limiter_table = converter_table.child("limiter")
    converter = _read_converter(converter_table)
    filter_ = _read_filter(root.section("filter"))
    check_plausible(converter, filter_, faults)
    limiter_given = read_limiter(limiter_table, LIMITERS[current_limiter], converter, filter_)
    inner = read_inner_loops(root.child("inner_loops"), filter_, converter)
    grid_table = root.section("grid")
    grid, source_, basis = _read_grid_section(grid_table, converter)
    power = root.child("power_loops") or TableReader({}, "power_loops", faults)
    tau_P = power.quantity("tau_P", "s", 0.0, 1.0, default=0.0)
    tau_Q = power.quantity("tau_Q", "s", 0.0, 1.0, default=0.0)
    power_filter = power.choice("power_filter", POWER_FILTERS, default="low_pass")
    notch_damping = power.quantity("notch_damping", "1", 0.05, 2.0, default=NOTCH_DAMPING)
    if power_filter == "low_pass" and power.has("notch_damping"):
        power.fault("notch_damping", power.table["notch_damping"], "there is no notch", 'Add power_filter = "notch".')
    default_target = ClosedFormTarget(
        settling_time=1.0, damping_ratio=1.0, droop_ratio=0.01, P=converter.S_rated * 0.9, Q=converter.S_rated * 0.2
    )
    target = read_target(power, default_target, converter)
    power.finish()
    simulation = read_simulation(root.section("simulation"), converter)
    network = read_network(root.child("network"), converter)
    events = read_events(root.children("events"), grid, basis, converter, simulation, source_, network)
    _check_resonance(filter_, converter, [grid, *(event.grid for event in events if event.grid)], faults)
    controllers = read_controllers(
        root, target, grid, basis, converter, filter_, (current_limiter, limiter_given), simulation
    )
    specification = read_specification(root.child("specification"), converter, source_, target, basis)
    slowest = target.settling_time if specification is None else specification.settling_time
    stability = read_stability(root.child("stability"), converter, target, slowest)
    estimator = read_estimator(root.child("estimator"))
    by_sample = [spec for spec in controllers if spec.estimate != "truth" and ESTIMATORS[spec.estimate].by_sample]
    if estimator is not None and estimator.probe is not None and not by_sample:
        root.fault(
            "estimator.probe", None, "no controller has a field estimator", 'Set estimate = "field", or leave it.'
        )
    survival = read_survival(root.child("survival"))
    maps = _axes_given(root, stability)
    verification = read_verification(root.child("verification"), converter, source_, specification, maps, basis)
    background, sensors = read_background(root.child("background")), read_sensors(root.child("sensors"))
    replay = read_replay(root.child("replay"), converter, simulation.duration)
    if root.has("replay"):
        _check_replay(root, faults)
    if simulation.survival:
        _check_survival(root, source_, events)
    root.finish()
    inner_gains, omega_t, request = inner.gains, inner.omega_t, None
    if inner_gains is None:
        request = request_of(inner, converter, filter_, basis, target, specification)
        inner_gains, omega_t = _designed(request, inner_loops, faults)
    return Study(
        name=name,
        title=title,
        source=source,
        converter=converter,
        filter=filter_,
        inner_gains=inner_gains,
        grid=grid,
        grid_source=source_,
        scr_basis=basis,
        network=network,
        target=target,
        tau_P=tau_P,
        tau_Q=tau_Q,
        power_filter=power_filter,
        notch_damping=notch_damping,
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
    )


def _read_schema(root: TableReader) -> None:
    """The version of the format, of which there is one."""
    root.integer("schema", SCHEMA, SCHEMA, default=SCHEMA)
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


def _check_survival(root: TableReader, source: GridSource, events: tuple[Event, ...]) -> None:
    """A scenario is judged as one disturbance only where powers come to rest."""
    advice = "Leave survival out, or take that away. vsgdesign survive judges such grids."
    restless = [f"[{name}]" for name in ("background", "sensors", "replay") if root.has(name)]
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
                "Open the study with vsgdesign.pipeline.open_study, or give the gains.",
            )
        )
    return InnerLoopGains(*[math.nan] * 4), math.nan


def _read_identity(table: TableReader | None, default_name: str) -> tuple[str, str, str]:
    if table is None:
        return default_name, default_name, ""
    name = table.identifier("name", default=default_name)
    title = table.text("title", default=name)
    source = table.text("source", default="")
    table.finish()
    return name, title, source


def _read_converter(table: TableReader) -> Converter:
    S_rated = table.quantity("S_rated", "VA", 10.0, 1e10)
    if table.one_of(("V_rated_ll_rms",), ("V_rated_rms",)) == ("V_rated_rms",):
        V_rated_rms = table.quantity("V_rated_rms", "V", 5.0, 5e5)
    else:
        V_rated_rms = ll_to_phase(table.quantity("V_rated_ll_rms", "V", 10.0, 1e6)) if table.table else math.nan
    f_n = table.quantity("f_n", "Hz", 10.0, 1000.0)
    V_dc = table.quantity("V_dc", "V", 10.0, 1e6)
    f_sw = table.quantity("f_sw", "Hz", 300.0, 1e6)
    converter = Converter(
        S_rated=S_rated,
        V_rated_rms=V_rated_rms,
        omega_n=2.0 * math.pi * f_n,
        V_dc=V_dc,
        f_sw=f_sw,
        samples_per_carrier=table.integer("samples_per_carrier", 1, 64, default=2),
        delay_samples=table.integer("delay_samples", 0, 1, default=1),
        zero_sequence=table.choice("modulation", ("sine_triangle", "min_max"), default="sine_triangle") == "min_max",
        current_limit_pu=read_limit(table),
        V_min_pu=table.quantity("V_min_pu", "1", 0.0, 1.0, default=0.85),
        V_max_pu=table.quantity("V_max_pu", "1", 1.0, 3.0, default=1.25),
    )
    if rms_to_peak(V_rated_rms) > converter.v_max_pk:
        table.fault(
            "V_dc",
            f"{V_dc:.6g} V",
            f"too low: the bridge makes at most {converter.v_max_pk:.4g} V peak and the rated voltage is "
            f"{rms_to_peak(V_rated_rms):.4g} V peak",
            'Raise V_dc, or set modulation = "min_max" (+15 %).',
        )
    if f_sw * converter.samples_per_carrier < 20.0 * f_n:
        table.fault("f_sw", f"{f_sw:.6g} Hz", f"samples fewer than 20 times a cycle of {f_n:.6g} Hz", "Raise f_sw.")
    table.finish()
    return converter


def _read_filter(table: TableReader) -> Filter:
    kind = table.choice("kind", ("LC", "LCL"))
    filter_ = Filter(
        L_1=table.quantity("L_1", "H", 1e-7, 0.5),
        R_1=table.quantity("R_1", "ohm", 0.0, 100.0),
        C=table.quantity("C", "F", 1e-8, 0.1),
        R_c=table.quantity("R_c", "ohm", 0.0, 1000.0, default=0.0),
        L_2=table.quantity("L_2", "H", 1e-7, 0.5) if kind == "LCL" else 0.0,
        R_2=table.quantity("R_2", "ohm", 0.0, 100.0) if kind == "LCL" else 0.0,
    )
    if kind == "LC":
        for field in ("L_2", "R_2"):
            if table.has(field):
                table.fault(field, table.table[field], "an LC filter has none", 'Set kind = "LCL" or remove it.')
                table.quantity(field, "H" if field == "L_2" else "ohm")
    table.finish()
    return filter_


def _check_resonance(filter_: Filter, converter: Converter, grids: list[Grid], faults: list[Fault]) -> None:
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


def _read_grid_section(table: TableReader, converter: Converter) -> tuple[Grid, GridSource, str]:
    basis = table.choice("scr_basis", tuple(SCR_BASES), default="impedance")
    grid = read_grid(table, converter, basis, None)
    V_g_rms = table.quantity("V_g_pu", "1", 0.1, 2.0, default=1.0) * converter.V_rated_rms
    f_n = converter.omega_n / (2.0 * math.pi)
    f_g = table.quantity("f_g", "Hz", 0.8 * f_n, 1.2 * f_n, default=f_n)
    components = read_components(table.children("components"))
    table.finish()
    return grid, GridSource(V_g_rms, 2.0 * math.pi * f_g, components), basis
