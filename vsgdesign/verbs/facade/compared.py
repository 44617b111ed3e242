"""Comparisons: of controllers with the best fixed gains, of gain tables, and of two results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.shown import Shown, given_study
from vsgdesign.verbs.facade.tables import DesignedTable

if TYPE_CHECKING:
    from vsgdesign.design.comparison import Comparison
    from vsgdesign.linear.stability.gain_table import Compared, TableCheck
    from vsgdesign.report.drawing.figures import NamedFigure
    from vsgdesign.verbs.pipeline.given_results import Comparison as Changes

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
