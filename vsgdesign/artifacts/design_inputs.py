"""What the design of a gain table depends on, and no more: the resolved values, their hash, and where two differ.

A title, an event, a colour of the grid that no promise is about: none of them is here. Values are in SI and rounded to
twelve digits, so that neither units nor the order of a study file matter. What is zero, false or not given is left out:
a field that a later version adds, and that is off, changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.guarded_file import content_hash, is_number
from vsgdesign.equations.structures import STRUCTURES

if TYPE_CHECKING:
    from vsgdesign.artifacts.gain_table import GainTable
    from vsgdesign.study.parameters.study import ClosedFormTarget, Study

_DIGITS = 12
_SHOWN = 8
"""Fields that a refusal names."""


def resolved_inputs(study: Study, target: ClosedFormTarget) -> dict[str, Any]:
    """The values themselves, by section of the study file: converter, filter, loops, source, controller,
    specification. To the last bit: what unfinished cells are kept by."""
    specification = study.specification
    structure, droops = STRUCTURES[target.structure], {}
    if structure.Q_droop:
        droops["Q_droop"] = target.Q_droop
    if structure.P_droop:
        droops["P_droop"] = target.P_droop
    found: dict[str, Any] = {
        "converter": asdict(study.converter),
        "filter": asdict(study.filter),
        "inner_loops": study.inner_gains._asdict() | {"omega_t": study.omega_t},
        "power_loops": {"tau_P": study.tau_P, "tau_Q": study.tau_Q}
        | ({"notch_damping": study.notch_damping} if study.has_notch else {}),
        "grid": {"V_g_rms": study.grid_source.V_g_rms, "omega_g": study.grid_source.omega_g},
        "controller": {"structure": target.structure, "P_design": target.P, "Q_design": target.Q} | droops,
    }
    if specification is not None:
        found["specification"] = asdict(specification)
    return plain(found)


def design_inputs(study: Study, target: ClosedFormTarget) -> dict[str, Any]:
    """What a table that is designed for this controller of this study keeps: JSON's types."""
    return _kept(resolved_inputs(study, target))


def design_hash(inputs: Mapping[str, Any]) -> str:
    """SHA-256 of inputs; empty where there are none (a table that was not designed to a specification)."""
    return content_hash(dict(inputs)) if inputs else ""


