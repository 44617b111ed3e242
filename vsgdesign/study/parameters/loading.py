"""From a TOML file or a document in Python to a Study: bases and changes merged, every fault reported at once; and
where the fields of a study are, and what they say of themselves.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from importlib import resources
from numbers import Integral, Real
from pathlib import Path
from typing import Any

from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.errors import Fault, StudyError
from vsgdesign.study.given_files import CASE_PREFIX, parse_toml, read_toml
from vsgdesign.study.parameters.building import Sections, build_study
from vsgdesign.study.parameters.fields import Field, fields_of
from vsgdesign.study.parameters.inner_loops import GIVEN, InnerLoopSource
from vsgdesign.study.parameters.reader import Asked, UnitError, parse_quantity
from vsgdesign.study.parameters.study import InnerLoopRequest, Study, StudyOrigin

_MAX_BASES = 8


def case_names() -> tuple[str, ...]:
    """Names of the published and example cases that come with the package."""
    folder = resources.files("vsgdesign.study.parameters") / "cases"
    return tuple(sorted(item.name[:-5] for item in folder.iterdir() if item.name.endswith(".toml")))


def load_study(path: str | Path, inner_loops: InnerLoopSource | None = None) -> Study:
    """Reads, merges and checks a study file. Raises StudyError with every fault in it.

    ``inner_loops`` supplies the gains if the study asks for a design of them and the rest of it has no fault.
    """
    origin = read_document(path)
    return replace(study_from_document(origin.document, origin, inner_loops), files=files_of(path))


def read_document(path: str | Path) -> StudyOrigin:
    """The merged document of a study file, not yet checked. Raises StudyError."""
    path = Path(path)
    name = path.stem if path.stem != "study" else (path.resolve().parent.name or path.stem)
    return StudyOrigin(_document(path, _MAX_BASES), str(path.parent), str(path), name)


def files_of(path: str | Path) -> tuple[str, ...]:
    """A study file and those that it is based on."""
    return tuple(os.path.abspath(file) for file in (path, *base_files(path)))


def base_files(path: str | Path) -> list[Path]:
    """The files that a study file builds on, the nearest first; packaged cases by where they are installed.

    A base that cannot be read ends the list: reading the study tells what is wrong with it.
    """
    found: list[Path] = []
    path = Path(path)
    while len(found) < _MAX_BASES:
        try:
            base = read_toml(path, "study file").get("base")
        except StudyError:
            break
        if not isinstance(base, str):
            break
        path = _case_file(base[len(CASE_PREFIX) :]) if base.startswith(CASE_PREFIX) else path.parent / base
        found.append(path)
    return found


def _case_file(name: str) -> Path:
    return Path(str(resources.files("vsgdesign.study.parameters") / "cases" / f"{name}.toml"))


def study_from_text(
    text: str, source: str = "study text", folder: str | Path = ".", inner_loops: InnerLoopSource | None = None
) -> Study:
    """The same from TOML text; relative bases and files are looked up in ``folder``."""
    document = merged_document(parse_toml(text, source), folder, source)
    return study_from_document(document, StudyOrigin(document, str(folder), source, "study"), inner_loops)


def merged_document(document: Mapping[str, Any], folder: str | Path = ".", source: str = "study") -> dict[str, Any]:
    """A document with its base read and merged; relative paths begin in ``folder``. Raises StudyError."""
    return _merge_bases(dict(document), Path(folder), source, _MAX_BASES)


def study_from_document(
    document: Mapping[str, Any],
    origin: StudyOrigin,
    inner_loops: InnerLoopSource | None = None,
    asked: dict[str, Asked] | None = None,
) -> Study:
    """The Study of a merged document, which may say more than the one that it came from (``origin``).

    ``asked`` collects every quantity that is read, by its full name. Raises StudyError with every fault.
    """
    faults: list[Fault] = []
    known = _with_cases(dict(document), Path(origin.folder))
    placed = with_files(known, lambda name: str(Path(origin.folder) / name))
    study = build_study(placed, origin.default_name, _hash(known), faults, inner_loops, asked)
    if faults:
        raise StudyError(origin.source, faults)
    return replace(study, origin=replace(origin, changed=changed))


def _with_cases(document: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The document with the cases of a plant's units read. Raises StudyError for one that cannot be read."""
    network = document.get("network")
    units = network.get("units") if isinstance(network, dict) else None
    if not isinstance(network, dict) or not isinstance(units, list):
        return document
    read = [
        {**one, "case": merged_document({"base": one["case"]}, folder, f"network.units[{k}].case")}
        if isinstance(one, dict) and isinstance(one.get("case"), str)
        else one
        for k, one in enumerate(units)
    ]
    return {**document, "network": {**network, "units": read}}


