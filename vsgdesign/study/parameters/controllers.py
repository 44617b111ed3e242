"""Reads [[controllers]]: what each of them aims at, how it is scheduled and how it limits its current."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from vsgdesign.equations.limiters import LIMITERS, KnownRatings, Limiter
from vsgdesign.equations.placing import Poles
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.identification.feeding import window_of_rate
from vsgdesign.identification.interface import ESTIMATORS, needs_network, samples_itself
from vsgdesign.study.parameters.converter import Converter, Filter, current_limit, limiter_ratings
from vsgdesign.study.parameters.fields import (
    DURATION,
    T_S,
    Scope,
    fields_of,
    inserted,
    number,
    picked,
    read,
    section,
    subtable,
    text,
    values,
    word,
)
from vsgdesign.study.parameters.grid import Grid, GridEstimate, Impedance, basis_field, read_grid
from vsgdesign.study.parameters.reader import TableReader, format_quantity
from vsgdesign.study.parameters.targets import TARGETS, ClosedFormTarget, Gains, read_power_gains, read_target

NO_LIMITER = "none"
"""The word for a controller of a study that does not limit its current."""

UPDATE_PERIOD = 0.02
"""Time between two updates of a schedule where a study says nothing, s: as published."""

_OF_CONVERTER = "of `[converter]`"


class _Basis:
    """The basis of a grid of its own."""

    scr_basis: str = basis_field(shown="of `[grid]`")
    """Basis of `scr` here."""


DESIGN_GRID = (*fields_of(_Basis), *fields_of(Impedance))
"""The fields of [controllers.design_grid]."""


@section
class ControllerSpec:
    """One controller of a study, with fixed gains or with gains scheduled from the grid impedance."""

    name: str = text(
        kind="name",
        limits="letters, digits, `-` `_` `.`, a name of a file; at most 100 bytes; unique, also without regard to case",
    )
    """Becomes a file name."""
    kind: str = word(("fixed", "scheduled"))
    """Gains that never change, or gains that follow the grid impedance."""
    target: ClosedFormTarget
    gains: PowerLoopGains | None = subtable(Gains, default=None, limits="`fixed` only")
    """The gains themselves: the four of the published structure, or all eight."""
    design_grid: Grid | None = subtable(
        DESIGN_GRID, default=None, limits="`fixed` only; not with `gains`", shown="the grid at t = 0"
    )
    """Grid for which the fixed gains are designed; in a plant, as the unit sees it."""
    update_period: float | None = number(
        "s", T_S, DURATION, default=None, shown="0.02, as near as T_s allows; with an estimate the window"
    )
    """`scheduled` only: time between updates, a multiple of T_s."""
    schedule: str = word(("closed_form", "table"), default="closed_form")
    """`scheduled` only: where the gains come from; `table` needs a `[specification]` to design one to, or `table`."""
    table_file: str | None = text(default=None, name="table", limits="a file")
    """File of a gain table to use instead of designing one."""
    estimate: str = word(lambda: ("truth", *ESTIMATORS), default="truth")
    """`scheduled` only: what it knows of the grid, the truth or an [estimate](#estimates); `neural` needs an
    `[estimator]`."""
    knowledge: GridEstimate | None = subtable(GridEstimate, default=None, shown="the grid exactly and at once")
    """`scheduled` with `truth` only: [how wrong and how late](#controllersknowledge) it knows the grid."""
    current_limiter: str | None = word(lambda: (NO_LIMITER, *LIMITERS), default=None, shown=_OF_CONVERTER)
    """How this controller limits its current; `none`: it does not."""
    current_limit_pu: float | None = current_limit(shown=_OF_CONVERTER)
    """Limit of this controller's current reference, pu of the rated peak; not with `none`."""
    limiter_given: tuple[tuple[str, float], ...] | None = subtable(
        (), default=None, name="limiter", shown="of `[converter]` with the same limiter"
    )
    """Parameters of this controller's limiter: the fields of [`[converter.limiter]`](#converterlimiter)."""


_TARGETS = tuple(
    replace(one, shown="of `[power_loops]`" + (f", {one.shown}" if one.shown.startswith("scaled") else ""))
    for one in TARGETS
)

CONTROLLER = inserted(fields_of(ControllerSpec), "kind", *_TARGETS)
"""The fields of [[controllers]]."""


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


def cycles_of_mean(controllers: Sequence[ControllerSpec]) -> int:
    """Nominal cycles over which the ripple of P and Q is averaged out where steps are judged: one, or two where a field
    estimator sends its probe, whose lines lie half-way between the harmonics."""
    return 2 if any(samples_itself(controller.estimate) for controller in controllers) else 1


def mean_time(controllers: Sequence[ControllerSpec], converter: Converter) -> float:
    """The same in s."""
    return cycles_of_mean(controllers) * 2.0 * math.pi / converter.omega_n


def poles_to_write(spec: ControllerSpec, mean_s: float) -> dict[str, float]:
    """The poles that another study has to give to a controller, to keep those that it has, where the steps of that
    study are judged by a mean over ``mean_s`` (s)."""
    if spec.schedule == "table" or spec.gains is not None or STRUCTURES[spec.target.structure].uncoupled:
        return {}
    there = spec.target.placed(mean_s, spec.target.margin)
    poles = {name: float(getattr(spec.target, name)) for name in Poles._fields}
    return {name: value for name, value in poles.items() if value != getattr(there, name)}


_OF_WINDOWS = "an estimator answers at the end of each of its windows, which are whole cycles of the grid"

_OF_CYCLES = "this estimator answers at the end of each of its own cycles, which follow the frequency"

_OF_CLOSED_FORMS = ("settling_time", "damping_ratio", "droop_ratio", "k_1", "d_1", "k_2", "share_P", "share_Q")
"""Targets of a controller that a designed table chooses by itself."""


def read_controllers(
    root: TableReader,
    scope: Scope,
    target: ClosedFormTarget,
    grid: Grid | None,
    basis: str,
    converter: Converter,
    filter_: Filter,
    limiter: tuple[str, tuple[tuple[str, float], ...]],
) -> tuple[ControllerSpec, ...]:
    """Every controller of a study. ``grid``: for which fixed gains are designed that name none; None: what their unit
    of a plant sees. ``limiter``: the name of the study's current limiter, and its given parameters."""
    specs: list[ControllerSpec] = []
    for table in root.children("controllers"):
        identity = values(picked(ControllerSpec, "name", "kind"), table)
        name, fixed = identity["name"], identity["kind"] == "fixed"
        if name and (taken := _taken(name, [spec.name for spec in specs])) is not None:
            table.fault("name", name, *taken)
        own_target = read_target(table, scope, target)
        limits = _read_own_limit(table, converter, filter_, *limiter)
        known = table.child("knowledge")
        knowledge = None if known is None else read(GridEstimate, known)
        spec = ControllerSpec(**identity, **limits, target=own_target, knowledge=knowledge, update_period=UPDATE_PERIOD)
        if knowledge is not None and fixed:
            table.fault(
                "knowledge", None, 'a controller with kind = "fixed" is told nothing of the grid', "Leave it out."
            )
        if fixed:
            specs.append(_read_fixed(table, spec, scope, grid, basis, converter))
        else:
            specs.append(_read_scheduled(table, spec, scope, root, converter))
        table.finish()
    if not specs and root.table.get("controllers", []) == []:
        root.fault(
            "controllers", None, "none given", 'Add [[controllers]] with name and kind = "fixed" or "scheduled".'
        )
    return tuple(specs)


def _read_fixed(
    table: TableReader, spec: ControllerSpec, scope: Scope, grid: Grid | None, basis: str, converter: Converter
) -> ControllerSpec:
    gains_table, grid_table = table.child("gains"), table.child("design_grid")
    gains = None if gains_table is None else read_power_gains(gains_table)
    if grid_table is None:
        return replace(spec, gains=gains, design_grid=grid if gains is None else None)
    if gains is not None:
        table.fault("design_grid", None, "gains are given too", "Give either gains or design_grid.")
    own_basis = values(_Basis, grid_table, defaults={"scr_basis": basis})["scr_basis"]
    design_grid = read_grid(grid_table, scope, converter, own_basis, None)
    grid_table.finish()
    return replace(spec, gains=gains, design_grid=design_grid)


def _read_scheduled(
    table: TableReader, spec: ControllerSpec, scope: Scope, root: TableReader, converter: Converter
) -> ControllerSpec:
    found = values(picked(ControllerSpec, "schedule", "table"), table)
    schedule, table_file = found["schedule"], found["table_file"]
    for field in _OF_CLOSED_FORMS if schedule == "table" else ():
        if table.has(field):
            table.fault(
                field,
                table.table[field],
                'has no effect with schedule = "table": the table is designed to the [specification]',
                "Leave it out, or set it there.",
            )
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
    estimate = values(picked(ControllerSpec, "estimate"), table)["estimate"]
    if needs_network(estimate) and not root.has("estimator"):
        table.fault("estimate", estimate, "there is no network to estimate with", "Add an [estimator] section.")
    if spec.knowledge is not None and estimate != "truth":
        problem = f'has no effect with estimate = "{estimate}", which estimates the grid by itself'
        table.fault("knowledge", None, problem, 'Leave it out, or take estimate = "truth".')
    return replace(spec, **found, estimate=estimate, update_period=_read_period(table, estimate, scope, converter))


def _read_period(table: TableReader, estimate: str, scope: Scope, converter: Converter) -> float | None:
    """The time between two updates, s; None: that of the windows of a network."""
    period = values(picked(ControllerSpec, "update_period"), table, scope)["update_period"]
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
) -> dict[str, Any]:
    """How a controller limits its current, to how much, and with which parameters, where it differs from the study."""
    found = values(picked(ControllerSpec, "current_limiter", "current_limit_pu"), table)
    limiter, limit_pu = found["current_limiter"], found["current_limit_pu"]
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
        return found
    own = converter if limit_pu is None else replace(converter, current_limit_pu=limit_pu)
    inherited = given if limiter in (None, of_study) else ()
    limiter_table = limiter_table or TableReader({}, table.name("limiter"), table.faults)
    return found | {
        "limiter_given": read_limiter(limiter_table, LIMITERS[limiter or of_study], own, filter_, inherited)
    }


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
