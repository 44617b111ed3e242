"""The look of every figure, in one place. matplotlib is loaded where a figure is drawn, not with this module."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMN_IN = 3.5
"""Width of a journal column."""

PAGE_IN = 7.16
"""Width of a journal page of two columns."""

TEXT_PT = 7.0
LABEL_PT = 8.0

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#777777")
"""Okabe and Ito's colour-blind-safe palette (with grey instead of its yellow, which is hard to see on white paper)."""

DASHES: tuple[Any, ...] = (
    "-",
    (0, (5, 1.2)),
    (0, (5, 1.2, 1.2, 1.2)),
    (0, (1.3, 1.1)),
    (0, (8, 1.5)),
    (0, (5, 1, 1, 1, 1, 1)),
    (0, (2.5, 1)),
    (0, (9, 1.5, 2, 1.5)),
)
"""A line style for each colour, so that the curves can be told apart in grey print."""

REFERENCE: dict[str, Any] = {"color": "#222222", "linestyle": (0, (2.2, 1.6)), "linewidth": 0.7, "zorder": 2.2}
EVENT_LINE: dict[str, Any] = {"color": "#9A9A9A", "linestyle": (0, (1, 2)), "linewidth": 0.6, "zorder": 1.1}
BAND: dict[str, Any] = {"color": "#BDBDBD", "alpha": 0.45, "linewidth": 0.0, "zorder": 0.6}
LIMITS_BAND: dict[str, Any] = {"facecolor": "#DDEFE8", "edgecolor": "#5B8C7B", "linewidth": 0.6, "zorder": 0.3}
ZOOM_SPAN: dict[str, Any] = {"color": "#8A8A8A", "linewidth": 0.0, "zorder": 2.1}
NOTE_COLOUR = "#444444"

_LOOK: dict[str, Any] = {
    # DejaVu Sans comes with matplotlib, so the layout is the same on every machine.
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "mathtext.fontset": "dejavusans",
    "mathtext.default": "it",
    "font.size": TEXT_PT,
    "axes.labelsize": LABEL_PT,
    "axes.titlesize": TEXT_PT,
    "xtick.labelsize": TEXT_PT,
    "ytick.labelsize": TEXT_PT,
    "legend.fontsize": TEXT_PT,
    "axes.linewidth": 0.6,
    "axes.edgecolor": "#333333",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.labelpad": 2.5,
    "axes.titlepad": 3.0,
    "axes.titlelocation": "left",
    # Where a title goes anyway; to be told so spares matplotlib a search that costs a fifth of its time.
    "axes.titley": 1.0,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-4, 5),
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.0,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.minor.size": 1.5,
    "ytick.minor.size": 1.5,
    "xtick.major.width": 0.5,
    "ytick.major.width": 0.5,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "legend.frameon": False,
    "legend.handlelength": 2.8,
    "legend.borderaxespad": 0.0,
    "legend.borderpad": 0.0,
    "legend.columnspacing": 1.6,
    "legend.labelspacing": 0.25,
    "svg.fonttype": "none",
    "svg.hashsalt": "vsgdesign",
    "savefig.dpi": 200,
}


@contextmanager
def look() -> Iterator[None]:
    """Settings for building and for saving figures. A user's own matplotlibrc has no effect inside."""
    import matplotlib

    from vsgdesign.report.drawing.ticks import formulas_kept

    with matplotlib.rc_context(_settings()), formulas_kept():
        yield


@functools.cache
def _settings() -> Any:
    import matplotlib

    # What belongs to the session rather than to the look is left alone.
    session = ("backend", "interactive", "toolbar", "timezone", "tk.", "webagg", "docstring", "keymap", "figure.hooks")
    defaults = {key: value for key, value in matplotlib.rcParamsDefault.items() if not key.startswith(session)}
    return {**defaults, **_LOOK}


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure on its own canvas, outside pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in))
    FigureCanvasAgg(figure)
    return figure


def add_axes(figure: Figure, left: float, bottom: float, width: float, height: float, **kwargs: Any) -> Any:
    """Axes at a place in inches from the lower left corner."""
    figure_width, figure_height = (float(size) for size in figure.get_size_inches())
    place = (left / figure_width, bottom / figure_height, width / figure_width, height / figure_height)
    return figure.add_axes(place, **kwargs)


def line_style(index: int) -> dict[str, Any]:
    """Colour and dashes of the curve with this index."""
    # The second round through the colours shifts the dashes, so that no two of 64 curves are alike.
    dash = DASHES[(index + index // len(COLOURS)) % len(DASHES)]
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": dash}


def text_width(text: str, size_pt: float = TEXT_PT) -> float:
    """Rough width of plain text in inches, on the safe side."""
    return 0.54 * size_pt / 72.0 * len(text)
