"""Every figure of a stability assessment, part by part."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from vsgdesign.report.drawing.figure_types import NamedFigure, WrittenFigure
from vsgdesign.report.drawing.files import write_figure
from vsgdesign.report.stability.frequency import frequency_figures
from vsgdesign.report.stability.maps import map_figures
from vsgdesign.report.stability.modes import mode_figures
from vsgdesign.report.stability.schedule import schedule_figures
from vsgdesign.report.stability.steps import step_figures
from vsgdesign.simulation.stability_result import StabilityResult


def stability_figures(result: StabilityResult) -> Iterator[NamedFigure]:
    """One at a time, in the order of the report."""
    yield from map_figures(result)
    yield from schedule_figures(result)
    yield from mode_figures(result)
    yield from frequency_figures(result)
    yield from step_figures(result)


def write_all(result: StabilityResult, folder: Path) -> list[WrittenFigure]:
    """Write every figure into an existing folder."""
    return [write_figure(figure, folder) for figure in stability_figures(result)]
