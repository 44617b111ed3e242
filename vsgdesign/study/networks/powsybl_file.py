"""Networks of everything that pypowsybl reads: CGMES, PSS/E, PowerFactory, MATPOWER, UCTE, IEEE-CDF, XIIDM."""

from __future__ import annotations

import cmath
import importlib
import logging
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from vsgdesign.errors import Fault, StudyError
from vsgdesign.study.networks.model import (
    LINE,
    MACHINE,
    NEIGHBOUR,
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

_AS_CONVERTERS = ("WIND", "SOLAR")
"""Sources of energy whose generators are no synchronous machines."""
_PARAMETERS = {"matpower.import.ignore-base-voltage": "false"}
"""Without it every bus of a MATPOWER file has 1 kV."""


def read_powsybl(path: str | Path) -> Network:
    """The network of a file. Raises StudyError for a file that pypowsybl does not read, and for elements that are not
    known here."""
    pypowsybl = _library()
    try:
        found = pypowsybl.network.load(str(path), parameters=_PARAMETERS)
    except Exception as error:  # noqa: BLE001 - of any kind, for a file that is damaged or of something else
        problem = f"pypowsybl cannot read it ({str(error).splitlines()[0] if str(error) else type(error).__name__})"
        formats = ", ".join(pypowsybl.network.get_import_formats())
        advice = f"Give a file of pandapower (.json) or one of {formats}."
        raise StudyError(str(path), [Fault("network", "", problem, advice)]) from None
    return network_of_powsybl(found, str(path))


def _library() -> Any:
    """pypowsybl, which warns at its import of an extra of its own that is not needed here."""
    logger = logging.getLogger("powsybl")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        return importlib.import_module("pypowsybl")
    finally:
        logger.setLevel(level)


def network_of_powsybl(found: Any, file: str) -> Network:
    """The network of a pypowsybl.network.Network. Impedances are taken in Ω and put in per unit here."""
    levels = found.get_voltage_levels()["nominal_v"].to_dict()
    views = found.get_buses(all_attributes=True)
    names: dict[str, list[str]] = {str(bus): [] for bus in views.index}
    nodes: dict[str, list[str]] = {str(bus): [] for bus in views.index}
    for node, one in found.get_bus_breaker_view_buses(all_attributes=True).iterrows():
        if one.bus_id in nodes:
            nodes[one.bus_id].append(str(node))
            names[one.bus_id] += [one["name"]] if one.get("name") else []
    place = {bus: k for k, bus in enumerate(nodes)}
    V = {bus: float(levels[one.voltage_level_id]) * 1e3 for bus, one in views.iterrows()}
    buses = tuple(_bus(bus, V[bus], names[bus], said, str(views["name"][bus] or "")) for bus, said in nodes.items())
    faults = [
        Fault(what, ", ".join(map(str, table.index)), "is not known here", "Take it out.")
        for what, table in (("HVDC line of thyristors", found.get_lcc_converter_stations()),)
        if len(table)
    ]
    if faults:
        raise StudyError(file, faults)
    three = list(_of_three_windings(found, place, V, len(buses)))
    stars = tuple(Bus(f"star of {key}", V_0) for key, V_0, _ in three)
    return Network(
        file=file,
        program="pypowsybl",
        buses=(*buses, *stars),
        branches=apart(
            (
                *_lines(found, place, V),
                *_transformers(found, place, V),
                *((key, leg) for key, _, legs in three for leg in legs),
            )
        ),
        shunts=tuple(_shunts(found, place, V)),
        sources=apart(_sources(found, place, V)),
        converters=tuple(_converters(found, place)),
        loads=tuple(
            Load(_name(one, index), place[one.bus_id], complex(one.p0, one.q0) * 1e6 / S_BASE)
            for index, one in found.get_loads().iterrows()
            if one.connected and one.bus_id in place
        ),
    )


def _bus(view: str, V: float, names: list[str], nodes: list[str], title: str) -> Bus:
    """A bus by the name of its busbar, else by that of its only node, else as the file's own view calls it."""
    known = [name for name in (*names, *(nodes if len(nodes) == 1 else ()), view, *nodes, title) if name]
    return Bus(known[0], V, tuple(dict.fromkeys(known[1:])))


def _name(one: Any, index: Any) -> str:
    name = one.get("name")
    return str(index) if not name or name != name else str(name)


def _ends(one: Any, place: dict[str, int]) -> tuple[int, int] | None:
    """Both buses of a branch; None where an end of it is open."""
    if not (one.connected1 and one.connected2 and one.bus1_id in place and one.bus2_id in place):
        return None
    return place[one.bus1_id], place[one.bus2_id]


def _lines(found: Any, place: dict[str, int], V: dict[str, float]) -> Iterator[tuple[str, Branch]]:
    for index, one in found.get_lines().iterrows():
        ends = _ends(one, place)
        if ends is None:
            continue
        V_1, V_2 = V[one.bus1_id], V[one.bus2_id]
        Z_n = V_1 * V_2 / S_BASE
        y = 1.0 / complex(one.r, one.x) if one.r or one.x else 0j
        # Between two nominal voltages a line is a π element in Ω, whose shunts in per unit take up the difference.
        y_1 = (complex(one.g1, one.b1) + y * (1.0 - V_2 / V_1)) * V_1**2 / S_BASE
        y_2 = (complex(one.g2, one.b2) + y * (1.0 - V_1 / V_2)) * V_2**2 / S_BASE
        line = Branch(name=_name(one, index), kind=LINE, ends=ends, r=one.r / Z_n, x=one.x / Z_n, y_1=y_1, y_2=y_2)
        yield str(index), line


def _transformers(found: Any, place: dict[str, int], V: dict[str, float]) -> Iterator[tuple[str, Branch]]:
    for index, one in found.get_2_windings_transformers(all_attributes=True).iterrows():
        ends = _ends(one, place)
        if ends is None:
            continue
        V_1, V_2 = V[one.bus1_id], V[one.bus2_id]
        Z_n = V_2**2 / S_BASE
        # rho and alpha are those of V_2/V_1 at no load, in V; g and b are at the second side, before the impedance.
        ratio = V_2 / V_1 / (one.rho * cmath.exp(1j * math.radians(one.alpha)))
        transformer = Branch(
            name=_name(one, index),
            kind=TRANSFORMER,
            ends=ends,
            r=one.r_at_current_tap / Z_n,
            x=one.x_at_current_tap / Z_n,
            y_1=complex(one.g_at_current_tap, one.b_at_current_tap) * Z_n,
            ratio=ratio,
            rating=float(one.rated_s) * 1e6 if one.rated_s == one.rated_s else math.nan,
        )
        yield str(index), transformer


def _of_three_windings(
    found: Any, place: dict[str, int], V: dict[str, float], first: int
) -> Iterator[tuple[str, float, list[Branch]]]:
    for k, (index, one) in enumerate(found.get_3_windings_transformers(all_attributes=True).iterrows()):
        V_0, legs = float(one.rated_u0) * 1e3, []
        Z_n = V_0**2 / S_BASE
        for side in (1, 2, 3):
            bus = one[f"bus{side}_id"]
            if not one[f"connected{side}"] or bus not in place:
                continue
            rho, alpha = float(one[f"rho{side}"]), math.radians(float(one[f"alpha{side}"]))
            legs.append(
                Branch(
                    name=_name(one, index),
                    kind=TRANSFORMER,
                    ends=(place[bus], first + k),
                    r=one[f"r{side}_at_current_tap"] / Z_n,
                    x=one[f"x{side}_at_current_tap"] / Z_n,
                    y_1=complex(one[f"g{side}_at_current_tap"], one[f"b{side}_at_current_tap"]) * Z_n,
                    ratio=V_0 / V[bus] / (rho * cmath.exp(1j * alpha)),
                    leg=True,
                )
            )
        yield str(index), V_0, legs


def _shunts(found: Any, place: dict[str, int], V: dict[str, float]) -> Iterator[Shunt]:
    for index, one in found.get_shunt_compensators().iterrows():
        if one.connected and one.bus_id in place:
            y = complex(one.g, one.b) * V[one.bus_id] ** 2 / S_BASE
            yield Shunt(_name(one, index), place[one.bus_id], y)


def _sources(found: Any, place: dict[str, int], V: dict[str, float]) -> Iterator[tuple[str, Source]]:
    marked, known = (found.get_extensions(name) for name in ("slackTerminal", "generatorShortCircuit"))
    slack = set(marked["bus_id"]) if len(marked) else set()
    for index, one in found.get_generators(all_attributes=True).iterrows():
        if not one.connected or one.bus_id not in place or one.energy_source in _AS_CONVERTERS:
            continue
        rating = float(one.rated_s) * 1e6 if one.rated_s == one.rated_s else math.nan
        kind, z = SLACK if one.bus_id in slack else MACHINE, None
        if index in known.index:
            X = float(known.direct_sub_trans_x[index]) + float(known.step_up_transformer_x[index])
            if X > 0.0:
                own = complex(0.0, X) / (V[one.bus_id] ** 2 / S_BASE)
                z = own, own
        yield str(index), Source(_name(one, index), place[one.bus_id], kind, z, rating)
    for index, one in found.get_boundary_lines().iterrows():
        if one.connected and one.bus_id in place and not one.get("paired", False):
            yield str(index), Source(_name(one, index), place[one.bus_id], NEIGHBOUR)


def _converters(found: Any, place: dict[str, int]) -> Iterator[Converter]:
    for index, one in found.get_generators(all_attributes=True).iterrows():
        if one.connected and one.bus_id in place and one.energy_source in _AS_CONVERTERS:
            S = float(one.rated_s) * 1e6 if one.rated_s == one.rated_s else abs(float(one.max_p)) * 1e6
            yield Converter(_name(one, index), place[one.bus_id], S)
    for index, one in found.get_batteries().iterrows():
        if one.connected and one.bus_id in place:
            yield Converter(_name(one, index), place[one.bus_id], abs(float(one.max_p)) * 1e6)
    for table in (found.get_vsc_converter_stations(), found.get_static_var_compensators()):
        for index, one in table.iterrows():
            if one.connected and one.bus_id in place:
                yield Converter(_name(one, index), place[one.bus_id], math.nan)
