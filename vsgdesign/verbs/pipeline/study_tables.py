"""Where the gain tables of a study come from: a file that it names, an earlier command, or a design that begins now."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from vsgdesign.artifacts import write_table_file
from vsgdesign.artifacts.design_inputs import design_inputs, input_differences
from vsgdesign.artifacts.files import package_hash, parents_made, provenance
from vsgdesign.artifacts.gain_table import GainTable, base_differences, base_of
from vsgdesign.artifacts.gain_table_file import read_table_file
from vsgdesign.artifacts.ready import Ready, read_named_table
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import ArtifactError
from vsgdesign.execution.executors import Progress, executor_of
from vsgdesign.execution.journal import work_folder
from vsgdesign.runtime.guards import lacks_safe_place
from vsgdesign.study.given_files import RESULT_BYTES, read_given
from vsgdesign.study.parameters.study import ControllerSpec, Study

CELLS = "cells"
"""Names the folder beside a table that keeps finished cells until the table is complete."""


@dataclass(frozen=True)
class LeftTables:
    """Where earlier commands have left tables, and which of them are taken."""

    places: Callable[[Study, ControllerSpec], tuple[Path, ...]]
    """Files in which the table of a controller may be, the first one first."""
    why_not: Callable[[Study, ControllerSpec, Path, GainTable], str]
    """Why the table in a file is not taken; empty where it is."""
    taken: str = "The gain table of {name} is that of {path}."
    """What is said of a table that is taken."""
    missing: str = ""
    """Why a table is designed, where that is said; the reasons why files are not taken follow."""
    keeps: bool = False
    """Whether a table that is designed now is kept at the last of the places."""


@dataclass(frozen=True)
class StudyTables:
    """The gain tables of a study by the name of their controller."""

    tables: dict[str, GainTable] = field(default_factory=dict)
    files: dict[str, Path] = field(default_factory=dict)
    """The file of each table, absolute; none for one that was designed and is not kept, or could not be."""
    words: list[str] = field(default_factory=list)
    """One sentence on each table that the study does not name."""
    say: Callable[[str], None] | None = None
    """Takes each of these sentences."""

    def tell(self, sentence: str) -> None:
        """Add a sentence."""
        self.words.append(sentence)
        if self.say is not None:
            self.say(sentence)

    @property
    def ready(self) -> Ready:
        """The tables as runs take them."""
        return Ready(tables=self.tables)


def study_tables(
    study: Study,
    out: str | Path | None = None,
    *,
    left: LeftTables | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    certificates: bool = True,
    keep: ExitStack | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> StudyTables:
    """The gain table of every controller of a study that asks for one.

    It is read from the file that the study names. If the study names none, it is one that an earlier command has
    ``left``; otherwise it is designed. Finished cells are kept beside ``out`` during a design, and until ``keep`` is
    closed if it is given. Without ``out`` they are in a temporary folder, and an interrupted design starts again. An
    ``executor`` is used instead of processes of its own, ``workers`` of them. ``certificates``: whether designed tables
    are certified. ``say`` takes one sentence for each table that the study does not name. Raises ArtifactError for a
    file that is not a table of this converter, and the errors of :func:`vsgdesign.design.table.build_table`.
    """
    found, missing, reasons = StudyTables(say=say), list[ControllerSpec](), list[str]()
    for spec in study.controllers:
        if spec.schedule != "table":
            continue
        table, path = read_named_table(study, spec), Path(spec.table_file or "")
        if table is None and left is not None:
            table, path, refused = _left(left, study, spec)
            reasons += refused
            if table is not None:
                found.tell(left.taken.format(name=spec.name, path=path))
        if table is None:
            missing.append(spec)
        else:
            found.tables[spec.name], found.files[spec.name] = table, path.absolute()
    if not missing:
        return found
    if left is not None and left.missing and say is not None:
        names = ", ".join(spec.name for spec in missing)
        say(f"The gain table of {names} is designed now: {'; '.join([left.missing, *reasons])}.")
    with ExitStack() as own:
        held = own if keep is None else keep
        place = Path(os.path.realpath(out or Path(held.enter_context(TemporaryDirectory())) / study.name))
        executor = executor or own.enter_context(executor_of(workers))
        for spec in missing:
            cells = place.with_name(f"{place.name}.{spec.name}")
            what = f'the table of controller {spec.name} for "{out}"'
            folder = held.enter_context(work_folder(cells, CELLS, what=what, own=True))
            found.tables[spec.name] = _designed(study, spec, folder, executor, certificates, progress)
            if left is not None and left.keeps:
                _keep(found, spec, left.places(study, spec)[-1])
    in_order = [spec.name for spec in study.controllers if spec.name in found.tables]
    return replace(found, tables={name: found.tables[name] for name in in_order})


def _designed(
    study: Study,
    spec: ControllerSpec,
    folder: Path,
    executor: Executor | None,
    certificates: bool,
    progress: Progress | None,
) -> GainTable:
    from vsgdesign.design.table import build_table

    own = study.with_limit_of(spec)
    return build_table(own, spec, folder, executor=executor, certificate=certificates, progress=progress).table


def _keep(found: StudyTables, spec: ControllerSpec, path: Path) -> None:
    """Keeps a table that was just designed."""
    try:
        with parents_made(path.parent):
            write_table_file(found.tables[spec.name], path)
    except (ArtifactError, OSError) as error:
        found.tell(f"The gain table of {spec.name} could not be kept and will be designed again next time: {error}")
        return
    found.files[spec.name] = path.absolute()
    found.tell(f"The gain table of {spec.name} was designed and is kept in {path}.")


def _left(left: LeftTables, study: Study, spec: ControllerSpec) -> tuple[GainTable | None, Path, list[str]]:
    """The first table that is taken, where it is, and why others are not."""
    refused = []
    for path in left.places(study, spec):
        if not path.is_file():
            continue
        try:
            table = read_table_file(path)
            why = left.why_not(study, spec, path, table)
        except ArtifactError:
            table, why = None, "the file is damaged"  # nobody's table here, and one that is designed lies elsewhere
        if not why:
            return table, path, []
        refused.append(f"{path} is not taken: {why}")
    return None, Path(), refused


def left_below(out: str | Path = "out") -> LeftTables:
    """What ``vsgdesign run``, ``vsgdesign table build`` or an earlier call has left of the same design in or below
    ``out``, beside the study's file, or in or below ``out`` beside it. A table that is designed is kept in
    ``out/STUDY-explore``."""
    out = Path(out)

    def places(study: Study, spec: ControllerSpec) -> tuple[Path, ...]:
        name = f"{spec.name}.table.json"
        made = Path(study.name) / name, Path(f"{study.name}-{spec.name}.json"), Path(f"{study.name}-explore") / name
        left = Path(name), *made  # the first one is that of --out out
        below = [out / one for one in left[:-1]]
        if study.origin is not None:
            folder = Path(study.origin.folder)
            below += [folder / name, *(folder / "out" / one for one in left)]
        return *below, out / left[-1]

    where = f"in {out}, below it or beside the study's file"
    missing = f"the study names no file, and no earlier command has left one of the same design {where}"
    return LeftTables(places, _another_design, missing=missing, keeps=True)


def kept_beside(folder: str | Path) -> LeftTables:
    """What an interrupted command has kept in a folder of its own, of the same design."""

    def places(study: Study, spec: ControllerSpec) -> tuple[Path, ...]:
        return (Path(folder) / f"{study.name}.{spec.name}.table.json",)

    return LeftTables(places, _another_design, keeps=True)


def left_by_run(out: str | Path) -> LeftTables:
    """What an earlier run has left in the folder that a run is about to replace, and would design again to the last
    bit: its record says what each table was made from."""

    def why_not(study: Study, spec: ControllerSpec, path: Path, table: GainTable) -> str:
        wanted, said = made_from(study, spec), _recorded(path.with_name("results.json"), spec.name)
        same = wanted and said.get("made_from") == wanted and said.get("sha256") == table.sha256
        return "" if same else "it was made from other inputs or by another program"

    words = "which an earlier run designed from the same inputs with the same program."
    return LeftTables(
        lambda _study, spec: (Path(out) / f"{spec.name}.table.json",),
        why_not,
        taken=f"The gain table of {{name}} is that of {{path}}, {words}",
    )


def kept_tables(
    study: Study,
    out: str | Path = "out",
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> StudyTables:
    """The gain tables of a study as earlier commands have left them (:func:`left_below`); what is missing is designed
    once, with its certificate, and kept. Raises the errors of :func:`study_tables`."""
    own = Path(out) / f"{study.name}-explore"
    return study_tables(study, own, left=left_below(out), workers=workers, progress=progress, say=say)


def with_left_tables(study: Study, out: str | Path = "out", *, say: Callable[[str], None] | None = None) -> Study:
    """The study with the gain tables that earlier commands have left (:func:`left_below`), as files that it names.

    A table of the same design would be built again otherwise. A controller without one stays as it is. ``say`` takes
    one sentence for each table that is found, with the reason where it is not taken.
    """
    specs, left = [], left_below(out)
    for spec in study.controllers:
        if spec.schedule == "table" and spec.table_file is None:
            table, path, sentences = _left(left, study, spec)
            if table is not None:
                sentences = [left.taken.format(name=spec.name, path=path).rstrip(".")]
                spec = replace(spec, table_file=str(path.absolute()))
            if say is not None:
                for sentence in sentences:
                    say(f"{sentence}.")
        specs.append(spec)
    return replace(study, controllers=tuple(specs))


def _another_design(study: Study, spec: ControllerSpec, _path: Path, table: GainTable) -> str:
    """Why a table is not what the study's inputs would design; empty where it is."""
    own = study.with_limit_of(spec)
    if not table.design_inputs:
        return "it does not say what it was designed from"
    differences = base_differences(table.base, base_of(own, table.base.scr_basis), "the study")
    differences += input_differences(table.design_inputs, design_inputs(own, spec.target))
    if differences:
        more = f", and {len(differences) - 1} more" if len(differences) > 1 else ""
        return f"{differences[0]}{more}"
    if lacks_safe_place(table):
        return "an earlier version of vsgdesign designed it, without a safe place"
    return ""


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


def _recorded(record: Path, name: str) -> dict[str, Any]:
    """What the record of a folder says of the table of a controller; empty where there is none."""
    try:
        table = json.loads(read_given(record, RESULT_BYTES))["controllers"][name]["table"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}
    return table if isinstance(table, dict) else {}
