"""Counts of what was kept, as a table of coloured cells with a number in each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

from vsgdesign.report.drawing.figure_types import NamedFigure
from vsgdesign.report.drawing.quantities import DASH
from vsgdesign.report.drawing.style import COLOURS, PAGE_IN, add_axes, look, new_figure, text_width

_ROW, _TOP, _BOTTOM, _RIGHT = 0.2, 0.24, 0.1, 0.1
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
    top = _TOP + 0.12 * (lines - 1)
    left = 0.15 + max((text_width(row) for row in rows), default=0.0)
    width, height = PAGE_IN - left - _RIGHT, _ROW * max(len(rows), 1)
    figure = new_figure(PAGE_IN, _BOTTOM + height + top)
    axes: Any = add_axes(figure, left, _BOTTOM, width, height)
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
