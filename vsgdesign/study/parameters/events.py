"""Reads the events of a study file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from vsgdesign.errors import did_you_mean
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.fields import (
    DURATION,
    Field,
    Scope,
    fields_of,
    flag,
    inserted,
    number,
    picked,
    subtable,
    take,
    text,
    values,
    word,
)
from vsgdesign.study.parameters.grid import (
    PLAIN,
    Grid,
    GridSource,
    Impedance,
    Network,
    Sag,
    SourceComponent,
    SynchroCheck,
    read_grid,
    sagged,
)
from vsgdesign.study.parameters.network_fields import (
    CLEARED,
    CLOSED,
    NONE,
    NOTHING_SAID,
    OPEN,
    Base,
    FaultFields,
    LoadFields,
    Said,
    check_said,
    network_words,
    read_sag,
    read_said,
    read_synchro_check,
    sag_words,
    synchro_check_words,
)
from vsgdesign.study.parameters.reader import TableReader, UnitError, parse_quantity
from vsgdesign.study.parameters.scenario import Component, read_components

SAME_INSTANT = 1e-9
"""Events that are less than this apart, s, are at the same instant."""


@dataclass
class _Present:
    """What holds up to an event, since an event changes only what it names."""

    grid: Grid
    network: Network
    source: GridSource
    """Without the sag."""
    sag: Sag | None = None
    ramp_end_s: float = -math.inf
    """When the last ramp of V_g_rms is over."""

    def settle(self, event: Event, converter: Converter) -> Event:
        """The event with everything that is connected from then on, and with what a sag makes of the source."""
        if event.switched != NOTHING_SAID:
            self.network = event.switched.on(self.network)
            event = replace(event, network=self.network, switched=NOTHING_SAID)
        return _with_sag(replace(event, sag=None), event.sag, self, converter)


_UNCHANGED = "unchanged"

_GRID = tuple(
    replace(one, shown="value before the event") if one.name in ("scr", "x_over_r") else one
    for one in fields_of(Impedance)
)


class EventFields:
    """The fields of [[events]] beside the quantities of :data:`vsgdesign.study.parameters.event_kinds.EVENT_KINDS`."""

    time: float = number("s", 0.0, DURATION, hint="Events must lie within simulation.duration.")
    """Instant."""
    name: str = text(limits="not empty", shown="a description of the change")
    """Label in reports."""
    element: str | None = text(default=None, shown="the grid and all units")
    """Of a plant, by its name, what it changes: a unit (set points, `breaker`, dc source), an inverter (set points,
    `breaker`), a branch, shunt, load or source (`breaker`), or a node (`fault`)."""
    grid: Any = subtable(_GRID, shown=_UNCHANGED)
    """New grid impedance."""
    over: float = number("s", 0.0, DURATION, default=0.0)
    """Ramps `V_g_pu` and `f_g` linearly over this time."""
    components: Any = subtable(Component, kind="tables", shown=_UNCHANGED)
    """The source's negative sequence and harmonics from now on, in place of all earlier ones; `[]`: none."""
    sag: Any = subtable(Sag, shown=_UNCHANGED, instead=NONE)
    """An unbalanced or balanced voltage sag from now on; `"none"` ends it."""
    load: Any = subtable(LoadFields, shown=_UNCHANGED, instead=NONE)
    """The load at the PCC from now on; `"none"`: no load."""
    fault: Any = subtable(FaultFields, shown=_UNCHANGED, instead=CLEARED)
    """The short circuit from now on; `"cleared"` ends it, phase by phase at the next zeros of its currents
    ([theory](theory/networks.md#clearing-at-zeros))."""
    breaker: str | None = word((OPEN, CLOSED), default=None, shown=_UNCHANGED)
    """The breaker between the PCC and the grid."""
    synchro_check: Any = subtable(SynchroCheck, shown="at once")
    """With `breaker = "closed"`: the breaker waits until both sides are near each other; in a plant, that of a unit."""
    synchronise: bool = flag(default=False)
    """With `breaker = "closed"`: the converter sets itself to the grid behind the breaker, which closes when it has
    been in step for 0.2 s."""


