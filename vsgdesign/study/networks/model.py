"""A network as its Y matrix needs it, in per unit of :data:`S_BASE` and of each bus's nominal voltage."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from vsgdesign.errors import Fault, StudyError, did_you_mean

S_BASE = 100e6
"""VA."""

LINE, TRANSFORMER, OTHER = "line", "transformer", "impedance"
"""Kinds of branches."""
SLACK, MACHINE, NEIGHBOUR = "slack", "machine", "neighbour"
"""Kinds of sources: the grid behind a slack bus, a synchronous machine, and a line to a network that is not in the
file."""


@dataclass(frozen=True)
class Bus:
    """A bus with its names and its nominal voltage, line to line in V (nan where the file has none)."""

    name: str
    V_n_ll_rms: float
    others: tuple[str, ...] = ()
    """Further names: of the same node in other views, and of busbars that closed switches join."""


@dataclass(frozen=True, kw_only=True)
class Branch:
    """A π element between two buses; elements of one ``name`` are switched together.

    ``ratio`` is that of an ideal transformer at the first end, V_1 = ratio · V behind it. ``y_1`` and ``y_2`` are the
    shunt admittances at the ends, g + jb; a positive b is a capacitance, a negative one an inductance.
    """

    name: str
    kind: str
    ends: tuple[int, int]
    r: float
    x: float
    y_1: complex = 0j
    y_2: complex = 0j
    ratio: complex = 1.0 + 0j
    rating: float = math.nan
    """VA of a transformer, nan where the file has none."""
    leg: bool = False
    """Whether it is one of three legs of a star, of which one may have a negative reactance."""


@dataclass(frozen=True)
class Shunt:
    """An admittance g + jb from a bus to earth."""

    name: str
    bus: int
    y: complex


@dataclass(frozen=True)
class Source:
    """A voltage source behind an impedance in per unit; ``z`` has the strongest and the weakest one that the file
    gives, and None where it gives none."""

    name: str
    bus: int
    kind: str
    z: tuple[complex, complex] | None = None
    rating: float = math.nan


@dataclass(frozen=True)
class Converter:
    """A converter that is a current source here: it is listed and does not strengthen the bus."""

    name: str
    bus: int
    S: float
    """VA, nan where the file has none."""


@dataclass(frozen=True)
class Load:
    """Constant powers in per unit."""

    name: str
    bus: int
    s: complex


Named = TypeVar("Named", Branch, Source)


@dataclass(frozen=True, kw_only=True)
class Network:
    """Everything that a file gives."""

    file: str
    program: str
    """What read it."""
    buses: tuple[Bus, ...]
    branches: tuple[Branch, ...]
    shunts: tuple[Shunt, ...] = ()
    sources: tuple[Source, ...] = ()
    converters: tuple[Converter, ...] = ()
    loads: tuple[Load, ...] = ()
    f_n: float | None = None
    """Hz; None where the format has none."""

    def bus(self, name: str) -> int:
        """The place of the bus of a name. Raises StudyError for an unknown name or one of several buses."""
        found = [k for k, bus in enumerate(self.buses) if name in (bus.name, *bus.others)]
        if len(found) == 1:
            return found[0]
        names = [bus.name for bus in self.buses]
        if found:
            others = "; ".join(", ".join(self.buses[k].others) for k in found)
            problem, advice = f"{len(found)} buses have this name", f"Their other names: {others}."
            raise StudyError(self.file, [Fault("bus", f'"{name}"', problem, advice)])
        some = ", ".join(names[:8]) + (", …" if len(names) > 8 else "")
        known = [other for bus in self.buses for other in (bus.name, *bus.others)]
        advice = did_you_mean(name, known, f"Some of its buses: {some}.")
        raise StudyError(self.file, [Fault("bus", f'"{name}"', "unknown", advice)])

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of all branches that can be switched off, in the order of the file."""
        return tuple(dict.fromkeys(branch.name for branch in self.branches))

    def without(self, names: Iterable[str]) -> Network:
        """The network with these elements out."""
        out = set(names)
        return replace(self, branches=tuple(branch for branch in self.branches if branch.name not in out))


def apart(found: Iterable[tuple[str, Named]]) -> tuple[Named, ...]:
    """Elements by the keys under which their file has them. Those that share a name without being one element get
    their keys behind it, so that an outage of a name is one outage."""
    pairs = list(found)
    keys: dict[str, set[str]] = {}
    for key, one in pairs:
        keys.setdefault(one.name, set()).add(key)
    return tuple(replace(one, name=f"{one.name} ({key})") if len(keys[one.name]) > 1 else one for key, one in pairs)


