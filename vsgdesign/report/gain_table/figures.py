"""Every figure of a gain table, part by part."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.report.drawing.files import write_figure
from vsgdesign.report.figure_types import NamedFigure, WrittenFigure
from vsgdesign.report.gain_table.maps import gain_surfaces, margin_figures
from vsgdesign.report.gain_table.regions import certificate_figure, constraint_figures, stale_figures


def table_figures(table: GainTable) -> Iterator[NamedFigure]:
    """One at a time, in the order of the page."""
    yield from margin_figures(table)
    yield from gain_surfaces(table)
    yield from constraint_figures(table)
    certified = certificate_figure(table)
    if certified is not None:
        yield certified
    yield from stale_figures(table)


def write_all(table: GainTable, folder: Path) -> list[WrittenFigure]:
    """Write every figure into an existing folder."""
    return [write_figure(figure, folder) for figure in table_figures(table)]
