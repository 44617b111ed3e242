"""Load, fault, breaker and sag of a document: their fields, read, described in words, and written back."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.fields import (
    C_BASE,
    L_BASE,
    S_RATED,
    Z_BASE,
    Scope,
    at,
    document,
    number,
    picked,
    read,
    subtable,
    take,
    values,
    word,
)
from vsgdesign.study.parameters.grid import (
    FAULT_KINDS,
    PHASE_PAIRS,
    THREE_PHASE,
    Fault,
    Load,
    Network,
    Sag,
    SynchroCheck,
)
from vsgdesign.study.parameters.reader import TableReader, format_quantity

NONE, CLEARED, OPEN, CLOSED = "none", "cleared", "open", "closed"
"""Words that stand in the place of a load or a sag, of a fault, and the two states of the breaker."""

_LEAST, _MOST, _LEAST_X, _MOST_POWER, _MOST_FAULT_R = 0.01, 1e3, 1e-4, 100.0, 100.0
"""Limits in pu: of a parallel element and of a branch in series, of its elements, of a power, and of a resistance in a
fault. Less than the first is a short circuit."""


class Base(NamedTuple):
    """What per-unit quantities are taken on: Ω, the nominal angular frequency in rad/s, and VA."""

    Z: float
    omega: float
    S: float

    @classmethod
    def of(cls, converter: Converter) -> Base:
        """That of a converter."""
        return cls(converter.Z_base, converter.omega_n, converter.S_rated)

    @property
    def scope(self) -> Scope:
        """What limits in SI follow from."""
        bases = {S_RATED: self.S, Z_BASE: self.Z, L_BASE: self.Z / self.omega, C_BASE: 1.0 / (self.omega * self.Z)}
        return {times.of: value for times, value in bases.items()}


class SeriesFields:
    """The fields of a load's branch in series."""

    R: float | None = number("ohm", 0.0, _MOST * Z_BASE, default=None)
    """Resistance in series."""
    R_pu: float | None = number("1", 0.0, _MOST, default=None, scale=Z_BASE)
    """The same, pu of Z_base."""
    L: float | None = number("H", _LEAST_X * L_BASE, _MOST * L_BASE, default=None)
    """Inductance in series."""
    X_L_pu: float | None = number("1", _LEAST_X, _MOST, default=None, scale=L_BASE)
    """Its reactance at nominal frequency, pu of Z_base."""
    C: float | None = number("F", 1.0 / _MOST * C_BASE, 1.0 / _LEAST_X * C_BASE, default=None)
    """Capacitance in series."""
    X_C_pu: float | None = number("1", _LEAST_X, _MOST, default=None, scale=C_BASE)
    """Its reactance at nominal frequency, pu of Z_base."""


class LoadFields:
    """The fields of a load."""

    P: float | None = number("W", 0.0, _MOST_POWER * S_RATED, default=None)
    """Power at nominal voltage: a resistance in parallel."""
    P_pu: float | None = number("1", 0.0, _MOST_POWER, default=None, scale=S_RATED)
    """The same, pu of S_rated."""
    Q: float | None = number("var", -_MOST_POWER * S_RATED, _MOST_POWER * S_RATED, default=None)
    """Reactive power at nominal voltage and frequency: an inductance in parallel, or a capacitance if it is
    negative."""
    Q_pu: float | None = number("1", -_MOST_POWER, _MOST_POWER, default=None, scale=S_RATED)
    """The same, pu of S_rated."""
    R: float | None = number("ohm", _LEAST * Z_BASE, _MOST * Z_BASE, default=None)
    """Resistance in parallel."""
    R_pu: float | None = number("1", _LEAST, _MOST, default=None, scale=Z_BASE)
    """The same, pu of Z_base."""
    L: float | None = number("H", _LEAST * L_BASE, _MOST * L_BASE, default=None)
    """Inductance in parallel."""
    X_L_pu: float | None = number("1", _LEAST, _MOST, default=None, scale=L_BASE)
    """Its reactance at nominal frequency, pu of Z_base."""
    C: float | None = number("F", 1.0 / _MOST * C_BASE, 1.0 / _LEAST * C_BASE, default=None)
    """Capacitance in parallel."""
    X_C_pu: float | None = number("1", _LEAST, _MOST, default=None, scale=C_BASE)
    """Its reactance at nominal frequency, pu of Z_base."""
    series: Any = subtable(SeriesFields)
    """A further branch in parallel, of elements in series."""


