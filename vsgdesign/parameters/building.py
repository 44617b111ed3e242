"""Builds each part of a Study from its TOML section. The limits of every field stand here.

The limits are plausibility limits: wide enough for any real converter, narrow enough that a wrong unit
(1 for 1 mH) falls outside.
"""

from __future__ import annotations

import math
import unicodedata
from dataclasses import replace
from typing import Any

import numpy as np

from vsgdesign.equations.closed_form import paced
from vsgdesign.equations.filters import FilterGrid, filter_grid_derivative
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.limiters import CIRCULAR, LIMITERS, KnownRatings, Limiter
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import Fault
from vsgdesign.frames import ll_to_phase, rms_to_peak
from vsgdesign.identification.registry import ESTIMATORS, needs_network
from vsgdesign.identification.sampling import window_of_rate
from vsgdesign.parameters.background import read_background
from vsgdesign.parameters.estimator import read_estimator
from vsgdesign.parameters.inner_loops import InnerLoopSource, read_inner_loops, request_of
from vsgdesign.parameters.reader import REQUIRED, TableReader
from vsgdesign.parameters.replay import read_replay
from vsgdesign.parameters.scenario import read_components, read_events, read_grid, read_simulation
from vsgdesign.parameters.sensors import read_sensors
from vsgdesign.parameters.specification import read_specification
from vsgdesign.parameters.stability import read_stability
from vsgdesign.parameters.study import (
    NO_LIMITER,
    NOTCH_DAMPING,
    POWER_FILTERS,
    UPDATE_PERIOD,
    ClosedFormTarget,
    ControllerSpec,
    Converter,
    Filter,
    Grid,
    GridSource,
    InnerLoopRequest,
    Study,
    limiter_ratings,
)
from vsgdesign.parameters.survival import read_survival
from vsgdesign.parameters.units import format_quantity

SCHEMA = 1


def build_study(
    document: dict[str, Any],
    default_name: str,
    content_hash: str,
    faults: list[Fault],
    inner_loops: InnerLoopSource | None = None,
) -> Study:
    """A Study from a merged document. Faults are appended; the result is meaningless if there are any.

    ``inner_loops`` is asked for gains where the study leaves them to be designed; without it that is a fault.
    """
    root = TableReader(document, "", faults)
    root.integer("schema", SCHEMA, SCHEMA, default=SCHEMA)
    name, title, source = _read_identity(root.child("study"), default_name)
    converter_table = root.section("converter")
    current_limiter = converter_table.choice("current_limiter", tuple(LIMITERS), default=CIRCULAR.name)
    limiter_table = converter_table.child("limiter")
    converter = _read_converter(converter_table)
    filter_ = _read_filter(root.section("filter"))
    limiter_given = _read_limiter(limiter_table, LIMITERS[current_limiter], converter, filter_)
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
    target = _read_target(power, default_target, converter)
    power.finish()
    simulation = read_simulation(root.section("simulation"), converter)
    events = read_events(root.children("events"), grid, basis, converter, simulation)
    _check_resonance(filter_, converter, [grid, *(event.grid for event in events if event.grid)], faults)
    controllers = _read_controllers(
        root, target, grid, basis, converter, filter_, (current_limiter, limiter_given), simulation
    )
    specification = read_specification(root.child("specification"), converter, source_, target, basis)
    asked = target.settling_time if specification is None else specification.settling_time
    stability = read_stability(root.child("stability"), converter, target, asked)
    estimator = read_estimator(root.child("estimator"))
    by_sample = [spec for spec in controllers if spec.estimate != "truth" and ESTIMATORS[spec.estimate].by_sample]
    if estimator is not None and estimator.probe is not None and not by_sample:
        root.fault(
            "estimator.probe", None, "no controller has a field estimator", 'Set estimate = "field", or leave it.'
        )
    survival = read_survival(root.child("survival"))
    background, sensors = read_background(root.child("background")), read_sensors(root.child("sensors"))
    replay = read_replay(root.child("replay"), converter, simulation.duration)
    if root.has("replay"):
        _check_replay(root, faults)
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
        background=background,
        sensors=sensors,
        replay=replay,
    )


