"""Reads the events of a test of a suite file: what changes at which instant, per unit of the converter."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from vsgdesign.compliance.suite import SuiteEvent
from vsgdesign.parameters.grid import SCR_LIMITS, X_OVER_R_LIMITS
from vsgdesign.parameters.network import Load, Network
from vsgdesign.parameters.network_fields import (
    CLEARED,
    CLOSED,
    NONE,
    check_said,
    read_sag,
    read_said,
    read_synchro_check,
)
from vsgdesign.parameters.reader import TableReader

LONGEST_S = 600.0
"""Longest time that a test may speak of, s."""
MOST_DF_HZ = 12.0
"""Largest distance from the nominal frequency, Hz."""
MOST_POWER_PU = 2.0


@dataclass
class _Present:
    """What the events so far have left, for those that say only a part."""

    scr: float
    x_over_r: float
    V_g_pu: float
    df_hz: float
    network: Network
    sagged: bool = False
    waits: bool = False
    """Whether a synchro-check closes the breaker, at an instant that the file does not know."""


def read_events(
    tables: list[TableReader], scr: float, x_over_r: float, V_g_pu: float, df_hz: float, load: Load | None
) -> tuple[SuiteEvent, ...]:
    """The events in the order of time. What ``lasts`` ends with an event of its own. The others say what holds
    before."""
    present = _Present(scr, x_over_r, V_g_pu, df_hz, Network(load=load))
    timed = [(table.quantity("time", "s", 0.0, LONGEST_S, default=0.0), table) for table in tables]
    timed.sort(key=lambda pair: math.inf if math.isnan(pair[0]) else pair[0])
    found: list[list[SuiteEvent]] = []
    for t_s, table in timed:
        found.append(_read_event(table, t_s, present))
        table.finish()
    _check_ends([table for _, table in timed], found)
    return tuple(sorted((event for pair in found for event in pair), key=lambda event: event.t_s))


def _check_ends(tables: list[TableReader], found: list[list[SuiteEvent]]) -> None:
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


def _changed(event: SuiteEvent) -> set[str]:
    """What an event changes of what ``lasts`` can end, in words."""
    changed = {
        "grid": event.scr is not None,
        "voltage": event.V_g_pu is not None or event.sag is not None,
        "short circuit": event.fault is not None or event.fault_cleared,
        "load": event.load is not None or event.load_off,
        "breaker": event.connected is not None,
    }
    return {word for word, yes in changed.items() if yes}


def _read_event(table: TableReader, t_s: float, present: _Present) -> list[SuiteEvent]:
    before = replace(present)
    event = SuiteEvent(t_s=t_s)
    table.skip("scr", "x_over_r")
    if table.has("scr") or table.has("x_over_r"):
        present.scr = table.quantity("scr", "1", *SCR_LIMITS, default=present.scr)
        present.x_over_r = table.quantity("x_over_r", "1", *X_OVER_R_LIMITS, default=present.x_over_r)
        event = replace(event, scr=present.scr, x_over_r=present.x_over_r)
    event = _read_source(table, event, present)
    event = _read_network(table, event, present)
    event = replace(
        event,
        P_pu=table.quantity("P_pu", "1", -MOST_POWER_PU, MOST_POWER_PU, default=None),
        Q_pu=table.quantity("Q_pu", "1", -MOST_POWER_PU, MOST_POWER_PU, default=None),
    )
    lasts = table.quantity("lasts", "s", 1e-3, LONGEST_S, default=None)
    if event == SuiteEvent(t_s=t_s):
        words = "scr, x_over_r, V_g_pu, sag, df, phase_jump, P_pu, Q_pu, load, fault or breaker"
        table.fault("", None, "changes nothing", f"Give {words}.")
    if lasts is None:
        return [event]
    return [event, *_end(table, event, lasts, before, present)]


def _read_source(table: TableReader, event: SuiteEvent, present: _Present) -> SuiteEvent:
    """Voltage, dip, frequency and phase of the grid's source."""
    V_g_pu = table.quantity("V_g_pu", "1", 0.0, 2.0, default=None)
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
    df_hz = table.quantity("df", "Hz", -MOST_DF_HZ, MOST_DF_HZ, default=None)
    over_s = table.quantity("over", "s", 0.0, LONGEST_S, default=0.0)
    rate = table.quantity("df_per_s", "Hz/s", 1e-3, 1e3, default=None)
    if rate is not None and df_hz is None:
        table.fault("df_per_s", f"{rate:g}", "there is no frequency to reach", 'Add it, such as df = "1 Hz".')
    elif rate is not None and table.has("over"):
        table.fault("df_per_s", f"{rate:g}", "the same event gives over", "Give the rate or the duration.")
    elif rate is not None and df_hz is not None:
        over_s = abs(df_hz - present.df_hz) / rate
    elif over_s != 0.0 and V_g_pu is None and df_hz is None:
        table.fault("over", f"{over_s:g} s", "there is nothing to ramp", "Use it with V_g_pu or df.")
    if df_hz is not None:
        present.df_hz = df_hz
    phase = table.quantity("phase_jump", "rad", -math.pi, math.pi, default=0.0)
    # To twelve digits: "30 deg" is 30 again.
    degrees = float(f"{math.degrees(phase):.12g}")
    return replace(event, V_g_pu=V_g_pu, sag=sag, df_hz=df_hz, over_s=over_s, phase_deg=degrees)


def _read_network(table: TableReader, event: SuiteEvent, present: _Present) -> SuiteEvent:
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
    return replace(
        event,
        load=None if isinstance(said.load, str) else said.load,
        load_off=said.load == NONE,
        fault=None if isinstance(said.fault, str) else said.fault,
        fault_cleared=said.fault == CLEARED,
        connected=None if said.breaker is None else present.network.connected,
        synchro_check=check,
    )


def _end(table: TableReader, event: SuiteEvent, lasts: float, before: _Present, present: _Present) -> list[SuiteEvent]:
    """The event that ends what another began ``lasts`` before. What it cannot end stays."""
    if not math.isfinite(lasts):  # its fault has been said
        return []
    end = SuiteEvent(t_s=float(f"{event.t_s + lasts:.12g}"))
    if event.over_s > lasts:
        table.fault("lasts", f"{lasts:g} s", f"ends before the ramp, which takes {event.over_s:g} s")
    if event.scr is not None:
        end = replace(end, scr=before.scr, x_over_r=before.x_over_r)
        present.scr, present.x_over_r = before.scr, before.x_over_r
    if event.sag is not None or event.V_g_pu is not None:
        end = replace(end, V_g_pu=before.V_g_pu)
        present.V_g_pu, present.sagged = before.V_g_pu, False
    now, then = present.network, before.network
    if now.fault != then.fault:
        end = replace(end, fault=then.fault, fault_cleared=then.fault is None)
    if now.load != then.load:
        end = replace(end, load=then.load, load_off=then.load is None)
    if now.connected != then.connected:
        end = replace(end, connected=then.connected)
    present.network = then
    if end == SuiteEvent(t_s=end.t_s):
        what = "scr, V_g_pu, sag, fault, load or breaker"
        table.fault("lasts", f"{lasts:g} s", "there is nothing that ends", f"Use it with {what}.")
        return []
    return [end]
