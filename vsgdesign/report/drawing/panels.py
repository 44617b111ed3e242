"""Maps over SCR and X/R: panels of cells on one colour scale, or each on a scale of its own; and counts as a table of
coloured cells.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.look import (
    MOST_VECTORS,
    Cells,
    Scale,
    colour_bar,
    draw_cells,
    legend_patches,
    round_numbers,
    scale_between,
)
from vsgdesign.report.drawing.quantities import DASH
from vsgdesign.report.drawing.style import COLOURS, PAGE_IN, add_axes, look, new_figure, text_width
from vsgdesign.report.drawing.time_axis import symbols

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_LEFT, _BOTTOM, _TOP = 0.5, 0.36, 0.22
_BAR, _BAR_GAP, _BAR_ROOM = 0.11, 0.12, 0.48
_BETWEEN_X, _BETWEEN_Y = 0.16, 0.3
_LEGEND_ROW = 0.17
_WIDEST = 2.9
_OWN_TOP, _OWN_BAR_ROOM, _OWN_BETWEEN, _OWN_GAP = 0.24, 0.8, 0.34, 0.3
"""Where each map has its own colour bar; the last is between its label and the numbers of the next axis."""


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


@look()
def map_figure(frame: Frame, rows: Sequence[Sequence[Panel]], scale: Scale) -> NamedFigure:
    """Panels in rows, one scale and one colour bar for all, axes labelled at the outer panels only."""
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


@dataclass(frozen=True, eq=False)
class Scaled:
    """What stands beside a map that has a colour scale of its own. ``label`` is that of its colour bar.

    ``values`` are all that the map shows: those beyond the scale are marked at the ends of the bar.
    """

    title: str
    label: str
    values: Array
    scale: Scale


def scaled_maps(
    panels: Sequence[Scaled],
    x_label: str,
    draw: Callable[[Any, int, float, float], None],
    entries: Sequence[tuple[Any, str]] = (),
) -> Figure:
    """Maps over SCR and X/R, two in a row, each with its own colour bar; ``entries`` of a legend below them.

    ``draw`` is given the axes of a map, its number, and the width and height of the axes (in).
    """
    width = (PAGE_IN - _LEFT - 2.0 * _OWN_BAR_ROOM - _OWN_GAP) / 2.0
    height = width * 0.56
    rows = -(-len(panels) // 2)
    below = _BOTTOM + (0.24 if entries else 0.0)
    total = below + rows * height + (rows - 1) * _OWN_BETWEEN + _OWN_TOP
    figure = new_figure(PAGE_IN if len(panels) > 1 else _LEFT + width + _OWN_BAR_ROOM, total)
    for k, panel in enumerate(panels):
        row, column = divmod(k, 2)
        left = _LEFT + column * (width + _OWN_BAR_ROOM + _OWN_GAP)
        bottom = below + (rows - 1 - row) * (height + _OWN_BETWEEN)
        axes = add_axes(figure, left, bottom, width, height)
        draw(axes, k, width, height)
        axes.set_title(panel.title)
        if column == 0:
            axes.set_ylabel("X/R [1]")
        if k + 2 >= len(panels):
            axes.set_xlabel(x_label)
        else:
            axes.tick_params(axis="x", which="both", labelbottom=False)
        known = panel.values[~np.isnan(panel.values)]
        beyond = (bool((known < panel.scale.low).any()), bool((known > panel.scale.high).any()))
        colour_bar(figure, (left + width + 0.08, bottom, 0.1, height), panel.scale, panel.label, beyond)
    if entries:
        figure.legend(
            *zip(*entries, strict=True),
            ncols=len(entries),
            loc="lower left",
            bbox_to_anchor=(_LEFT / float(figure.get_size_inches()[0]), 0.03 / total),
            handleheight=1.1,
            handlelength=1.6,
        )
    return figure


MOST = 4
"""Surfaces of one figure."""


@dataclass(frozen=True, eq=False)
class Surface:
    """One quantity over SCR and X/R. ``symbol`` may be a formula; ``key`` names what a pointer reads out."""

    title: str
    symbol: str
    unit: str
    values: Array
    key: str = ""


@look()
def surface_figure(
    named: tuple[str, str, str], scr: Array, x_over_r: Array, surfaces: Sequence[Surface], x_label: str, part: int
) -> NamedFigure:
    """Up to MOST surfaces, two in a row; ``named``: name, title and caption of the figure. NaN cells are crossed."""
    raster = len(surfaces) * len(scr) * len(x_over_r) > MOST_VECTORS
    nowhere = np.zeros((len(scr), len(x_over_r)), dtype=bool)
    panels = []
    for surface in surfaces:
        factor, power = _power_of(surface.values)
        values, label = surface.values / factor, f"{surface.symbol} [{power}{surface.unit}]"
        panels.append(Scaled(surface.title, label, values, surface_scale(values)))

    def draw(axes: Any, k: int, width: float, height: float) -> None:
        values = panels[k].values
        cells = Cells(x=scr, y=x_over_r, values=values, unstable=nowhere, missing=np.isnan(values), partial=nowhere)
        draw_cells(axes, cells, panels[k].scale, width, height, raster)
        if surfaces[k].key:
            axes.patch.set_gid(f"hover.{surfaces[k].key}")

    return NamedFigure(*named, scaled_maps(panels, x_label, draw), part)


def surface_scale(values: Array) -> Scale:
    """Logarithmic for values of one sign that vary; the ticks are round numbers within the values."""
    from matplotlib.ticker import MaxNLocator

    known = values[np.isfinite(values)]
    low, high = float(known.min()), float(known.max())
    scale = scale_between(low, high)
    if scale.ticks:
        return scale
    if scale.log:
        inside = round_numbers(low, high)
        return replace(scale, ticks=tuple(inside if len(inside) > 1 else np.geomspace(low, high, 4)))
    return replace(scale, ticks=tuple(float(t) for t in MaxNLocator(5).tick_values(low, high) if low <= t <= high))


def _power_of(values: Array) -> tuple[float, str]:
    """(factor, "10⁻⁴ ") that makes the numbers short; (1, "") if they are already short."""
    exponent = int(np.floor(np.log10(np.nanmax(np.abs(values)) or 1.0)))
    if -1 <= exponent <= 3:
        return 1.0, ""
    power = str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return 10.0**exponent, f"10{power} "


def groups(items: Sequence, most: int) -> list[Sequence]:
    """Items in as few groups of at most ``most`` as possible, about equally large."""
    count = -(-len(items) // most)
    if count == 0:
        return []
    size = -(-len(items) // count)
    return [items[first : first + size] for first in range(0, len(items), size)]


_ROW, _HEAD_ROOM, _FOOT_ROOM, _RIGHT = 0.2, 0.24, 0.1, 0.1
_LETTERS = 18
"""Of a line of a heading."""
_KEPT, _LOST, _NOTHING = "#CFE3F2", "#F6D2B8", "#EEEEEE"


@look()
def counts_figure(
    name: str, title: str, caption: str, rows: Mapping[str, Sequence[tuple[int, int]]], columns: Sequence[str]
) -> NamedFigure:
    """One row for each group, one column for each controller: (kept, judged). What is not all kept has another colour
    and a frame, so that it shows in grey print, too."""
    from matplotlib.patches import Rectangle

    heads = [fill(column, _LETTERS) for column in columns]
    lines = max((head.count("\n") + 1 for head in heads), default=1)
    top = _HEAD_ROOM + 0.12 * (lines - 1)
    left = 0.15 + max((text_width(row) for row in rows), default=0.0)
    width, height = PAGE_IN - left - _RIGHT, _ROW * max(len(rows), 1)
    figure = new_figure(PAGE_IN, _FOOT_ROOM + height + top)
    axes: Any = add_axes(figure, left, _FOOT_ROOM, width, height)
    for j, cells in enumerate(rows.values()):
        for k, (kept, judged) in enumerate(cells):
            colour = _NOTHING if not judged else _KEPT if kept == judged else _LOST
            edge: dict[str, Any] = {"edgecolor": COLOURS[1], "linewidth": 0.8} if kept < judged else {"linewidth": 0.0}
            axes.add_patch(Rectangle((k + 0.03, j + 0.06), 0.94, 0.88, facecolor=colour, **edge))
            said = f"{kept} of {judged}" if judged else DASH
            axes.text(k + 0.5, j + 0.52, said, ha="center", va="center")
    axes.set_xlim(0.0, max(len(columns), 1))
    axes.set_ylim(max(len(rows), 1), 0.0)
    axes.grid(False)
    axes.xaxis.tick_top()
    axes.set_xticks([k + 0.5 for k in range(len(columns))], heads)
    axes.set_yticks([j + 0.5 for j in range(len(rows))], list(rows))
    axes.tick_params(length=0.0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    return NamedFigure(name, title, caption, figure)
