"""A plant of several converters ("units") on one network, as data in SI.

Everything between the units is a list of elements: R, L and C in series between two nodes, or between a node and the
neutral. A cable is three of them, and a load up to four. :class:`PowerPlant` has them with the sources and the units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from vsgdesign.equations.grid_following import SetPoints
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.identification.field import PAIRS
from vsgdesign.study.parameters.converter import Filter
from vsgdesign.study.parameters.grid import Load
from vsgdesign.study.parameters.inverter_kinds import InverterKind

if TYPE_CHECKING:
    from vsgdesign.study.parameters.controllers import ControllerSpec
    from vsgdesign.study.parameters.dc_link import DcLink
    from vsgdesign.study.parameters.study import Study

NEUTRAL = ""
"""The node to which shunts, loads and sources lead."""

GRID = "grid"
"""Name of the source that the study's [grid] describes."""


@dataclass(frozen=True)
class Element:
    """R, L and C in series; zero or None for what is not there."""

    name: str
    group: str
    """The branch, shunt or load to which it belongs: its breaker opens all of the group."""
    start: str
    end: str
    R: float = 0.0
    L: float = 0.0
    C: float | None = None


@dataclass(frozen=True)
class Source:
    """A source behind R and L at a node. Its frequency is that of the grid."""

    name: str
    node: str
    V_rms: float
    phase: float
    """By how much it leads the grid's source, rad."""
    R: float = 0.0
    L: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Unit:
    """A converter at a node."""

    name: str
    node: str
    R: float = 0.0
    L: float = 0.0
    """Of its own transformer and feeder, from its terminals to the node."""
    P_ref: float
    Q_ref: float
    """At t = 0."""
    offset: float = 0.0
    """When it samples for the first time, s; less than its sampling period."""
    pair: int = 1
    """On which pair of lines its field estimator sends its probe; 0: all pairs are taken by units before it."""
    case: Study | None = None
    """Its converter, filter, inner loops and power loops; None: those of the study."""
    dc: DcLink | None = None
    """Its dc link and what feeds it; None: the link is ideal."""


@dataclass(frozen=True, kw_only=True)
class Inverter:
    """A converter of another kind at a node: a grid-following inverter, or an active rectifier."""

    name: str
    node: str
    kind: InverterKind
    settings: Any
    """The constants of its kind."""
    filter: Filter
    S_rated: float
    V_rated_rms: float
    T_s: float
    delay_samples: int
    R: float = 0.0
    L: float = 0.0
    """Of its own transformer and feeder, from its terminals to the node."""
    asked: SetPoints
    """At t = 0."""
    offset: float = 0.0
    """When it samples for the first time, s; less than its sampling period."""


@dataclass(frozen=True, kw_only=True)
class PowerPlant:
    """Everything that is connected to the grid's impedance."""

    nodes: tuple[str, ...]
    elements: tuple[Element, ...]
    sources: tuple[Source, ...]
    """Beside the grid."""
    units: tuple[Unit, ...]
    pcc: str
    """The node to which the grid's impedance leads, and at which the load and the fault of [network] are."""
    opened: frozenset[str] = frozenset()
    """Names of what is not connected at the start."""
    least: int | None = None
    """The least number of units on line for which gains are designed; None: all of them."""
    inverters: tuple[Inverter, ...] = ()
    """Converters of other kinds."""
    common_estimate: bool = False
    """Whether the units, which are equal, share one field estimator at their node."""

    @property
    def converters(self) -> tuple[Unit | Inverter, ...]:
        """Everything with a bridge: the units, then the inverters."""
        return (*self.units, *self.inverters)

    @property
    def names(self) -> dict[str, str]:
        """Everything that an event may name, and what it is."""
        found = {one.group: "element" for one in self.elements} | {one.name: "source" for one in self.sources}
        found |= {one.name: "unit" for one in self.units} | {one.name: "inverter" for one in self.inverters}
        return {GRID: "source"} | found | dict.fromkeys(self.nodes, "node")

    def unit(self, name: str) -> Unit:
        """The unit of a name."""
        return next(one for one in self.units if one.name == name)

    @property
    def most_grid(self) -> float:
        """How many times as strong a grid a unit sees with the least number of units on line as with all of them."""
        return len(self.units) / self.least if self.least else 1.0

    @property
    def equal(self) -> bool:
        """Whether all converters are units that are alike, at one node, with equal set points, and sample together."""
        if not self.units or self.inverters:
            return False
        first = self.units[0]
        alike = {(one.node, one.R, one.L, one.P_ref, one.Q_ref, one.offset) for one in self.units}
        return len(alike) == 1 and all((one.case, one.dc) == (first.case, first.dc) for one in self.units)


