"""Reads the events of a test of a suite file: the events of a study, per unit of the converter."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from vsgdesign.study.parameters.event import BASIS, Event
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.grid import SCR_LIMITS, X_OVER_R_LIMITS, Place
from vsgdesign.study.parameters.network import Load, Network
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
