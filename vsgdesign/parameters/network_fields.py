"""Load, fault, breaker and sag of a document: read, described in words, and written back."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

from vsgdesign.equations.sags import SAG_TYPES
from vsgdesign.parameters.converter import Converter
from vsgdesign.parameters.network import FAULT_KINDS, PHASE_PAIRS, THREE_PHASE, Fault, Load, Network, SynchroCheck
from vsgdesign.parameters.reader import TableReader
from vsgdesign.parameters.source import Sag
from vsgdesign.parameters.units import format_quantity

NONE, CLEARED, OPEN, CLOSED = "none", "cleared", "open", "closed"
"""Words that stand in the place of a load or a sag, of a fault, and the two states of the breaker."""

_LOAD = (0.01, 1e3)
_MOST_POWER = 1.0 / _LOAD[0]
_SERIES_R, _SERIES_X = (0.0, 1e3), (1e-4, 1e3)
"""Limits of a load's elements, pu. Less than the first is a short circuit."""

_MOST_FAULT_R = 100.0
"""Largest resistance of a fault, pu."""

_WIDEST_ANGLE = 0.5 * math.pi
"""Largest phase-angle jump of a sag's characteristic voltage, rad."""


class Base(NamedTuple):
    """What per-unit quantities are taken on: Ω, the nominal angular frequency in rad/s, and VA."""

    Z: float
    omega: float
    S: float

    @classmethod
    def of(cls, converter: Converter) -> Base:
        """That of a converter."""
        return cls(converter.Z_base, converter.omega_n, converter.S_rated)


def read_load(table: TableReader, base: Base | None) -> Load:
    """A load by its powers at nominal voltage or by its elements: in SI or pu with a base, and then in SI. Without a
    base in pu alone, as R, ωL and 1/(ωC) over the base impedance."""
    R, L, C = _elements(table, base, _LOAD, _LOAD)
    R, L, C = _by_powers(table, base, R, L, C)
    branch = table.child("series")
    series: tuple[float | None, ...] = (None, None, None)
    if branch is not None:
        series = _series(branch, base)
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
    S = None if base is None else base.S
    P = _either(table, "P", "P_pu", "W", (0.0, _MOST_POWER), S)
    Q = _either(table, "Q", "Q_pu", "var", (-_MOST_POWER, _MOST_POWER), S)
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


def _elements(
    table: TableReader, base: Base | None, R_pu: tuple[float, float], X_pu: tuple[float, float]
) -> tuple[float | None, float | None, float | None]:
    """Resistance, inductance and capacitance of a branch; None for what it does not have."""
    R = _either(table, "R", "R_pu", "ohm", R_pu, None if base is None else base.Z)
    L = _either(table, "L", "X_L_pu", "H", X_pu, None if base is None else base.Z / base.omega)
    C = _either(table, "C", "X_C_pu", "F", X_pu, None if base is None else 1.0 / (base.omega * base.Z), inverse=True)
    return R, L, C


def _either(
    table: TableReader,
    field: str,
    field_pu: str,
    unit: str,
    limits_pu: tuple[float, float],
    one_pu: float | None,
    *,
    inverse: bool = False,
    default: float | None = None,
) -> float | None:
    """A quantity with its unit or in pu. ``one_pu``: what 1 pu is in SI; None: pu alone. ``inverse``: the quantity is
    one over that of pu."""
    value = table.quantity(field_pu, "1", *limits_pu, default=None)
    if one_pu is None:
        return default if value is None else value
    limits = [one_pu / limit if inverse else limit * one_pu for limit in limits_pu]
    given = table.quantity(field, unit, min(limits), max(limits), default=None)
    if value is not None and given is not None:
        table.fault("", None, f"gives both {field} and {field_pu}", "Give one of them.")
    if given is not None:
        return given
    if value is None:
        return default
    return one_pu / value if inverse else value * one_pu