def event_fields() -> tuple[Field, ...]:
    """All fields of [[events]]."""
    kinds = [kind.field for kind in EVENT_KINDS.values() if not kind.of_controller]
    set_points = [kind.field for kind in EVENT_KINDS.values() if kind.of_controller]
    return (*inserted(fields_of(EventFields), "grid", *kinds), *set_points)


def read_events(
    tables: list[TableReader],
    scope: Scope,
    grid: Grid,
    basis: str,
    converter: Converter,
    source: GridSource,
    network: Network = PLAIN,
    elements: Mapping[str, str] | None = None,
) -> tuple[Event, ...]:
    """The [[events]], sorted by time. An event may change several things at once. ``grid``, ``source`` and ``network``
    are those at the start. ``elements``: of a plant, what its events may name; None: there is no plant."""
    events: list[Event] = []
    said: list[tuple[float, TableReader, dict[str, Any]]] = []
    present = _Present(grid, network, source)
    before, before_s = replace(present), -math.inf  # at the end of the instant before
    waiting: TableReader | None = None  # of the event whose breaker waits to close
    for table in sorted(tables, key=_time_or_last):
        t_s = values(picked(EventFields, "time"), table, scope)["time"]
        _check_left(table, t_s, scope, converter)
        element = values(picked(EventFields, "element"), table)["element"]
        if element is not None:
            events.append(_of_element(table, Event(t_s, element=element), scope, elements, converter))
            continue
        if not abs(t_s - before_s) <= SAME_INSTANT:
            before, before_s = replace(present), t_s
        event = _read_source(table, scope, Event(t_s), present, basis, converter)
        event = _read_network(table, event, before, present, waiting, converter)
        if event.synchro_check is not None or event.synchronised_until is not None:
            waiting = table
        if event.sag is not None:
            _check_sag(table, event, event.sag, before)
        given = _given(table, event, converter, basis) | _given_objects(table, event)
        said = [one for one in said if abs(t_s - one[0]) <= SAME_INSTANT]
        for _, earlier, earlier_values in said:
            _check_agreement(table, given, earlier, earlier_values, t_s)
        said.append((t_s, table, given))
        described = describe(event, converter, basis)
        if not described:
            names = ", ".join(["grid", *EVENT_KINDS, "components", "sag", "load", "fault"])
            table.fault("", None, "changes nothing", f"Give {names} or breaker.")
        name = values(picked(EventFields, "name"), table, defaults={"name": described})["name"]
        events.append(present.settle(replace(event, name=name), converter))
        table.finish()
    return tuple(events)


_MAY_CHANGE = {
    "unit": "set points, breaker and dc source",
    "inverter": "set points and breaker",
    "node": "fault",
    "source": "breaker",
    "element": "breaker",
}
"""What of an element an event may change, by the kind of the element."""

_ARTICLE = {
    "unit": "a unit",
    "inverter": "an inverter",
    "node": "a node",
    "source": "a source",
    "element": "a branch, shunt or load",
}
_OF_INVERTER = ("P_ref", "Q_ref")
"""The set points that an inverter has."""