def parts(network: Network) -> list[set[int]]:
    """The buses that are connected with each other."""
    found = list(range(len(network.buses)))

    def root(k: int) -> int:
        while found[k] != k:
            found[k] = found[found[k]]
            k = found[k]
        return k

    for branch in network.branches:
        a, b = (root(end) for end in branch.ends)
        found[a] = b
    groups: dict[int, set[int]] = {}
    for k in range(len(found)):
        groups.setdefault(root(k), set()).add(k)
    return list(groups.values())


def part_of(network: Network, bus: int) -> tuple[Network, int] | None:
    """What is connected with a bus, and the bus in it. None where no path leads to a source."""
    part = next(one for one in parts(network) if bus in one)
    if not any(source.bus in part for source in network.sources):
        return None
    place = {old: new for new, old in enumerate(sorted(part))}
    inside: dict[str, Any] = {
        name: tuple(replace(one, bus=place[one.bus]) for one in getattr(network, name) if one.bus in place)
        for name in ("shunts", "sources", "converters", "loads")
    }
    branches = tuple(
        replace(branch, ends=(place[branch.ends[0]], place[branch.ends[1]]))
        for branch in network.branches
        if branch.ends[0] in place
    )
    buses = tuple(network.buses[k] for k in sorted(part))
    return replace(network, buses=buses, branches=branches, **inside), place[bus]


_LEAST_V, _LARGEST_V = 100.0, 1.5e6
_SURGE_OHM = (5.0, 3000.0)
"""√(X/B) of any line or cable lies between these."""
_VOLTAGE = (0.01, 0.5)
"""Short-circuit voltage of a transformer on its rating."""


def check_network(network: Network) -> None:
    """Raises StudyError with every fault of a network, each with the name of its element: an island, a reactance that
    is negative or zero, a resistance that is negative, and values that are in other units than the file's."""
    faults = [fault for bus in network.buses for fault in _of_bus(bus)]
    faults += [fault for branch in network.branches for fault in _of_branch(network, branch)]
    faults += _of_stars(network)
    sources = {source.bus for source in network.sources}
    for part in parts(network):
        if not part & sources:
            names = [network.buses[k].name for k in sorted(part)]
            shown = ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
            advice = "Connect it, or take its buses out of service."
            faults.append(Fault("island", shown, "no path leads from here to a source", advice))
    if faults:
        raise StudyError(network.file, faults)


def _of_bus(bus: Bus) -> list[Fault]:
    V = bus.V_n_ll_rms
    if math.isnan(V) or _LEAST_V <= V <= _LARGEST_V:
        return []
    advice = "The nominal voltage of a bus is given in kV in these files."
    return [Fault(f"bus {bus.name}", f"{V:g} V", f"is not between {_LEAST_V:g} V and {_LARGEST_V:g} V", advice)]


def _of_branch(network: Network, branch: Branch) -> list[Fault]:
    field, faults = f"{branch.kind} {branch.name}", []
    if not (math.isfinite(branch.r) and math.isfinite(branch.x)):
        advice = (
            "Of a transformer the short-circuit voltage is smaller than its resistive part, in per cent of its rating."
        )
        return [
            Fault(field, "", "its impedance is not a number", advice if branch.kind == TRANSFORMER else "Correct it.")
        ]
    if not branch.leg and branch.x <= 0.0:
        problem = "its reactance is negative" if branch.x < 0.0 else "has no reactance"
        advice = "A series capacitor is not known here." if branch.x < 0.0 else "Join its buses with a closed switch."
        faults.append(Fault(field, f"{branch.x:.4g} pu of 100 MVA", problem, advice))
    if branch.r < 0.0 and not branch.leg:
        faults.append(Fault(field, f"{branch.r:.4g} pu of 100 MVA", "its resistance is negative", "Correct it."))
    V, b = network.buses[branch.ends[0]].V_n_ll_rms, (branch.y_1 + branch.y_2).imag
    if branch.kind == LINE and branch.x > 0.0 and b > 0.0 and not math.isnan(V):
        surge = math.sqrt(branch.x / b) * V**2 / S_BASE
        if not _SURGE_OHM[0] <= surge <= _SURGE_OHM[1]:
            problem = f"√(X/B) is not between {_SURGE_OHM[0]:g} Ω and {_SURGE_OHM[1]:g} Ω, as that of any line"
            advice = "Its reactance, its capacitance or the voltage of its buses is in another unit than the file's."
            faults.append(Fault(field, f"{surge:.3g} Ω", problem, advice))
    if branch.kind == TRANSFORMER and not branch.leg and branch.rating > 0.0 and branch.x > 0.0:
        voltage = math.hypot(branch.r, branch.x) * branch.rating / S_BASE
        if not _VOLTAGE[0] <= voltage <= _VOLTAGE[1]:
            problem = f"its short-circuit voltage is not between {_VOLTAGE[0]:.0%} and {_VOLTAGE[1]:.0%}"
            advice = "It is given in per cent of the transformer's rating, or its reactance in Ω at the stated voltage."
            faults.append(Fault(field, f"{100.0 * voltage:.3g} %", problem, advice))
    return faults


