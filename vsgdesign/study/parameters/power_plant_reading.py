"""The plant that the section [plant] or the lists of [network] describe, and what does not go with it in a study."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from vsgdesign.errors import did_you_mean
from vsgdesign.identification.field import PAIRS
from vsgdesign.study.parameters.converter import Converter
from vsgdesign.study.parameters.dc_link import DcLink, read_dc
from vsgdesign.study.parameters.fields import (
    MOST_REFERENCE,
    S_RATED,
    Scope,
    fields_of,
    picked,
    values,
)
from vsgdesign.study.parameters.grid import THREE_PHASE, Fault, Load, Network
from vsgdesign.study.parameters.network_fields import (
    OPEN,
    Base,
    either,
    read_load,
    read_series,
)
from vsgdesign.study.parameters.power_plant import (
    GRID,
    NEUTRAL,
    Element,
    Inverter,
    PowerPlant,
    Source,
    Unit,
    cable_elements,
    load_elements,
    pairs_of_units,
    unconnected,
)
from vsgdesign.study.parameters.power_plant_fields import (
    COMMON,
    CONSTANT_POWER,
    LISTS,
    MOST_UNITS,
    OWN,
    SPREAD,
    TOGETHER,
    AtNode,
    Breaker,
    Ends,
    ListFields,
    LoadKind,
    Named,
    OfBranch,
    OfSource,
    OfUnit,
    PlantFields,
    Series,
    read_inverter,
    read_rectifier,
    rectifier_fields,
)
from vsgdesign.study.parameters.reader import TableReader

if TYPE_CHECKING:
    from vsgdesign.study.parameters.estimator import ProbeSpec
    from vsgdesign.study.parameters.event import Event
    from vsgdesign.study.parameters.study import Study

CaseOfUnit = Callable[[Mapping[str, Any], TableReader], "Study | None"]
"""Makes the study of a unit's case of its merged document; None with faults in the table."""


class Around(NamedTuple):
    """What the reader of a plant is given."""

    converter: Converter
    scope: Scope
    P_ref: float
    Q_ref: float
    case: CaseOfUnit
    dc: DcLink | None
    """The dc link of the study."""


def units_asked(root: TableReader) -> int:
    """How many units the document has, before anything else is read; 1 where it is faulty."""
    plant, network = root.table.get("plant"), root.table.get("network")
    count = plant.get("units") if isinstance(plant, dict) else None
    count = count[-1] if isinstance(count, list) and count else count
    listed = network.get("units") if isinstance(network, dict) else None
    if isinstance(count, int) and not isinstance(count, bool) and 1 <= count <= MOST_UNITS:
        return count
    return len(listed) if isinstance(listed, list) and 1 <= len(listed) <= MOST_UNITS else 1


def read_plant(root: TableReader, network: TableReader | None, around: Around) -> PowerPlant | None:
    """The plant of a study; None where it has one converter on a grid."""
    short = root.child("plant")
    listed = [] if network is None else [name for name in LISTS if network.has(name)]
    if short is not None:
        if network is not None and listed:
            given = ", ".join(f"network.{name}" for name in listed)
            short.fault("", None, f"{given} describe a plant, too", "Give one of them.")
            network.skip(*listed)
        return _short(short, around)
    if network is None or not listed:
        return None
    return _Reader(network, around).plant()


def _short(table: TableReader, around: Around) -> PowerPlant:
    """N equal units at one node."""
    found, c = values(PlantFields, table), around.converter
    table.finish()
    least, count = found["units"]
    each = found["resistance"] * c.Z_base, found["reactance"] * c.Z_base / c.omega_n
    spread = c.T_s / count if found["sampling"] == SPREAD else 0.0
    common = found["estimators"] == COMMON
    if common and spread > 0.0:
        problem = "one estimator for all units needs units that sample together"
        table.fault("estimators", COMMON, problem, f'Give sampling = "{TOGETHER}", or estimators = "{OWN}".')
    pairs = [1] * count if common else pairs_of_units([None] * count)
    units = tuple(
        Unit(
            name=f"unit{k + 1}",
            node="pcc",
            R=each[0],
            L=each[1],
            P_ref=around.P_ref,
            Q_ref=around.Q_ref,
            offset=k * spread,
            pair=pairs[k],
            dc=around.dc,
        )
        for k in range(count)
    )
    return PowerPlant(
        nodes=("pcc",), elements=(), sources=(), units=units, pcc="pcc", least=least, common_estimate=common
    )


