"""What changes in steps over a scenario: the grid's impedance and the controllers' gains."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from vsgdesign.report.drawing.decimation import extreme_indices
from vsgdesign.report.drawing.figure_types import NamedFigure
from vsgdesign.report.drawing.quantities import prefix_for
from vsgdesign.report.drawing.run_figure import Row, RunFigure, View, run_figure
from vsgdesign.report.drawing.style import COLOURS, COLUMN_IN, line_style, look
from vsgdesign.report.drawing.time_axis import symbols
from vsgdesign.simulation.scenario import ScenarioResult

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
    yield _impedance_figure(result)
    yield _gains_figure(result)


@look()
def _impedance_figure(result: ScenarioResult) -> NamedFigure:
    rows = []
    for field, symbol, unit_name in (("R_g", "R", "Ω"), ("L_g", "L", "H")):
        values = np.array([getattr(grid, field) for _, grid in result.timeline.grids])
        factor, prefix = prefix_for(float(np.max(values)), 1e-6)
        draw = functools.partial(_draw_impedance, [t_s for t_s, _ in result.timeline.grids], values / factor)
        rows.append(Row(f"${symbol}_g$ [{prefix}{unit_name}]", draw))
    return run_figure(
        RunFigure(
            name="grid_impedance",
            title="Grid impedance",
            caption="True grid impedance at the point of common coupling: resistance and inductance per phase.",
            columns=[rows],
            width_in=COLUMN_IN,
            **_changes_of_grid(result),
        )
    )


def _changes_of_grid(result: ScenarioResult) -> dict[str, Any]:
    """What both figures have of the run: only changes of the grid are marked."""
    return {
        "duration_s": result.study.simulation.duration,
        "events": [event for event in result.study.events if event.grid is not None],
        "numbers": "changes of the grid in order of time",
    }


def _draw_impedance(times: Sequence[float], values: Any, axes: Any, view: View) -> None:
    _step_line(axes, times, values, view, {"color": COLOURS[0], "linestyle": "-"})
    axes.set_ylim(0.0, 1.12 * float(np.max(values)) or 1.0)


@look()
def _gains_figure(result: ScenarioResult) -> NamedFigure:
    from matplotlib.lines import Line2D

    rows = [
        Row(f"{symbol} [{unit_name}]", functools.partial(_draw_gain, result, field))
        for field, symbol, unit_name in GAIN_AXES
    ]
    caption = "Power-loop gains of each controller: fixed, or rescheduled from the grid impedance."
    if any(controller.estimates is not None for controller in result.controllers):
        caption += " Those from an estimate change with every window; the curve keeps their extremes."
    names = [symbols(controller.spec.name) for controller in result.controllers]
    return run_figure(
        RunFigure(
            name="gains",
            title="Gains",
            caption=caption,
            columns=[rows[:2], rows[2:]],
            entries=[(Line2D([], [], **line_style(index)), name) for index, name in enumerate(names)],
            **_changes_of_grid(result),
        )
    )


def _draw_gain(result: ScenarioResult, field: str, axes: Any, view: View) -> None:
    ends = []
    for curve, controller in enumerate(result.controllers):
        times = np.array([change.t_s for change in controller.gain_changes])
        values = np.array([getattr(change.gains, field) for change in controller.gain_changes])
        ends += [float(np.min(values)), float(np.max(values))]
        # An estimate never stands still: thousands of steps, of which the eye sees the extremes.
        picks = extreme_indices(values, _COLUMNS)
        _step_line(axes, times[picks].tolist(), values[picks], view, line_style(curve))
    _gain_scale(axes, min(ends), max(ends))


def _step_line(axes: Any, times: Sequence[float], values: Any, view: View, style: dict[str, Any]) -> None:
    t = view.place(np.array([*times, view.end_s]))
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
