"""Functions that design, show, certify, compare and export gain tables and load them into a scheduler, and comparisons
with the best fixed gains and of two results.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.shown import Shown, dataset_of, frame_of, given_study

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from vsgdesign.certificate import Certificate, Counterexample, Places
    from vsgdesign.design.comparison import Comparison
    from vsgdesign.export import ExportedC
    from vsgdesign.linear.stability.gain_table import Compared, TableCheck
    from vsgdesign.report.drawing.figures import NamedFigure
    from vsgdesign.verbs.pipeline.given_results import Comparison as Changes

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class DesignedTable(Shown):
    """A gain table with the results of its design.

    ``table`` holds the data, and ``document`` is what ``table build --json`` prints.
    """

    table: GainTable
    document: dict[str, Any]

    @property
    def title(self) -> str:
        """Name, structure and study of the table."""
        return f"Gain table {self.table.name} of {self.table.study}"

    def sentences(self) -> Sequence[str]:
        """The purpose of the table and what is proved about it, as ``vsgdesign table show`` prints it."""
        from vsgdesign.report.gain_table.words import heading

        return list(heading(self.table))

    def to_dict(self) -> dict[str, Any]:
        """The result of the design in JSON's types."""
        return self.document

    def frame(self) -> pd.DataFrame:
        """One row for each node, as table.csv of ``vsgdesign table report`` has them; units are in its ``attrs``.
        Needs the extra ``frames``."""
        from vsgdesign.verbs.pipeline.table import table_header, table_rows

        about = {"table": self.table.name, "scr_basis": self.table.base.scr_basis}
        return frame_of(table_header(self.table), table_rows(self.table), **about)

    def dataset(self) -> xr.Dataset:
        """Gains, margins and status over ``scr`` and ``x_over_r``. Needs the extra ``frames``."""
        return dataset_of(self.frame(), {"SCR": self.table.scr, "X/R": self.table.x_over_r})

    def save(self, file: str | Path) -> Path:
        """Writes the table to a file and returns its path.

        An existing gain table is replaced. Any other existing file raises ArtifactError.
        """
        from vsgdesign.artifacts import write_table_file

        write_table_file(self.table, Path(file))
        return Path(file)

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.gain_table.page import table_figures

        yield from table_figures(self.table)


@dataclass(frozen=True)
class Proof(Shown):
    """The result of :func:`certify`: a certificate, or a cell that makes one impossible.

    It is true for a certificate.
    """

    found: Certificate | Places | Counterexample

    @property
    def title(self) -> str:
        """The title, with the controller that was certified."""
        return f"Certificate of {self.found.controller}"

    @property
    def certified(self) -> bool:
        """Whether the decay is proved over the whole region."""
        return bool(self.to_dict()["certified"])

    def __bool__(self) -> bool:
        return self.certified

    def sentences(self) -> Sequence[str]:
        """What was proved, or the cell that makes a proof impossible."""
        from vsgdesign.report.gain_table.words import certificate_text

        return certificate_text(self.found).split("\n")

    def to_dict(self) -> dict[str, Any]:
        """The record in JSON's types."""
        return self.found.as_document()


def design_table(
    study: Study | str | Path,
    *,
    controller: str | None = None,
    workers: int | None = None,
    points: int | None = None,
    progress: Progress | None = None,
) -> DesignedTable:
    """Designs the gain table of a scheduled controller (the last one, if none is named) to the study's specification.

    ``workers`` is the number of processes (None means one per core). ``points`` is the number of random grids of each
    check between the nodes (default 2000). Nothing is written to a file. Raises StudyError if the study has no
    [specification], and the errors of :func:`vsgdesign.verbs.pipeline.table.build_table_file`.
    """
    from vsgdesign.artifacts import read_table_file
    from vsgdesign.verbs.pipeline.one_unit import as_unit
    from vsgdesign.verbs.pipeline.table import build_table_file

    study = as_unit(given_study(study, "design_table"), "design_table")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{study.name}.json"
        document = build_table_file(
            study, file, controller=controller, workers=workers, points=points, progress=progress
        )
        return DesignedTable(read_table_file(file), {key: value for key, value in document.items() if key != "file"})


def open_table(file: str | Path) -> DesignedTable:
    """The gain table of a file. Raises ArtifactError if the file is damaged or is not a gain table."""
    from vsgdesign.artifacts import read_table_file

    return DesignedTable(read_table_file(file), {})


