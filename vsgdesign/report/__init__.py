"""Figures and pages of a scenario, a stability assessment, a gain table, a comparison and a verification. This module
does not load matplotlib.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.report.drawing.figure_types import ExplorerFile, WrittenFigure

if TYPE_CHECKING:
    from vsgdesign.artifacts.gain_table import GainTable
    from vsgdesign.design.comparison import Comparison
    from vsgdesign.estimator.trained import TrainedEstimator
    from vsgdesign.linear.stability.gain_table import TableCheck
    from vsgdesign.report.page.live import StaticPage
    from vsgdesign.simulation.scenario import ScenarioResult
    from vsgdesign.simulation.stability_result import StabilityResult

__all__ = [
    "ExplorerFile",
    "WrittenFigure",
    "begin_figures",
    "write_comparison_figures",
    "write_comparison_report",
    "write_figures",
    "write_report",
    "write_stability_figures",
    "write_stability_report",
    "write_table_figures",
    "write_table_report",
    "write_verification_report",
]


def write_figures(
    result: ScenarioResult,
    folder: str | Path,
    trained: TrainedEstimator | None = None,
) -> list[WrittenFigure]:
    """Draw every figure of a scenario into ``folder`` (created if missing), each as SVG and as PNG (200 dpi).

    ``trained`` is the network that was trained in the run, for the figures of its training.
    """
    return begin_figures(result, folder, trained)()


def begin_figures(
    result: ScenarioResult,
    folder: str | Path,
    trained: TrainedEstimator | None = None,
    executor: Executor | None = None,
) -> Callable[[], list[WrittenFigure]]:
    """Begins what :func:`write_figures` does, on worker processes of an ``executor``, and returns what waits for it."""
    from vsgdesign.report.scenario.figures import begin_all

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return begin_all(result, folder, trained, executor)


def write_report(
    result: ScenarioResult,
    figures: Sequence[WrittenFigure],
    out_path: str | Path,
    trained: TrainedEstimator | None = None,
    inner: dict[str, Any] | None = None,
    jumps: dict[str, Any] | None = None,
    live: StaticPage | None = None,
) -> Path:
    """Write the report of a scenario: one HTML file that contains the text, the tables and the given figures.

    ``inner`` says what designed inner loops keep, and ``jumps`` what current phase jumps make (results.json of the verb
    ``inner`` and its ``phase_jumps``). ``live`` becomes the part on which one tries other grids and events.
    """
    from vsgdesign.report.scenario.page import write_page

    return write_page(result, figures, Path(out_path), trained, inner, jumps, live)


def write_stability_figures(result: StabilityResult, folder: str | Path) -> list[WrittenFigure]:
    """Draw every figure of a stability assessment into ``folder`` (made if missing), as SVG and as PNG (200 dpi)."""
    from vsgdesign.report.drawing.files import write_all
    from vsgdesign.report.stability.page import stability_figures

    return write_all(stability_figures(result), folder)


def write_stability_report(
    result: StabilityResult,
    figures: Sequence[WrittenFigure],
    out_path: str | Path,
    explorer: ExplorerFile | None = None,
    pdf: Path | None = None,
    jumps: dict[str, Any] | None = None,
) -> Path:
    """Write the stability report: one HTML file with text, tables and the given figures; with ``pdf`` this file, too.

    Its links lead to the CSV files of the same folder, and a frame shows the page of the ``explorer`` there.
    ``jumps`` is what current phase jumps make (``phase_jumps`` in results.json).
    """
    from vsgdesign.report.stability.page import write_stability_page

    return write_stability_page(result, figures, Path(out_path), explorer, pdf, jumps)


def write_table_figures(table: GainTable, folder: str | Path) -> list[WrittenFigure]:
    """Draw every figure of a gain table into ``folder`` (made if missing), as SVG and as PNG (200 dpi)."""
    from vsgdesign.artifacts.measured_errors import shipped_errors
    from vsgdesign.report.drawing.files import write_all
    from vsgdesign.report.gain_table.page import table_figures

    return write_all(table_figures(table, shipped_errors()), folder)


def write_table_report(
    table: GainTable,
    figures: Sequence[WrittenFigure],
    out_path: str | Path,
    checked: TableCheck | None = None,
    live: StaticPage | None = None,
) -> Path:
    """Write the page of a gain table: one HTML file with text, tables and the given figures, in seven parts.

    ``checked``: what a check of its file found. ``live`` becomes the part on which one tries other grids and events.
    """
    from vsgdesign.report.gain_table.page import write_table_page

    return write_table_page(table, figures, Path(out_path), checked, live)


def write_comparison_figures(comparison: Comparison, folder: str | Path) -> list[WrittenFigure]:
    """Draw the figure of a comparison into ``folder`` (made if missing), as SVG and as PNG (200 dpi)."""
    from vsgdesign.report.comparison.page import comparison_figures
    from vsgdesign.report.drawing.files import write_all

    return write_all(comparison_figures(comparison), folder)


def write_comparison_report(comparison: Comparison, figures: Sequence[WrittenFigure], out_path: str | Path) -> Path:
    """Write the page of a comparison: one HTML file with text, tables and the given figures."""
    from vsgdesign.report.comparison.page import comparison_page
    from vsgdesign.report.page.html import print_html

    return print_html(comparison_page(comparison, figures), Path(out_path))


def write_verification_report(
    document: Mapping[str, Any], folder: str | Path, live: StaticPage | None = None
) -> list[Path]:
    """Write ``report.html`` and ``figures/`` of a verification into ``folder`` (made if missing).

    ``document`` is results.json of the verb ``verify``. The page's links lead to the study files of the worst cases,
    which the document names relative to the folder. ``live`` becomes the part on which one tries other grids and
    events. Returns every file that was written.
    """
    from vsgdesign.report.verification.page import write_verification_page

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return write_verification_page(document, folder, live)
