"""A sheet to sign: the answer of a run, its gains, evidence, limits and hashes on one page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from vsgdesign.artifacts.files import write_new
from vsgdesign.report.page.blocks import SOURCE, Block, Heading, Note, Page, Span, Table, opening, words
from vsgdesign.report.page.converter import converter_table, filter_table
from vsgdesign.report.page.pdf import print_pdf, sheets_of
from vsgdesign.report.scenario import promise_tables, tables
from vsgdesign.report.scenario.answer import scenario_answer, scenario_headline
from vsgdesign.report.scenario.outcomes import step_outcomes
from vsgdesign.report.scenario.page import left_out, limits_of_validity, lines_of_tables
from vsgdesign.simulation.scenario import ScenarioResult
from vsgdesign.simulation.scenario.judging import judge_estimates
from vsgdesign.simulation.scenario.promises import promises_kept

_MOST = (30, 20, 14, 10, 7, 5, 3, 2, 1)
"""Rows of a table, fewer and fewer until all is on one sheet."""

_TO_SIGN = "Name, date, signature: ______________________________________________________________________"


def write_sheet(result: ScenarioResult, document: Mapping[str, Any], out_path: str | Path) -> None:
    """Write a PDF of one sheet, which must not be there yet: a signed one is never replaced.

    ``document`` is the content of results.json, with its hash. Raises ArtifactError.
    """
    pages = (sheet_page(result, document, most) for most in _MOST)
    fits = next((page for page in pages if sheets_of(page) == 1), None)
    with TemporaryDirectory() as folder:
        made = print_pdf(fits or sheet_page(result, document, _MOST[-1]), Path(folder) / "sheet.pdf")
        write_new(out_path, made.read_bytes())


def sheet_page(result: ScenarioResult, document: Mapping[str, Any], most: int = _MOST[0]) -> Page:
    """The page of a sheet, with at most so many rows of each table; what is left out is counted."""
    study = result.study
    outcomes, kept, judged = step_outcomes(result), promises_kept(result), judge_estimates(result)
    answer = scenario_answer(result, outcomes, kept, judged)
    evidence = [*lines_of_tables(result), *promise_tables.promise_sentences(kept)]
    blocks: list[Block] = [
        words(f"Parameters: {study.source}" if study.source else "", style=SOURCE),
        *left_out(result),
        *opening(scenario_headline(result, outcomes), [replace(answer, notes=())], ()),
        *(_in_line(table) for table in (converter_table(result), filter_table(result))),
        _first(tables.controllers_table(result), most),
        *(_first(tables.gains_table(result, controller), most) for controller in result.controllers[:most]),
        Heading("Evidence", 3),
        *([_first(tables.targets_table(outcomes), most)] if outcomes else []),
        *map(Note, evidence),
        Heading("Limits", 3),
        *map(Note, limits_of_validity(result)),
        _hashes(document),
        words(_TO_SIGN),
    ]
    origin = ("Study ", Span(study.name, code=True), ".")
    return Page(f"{study.title}: sheet of a run", blocks, origin)


def _hashes(document: Mapping[str, Any]) -> Table:
    """SHA-256 of what the sheet stands for; results.json has those of all files of its folder."""
    files = document["files"]
    made = [
        name for name in files if name.endswith((".table.json", ".weights.json", ".c/manifest.json", "report.html"))
    ]
    rows = [("study, with all that it is based on", document["study"]["hash"]), ("results.json", document["sha256"])]
    return Table("Hashes (SHA-256)", ("File", "Hash"), (*rows, *((name, files[name]) for name in made)), texts=2)


def _in_line(table: Table) -> Note:
    """A table of quantities and values as one paragraph."""
    said = ["" if not name else f"{name}: {value}" for name, value in table.rows]
    said = [text or f"{value}" for text, (_, value) in zip(said, table.rows, strict=True)]
    return Note(f"{table.title}. {'. '.join(said)}.")


def _first(table: Table, most: int) -> Table:
    """The first rows of a table, without its notes."""
    left = _more(len(table.rows) - most)
    flagged = frozenset(row for row in table.flagged if row < most)
    return replace(table, rows=table.rows[:most], flagged=flagged, notes=(left,) if left else ())


def _more(left: int) -> str:
    return f"… and {left} more in report.html." if left > 0 else ""
