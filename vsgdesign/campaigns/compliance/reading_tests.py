"""With what a test of a suite file is read: its events, those of a study per unit of the converter, and its sweeps."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from vsgdesign.study.parameters.event import BASIS, Event
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.grid import SCR_LIMITS, X_OVER_R_LIMITS, Load, Network, Place
from vsgdesign.study.parameters.network_fields import (
    CLEARED,
    CLOSED,
    NONE,
    OPEN,
    Said,
    check_said,
    read_sag,
    read_said,
    read_synchro_check,
)
from vsgdesign.study.parameters.reader import TableReader

LONGEST_S = 600.0
"""Longest time that a test may speak of, s."""


@dataclass
class _Present:
    """What the events so far have left, for those that say only a part."""

    place: Place
    V_g_pu: float
    df_hz: float
    network: Network
    sagged: bool = False
    waits: bool = False
    """Whether a synchro-check closes the breaker, at an instant that the file does not know."""


def read_events(
    tables: list[TableReader], place: Place, V_g_pu: float, df_hz: float, load: Load | None
) -> tuple[Event, ...]:
    """The events per unit, in the order of time. What ``lasts`` ends with an event of its own. The others say what
    holds before."""
    present = _Present(place, V_g_pu, df_hz, Network(load=load))
    timed = [(table.quantity("time", "s", 0.0, LONGEST_S, default=0.0), table) for table in tables]
    timed.sort(key=lambda pair: math.inf if math.isnan(pair[0]) else pair[0])
    found: list[list[Event]] = []
    for t_s, table in timed:
        found.append(_read_event(table, t_s, present))
        table.finish()
    _check_ends([table for _, table in timed], found)
    return tuple(sorted((event for pair in found for event in pair), key=lambda event: event.t_s))


def _check_ends(tables: list[TableReader], found: list[list[Event]]) -> None:
    """What an event ends, no other event changes before or at the same instant: it would be lost."""
    for table, events in zip(tables, found, strict=True):
        if len(events) < 2:
            continue
        begin, end = events
        for other, others in zip(tables, found, strict=True):
            inside = [event for event in others if event is not begin and event is not end]
            lost = {word for event in inside if begin.t_s <= event.t_s <= end.t_s for word in _changed(event)}
            for word in sorted(lost & _changed(end)):
                problem = f"{other.path} changes the {word} before this ends, at {end.t_s:g} s"
                table.fault("lasts", table.table["lasts"], problem, "Leave lasts out, and end it with an event.")


def _changed(event: Event) -> set[str]:
    """What an event changes of what ``lasts`` can end, in words."""
    changed = {
        "grid": event.place,
        "voltage": event.sag if event.V_g_rms is None else event.V_g_rms,
        "short circuit": event.switched.fault,
        "load": event.switched.load,
        "breaker": event.switched.breaker,
    }
    return {word for word, value in changed.items() if value is not None}


def _read_event(table: TableReader, t_s: float, present: _Present) -> list[Event]:
    before = replace(present)
    nothing = event = Event(t_s, per_unit=True)
    table.skip("scr", "x_over_r")
    if table.has("scr") or table.has("x_over_r"):
        scr = table.quantity("scr", "1", *SCR_LIMITS, default=present.place.scr)
        x_over_r = table.quantity("x_over_r", "1", *X_OVER_R_LIMITS, default=present.place.x_over_r)
        present.place = Place(scr, x_over_r, BASIS)
        event = replace(event, place=present.place)
    event = _read_source(table, _read_quantities(table, event), present)
    event = _read_network(table, event, present)
    lasts = table.quantity("lasts", "s", 1e-3, LONGEST_S, default=None)
    if event == nothing:
        names = ["scr", "x_over_r", "sag", *(kind.of_suite.name for kind in EVENT_KINDS.values()), "load", "fault"]
        table.fault("", None, "changes nothing", f"Give {', '.join(names)} or breaker.")
    if lasts is None:
        return [event]
    return [event, *_end(table, event, lasts, before, present)]


def _read_quantities(table: TableReader, event: Event) -> Event:
    """The quantities of an event, by the names that a suite has for them."""
    found = {}
    for kind in EVENT_KINDS.values():
        field = kind.of_suite
        value = table.quantity(field.name, field.unit, *field.limits, default=kind.nothing)
        found[kind.quantity] = value if value is None else field.read(value)
    return replace(event, **found)


def _read_source(table: TableReader, event: Event, present: _Present) -> Event:
    """Dip and ramp of the grid's source."""
    V_g_pu, df_hz = event.V_g_rms, event.df_hz
    dip = table.child_or_word("sag", NONE)
    sag = read_sag(dip) if isinstance(dip, TableReader) else None
    if dip is not None and V_g_pu is not None:
        table.fault("V_g_pu", f"{V_g_pu:g}", "the same event gives a sag", "Give the one or the other.")
    if dip == NONE and not present.sagged:
        table.fault("sag", NONE, "there is no sag that it could end", "Leave it out, or begin one before.")
    if V_g_pu is not None:
        present.V_g_pu, present.sagged = V_g_pu, False
    elif dip == NONE:
        V_g_pu, present.sagged = present.V_g_pu, False
    elif sag is not None:
        present.sagged = True
    over_s = table.quantity("over", "s", 0.0, LONGEST_S, default=0.0)
    rate = table.quantity("df_per_s", "Hz/s", 1e-3, 1e3, default=None)
    if rate is not None and df_hz is None:
        table.fault("df_per_s", f"{rate:g}", "there is no frequency to reach", 'Add it, such as df = "1 Hz".')
    elif rate is not None and table.has("over"):
        table.fault("df_per_s", f"{rate:g}", "the same event gives over", "Give the rate or the duration.")
    elif rate is not None and df_hz is not None:
        over_s = abs(df_hz - present.df_hz) / rate
    elif over_s != 0.0 and not any(kind.ramps for kind in event.changed):
        table.fault("over", f"{over_s:g} s", "there is nothing to ramp", "Use it with V_g_pu or df.")
    if df_hz is not None:
        present.df_hz = df_hz
    return replace(event, V_g_rms=V_g_pu, sag=sag, over=over_s)


