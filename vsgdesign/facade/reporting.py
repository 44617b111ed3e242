"""Folders of evidence from Python: the same files as the verbs of the command line leave."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from vsgdesign.facade.assessed import Margins
from vsgdesign.facade.simulated import Run
from vsgdesign.facade.tables import DesignedTable
from vsgdesign.parameters.study import Study


def write_report(
    what: Study | Run | Margins | DesignedTable,
    out: str | Path,
    *,
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Any]:
    """Leave report.html, results.json, figures and data of a result in the folder ``out``.

    A study is run first (``vsgdesign run``); a :class:`Run`, :class:`Margins` or :class:`DesignedTable` is written as
    it is. An unchanged folder of the same kind is replaced, anything else is left alone (ArtifactError). Returns the
    content of results.json.
    """
    if isinstance(what, Study):
        from vsgdesign.pipeline.run import run_study

        return run_study(what, out, progress=progress)
    if isinstance(what, Run):
        from vsgdesign.pipeline.run import write_run

        return write_run(what.result, out, progress=progress)
    if isinstance(what, Margins):
        from vsgdesign.pipeline.margins import write_stability

        return write_stability(what.result, out, progress=progress)
    from vsgdesign.pipeline.table import report_table

    return report_table(what.table, out, progress=progress)