def _check_replay(root: TableReader, faults: list[Fault]) -> None:
    """Beside a record, nothing else may say what the source does."""
    advice = "The record says it: take it away, or take [replay] away."
    if root.has("background"):
        faults.append(Fault("background", "", "there is a recorded source, [replay]", advice))
    events = root.table.get("events", [])
    tables = [("grid", root.table.get("grid")), *((f"events[{k}]", one) for k, one in enumerate(events))]
    for path, table in tables:
        for field in ("V_g_pu", "f_g", "phase_jump", "components", "over"):
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
        current_limit_pu=_read_limit(table),
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


def _read_limit(table: TableReader) -> float | None:
    return table.quantity("current_limit_pu", "1", 0.5, 20.0, default=None)


def _read_limiter(
    table: TableReader | None,
    limiter: Limiter,
    converter: Converter,
    filter_: Filter,
    inherited: tuple[tuple[str, float], ...] = (),
) -> tuple[tuple[str, float], ...]:
    """The parameters of a current limiter that are set: those of its table, else those that it inherits."""
    if table is None:
        return inherited
    if converter.current_limit_pu is None and table.table:
        table.fault("", None, "there is no current limit", "Give current_limit_pu.")
    ratings = limiter_ratings(converter, filter_)
    values: dict[str, float] = {}
    for parameter in limiter.parameters:
        known = KnownRatings(ratings, values)
        default = dict(inherited).get(parameter.name, parameter.default(known))
        low, high = parameter.low(known), parameter.high(known)
        values[parameter.name] = table.quantity(parameter.name, parameter.unit, low, high, default)
        if parameter.name in dict(inherited) and not table.has(parameter.name) and not low <= default <= high:
            limits = f"outside {format_quantity(low, parameter.unit)} to {format_quantity(high, parameter.unit)}"
            value = format_quantity(default, parameter.unit)
            table.fault(parameter.name, value, f"{limits} with this controller's limit", "Give it its own value.")
    for field in table.table:
        if field not in values:
            advice = f'current_limiter = "{limiter.name}" {limiter.has_parameters}.'
            table.fault(field, None, "unknown parameter", advice)
    return tuple((name, value) for name, value in values.items() if table.has(name) or name in dict(inherited))


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


def _read_target(table: TableReader, default: ClosedFormTarget, converter: Converter) -> ClosedFormTarget:
    limit = 2.0 * converter.S_rated
    structure = table.choice("structure", tuple(STRUCTURES), default=default.structure)
    settling_time = table.quantity("settling_time", "s", 0.01, 1000.0, default=default.settling_time)
    k_1, d_1, k_2 = paced(default.k_1, default.d_1, default.k_2, default.settling_time / settling_time)
    at = table.choice("operating_point", ("design", "reference"), default=_operating_point(default, structure))
    return ClosedFormTarget(
        settling_time=settling_time,
        damping_ratio=table.quantity("damping_ratio", "1", 0.05, 20.0, default=default.damping_ratio),
        droop_ratio=table.quantity("droop_ratio", "1", 0.0, 10.0, default=default.droop_ratio),
        P=table.quantity("P_design", "W", -limit, limit, default=default.P),
        Q=table.quantity("Q_design", "var", -limit, limit, default=default.Q),
        structure=structure,
        k_1=table.quantity("k_1", "1/s²", 1e-3, 1e6, default=k_1),
        d_1=table.quantity("d_1", "1/s", 1e-3, 1e4, default=d_1),
        k_2=table.quantity("k_2", "1/s", 1e-3, 1e4, default=k_2),
        P_droop=table.quantity("P_droop", "1", 0.0, 1.0, default=default.P_droop),
        Q_droop=table.quantity("Q_droop", "1", 0.0, 1.0, default=default.Q_droop),
        share_P=table.quantity("share_P", "1", 0.0, 1.0, default=default.share_P),
        share_Q=table.quantity("share_Q", "1", 0.0, 1.0, default=default.share_Q),
        follow_references=at == "reference",
    )