def _series(table: TableReader, base: Base | None) -> tuple[float | None, float | None, float | None]:
    """The elements of a series branch; none where they are faulty."""
    R, L, C = _elements(table, base, _SERIES_R, _SERIES_X)
    if not table.table:
        table.fault("", None, "has no element", "Give R_pu, X_L_pu or X_C_pu, or leave series out.")
    if (R, L, C) == (None, None, None):
        return R, L, C
    if base is None:
        Z = complex(R or 0.0, (L or 0.0) - (C or 0.0))
    else:
        Z = Load(R_series=R, L_series=L, C_series=C).series_impedance(base.omega) / base.Z
    if abs(Z) >= _LOAD[0]:
        return R, L, C
    if not math.isnan(abs(Z)):  # NaN has had its own fault
        problem = f"its impedance at nominal frequency is {abs(Z):.3g} pu, less than {_LOAD[0]:g} pu"
        table.fault("", None, problem, "Give more. A short circuit is a fault: fault = { … }")
    return None, None, None


def read_fault(table: TableReader, base: Base | None) -> Fault:
    """A short circuit; its resistance in Ω, or in pu without a base."""
    kind = table.choice("kind", FAULT_KINDS, default=THREE_PHASE)
    at = table.quantity("at", "1", 0.0, 1.0, default=0.0)
    if at == 1.0:
        table.fault("at", table.table["at"], "would short the source itself", "Give less than 1.")
    R = _either(table, "R", "R_pu", "ohm", (0.0, _MOST_FAULT_R), None if base is None else base.Z, default=0.0)
    phases = table.choice("phases", PHASE_PAIRS, default=Fault.phases)
    if kind == THREE_PHASE and table.has("phases"):
        table.fault("phases", table.table["phases"], "a three-phase fault has no pair of phases", "Leave it out.")
    return _finished(table, Fault(kind=kind, at=at, R=R or 0.0, phases=phases))


def read_sag(table: TableReader) -> Sag:
    """A voltage sag."""
    sag = Sag(
        kind=table.choice("type", tuple(SAG_TYPES)),
        V_pu=table.quantity("V_pu", "1", 0.0, 1.0),
        angle=table.quantity("angle", "rad", -_WIDEST_ANGLE, _WIDEST_ANGLE, default=0.0),
    )
    return _finished(table, sag)


def _finished(table: TableReader, found: Any) -> Any:
    table.finish()
    return found


def read_synchro_check(table: TableReader) -> SynchroCheck:
    """The limits of a synchro-check."""
    check = SynchroCheck(
        angle=table.quantity("angle", "rad", math.radians(0.1), 0.5 * math.pi, default=math.radians(10.0)),
        V_pu=table.quantity("V_pu", "1", 0.001, 1.0, default=0.1),
        omega=2.0 * math.pi * table.quantity("df", "Hz", 0.001, 10.0, default=0.3),
        around=table.quantity("around", "rad", -math.pi, math.pi, default=0.0),
    )
    return _finished(table, check)


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
    breaker = table.choice("breaker", (OPEN, CLOSED), default=None)
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


def fault_words(fault: Fault, unit: str = "ohm") -> str:
    """``three-phase fault at the PCC, 0.1 ohm``. ``unit``: of its resistance, ohm or pu."""
    what = "three-phase fault" if fault.kind == THREE_PHASE else f"fault from phase {' to '.join(fault.phases)}"
    where = "at the PCC" if fault.at == 0.0 else f"behind {100.0 * fault.at:.4g} % of the grid's impedance"
    R = format_quantity(fault.R, "ohm") if unit == "ohm" else f"{fault.R:.4g} pu"
    return f"{what} {where}, {'bolted' if fault.R == 0.0 else R}"


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
    found: dict[str, Any] = {"type": sag.kind, "V_pu": sag.V_pu}
    return found if sag.angle == 0.0 else found | {"angle": sag.angle}


def synchro_check_document(check: SynchroCheck) -> dict[str, Any]:
    """The table of a synchro-check, as :func:`read_synchro_check` reads it."""
    df = check.omega / (2.0 * math.pi)
    return {"angle": check.angle, "V_pu": check.V_pu, "df": df, "around": check.around}


def fault_in_si(fault: Fault, Z_base: float) -> Fault:
    """A fault whose resistance is in pu with that in Ω."""
    return replace(fault, R=fault.R * Z_base)


def network_document(network: Network) -> dict[str, Any]:
    """The fields ``load``, ``fault`` and ``breaker`` of a network in SI that differ from the plain one."""
    found: dict[str, Any] = {}
    if network.load is not None:
        found["load"] = load_document(network.load)
    if network.fault is not None:
        found["fault"] = fault_document(network.fault)
    return found if network.connected else found | {"breaker": OPEN}
