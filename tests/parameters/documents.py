"""Study documents as nested dictionaries, so that a test can change one field and write it back as TOML."""

from __future__ import annotations

import copy
import json
import math
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from vsgdesign.errors import Fault, StudyError
from vsgdesign.study.parameters import Study, study_from_text

PUBLISHED = Path(__file__).resolve().parents[2] / "studies" / "published" / "study.toml"

MISSING = object()
"""Value of a field to be taken out."""


def case_document() -> dict[str, Any]:
    """The published case with the published study's scenario on top, as one document without a base."""
    case = resources.files("vsgdesign.study.parameters") / "cases" / "hoang2025_5kva.toml"
    document = tomllib.loads(case.read_text(encoding="utf-8"))
    study = tomllib.loads(PUBLISHED.read_text(encoding="utf-8"))
    study.pop("base")
    document["study"] |= study.pop("study")
    return document | study


def to_toml(value: Any) -> str:
    """TOML text of a document: tables inline, which TOML takes as well as sections."""
    return "".join(f"{_key(key)} = {_inline(item)}\n" for key, item in value.items())


def _key(key: str) -> str:
    return json.dumps(key, ensure_ascii=False)


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(key)} = {_inline(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_inline(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else ("inf" if value > 0.0 else "-inf")
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)


def changed(path: str, value: Any, document: dict[str, Any] | None = None) -> dict[str, Any]:
    """A copy with one field set (or taken out with MISSING); ``events.0.time`` reaches into lists."""
    result = copy.deepcopy(case_document() if document is None else document)
    *above, last = path.split(".")
    here: Any = result
    for step in above:
        here = here[int(step)] if isinstance(here, list) else here.setdefault(step, {})
    key: Any = int(last) if isinstance(here, list) else last
    if value is MISSING:
        del here[key]
    else:
        here[key] = value
    return result


def build(document: dict[str, Any], folder: str | Path = ".") -> Study:
    """The study of a document."""
    return study_from_text(to_toml(document), folder=folder)


def faults_of(document: dict[str, Any]) -> tuple[Fault, ...]:
    """The faults of a document that must have some."""
    with pytest.raises(StudyError) as caught:
        build(document)
    return caught.value.faults


def the_fault(document: dict[str, Any], field: str) -> Fault:
    """The one fault of a field."""
    found = faults_of(document)
    named = [fault for fault in found if fault.field == field]
    assert len(named) == 1, [str(fault) for fault in found]
    return named[0]