def _of_element(
    table: TableReader, event: Event, scope: Scope, elements: Mapping[str, str] | None, converter: Converter
) -> Event:
    """An event of one element of a plant."""
    name, known = event.element or "", elements or {}
    if name not in known:
        names = f"Known: {', '.join(known)}." if known else "Leave it out: there is no plant."
        table.fault("element", name, "the plant has none of this name", did_you_mean(name, known, names, 0.5))
    what = known.get(name, "")
    set_points = [kind for kind in EVENT_KINDS.values() if kind.of_controller]
    of_dc = [kind for kind in EVENT_KINDS.values() if kind.of_dc]
    found = {kind.quantity: take(table, kind.field, scope, None) for kind in (*set_points, *of_dc)}
    said = read_said(table, Base.of(converter))
    given = {
        "set points": any(found[kind.quantity] is not None for kind in set_points),
        "dc source": any(found[kind.quantity] is not None for kind in of_dc),
        "breaker": said.breaker is not None,
        "fault": said.fault is not None,
        "load": said.load is not None,
    }
    wrong = [one for one, there in given.items() if there and what and one not in _MAY_CHANGE[what]]
    if not any(given.values()):
        table.fault("", None, "changes nothing", f"Give {_MAY_CHANGE.get(what, 'breaker')}.")
    others = [
        kind.name for kind in set_points if found[kind.quantity] is not None and kind.quantity not in _OF_INVERTER
    ]
    if what == "inverter" and others:
        problem = f"{name} is an inverter, which has no {' and '.join(others)}"
        table.fault(others[0], table.table[others[0]], problem, "Give its P_ref or Q_ref.")
    if wrong:
        problem = f"{name} is {_ARTICLE[what]}, which has no {' and '.join(wrong)} that an event may change"
        table.fault("element", name, problem, f"An event may change its {_MAY_CHANGE[what]}.")
    check_table = table.child("synchro_check")
    check = None if check_table is None else read_synchro_check(check_table)
    if check is not None and (what != "unit" or said.breaker != CLOSED):
        problem = "in a plant it closes the breaker of a unit, which this event does not"
        table.fault("synchro_check", None, problem, f'Name a unit, and add breaker = "{CLOSED}".')
    every = (*set_points, *of_dc)
    words = [kind.words(found[kind.quantity], converter) for kind in every if found[kind.quantity] is not None]
    words += network_words(said, Base.of(converter))
    words += [] if check is None else [synchro_check_words(check)]
    label = values(picked(EventFields, "name"), table, defaults={"name": f"{name}: {', '.join(words)}"})["name"]
    table.finish()
    return replace(event, name=label, switched=said, synchro_check=check, **found)


def _check_left(table: TableReader, t_s: float, scope: Scope, converter: Converter) -> None:
    """An event with no sample after it would never be seen."""
    left = scope[DURATION.of] - t_s
    if left < converter.T_s:
        problem = f"{left:.3g} s are left after it, less than one sampling period ({converter.T_s:.3g} s)"
        advice = "Begin it earlier, or give a longer simulation.duration. Figures need a cycle after an event."
        table.fault("time", f"{t_s:g} s", problem, advice)


def settled(
    events: Iterable[Event], converter: Converter, basis: str, source: GridSource, network: Network
) -> tuple[Event, ...]:
    """Events in SI, in the order of time, as a study has them: named after what they change, with what a sag makes of
    the source, and with everything that is connected from then on. ``source`` and ``network``: at the start."""
    present = _Present(Grid(0.0, 0.0), network, source)
    named = (event if event.name else replace(event, name=describe(event, converter, basis)) for event in events)
    return tuple(present.settle(event, converter) for event in named)


def _read_source(
    table: TableReader, scope: Scope, event: Event, present: _Present, basis: str, converter: Converter
) -> Event:
    """Grid, source and set points of an event."""
    found: dict[str, Any] = {}
    grid_table = table.child("grid")
    if grid_table is not None:
        present.grid = found["grid"] = read_grid(grid_table, scope, converter, basis, present.grid)
        grid_table.finish()
    for kind in EVENT_KINDS.values():
        value = take(table, kind.field, scope, kind.nothing)
        if value is not None:
            found[kind.quantity] = kind.one(converter) * value
    over = values(picked(EventFields, "over"), table, scope)["over"]
    components = read_components(table.children("components")) if table.has("components") else None
    table.skip("components")
    event = replace(event, **found, over=over, components=components)
    ramped = [kind.name for kind in EVENT_KINDS.values() if kind.ramps]
    if over > 0.0 and not any(kind.ramps for kind in event.changed):
        advice = f"Use it with {' or '.join(ramped)}."
        table.fault("over", f"{over:.6g} s", "there is nothing to ramp", advice)
    return event