class _Reader:
    """Reads the lists of [network]."""

    def __init__(self, table: TableReader, around: Around) -> None:
        self._table, self._around, self._base = table, around, Base.of(around.converter)
        self._names: list[str] = [GRID]
        self._opened: set[str] = set()
        self._elements: list[Element] = []
        self._rectifiers: list[Inverter] = []
        self._nodes: tuple[str, ...] = ()
        self._pairs: list[int | None] = []

    def plant(self) -> PowerPlant:
        """The plant; meaningless where there are faults."""
        table = self._table
        nodes = []
        for one in table.children("nodes"):
            nodes.append((one, self._name(one)))
            one.finish()
        self._nodes = tuple(name for _, name in nodes)
        pcc = values(picked(ListFields, "pcc"), table)["pcc"]
        if pcc not in self._nodes:
            table.fault("pcc", pcc, "is no node", f'Add [[network.nodes]] with name = "{pcc}", or name one as pcc.')
        for one in table.children("branches"):
            self._branch(one)
        for one in table.children("shunts"):
            self._shunt(one)
        for one in table.children("loads"):
            self._load(one)
        sources = tuple(self._source(one) for one in table.children("sources"))
        units = self._with_pairs(tuple(self._unit(one) for one in table.children("units")))
        inverters = (*map(self._inverter, table.children("inverters")), *self._rectifiers)
        if not 1 <= len(units) <= MOST_UNITS:
            advice = "Add [[network.units]] with name and node, or take the other lists out."
            table.fault("units", len(units), f"a plant has 1 to {MOST_UNITS} units", advice)
        fed = {pcc, *(one.node for one in (*sources, *units, *inverters))}
        lost = unconnected(self._nodes, tuple(self._elements), fed)
        for one, name in nodes:
            if name in lost:
                problem = "no branch leads from it to a unit or a source"
                one.fault("name", name, problem, "Add a branch, or take the node out.")
        self._check_sources(sources)
        return PowerPlant(
            nodes=self._nodes,
            elements=tuple(self._elements),
            sources=sources,
            units=units,
            pcc=pcc,
            opened=frozenset(self._opened),
            inverters=inverters,
        )

    def _name(self, table: TableReader) -> str:
        name = values(picked(Named, "name"), table)["name"]
        if name in self._names:
            table.fault("name", name, "used twice", "Give everything in the plant its own name.")
        self._names.append(name)
        return name

    def _named(self, table: TableReader) -> str:
        name = self._name(table)
        if name:  # what is wrong with its fields is told with its name
            table.path = f'{table.path.partition("[")[0]}["{name}"]'
        if values(Breaker, table)["breaker"] == OPEN:
            self._opened.add(name)
        return name

    def _at(self, table: TableReader, field: str, node: str) -> str:
        if node and node not in self._nodes:
            known = f"Known: {', '.join(self._nodes)}." if self._nodes else "Add [[network.nodes]]."
            table.fault(field, node, "is no node", did_you_mean(node, self._nodes, known, 0.5))
        return node

    def _node(self, table: TableReader) -> str:
        return self._at(table, "node", values(AtNode, table)["node"])

    def _series(self, table: TableReader, base: Base | None = None) -> tuple[float, float]:
        base = base or self._base
        R = either(table, Series, "R", "R_pu", base)
        L = either(table, Series, "L", "X_pu", base)
        return R or 0.0, L or 0.0

    def _branch(self, table: TableReader) -> None:
        name, ends = self._named(table), values(Ends, table)
        start, end = self._at(table, "from", ends["start"]), self._at(table, "to", ends["end"])
        if start and start == end:
            table.fault("to", end, "is the node at which it begins", "Name another node.")
        rating = values(picked(OfBranch, "S_rated"), table, self._base.scope)["S_rated"]
        of = self._base if rating is None else self._base._replace(Z=self._base.Z * self._base.S / rating, S=rating)
        R, L = self._series(table, of)
        C = either(table, OfBranch, "C", "B_pu", self._base)
        if R == 0.0 and L == 0.0:
            table.fault("", None, f"branch {name} has no impedance", "Give R, L or both, or join its two nodes.")
        if C:
            self._elements += cable_elements(name, start, end, R, L, C)
        else:
            self._elements.append(Element(name, name, start, end, R, L))
        table.finish()

    def _shunt(self, table: TableReader) -> None:
        name, node = self._named(table), self._node(table)
        R, L, C = read_series(table, self._base)
        if (R, L, C) == (None, None, None) and not any(map(table.has, ("R", "R_pu", "L", "X_L_pu", "C", "X_C_pu"))):
            table.fault("", None, f"shunt {name} has no element", "Give R, L or C.")
        self._elements.append(Element(name, name, node, NEUTRAL, R or 0.0, L or 0.0, C))
        table.finish()

    def _load(self, table: TableReader) -> None:
        name, node = self._named(table), self._node(table)
        own = rectifier_fields()
        samples = values(LoadKind, table)["kind"] == CONSTANT_POWER
        rectifier = values(own, table, self._around.scope) if samples else {}
        for one in (one.name for one in own if not samples and table.has(one.name)):
            table.fault(one, table.table[one], "is of a load that samples", f'Give kind = "{CONSTANT_POWER}".')
            table.skip(one)
        wrong = [one for one in ("R", "R_pu", "L", "X_L_pu", "C", "X_C_pu", "series") if samples and table.has(one)]
        for one in wrong:
            table.fault(one, None, "a load of constant power has no impedance", "Give P and Q, or P_pu and Q_pu.")
        load = read_load(table, self._base)
        if load == Load() and not any(one.field.startswith(table.path) for one in table.faults):
            table.fault("", None, f"load {name} takes no power", "Give P_pu, R_pu, X_L_pu, X_C_pu or series.")
        if samples:
            self._rectifiers.append(read_rectifier(table, name, node, self._around.converter, load, rectifier))
        else:
            self._elements += load_elements(name, node, load)

    def _inverter(self, table: TableReader) -> Inverter:
        name, node = self._named(table), self._node(table)
        return read_inverter(table, name, node, self._around.converter, self._around.scope)

    def _source(self, table: TableReader) -> Source:
        name, node = self._named(table), self._node(table)
        own = values(OfSource, table, self._around.scope)
        found = Source(name, node, own["V_rms"], own["phase"], *self._series(table))
        table.finish()
        return found

    def _unit(self, table: TableReader) -> Unit:
        name, node = self._named(table), self._node(table)
        document, case = table.table.get("case"), None
        if isinstance(document, Mapping):  # a name has become its document
            table.skip("case")
            case = self._around.case(document, table)
        else:
            values(picked(OfUnit, "case"), table)
        c = self._around.converter if case is None else case.converter
        scope = dict(self._around.scope) | {S_RATED.of: c.S_rated}
        dc = read_dc(link, c) if (link := table.child("dc")) is not None else (case or self._around).dc
        own = tuple(one for one in fields_of(OfUnit) if one.name not in ("case", "dc"))
        found = values(own, table, scope | _reference_limit(self._around.scope, c, self._around.converter))
        if case is not None and case.converter.omega_n != self._around.converter.omega_n:
            ours, theirs = (one.omega_n / (2.0 * math.pi) for one in (self._around.converter, c))
            problem = f"unit {name} is made for {theirs:g} Hz, and the network has {ours:g} Hz"
            table.fault("case", None, problem, "Take a case of this frequency.")
        if case is not None and abs(c.V_rated_rms / self._around.converter.V_rated_rms - 1.0) > 1e-9:
            problem = f"unit {name} is made for {c.V_rated_rms:g} V, and the study for another voltage"
            table.fault("case", None, problem, "Refer its data to the voltage of the study.")
        table.finish()
        self._pairs.append(found["pair"])
        return Unit(
            name=name,
            node=node,
            R=found["resistance"] * c.Z_base,
            L=found["reactance"] * c.Z_base / c.omega_n,
            P_ref=self._around.P_ref if found["P_ref"] is None else found["P_ref"],
            Q_ref=self._around.Q_ref if found["Q_ref"] is None else found["Q_ref"],
            offset=found["offset"] * c.T_s,
            case=case,
            dc=dc,
        )

    def _with_pairs(self, units: tuple[Unit, ...]) -> tuple[Unit, ...]:
        """Two units with one pair would hear each other in place of themselves."""
        for pair, count in Counter(one for one in self._pairs if one is not None).items():
            if count > 1:
                names = [unit.name for unit, own in zip(units, self._pairs, strict=True) if own == pair]
                problem = f"{' and '.join(names)} send their probes on the same pair of lines"
                self._table.fault("units", None, f"{problem}, {pair}", "Give each another pair, or leave pair out.")
        pairs = pairs_of_units(self._pairs)
        return tuple(replace(unit, pair=pair) for unit, pair in zip(units, pairs, strict=True))

    def _check_sources(self, sources: tuple[Source, ...]) -> None:
        """Nothing says how ideal sources at one node share the current, and a capacitor cannot follow one."""
        ideal = [one for one in sources if one.R == 0.0 and one.L == 0.0]
        for node, count in Counter(one.node for one in ideal).items():
            names = ", ".join(one.name for one in ideal if one.node == node)
            if count > 1:
                problem = f"{names} make a loop of sources at node {node}"
                self._table.fault("sources", None, problem, "Give all but one of them R or L.")
            across = [
                one.group
                for one in self._elements
                if one.C is not None and one.R == 0.0 and one.L == 0.0 and node in (one.start, one.end)
            ]
            if across:
                problem = f"{', '.join(dict.fromkeys(across))} would be a capacitor across the ideal source {names}"
                self._table.fault("sources", None, problem, "Give the source R or L.")


