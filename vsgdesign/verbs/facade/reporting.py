"""Result folders and pages from Python, with the same files that the commands of the command line write."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.ready import Ready
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.facade.assessed import Margins
from vsgdesign.verbs.facade.shown import given_study
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
        from vsgdesign.verbs.pipeline.one_unit import as_one_converter
        from vsgdesign.verbs.pipeline.plant import run_plant_study
        from vsgdesign.verbs.pipeline.run import run_study

        what = as_one_converter(what)
        if what.plant is not None:
            return run_plant_study(what, out, report=True, progress=progress)[1]
        return run_study(what, out, report=explorer or "still", progress=progress)
    if isinstance(what, Run):
        from vsgdesign.verbs.pipeline.run import write_run

        return write_run(what.result, out, explorer=explorer, progress=progress)
    if isinstance(what, Margins):
        from vsgdesign.verbs.pipeline.margins import write_stability

        return write_stability(what.result, out, explorer=explorer, progress=progress)
    from vsgdesign.verbs.pipeline.table import report_table

    return report_table(what.table, out, progress=progress)


def explore(
    study: Study | str | Path,
    page: str | Path,
    *,
    controllers: Sequence[str] | None = None,
    scr: float | None = None,
    x_over_r: float | None = None,
    lattice: tuple[int, int] = (48, 32),
    bridge: str = "averaged",
    ready: Ready | None = None,
    workers: int | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Path:
    """Writes the page that simulates, as ``vsgdesign explore --page`` does, and returns its path.

    The page is one file without a server. It shows these ``controllers`` of the study (None: those with which the
    explorer begins), and opens on the grid of ``scr`` and ``x_over_r`` (None: that of the study). ``lattice`` has the
    numbers of SCR and X/R, 2 to 120 and 1 to 80. Runs have the ``bridge`` "averaged" or "pwm" in place of the study's;
    those of a switched one have no verdict on the page. ``ready`` holds gain tables from an earlier call of
    :func:`vsgdesign.verbs.pipeline.making.make_ready`. Without it, those that the study asks for are read, taken from
    below ``out`` where an earlier command has left them, or designed first and kept there. A page is replaced, any
    other file is left unchanged. Raises StudyError, InfeasibleStudyError and ArtifactError.
    """
    from vsgdesign.report.explore.lattice import lattice_counts
    from vsgdesign.report.explore.page_file import write_page
    from vsgdesign.report.explore.session import session_from
    from vsgdesign.verbs.pipeline.one_unit import alone
    from vsgdesign.verbs.pipeline.study_tables import kept_tables

    counts = lattice_counts("x".join(map(str, lattice)))
    study = alone(given_study(study, "explore"), "explore")
    begins = {"controllers": None if controllers is None else list(controllers), "scr": scr, "x_over_r": x_over_r}
    start = {name: value for name, value in begins.items() if value is not None}
    there = ready or Ready(tables=kept_tables(study, workers=workers, progress=progress).tables)
    session = session_from(study, there, start, bridge=bridge)
    write_page(session, page, lattice=counts, progress=progress, workers=workers)
    return Path(page)
