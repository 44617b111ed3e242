"""The tables [[network.inverters]], and loads that take a constant power: their fields, read into inverters."""

from __future__ import annotations

import math
from typing import Any

from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.grid_following import SetPoints
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.fields import (
    F_N,
    S_RATED,
    Field,
    Scope,
    fields_of,
    number,
    picked,
    values,
    whole,
    word,
)
from vsgdesign.study.parameters.inverter_kinds import (
    FOLLOWING,
    GRID_FOLLOWING,
    INVERTER_KINDS,
    POWER,
    FollowingFields,
    InverterKind,
    InverterRatings,
)
from vsgdesign.study.parameters.network import Load
from vsgdesign.study.parameters.power_plant import Inverter
from vsgdesign.study.parameters.reader import TableReader

IMPEDANCE, CONSTANT_POWER = "impedance", "constant_power"
_ROOM = 1.25
"""Rating of the rectifier of a constant-power load over the power that it takes."""


def _kinds() -> tuple[str, ...]:
    return tuple(INVERTER_KINDS)


class InverterFields:
    """The fields of an inverter whatever its kind."""

    kind: str = word(_kinds, default=FOLLOWING)
    """Which controller it has; more can be [registered](theory/plants.md#another-kind)."""
    S_rated: float = number("VA", 1e-3 * S_RATED, 1e3 * S_RATED, default=S_RATED)
    """Rating, the base of its quantities in pu."""
    P_ref: float = number("W", -1e3 * S_RATED, 1e3 * S_RATED, default=0.0)
    """Active power out of it at t = 0; negative where it takes power."""
    Q_ref: float = number("var", -1e3 * S_RATED, 1e3 * S_RATED, default=0.0)
    """Reactive power out of it at t = 0."""
    reactance: float = number("1", 0.0, 10.0, default=0.0)
    """Reactance of its transformer and feeder."""
    resistance: float = number("1", 0.0, 10.0, default=0.0)
    """Its resistance."""
    f_s: float | None = number("Hz", 5.0 * F_N, 1e7, default=None, shown="of `[converter]`")
    """Sampling frequency of its controller."""
    delay_samples: int | None = whole(0, 1, default=None, shown="of `[converter]`")
    """Samples between measuring and applying."""
    offset: float = number("1", 0.0, 0.999, default=0.0)
    """When it samples for the first time, as a share of its sampling period."""


class FilterFields:
    """The LCL filter of an inverter, pu of its rating."""

    X_1: float = number("1", 1e-3, 1.0, default=0.1, name="L_1_pu")
    """Reactance of the converter-side inductor."""
    R_1: float = number("1", 0.0, 1.0, default=0.005, name="R_1_pu")
    """Its resistance."""
    B: float = number("1", 1e-4, 1.0, default=0.05, name="C_pu")
    """Susceptance of the capacitor."""
    R_c: float = number("1", 0.0, 10.0, default=0.2, name="R_c_pu")
    """Damping resistor in series with it."""
    X_2: float = number("1", 0.0, 1.0, default=0.03, name="L_2_pu")
    """Reactance of the grid-side inductor."""
    R_2: float = number("1", 0.0, 1.0, default=0.002, name="R_2_pu")
    """Its resistance."""


def inverter_fields() -> tuple[Field, ...]:
    """All fields of an inverter: those of every one, then those of each kind, once a name."""
    found = {one.name: one for one in (*fields_of(InverterFields), *fields_of(FilterFields))}
    for kind in INVERTER_KINDS.values():
        found |= {one.name: one for one in fields_of(kind.fields) if one.name not in found}
    return tuple(found.values())


class LoadKind:
    """What a load is."""

    kind: str = word((IMPEDANCE, CONSTANT_POWER), default=IMPEDANCE)
    """Constant impedance; or an active rectifier that takes P and Q at any voltage, with a controller that samples."""


