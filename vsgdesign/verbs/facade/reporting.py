"""Result folders from Python, with the same files that the commands of the command line write."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.assessed import Margins
from vsgdesign.verbs.facade.simulated import Run
from vsgdesign.verbs.facade.tables import DesignedTable


def write_report(
    what: Study | Run | Margins | DesignedTable,
    out: str | Path,
    *,
    explorer: bool = True,
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Any]:
    """Writes report.html, results.json, figures and data of a result into the folder ``out``.

    A study is run first, as ``vsgdesign run`` does. A :class:`Run`, :class:`Margins` or :class:`DesignedTable` is
    written as it is. A folder of the same kind is replaced if nobody has changed it since. Anything else is left
    unchanged and raises ArtifactError. ``explorer``: whether it has what simulates in the browser. Returns the content
    of results.json.
    """
    if isinstance(what, Study):
        from vsgdesign.verbs.pipeline.plant import alone
        from vsgdesign.verbs.pipeline.run import run_study

        what = alone(what, "write_report")
        return run_study(what, out, report=explorer or "still", progress=progress)
    if isinstance(what, Run):
        from vsgdesign.verbs.pipeline.run import write_run

        return write_run(what.result, out, explorer=explorer, progress=progress)
    if isinstance(what, Margins):
        from vsgdesign.verbs.pipeline.margins import write_stability

        return write_stability(what.result, out, explorer=explorer, progress=progress)
    from vsgdesign.verbs.pipeline.table import report_table

    return report_table(what.table, out, progress=progress)