def load_elements(name: str, node: str, load: Load) -> list[Element]:
    """The branches of a load side by side."""
    found = []
    for part, R, L, C in (
        ("R", load.R_parallel, 0.0, None),
        ("L", 0.0, load.L_parallel, None),
        ("C", 0.0, 0.0, load.C_parallel),
    ):
        if R or L or C:
            found.append(Element(f"{name}.{part}", name, node, NEUTRAL, R or 0.0, L or 0.0, C))
    if (load.R_series, load.L_series, load.C_series) != (None, None, None):
        series = load.R_series or 0.0, load.L_series or 0.0, load.C_series
        found.append(Element(f"{name}.series", name, node, NEUTRAL, *series))
    return found


def cable_elements(name: str, start: str, end: str, R: float, L: float, C: float) -> list[Element]:
    """The π of a cable: half of its capacitance at each end."""
    halves = [Element(f"{name}.{at}", name, at, NEUTRAL, C=0.5 * C) for at in (start, end)]
    return [Element(name, name, start, end, R, L), *halves]


def unconnected(nodes: tuple[str, ...], elements: tuple[Element, ...], fed: set[str]) -> list[str]:
    """Nodes from which no branch leads to a unit or a source. ``fed``: the nodes at which there is one."""
    reached, waiting = set(fed), list(fed)
    while waiting:
        node = waiting.pop()
        for one in elements:
            for here, there in ((one.start, one.end), (one.end, one.start)):
                if here == node and there != NEUTRAL and there not in reached:
                    reached.add(there)
                    waiting.append(there)
    return [node for node in nodes if node not in reached]


def behind_its_path(study: Study, unit: Unit) -> Study:
    """The converter of a unit with its dc link, whose transformer and feeder belong to L_2 and R_2 of its filter: the
    grid begins at the unit's node. The table of a unit is made for this filter."""
    base = unit.case or study
    base = base if base.dc == unit.dc else replace(base, dc=unit.dc)
    return base if unit.R == 0.0 and unit.L == 0.0 else replace(base, filter=with_path(base.filter, unit))


def with_fixed_gains(study: Study) -> Study:
    """A converter of a plant on the grid that it sees at first: fixed gains whose controller names no grid are designed
    for this one."""

    def own(spec: ControllerSpec) -> ControllerSpec:
        placed = spec.kind == "scheduled" or spec.gains is not None or spec.design_grid is not None
        return spec if placed else replace(spec, design_grid=study.grid)

    return replace(study, controllers=tuple(map(own, study.controllers)))


def with_path(filter_: Filter, unit: Unit) -> Filter:
    """A filter with the transformer and feeder of a unit in L_2 and R_2."""
    return replace(filter_, L_2=filter_.L_2 + unit.L, R_2=filter_.R_2 + unit.R)


def one_converter(study: Study, what: str) -> None:
    """Raises InfeasibleStudyError for ``what``, which knows one converter on a grid, where there is a plant."""
    if study.plant is not None:
        raise InfeasibleStudyError(
            f"{what} knows one converter on a grid, and this study has a plant of {len(study.plant.units)}: take "
            "[plant] and the lists of [network] out of the study. vsgdesign run and simulate take it as it is, and "
            "table build, margins, certify, compare, verify, survive, comply, inner and explore take equal units."
        )


def pairs_of_units(chosen: Sequence[int | None]) -> list[int]:
    """The pair of each unit of a plant: the chosen ones, then those that are left in turn; 0 where none is left."""
    left = [pair for pair in range(1, len(PAIRS) + 1) if pair not in chosen]
    return [one if one is not None else left.pop(0) if left else 0 for one in chosen]
