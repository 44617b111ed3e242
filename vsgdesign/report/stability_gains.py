"""Scheduled gains over SCR and X/R, each on its own logarithmic colour scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from vsgdesign.report.figure_types import NamedFigure
from vsgdesign.report.stability_look import MOST_VECTORS, Cells, Scale, colour_bar, draw_cells
from vsgdesign.report.style import PAGE_IN, add_axes, look, new_figure
from vsgdesign.report.tables import GAIN_UNITS
from vsgdesign.report.time_axis import symbols
from vsgdesign.simulation.stability_result import StabilityResult
from vsgdesign.stability.assessment import ControllerAssessment
from vsgdesign.stability.maps import MarginMap

_LEFT, _BOTTOM, _TOP, _BAR_ROOM, _BETWEEN = 0.5, 0.36, 0.22, 0.8, 0.32
_ASPECT = 0.56


def used_gains(field: MarginMap) -> list[str]:
    """Names of the gains that are not zero everywhere; the published structure's four always."""
    gains = field.cells.gains
    defaults = gains._field_defaults
    return [name for name in gains._fields if name not in defaults or np.any(np.nan_to_num(getattr(gains, name)) != 0)]


def gain_figures(result: StabilityResult, index: int, a: ControllerAssessment, baseline: str) -> Iterator[NamedFigure]:
    """A panel for every gain, four a figure; nothing where no grid has gains."""
    if not np.isfinite(a.reduced.cells.gains.K_ip).any():
        return
    names = used_gains(a.reduced)
    for first in range(0, len(names), 4):
        name = f"map_gains_{index + 1}" + (f"_{first // 4 + 1}" if len(names) > 4 else "")
        with look():
            figure = _gain_figure(result, index, a, names[first : first + 4], name, baseline)
        yield figure


def _gain_figure(
    result: StabilityResult, index: int, a: ControllerAssessment, names: Sequence[str], figure_name: str, baseline: str
) -> NamedFigure:
    field = a.reduced
    width = (PAGE_IN - _LEFT - 2.0 * _BAR_ROOM - 0.12) / 2.0
    panel = width * _ASPECT
    rows = -(-len(names) // 2)
    figure = new_figure(PAGE_IN, _BOTTOM + rows * panel + (rows - 1) * _BETWEEN + _TOP)
    shape = field.shape
    raster = len(names) * shape[0] * shape[1] > MOST_VECTORS
    nowhere = np.zeros(shape[:2], dtype=bool)
    missing_any = False
    for k, name in enumerate(names):
        symbol = f"${name[0]}_{{{name[2:]}}}$"
        row, column = divmod(k, 2)
        values = np.reshape(getattr(field.cells.gains, name), shape)[:, :, 0]
        missing = np.isnan(values)
        missing_any |= bool(missing.any())
        factor, power = _power_of(values)
        values = values / factor
        cells = Cells(field.axes[0][1], field.axes[1][1], values, nowhere, missing, nowhere)
        scale = _gain_scale(values)
        left = _LEFT + column * (width + _BAR_ROOM + 0.1)
        bottom = _BOTTOM + (rows - 1 - row) * (panel + _BETWEEN)
        axes = add_axes(figure, left, bottom, width, panel)
        draw_cells(axes, cells, scale, width, panel, raster)
        axes.patch.set_gid(f"hover.map.{index}.gains.{name}")
        axes.set_title(symbols(f"{a.spec.name}: ") + symbol)
        if column == 0:
            axes.set_ylabel("X/R [1]")
        if k + 2 >= len(names):
            axes.set_xlabel(f"SCR, {result.study.scr_basis} basis [1]")
        else:
            axes.tick_params(axis="x", which="both", labelbottom=False)
        colour_bar(
            figure,
            (left + width + 0.08, bottom, 0.1, panel),
            scale,
            f"{symbol} [{power}{GAIN_UNITS[name]}]",
            (False, False),
        )
    note = " Crosses: no gains, as the design point does not exist on this grid." if missing_any else ""
    caption = (
        "How to read: the gains that the schedule gives each grid, one colour scale a gain, logarithmic where "
        "all values are positive. They belong to "
        f"the grid alone, whatever the operating point.{note}{baseline}"
    )
    return NamedFigure(figure_name, f"Scheduled gains of {a.spec.name}", caption, figure, 3)


def _gain_scale(values: np.ndarray) -> Scale:
    """Logarithmic for gains of one sign that vary; the ticks are round numbers within the values."""
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


def _power_of(values: np.ndarray) -> tuple[float, str]:
    """(factor, "10⁻⁴ ") that makes short numbers of the values; (1, "") where they are short already."""
    exponent = int(np.floor(np.log10(np.nanmax(np.abs(values)) or 1.0)))
    if -1 <= exponent <= 3:
        return 1.0, ""
    power = str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return 10.0**exponent, f"10{power} "
