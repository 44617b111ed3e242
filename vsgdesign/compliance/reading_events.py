"""Reads the events of a test of a suite file: what changes at which instant, per unit of the converter."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from vsgdesign.compliance.suite import Sag, SuiteEvent
from vsgdesign.parameters.network import FAULT_KINDS, PHASE_PAIRS, THREE_PHASE, Fault, Load
from vsgdesign.parameters.reader import TableReader
from vsgdesign.parameters.scenario import SCR_LIMITS, X_OVER_R_LIMITS

LONGEST_S = 600.0
"""Longest time that a test may speak of, s."""
MOST_DF_HZ = 12.0
"""Largest distance from the nominal frequency, Hz."""
MOST_POWER_PU = 2.0
IMPEDANCE_LIMITS = (1e-3, 1e4)
"""Limits of an element of a load, pu."""
SAG_KINDS = ("A", "B", "C", "D", "E", "F", "G")


@dataclass
class _Present:
    """What the events so far have left, for those that say only a part."""

    scr: float
    x_over_r: float
    V_g_pu: float
    df_hz: float
    load: Load | None


def read_events(
    tables: list[TableReader], scr: float, x_over_r: float, V_g_pu: float, load: Load | None
) -> tuple[SuiteEvent, ...]:
    """The events in the order of time. What ``lasts`` ends with an event of its own."""
    present = _Present(scr, x_over_r, V_g_pu, 0.0, load)
    timed = [(table.quantity("time", "s", 0.0, LONGEST_S, default=0.0), table) for table in tables]
    timed.sort(key=lambda pair: math.inf if math.isnan(pair[0]) else pair[0])
    found: list[SuiteEvent] = []
    for t_s, table in timed:
        found += _read_event(table, t_s, present)
        table.finish()
    return tuple(sorted(found, key=lambda event: event.t_s))


def _read_event(table: TableReader, t_s: float, present: _Present) -> list[SuiteEvent]:
    before = replace(present)
    event = SuiteEvent(t_s=t_s)
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
        words = "scr, x_over_r, V_g_pu, sag, df, phase_jump, P_pu, Q_pu, fault, load or connected"
        table.fault("", None, "changes nothing", f"Give {words}.")
    if lasts is None:
        return [event]
    return [event, *_end(table, event, lasts, before, present)]


def _read_source(table: TableReader, event: SuiteEvent, present: _Present) -> SuiteEvent:
    """Voltage, dip, frequency and phase of the grid's source."""
    V_g_pu = table.quantity("V_g_pu", "1", 0.0, 2.0, default=None)
    dip = table.child("sag")
    sag = None
    if dip is not None:
        sag = Sag(kind=dip.choice("kind", SAG_KINDS, default="A"), V_pu=dip.quantity("V_pu", "1", 0.0, 1.0))
        dip.finish()
        if V_g_pu is not None:
            table.fault("V_g_pu", f"{V_g_pu:g}", "the same event gives a sag", "Give the one or the other.")
    if V_g_pu is not None:
        present.V_g_pu = V_g_pu
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
    """Short circuit, load and breaker."""
    fault = _read_fault(table)
    cleared = table.flag("fault_cleared", default=False)
    if cleared and fault is not None:
        table.fault("fault_cleared", "true", "the same event gives a fault", "Clear it in a later event, or use lasts.")
    load = read_load(table)
    load_off = table.flag("load_off", default=False)
    if load_off and load is not None:
        table.fault("load_off", "true", "the same event gives a load", "Give the one or the other.")
    if load is not None or load_off:
        present.load = load
    return replace(
        event,
        fault=fault,
        fault_cleared=cleared,
        load=load,
        load_off=load_off,
        connected=table.flag("connected", default=None),
    )


def _end(table: TableReader, event: SuiteEvent, lasts: float, before: _Present, present: _Present) -> list[SuiteEvent]:
    """The event that ends what another began ``lasts`` before. What it cannot end stays."""
    end = SuiteEvent(t_s=float(f"{event.t_s + lasts:.12g}"))
    if event.sag is not None or event.V_g_pu is not None:
        present.V_g_pu = before.V_g_pu
        end = replace(end, V_g_pu=before.V_g_pu)
    if event.fault is not None:
        end = replace(end, fault_cleared=True)
    if event.load is not None or event.load_off:
        present.load = before.load
        end = replace(end, load=before.load, load_off=before.load is None)
    if event.connected is not None:
        end = replace(end, connected=not event.connected)
    if event.over_s > lasts:
        table.fault("lasts", f"{lasts:g} s", f"ends before the ramp, which takes {event.over_s:g} s")
    if end == SuiteEvent(t_s=end.t_s):
        table.fault(
            "lasts", f"{lasts:g} s", "there is nothing that ends", "Use it with sag, V_g_pu, fault, load or connected."
        )
        return []
    return [end]


def _read_fault(table: TableReader) -> Fault | None:
    given = table.child("fault")
    if given is None:
        return None
    fault = Fault(
        kind=given.choice("kind", FAULT_KINDS, default=THREE_PHASE),
        at=given.quantity("at", "1", 0.0, 0.99, default=0.0),
        R=given.quantity("R", "1", 0.0, 100.0, default=0.0, hint="It is in pu of the base impedance."),
        phases=given.choice("phases", PHASE_PAIRS, default="bc"),
    )
    if fault.kind == THREE_PHASE and given.has("phases"):
        given.fault("phases", fault.phases, "a three-phase fault has all of them", "Leave it out.")
    given.finish()
    return fault


def read_load(table: TableReader) -> Load | None:
    """The load of a test or an event: by its power at nominal voltage, or by its elements, per unit."""
    given = table.child("load")
    if given is None:
        return None
    elements = [f"{element}_{branch}" for branch in ("parallel", "series") for element in "RLC"]
    if not given.table:
        given.fault("", None, "names no element", "For example load = { P_pu = 0.5 }, or R_parallel = 2.0.")
    found = {name: given.quantity(name, "1", *IMPEDANCE_LIMITS, default=None) for name in elements}
    P_pu = given.quantity("P_pu", "1", 0.0, MOST_POWER_PU, default=None)
    Q_pu = given.quantity("Q_pu", "1", -MOST_POWER_PU, MOST_POWER_PU, default=None)
    for power, parallel in (("P_pu", ("R_parallel",)), ("Q_pu", ("L_parallel", "C_parallel"))):
        for name in parallel:
            if given.has(power) and given.has(name):
                given.fault(name, f"{found[name]:g}", f"{power} stands for it", "Give the one or the other.")
    given.finish()
    if P_pu:
        found["R_parallel"] = 1.0 / P_pu
    if Q_pu:
        found["L_parallel" if Q_pu > 0.0 else "C_parallel"] = 1.0 / abs(Q_pu)
    return Load(**found)