def _reference_limit(scope: Scope, own: Converter, of_study: Converter) -> dict[str, float]:
    """The largest reference of a unit with another rating."""
    return {MOST_REFERENCE.of: scope[MOST_REFERENCE.of] * own.S_rated / of_study.S_rated}


def on_all_units(converter: Converter, count: int) -> Converter:
    """The converter on whose rating the grid's short-circuit ratio is taken: all units together."""
    return converter if count == 1 else replace(converter, S_rated=count * converter.S_rated)


def check_estimators(root: TableReader, plant: PowerPlant, probe: ProbeSpec | None) -> None:
    """Of a plant whose units have field estimators: each needs lines of its own for its probe."""
    without = [one.name for one in plant.units if one.pair == 0]
    if without:
        problem = (
            f"there are {len(PAIRS)} pairs of lines for the probes of {len(plant.units)} units: {', '.join(without)} "
            "would have none"
        )
        advice = 'Give four units at most, plant.estimators = "common", or estimate = "truth".'
        root.fault("plant.units", len(plant.units), problem, advice)
    if probe is not None and probe.pair != 1 and not plant.common_estimate:
        advice = "Leave it out, or give pair in [[network.units]]."
        root.fault("estimator.probe.pair", probe.pair, "each unit of a plant has a pair of its own", advice)


def check_plant(
    root: TableReader,
    plant: PowerPlant,
    network: Network,
    events: Sequence[Event],
) -> None:
    """What a run of a plant does not have."""
    faults = [network.fault, *(event.network.fault for event in events if event.network is not None)]
    faults += [one.switched.fault for one in events if isinstance(one.switched.fault, Fault)]
    for fault in (one for one in faults if one is not None):
        if fault.at > 0.0 or fault.kind != THREE_PHASE:
            problem = "a fault of a plant is three-phase and at a node"
            root.fault("network.fault", fault.kind, problem, "Leave at and phases out.")
    for k, event in enumerate(events):
        waits = event.synchro_check is not None and event.element is None
        if waits or event.synchronised_until is not None:
            problem = "the breaker of a plant's grid does not wait"
            root.fault(f"events[{k}]", None, problem, "Give synchro_check for the breaker of a unit alone.")
        if event.over > 0.0 and event.omega_g is not None and plant.sources:
            problem = f"the frequency is that of the sources {', '.join(one.name for one in plant.sources)}, too"
            advice = "Leave over out, or take these sources out of the network."
            root.fault(f"events[{k}].over", event.over, problem, advice)
