"""Ports, parameters and state of an exported controller: one list, out of the records that run on a converter.

Every wrapper is printed from this list. A port takes its unit and its meaning from the record of the equations in which
its number is (:mod:`vsgdesign.export.field`); the records of this module hold what only a wrapper has.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from vsgdesign.codegen.described import DescribedNumber, described_numbers
from vsgdesign.equations.controller import ControllerOutput, ControllerState, GridWatch, Measurement
from vsgdesign.equations.frames import clarke_inverse
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_loops import References
from vsgdesign.equations.scheduler_data import SchedulerState
from vsgdesign.export.port_records import (
    FIXED,
    INPUT,
    OUTPUT,
    STATUS_MEANINGS,
    TUNABLE,
    Asked,
    Port,
    PortList,
    Stored,
    Told,
    UnitMemory,
)
from vsgdesign.export.unit import Unit
from vsgdesign.runtime.guards import STATUSES


def port_list(unit: Unit, variant: str, structs: Mapping[str, str]) -> PortList:
    """The ports and the state of one variant of an exported controller. ``structs``: what C calls the records."""
    ports = _of_controller(unit) if variant == "controller" else _of_reference(unit)
    return PortList(variant, tuple(ports), tuple(_states(unit, variant, structs)))


def _of_controller(unit: Unit) -> Iterator[Port]:
    refs, S, asked = unit.references, unit.S_rated, unit.asked
    v, i_s, i_g = (_phases(value) for value in unit.measured)
    yield from _abc("v", Measurement, "v_alpha", INPUT, v)
    yield from _abc("i_s", Measurement, "i_s_alpha", INPUT, i_s)
    yield from _abc("i_g", Measurement, "i_g_alpha", INPUT, i_g)
    grid = described_numbers(GridWatch)[0]._replace(meaning="Voltage of the grid behind the breaker")
    yield from _abc("v_grid", grid, "", INPUT, v)
    if unit.link is not None:
        yield _one(Asked, "v_dc", INPUT, unit.link.rest, *unit.link.limits)
    yield from _source_limits(unit)
    yield _one(Asked, "closed", INPUT, 1.0, 0.0, 1.0)
    yield from _references(refs, S)
    yield from _estimate(unit, not unit.has_field)
    yield from _abc("v_b", ControllerOutput, "v_b_alpha", OUTPUT, _phases(unit.bridge))
    yield _one(ControllerOutput, "omega", OUTPUT, unit.omega)
    yield _one(ControllerState, "theta", OUTPUT, unit.rest.theta)
    yield _one(ControllerState, "V", OUTPUT, unit.rest.V, name="V_rms")
    yield _one(ControllerOutput, "P", OUTPUT, unit.powers[0])
    yield _one(ControllerOutput, "Q", OUTPUT, unit.powers[1])
    yield _one(ControllerOutput, "limited", OUTPUT, 0.0, 0.0, 1.0)
    yield _one(Told, "used", OUTPUT, 1.0, 0.0, 1.0)
    yield from _told(unit)
    if unit.limit_may_move:
        yield _one(Asked, "i_max_pk", TUNABLE, asked.i_max_pk, 0.0, asked.i_max_pk, name="i_max")
    if unit.has_field:
        yield _one(Asked, "probe", TUNABLE, 1.0, 0.0, 1.0)
        yield replace(_one(Asked, "pair", FIXED, unit.pair, 1.0, len(unit.probes)), whole=True)
    yield from _starts(unit)


def _of_reference(unit: Unit) -> Iterator[Port]:
    V_n = unit.references.V_n
    yield _one(ControllerOutput, "P", INPUT, unit.powers[0])
    yield _one(ControllerOutput, "Q", INPUT, unit.powers[1])
    measured = _number(ControllerState, "V")._replace(meaning="Measured voltage")
    yield _port(measured, "V", INPUT, unit.rest.V, 0.0, 2.0 * V_n)
    yield _one(Asked, "delta", INPUT, unit.rest.theta, name="delta_v")
    if unit.link is not None and unit.link.droop is not None:
        yield _one(Asked, "v_dc", INPUT, unit.link.rest, *unit.link.limits)
    yield from _source_limits(unit)
    yield _one(Asked, "closed", INPUT, 1.0, 0.0, 1.0)
    yield from _references(unit.references, unit.S_rated)
    yield from _estimate(unit, True)
    yield _one(ControllerState, "V", OUTPUT, unit.rest.V, name="V_rms")
    yield _one(ControllerState, "theta", OUTPUT, unit.rest.theta)
    yield _one(Told, "delta", OUTPUT, unit.rest.theta)
    yield _one(ControllerOutput, "omega", OUTPUT, unit.omega)
    yield _one(Told, "used", OUTPUT, 1.0, 0.0, 1.0)
    yield from _told(unit)
    yield from _starts(unit)


def _source_limits(unit: Unit) -> Iterator[Port]:
    """What the source of the dc link can give, where the controller asks for no more."""
    clamp = None if unit.link is None else unit.link.clamp
    if clamp is not None:
        yield _one(Asked, "P_dc_low", INPUT, clamp.limits.low)
        yield _one(Asked, "P_dc_high", INPUT, clamp.limits.high)


def _references(refs: References, S: float) -> Iterator[Port]:
    for name, low, high in (
        ("P_ref", -2.0 * S, 2.0 * S),
        ("Q_ref", -2.0 * S, 2.0 * S),
        ("omega_0", 0.9 * refs.omega_0, 1.1 * refs.omega_0),
        ("V_n", 0.5 * refs.V_n, 1.5 * refs.V_n),
    ):
        port = _one(References, name, INPUT, getattr(refs, name), low, high)
        yield Port(port.name, port.unit, f"Set point: {_lower(port.meaning)}", *_rest_of(port))


def _estimate(unit: Unit, given: bool) -> Iterator[Port]:
    """What the scheduler is given by an estimator outside, and whether it is to follow it."""
    if not unit.scheduled:
        return
    c, on_line = unit.scheduler.settings, unit.on_line
    where, least, most = ("PCC", 1, 1) if on_line is None else ("node of the plant", on_line.least, on_line.most)
    if given:
        for name, quantity, unit_of, limits in (
            ("R_g", "resistance", "Ω", c.R_g),
            ("L_g", "inductance", "H", c.L_g),
        ):
            meaning = f"Estimated {quantity} of the grid at the {where}"
            low, high = float(limits[0]) / most, float(limits[1]) / least
            yield Port(name, unit_of, meaning, INPUT, getattr(unit.grid, name) / most, low, high)
        yield _one(Asked, "estimated", INPUT, 1.0, 0.0, 1.0)
        if on_line is not None:
            yield replace(_one(Asked, "units", INPUT, most, least, most), whole=True)
    yield _one(Asked, "scheduling", TUNABLE, 1.0, 0.0, 1.0)


def _told(unit: Unit) -> Iterator[Port]:
    yield _one(Told, "ready", OUTPUT, 1.0, 0.0, 1.0)
    for name, unit_of, value in (("R_g", "Ω", unit.grid.R_g), ("L_g", "H", unit.grid.L_g)):
        quantity = "resistance" if name == "R_g" else "inductance"
        yield Port(f"{name}_of_gains", unit_of, f"Grid {quantity} that the gains are made for", OUTPUT, value)
    if unit.scheduled:
        for bit, name in STATUSES.items():
            start = float(bool(unit.first_status & bit))
            yield Port(f"status_{name}", "1", STATUS_MEANINGS[name], OUTPUT, start, 0.0, 1.0)
        yield _one(Told, "reason", OUTPUT, 0.0, 0.0, 8.0)
    if unit.link is not None and unit.link.clamp is not None:
        yield _one(Told, "P_cut", OUTPUT, 0.0)


def _starts(unit: Unit) -> Iterator[Port]:
    at, S, V_n = unit.asked, unit.S_rated, unit.references.V_n
    yield _one(Asked, "start", FIXED, 0.0, 0.0, 1.0)
    yield _one(Asked, "P_start", FIXED, at.P_start, -2.0 * S, 2.0 * S)
    yield _one(Asked, "Q_start", FIXED, at.Q_start, -2.0 * S, 2.0 * S)
    yield _one(Asked, "V_start", FIXED, at.V_start, 0.0, 2.0 * V_n)
    yield _one(Asked, "theta_start", FIXED, at.theta_start, -math.pi, math.pi)


def _number(record: Any, field: str) -> DescribedNumber:
    return next(one for one in described_numbers(record) if one.name == field)


def _port(
    number: DescribedNumber, name: str, kind: str, start: float, low: float = -math.inf, high: float = math.inf
) -> Port:
    return Port(name, number.unit, number.meaning, kind, float(start), float(low), float(high))


def _one(
    record: Any, field: str, kind: str, start: float, low: float = -math.inf, high: float = math.inf, name: str = ""
) -> Port:
    """A port that is one number of a record."""
    return _port(_number(record, field), name or field, kind, start, low, high)


def _abc(name: str, of: Any, field: str, kind: str, start: tuple[float, ...]) -> Iterator[Port]:
    """The three phases of what a record has as α and β."""
    number = of if isinstance(of, DescribedNumber) else _number(of, field)
    for phase, value in zip("abc", start, strict=True):
        meaning = f"{number.meaning}, phase {phase}"
        unit = number.unit.removesuffix(" peak")
        yield Port(f"{name}_{phase}", unit, meaning, kind, value)


def _rest_of(port: Port) -> tuple[str, float, float, float]:
    return port.kind, port.start, port.low, port.high


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]


def _phases(vector: complex) -> tuple[float, float, float]:
    """Phases of α + jβ, without a zero sequence."""
    a, b, c = clarke_inverse(vector.real, vector.imag)
    return float(a), float(b), float(c)


def remembered(unit: Unit) -> list[DescribedNumber]:
    """What a wrapper of this controller remembers, of UnitMemory."""
    clamps = unit.link is not None and unit.link.clamp is not None
    there = {"v_dc": unit.link is not None, "pair": unit.has_field} | dict.fromkeys(_OF_CLAMP, clamps)
    return [number for number in described_numbers(UnitMemory) if there.get(number.name, True)]


_OF_CLAMP = ("P_ref", "P_dc_low", "P_dc_high", "omega", "omega_lost")


_MEMBER = re.compile(r"^    (\w+) (\w+)(?:\[\d+\])?;", re.MULTILINE)


def _states(unit: Unit, variant: str, structs: Mapping[str, str]) -> Iterator[Stored]:
    """Every number that goes from one sample to the next, with its place in the struct of the variant."""
    where: dict[str, str] = {"memory.": "vsg_unit_memory_t"}
    described: dict[str, list[DescribedNumber]] = {"memory.": described_numbers(UnitMemory)}
    within = "x." if unit.has_field and variant == "controller" else ""
    if variant == "controller":
        for part, struct, record, first in (
            ("control.state.", "vsg_controller_state_t", ControllerState, unit.rest),
            ("control.lost.", "vsg_controller_state_lost_t", None, None),
            ("control.gains.", "vsg_gains_t", type(unit.gains), None),
            ("control.grid.", "vsg_grid_estimate_t", GridEstimate, None),
            ("control.refs.", "vsg_references_t", References, None),
        ):
            path = f"{within}{part}"
            where[path] = struct
            described[path] = [] if record is None else described_numbers(record, first)
        where["watch."], described["watch."] = "vsg_grid_watch_t", described_numbers(GridWatch)
    else:
        where |= {"power.gains.": "vsg_gains_t", "power.refs.": "vsg_references_t", "grid.": "vsg_grid_estimate_t"}
        described |= {"power.gains.": described_numbers(type(unit.gains)), "power.refs.": described_numbers(References)}
        described["grid."] = described_numbers(GridEstimate)
        for name, field in POWER_FIELDS.items():
            number = _number(ControllerState, field)
            yield Stored(f"power.{name}", number.unit, number.meaning, False)
        for k in range(3):
            yield Stored(f"power.lost[{k}]", "1", LOST, False)
    if unit.scheduled:
        path = f"{within}scheduler."
        where[path], described[path] = "vsg_scheduler_t", described_numbers(SchedulerState)
    if unit.has_field and variant == "controller":
        where |= unit.field_structs
        described |= unit.field_numbers
        for path, kind in unit.field_members.items():
            yield Stored(path, "1", "Of the field estimator", kind != "vsg_real_t", _bits(kind))
    for path, struct in where.items():
        known = {number.name: number for number in described.get(path, [])}
        for member, kind in members(structs, struct):
            number = known.get(member)
            meaning = LOST if number is None else number.meaning
            unit_of = "1" if number is None else number.unit
            yield Stored(f"{path}{member}", unit_of, meaning, kind != "vsg_real_t", _bits(kind))


LOST = "What rounding left out of an integrator"

POWER_FIELDS = {
    "theta": "theta",
    "omega_i": "omega_i",
    "V_rms": "V",
    "P_f": "P_f",
    "Q_f": "Q_f",
    "ripple_P": "ripple_P",
    "ripple_Q": "ripple_Q",
    "mean_P": "mean_P",
    "mean_Q": "mean_Q",
}
"""What ``vsg_power_t`` calls the states of the power loops."""


def members(structs: Mapping[str, str], struct: str, path: str = "") -> Iterator[tuple[str, str]]:
    """Every number of a struct of C with its type, those of the structs in it included."""
    for kind, name in _MEMBER.findall(structs[struct]):
        if kind in structs:
            yield from members(structs, kind, f"{path}{name}.")
        else:
            yield f"{path}{name}", kind


def _bits(kind: str) -> int:
    return {"uint32_t": 32, "uint16_t": 16}.get(kind, 0)