def _read_network(
    table: TableReader,
    event: Event,
    before: _Present,
    present: _Present,
    waiting: TableReader | None,
    converter: Converter,
) -> Event:
    """Sag, load, fault and breaker of an event."""
    said = read_said(table, Base.of(converter))
    check_said(table, said if waiting is None else said._replace(breaker=None), before.network)
    check_table = table.child("synchro_check")
    check = None if check_table is None else read_synchro_check(check_table)
    synchronise = values(picked(EventFields, "synchronise"), table)["synchronise"]
    _check_waiting(table, said, check, synchronise, waiting, present.network)
    sag_table = table.child_or_word("sag", NONE)
    sag = read_sag(sag_table) if isinstance(sag_table, TableReader) else sag_table
    if check is not None or synchronise:  # until then the breaker is open
        said = said._replace(breaker=None)
    until = math.inf if synchronise else None
    return replace(event, switched=said, synchro_check=check, synchronised_until=until, sag=sag)


def _check_waiting(
    table: TableReader,
    of_network: Said,
    check: SynchroCheck | None,
    synchronise: bool,
    waiting: TableReader | None,
    network: Network,
) -> None:
    """A synchro-check or the converter itself closes the breaker, at an instant that is not known beforehand."""
    for field in (*(["synchro_check"] if check is not None else []), *(["synchronise"] if synchronise else [])):
        if of_network.breaker != CLOSED:
            problem = "it closes the breaker, which this event does not"
            table.fault(field, None, problem, f'Add breaker = "{CLOSED}".')
    if synchronise and check is not None:
        table.fault("synchronise", "true", "the same event has a synchro_check", "Give one of them.")
    if synchronise and of_network.on(network).load is not None:
        problem = "there is a load at the PCC, and a converter synchronises without power"
        table.fault("synchronise", "true", problem, 'Take the load away (load = "none"), or give synchro_check.')
    if waiting is not None and of_network.breaker is not None:
        problem = f"{waiting.path} closes it at an instant that is not known beforehand"
        table.fault("breaker", of_network.breaker, problem, "Let it be the last event of the breaker.")


def _check_sag(table: TableReader, event: Event, sag: Sag | str, before: _Present) -> None:
    """A sag is a step from a voltage that holds."""
    shown = sag_words(sag)
    if sag == NONE and before.sag is None:
        table.fault("sag", NONE, "there is no sag that it could end", "Leave it out, or begin one before.")
    if event.V_g_rms is not None:
        table.fault("sag", shown, "V_g_pu is given as well", "Give one of them: a sag is a share of V_g_pu before it.")
    if event.over > 0.0:
        table.fault("over", f"{event.over:.6g} s", "a sag begins and ends at once", "Ramp f_g in an event of its own.")
    if event.t_s < before.ramp_end_s - SAME_INSTANT:
        problem = f"the ramp of V_g_pu goes on to {before.ramp_end_s:g} s"
        table.fault("sag", shown, problem, "Begin it after the ramp, or give V_g_pu without over.")


def _with_sag(event: Event, sag: Sag | str | None, present: _Present, converter: Converter) -> Event:
    """The event with what a sag makes of the source: its positive sequence, the angle by which this is turned, and its
    negative sequence. ``present`` goes on with what holds from here on."""
    V_rated = converter.V_rated_rms
    old = present.source
    _, turned, before = sagged(old, present.sag, V_rated)
    source = replace(
        old,
        V_g_rms=old.V_g_rms if event.V_g_rms is None else event.V_g_rms,
        components=old.components if event.components is None else event.components,
    )
    # A voltage that is given says what holds from here on, so it ends the sag.
    kept = present.sag if event.V_g_rms is None else None
    now = kept if sag is None else (None if isinstance(sag, str) else sag)
    if event.V_g_rms is not None:
        present.ramp_end_s = event.t_s + event.over
    was, present.source, present.sag = present.sag, source, now
    if was is None and now is None:
        return event
    V_g_rms, angle, components = sagged(source, now, V_rated)
    if was == now and event.components is not None:
        return replace(event, components=components)
    if was == now:
        return event
    return replace(
        event,
        V_g_rms=event.V_g_rms if event.V_g_rms is not None else V_g_rms,
        phase_jump=event.phase_jump + angle - turned,
        components=None if components == before else components,
    )


def _given_objects(table: TableReader, event: Event) -> dict[str, Any]:
    """What an event sets besides quantities. Components are compared as they are written."""
    values = event.switched._asdict() | {"sag": event.sag, "components": table.table.get("components")}
    return {name: value for name, value in values.items() if value is not None}


