"""Reads [[controllers]]: what each of them aims at, how it is scheduled and how it limits its current."""

from __future__ import annotations

import math
import unicodedata
from dataclasses import replace
from typing import Any

from vsgdesign.equations.closed_form import paced
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.limiters import LIMITERS, KnownRatings, Limiter
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.identification.registry import ESTIMATORS, needs_network
from vsgdesign.identification.sampling import window_of_rate
from vsgdesign.parameters.converter import Converter, Filter, limiter_ratings
from vsgdesign.parameters.grid import Grid
from vsgdesign.parameters.knowledge import read_knowledge
from vsgdesign.parameters.reader import REQUIRED, TableReader
from vsgdesign.parameters.scenario import read_grid
from vsgdesign.parameters.study import NO_LIMITER, UPDATE_PERIOD, ClosedFormTarget, ControllerSpec
from vsgdesign.parameters.units import format_quantity


def read_limit(table: TableReader) -> float | None:
    return table.quantity("current_limit_pu", "1", 0.5, 20.0, default=None)


def read_limiter(
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


def read_target(table: TableReader, default: ClosedFormTarget, converter: Converter) -> ClosedFormTarget:
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


def read_controllers(
    root: TableReader,
    target: ClosedFormTarget,
    grid: Grid,
    basis: str,
    converter: Converter,
    filter_: Filter,
    limiter: tuple[str, tuple[tuple[str, float], ...]],
    simulation: Any,
) -> tuple[ControllerSpec, ...]:
    """Every controller of a study. ``limiter``: the name of the study's current limiter, and its given parameters."""
    specs: list[ControllerSpec] = []
    for table in root.children("controllers"):
        name = table.identifier("name")
        if name and (taken := _taken(name, [spec.name for spec in specs])) is not None:
            table.fault("name", name, *taken)
        kind = table.choice("kind", ("fixed", "scheduled"))
        own_target = read_target(table, target, converter)
        own_limiter, own_limit_pu, limiter_given = _read_own_limit(table, converter, filter_, *limiter)
        knowledge = read_knowledge(table.child("knowledge"))
        spec = ControllerSpec(
            name=name,
            kind=kind,
            target=own_target,
            update_period=UPDATE_PERIOD,
            current_limiter=own_limiter,
            current_limit_pu=own_limit_pu,
            limiter_given=limiter_given,
            knowledge=knowledge,
        )
        if knowledge is not None and kind == "fixed":
            table.fault(
                "knowledge", None, 'a controller with kind = "fixed" is told nothing of the grid', "Leave it out."
            )
        if kind == "fixed":
            specs.append(_read_fixed(table, spec, grid, basis, converter))
        else:
            specs.append(_read_scheduled(table, spec, root, converter, simulation))
        table.finish()
    if not specs and root.table.get("controllers", []) == []:
        root.fault(
            "controllers", None, "none given", 'Add [[controllers]] with name and kind = "fixed" or "scheduled".'
        )
    return tuple(specs)


def _read_fixed(
    table: TableReader, spec: ControllerSpec, grid: Grid, basis: str, converter: Converter
) -> ControllerSpec:
    gains_table, grid_table = table.child("gains"), table.child("design_grid")
    gains = None if gains_table is None else read_power_gains(gains_table)
    if grid_table is None:
        return replace(spec, gains=gains, design_grid=grid if gains is None else None)
    if gains is not None:
        table.fault("design_grid", None, "gains are given too", "Give either gains or design_grid.")
    own_basis = grid_table.choice("scr_basis", tuple(SCR_BASES), default=basis)
    design_grid = read_grid(grid_table, converter, own_basis, None)
    grid_table.finish()
    return replace(spec, gains=gains, design_grid=design_grid)


def _read_scheduled(
    table: TableReader, spec: ControllerSpec, root: TableReader, converter: Converter, simulation: Any
) -> ControllerSpec:
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
    if spec.knowledge is not None and estimate != "truth":
        problem = f'has no effect with estimate = "{estimate}", which estimates the grid by itself'
        table.fault("knowledge", None, problem, 'Leave it out, or take estimate = "truth".')
    period = _read_period(table, estimate, converter, simulation)
    return replace(spec, update_period=period, schedule=schedule, table_file=table_file, estimate=estimate)


def _read_period(table: TableReader, estimate: str, converter: Converter, simulation: Any) -> float | None:
    """The time between two updates, s; None: that of the windows of a network."""
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
    return period


def _read_own_limit(
    table: TableReader,
    converter: Converter,
    filter_: Filter,
    of_study: str,
    given: tuple[tuple[str, float], ...],
) -> tuple[str | None, float | None, tuple[tuple[str, float], ...] | None]:
    """How a controller limits its current, to how much, and with which parameters, where it differs from the study."""
    limiter = table.choice("current_limiter", (NO_LIMITER, *LIMITERS), default=None)
    limit_pu = read_limit(table)
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
    return limiter, limit_pu, read_limiter(limiter_table, LIMITERS[limiter or of_study], own, filter_, inherited)


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


def read_power_gains(table: TableReader) -> PowerLoopGains:
    """The gains of a controller that gives them all."""
    gains = PowerLoopGains(
        K_ip=table.quantity("K_ip", "rad/(s²·W)", 1e-15, 1e6, default=REQUIRED),
        D_p=table.quantity("D_p", "W·s/rad", 0.0, 1e12),
        K_iq=table.quantity("K_iq", "V/(s·var)", 1e-15, 1e6),
        D_q=table.quantity("D_q", "var/V", 0.0, 1e12),
        K_pq=table.quantity("K_pq", "rad/(s²·var)", -1e6, 1e6, default=0.0),
        K_qp=table.quantity("K_qp", "V/(s·W)", -1e6, 1e6, default=0.0),
        k_P=table.quantity("k_P", "rad/(s·W)", -1e6, 1e6, default=0.0),
        k_Q=table.quantity("k_Q", "rad/(s·var)", -1e6, 1e6, default=0.0),
    )
    table.finish()
    return gains