class FaultFields:
    """The fields of a short circuit."""

    kind: str = word(FAULT_KINDS, default=THREE_PHASE)
    """Between which wires."""
    at: float = number("1", 0.0, 1.0, default=0.0)
    """Share of the grid's impedance between the PCC and the fault; less than 1."""
    R: float | None = number("ohm", 0.0, _MOST_FAULT_R * Z_BASE, default=None)
    """Resistance: of each phase to the common point, or between the two phases; none, or 0: bolted."""
    R_pu: float | None = number("1", 0.0, _MOST_FAULT_R, default=None, scale=Z_BASE)
    """The same, pu of Z_base."""
    phases: str = word(PHASE_PAIRS, default=Fault.phases)
    """The two phases; not for `three_phase`."""


class NetworkFields:
    """The fields that say what is connected at the PCC."""

    load: Any = subtable(LoadFields)
    """A balanced load."""
    fault: Any = subtable(FaultFields)
    """A short circuit."""
    breaker: str | None = word((OPEN, CLOSED), default=None, shown="closed")
    """The breaker between the PCC and the grid."""


def read_load(table: TableReader, base: Base | None) -> Load:
    """A load by its powers at nominal voltage or by its elements: in SI or pu with a base, and then in SI. Without a
    base in pu alone, as R, ωL and 1/(ωC) over the base impedance."""
    R, L, C = _elements(table, LoadFields, base)
    R, L, C = _by_powers(table, base, R, L, C)
    branch = table.child("series")
    series: tuple[float | None, ...] = (None, None, None)
    if branch is not None:
        series = read_series(branch, base)
        branch.finish()
    load = Load(R_parallel=R, L_parallel=L, C_parallel=C, R_series=series[0], L_series=series[1], C_series=series[2])
    if load == Load() and all(table.table.get(name, 0) == 0 for name in table.table):
        table.fault("", None, "is no load", f'Give P_pu, R_pu, X_L_pu, X_C_pu or series, or write load = "{NONE}".')
    table.finish()
    return load


def _by_powers(
    table: TableReader, base: Base | None, R: float | None, L: float | None, C: float | None
) -> tuple[float | None, float | None, float | None]:
    """The parallel elements with those that powers at nominal voltage stand for: R for P, L or C for Q."""
    P, Q = either(table, LoadFields, "P", "P_pu", base), either(table, LoadFields, "Q", "Q_pu", base)
    for power, elements in (("P", ("R",)), ("Q", ("X_L", "X_C", "L", "C"))):
        for name in (f"{element}{unit}" for element in elements for unit in ("", "_pu")):
            if name in table.table and (power in table.table or f"{power}_pu" in table.table):
                table.fault(name, table.table[name], f"{power} stands for it", "Give one of them.")
    V_sq, omega = (1.0, 1.0) if base is None else (base.Z * base.S, base.omega)
    if P:
        R = V_sq / P
    if Q and Q > 0.0:
        L = V_sq / (Q * omega)
    elif Q:
        C = V_sq / -Q if base is None else -Q / (omega * V_sq)
    return R, L, C


def _elements(table: TableReader, of: type, base: Base | None) -> tuple[float | None, float | None, float | None]:
    """Resistance, inductance and capacitance of a branch; None for what it does not have."""
    R, L = either(table, of, "R", "R_pu", base), either(table, of, "L", "X_L_pu", base)
    return R, L, either(table, of, "C", "X_C_pu", base, inverse=True)