def _operating_point(default: ClosedFormTarget, structure: str) -> str:
    """As the default target has it, or as another structure has it by itself."""
    same = structure == default.structure or structure not in STRUCTURES  # the reader has told of an unknown name
    follows = default.follow_references if same else STRUCTURES[structure].follows_references
    return "reference" if follows else "design"


_OF_WINDOWS = "an estimator answers at the end of each of its windows, which are whole cycles of the grid"

_OF_CYCLES = "this estimator answers at the end of each of its own cycles, which follow the frequency"

_OF_CLOSED_FORMS = ("settling_time", "damping_ratio", "droop_ratio", "k_1", "d_1", "k_2", "share_P", "share_Q")
"""Targets of a controller that a designed table chooses by itself."""


def _read_controllers(
    root: TableReader,
    target: ClosedFormTarget,
    grid: Grid,
    basis: str,
    converter: Converter,
    filter_: Filter,
    limiter: tuple[str, tuple[tuple[str, float], ...]],
    simulation: Any,
) -> tuple[ControllerSpec, ...]:
    specs: list[ControllerSpec] = []
    for table in root.children("controllers"):
        name = table.identifier("name")
        if name and (taken := _taken(name, [spec.name for spec in specs])) is not None:
            table.fault("name", name, *taken)
        kind = table.choice("kind", ("fixed", "scheduled"))
        own_target = _read_target(table, target, converter)
        own_limiter, own_limit_pu, limiter_given = _read_own_limit(table, converter, filter_, *limiter)
        gains, design_grid, schedule, table_file, estimate = None, None, "closed_form", None, "truth"
        period: float | None = UPDATE_PERIOD
        if kind == "fixed":
            gains_table = table.child("gains")
            if gains_table is not None:
                gains = _read_power_gains(gains_table)
            grid_table = table.child("design_grid")
            if grid_table is not None:
                if gains is not None:
                    table.fault("design_grid", None, "gains are given too", "Give either gains or design_grid.")
                own_basis = grid_table.choice("scr_basis", tuple(SCR_BASES), default=basis)
                design_grid = read_grid(grid_table, converter, own_basis, None)
                grid_table.finish()
            elif gains is None:
                design_grid = grid
        else:
            schedule = table.choice("schedule", ("closed_form", "table"), default="closed_form")
            for field in _OF_CLOSED_FORMS if schedule == "table" else ():
                if table.has(field):
                    table.fault(
                        field,
                        table.table[field],
                        'has no effect with schedule = "table": the table is designed to the [specification]',
                        "Leave it out, or set it there.",
                    )
            table_file = table.text("table", default=None)
            if table_file is not None:
                if schedule != "table":
                    table.fault("table", table_file, 'is used by schedule = "table" alone', 'Add schedule = "table".')
            elif schedule == "table" and not root.has("specification"):
                table.fault(
                    "schedule",
                    schedule,
                    "there is neither a table nor a specification to design one to",
                    'Add a [specification] section, or table = "FILE.json".',
                )
            estimate = table.choice("estimate", ("truth", *ESTIMATORS), default="truth")
            if needs_network(estimate) and not root.has("estimator"):
                table.fault("estimate", estimate, "there is no network to estimate with", "Add an [estimator] section.")
            period = table.quantity("update_period", "s", converter.T_s, simulation.duration, default=None)
            if estimate != "truth" and not needs_network(estimate):
                if period is not None:
                    why = _OF_CYCLES if ESTIMATORS[estimate].by_sample else _OF_WINDOWS
                    table.fault("update_period", f"{period:g} s", why, "Leave it out.")
                period = _window_length(converter)
            elif period is None and estimate == "truth":
                period = _default_update_period(converter)
            steps = 0.0 if period is None else period / converter.T_s
            if not math.isnan(steps) and abs(steps - round(steps)) > 1e-6 * steps:
                table.fault(
                    "update_period",
                    f"{period:.6g} s",
                    f"not a whole number of sampling periods ({converter.T_s:.6g} s)",
                    f"Use {round(steps) * converter.T_s:.9g}.",
                )
        specs.append(
            ControllerSpec(
                name=name,
                kind=kind,
                target=own_target,
                gains=gains,
                design_grid=design_grid,
                update_period=period,
                schedule=schedule,
                table_file=table_file,
                estimate=estimate,
                current_limiter=own_limiter,
                current_limit_pu=own_limit_pu,
                limiter_given=limiter_given,
            )
        )
        table.finish()
    if not specs and root.table.get("controllers", []) == []:
        root.fault(
            "controllers", None, "none given", 'Add [[controllers]] with name and kind = "fixed" or "scheduled".'
        )
    return tuple(specs)


