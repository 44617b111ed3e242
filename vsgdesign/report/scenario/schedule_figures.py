"""What changes in steps over a scenario: the grid's impedance, the controllers' gains, and the estimated grid beside
the true one."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from vsgdesign.identification.interface import needs_network
from vsgdesign.metrics.answers import relative_errors_pct
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.quantities import prefix_for
from vsgdesign.report.drawing.style import COLOURS, COLUMN_IN, REFERENCE, line_style, look
from vsgdesign.report.drawing.time_axis import (
    Row,
    RunFigure,
    View,
    Zoom,
    extreme_indices,
    run_figure,
    short_name,
    symbols,
)
from vsgdesign.report.page.converter import grid_label
from vsgdesign.simulation.estimated import EstimateLog
from vsgdesign.simulation.scenario import ScenarioResult
from vsgdesign.simulation.scenario.judging import judge_estimates

_LOG_FROM = 4.0
"""A ratio of largest to smallest from which a logarithmic axis reads better."""

_MOST_STEPS = 300
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
        picks = extreme_indices(values, _MOST_STEPS)
        _step_line(axes, times[picks].tolist(), values[picks], view, line_style(curve))
    _gain_scale(axes, min(ends), max(ends))


def _step_line(axes: Any, times: Sequence[float], values: Any, view: View, style: dict[str, Any]) -> None:
    t = view.place(np.array([*times, view.end_s]))
    axes.step(t, np.append(values, values[-1]), where="post", **style)


def _gain_scale(axes: Any, low: float, high: float) -> None:
    """Logarithmic over a wide range; else linear with some room, so that a constant stands clear of the frame."""
    from vsgdesign.report.drawing.look import round_decades
    from vsgdesign.report.drawing.ticks import PlainNumbers

    if low > 0.0 and high > _LOG_FROM * low:
        axes.set_yscale("log")
        axes.set_ylim(low / 1.4, high * 1.4)
        round_decades(axes.yaxis, _log_tick, (1.0, 2.0, 5.0) if high < 100.0 * low else (1.0,))
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


_MOST_ZOOMS = 3
_COLUMNS = 700

_BEFORE_S, _AFTER_S = 0.06, 0.3
"""Stretch about a change of grid that is enlarged."""

_REST_S = 0.2
"""Stretch of rest that is enlarged."""

_LEAST_SHARE = 2e-3
"""Half the height of an enlarged rest, of the true value, at least."""

_LEAST_ERROR_PCT = 1e-3
"""Errors below are drawn here on the logarithmic axis."""

QUANTITIES = (("R_g", "R_g_hat", "R", "Ω", "resistance"), ("L_g", "L_g_hat", "L", "H", "inductance"))


def estimate_figures(result: ScenarioResult) -> Iterator[NamedFigure]:
    """Resistance, inductance and errors; nothing if no controller estimates the grid."""
    if any(controller.estimates is not None for controller in result.controllers):
        for quantity in QUANTITIES:
            yield _estimate_figure(result, *quantity)
        yield _error_figure(result)


def _estimating(result: ScenarioResult) -> list[tuple[int, str, EstimateLog]]:
    """Place among all controllers, which gives the colour, name and log."""
    return [(k, c.spec.name, c.estimates) for k, c in enumerate(result.controllers) if c.estimates is not None]


@look()
def _estimate_figure(
    result: ScenarioResult, truth: str, estimate: str, symbol: str, unit_name: str, word: str
) -> NamedFigure:
    study = result.study
    factor, prefix = prefix_for(max(getattr(grid, truth) for _, grid in result.timeline.grids), 1e-6)
    period_ms = 1e3 * _estimating(result)[0][2].period
    caption = (
        f"Grid {word} as {_who(result)} it, one answer for each window of {period_ms:g} ms, drawn from the end of "
        "the window, where it acts, and the truth. Below: changes of grid, and rest before the next event, enlarged."
        + (" An answer beyond what the network was trained on is clipped." if result.ready.network else "")
    )
    return run_figure(
        RunFigure(
            name=f"estimate_{word}",
            title=f"Estimated {word} of the grid",
            caption=caption,
            duration_s=study.simulation.duration,
            events=study.events,
            columns=[
                [
                    Row(
                        f"${symbol}_g$ [{prefix}{unit_name}]",
                        functools.partial(_draw, result, truth, estimate, factor),
                    )
                ]
            ],
            zooms=[change_zooms(result, _BEFORE_S, _AFTER_S)[:_MOST_ZOOMS], _rests_shown(result)],
            entries=_legend_entries(result),
        )
    )


def _who(result: ScenarioResult) -> str:
    known = result.ready.network is not None
    alone = known and all(needs_network(c.spec.estimate) for c in result.controllers if c.estimates is not None)
    return "the network says" if alone else "the estimators say"


def change_zooms(result: ScenarioResult, before_s: float, after_s: float) -> list[Zoom]:
    """A stretch about each change of the grid during a run."""
    study = result.study
    names = {event.t_s: short_name(event) for event in reversed(study.events)}
    return [
        Zoom(
            max(t_s - before_s, 0.0),
            min(t_s + after_s, study.simulation.duration),
            names.get(t_s, f"change of grid at {t_s:g} s"),
            t_s,
        )
        for t_s, _ in result.timeline.grids
        if t_s > 0.0
    ]


def _rests_shown(result: ScenarioResult) -> list[Zoom]:
    """The end of the last rest on each grid, of the first controller that estimates."""
    by_grid = {(rest.R_g, rest.L_g): rest for rest in judge_estimates(result)[0].rest}
    return [
        Zoom(
            max(rest.begin_s, rest.end_s - _REST_S),
            rest.end_s,
            f"at rest, {grid_label(result, result.timeline.grid_at(rest.end_s - 1e-6))}",
        )
        for rest in list(by_grid.values())[:_MOST_ZOOMS]
    ]


def _draw(result: ScenarioResult, truth: str, estimate: str, factor: float, axes: Any, view: View) -> None:
    """Truth and estimates. Of a rest the truth is in the middle, and answers about a change are marked by dots."""
    timeline, zoom = result.timeline, view.zoom
    about_change = zoom is not None and zoom.event_s is not None
    times = np.array([*(t_s for t_s, _ in timeline.grids), result.study.simulation.duration])
    values = np.array([getattr(grid, truth) for _, grid in timeline.grids]) / factor
    axes.step(view.place(times), np.append(values, values[-1]), where="post", **REFERENCE)
    seen: list[float] = []
    for index, _, log in _estimating(result):
        rows = np.flatnonzero((log.t_s >= view.begin_s - 2.0 * log.period) & (log.t_s <= view.end_s + log.period))
        t, y = log.t_s[rows], getattr(log, estimate)[rows] / factor
        seen += y[(t > view.begin_s - 1e-9) & (t < view.end_s + 1e-9) & np.isfinite(y)].tolist()
        picks = extreme_indices(np.nan_to_num(y), _COLUMNS)
        marks: dict[str, Any] = {"marker": "o", "markersize": 2.2} if about_change else {}
        axes.step(view.place(t[picks]), y[picks], where="post", zorder=3.0, **line_style(index), **marks)
    if zoom is None:
        axes.set_ylim(bottom=0.0)
    elif about_change:
        _limit_change(
            axes, [*seen, *(getattr(timeline.grid_at(t), truth) / factor for t in (view.begin_s, view.end_s))]
        )
    else:
        _limit_rest(axes, getattr(timeline.grid_at(view.end_s - 1e-6), truth) / factor, seen)


def _limit_rest(axes: Any, true: float, seen: Sequence[float]) -> None:
    """The truth in the middle, the estimates in sight, and rounding not blown up."""
    reach = max((1.5 * abs(value - true) for value in seen), default=0.0)
    half = max(reach, _LEAST_SHARE * abs(true), 1e-12)
    axes.set_ylim(true - half, true + half)


def _limit_change(axes: Any, seen: Sequence[float]) -> None:
    low, high = min(seen), max(seen)
    room = max(0.06 * (high - low), 1e-3 * abs(high), 1e-12)
    axes.set_ylim(low - room, high + room)


@look()
def _error_figure(result: ScenarioResult) -> NamedFigure:
    study = result.study
    caption = (
        "Magnitude of the relative error of every window. A window that holds a change of grid belongs to two grids; "
        "after it " + ("the network sees" if result.ready.network else "the estimators see") + " the grid settle."
    )
    named = run_figure(
        RunFigure(
            name="estimate_error",
            title="Error of the estimated grid",
            caption=caption,
            duration_s=study.simulation.duration,
            events=study.events,
            columns=[
                [
                    Row(f"Error of ${symbol}_g$ [%]", functools.partial(_draw_error, result, truth, estimate))
                    for truth, estimate, symbol, _, _ in QUANTITIES
                ]
            ],
            entries=_legend_entries(result)[:-1],
        )
    )
    ends = np.array([axes.get_ylim() for axes in named.figure.axes])
    for axes in named.figure.axes:
        axes.set_ylim(max(float(ends.min()), _LEAST_ERROR_PCT), float(ends.max()))
    return named


def _draw_error(result: ScenarioResult, truth: str, estimate: str, axes: Any, view: View) -> None:
    for index, _, log in _estimating(result):
        error = np.abs(relative_errors_pct(getattr(log, truth), getattr(log, estimate)))
        picks = extreme_indices(np.nan_to_num(error), _COLUMNS)
        style = {**line_style(index), "linestyle": "-", "linewidth": 0.8}
        axes.step(view.place(log.t_s[picks]), np.maximum(error[picks], _LEAST_ERROR_PCT), where="post", **style)
    axes.set_yscale("log")


def _legend_entries(result: ScenarioResult) -> list[tuple[Any, str]]:
    """The estimates, then the truth."""
    from matplotlib.lines import Line2D

    entries = [
        (Line2D([], [], **line_style(index)), symbols(f"estimate of {name}")) for index, name, _ in _estimating(result)
    ]
    return [*entries, (Line2D([], [], **REFERENCE), "truth")]