def merge(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """A document with changes on top: tables merge field by field; anything else replaces."""
    return _merge(dict(below), dict(above))


def _hash(document: Mapping[str, Any]) -> str:
    canonical = json.dumps(document, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(canonical.encode()).hexdigest()


def _document(path: Path, depth: int) -> dict[str, Any]:
    return _merge_bases(read_toml(path, "study file"), path.parent, str(path), depth)


def _merge_bases(document: dict[str, Any], folder: Path, source: str, depth: int) -> dict[str, Any]:
    base = document.pop("base", None)
    if base is None:
        return document
    if not isinstance(base, str) or depth == 0:
        problem = "must be a text" if depth else f"more than {_MAX_BASES} bases, each based on the next (a circle?)"
        raise StudyError(source, [Fault("base", str(base), problem, 'Give "case:NAME" or a path.')])
    if base.startswith(CASE_PREFIX):
        name = base[len(CASE_PREFIX) :]
        if name not in case_names():
            known = ", ".join(f'"{CASE_PREFIX}{case}"' for case in case_names())
            raise StudyError(source, [Fault("base", f'"{base}"', "no such case", f"Known: {known}.")])
        text = _case_file(name).read_text(encoding="utf-8")
        below = _merge_bases(parse_toml(text, base), folder, base, depth - 1)
    else:
        # What a base names is relative to that base; seen from here it is beside the base, too.
        below = with_files(_document(folder / base, depth - 1), lambda name: str(Path(base).parent / name))
    return _merge(below, document)


FILES = (
    ("controllers", "table"),
    ("estimator", "weights"),
    ("estimator", "field_weights"),
    ("estimator", "recipe"),
    ("replay", "file"),
)
"""Section and field of what names a file, relative to the document that says it. A recipe may be a word instead."""


def with_files(document: Mapping[str, Any], place: Callable[[str], str]) -> dict[str, Any]:
    """A document, or some of its sections, in which ``place`` says of each file that is named where it is."""

    def placed(table: Any, field: str) -> Any:
        named = table.get(field) if isinstance(table, dict) else None
        if not isinstance(named, str) or not named.strip() or (field == "recipe" and not named.endswith(".toml")):
            return table
        return table | {field: place(named)}

    found = dict(document)
    for section, field in FILES:
        tables = found.get(section)
        if isinstance(tables, list):
            found[section] = [placed(table, field) for table in tables]
        elif tables is not None:
            found[section] = placed(tables, field)
    return found


_ALTERNATIVES = (
    ({"R_g", "L_g"}, {"scr", "x_over_r"}),
    ({"V_rated_rms"}, {"V_rated_ll_rms"}),
    ({"current_response_time", "voltage_response_time", "damping_ratio"}, {"K_pc", "K_ic", "K_pv", "K_iv"}),
    ({"R"}, {"R_pu"}),
    ({"L"}, {"X_L_pu"}),
    ({"C"}, {"X_C_pu"}),
    ({"P"}, {"P_pu"}),
    ({"Q"}, {"Q_pu"}),
    ({"P", "P_pu"}, {"R", "R_pu"}),
    ({"Q", "Q_pu"}, {"L", "X_L_pu", "C", "X_C_pu"}),
)
"""Fields of one table that say the same thing; the last seven are of a load and of a fault."""
_GIVEN = set(GIVEN)
_DESIGNED = {"design", "scr", "x_over_r", "seed"}
"""Fields of [inner_loops] that give the gains, and those that leave them to be designed: either replaces all of the
other that stand below."""


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Tables merge field by field; anything else replaces. One way of saying a thing replaces the other."""
    merged = dict(below)
    for left, right in _ALTERNATIVES:
        for ours, theirs in ((left, right), (right, left)):
            if ours & above.keys() and not theirs & above.keys():
                merged = {key: value for key, value in merged.items() if key not in theirs}
    if "design" in above:
        merged = {key: value for key, value in merged.items() if key not in _GIVEN}
    if (_GIVEN - {"damping_ratio"}) & above.keys():  # that one is a field of other sections, too
        merged = {key: value for key, value in merged.items() if key not in _DESIGNED}
    for key, value in above.items():
        if isinstance(value, dict) and isinstance(merged.get(key), dict):
            merged[key] = _merge(merged[key], value)
        else:
            merged[key] = value
    return merged


AFTER_THE_LAST_EVENT = 3.0
"""Seconds that a run goes on where a study built in Python says no duration: the loops settle in about one."""

ONE_CONTROLLER = ({"name": "scheduled", "kind": "scheduled"},)
"""The controllers of a study built in Python that names none: the closed form on the true impedance."""


def complete(document: Mapping[str, Any]) -> dict[str, Any]:
    """A document with what a study built in Python may leave out: controllers, references (0) and duration.

    A study file has to say them; here a system alone (a packaged case) is enough for a first run.
    """
    simulation = document.get("simulation", {})
    if not isinstance(simulation, Mapping):
        return dict(document)  # the reader says what is wrong with it
    given = {"P_ref": 0.0, "Q_ref": 0.0, **simulation}
    if "duration" not in given:
        given["duration"] = AFTER_THE_LAST_EVENT + max(map(_time_of, _tables(document, "events")), default=0.0)
    return {"controllers": list(ONE_CONTROLLER), **document, "simulation": given}


def plain_document(value: Any) -> Any:
    """A copy as TOML would have given it: NumPy's numbers as numbers, tuples and arrays as lists, paths as texts."""
    if isinstance(value, Mapping):
        return {str(key): plain_document(item) for key, item in value.items()}
    if isinstance(value, str | bool) or value is None:
        return value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Integral):
        return int(value)
    if isinstance(value, Real):
        return float(value)
    if hasattr(value, "tolist"):
        return plain_document(value.tolist())
    return [plain_document(item) for item in value] if isinstance(value, list | tuple | range) else value


def built(
    document: Mapping[str, Any],
    origin: StudyOrigin,
    changes: Mapping[str, Any],
    inner_loops: InnerLoopSource | None,
    asked: dict[str, Asked] | None = None,
) -> Study:
    """The study of a merged document with changes; the origin that it keeps says what was written, not what was
    filled in. ``asked`` collects every quantity that is read, by its full name. Raises StudyError with every fault."""
    written = merge(document, with_files(plain_document(changes), os.path.abspath))
    study = study_from_document(complete(written), origin, inner_loops, asked)
    return replace(study, origin=replace(origin, document=written, changed=changed))


def changed_with_same_inner_loops(
    study: Study, changes: Mapping[str, Any], asked: dict[str, Asked] | None = None
) -> Study:
    """The study with changes, as :meth:`vsgdesign.study.parameters.study.Study.with_changes`, but with the inner-loop
    gains that it has, also where they were designed for data that the changes alter.

    ``asked`` collects every quantity that is read, by its full name. Raises StudyError with every fault.
    """
    origin = _origin_of(study)
    gains = study.inner_gains, study.omega_t
    after = built(origin.document, origin, changes, lambda _: gains, asked)
    return replace(after, files=study.files)


def _origin_of(study: Study) -> StudyOrigin:
    if study.origin is None:
        raise StudyError(
            study.name,
            [Fault("study", "", "was built from its parts and not read from a document", "Use vd.load.")],
        )
    return study.origin


def changed(study: Study, changes: Mapping[str, Any]) -> Study:
    """:meth:`vsgdesign.study.parameters.study.Study.with_changes`."""
    origin = _origin_of(study)

    def same_gains(request: InnerLoopRequest) -> tuple[InnerLoopGains, float]:
        if request == study.inner_request:
            return study.inner_gains, study.omega_t
        raise StudyError(
            origin.source,
            [
                Fault(
                    "inner_loops",
                    "",
                    "the gains were designed for data that differ from those of the changed study",
                    "Make the change in vd.load, which designs them again, or give the gains.",
                )
            ],
        )

    unchanged = built(origin.document, origin, {}, same_gains)
    if replace(unchanged, files=study.files) != study:
        raise StudyError(
            study.name,
            [
                Fault(
                    "study",
                    "",
                    "some of its fields were replaced directly, and a change of its document would lose them",
                    "Make every change with with_changes, with_controllers or with_events.",
                )
            ],
        )
    after = built(origin.document, origin, changes, same_gains)
    return replace(after, files=study.files)


def _tables(document: Mapping[str, Any], section: str) -> list[Mapping[str, Any]]:
    found = document.get(section, [])
    return [table for table in found if isinstance(table, Mapping)] if isinstance(found, list | tuple) else []


def _time_of(event: Mapping[str, Any]) -> float:
    try:
        return parse_quantity(event.get("time"), "s")
    except UnitError:
        return 0.0  # the reader says what is wrong with it


def tables_of(fields: tuple[Field, ...], path: str = "") -> Iterator[tuple[str, tuple[Field, ...]]]:
    """The path of every table of a study, and its fields; ``""`` for the top level."""
    yield path, fields
    for one in fields:
        if one.of:
            yield from tables_of(one.fields, f"{path}.{one.name}" if path else one.name)


def field_at(path: str) -> Field:
    """The field of a path such as ``power_loops.tau_P``. Raises KeyError for a path that a study does not have."""
    table, _, name = path.rpartition(".")
    return {one.name: one for one in dict(tables_of(fields_of(Sections)))[table]}[name]


def plain_meaning(one: Field) -> str:
    """The meaning of a field as text without links and marks."""
    text = re.sub(r" \(:eq:.[a-z0-9-]+.\)", "", one.meaning.removesuffix("."))
    return re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text).replace("`", "")


def type_text(one: Field, table: str = "Mapping[str, Any]") -> str:
    """The type of a field as an argument in Python, as text: ``Quantity`` is a number in SI or a text with a unit.

    ``table``: the type of a table.
    """
    words = "Literal[" + ", ".join(f'"{word}"' for word in one.choices) + "]"
    types = {
        "number": "Quantity",
        "range": "Quantity | Sequence[Quantity]",
        "numbers": "Sequence[Quantity]",
        "whole number": "int",
        "whole range": "int | Sequence[int]",
        "true or false": "bool",
        "word": words if isinstance(one.words, tuple) else f"{words} | str",
        "text": "str | Path" if "file" in one.limits or ".csv" in one.limits else "str",
        "name": "str",
        "names": "Sequence[str | int]",
        "tables": f"Sequence[{table}]",
        "table": table + (f' | Literal["{one.instead}"]' if one.instead else ""),
    }
    return types[one.kind]