def certify(
    study: Study | str | Path,
    *,
    controller: str | None = None,
    table: DesignedTable | GainTable | None = None,
    decay: float | None = None,
    progress: Progress | None = None,
    **region: Any,
) -> Proof:
    """Searches for one Lyapunov function over a region of grids, powers and estimate errors.

    The result is a certificate, or a cell that makes one impossible. ``table`` holds the gains of a controller that
    takes them from a table; without it the table is read, taken from below ``out`` or designed first. ``decay`` is the
    decay rate in 1/s to be proved; None asks for the largest. ``region`` may hold the pairs ``scr``, ``x_over_r``,
    ``P_pu`` and ``Q_pu``, and ``error``, ``error_Z`` and ``rate`` (1/s), as in :func:`vsgdesign.certificate.region_of`.
    Whatever it leaves out is taken from the box of the table, and ``scr`` is on the table's basis. A certificate also
    says after which steps no limit acts. Raises the errors of :func:`vsgdesign.certificate.certify`.
    """
    from vsgdesign.artifacts.ready import Ready, read_tables
    from vsgdesign.certificate import certify as of_one
    from vsgdesign.certificate import of_a_pair, on_basis_of_table, region_of, with_steps
    from vsgdesign.verbs.pipeline.one_unit import as_unit
    from vsgdesign.verbs.pipeline.study_tables import study_tables, with_left_tables

    whole = given_study(study, "certify")
    study = as_unit(whole, "certify")
    given = table.table if isinstance(table, DesignedTable) else table
    study = study if given is not None else with_left_tables(study)
    tables = read_tables(study)
    if given is not None:
        tables |= {spec.name: given for spec in study.controllers if spec.schedule == "table"}
    study = on_basis_of_table(study, controller, Ready(tables=tables))
    asked: dict[str, Any] = {"scr": None, "x_over_r": None} | region
    spec, chosen = region_of(study, controller, **asked, ready=Ready(tables=tables))
    if spec.name not in tables:
        tables |= study_tables(replace(study, controllers=(spec,)), progress=progress).tables
    ready = Ready(tables=tables)
    prove = of_a_pair if whole.plant is not None and len(whole.plant.units) > 1 else of_one
    found = prove(study, spec, chosen, ready=ready, decay=decay, progress=progress)
    return Proof(with_steps(study, spec, found, ready=ready, progress=progress))


def export_c(
    source: Study | DesignedTable | GainTable | str | Path,
    out: str | Path,
    *,
    controller: str | None = None,
    **options: Any,
) -> ExportedC:
    """Writes the C99 code of a table (or of its file), or of a controller of a study, into the folder ``out``.

    ``controller`` names the controller of a study; None is the last one. Its folder has the converter with its ports.
    ``options`` of a table are those of :func:`vsgdesign.export.export_c_files` (``weights``, ``study``, ``rate`` ...),
    those of a study ``table`` and ``rate``. Raises ArtifactError where the table does not fit or the folder cannot be
    written.
    """
    from vsgdesign.artifacts import write_table_file
    from vsgdesign.export import export_c_files

    if isinstance(source, Study):
        from vsgdesign.export.c_code import export_unit_c
        from vsgdesign.verbs.pipeline.export import unit_of_study

        given = options.pop("table", None)
        table = given.table if isinstance(given, DesignedTable) else given
        unit = unit_of_study(source, controller, table=table, **options)
        return export_unit_c(unit, out, inputs=source.input_files)

    if isinstance(source, str | Path):
        return export_c_files(source, out, **options)
    table = source.table if isinstance(source, DesignedTable) else source
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "table.json"
        write_table_file(table, file)
        return export_c_files(file, out, **options)


Table = DesignedTable | GainTable | str | Path
"""A gain table, or its file."""


@dataclass(frozen=True)
class ComparedGains(Shown):
    """The result of :func:`compare`. ``comparison`` has every contender with its grids and steps."""

    comparison: Comparison

    @property
    def title(self) -> str:
        """The study's title."""
        return f"Comparison: {self.comparison.study.title}"

    def sentences(self) -> Sequence[str]:
        """Who keeps the specification, and what each contender keeps, as on the page."""
        from vsgdesign.report.comparison.page import comparison_headline
        from vsgdesign.report.comparison.tables import verdicts

        return [comparison_headline(self.comparison), *verdicts(self.comparison)]

    def to_dict(self) -> dict[str, Any]:
        """The content of results.json of ``vsgdesign compare``."""
        from vsgdesign.verbs.pipeline.comparison import comparison_document

        return plain(comparison_document(self.comparison))

    def _figures(self) -> Iterator[NamedFigure]:
        from vsgdesign.report.comparison.page import comparison_figures

        yield from comparison_figures(self.comparison)