class RectifierFields:
    """The fields of a constant-power load beside P and Q; its filter has the defaults of an inverter's."""

    S_rated: float | None = number(
        "VA", 1e-3 * S_RATED, 1e3 * S_RATED, default=None, shown="1.25 of its apparent power"
    )
    """Rating of a constant-power load's rectifier."""


_OF_FOLLOWING = ("pll_bandwidth", "pll_damping", "current_bandwidth", "feedforward_time", "voltage_filter")


def rectifier_fields() -> tuple[Field, ...]:
    """The fields of a load of constant power beside those of a load."""
    return (*fields_of(RectifierFields), *picked(FollowingFields, *_OF_FOLLOWING))


def read_inverter(table: TableReader, name: str, node: str, converter: Converter, scope: Scope) -> Inverter:
    """An inverter of a table whose name, node and breaker are read."""
    found = values(InverterFields, table, scope)
    given = values(FilterFields, table)
    kind = INVERTER_KINDS[found["kind"]]
    own = values(kind.fields, table, scope)
    table.finish()
    S = found["S_rated"]
    asked = SetPoints(found["P_ref"], found["Q_ref"])
    if math.hypot(*asked) > S * (1.0 + 1e-9):
        problem = f"P_ref and Q_ref are {math.hypot(*asked) / S:.3g} times its rating"
        table.fault("P_ref", f"{asked.P_ref:g} W", problem, "Ask for less, or give a larger S_rated.")
    return _made(name, node, kind, own, converter, found, given, asked)


def read_rectifier(
    table: TableReader, name: str, node: str, converter: Converter, load: Load, given: dict[str, Any]
) -> Inverter:
    """The rectifier of a load of constant power. ``given``: its own fields by attribute."""
    S_base = load.admittance(converter.omega_n).conjugate() * 3.0 * converter.V_rated_rms**2
    taken = abs(S_base)
    S = _ROOM * taken if given["S_rated"] is None else given["S_rated"]
    if not taken > 0.0:
        S, taken = converter.S_rated, 0.0
    if taken > S:
        table.fault("S_rated", f"{S:g} VA", f"the load takes {taken:.4g} VA", "Give a larger S_rated.")
    own = values(FollowingFields, None) | given | {"keeps": POWER}
    basis = values(InverterFields, None, {S_RATED.of: converter.S_rated, F_N.of: 1.0}) | {"S_rated": S}
    asked = SetPoints(-S_base.real, -S_base.imag)
    return _made(name, node, GRID_FOLLOWING, own, converter, basis, values(FilterFields, None), asked)


def _made(
    name: str,
    node: str,
    kind: InverterKind,
    own: dict[str, Any],
    converter: Converter,
    found: dict[str, Any],
    given: dict[str, Any],
    asked: SetPoints,
) -> Inverter:
    S, omega = found["S_rated"], converter.omega_n
    Z = converter.Z_base * converter.S_rated / S
    T_s = converter.T_s if found["f_s"] is None else 1.0 / found["f_s"]
    delay = converter.delay_samples if found["delay_samples"] is None else found["delay_samples"]
    filter_ = Filter(
        L_1=given["X_1"] * Z / omega,
        R_1=given["R_1"] * Z,
        C=given["B"] / (Z * omega),
        R_c=given["R_c"] * Z,
        L_2=given["X_2"] * Z / omega,
        R_2=given["R_2"] * Z,
    )
    ratings = InverterRatings(
        S_rated=S,
        V_rated_pk=rms_to_peak(converter.V_rated_rms),
        I_rated_pk=converter.I_rated_pk * S / converter.S_rated,
        omega_n=omega,
        T_s=T_s,
        delay_samples=delay,
        v_max_pk=converter.v_max_pk,
        filter=filter_,
    )
    return Inverter(
        name=name,
        node=node,
        kind=kind,
        settings=kind.build(ratings, own),
        filter=filter_,
        S_rated=S,
        V_rated_rms=converter.V_rated_rms,
        T_s=T_s,
        delay_samples=delay,
        R=found["resistance"] * Z,
        L=found["reactance"] * Z / omega,
        asked=asked,
        offset=found["offset"] * T_s,
    )