def _given(table: TableReader, event: Event, converter: Converter, basis: str) -> dict[str, Any]:
    """The quantities that an event sets, SI."""
    values: dict[str, float | None] = {}
    for kind in event.changed:
        values[kind.name] = kind.value(event)
        if kind.ramps:
            values[f"over of {kind.name}"] = event.over
    if event.grid is not None:
        scr, ratio = event.grid.scr(converter, basis), event.grid.x_over_r(converter.omega_n)
        known = {"R_g": event.grid.R_g, "L_g": event.grid.L_g, "scr": scr, "x_over_r": ratio}
        written = table.table["grid"]
        if isinstance(written, dict):  # the reader has said so where it is not
            values |= {f"grid.{name}": value for name, value in known.items() if name in written}
    return {name: value for name, value in values.items() if value is not None}


def _check_agreement(
    table: TableReader, given: dict[str, Any], earlier: TableReader, before: dict[str, Any], t_s: float
) -> None:
    """Two events of one instant may set different things, or the same thing twice, but not two values of one thing."""
    advice = "Give one value, or different times."
    for name in [name for name in given if name in before]:
        if not isinstance(given[name], float):
            if given[name] != before[name]:
                value = given[name] if isinstance(given[name], str) else None
                other = f"other {name}" if name == "components" else f"another {name}"
                table.fault(name, value, f"{earlier.path} gives {other} at the same instant, {t_s:g} s", advice)
        elif not math.isclose(given[name], before[name], rel_tol=1e-9) and not math.isnan(given[name] - before[name]):
            field = name.partition(" of ")[0]
            value, other = _at(table.table, field), _at(earlier.table, field)
            problem = f"{earlier.path} sets it to {other} at the same instant, {t_s:g} s"
            table.fault(field, value, problem, advice)
    impedance, ratios = {"grid.R_g", "grid.L_g"}, {"grid.scr", "grid.x_over_r"}
    for one, two in ((impedance, ratios), (ratios, impedance)):
        if one & given.keys() and two & before.keys():
            table.fault(
                "grid", None, f"{earlier.path} gives the grid in other terms at the same instant, {t_s:g} s", advice
            )
    for one, two in (("sag", "V_g_pu"), ("V_g_pu", "sag")):
        if one in given and two in before and two not in given:
            table.fault(one, None, f"{earlier.path} gives {two} at the same instant, {t_s:g} s", advice)


def _at(table: dict[str, Any], field: str) -> object:
    """A value as it stands in the file; what is left out is zero there."""
    value: Any = table
    for key in field.split("."):
        value = value.get(key, 0)
    return value


def _time_or_last(table: TableReader) -> float:
    try:
        return parse_quantity(table.table.get("time"), "s")
    except UnitError:
        return math.inf


def _describe_components(components: tuple[SourceComponent, ...]) -> str:
    if not components:
        return "no source components"
    return "source " + " ".join(f"{c.order:+g}: {100.0 * c.amplitude_pu:.3g} %" for c in components)


def describe(event: Event, converter: Converter, basis: str) -> str:
    """What an event in SI changes, in words; without what a sag makes of the source."""
    parts = []
    if event.grid is not None:
        parts.append(f"SCR {event.grid.scr(converter, basis):.3g}, X/R {event.grid.x_over_r(converter.omega_n):.3g}")
    values = {kind: kind.value(event) for kind in event.changed}
    words = {kind: kind.words(value, converter) for kind, value in values.items() if value is not None}
    parts += [text for kind, text in words.items() if not kind.of_controller]
    if event.components is not None:
        parts.append(_describe_components(event.components))
    if event.sag is not None:
        parts.append(sag_words(event.sag))
    parts += [] if event.synchro_check is None else [synchro_check_words(event.synchro_check)]
    parts += [] if event.synchronised_until is None else ["converter synchronises"]
    parts += network_words(event.switched, Base.of(converter))
    return ", ".join([*parts, *(text for kind, text in words.items() if kind.of_controller)])