def _read_network(table: TableReader, event: Event, present: _Present) -> Event:
    """Load, short circuit and breaker, with the words of a study file."""
    said = read_said(table, None)
    check_said(table, said, present.network)
    present.network = said.on(present.network)
    given = table.child("synchro_check")
    check = None if given is None else read_synchro_check(given)
    if check is not None and said.breaker != CLOSED:
        problem = "it closes the breaker, which this event does not"
        table.fault("synchro_check", None, problem, f'Add breaker = "{CLOSED}".')
    if present.waits and (said.breaker is not None or check is not None):
        table.fault(
            "breaker", said.breaker, "an earlier event closes it when its synchro-check allows", "Leave it out."
        )
    present.waits = present.waits or check is not None
    return replace(event, switched=said, synchro_check=check)


def _end(table: TableReader, event: Event, lasts: float, before: _Present, present: _Present) -> list[Event]:
    """The event that ends what another began ``lasts`` before. What it cannot end stays."""
    if not math.isfinite(lasts):  # its fault has been said
        return []
    nothing = end = Event(float(f"{event.t_s + lasts:.12g}"), per_unit=True)
    if event.over > lasts:
        table.fault("lasts", f"{lasts:g} s", f"ends before the ramp, which takes {event.over:g} s")
    if event.place is not None:
        present.place = before.place
        end = replace(end, place=before.place)
    if event.sag is not None or event.V_g_rms is not None:
        end = replace(end, V_g_rms=before.V_g_pu)
        present.V_g_pu, present.sagged = before.V_g_pu, False
    now, then = present.network, before.network
    ended = Said(
        load=None if now.load == then.load else then.load or NONE,
        fault=None if now.fault == then.fault else then.fault or CLEARED,
        breaker=None if now.connected == then.connected else (CLOSED if then.connected else OPEN),
    )
    present.network = then
    end = replace(end, switched=ended)
    if end == nothing:
        what = "scr, V_g_pu, sag, fault, load or breaker"
        table.fault("lasts", f"{lasts:g} s", "there is nothing that ends", f"Use it with {what}.")
        return []
    return [end]


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
