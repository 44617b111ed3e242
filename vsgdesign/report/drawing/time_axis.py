"""Time axes of any length, and events marked on them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from vsgdesign.report.drawing.style import EVENT_LINE, NOTE_COLOUR, TEXT_PT, text_width
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
