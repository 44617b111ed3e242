"""Panels of cells on one colour scale: the frame that all maps share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsgdesign.report.drawing.look import MOST_VECTORS, Cells, Scale, colour_bar, draw_cells, legend_patches
from vsgdesign.report.drawing.style import PAGE_IN, add_axes, look, new_figure, text_width
from vsgdesign.report.drawing.time_axis import symbols
from vsgdesign.report.figure_types import NamedFigure

_LEFT, _BOTTOM, _TOP = 0.5, 0.36, 0.22
_BAR, _BAR_GAP, _BAR_ROOM = 0.11, 0.12, 0.48
_BETWEEN_X, _BETWEEN_Y = 0.16, 0.3
_LEGEND_ROW = 0.17
_WIDEST = 2.9


@dataclass(frozen=True)
class Panel:
    """One map of a figure. ``key`` names the cells that a pointer reads out; empty: none."""

    title: str
    cells: Cells
    key: str = ""


@dataclass(frozen=True)
class Frame:
    """What the panels of one figure share."""

    name: str
    title: str
    caption: str
    x_label: str
    y_label: str
    bar_label: str
    part: int
    aspect: float = 0.56
    """Height of a panel over its width."""
    gate_label: str | None = None
    missing_label: str = "not analysed: no operating point or no gains"
    """Why a cell may have no value."""


def map_figure(frame: Frame, rows: Sequence[Sequence[Panel]], scale: Scale) -> NamedFigure:
    """Panels in rows, one scale and one colour bar for all, axes labelled at the outer panels only."""
    with look():
        return _map_figure(frame, rows, scale)


def _map_figure(frame: Frame, rows: Sequence[Sequence[Panel]], scale: Scale) -> NamedFigure:
    columns = max(len(row) for row in rows)
    bar = _BAR_GAP + _BAR + _BAR_ROOM
    width = min((PAGE_IN - _LEFT - bar - 0.02 - _BETWEEN_X * (columns - 1)) / columns, _WIDEST)
    panel_height = width * frame.aspect
    panels = [panel for row in rows for panel in row]
    entries = legend_patches(
        any(p.cells.unstable.any() for p in panels),
        frame.missing_label if any(p.cells.missing.any() for p in panels) else None,
        any((p.cells.partial & ~p.cells.missing).any() for p in panels),
        frame.gate_label if scale.gate is not None else None,
        any(p.cells.outside is not None and (p.cells.outside & ~p.cells.missing).any() for p in panels),
    )
    total = _LEFT + columns * width + (columns - 1) * _BETWEEN_X + bar + 0.02
    room = sum(text_width(label.replace("$", "")) + 0.58 for _, label in entries)
    per_row = max(len(entries) if room < total - _LEFT else len(entries) // 2, 1)
    legend_rows = -(-len(entries) // per_row)
    below = _BOTTOM + (_LEGEND_ROW * legend_rows + 0.06 if entries else 0.0)
    inner = len(rows) * panel_height + (len(rows) - 1) * _BETWEEN_Y
    height = below + inner + _TOP
    figure = new_figure(total, height)
    raster = sum(p.cells.values.size for p in panels) > MOST_VECTORS
    values = np.concatenate([p.cells.values[~(p.cells.unstable | p.cells.missing)].ravel() for p in panels])
    values = values[~np.isnan(values)]
    for r, row in enumerate(rows):
        for c, panel in enumerate(row):
            bottom = below + (len(rows) - 1 - r) * (panel_height + _BETWEEN_Y)
            axes = add_axes(figure, _LEFT + c * (width + _BETWEEN_X), bottom, width, panel_height)
            draw_cells(axes, panel.cells, scale, width, panel_height, raster)
            axes.set_title(symbols(panel.title))
            if panel.key:
                axes.patch.set_gid(f"hover.{panel.key}")
            if c == 0:
                axes.set_ylabel(frame.y_label)
            else:
                axes.tick_params(axis="y", which="both", labelleft=False)
            lowest = r == len(rows) - 1 or c >= len(rows[r + 1])
            if lowest:
                axes.set_xlabel(frame.x_label)
            else:
                axes.tick_params(axis="x", which="both", labelbottom=False)
    left = _LEFT + columns * width + (columns - 1) * _BETWEEN_X + _BAR_GAP
    bar_height = min(inner, 3.2)
    place = (left, below + 0.5 * (inner - bar_height), _BAR, bar_height)
    beyond = (bool((values < scale.low).any()), bool((values > scale.high).any()))
    colour_bar(figure, place, scale, frame.bar_label, beyond)
    if entries:
        figure.legend(
            *zip(*entries, strict=True),
            ncols=min(per_row, len(entries)),
            loc="lower left",
            bbox_to_anchor=(_LEFT / total, 0.03 / height),
            handleheight=1.1,
        )
    return NamedFigure(frame.name, frame.title, frame.caption, figure, frame.part)


def groups(items: Sequence, most: int) -> list[Sequence]:
    """Items in as few groups of at most ``most`` as possible, about equally large."""
    count = -(-len(items) // most)
    if count == 0:
        return []
    size = -(-len(items) // count)
    return [items[first : first + size] for first in range(0, len(items), size)]
