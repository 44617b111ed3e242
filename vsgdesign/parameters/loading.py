"""From a TOML file to a Study: base documents merged, then every fault reported at once."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from vsgdesign.errors import Fault, StudyError
from vsgdesign.parameters.building import build_study
from vsgdesign.parameters.inner_loops import GIVEN, InnerLoopSource
from vsgdesign.parameters.reader import Asked
from vsgdesign.parameters.study import Study, StudyOrigin
from vsgdesign.parameters.toml_file import parse_toml, read_toml

_CASE_PREFIX = "case:"
_MAX_BASES = 8


def case_names() -> tuple[str, ...]:
    """Names of the published and example cases that come with the package."""
    folder = resources.files("vsgdesign.parameters") / "cases"
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
        path = _case_file(base[len(_CASE_PREFIX) :]) if base.startswith(_CASE_PREFIX) else path.parent / base
        found.append(path)
    return found


def _case_file(name: str) -> Path:
    return Path(str(resources.files("vsgdesign.parameters") / "cases" / f"{name}.toml"))


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
    placed = _files_in(dict(document), Path(origin.folder))
    study = build_study(placed, origin.default_name, _hash(document), faults, inner_loops, asked)
    if faults:
        raise StudyError(origin.source, faults)
    return replace(study, origin=origin)


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
    if base.startswith(_CASE_PREFIX):
        name = base[len(_CASE_PREFIX) :]
        if name not in case_names():
            known = ", ".join(f'"{_CASE_PREFIX}{case}"' for case in case_names())
            raise StudyError(source, [Fault("base", f'"{base}"', "no such case", f"Known: {known}.")])
        text = _case_file(name).read_text(encoding="utf-8")
        below = _merge_bases(parse_toml(text, base), folder, base, depth - 1)
    else:
        # What a base names is relative to that base; seen from here it is beside the base, too.
        below = _files_in(_document(folder / base, depth - 1), Path(base).parent)
    return _merge(below, document)


FILES = (
    ("controllers", "table"),
    ("estimator", "weights"),
    ("estimator", "field_weights"),
    ("estimator", "recipe"),
    ("replay", "file"),
)
"""Section and field of what names a file, relative to the document that says it. A recipe may be a word instead."""


def _files_in(document: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The document with the files that it names looked up in a folder."""

    def placed(table: Any, field: str) -> Any:
        named = table.get(field) if isinstance(table, dict) else None
        if not isinstance(named, str) or not named.strip() or (field == "recipe" and not named.endswith(".toml")):
            return table
        return table | {field: str(folder / named)}

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
