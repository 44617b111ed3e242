"""Figures over the time of a run: axes of any length with events marked on them, rows of signals over the whole run,
enlarged parts of the first one below, and long signals reduced to what a figure shows of them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.style import (
    EVENT_LINE,
    NOTE_COLOUR,
    PAGE_IN,
    TEXT_PT,
    ZOOM_SPAN,
    add_axes,
    new_figure,
    text_width,
)
from vsgdesign.study.parameters.study import Event

LABEL_ROW_IN = 0.125
"""Height of one row of event labels."""

_MOST_ROWS = 3
_LONGEST_NAME = 24
_SYMBOL = re.compile(r"\b([PQVf])_(ref|g)\b")


@dataclass(frozen=True)
class TimeUnit:
    """What times are divided by for an axis, and the unit's symbol."""

    seconds: float
    symbol: str


def time_unit(span_s: float) -> TimeUnit:
    """Milliseconds for short spans, minutes from ten minutes on."""
    if span_s < 0.5:
        return TimeUnit(1e-3, "ms")
    return TimeUnit(1.0, "s") if span_s <= 600.0 else TimeUnit(60.0, "min")


def symbols(text: str) -> str:
    """Plain text for matplotlib: quantities as mathematical symbols, everything else literally."""
    return _SYMBOL.sub(r"$\1_\\mathrm{\2}$", text.replace("$", r"\$"))


def short_name(event: Event) -> str:
    """An event's name, cut where it is too long for a figure."""
    return event.name if len(event.name) <= _LONGEST_NAME else event.name[: _LONGEST_NAME - 1].rstrip(" ,") + "…"


@dataclass(frozen=True)
class EventLabel:
    """One label above the axes: at ``x_in`` inches from their left edge, in ``row`` (0 is lowest)."""

    t_s: float
    text: str
    x_in: float
    row: int
    align: str


@dataclass(frozen=True)
class EventLabels:
    """All labels of one figure. ``numbered``: there was no space for names, and numbers are used instead."""

    labels: tuple[EventLabel, ...]
    rows: int
    numbered: bool

    @property
    def height_in(self) -> float:
        """Space that the labels need above the axes."""
        return LABEL_ROW_IN * self.rows


def event_labels(events: Sequence[tuple[float, str]], duration_s: float, width_in: float) -> EventLabels:
    """Labels (time, text) placed without overlap; numbers if there is no space for the names."""
    placed = _place(events, duration_s, width_in)
    if len(placed) == len(events):
        return _labels(placed, numbered=False)
    numbers = [(t_s, str(index + 1)) for index, (t_s, _) in enumerate(events)]
    return _labels(_place(numbers, duration_s, width_in), numbered=True)


def _labels(placed: list[EventLabel], numbered: bool) -> EventLabels:
    return EventLabels(tuple(placed), 1 + max((label.row for label in placed), default=-1), numbered)


def _place(events: Sequence[tuple[float, str]], duration_s: float, width_in: float) -> list[EventLabel]:
    """Greedy: each label goes to the lowest row where it is free; one that fits nowhere is left out."""
    ends = [float("-inf")] * _MOST_ROWS
    placed = []
    for t_s, text in events:
        x_in = t_s / duration_s * width_in
        # Labels start at their event; one that would leave the axes ends there.
        length = text_width(text) + 0.06
        fits = x_in + length <= width_in + 0.05
        begin, end = (x_in, x_in + length) if fits else (x_in - length, x_in)
        row = next((row for row, taken in enumerate(ends) if begin >= taken), None)
        if row is None or (not fits and begin < -0.4):
            continue
        ends[row] = end
        placed.append(EventLabel(t_s, text, x_in, row, "left" if fits else "right"))
    return placed


def mark_events(axes: Any, times_s: Sequence[float], unit: TimeUnit) -> None:
    """A thin dotted line at each event."""
    for t_s in dict.fromkeys(times_s):
        axes.axvline(t_s / unit.seconds, **EVENT_LINE)


def draw_labels(axes: Any, labels: EventLabels, unit: TimeUnit) -> None:
    """The labels above the axes."""
    for label in labels.labels:
        axes.annotate(
            symbols(label.text),
            (label.t_s / unit.seconds, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0.0, 2.5 + label.row * LABEL_ROW_IN * 72.0),
            textcoords="offset points",
            ha=label.align,
            va="bottom",
            fontsize=TEXT_PT,
            color=NOTE_COLOUR,
            annotation_clip=False,
        )


def whole_scenario(axes: Any, duration_s: float, unit: TimeUnit, label: bool = True) -> None:
    """Limits and label of a time axis over the whole run."""
    axes.set_xlim(0.0, duration_s / unit.seconds)
    if label:
        axes.set_xlabel(f"Time [{unit.symbol}]")
    else:
        axes.tick_params(labelbottom=False)


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


Array = NDArray[np.float64]


def extreme_indices(y: Array, columns: int) -> NDArray[np.intp]:
    """Sorted indices of at most about 4·columns samples that draw the same line on that many pixel columns.

    Of each column the first, smallest, largest and last sample: the line cannot be told from the full one, and
    no extreme is lost.
    """
    n = len(y)
    size = -(-n // max(columns, 1))
    if size <= 4:
        return np.arange(n)
    whole = n // size * size
    blocks = y[:whole].reshape(-1, size)
    starts = np.arange(0, whole, size)
    picks = [starts, starts + np.argmin(blocks, axis=1), starts + np.argmax(blocks, axis=1), starts + size - 1]
    if whole < n:
        rest = y[whole:]
        picks.append(np.array([whole, whole + int(np.argmin(rest)), whole + int(np.argmax(rest)), n - 1]))
    return np.unique(np.concatenate(picks))


def envelope(t: Array, y: Array, columns: int) -> tuple[Array, Array, Array]:
    """(t, smallest, largest) of each of at most ``columns`` blocks; t spans the whole signal."""
    n = len(y)
    size = max(-(-n // max(columns, 1)), 1)
    starts = np.arange(0, n, size)
    middles = 0.5 * (t[starts] + t[np.minimum(starts + size, n) - 1])
    # The polygon must reach both ends of the axis.
    middles[0], middles[-1] = t[0], t[-1]
    return middles, np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)


def ripple_level(y: Array, mean: Array) -> float:
    """Typical distance of a signal from its mean over whole cycles, in the signal's unit.

    The median over the whole run: transients, during which the mean lags, do not count.
    """
    step = max(len(y) // 20_000, 1)
    return float(np.median(np.abs(y[::step] - mean[::step])))


@dataclass(frozen=True)
class Trace:
    """One signal of one controller: instantaneous and its mean over the preceding cycle."""

    t: Array
    y: Array
    mean: Array
    ripple: float
    """Typical distance between the two; zero for an averaged bridge, which has no ripple to remove."""
    broken: bool = False
    """Whether the simulation diverged, so that the signal ends early."""

    def between(self, begin_s: float, end_s: float) -> Trace:
        """The part within a stretch of time, both ends included."""
        slack = 0.5 * (self.t[1] - self.t[0]) if len(self.t) > 1 else 0.0
        first, last = np.searchsorted(self.t, [begin_s - slack, end_s + slack])
        return Trace(self.t[first:last], self.y[first:last], self.mean[first:last], self.ripple, self.broken)
