"""The gain tables of a study as earlier commands have left them; what is missing is designed once and kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from vsgdesign.artifacts import write_table_file
from vsgdesign.artifacts.design_inputs import design_inputs, input_differences
from vsgdesign.artifacts.gain_table import GainTable, base_differences, base_of
from vsgdesign.artifacts.gain_table_file import read_table_file
from vsgdesign.artifacts.ready import read_named_table
from vsgdesign.artifacts.staging import parents_made
from vsgdesign.errors import ArtifactError
from vsgdesign.execution.progress import Progress
from vsgdesign.parameters.study import ControllerSpec, Study
from vsgdesign.pipeline.table import make_tables
from vsgdesign.runtime.guards import lacks_safe_place


@dataclass(frozen=True)
class KeptTables:
    """Gain tables by the name of their controller."""

    tables: dict[str, GainTable] = field(default_factory=dict)
    files: dict[str, Path] = field(default_factory=dict)
    """The file of each table, absolute; none for one that could not be kept."""
    words: list[str] = field(default_factory=list)
    """One sentence on each table that the study does not name."""


def kept_tables(
    study: Study,
    out: str | Path = "out",
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> KeptTables:
    """The gain table of every controller that asks for one.

    A table is read from the file that the study names. If it names none, it is read from what ``vsgdesign run``,
    ``vsgdesign table build`` or an earlier call has left below ``out``, if it was designed from the same inputs.
    Otherwise it is designed with its certificate, and kept in ``out/STUDY-explore``. ``say`` takes one sentence for
    each table that the study does not name. Raises the errors of :func:`vsgdesign.pipeline.table.make_tables`.
    """
    out, found = Path(out), KeptTables()
    own = out / f"{study.name}-explore"
    missing: list[ControllerSpec] = []
    reasons: list[str] = []

    def tell(sentence: str) -> None:
        found.words.append(sentence)
        if say is not None:
            say(sentence)

    for spec in study.controllers:
        if spec.schedule != "table":
            continue
        table, path = read_named_table(study, spec), Path(spec.table_file or "")
        if table is None:
            table, path, refused = _left(study, spec, out, own)
            if table is None:
                missing.append(spec)
                reasons += refused
                continue
            tell(f"The gain table of {spec.name} is that of {path}.")
        found.tables[spec.name], found.files[spec.name] = table, path.absolute()
    if missing:
        names = ", ".join(spec.name for spec in missing)
        why = f"the study names no file, and no earlier command has left one of the same design below {out}"
        why = "; ".join([why, *reasons])
        if say is not None:
            say(f"The gain table of {names} is designed now: {why}.")
        made = make_tables(replace(study, controllers=tuple(missing)), own, workers=workers, progress=progress)
        for name, table in made.items():
            path = own / f"{name}.table.json"
            found.tables[name] = table
            try:
                _keep(table, path)
                found.files[name] = path.absolute()
                tell(f"The gain table of {name} was designed and is kept in {path}.")
            except (ArtifactError, OSError) as error:
                tell(f"The gain table of {name} could not be kept and will be designed again next time: {error}")
    return found


def with_left_tables(study: Study, out: str | Path = "out", *, say: Callable[[str], None] | None = None) -> Study:
    """The study with the gain tables that earlier commands have left below ``out``, as files that it names.

    A table of the same design would be built again otherwise. A controller without one stays as it is. ``say`` takes
    one sentence for each table that is found, with the reason where it is not taken.
    """
    out, specs = Path(out), []
    for spec in study.controllers:
        if spec.schedule == "table" and spec.table_file is None:
            table, path, refused = _left(study, spec, out, out / f"{study.name}-explore")
            if table is not None:
                refused = [f"The gain table of {spec.name} is that of {path}"]
                spec = replace(spec, table_file=str(path.absolute()))
            if say is not None:
                for sentence in refused:
                    say(f"{sentence}.")
        specs.append(spec)
    return replace(study, controllers=tuple(specs))


def _left(study: Study, spec: ControllerSpec, out: Path, own: Path) -> tuple[GainTable | None, Path, list[str]]:
    """The table of the same design that an earlier command has left, where it is, and why others are not taken."""
    places = (out / study.name / f"{spec.name}.table.json", out / f"{study.name}-{spec.name}.json")
    refused = []
    for path in (*places, own / f"{spec.name}.table.json"):
        if not path.is_file():
            continue
        table, why = _same_design(study, spec, path)
        if table is not None:
            return table, path, []
        refused.append(f"{path} is not taken: {why}")
    return None, Path(), refused


def _same_design(study: Study, spec: ControllerSpec, path: Path) -> tuple[GainTable | None, str]:
    """The table in a file, if it is whole and designed from the inputs that the study has; otherwise why it is not."""
    try:
        table = read_table_file(path)
    except ArtifactError:
        return None, "the file is damaged"  # nobody's table here, and the one that is designed lies elsewhere
    own = study.with_limit_of(spec)
    if not table.design_inputs:
        return None, "it does not say what it was designed from"
    differences = base_differences(table.base, base_of(own, table.base.scr_basis), "the study")
    differences += input_differences(table.design_inputs, design_inputs(own, spec.target))
    if differences:
        more = f", and {len(differences) - 1} more" if len(differences) > 1 else ""
        return None, f"{differences[0]}{more}"
    if lacks_safe_place(table):
        return None, "an earlier version of vsgdesign designed it, without a safe place"
    return table, ""


def _keep(table: GainTable, path: Path) -> None:
    with parents_made(path.parent):
        write_table_file(table, path)