def either(
    table: TableReader, of: type, name: str, name_pu: str, base: Base | None, *, inverse: bool = False
) -> float | None:
    """A quantity with its unit or in pu; without a base in pu alone. ``inverse``: the quantity is one over that of
    pu."""
    field, per_unit = picked(of, name, name_pu)
    value = take(table, per_unit, {}, None)
    if base is None:
        return value
    given = take(table, field, base.scope, None)
    if value is not None and given is not None:
        table.fault("", None, f"gives both {name} and {name_pu}", "Give one of them.")
    if given is not None or value is None:
        return given
    one_pu = at(per_unit.scale, base.scope)
    return one_pu / value if inverse else value * one_pu


def read_series(table: TableReader, base: Base | None) -> tuple[float | None, float | None, float | None]:
    """The elements of a series branch; none where they are faulty."""
    R, L, C = _elements(table, SeriesFields, base)
    if not table.table:
        table.fault("", None, "has no element", "Give R_pu, X_L_pu or X_C_pu, or leave series out.")
    if (R, L, C) == (None, None, None):
        return R, L, C
    if base is None:
        Z = complex(R or 0.0, (L or 0.0) - (C or 0.0))
    else:
        Z = Load(R_series=R, L_series=L, C_series=C).series_impedance(base.omega) / base.Z
    if abs(Z) >= _LEAST:
        return R, L, C
    if not math.isnan(abs(Z)):  # NaN has had its own fault
        problem = f"its impedance at nominal frequency is {abs(Z):.3g} pu, less than {_LEAST:g} pu"
        table.fault("", None, problem, "Give more. A short circuit is a fault: fault = { … }")
    return None, None, None


def read_fault(table: TableReader, base: Base | None) -> Fault:
    """A short circuit; its resistance in Ω, or in pu without a base."""
    found = values(picked(FaultFields, "kind", "at"), table)
    if found["at"] == 1.0:
        table.fault("at", table.table["at"], "would short the source itself", "Give less than 1.")
    R = either(table, FaultFields, "R", "R_pu", base)
    phases = values(picked(FaultFields, "phases"), table)
    if found["kind"] == THREE_PHASE and table.has("phases"):
        table.fault("phases", table.table["phases"], "a three-phase fault has no pair of phases", "Leave it out.")
    table.finish()
    return Fault(**found, **phases, R=R or 0.0)


def read_sag(table: TableReader) -> Sag:
    """A voltage sag."""
    return read(Sag, table)


def read_synchro_check(table: TableReader) -> SynchroCheck:
    """The limits of a synchro-check."""
    return read(SynchroCheck, table)


class Said(NamedTuple):
    """What one table says of the network. None: nothing."""

    load: Load | str | None
    fault: Fault | str | None
    breaker: str | None

    def on(self, network: Network) -> Network:
        """A network with what is said; the rest is kept."""
        return Network(
            load=network.load if self.load is None else (None if isinstance(self.load, str) else self.load),
            fault=network.fault if self.fault is None else (None if isinstance(self.fault, str) else self.fault),
            connected=network.connected if self.breaker is None else self.breaker == CLOSED,
        )


NOTHING_SAID = Said(None, None, None)


def read_said(table: TableReader, base: Base | None) -> Said:
    """``load``, ``fault`` and ``breaker`` of a table."""
    load, fault = table.child_or_word("load", NONE), table.child_or_word("fault", CLEARED)
    breaker = values(picked(NetworkFields, "breaker"), table)["breaker"]
    return Said(
        load=read_load(load, base) if isinstance(load, TableReader) else load,
        fault=read_fault(fault, base) if isinstance(fault, TableReader) else fault,
        breaker=breaker if breaker == table.table.get("breaker") else None,  # a faulty word says nothing
    )


def check_said(table: TableReader, said: Said, network: Network) -> None:
    """Something can only end that has begun. ``network`` is the one before."""
    if said.load == NONE and network.load is None:
        table.fault("load", NONE, "there is no load that it could take away", "Leave it out.")
    if said.fault == CLEARED and network.fault is None:
        table.fault("fault", CLEARED, "there is no fault that it could clear", "Leave it out, or begin one before.")
    if said.breaker is not None and (said.breaker == CLOSED) == network.connected:
        table.fault("breaker", said.breaker, f"it is {said.breaker} already", "Leave it out.")


