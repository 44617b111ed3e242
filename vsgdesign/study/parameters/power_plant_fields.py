"""The section [plant], the lists of [network] and its inverters: their fields, and inverters read from them."""

from __future__ import annotations

import math
from typing import Any

from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.grid_following import SetPoints
from vsgdesign.identification.field import PAIRS
from vsgdesign.study.parameters.converter import Converter, Filter
from vsgdesign.study.parameters.fields import (
    C_BASE,
    F_N,
    L_BASE,
    MOST_REFERENCE,
    S_RATED,
    V_RATED,
    Z_BASE,
    Field,
    Scope,
    fields_of,
    number,
    picked,
    subtable,
    text,
    values,
    whole,
    whole_range,
    word,
)
from vsgdesign.study.parameters.grid import Load
from vsgdesign.study.parameters.inverter_kinds import (
    FOLLOWING,
    GRID_FOLLOWING,
    INVERTER_KINDS,
    POWER,
    FollowingFields,
    InverterKind,
    InverterRatings,
)
from vsgdesign.study.parameters.network_fields import (
    CLOSED,
    OPEN,
    LoadFields,
    NetworkFields,
    SeriesFields,
)
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


MOST_UNITS = 32
TOGETHER, SPREAD = "together", "spread"
OWN, COMMON = "own", "common"
_MOST_PU = 1e3


class PlantFields:
    """The fields of [plant]."""

    units: tuple[int, int] = whole_range(1, MOST_UNITS)
    """How many equal converters there are; [least, all]: gains are designed for every number of them from the least
    on, as after the loss of units."""
    reactance: float = number("1", 0.0, 10.0, default=0.0)
    """Reactance x_t of one unit's transformer and feeder, pu of one unit."""
    resistance: float = number("1", 0.0, 10.0, default=0.0)
    """Its resistance, pu of one unit."""
    sampling: str = word((TOGETHER, SPREAD), default=TOGETHER)
    """All units sample at the same instants, or one after the other, spread over a sampling period."""
    estimators: str = word((OWN, COMMON), default=OWN)
    """With `estimate = "field"`: each unit has an estimator with a probe of its own, for four units at most, or all of
    them share [one at the node](theory/plants.md#one-estimate-for-all-units)."""


class Named:
    """The name that events give to it."""

    name: str = text(kind="name", limits="letters, digits, `-` `_` `.`; unique in the plant")
    """Name."""


class Breaker:
    """The breaker that connects it."""

    breaker: str = word((OPEN, CLOSED), default=CLOSED)
    """Its breaker at t = 0."""


class AtNode:
    """Where it is."""

    node: str = text(limits="a node")
    """The node to which it is connected."""


class Series:
    """Resistance and inductance in series."""

    R: float | None = number("ohm", 0.0, _MOST_PU * Z_BASE, default=None)
    """Resistance."""
    R_pu: float | None = number("1", 0.0, _MOST_PU, default=None, scale=Z_BASE)
    """The same, pu of Z_base; with `S_rated` pu of that rating."""
    L: float | None = number("H", 0.0, _MOST_PU * L_BASE, default=None)
    """Inductance."""
    X_pu: float | None = number("1", 0.0, _MOST_PU, default=None, scale=L_BASE)
    """Its reactance at nominal frequency, pu as `R_pu`."""


class Ends:
    """Between which nodes it lies."""

    start: str = text(name="from", limits="a node")
    """The node at which it begins."""
    end: str = text(name="to", limits="another node")
    """The node at which it ends."""


class OfBranch:
    """What makes a cable or a transformer of a branch."""

    C: float | None = number("F", 0.0, _MOST_PU * C_BASE, default=None)
    """Capacitance to neutral of a cable, half of it at each end."""
    B_pu: float | None = number("1", 0.0, _MOST_PU, default=None, scale=C_BASE)
    """Its susceptance at nominal frequency, pu of 1/Z_base."""
    S_rated: float | None = number("VA", 1e-3 * S_RATED, 1e4 * S_RATED, default=None)
    """Rating of a transformer, on which `R_pu` and `X_pu` are taken; none: on that of `[converter]`."""


