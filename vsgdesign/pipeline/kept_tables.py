"""The gain tables of a study as earlier commands have left them; what is missing is designed once and kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
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


def kept_tables(
    study: Study,
    out: str | Path = "out",
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, GainTable]:
    """The gain table of every controller that asks for one, by the controller's name.

    A table is read from the file that the study names. If it names none, it is read from what ``vsgdesign run``,
    ``vsgdesign table build`` or an earlier call has left below ``out``, if it was designed from the same inputs.
    Otherwise it is designed with its certificate, and kept in ``out/STUDY-explore``. ``say`` takes one sentence for
    each table that the study does not name. Raises the errors of :func:`vsgdesign.pipeline.table.make_tables`.
    """
    out, tell = Path(out), say or (lambda _sentence: None)
    own = out / f"{study.name}-explore"
    tables: dict[str, GainTable] = {}
    missing: list[ControllerSpec] = []
    for spec in study.controllers:
        if spec.schedule != "table":
            continue
        named = read_named_table(study, spec)
        if named is not None:
            tables[spec.name] = named
            continue
        places = (out / study.name / f"{spec.name}.table.json", out / f"{study.name}-{spec.name}.json")
        for path in (*places, own / f"{spec.name}.table.json"):
            table = _same_design(study, spec, path)
            if table is not None:
                tables[spec.name] = table
                tell(f"The gain table of {spec.name} is that of {path}.")
                break
        else:
            missing.append(spec)
    if missing:
        names = ", ".join(spec.name for spec in missing)
        tell(f"Designing the gain table of {names}: the study names no file, and there is none of the same design.")
        made = make_tables(replace(study, controllers=tuple(missing)), own, workers=workers, progress=progress)
        for name, table in made.items():
            tell(_keep(table, own / f"{name}.table.json", name))
        tables |= made
    return tables


def _same_design(study: Study, spec: ControllerSpec, path: Path) -> GainTable | None:
    """The table in a file, if it is there, whole, and designed from the inputs that the study has."""
    if not path.is_file():
        return None
    try:
        table = read_table_file(path)
    except ArtifactError:
        return None  # a damaged file is nobody's table here, and the one that is designed lies elsewhere
    own = study.with_limit_of(spec)
    if not table.design_inputs or base_differences(table.base, base_of(own, table.base.scr_basis), "the study"):
        return None
    return None if input_differences(table.design_inputs, design_inputs(own, spec.target)) else table


def _keep(table: GainTable, path: Path, name: str) -> str:
    try:
        with parents_made(path.parent):
            write_table_file(table, path)
    except (ArtifactError, OSError) as error:
        return f"The gain table of {name} could not be kept and will be designed again next time: {error}"
    return f"The gain table of {name} is kept in {path}."
