"""Scheduled gains over SCR and X/R, each on its own logarithmic colour scale."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.stability.assessment import ControllerAssessment
from vsgdesign.report.drawing.figure_types import NamedFigure
from vsgdesign.report.drawing.panels import MOST, Surface, surface_figure
from vsgdesign.report.drawing.quantities import GAIN_UNITS, plain
from vsgdesign.report.drawing.time_axis import symbols
from vsgdesign.runtime.of_study import follows_measured
from vsgdesign.simulation.stability_result import StabilityResult

PART = 3


def used_gains(gains: PowerLoopGains) -> list[str]:
    """Names of the gains that are not zero everywhere; the published structure's four always."""
    defaults = gains._field_defaults
    return [name for name in gains._fields if name not in defaults or np.any(np.nan_to_num(getattr(gains, name)) != 0)]


def gain_symbol(name: str) -> str:
    """K_ip as a formula."""
    return f"${name[0]}_{{{name[2:]}}}$"


def gain_figures(result: StabilityResult, index: int, a: ControllerAssessment, baseline: str) -> Iterator[NamedFigure]:
    """A panel for every gain, four a figure; nothing where no grid has gains."""
    field = a.reduced
    gains = PowerLoopGains(*(np.reshape(value, field.shape)[:, :, 0] for value in field.cells.gains))
    if not np.isfinite(gains.K_ip).any():
        return
    reasons = dict.fromkeys(fault.partition(": ")[2] for fault in field.cells.faults if fault and "no gains" in fault)
    missing = " Crosses: no operating point, or no gains." if np.isnan(gains).any() else ""
    missing = f" Crosses: no gains, {'; '.join(reasons)}." if reasons else missing
    s = result.study.stability
    place = "They belong to the grid alone, whatever the operating point."
    if follows_measured(a.spec):
        place = (
            "They follow the measured P, Q and V and are shown in the steady state at "
            f"P = {plain(s.P[0] / 1e3)} kW, Q = {plain(s.Q[0] / 1e3)} kvar."
        )
    caption = (
        "How to read: the gains that the schedule gives each grid, one colour scale a gain, logarithmic where "
        f"all values are positive. {place}{missing}{baseline}"
    )
    surfaces = [
        Surface(
            symbols(f"{a.spec.name}: ") + gain_symbol(name),
            gain_symbol(name),
            GAIN_UNITS[name],
            getattr(gains, name),
            f"map.{index}.gains.{name}",
        )
        for name in used_gains(gains)
    ]
    for first in range(0, len(surfaces), MOST):
        name = f"map_gains_{index + 1}" + (f"_{first // MOST + 1}" if len(surfaces) > MOST else "")
        named = (name, f"Scheduled gains of {a.spec.name}", caption)
        label = f"SCR, {result.study.scr_basis} basis [1]"
        yield surface_figure(named, field.axes[0][1], field.axes[1][1], surfaces[first : first + MOST], label, PART)
