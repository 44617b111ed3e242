"""Sweeps of a suite file: a list in the place of a value stands for one test per value."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.reader import TableReader

MOST_TESTS = 2000
"""Largest number of tests in a suite: about a minute of simulation for one controller on two cores."""

_OF_TEST = {
    "scr": "SCR {}",
    "x_over_r": "X/R {}",
    "P_pu": "P {} pu",
    "Q_pu": "Q {} pu",
    "V_g_pu": "V_g {} pu",
    "df": "from {:+}",
    "silent": "silent {}",
}
"""Fields of a test that may be lists, with the part that each value adds to the test's id."""

_OF_EVENT = {
    "time": "at {}",
    "scr": "to SCR {}",
    "x_over_r": "to X/R {}",
    "V_g_pu": "",
    "df": "",
    "df_per_s": "{}",
    "over": "within {}",
    "lasts": "{}",
    "phase_jump": "",
    "breaker": "breaker {}",
}
"""The same of an event, in the order in which they stand in an id. The words of a quantity are those of its kind
(:data:`vsgdesign.study.parameters.event_kinds.EVENT_KINDS`); kinds that are not listed follow."""
_NESTED = {
    "sag": {"type": "type {}", "V_pu": "{} pu", "angle": "{:+}"},
    "synchro_check": {"around": "around {}"},
    "fault": {"kind": "{}", "at": "at {}", "R_pu": "R {} pu", "phases": "{}"},
    "load": {
        "P_pu": "load {} pu",
        "Q_pu": "load Q {} pu",
        "R_pu": "load R {} pu",
        "X_L_pu": "load X_L {} pu",
        "X_C_pu": "load X_C {} pu",
    },
}
_BARE_UNITS = {
    "time": "s",
    "over": "s",
    "lasts": "s",
    "silent": "s",
    "df": "Hz",
    "df_per_s": "Hz/s",
}


_STAND_IN = 1.0
"""In the place of a value where a list has none, which has its own fault."""


class Axis(NamedTuple):
    """One swept field of a test: the way to it in the document, its full name, and its values as they are written."""

    way: tuple[str | int, ...]
    name: str
    label: str
    values: tuple[Any, ...]

    def words(self, value: Any) -> str:
        """What a value adds to the id of its test."""
        text = f"{value:g}" if isinstance(value, float) else str(value).strip()
        unit = (_BARE_UNITS | _units_of_kinds()).get(str(self.way[-1]))
        if unit is not None and not isinstance(value, str):
            text = f"{text} {unit}"
        if "{:+}" in self.label:
            return self.label.replace("{:+}", text if text.startswith(("-", "+")) else f"+{text}")
        return self.label.format(text.replace("_", " "))


def _units_of_kinds() -> dict[str, str]:
    fields = (kind.of_suite for kind in EVENT_KINDS.values())
    return {field.name: field.unit for field in fields if field.unit != "1"}


def axes_of(table: TableReader) -> list[Axis]:
    """The swept fields of a test: first those of its events, then those of its grid and operating point.

    An empty list, a list that holds anything but numbers and texts, and a value given twice are faults of the table.
    """
    found: list[Axis] = []
    events = table.table.get("events")
    of_event = _OF_EVENT | {kind.of_suite.name: kind.of_suite.words for kind in EVENT_KINDS.values()}
    if isinstance(events, list):
        for k, event in enumerate(events):
            if isinstance(event, dict):
                _collect(table, found, event, ("events", k), f"events[{k}].", of_event)
    _collect(table, found, table.table, (), "", _OF_TEST)
    return found


def _collect(
    table: TableReader,
    found: list[Axis],
    part: dict[str, Any],
    way: tuple[str | int, ...],
    prefix: str,
    labels: dict[str, str],
) -> None:
    for field, label in labels.items():
        if isinstance(part.get(field), list):
            _add(table, found, part[field], (*way, field), prefix + field, label)
    for name, nested in _NESTED.items():
        inner = part.get(name)
        if isinstance(inner, dict):
            for field, label in nested.items():
                if isinstance(inner.get(field), list):
                    _add(table, found, inner[field], (*way, name, field), f"{prefix}{name}.{field}", label)


def _add(
    table: TableReader, found: list[Axis], raw: list[Any], way: tuple[str | int, ...], field: str, label: str
) -> None:
    advice = f"Give one value or a list such as {way[-1]} = {_EXAMPLES.get(str(way[-1]), '[0.5, 1.0]')}."
    if not raw:
        table.fault(field, raw, "is an empty sweep: there would be no test", advice)
        raw = [_STAND_IN]
    elif any(isinstance(item, list | dict | bool) for item in raw):
        table.fault(field, raw, "must be a list of numbers or texts", advice)
        raw = [item for item in raw if not isinstance(item, list | dict | bool)] or [_STAND_IN]
    # As they are written: nan is unlike itself.
    written = [repr(item) for item in raw]
    twice = next((item for k, item in enumerate(raw) if repr(item) in written[:k]), None)
    if twice is not None:
        table.fault(field, raw, f"gives {twice} twice", "Give each value once: each makes a test of its own.")
        raw = [item for k, item in enumerate(raw) if repr(item) not in written[:k]]
    found.append(Axis(way, field, label, tuple(raw)))


_EXAMPLES = {
    "scr": "[1.5, 3, 10]",
    "x_over_r": "[2, 10]",
    "time": '["0 s", "1 s"]',
    "lasts": '["50 ms", "150 ms"]',
    "phase_jump": '["30 deg", "-30 deg"]',
    "df": '["1 Hz", "-1 Hz"]',
    "df_per_s": '["1 Hz/s", "4 Hz/s"]',
    "type": '["A", "C"]',
    "breaker": '["open", "closed"]',
}


def size_of(axes: list[Axis]) -> int:
    """How many tests a sweep makes."""
    return math.prod(len(axis.values) for axis in axes)


def size_in_words(axes: list[Axis]) -> str:
    """How its size comes about, such as ``scr 40 × x_over_r 30``."""
    return " × ".join(f"{axis.name} {len(axis.values)}" for axis in axes)


def combinations(document: dict[str, Any], axes: list[Axis]) -> Iterator[tuple[dict[str, Any], str]]:
    """The document of each test, with one value in the place of each list, and what its values add to the id."""
    for values in itertools.product(*(axis.values for axis in axes)):
        one = copy.deepcopy(document)
        for axis, value in zip(axes, values, strict=True):
            part: Any = one
            for step in axis.way[:-1]:
                part = part[step]
            part[axis.way[-1]] = value
        yield one, ", ".join(axis.words(value) for axis, value in zip(axes, values, strict=True))
