"""Reads what a test of a suite asks for: a measure with its limits, or an envelope."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable

from vsgdesign.compliance.envelopes import ENVELOPES
from vsgdesign.compliance.measures import MEASURES, Parameter
from vsgdesign.compliance.suite import ENVELOPE, Criterion
from vsgdesign.parameters.reader import TableReader
from vsgdesign.parameters.units import UnitError, parse_quantity

_SCALED = {"": ("1", 1.0), "pu": ("1", 1.0), "%": ("1", 100.0), "ms": ("s", 1e3), "°": ("rad", 180.0 / math.pi)}
"""Units of measures that are not those of quantities: the dimension that is read, and the factor from it."""


def read_criteria(tables: list[TableReader]) -> tuple[Criterion, ...]:
    """The criteria, in the order of the file. A measure without a limit is informational."""
    return tuple(_read_criterion(table) for table in tables)


def _read_criterion(table: TableReader) -> Criterion:
    measure, envelope = _name(table, "measure", MEASURES), _name(table, "envelope", ENVELOPES)
    if table.has("measure") == table.has("envelope"):
        problem = "gives both measure and envelope" if measure else "says neither measure nor envelope"
        table.fault("", None, problem, 'For example { measure = "peak_after_5ms_pu", at_most = 1.3 }.')
    limits = _limits(table, measure)
    parameters: tuple[Parameter, ...] = ()
    if measure in MEASURES:
        parameters = MEASURES[measure].parameters
    elif envelope in ENVELOPES:
        parameters = ENVELOPES[envelope].parameters
    given = tuple((p.name, _parameter(table, p)) for p in parameters if table.has(p.name))
    ours, judged = table.flag("ours", default=False), table.flag("judged", default=True)
    if measure in MEASURES or envelope in ENVELOPES:
        table.skip(*(parameter.name for parameter in parameters))
        table.finish()  # which parameters there are is known of a known name alone
    return Criterion(
        measure=ENVELOPE if envelope else measure,
        at_least=limits[0],
        at_most=limits[1],
        envelope=envelope or None,
        given=given,
        ours=ours,
        judged=judged,
    )


def _parameter(table: TableReader, parameter: Parameter) -> float:
    value = in_unit(table, parameter.name, parameter.unit)
    problem = None if math.isnan(value) else parameter.problem(value)
    if problem is not None:
        default = f"Leave it out for {parameter.default:g}." if math.isfinite(parameter.default) else ""
        table.fault(parameter.name, table.table[parameter.name], problem, default)
    return value


def _name(table: TableReader, field: str, known: Iterable[str]) -> str:
    """The name of a measure or an envelope; empty where there is none. Of an unknown one the nearest is suggested."""
    if not table.has(field):
        table.skip(field)
        return ""
    name = table.text(field)
    if name and name not in known:
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
        advice = f"Did you mean {near[0]}?" if near else f"Known: {', '.join(known)}."
        table.fault(field, name, f"there is no such {field}", advice)
    return name


def _limits(table: TableReader, measure: str) -> tuple[float | None, float | None]:
    found: list[float | None] = []
    for field in ("at_least", "at_most"):
        table.skip(field)
        if not table.has(field):
            found.append(None)
        elif not measure:
            table.fault(field, table.table[field], "limits a measure, and an envelope has its own", "Leave it out.")
            found.append(None)
        else:
            found.append(in_unit(table, field, MEASURES[measure].unit) if measure in MEASURES else None)
    low, high = found
    if low is not None and high is not None and low > high:
        table.fault("at_least", f"{low:g}", f"is above at_most = {high:g}: nothing can pass", "Exchange the two.")
    return low, high


def in_unit(table: TableReader, field: str, unit: str) -> float:
    """A field as a number in the unit of a measure or a parameter. A bare number has this unit; NaN for a fault."""
    raw = table.table[field]
    dimension, factor = _SCALED.get(unit, (unit, 1.0))
    try:
        value = parse_quantity(raw, dimension)
    except UnitError as error:
        table.fault(field, raw, str(error), f"A bare number is in {unit}." if dimension != unit and unit else "")
        return math.nan
    return value * factor if isinstance(raw, str) else value
