"""Maps that each have a colour scale of their own: gains, which share no unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.report.drawing.look import MOST_VECTORS, Cells, Scale, colour_bar, draw_cells
from vsgdesign.report.drawing.style import PAGE_IN, add_axes, look, new_figure
from vsgdesign.report.figure_types import NamedFigure

Array = NDArray[np.float64]

_LEFT, _BOTTOM, _TOP, _BAR_ROOM, _BETWEEN = 0.5, 0.36, 0.22, 0.8, 0.32
_GAP = 0.3
"""Between the label of a colour bar and the numbers of the next axis."""
_ASPECT = 0.56

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


def surface_figure(
    named: tuple[str, str, str], scr: Array, x_over_r: Array, surfaces: Sequence[Surface], x_label: str, part: int
) -> NamedFigure:
    """Up to MOST surfaces, two in a row; ``named``: name, title and caption of the figure. NaN cells are crossed."""
    with look():
        return _draw(named, scr, x_over_r, surfaces, x_label, part)


def _draw(
    named: tuple[str, str, str], scr: Array, x_over_r: Array, surfaces: Sequence[Surface], x_label: str, part: int
) -> NamedFigure:
    width = (PAGE_IN - _LEFT - 2.0 * _BAR_ROOM - _GAP) / 2.0
    panel = width * _ASPECT
    rows = -(-len(surfaces) // 2)
    figure = new_figure(PAGE_IN, _BOTTOM + rows * panel + (rows - 1) * _BETWEEN + _TOP)
    raster = len(surfaces) * len(scr) * len(x_over_r) > MOST_VECTORS
    nowhere = np.zeros((len(scr), len(x_over_r)), dtype=bool)
    for k, surface in enumerate(surfaces):
        row, column = divmod(k, 2)
        factor, power = _power_of(surface.values)
        values = surface.values / factor
        scale = surface_scale(values)
        left = _LEFT + column * (width + _BAR_ROOM + _GAP)
        bottom = _BOTTOM + (rows - 1 - row) * (panel + _BETWEEN)
        axes = add_axes(figure, left, bottom, width, panel)
        cells = Cells(x=scr, y=x_over_r, values=values, unstable=nowhere, missing=np.isnan(values), partial=nowhere)
        draw_cells(axes, cells, scale, width, panel, raster)
        if surface.key:
            axes.patch.set_gid(f"hover.{surface.key}")
        axes.set_title(surface.title)
        if column == 0:
            axes.set_ylabel("X/R [1]")
        if k + 2 >= len(surfaces):
            axes.set_xlabel(x_label)
        else:
            axes.tick_params(axis="x", which="both", labelbottom=False)
        place = (left + width + 0.08, bottom, 0.1, panel)
        colour_bar(figure, place, scale, f"{surface.symbol} [{power}{surface.unit}]", (False, False))
    name, title, caption = named
    return NamedFigure(name, title, caption, figure, part)


def surface_scale(values: Array) -> Scale:
    """Logarithmic for values of one sign that vary; the ticks are round numbers within the values."""
    from matplotlib.ticker import MaxNLocator

    known = values[np.isfinite(values)]
    low, high = float(known.min()), float(known.max())
    if high - low <= 1e-6 * max(abs(low), abs(high)):
        room = 0.05 * abs(low) or 1.0
        return Scale(low - room, high + room, ticks=(low,))
    if low > 0.0 and high > 4.0 * low:
        decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
        round_numbers = [m * 10.0**d for d in decades for m in (1.0, 2.0, 5.0)]
        inside = [t for t in round_numbers if low <= t <= high]
        return Scale(low, high, log=True, ticks=tuple(inside if len(inside) > 1 else np.geomspace(low, high, 4)))
    inside = [float(t) for t in MaxNLocator(5).tick_values(low, high) if low <= t <= high]
    return Scale(low, high, ticks=tuple(inside))


def _power_of(values: Array) -> tuple[float, str]:
    """(factor, "10⁻⁴ ") that makes the numbers short; (1, "") if they are already short."""
    exponent = int(np.floor(np.log10(np.nanmax(np.abs(values)) or 1.0)))
    if -1 <= exponent <= 3:
        return 1.0, ""
    power = str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return 10.0**exponent, f"10{power} "