def network_words(said: Said, base: Base) -> list[str]:
    """What is said of a network in SI, in words."""
    words = []
    if isinstance(said.load, Load):
        words.append(load_words(said.load, base))
    elif said.load is not None:
        words.append("no load")
    if isinstance(said.fault, Fault):
        words.append(fault_words(said.fault))
    elif said.fault is not None:
        words.append("fault cleared")
    if said.breaker is not None:
        words.append("breaker opens" if said.breaker == OPEN else "breaker closes")
    return words


def synchro_check_words(check: SynchroCheck) -> str:
    """``breaker waits to close within 10°``."""
    around = "" if check.around == 0.0 else f" around {math.degrees(check.around):+.3g}°"
    return f"breaker waits to close within {math.degrees(check.angle):.3g}°{around}"


def load_words(load: Load, base: Base) -> str:
    """A load in SI by its powers at nominal voltage and frequency: ``load 4 kW, 1 kvar``."""
    power = load.admittance(base.omega).conjugate() * base.Z * base.S
    P, Q = (float(f"{part:.4g}") for part in (power.real, power.imag))
    parts = [format_quantity(P, "W")] if abs(P) > 1e-9 * base.S else []
    parts += [format_quantity(Q, "var")] if abs(Q) > 1e-9 * base.S or not parts else []
    return "load " + ", ".join(parts)


def fault_words(fault: Fault) -> str:
    """``three-phase fault at the PCC, 0.1 ohm``."""
    what = "three-phase fault" if fault.kind == THREE_PHASE else f"fault from phase {' to '.join(fault.phases)}"
    where = "at the PCC" if fault.at == 0.0 else f"behind {100.0 * fault.at:.4g} % of the grid's impedance"
    return f"{what} {where}, {'bolted' if fault.R == 0.0 else format_quantity(fault.R, 'ohm')}"


def sag_words(sag: Sag | str) -> str:
    """``sag type C to 0.5 pu``."""
    if isinstance(sag, str):
        return "sag ends"
    angle = "" if sag.angle == 0.0 else f", {math.degrees(sag.angle):+.3g}°"
    return f"sag type {sag.kind} to {sag.V_pu:.3g} pu{angle}"


def beyond_models(network: Network) -> str | None:
    """Why the models of steady states and of small signals do not know a network; None for one that they know."""
    if not network.connected:
        what = "the breaker to the grid is open"
    elif network.fault is not None:
        what = "there is a fault"
    elif network.load is not None:
        what = "there is a load at the PCC"
    else:
        return None
    return f"{what}: the steady state and the modes that a settling time needs are not computed for that"


def load_document(load: Load, *, per_unit: bool = False) -> dict[str, Any]:
    """The table of a load, as :func:`read_load` reads it. ``per_unit``: its elements are R, ωL and 1/(ωC) in pu."""
    names = ("R_pu", "X_L_pu", "X_C_pu") if per_unit else ("R", "L", "C")

    def branch(*values: float | None) -> dict[str, Any]:
        return {name: value for name, value in zip(names, values, strict=True) if value is not None}

    found = branch(load.R_parallel, load.L_parallel, load.C_parallel)
    series = branch(load.R_series, load.L_series, load.C_series)
    return found | ({"series": series} if series else {})


def fault_document(fault: Fault, *, per_unit: bool = False) -> dict[str, Any]:
    """The table of a fault, as :func:`read_fault` reads it. ``per_unit``: its resistance is in pu."""
    found: dict[str, Any] = {"kind": fault.kind, "at": fault.at, "R_pu" if per_unit else "R": fault.R}
    return found if fault.kind == THREE_PHASE else found | {"phases": fault.phases}


def sag_document(sag: Sag) -> dict[str, Any]:
    """The table of a sag, as :func:`read_sag` reads it."""
    return document(sag, "type", "V_pu") if sag.angle == 0.0 else document(sag)


def synchro_check_document(check: SynchroCheck) -> dict[str, Any]:
    """The table of a synchro-check, as :func:`read_synchro_check` reads it."""
    return document(check)


def fault_in_si(fault: Fault, Z_base: float) -> Fault:
    """A fault whose resistance is in pu with that in Ω."""
    return replace(fault, R=fault.R * Z_base)
