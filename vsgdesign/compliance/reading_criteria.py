"""Reads what a test of a suite asks for: a measure with its limits, or an envelope."""

from __future__ import annotations

import math

from vsgdesign.compliance.suite import ENVELOPE, Criterion
from vsgdesign.parameters.reader import TableReader
from vsgdesign.parameters.units import UnitError, parse_quantity

_WITHOUT_NUMBERS = ("measure", "at_least", "at_most", "envelope", "ours")


def read_criteria(tables: list[TableReader]) -> tuple[Criterion, ...]:
    """The criteria, in the order of the file. A measure without a limit is informational."""
    return tuple(_read_criterion(table) for table in tables)


def _read_criterion(table: TableReader) -> Criterion:
    measure = table.text("measure", default="")
    envelope = table.text("envelope", default="")
    if bool(measure) == bool(envelope):
        problem = "gives both measure and envelope" if measure else "says neither measure nor envelope"
        table.fault("", None, problem, 'For example { measure = "peak_current", at_most = 1.3 }.')
    limits: dict[str, float | None] = dict.fromkeys(("at_least", "at_most"))
    for name in limits:
        table.skip(name)
        if table.has(name):
            limits[name] = _number(table, name)
    low, high = limits.values()
    if low is not None and high is not None and low > high:
        table.fault("at_least", f"{low:g}", f"is above at_most = {high:g}: nothing can pass", "Exchange the two.")
    given = []
    for name in table.table:
        if name not in _WITHOUT_NUMBERS:
            table.skip(name)
            given.append((name, _number(table, name)))
    ours = table.flag("ours", default=False)
    table.finish()
    return Criterion(
        measure=ENVELOPE if envelope else measure,
        at_least=low,
        at_most=high,
        envelope=envelope or None,
        given=tuple(given),
        ours=ours,
    )


def _number(table: TableReader, field: str) -> float:
    try:
        return parse_quantity(table.table[field], "1")
    except UnitError as error:
        table.fault(field, table.table[field], str(error))
        return math.nan
