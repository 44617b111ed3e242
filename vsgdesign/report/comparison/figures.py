"""The figure of a comparison: on which grids each contender keeps its promises."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from vsgdesign.artifacts.definitions import ASKED
from vsgdesign.design.comparison import STATES, Compared, Comparison
from vsgdesign.report.comparison.tables import bounds_inertia, error_of, inertia_asked, label, share
from vsgdesign.report.drawing.figure_types import NamedFigure
from vsgdesign.report.drawing.look import NO_POINT
from vsgdesign.report.drawing.quantities import plain
from vsgdesign.report.drawing.style import COLUMN_IN, TEXT_PT, add_axes, look, new_figure

LOOKS: dict[str, dict[str, Any]] = {
    "kept": {"facecolor": "#0072B2"},
    "kept_exact": {"facecolor": "#9AD0F0"},
    "broken": {"facecolor": "#F3D9A4"},
    "unstable": {"facecolor": "#8C3A00", "edgecolor": "#F6E3D5", "hatch": "//////"},
}
"""Dark and light blue, light and dark orange. All eyes can tell them apart, and the hatched one also in grey print."""

_ROW = 3
_LEFT, _RIGHT, _TOP, _BETWEEN_X, _BETWEEN_Y = 0.4, 0.04, 0.27, 0.1, 0.31
_AXIS, _LEGEND_ROW = 0.34, 0.155


def comparison_figures(comparison: Comparison) -> Iterator[NamedFigure]:
    """A map of the grids on which the requirements are kept, with one small panel for each contender."""
    yield _promises(comparison)


@look()
def _promises(comparison: Comparison) -> NamedFigure:
    from matplotlib.patches import Patch

    rows = math.ceil(len(comparison.contenders) / _ROW)
    width = (COLUMN_IN - _LEFT - _RIGHT - (_ROW - 1) * _BETWEEN_X) / _ROW
    height = 0.85 * width
    names = (
        "kept, wrong estimate too",
        "kept, exact estimate only",
        "not kept",
        "unstable, or no gains",
    )
    entries = [Patch(linewidth=0.0, **LOOKS[state]) for state in STATES]
    if comparison.outside:
        entries.append(Patch(**NO_POINT))
        names = (*names, "nothing is asked")
    below = _AXIS + _LEGEND_ROW * math.ceil(len(entries) / 2) + 0.06
    total = below + rows * height + (rows - 1) * _BETWEEN_Y + _TOP
    figure = new_figure(COLUMN_IN, total)
    for k, compared in enumerate(comparison.contenders):
        row, column = divmod(k, _ROW)
        place = (_LEFT + column * (width + _BETWEEN_X), below + (rows - 1 - row) * (height + _BETWEEN_Y))
        axes = add_axes(figure, *place, width, height)
        _panel(axes, comparison, compared)
        lowest = k + _ROW >= len(comparison.contenders)
        axes.tick_params(labelbottom=lowest, labelleft=column == 0)
        if lowest:
            axes.set_xlabel("X/R")
        if column == 0:
            axes.set_ylabel("SCR")
    figure.legend(
        entries,
        names,
        ncols=2,
        loc="lower left",
        bbox_to_anchor=(_LEFT / COLUMN_IN, 0.02 / total),
        handleheight=1.0,
        handlelength=1.4,
        columnspacing=1.0,
    )
    spec = comparison.specification
    caption = (
        f"Each cell is a grid, with the worst of its powers: overshoot ≤ {plain(100.0 * spec.overshoot)} %, settling ≤ "
        f"{plain(spec.settling_time)} s, {ASKED['disk_margin']} ≥ {plain(spec.disk_margin)}, "
        f"{ASKED['damping_ratio']} ≥ {plain(spec.damping_ratio)}{_inertia(comparison)}, kept with the real "
        "inner loops (full-order model) and with ideal ones. Percentages: grids kept with the estimate exact, and "
        f"wrong by {error_of(comparison)}."
    )
    return NamedFigure("promises", "Grids on which the requirements are kept", caption, figure)


def _inertia(comparison: Comparison) -> str:
    return f", {inertia_asked(comparison)}" if bounds_inertia(comparison) else ""


def _panel(axes: Any, comparison: Comparison, compared: Compared) -> None:
    """The cells of one contender. The axes count nodes, so that every grid has the same space."""
    from matplotlib.patches import Rectangle

    states = {(grid.scr, grid.x_over_r): grid.state for grid in compared.grids}
    for i, scr in enumerate(comparison.scr):
        for j, ratio in enumerate(comparison.x_over_r):
            style = LOOKS[states[scr, ratio]] if (scr, ratio) in states else NO_POINT
            axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1.0, 1.0, linewidth=0.0, **style))
    axes.set_xlim(-0.5, len(comparison.x_over_r) - 0.5)
    axes.set_ylim(-0.5, len(comparison.scr) - 0.5)
    axes.grid(False)
    for set_ticks, values in ((axes.set_xticks, comparison.x_over_r), (axes.set_yticks, comparison.scr)):
        last = len(values) - 1
        at = np.unique(np.linspace(0, last, 3 if last < 6 else 4).round().astype(int))
        set_ticks(at, [plain(values[k], 2) for k in at])
    axes.set_title(label(compared.contender.name), pad=9.0)
    axes.text(
        0.0,
        1.025,
        f"{share(compared.share('kept', 'kept_exact'))} %, {share(compared.share('kept'))} %",
        transform=axes.transAxes,
        fontsize=TEXT_PT - 1.0,
        color="#444444",
        va="bottom",
    )