def compare(
    study: Study | str | Path,
    out: str | Path | None = None,
    *,
    emt: bool = True,
    seed: int = 0,
    workers: int | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> ComparedGains:
    """Compares a study's controllers with the best fixed gains of their structures, as ``vsgdesign compare`` does.

    With ``out`` the folder of the verb is written, too. ``emt``: whether steps are simulated; ``seed`` is that of the
    search for fixed gains. Gain tables that the study asks for are read, taken from below ``out`` where an earlier
    command has left them, or designed first. Raises the errors of
    :func:`vsgdesign.verbs.pipeline.comparison.report_comparison`.
    """
    from vsgdesign.verbs.pipeline.comparison import compare_study, report_comparison
    from vsgdesign.verbs.pipeline.one_unit import as_one_converter, as_unit
    from vsgdesign.verbs.pipeline.study_tables import study_tables, with_left_tables

    study = with_left_tables(as_unit(as_one_converter(given_study(study, "compare")), "compare"))
    if out is None:
        ready = study_tables(study, workers=workers, certificates=False, progress=progress).ready
        return ComparedGains(compare_study(study, ready, emt=emt, seed=seed, progress=progress))
    found: list[Comparison] = []
    report_comparison(study, out, emt=emt, seed=seed, workers=workers, progress=progress, done=found.append)
    return ComparedGains(found[0])


@dataclass(frozen=True)
class ComparedTables(Shown):
    """The result of :func:`compare_tables`."""

    compared: Sequence[Compared]
    names: Sequence[str]

    @property
    def title(self) -> str:
        """The names of the tables."""
        return f"Gain tables: {', '.join(self.names)}"

    def sentences(self) -> Sequence[str]:
        """The worst margins of each table over the grids of the first one."""
        from vsgdesign.report.gain_table.overview import comparison_lines

        return comparison_lines(self.compared, self.names)

    def to_dict(self) -> dict[str, Any]:
        """What ``vsgdesign table compare --json`` prints."""
        from vsgdesign.report.gain_table.overview import comparison_document

        return plain(comparison_document(self.compared, self.names))


def compare_tables(*tables: Table) -> ComparedTables:
    """Compares the gains and margins of two or more tables on the grids of the first one. Raises ArtifactError for
    tables of different systems."""
    from vsgdesign.linear.stability.gain_table import compare_tables as compared

    if len(tables) < 2:
        raise TypeError("compare_tables takes at least two tables.")
    given = [_given(table) for table in tables]
    names = [str(one) if isinstance(one, str | Path) else table.name for one, table in zip(tables, given, strict=True)]
    return ComparedTables(compared(given, names), names)


@dataclass(frozen=True)
class CheckedTable(Shown):
    """The result of :func:`check_table`. It is true where no fault was found."""

    table: GainTable
    outcome: TableCheck
    name: str

    @property
    def title(self) -> str:
        """The table that was checked."""
        return f"Check of gain table {self.table.name}"

    def __bool__(self) -> bool:
        return not self.outcome.faults

    def sentences(self) -> Sequence[str]:
        """What ``vsgdesign table check`` prints."""
        from vsgdesign.report.gain_table.words import check_text

        return check_text(self.name, self.table, self.outcome).split("\n")

    def to_dict(self) -> dict[str, Any]:
        """What ``vsgdesign table check --json`` prints."""
        from vsgdesign.verbs.pipeline.table import check_document

        return plain({"table": self.table.name, "sha256": self.table.sha256} | check_document(self.outcome))


def check_table(table: Table, *, study: Study | str | Path | None = None) -> CheckedTable:
    """Computes again what follows from a table, and compares it with the table and, if one is given, with its study."""
    from vsgdesign.verbs.pipeline.one_unit import as_unit
    from vsgdesign.verbs.pipeline.table import check_whole_table

    found = _given(table)
    own = None if study is None else as_unit(given_study(study, "check_table"), "check_table")
    name = str(table) if isinstance(table, str | Path) else found.name
    return CheckedTable(found, check_whole_table(found, own), name)


def _given(table: Table) -> GainTable:
    from vsgdesign.artifacts import read_table_file

    if isinstance(table, str | Path):
        return read_table_file(table)
    return table.table if isinstance(table, DesignedTable) else table


@dataclass(frozen=True)
class Difference(Shown):
    """The result of :func:`diff`: changed ``inputs``, ``verdicts`` and ``figures`` of ``changes``."""

    changes: Changes

    @property
    def title(self) -> str:
        """The two results."""
        return f"From {self.changes.a} to {self.changes.b}"

    def sentences(self) -> Sequence[str]:
        """How much changed, and whether a verdict got worse."""
        from vsgdesign.report.page.terminal import diff_sentence

        return [diff_sentence(self.changes.document())]

    def to_dict(self) -> dict[str, Any]:
        """What ``vsgdesign diff --json`` prints."""
        return plain(self.changes.document())


def diff(a: str | Path, b: str | Path) -> Difference:
    """What changed from result A to result B, each a folder of results or its results.json. Raises ArtifactError."""
    from vsgdesign.verbs.pipeline.given_results import compare_results

    return Difference(compare_results(a, b))