def _read_own_limit(
    table: TableReader,
    converter: Converter,
    filter_: Filter,
    of_study: str,
    given: tuple[tuple[str, float], ...],
) -> tuple[str | None, float | None, tuple[tuple[str, float], ...] | None]:
    """How a controller limits its current, to how much, and with which parameters, where it differs from the study."""
    limiter = table.choice("current_limiter", (NO_LIMITER, *LIMITERS), default=None)
    limit_pu = _read_limit(table)
    limiter_table = table.child("limiter")
    if limiter == NO_LIMITER:
        for field in ("current_limit_pu", "limiter"):
            if table.has(field):
                table.fault(
                    field, table.table[field], f'has no effect with current_limiter = "{NO_LIMITER}"', "Leave it out."
                )
    elif limiter is not None and limit_pu is None and converter.current_limit_pu is None:
        table.fault(
            "current_limiter",
            limiter,
            "has no limit to keep: neither this controller nor the converter gives one",
            "Add current_limit_pu, for example 1.2.",
        )
    if limiter == NO_LIMITER or (limiter_table is None and limit_pu is None and limiter in (None, of_study)):
        return limiter, limit_pu, None
    own = converter if limit_pu is None else replace(converter, current_limit_pu=limit_pu)
    inherited = given if limiter in (None, of_study) else ()
    limiter_table = limiter_table or TableReader({}, table.name("limiter"), table.faults)
    return limiter, limit_pu, _read_limiter(limiter_table, LIMITERS[limiter or of_study], own, filter_, inherited)


def _default_update_period(converter: Converter) -> float:
    """20 ms as published, as near as the control period allows, s."""
    rate = converter.f_sw * converter.samples_per_carrier
    return max(round(UPDATE_PERIOD * rate), 1) / rate if math.isfinite(rate) else UPDATE_PERIOD


def _window_length(converter: Converter) -> float:
    """That of the windows which an estimator without training takes, s; NaN where the converter's data are faulty."""
    if not math.isfinite(converter.T_s * converter.omega_n):
        return math.nan
    plan = window_of_rate(converter.f_sw * converter.samples_per_carrier, converter.omega_n)
    return plan.samples * plan.steps * converter.T_s


def _taken(name: str, others: list[str]) -> tuple[str, str] | None:
    """What is wrong with a name beside others, whose files lie in the same folder, and what to do."""
    if name in others:
        return "used twice", "Give every controller its own name."
    for other in others:
        if _file_name(name) == _file_name(other):
            return f'"{other}" is the same file name on many disks', "Give names that differ in more than their case."
        longer, shorter = sorted((_file_name(name), _file_name(other)), key=len, reverse=True)
        if longer in (f"{shorter}.estimates", f"{shorter}.table"):
            return f'files of "{other}" have the same names', "Give another name."
    return None


def _file_name(name: str) -> str:
    """A name as file systems see it that tell neither case nor composed letters apart."""
    return unicodedata.normalize("NFC", name).casefold()


def _read_power_gains(table: TableReader) -> PowerLoopGains:
    gains = PowerLoopGains(
        K_ip=table.quantity("K_ip", "rad/(s²·W)", 1e-15, 1e6, default=REQUIRED),
        D_p=table.quantity("D_p", "W·s/rad", 0.0, 1e12),
        K_iq=table.quantity("K_iq", "V/(s·var)", 1e-15, 1e6),
        D_q=table.quantity("D_q", "var/V", 0.0, 1e12),
    )
    table.finish()
    return gains
