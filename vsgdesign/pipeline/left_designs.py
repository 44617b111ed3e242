"""Designs of gain tables that an earlier run has left in the folder that a run is about to replace.

Its record says what each was made from. A run that would design the very same takes it: what it writes is the same.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.gain_table_file import read_table_file
from vsgdesign.artifacts.provenance import package_hash, provenance
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import ArtifactError
from vsgdesign.parameters.study import ControllerSpec, Study

_UNSEEN = ("name", "title", "source", "controllers", "events", "hash", "survival", "verification", "files", "origin")
"""Parts of a study that a design never asks for."""
_OF_THE_RUN = {"duration": 1.0, "log_interval": 1.0, "csv_interval": 1.0, "P_ref": 0.0, "Q_ref": 0.0}
"""Fields of its [simulation] that a design never asks for."""


def made_from(study: Study, spec: ControllerSpec) -> str:
    """SHA-256 of all that decides the design of a controller's table, to the last bit: what the study says of it, the
    sources of this package, and the versions of Python and of the libraries. Empty for a structure that the program
    has registered itself: its sources are not known here."""
    if any(structure.name == spec.target.structure for structure in STRUCTURES.added):
        return ""
    own = study.with_limit_of(spec)
    own = replace(own, simulation=replace(own.simulation, **_OF_THE_RUN))
    parts = {
        "study": {field.name: repr(getattr(own, field.name)) for field in fields(own) if field.name not in _UNSEEN},
        "controller": repr(spec),
        "versions": provenance(),
        "code": package_hash(),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def left_designs(
    study: Study, specs: Sequence[ControllerSpec], out: str | Path, say: Callable[[str], None] | None = None
) -> dict[str, GainTable]:
    """The tables of these controllers as they come from their design, as far as ``out`` has them from the same inputs.

    They have no certificate and no verification, which depend on more. ``say`` takes one sentence for each.
    """
    found = {}
    for spec in specs:
        path = Path(out) / f"{spec.name}.table.json"
        said = _said(Path(out) / "results.json", spec.name)
        wanted = made_from(study, spec)
        if not wanted or said.get("made_from") != wanted:
            continue
        try:
            table = read_table_file(path)
        except ArtifactError:
            continue  # it is gone or damaged, and is designed again
        if table.sha256 != said.get("sha256"):
            continue
        found[spec.name] = replace(table, study=study.name, study_hash=study.hash, certificate=None, verification=None)
        if say is not None:
            say(
                f"The gain table of {spec.name} is that of {path}, which an earlier run designed from the same inputs "
                "with the same program."
            )
    return found


def _said(record: Path, name: str) -> dict[str, Any]:
    """What the record of a folder says of the table of a controller; empty where there is none."""
    try:
        table = json.loads(record.read_text(encoding="utf-8"))["controllers"][name]["table"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}
    return table if isinstance(table, dict) else {}
