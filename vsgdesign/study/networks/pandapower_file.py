"""Networks of pandapower (JSON)."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.errors import Fault, StudyError
from vsgdesign.study.networks.model import (
    LINE,
    MACHINE,
    OTHER,
    S_BASE,
    SLACK,
    TRANSFORMER,
    Branch,
    Bus,
    Converter,
    Load,
    Network,
    Shunt,
    Source,
    apart,
)

_UNKNOWN = ("xward", "dcline", "svc", "ssc", "tcsc", "vsc")
"""Elements that are no constant admittance and no converter of a known rating."""
_OUT_OF_SERVICE = 4


def network_of_pandapower(net: Any, file: str) -> Network:
    """The network of a pandapowerNet. pandapower itself makes per unit of its elements and joins the buses of closed
    switches. Raises StudyError for elements that are not known here."""
    from pandapower.converter.pypower.to_ppc import to_ppc
    from pandapower.pd2ppc import _pd2ppc
    from pandapower.pypower import idx_brch, idx_bus

    faults = [
        Fault(kind, ", ".join(_name(net[kind], k, kind) for k in net[kind].index), "is not known here", "Take it out.")
        for kind in _UNKNOWN
        if kind in net and len(net[kind])
    ]
    if faults:
        raise StudyError(file, faults)
    net = copy.deepcopy(net)  # what follows writes into it
    for table in ("gen", "ext_grid"):
        net[table]["vm_pu"] = 1.0  # two set points at one bus are refused, and an impedance has none
    try:
        with np.errstate(all="ignore"):  # what is no number is told below, with its name
            to_ppc(net, calculate_voltage_angles=True, check_connectivity=False, init="flat")  # sets how it is done
            ppc, _ = _pd2ppc(net)  # as pandapower itself numbers it: to_ppc leaves out what is out of service
    except Exception as error:  # noqa: BLE001 - of any kind, for tables that do not belong together
        problem = f"pandapower makes no matrix of it ({type(error).__name__}: {error})"
        raise StudyError(file, [Fault("network", "", problem, "Correct it until pandapower.runpp takes it.")]) from None
    lookup = net._pd2ppc_lookups
    rows, base = ppc["bus"], float(ppc["baseMVA"]) * 1e6
    in_service = np.flatnonzero(rows[:, idx_bus.BUS_TYPE] != _OUT_OF_SERVICE)
    place = {int(row): k for k, row in enumerate(in_service)}
    names: dict[int, list[str]] = {int(row): [] for row in in_service}
    for index in net.bus.index:
        row = int(lookup["bus"][index])
        if row in names:
            names[row] += dict.fromkeys((_name(net.bus, index, "bus"), f"bus {index}"))
    buses = tuple(
        Bus(said[0] if said else f"open end {row}", float(rows[row, idx_bus.BASE_KV]) * 1e3, tuple(said[1:]))
        for row, said in names.items()
    )

    def at(bus: int) -> int | None:
        return place.get(int(lookup["bus"][bus]))

    branches: list[tuple[str, Branch]] = []
    for row, (key, kind, name, rating, leg) in _elements(net, lookup["branch"]).items():
        one = ppc["branch"][row]
        first, second = (place.get(int(one[k].real)) for k in (idx_brch.F_BUS, idx_brch.T_BUS))
        if one[idx_brch.BR_STATUS] != 1 or first is None or second is None:
            continue
        if any(one[k] != 0.0 for k in (idx_brch.BR_R_ASYM, idx_brch.BR_X_ASYM)):
            faults.append(Fault(f"{kind} {name}", "", "is not the same from both sides", "Make it so."))
            continue
        branches.append((key, _branch(one, idx_brch, base, (kind, name, rating, leg), (first, second))))
    if faults:
        raise StudyError(file, faults)
    shunts = tuple(
        Shunt(f"shunt at {buses[k].name}", k, complex(rows[row, idx_bus.GS], rows[row, idx_bus.BS]) * 1e6 / S_BASE)
        for row, k in place.items()
        if rows[row, idx_bus.GS] or rows[row, idx_bus.BS]
    )
    return Network(
        file=file,
        program="pandapower",
        buses=buses,
        branches=apart(branches),
        shunts=shunts,
        sources=apart(_sources(net, at)),
        converters=tuple(_converters(net, at)),
        loads=tuple(_loads(net, at)),
        f_n=float(net.f_hz),
    )


def read_pandapower(path: str | Path) -> Network:
    """The network of a JSON file of pandapower. Raises StudyError for a file that is none, and what
    :func:`network_of_pandapower` raises."""
    import pandapower

    try:
        net = pandapower.from_json(str(path))
    except Exception as error:  # noqa: BLE001 - of any kind, for a file that is damaged or of something else
        problem = f"pandapower cannot read it ({type(error).__name__}: {error})"
        raise StudyError(str(path), [Fault("network", "", problem, "Give a file of pandapower.to_json.")]) from None
    if not isinstance(net, pandapower.pandapowerNet):
        advice = "Give a file of pandapower.to_json."
        raise StudyError(str(path), [Fault("network", "", "is no network of pandapower", advice)])
    return network_of_pandapower(net, str(path))


def _branch(one: Any, idx: Any, base: float, said: tuple[str, str, float, bool], ends: tuple[int, int]) -> Branch:
    kind, name, rating, leg = said
    numbers = {key: float(np.real(one[getattr(idx, key)])) for key in ("BR_R", "BR_X", "BR_B", "BR_G", "TAP", "SHIFT")}
    more_g, more_b = (float(np.real(one[getattr(idx, key)])) for key in ("BR_G_ASYM", "BR_B_ASYM"))
    y = complex(numbers["BR_G"], numbers["BR_B"]) * base / S_BASE / 2.0
    angle = math.radians(numbers["SHIFT"])
    return Branch(
        name=name,
        kind=kind,
        ends=ends,
        r=numbers["BR_R"] * S_BASE / base,
        x=numbers["BR_X"] * S_BASE / base,
        y_1=y,
        y_2=y + complex(more_g, more_b) * base / S_BASE / 2.0,
        ratio=(numbers["TAP"] or 1.0) * complex(math.cos(angle), math.sin(angle)),
        rating=rating,
        leg=leg,
    )


def _elements(net: Any, ranges: dict[str, tuple[int, int]]) -> dict[int, tuple[str, str, str, float, bool]]:
    """Key, kind, name, rating and whether it is a leg of a star, of each row of the branches."""
    found: dict[int, tuple[str, str, str, float, bool]] = {}
    for element, (first, last) in ranges.items():
        if element == "trafo3w":
            count = (last - first) // 3
            for side in range(3):
                for k, index in enumerate(net.trafo3w.index):
                    name = _name(net.trafo3w, index, "trafo3w")
                    found[first + side * count + k] = f"trafo3w {index}", TRANSFORMER, name, math.nan, True
            continue
        kind = {"line": LINE, "trafo": TRANSFORMER}.get(element, OTHER)
        table = net.get(element)
        for k, row in enumerate(range(first, last)):
            if table is None or k >= len(table):  # an impedance of a switch, for example
                found[row] = f"{element} {k}", kind, f"{element} {k}", math.nan, False
                continue
            index = table.index[k]
            rating = float(table.sn_mva[index] * table.parallel[index]) * 1e6 if element == "trafo" else math.nan
            found[row] = f"{element} {index}", kind, _name(table, index, element), rating, False
    return found


def _sources(net: Any, at: Any) -> Iterator[tuple[str, Source]]:
    for index, one in net.ext_grid.iterrows():
        if one.in_service and (bus := at(one.bus)) is not None:
            pairs = [(_value(one, f"s_sc_{which}_mva"), _value(one, f"rx_{which}")) for which in ("max", "min")]
            known = [(S, rx) for S, rx in pairs if S > 0.0 and rx >= 0.0]
            z = [S_BASE / (S * 1e6) * complex(rx, 1.0) / math.hypot(rx, 1.0) for S, rx in known]
            name = _name(net.ext_grid, index, "ext_grid")
            yield f"ext_grid {index}", Source(name, bus, SLACK, (z[0], z[-1]) if z else None)
    for index, one in net.gen.iterrows():
        if one.in_service and (bus := at(one.bus)) is not None:
            rating = _value(one, "sn_mva") * 1e6
            name, x, z = _name(net.gen, index, "gen"), _value(one, "xdss_pu"), None
            if x > 0.0 and rating > 0.0:
                V = _value(one, "vn_kv")
                V_bus = float(net.bus.vn_kv[one.bus])
                V = V if V > 0.0 else V_bus
                r = _value(one, "rdss_ohm") / (V**2 / (rating / 1e6))
                own = complex(r if r > 0.0 else 0.0, x) * S_BASE / rating * (V / V_bus) ** 2
                z = own, own
            yield f"gen {index}", Source(name, bus, MACHINE, z, rating)


def _converters(net: Any, at: Any) -> Iterator[Converter]:
    for kind in ("sgen", "storage"):
        for index, one in net[kind].iterrows():
            if one.in_service and (bus := at(one.bus)) is not None:
                rating, power = _value(one, "sn_mva"), abs(_value(one, "p_mw"))
                S = rating if rating > 0.0 else power
                yield Converter(_name(net[kind], index, kind), bus, S * 1e6 if S > 0.0 else math.nan)


def _loads(net: Any, at: Any) -> Iterator[Load]:
    for index, one in net.load.iterrows():
        if one.in_service and (bus := at(one.bus)) is not None:
            s = complex(one.p_mw, one.q_mvar) * one.scaling * 1e6 / S_BASE
            yield Load(_name(net.load, index, "load"), bus, s)


def _value(row: Any, column: str) -> float:
    value = row.get(column)
    return math.nan if value is None or value != value else float(value)


def _name(table: Any, index: Any, kind: str) -> str:
    name = table.name[index] if "name" in table else None
    return f"{kind} {index}" if name is None or name != name or not str(name).strip() else str(name)