def input_differences(made: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """Fields in which the inputs that a table was made from differ from those of a study, one sentence each.

    A study without [specification] takes the table's promises as they are.
    """
    mine, its = dict(_flat("", made)), dict(_flat("", wanted))
    names = [name for name in dict.fromkeys([*its, *mine]) if mine.get(name) != its.get(name)]
    if "specification" not in wanted:
        names = [name for name in names if not name.startswith("specification.")]
    return [
        f"{name} was {_shown(mine.get(name))} in its design, the study has {_shown(its.get(name))}"
        for name in sorted(names)
    ]


def study_differences(table: GainTable, study: Study) -> list[str]:
    """Why a table is not one of a study, one sentence each; empty where it is.

    It is one where some controller of the study would be designed from the same inputs. A table that does not keep
    its inputs (made by hand, or of schema 1) is one where it names the study's content hash.
    """
    if not table.design_inputs:
        if table.study_hash == study.hash:
            return []
        return [
            f"the study's hash is {study.hash[:12]}…, the table was made for {table.study_hash[:12]}…, and it does not "
            "hold the inputs of its design: build it again to compare it with a study"
        ]
    # The controller that it is named after, or the one that comes nearest.
    specs = sorted(study.controllers, key=lambda spec: spec.name != table.name)
    found = [input_differences(table.design_inputs, design_inputs(study, spec.target)) for spec in specs]
    named = [lines for spec, lines in zip(specs, found, strict=True) if spec.name == table.name]
    nearest = min(found, key=len)
    return _first(nearest if not nearest or not named else named[0])


_SAME = {
    "base.S_rated": "converter.S_rated",
    "base.V_rated_rms": "converter.V_rated_rms",
    "base.omega_n": "converter.omega_n",
    "base.V_g_rms": "grid.V_g_rms",
    "base.R_2": "filter.R_2",
    "base.L_2": "filter.L_2",
    "structure": "controller.structure",
    "P_design": "controller.P_design",
    "Q_design": "controller.Q_design",
}
"""Fields of a table and the inputs of its design that they repeat."""


def contradictions(table: GainTable) -> list[str]:
    """Where the fields of a table differ from the inputs of its design that it keeps, or from its specification, one
    sentence each."""
    inputs = dict(_flat("", table.design_inputs))
    if wrong := [f"design_inputs.{key} is {inputs[key]!r}, must be a number" for key in _no_numbers(inputs)]:
        return _first(wrong)
    pairs: list[tuple[str, Any, str, Any]] = []
    if inputs:
        pairs += [(name, attrgetter(name)(table), key, inputs.get(key)) for name, key in _SAME.items()]
        asked = dict(_flat("specification.", _kept(table.specification)))
        named = {key for key in inputs if key.startswith("specification.")}
        named = named | asked.keys() if named else set()
        pairs += [(key, asked.get(key), f"design_inputs.{key}", inputs.get(key)) for key in sorted(named)]
        V_n = table.base.V_rated_rms
        for k, key in enumerate(("converter.V_min_pu", "converter.V_max_pu")):
            pairs.append((f"validity.V_rms[{k}]", table.validity.V_rms[k], key, V_n * inputs.get(key, 0.0)))
    lines = [
        f"{name} is {_shown(mine)}, {key} gives {_shown(its)}"
        for name, mine, key, its in [*pairs, *_of_specification(table)]
        if _kept(mine) != _kept(its) and not (_is_close(mine, its) or (not mine and not its))
    ]
    return _first(lines)


def _first(lines: list[str]) -> list[str]:
    more = len(lines) - _SHOWN
    return lines if more <= 0 else [*lines[:_SHOWN], f"and {more} more fields differ"]


def _no_numbers(inputs: Mapping[str, Any]) -> list[str]:
    """Inputs of a design that are no numbers, although everything in these sections is one but a few words."""
    sections = ("converter.", "filter.", "grid.", "inner_loops.", "power_loops.", "controller.")
    named = [key for key in inputs if key.startswith(sections) and key not in _WORDS]
    return [key for key in named if not is_number(inputs[key])]


_WORDS = ("controller.structure", "converter.zero_sequence", "filter.kind")


def _of_specification(table: GainTable) -> Iterator[tuple[str, Any, str, Any]]:
    """Fields of a table that repeat its specification, where it has one with a box."""
    asked, v = table.specification, table.validity
    box = asked.get("box")
    if not isinstance(box, dict):
        return
    for name, value in box.items():
        if not all(map(is_number, value if isinstance(value, list) and not name.startswith("error") else [value])):
            yield f"specification.box.{name}", value, "the format", "a number or numbers"
            return
    for name in ("P", "Q"):
        if isinstance(powers := box.get(name), list) and powers:
            limits = [min(powers), max(powers)]
            yield f"validity.{name}", list(getattr(v, name)), f"specification.box.{name}", limits
    errors = [box.get(name, 0.0) for name in ("error_R", "error_X")]
    yield "validity.error", v.error, "specification.box", max(errors)
    yield "validity.error_Z", v.error_Z, "specification.box.error_Z", box.get("error_Z", 0.0)
    for name in ("scr", "x_over_r"):
        if isinstance(nodes := asked.get(name), list) and nodes:
            its = [float(value) for value in getattr(table, name) if value in nodes]
            yield name, its, f"specification.{name}", nodes
    if asked.get("aim") == "settling":
        yield "time_scale", table.time_scale, "specification.settling_time", asked.get("settling_time")


def _is_close(mine: Any, its: Any) -> bool:
    numbers = isinstance(mine, float) and isinstance(its, float)
    return numbers and abs(mine - its) <= 1e-11 * abs(mine)


def _kept(value: Any) -> Any:
    """Rounded, and without what is zero, false, empty or not given."""
    if isinstance(value, dict):
        kept = {key: _kept(item) for key, item in value.items()}
        return {key: kept[key] for key in sorted(kept) if isinstance(kept[key], list) or kept[key]}
    if isinstance(value, list):
        return [_kept(item) for item in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def _flat(prefix: str, content: Mapping[str, Any]) -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for key, value in content.items():
        rows += _flat(f"{prefix}{key}.", value) if isinstance(value, Mapping) else [(prefix + key, value)]
    return rows


def _shown(value: Any) -> str:
    if value is None:
        return "zero or not given"
    if isinstance(value, list):
        return "[" + ", ".join(map(_shown, value)) + "]"
    return f"{value:.{_DIGITS}g}" if isinstance(value, float) else str(value)
