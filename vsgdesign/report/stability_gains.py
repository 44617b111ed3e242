"""Scheduled gains over SCR and X/R, each on its own logarithmic colour scale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsgdesign.report.figure_types import NamedFigure
from vsgdesign.report.stability_look import Cells, Scale, colour_bar, draw_cells
from vsgdesign.report.style import PAGE_IN, add_axes, look, new_figure
from vsgdesign.report.tables import GAIN_UNITS
from vsgdesign.report.time_axis import symbols
from vsgdesign.simulation.stability_result import StabilityResult
from vsgdesign.stability.assessment import ControllerAssessment
from vsgdesign.stability.maps import MarginMap

_LEFT, _BOTTOM, _TOP, _BAR_ROOM, _BETWEEN = 0.5, 0.36, 0.22, 0.88, 0.32
_ASPECT = 0.56


def used_gains(field: MarginMap) -> list[str]:
    """Names of the gains that are not zero everywhere; the published structure's four always."""
    gains = field.cells.gains
    defaults = gains._field_defaults
    return [name for name in gains._fields if name not in defaults or np.any(np.nan_to_num(getattr(gains, name)) != 0)]


def gain_figure(result: StabilityResult, index: int, a: ControllerAssessment, baseline: str) -> NamedFigure | None:
    """A panel for every gain; None where no grid has gains."""
    if not np.isfinite(a.reduced.cells.gains.K_ip).any():
        return None
    with look():
        return _gain_figure(result, index, a, baseline)


def _gain_figure(result: StabilityResult, index: int, a: ControllerAssessment, baseline: str) -> NamedFigure:
    field = a.reduced
    width = (PAGE_IN - _LEFT - 2.0 * _BAR_ROOM - 0.12) / 2.0
    panel = width * _ASPECT
    names = used_gains(field)
    rows = -(-len(names) // 2)
    figure = new_figure(PAGE_IN, _BOTTOM + rows * panel + (rows - 1) * _BETWEEN + _TOP)
    shape = field.shape
    nowhere = np.zeros(shape[:2], dtype=bool)
    missing_any = False
    for k, name in enumerate(names):
        symbol = f"${name[0]}_{{{name[2:]}}}$"
        row, column = divmod(k, 2)
        values = np.reshape(getattr(field.cells.gains, name), shape)[:, :, 0]
        missing = np.isnan(values)
        missing_any |= bool(missing.any())
        cells = Cells(field.axes[0][1], field.axes[1][1], values, nowhere, missing, nowhere)
        scale = _gain_scale(values)
        left = _LEFT + column * (width + _BAR_ROOM + 0.1)
        bottom = _BOTTOM + (rows - 1 - row) * (panel + _BETWEEN)
        axes = add_axes(figure, left, bottom, width, panel)
        draw_cells(axes, replace(cells, values=np.where(missing, np.nan, values)), scale, width, panel)
        axes.patch.set_gid(f"hover.map.{index}.gains")
        axes.set_title(symbols(f"{a.spec.name}: ") + symbol)
        if column == 0:
            axes.set_ylabel("X/R [1]")
        if k + 2 >= len(names):
            axes.set_xlabel(f"SCR, {result.study.scr_basis} basis [1]")
        else:
            axes.tick_params(axis="x", which="both", labelbottom=False)
        colour_bar(
            figure, (left + width + 0.08, bottom, 0.1, panel), scale, f"{symbol} [{GAIN_UNITS[name]}]", (False, False)
        )
    note = " Crosses: no gains, as the design point does not exist on this grid." if missing_any else ""
    caption = (
        "How to read: the gains that the schedule gives each grid, one colour scale a gain, logarithmic where "
        "all values are positive. They belong to "
        f"the grid alone, whatever the operating point.{note}{baseline}"
    )
    return NamedFigure(f"map_gains_{index + 1}", f"Scheduled gains of {a.spec.name}", caption, figure, 3)


def _gain_scale(values: np.ndarray) -> Scale:
    known = values[np.isfinite(values)]
    if known.size == 0 or known.min() <= 0.0:
        low, high = (0.0, 1.0) if known.size == 0 else (float(known.min()), float(known.max()))
        return Scale(low, high if high > low else low + 1.0, ticks=tuple(np.linspace(low, high, 5)))
    low, high = float(known.min()), float(known.max())
    if high < 1.05 * low:
        low, high = low / 1.05, high * 1.05
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    ticks = [m * 10.0**d for d in decades for m in (1.0, 2.0, 5.0)]
    inside = [t for t in ticks if low <= t <= high]
    return Scale(low, high, log=True, ticks=tuple(inside if len(inside) > 1 else np.geomspace(low, high, 4)))
