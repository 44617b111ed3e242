"""What changes in steps over a scenario: the grid's impedance and the controllers' gains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from vsgdesign.report.drawing.decimation import extreme_indices
from vsgdesign.report.drawing.style import (
    COLOURS,
    COLUMN_IN,
    PAGE_IN,
    add_axes,
    line_style,
    look,
    new_figure,
    text_width,
)
from vsgdesign.report.drawing.time_axis import (
    draw_labels,
    event_labels,
    mark_events,
    short_name,
    symbols,
    time_unit,
    whole_scenario,
)
from vsgdesign.report.figure_types import NamedFigure
from vsgdesign.report.quantities import prefix_for
from vsgdesign.simulation import ScenarioResult

_LOG_FROM = 4.0
"""A ratio of largest to smallest from which a logarithmic axis reads better."""

_COLUMNS = 300
"""Columns that a curve of many steps is thinned to."""

GAIN_AXES = (
    ("K_ip", "$K_{ip}$", "rad/(s²·W)"),
    ("D_p", "$D_p$", "W·s/rad"),
    ("K_iq", "$K_{iq}$", "V/(s·var)"),
    ("D_q", "$D_q$", "var/V"),
)


def schedule_figures(result: ScenarioResult) -> Iterator[NamedFigure]:
    """The grid impedance, then the gains."""
    with look():
        impedance = _impedance_figure(result)
    yield impedance
    with look():
        gains = _gains_figure(result)
    yield gains


def _impedance_figure(result: ScenarioResult) -> NamedFigure:
    duration, unit = result.study.simulation.duration, time_unit(result.study.simulation.duration)
    left, right, bottom, height, gap = 0.55, 0.1, 0.36, 0.95, 0.1
    width = COLUMN_IN - left - right
    grid_events = [event for event in result.study.events if event.grid is not None]
    labels = event_labels([(event.t_s, short_name(event)) for event in grid_events], duration, width)
    figure = new_figure(COLUMN_IN, bottom + 2.0 * height + gap + labels.height_in + 0.1)
    times = [t_s for t_s, _ in result.timeline.grids]
    upper = add_axes(figure, left, bottom + height + gap, width, height)
    lower = add_axes(figure, left, bottom, width, height)
    resistance = np.array([grid.R_g for _, grid in result.timeline.grids])
    inductance = np.array([grid.L_g for _, grid in result.timeline.grids])
    for axes, values, symbol, unit_name in ((upper, resistance, "R", "Ω"), (lower, inductance, "L", "H")):
        factor, prefix = prefix_for(float(np.max(values)), 1e-6)
        _step_line(axes, times, values / factor, duration, unit.seconds, {"color": COLOURS[0], "linestyle": "-"})
        axes.set_ylim(0.0, 1.12 * float(np.max(values)) / factor or 1.0)
        axes.set_ylabel(f"${symbol}_g$ [{prefix}{unit_name}]")
        mark_events(axes, [event.t_s for event in grid_events], unit)
    whole_scenario(upper, duration, unit, label=False)
    whole_scenario(lower, duration, unit)
    draw_labels(upper, labels, unit)
    figure.align_ylabels([upper, lower])
    caption = "True grid impedance at the point of common coupling: resistance and inductance per phase."
    if labels.numbered:
        caption += " Numbers above the axes: changes of the grid in order of time."
    return NamedFigure("grid_impedance", "Grid impedance", caption, figure)


def _gains_figure(result: ScenarioResult) -> NamedFigure:
    duration, unit = result.study.simulation.duration, time_unit(result.study.simulation.duration)
    left, right, bottom, height, gap, between = 0.62, 0.13, 0.36, 1.05, 0.14, 0.75
    width = 0.5 * (PAGE_IN - left - right - between)
    names = [symbols(controller.spec.name) for controller in result.controllers]
    grid_events = [event for event in result.study.events if event.grid is not None]
    labels = event_labels([(event.t_s, short_name(event)) for event in grid_events], duration, width)
    columns = max(min(int((PAGE_IN - left) / (max(text_width(name) for name in names) + 0.55)), len(names)), 1)
    top = labels.height_in + 0.15 * -(-len(names) // columns) + 0.1
    figure_height = bottom + 2.0 * height + gap + top
    figure = new_figure(PAGE_IN, figure_height)
    for index, (field, symbol, unit_name) in enumerate(GAIN_AXES):
        column, row = divmod(index, 2)
        axes = add_axes(figure, left + column * (width + between), bottom + (1 - row) * (height + gap), width, height)
        ends = []
        for curve, controller in enumerate(result.controllers):
            times = np.array([change.t_s for change in controller.gain_changes])
            values = np.array([getattr(change.gains, field) for change in controller.gain_changes])
            ends += [float(np.min(values)), float(np.max(values))]
            # An estimate never stands still: thousands of steps, of which the eye sees the extremes.
            picks = extreme_indices(values, _COLUMNS)
            times, values = times[picks].tolist(), values[picks]
            _step_line(axes, times, values, duration, unit.seconds, line_style(curve))
        _gain_scale(axes, min(ends), max(ends))
        mark_events(axes, [event.t_s for event in grid_events], unit)
        whole_scenario(axes, duration, unit, label=row == 1)
        axes.set_ylabel(f"{symbol} [{unit_name}]")
        axes.yaxis.set_label_coords(-0.46 / width, 0.5)
        if row == 0:
            draw_labels(axes, labels, unit)
    lines = figure.axes[0].get_lines()[: len(names)]
    figure.legend(
        lines, names, ncols=columns, loc="upper left", bbox_to_anchor=(left / PAGE_IN, 1.0 - 0.04 / figure_height)
    )
    caption = "Power-loop gains of each controller: fixed, or rescheduled from the grid impedance."
    if any(controller.estimates is not None for controller in result.controllers):
        caption += " Those from an estimate change with every window; the curve keeps their extremes."
    if labels.numbered:
        caption += " Numbers above the axes: changes of the grid in order of time."
    return NamedFigure("gains", "Gains", caption, figure)


def _step_line(
    axes: Any, times: Sequence[float], values: Any, end_s: float, seconds: float, style: dict[str, Any]
) -> None:
    t = np.array([*times, end_s]) / seconds
    axes.step(t, np.append(values, values[-1]), where="post", **style)


def _gain_scale(axes: Any, low: float, high: float) -> None:
    """Logarithmic over a wide range; else linear with some room, so that a constant stands clear of the frame."""
    from vsgdesign.report.drawing.ticks import Labels, PlainNumbers

    if low > 0.0 and high > _LOG_FROM * low:
        from matplotlib.ticker import LogLocator, NullFormatter

        axes.set_yscale("log")
        axes.set_ylim(low / 1.4, high * 1.4)
        # Few decades: 1, 2, 5 read more easily than a lone power of ten.
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 100.0 * low else (1.0,)))
        axes.yaxis.set_major_formatter(Labels(_log_tick))
        axes.yaxis.set_minor_formatter(NullFormatter())
        return
    axes.yaxis.set_major_formatter(PlainNumbers((-3, 4)))
    room = max(0.15 * (high - low), 0.1 * abs(high), 1e-12)
    axes.set_ylim(max(low - room, 0.0), high + room)


def _log_tick(value: float) -> str:
    from vsgdesign.report.drawing.ticks import ten_to

    if 1e-4 <= value < 1e5:
        return f"{value:g}"
    mantissa, _, power = f"{value:.0e}".partition("e")
    factor = "" if mantissa == "1" else f"{mantissa}×"
    return f"{factor}{ten_to(int(power))}"
