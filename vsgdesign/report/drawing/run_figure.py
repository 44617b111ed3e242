"""A figure over the time of a run: rows of signals over the whole run, and enlarged parts of the first one below."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from vsgdesign.report.drawing.figure_types import NamedFigure
from vsgdesign.report.drawing.style import PAGE_IN, ZOOM_SPAN, add_axes, new_figure, text_width
from vsgdesign.report.drawing.time_axis import (
    TimeUnit,
    draw_labels,
    event_labels,
    mark_events,
    short_name,
    symbols,
    time_unit,
    whole_scenario,
)
from vsgdesign.study.parameters.study import Event

LETTERS = "abcdefgh"
"""What ties an enlarged part to its event above the whole run."""

_LEFT, _RIGHT, _RIGHT_WITH_SECOND, _BOTTOM = 0.6, 0.13, 0.52, 0.36
_ONE_ROW, _OF_SEVERAL, _BETWEEN_ROWS = 1.75, 1.1, 0.12
_ZOOM_HEIGHT, _ABOVE_ZOOM, _BESIDE_ZOOM = 1.2, 0.54, 0.47
_LABEL_IN = 0.46
"""From the axes to the labels of rows below each other, so that they stand in one line."""


@dataclass(frozen=True)
class Zoom:
    """A stretch of a run that is enlarged. Its axis counts from ``event_s``; None: as that of the run."""

    begin_s: float
    end_s: float
    title: str
    event_s: float | None = None


@dataclass(frozen=True)
class View:
    """The time axis of one panel. ``zoom`` is None where the panel shows the whole run."""

    begin_s: float
    end_s: float
    origin_s: float
    unit: TimeUnit
    width_in: float
    zoom: Zoom | None = None

    def place(self, t_s: Any) -> Any:
        """Instants of the run, s, on this axis."""
        return (t_s - self.origin_s) / self.unit.seconds


@dataclass(frozen=True)
class Row:
    """One signal: ``draw`` draws the curves on given axes and sets the vertical scale."""

    label: str
    draw: Callable[[Any, View], None]
    short_label: str = ""
    """For the lower axes of an enlarged part; empty: ``label``."""
    second_axis: Callable[[Any], None] | None = None
    """Draws an axis on the right of the whole run."""


@dataclass(frozen=True, kw_only=True)
class RunFigure:
    """What a figure over a run contains. The columns stand side by side, each with its rows from the top down."""

    name: str
    title: str
    caption: str
    duration_s: float
    events: Sequence[Event]
    columns: Sequence[Sequence[Row]]
    zooms: Sequence[Sequence[Zoom]] = ()
    """Enlarged parts of the first row, in rows below the whole run."""
    entries: Sequence[tuple[Any, str]] = ()
    """(handle, text) of the legend."""
    width_in: float = PAGE_IN
    numbers: str = "events as numbered in the study"
    """What numbers stand for where names of events have no room."""


def run_figure(asked: RunFigure) -> NamedFigure:
    """Lay the figure out and draw it. To be called within :func:`~vsgdesign.report.drawing.style.look`."""
    second = any(row.second_axis is not None for rows in asked.columns for row in rows)
    right = _RIGHT_WITH_SECOND if second else _RIGHT
    count = len(asked.columns)
    inner = asked.width_in - _LEFT - right
    width = (inner - (count - 1) * (_LEFT + _RIGHT)) / count
    zooms = [row for row in asked.zooms if row]
    letters = dict(zip([zoom.event_s for row in zooms for zoom in row], LETTERS, strict=False))
    named = [
        (e.t_s, f"({letters[e.t_s]}) {short_name(e)}" if e.t_s in letters else short_name(e)) for e in asked.events
    ]
    labels = event_labels(named, asked.duration_s, width)
    most = max(len(rows) for rows in asked.columns)
    row_height = _ONE_ROW if most == 1 else _OF_SEVERAL
    below = _BOTTOM + len(zooms) * (_ZOOM_HEIGHT + _ABOVE_ZOOM)
    inner_height = most * row_height + (most - 1) * _BETWEEN_ROWS
    height = below + inner_height + labels.height_in + legend_height([text for _, text in asked.entries], inner)
    figure = new_figure(asked.width_in, height)
    unit = time_unit(asked.duration_s)
    for number, rows in enumerate(asked.columns):
        left = _LEFT + number * (width + _LEFT + _RIGHT)
        for k, row in enumerate(rows):
            bottom = below + (most - 1 - k) * (row_height + _BETWEEN_ROWS)
            axes = add_axes(figure, left, bottom, width, row_height)
            row.draw(axes, View(0.0, asked.duration_s, 0.0, unit, width))
            mark_events(axes, [event.t_s for event in asked.events], unit)
            whole_scenario(axes, asked.duration_s, unit, label=k == len(rows) - 1)
            axes.set_ylabel(row.label)
            if row.second_axis is not None:
                row.second_axis(axes)
            if len(rows) > 1:
                axes.yaxis.set_label_coords(-_LABEL_IN / width, 0.5)
            if k == 0:
                draw_labels(axes, labels, unit)
            if k == len(rows) - 1:
                for zoom in (zoom for zoomed in zooms for zoom in zoomed):
                    axes.axvspan(zoom.begin_s / unit.seconds, zoom.end_s / unit.seconds, ymax=0.03, **ZOOM_SPAN)
    rest = iter(LETTERS)
    for k, zoomed in enumerate(zooms):
        bottom = _BOTTOM + (len(zooms) - 1 - k) * (_ZOOM_HEIGHT + _ABOVE_ZOOM)
        panel = (inner - _BESIDE_ZOOM * (len(zoomed) - 1)) / len(zoomed)
        for column, zoom in enumerate(zoomed):
            axes = add_axes(figure, _LEFT + column * (panel + _BESIDE_ZOOM), bottom, panel, _ZOOM_HEIGHT)
            _draw_zoom(axes, asked.columns[0][0], zoom, next(rest), unit, panel)
            axes.set_ylabel("" if column else asked.columns[0][0].short_label or asked.columns[0][0].label)
    legend(figure, asked.entries, inner)
    caption = asked.caption + (f" Numbers above the axes: {asked.numbers}." if labels.numbered else "")
    return NamedFigure(asked.name, asked.title, caption, figure)


def _draw_zoom(axes: Any, row: Row, zoom: Zoom, letter: str, unit: TimeUnit, width_in: float) -> None:
    origin = 0.0 if zoom.event_s is None else zoom.event_s
    if zoom.event_s is not None:
        unit = time_unit(zoom.end_s - zoom.event_s)
        mark_events(axes, [0.0], unit)
    view = View(zoom.begin_s, zoom.end_s, origin, unit, width_in, zoom)
    row.draw(axes, view)
    axes.set_xlim(view.place(zoom.begin_s), view.place(zoom.end_s))
    axes.set_xlabel(f"Time{'' if zoom.event_s is None else ' after event'} [{unit.symbol}]")
    axes.set_title(symbols(_fitting(f"({letter}) {zoom.title}", width_in)))
    axes.locator_params(axis="x", nbins=min(max(int(width_in / 0.3), 2), 7))
    if axes.get_yscale() == "linear":
        axes.locator_params(axis="y", nbins=5)


def _fitting(text: str, width_in: float) -> str:
    room = max(int((width_in + 0.3) / text_width("x")), 6)
    return text if len(text) <= room else text[: room - 1] + "…"


def legend_height(texts: Sequence[str], width_in: float) -> float:
    """Room above the axes for a legend of these texts, in."""
    return 0.12 + (0.15 * -(-len(texts) // _legend_columns(texts, width_in)) if texts else 0.0)


def legend(figure: Any, entries: Sequence[tuple[Any, str]], width_in: float) -> None:
    """A legend in the upper left corner of a figure, in as many columns as the width has room for."""
    if entries:
        width, height = (float(size) for size in figure.get_size_inches())
        figure.legend(
            *zip(*entries, strict=True),
            ncols=_legend_columns([text for _, text in entries], width_in),
            loc="upper left",
            bbox_to_anchor=(_LEFT / width, 1.0 - 0.04 / height),
        )


def _legend_columns(texts: Sequence[str], width_in: float) -> int:
    widest = max(text_width(text) for text in texts) + 0.55
    return max(min(int(width_in / widest), len(texts)), 1)
