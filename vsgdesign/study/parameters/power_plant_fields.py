"""The section [plant] and the lists of [network]: their fields."""

from __future__ import annotations

import math
from typing import Any

from vsgdesign.identification.field import PAIRS
from vsgdesign.study.parameters.fields import (
    C_BASE,
    L_BASE,
    MOST_REFERENCE,
    S_RATED,
    V_RATED,
    Z_BASE,
    fields_of,
    number,
    subtable,
    text,
    whole,
    whole_range,
    word,
)
from vsgdesign.study.parameters.inverter_fields import (
    LoadKind,
    inverter_fields,
    rectifier_fields,
)
from vsgdesign.study.parameters.network_fields import (
    CLOSED,
    OPEN,
    LoadFields,
    NetworkFields,
    SeriesFields,
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