def _of_stars(network: Network) -> list[Fault]:
    """Of the three legs of a star each two in series are what was measured, and have to be positive."""
    stars: dict[str, list[Branch]] = {}
    for branch in network.branches:
        if branch.leg:
            stars.setdefault(branch.name, []).append(branch)
    return [
        Fault(f"transformer {name}", "", "the reactance between two of its windings is negative", "Correct it.")
        for name, legs in stars.items()
        if any(a.x + b.x <= 0.0 for k, a in enumerate(legs) for b in legs[:k])
    ]


@dataclass(frozen=True, kw_only=True)
class Given:
    """What a person tells of sources that a file does not describe."""

    source: tuple[float, float] | None = None
    """Short-circuit power in VA and X/R of each slack bus."""
    machine: tuple[float, float] | None = None
    """Sub-transient reactance of each synchronous machine in per unit of its rating, and X/R."""
    named: tuple[tuple[str, tuple[float, float] | None], ...] = ()
    """Short-circuit power and X/R of sources by name; None: it is not there."""


def with_sources(network: Network, given: Given) -> Network:
    """The network with every source's impedance. Raises StudyError that names each one of which nothing is known."""
    named, known = dict(given.named), {source.name for source in network.sources}
    faults = [
        Fault("source", f'"{name}"', "unknown", did_you_mean(name, known, f"There are: {', '.join(sorted(known))}."))
        for name in named
        if name not in known
    ]
    kept: list[Source] = []
    for source in network.sources:
        if source.name in named:
            told = named[source.name]
            if told is not None:
                kept.append(replace(source, z=(_behind(*told),) * 2))
        elif source.kind == SLACK and given.source is not None:
            kept.append(replace(source, z=(_behind(*given.source),) * 2))
        elif source.z is not None:
            kept.append(source)
        elif source.kind == MACHINE and given.machine is not None and source.rating > 0.0:
            x, x_over_r = given.machine
            kept.append(replace(source, z=(_behind(source.rating / math.hypot(x, x / x_over_r), x_over_r),) * 2))
        else:
            told = f"{source.kind} {source.name}", f'"{network.buses[source.bus].name}"'
            faults.append(Fault(*told, *_unknown(source, faults)))
    if faults:
        raise StudyError(network.file, faults)
    return replace(network, sources=tuple(kept))


def _behind(S_sc: float, x_over_r: float) -> complex:
    return S_BASE / S_sc * complex(1.0, x_over_r) / math.hypot(1.0, x_over_r)


def _unknown(source: Source, before: Sequence[Fault]) -> tuple[str, str]:
    """What is missing of a source and, where nothing like it was missing before, how it is given."""
    if source.kind == SLACK:
        problem = "the file does not give the short-circuit power of the grid behind this bus"
        advice = "Give --source-s and --source-x-over-r."
    elif source.kind == MACHINE and not source.rating > 0.0:
        problem, advice = "the file gives neither the sub-transient reactance of this machine nor its rating", ""
    elif source.kind == MACHINE:
        problem = "the file does not give the sub-transient reactance of this machine"
        advice = "Give --machine-x and --machine-x-over-r."
    else:
        problem, advice = "the file does not give the network behind this line", ""
    if any(fault.problem == problem for fault in before):
        return problem, ""
    own = f'--source "{source.name} = 2 GVA, 10" gives its own short-circuit power and X/R, and "= none" leaves it out;'
    return problem, f"{advice} {own} --source FILE.csv gives many.".strip()
