"""From a gain table to its figures and page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vsgdesign.artifacts import staged_folder, write_json, write_table_file
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.progress import Progress, silent


def report_table(table: GainTable, out: str | Path, *, progress: Progress | None = None) -> dict[str, Any]:
    """Leave table.json, figures, results.json and report.html in ``out``; returns the content of results.json.

    The folder appears when everything is done. Raises ArtifactError.
    """
    from vsgdesign.report import write_table_figures, write_table_report
    from vsgdesign.stability.gain_table import check_table

    tell = progress or silent
    with staged_folder(out) as folder:
        tell("check the table", 0.0)
        outcome = check_table(table)
        tell("check the table", 1.0)
        write_table_file(table, folder / "table.json")
        tell("draw figures", 0.0)
        figures = write_table_figures(table, folder / "figures")
        tell("draw figures", 1.0)
        write_table_report(table, figures, folder / "report.html")
        document = {
            "table": {"name": table.name, "sha256": table.sha256, "study": table.study, "study_hash": table.study_hash},
            "cells": {status: int((table.status == status).sum()) for status in ("met", "relaxed", "outside")},
            "check": {"good": outcome.good} | vars(outcome),
            "figures": [figure.name for figure in figures],
        }
        write_json(folder / "results.json", document)
    return document
