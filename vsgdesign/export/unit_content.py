"""What the templates of the converter with ports are filled with."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from vsgdesign.codegen import c_functions
from vsgdesign.codegen.described import ascii_text
from vsgdesign.equations.dc_control import clamp_of_sample, turned_with_link
from vsgdesign.equations.dc_link import bridge_limit
from vsgdesign.equations.frames import clarke, clarke_inverse, instantaneous_power, rotate
from vsgdesign.equations.grid import grid_of_each
from vsgdesign.equations.integration import within_a_turn
from vsgdesign.export.c_content import initialiser, literal
from vsgdesign.export.field import field_laws
from vsgdesign.export.laws import NAMES, PUBLIC, laws
from vsgdesign.export.port_records import FIXED, TUNABLE, Port, PortList, refusal
from vsgdesign.export.ports import port_list, remembered
from vsgdesign.export.unit import Unit
from vsgdesign.runtime.guards import STATUSES

WORDS = {"controller": "unit", "reference": "loops"}
"""What the functions of each variant are called in C."""

TITLES = {
    "controller": "The whole controller: v, i_s and i_g in, bridge voltage out.",
    "reference": "The power loops alone: P and Q in, voltage and angle out.",
}

FRAMES = (clarke, clarke_inverse, instantaneous_power, rotate, within_a_turn)
"""What the ports need between phases and space vectors."""

BREAKER_HELD_S = 0.2
"""So long the voltages have to be in step before the breaker may close, s."""


def lists_of(unit: Unit) -> dict[str, PortList]:
    """Ports, parameters and state of both variants."""
    lookup, limiter = unit.scheduler.lookup, unit.origin.limiter
    structs = dict(laws(lookup.structure, lookup.law, lookup.scr_basis, limiter).structs)
    if unit.has_field:
        structs |= field_laws(unit.constants.network is not None).structs
    structs["vsg_unit_memory_t"] = memory_struct(unit)
    return {variant: port_list(unit, variant, structs) for variant in WORDS}


def unit_document(unit: Unit) -> dict[str, Any]:
    """The controller in JSON's types: where it comes from, its timing, and the list of its ports and states."""
    lists = lists_of(unit)
    return {
        "controller": unit.controller,
        "T_s": unit.T_s,
        "delay_samples": unit.delay_samples,
        "estimator": "field" if unit.has_field else "none",
        "sha256": unit_hash(unit, lists),
        "notes": list(unit.notes),
        "variants": [one.document() for one in lists.values()],
    }


def unit_hash(unit: Unit, lists: dict[str, PortList]) -> str:
    """SHA-256 of the table's hash, the settings, the constants, the ports and their start values."""
    parts = {
        "origin": repr(unit.origin),
        "settings": repr(unit.scheduler.settings),
        "lookup": repr(unit.scheduler.lookup),
        "constants": repr(unit.constants),
        "gains": repr((unit.gains, unit.grid, unit.references, unit.rest)),
        "timing": repr((unit.T_s, unit.delay_samples, unit.update_samples)),
        "ports": [one.document() for one in lists.values()],
    }
    more = {"probes": unit.probes, "link": unit.link, "on_line": unit.on_line}
    parts |= {name: repr(value) for name, value in more.items() if value}
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def unit_content(unit: Unit) -> dict[str, Any]:
    """What vsg_unit.h and vsg_unit.c need."""
    lists, tick, link = lists_of(unit), unit.scheduler.settings.tick, unit.link
    clamp = None if link is None else link.clamp
    needed = [*FRAMES, *([bridge_limit] if link else []), *([grid_of_each] if unit.on_line else [])]
    needed += [clamp_of_sample] if clamp else []
    needed += [turned_with_link] if link is not None and link.droop is not None else []
    frames = c_functions(needed, prefix="unit_", names=NAMES)
    return {
        "controller_name": ascii_text(unit.controller),
        "T_s": repr(unit.T_s),
        "delay": unit.delay_samples,
        "omega_n": repr(unit.omega_n),
        "memory_struct": memory_struct(unit),
        "variants": [
            {"word": WORDS[variant], "title": TITLES[variant], "ports": _commented(one)}
            for variant, one in lists.items()
        ],
        "scheduled": unit.scheduled,
        "has_field": unit.has_field,
        "frame_constants": frames.constants.rstrip(),
        "frame_structs": "\n".join(body for name, body in frames.structs.items() if name not in PUBLIC),
        "frame_functions": frames.functions,
        "held": round(BREAKER_HELD_S / unit.T_s),
        "sha256": unit_hash(unit, lists),
        "inner_gains": initialiser(unit.constants.inner_gains),
        "settings": initialiser(unit.constants.controller_settings),
        "references": initialiser(unit.references),
        "gains": initialiser(unit.gains),
        "grid": initialiser(unit.grid),
        "rest": initialiser(unit.rest),
        "update_samples": unit.update_samples,
        "update_ticks": round(unit.update_samples * unit.T_s / tick),
        "ticks_per_sample": repr(unit.T_s / tick),
        "limit_may_move": unit.limit_may_move,
        "bits": [name.upper() for name in STATUSES.values()],
        "update_text": f"{unit.update_samples * unit.T_s * 1e3:.6g} ms",
        "notes": [ascii_text(note) for note in unit.notes],
        "probes": [initialiser(one) for one in unit.probes],
        "per_volt": None if link is None else literal(link.per_volt),
        "clamp": None if clamp is None else [literal(one) for one in (*clamp.numbers, unit.omega)],
        "droop": None if link is None or link.droop is None else [literal(one) for one in (link.nominal, link.droop)],
        "pair": unit.pair,
        "v_dc": None if link is None else [literal(one) for one in (link.rest, *link.limits)],
        "units": None if unit.on_line is None else [literal(one) for one in (unit.on_line.least, unit.on_line.most)],
    }


def memory_struct(unit: Unit) -> str:
    """What a wrapper remembers, as a struct of C."""
    lines = [
        f"    {'uint32_t' if one.whole else 'vsg_real_t'} {one.name}; /* {_comment(one.meaning, one.unit)} */"
        for one in remembered(unit)
    ]
    return "\n".join(["typedef struct {", *lines, "} vsg_unit_memory_t;"])


def _commented(one: PortList) -> dict[str, Any]:
    return {
        "inputs": [_port(port) for port in one.inputs],
        "outputs": [_port(port) for port in one.outputs],
        "parameters": [_port(port) for port in one.parameters],
        "states": one.states,
    }


def _port(port: Port) -> dict[str, Any]:
    comment = _comment(port.meaning, port.unit)
    found = {"name": port.name, "comment": comment, "start": repr(float(port.start)), "whole": port.whole}
    if port.kind in (FIXED, TUNABLE):
        found |= {"low": literal(port.low), "high": literal(port.high), "refusal": refusal(port)}
    return found


def _comment(meaning: str, unit: str) -> str:
    return ascii_text(meaning if unit == "1" else f"{meaning}, {unit}")