class OfSource:
    """An ideal source."""

    V_rms: float = number("1", 0.1, 2.0, default=1.0, name="V_pu", scale=V_RATED)
    """Voltage, pu of rated."""
    phase: float = number("rad", -math.pi, math.pi, default=0.0)
    """By how much it leads the grid's source."""


class OfUnit:
    """What a unit has of its own."""

    case: Any = text(default=None, limits="`case:NAME` or a file", shown="the study itself")
    """A packaged case or a study file from which its converter, filter, inner loops and power loops are taken."""
    reactance: float = number("1", 0.0, 10.0, default=0.0)
    """Reactance x_t of its transformer and feeder, pu of this unit."""
    resistance: float = number("1", 0.0, 10.0, default=0.0)
    """Its resistance, pu of this unit."""
    P_ref: float | None = number("W", -1.0 * MOST_REFERENCE, MOST_REFERENCE, default=None, shown="of `[simulation]`")
    """Set point at t = 0."""
    Q_ref: float | None = number("var", -1.0 * MOST_REFERENCE, MOST_REFERENCE, default=None, shown="of `[simulation]`")
    """Set point at t = 0."""
    offset: float = number("1", 0.0, 0.999, default=0.0)
    """When it samples for the first time, as a share of its sampling period."""
    pair: int | None = whole(1, len(PAIRS), default=None, shown="the next one that is free")
    """On which [pair of lines](#estimatorprobe) its field estimator sends its probe."""
    dc: Any = subtable((), shown="of its case, or `[dc]`")
    """The capacitor of its dc link and what feeds it ([dc side](theory/dc-side.md#in-a-plant)), with the fields of
    [`[dc]`](#dc)."""


def _several(*of: type) -> tuple[Any, ...]:
    return tuple(field for one in of for field in fields_of(one))


NODE = fields_of(Named)
BRANCH = _several(Named, Ends, Series, OfBranch, Breaker)
SHUNT = _several(Named, AtNode, SeriesFields, Breaker)
LOAD = (*_several(Named, AtNode, LoadKind, LoadFields), *rectifier_fields(), *fields_of(Breaker))
SOURCE = _several(Named, AtNode, OfSource, Series, Breaker)
UNIT = _several(Named, AtNode, OfUnit, Breaker)


def _inverter() -> tuple[Any, ...]:
    return (*_several(Named, AtNode), *inverter_fields(), *fields_of(Breaker))


class ListFields:
    """The fields of [network] that describe more than a load, a fault and a breaker at the PCC."""

    pcc: str = text(default="pcc", limits="a node")
    """The node to which the grid's impedance leads; `load`, `fault` and `breaker` are there."""
    nodes: Any = subtable(NODE, kind="tables", shown="none")
    """The nodes."""
    branches: Any = subtable(BRANCH, kind="tables", shown="none")
    """Lines, cables and transformers between nodes."""
    shunts: Any = subtable(SHUNT, kind="tables", shown="none")
    """R, L and C in series between a node and the neutral, such as a filter."""
    loads: Any = subtable(LOAD, kind="tables", shown="none")
    """Loads of constant impedance or of constant power."""
    sources: Any = subtable(SOURCE, kind="tables", shown="none")
    """Sources beside the grid."""
    units: Any = subtable(UNIT, kind="tables", shown="none")
    """The converters; without any there is no plant."""
    inverters: Any = subtable(_inverter, kind="tables", shown="none")
    """Converters of other kinds beside them."""


NETWORK = (*fields_of(NetworkFields), *fields_of(ListFields))
"""The fields of [network]."""

LISTS = tuple(one.name for one in fields_of(ListFields))
