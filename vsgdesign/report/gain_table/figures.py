"""Every figure of a gain table, part by part."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.measured_errors import MeasuredErrors, shipped_errors
from vsgdesign.report.drawing.figure_types import NamedFigure, WrittenFigure
from vsgdesign.report.drawing.files import write_figure
from vsgdesign.report.gain_table.inside import inside_figure
from vsgdesign.report.gain_table.maps import gain_surfaces, margin_figures
from vsgdesign.report.gain_table.regions import certificate_figure, constraint_figures, stale_figures


def table_figures(table: GainTable, measured: MeasuredErrors | None = None) -> Iterator[NamedFigure]:
    """One at a time, in the order of the page. ``measured`` has the errors of an estimator, if they are known."""
    yield from margin_figures(table)
    yield from gain_surfaces(table)
    yield from constraint_figures(table)
    certified = certificate_figure(table)
    if certified is not None:
        yield certified
    inside = inside_figure(table, measured)
    if inside is not None:
        yield inside
    yield from stale_figures(table)


def write_all(table: GainTable, folder: Path) -> list[WrittenFigure]:
    """Write every figure into an existing folder."""
    return [write_figure(figure, folder) for figure in table_figures(table, shipped_errors())]
