"""The estimated grid over a scenario and the true grid, with enlarged transients and rests, and the error."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from vsgdesign.identification.registry import needs_network
from vsgdesign.metrics.estimation import RestError, relative_errors_pct
from vsgdesign.report.drawing.decimation import extreme_indices
from vsgdesign.report.drawing.style import (
    PAGE_IN,
    REFERENCE,
    ZOOM_SPAN,
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
from vsgdesign.report.page.converter import grid_label
from vsgdesign.report.quantities import prefix_for
from vsgdesign.simulation import ScenarioResult
from vsgdesign.simulation.estimated import EstimateLog
from vsgdesign.simulation.judging import judge_estimates

_LEFT, _RIGHT, _BOTTOM, _BETWEEN = 0.6, 0.13, 0.36, 0.56
_MAIN_HEIGHT, _ZOOM_HEIGHT, _GAP = 1.5, 1.05, 0.5
_MOST_ZOOMS = 3
_COLUMNS = 700

_BEFORE_S, _AFTER_S = 0.06, 0.3
"""Stretch about a change of grid that is enlarged."""

_REST_S = 0.2
"""Stretch of rest that is enlarged."""

_LEAST_SHARE = 2e-3
"""Half the height of an enlarged rest, of the true value, at least."""

QUANTITIES = (("R_g", "R_g_hat", "R", "Ω", "resistance"), ("L_g", "L_g_hat", "L", "H", "inductance"))


def estimate_figures(result: ScenarioResult) -> Iterator[NamedFigure]:
    """Resistance, inductance and errors; nothing if no controller estimates the grid."""
    if not any(controller.estimates is not None for controller in result.controllers):
        return
    for quantity in QUANTITIES:
        with look():
            figure = _estimate_figure(result, *quantity)
        yield figure
    with look():
        figure = _error_figure(result)
    yield figure


def _estimating(result: ScenarioResult) -> list[tuple[int, str, EstimateLog]]:
    """Place among all controllers, which gives the colour, name and log."""
    return [(k, c.spec.name, c.estimates) for k, c in enumerate(result.controllers) if c.estimates is not None]


def _estimate_figure(
    result: ScenarioResult, truth: str, estimate: str, symbol: str, unit_name: str, word: str
) -> NamedFigure:
    study, timeline = result.study, result.timeline
    duration, unit = study.simulation.duration, time_unit(study.simulation.duration)
    width = PAGE_IN - _LEFT - _RIGHT
    changes = [t_s for t_s, _ in timeline.grids if t_s > 0.0][:_MOST_ZOOMS]
    rests = _rests_shown(result)
    factor, prefix = prefix_for(max(getattr(grid, truth) for _, grid in timeline.grids), 1e-6)
    labels = event_labels([(e.t_s, short_name(e)) for e in study.events], duration, width)
    rows = [row for row in (changes, rests) if row]
    top = labels.height_in + _legend_height(result)
    below = _BOTTOM + len(rows) * (_ZOOM_HEIGHT + _GAP)
    height = below + _MAIN_HEIGHT + top
    figure = new_figure(PAGE_IN, height)
    main = add_axes(figure, _LEFT, below, width, _MAIN_HEIGHT)
    mark_events(main, [event.t_s for event in study.events], unit)
    draw_labels(main, labels, unit)
    _draw(main, result, truth, estimate, factor, 0.0, duration, 0.0, unit.seconds)
    whole_scenario(main, duration, unit)
    main.set_ylim(bottom=0.0)
    main.set_ylabel(f"${symbol}_g$ [{prefix}{unit_name}]")
    letters = iter("abcdefgh")
    for row, stretches in enumerate(rows):
        bottom = _BOTTOM + (len(rows) - 1 - row) * (_ZOOM_HEIGHT + _GAP)
        panel = (width - _BETWEEN * (len(stretches) - 1)) / len(stretches)
        for column, stretch in enumerate(stretches):
            axes = add_axes(figure, _LEFT + column * (panel + _BETWEEN), bottom, panel, _ZOOM_HEIGHT)
            letter = next(letters)
            if isinstance(stretch, RestError):
                begin, end = max(stretch.begin_s, stretch.end_s - _REST_S), stretch.end_s
                _draw(axes, result, truth, estimate, factor, begin, end, 0.0, unit.seconds)
                seen = _seen(result, estimate, factor, begin, end)
                _limit_rest(axes, getattr(stretch, truth) / factor, seen)
                axes.set_xlabel(f"Time [{unit.symbol}]")
                grid = timeline.grid_at(end - 1e-6)
                axes.set_title(f"({letter}) at rest, {grid_label(result, grid)}")
                axes.set_xlim(begin / unit.seconds, end / unit.seconds)
            else:
                begin, end = max(stretch - _BEFORE_S, 0.0), min(stretch + _AFTER_S, duration)
                _draw(axes, result, truth, estimate, factor, begin, end, stretch, 1e-3, marked=True)
                held = [getattr(timeline.grid_at(t), truth) / factor for t in (begin, end)]
                _limit_change(axes, [*held, *_seen(result, estimate, factor, begin, end)])
                axes.set_xlabel("Time after event [ms]")
                event = next((e for e in study.events if e.t_s == stretch), None)
                name = "change of grid" if event is None else short_name(event)
                axes.set_title(symbols(f"({letter}) {name} at {stretch:g} s"))
                axes.set_xlim(1e3 * (begin - stretch), 1e3 * (end - stretch))
                mark_events(axes, [0.0], time_unit(0.1))
            main.axvspan(begin / unit.seconds, end / unit.seconds, ymax=0.03, **ZOOM_SPAN)
            axes.locator_params(axis="x", nbins=max(int(panel / 0.5), 2))
            axes.locator_params(axis="y", nbins=4)
            if column == 0:
                axes.set_ylabel(f"${symbol}_g$ [{prefix}{unit_name}]")
    _legend(figure, result, height)
    period_ms = 1e3 * _estimating(result)[0][2].period
    caption = (
        f"Grid {word} as {_who(result)} it, one answer for each window of {period_ms:g} ms, drawn from the end of "
        "the window, where it acts, and the truth. Below: changes of grid, and rest before the next event, enlarged."
        + (" An answer beyond what the network was trained on is clipped." if result.ready.network else "")
    )
    return NamedFigure(f"estimate_{word}", f"Estimated {word} of the grid", caption, figure)


def _who(result: ScenarioResult) -> str:
    known = result.ready.network is not None
    alone = known and all(needs_network(c.spec.estimate) for c in result.controllers if c.estimates is not None)
    return "the network says" if alone else "the estimators say"


def _rests_shown(result: ScenarioResult) -> list[RestError]:
    """The last rest on each grid, of the first controller that estimates."""
    by_grid: dict[tuple[float, float], RestError] = {}
    for rest in judge_estimates(result)[0].rest:
        by_grid[rest.R_g, rest.L_g] = rest
    return list(by_grid.values())[:_MOST_ZOOMS]


def _draw(
    axes: Any,
    result: ScenarioResult,
    truth: str,
    estimate: str,
    factor: float,
    begin: float,
    end: float,
    origin: float,
    seconds: float,
    marked: bool = False,
) -> None:
    grids = result.timeline.grids
    times = np.array([*(t_s for t_s, _ in grids), result.study.simulation.duration])
    values = np.array([getattr(grid, truth) for _, grid in grids]) / factor
    axes.step((times - origin) / seconds, np.append(values, values[-1]), where="post", **REFERENCE)
    for index, _, log in _estimating(result):
        rows = np.flatnonzero((log.t_s >= begin - 2.0 * log.period) & (log.t_s <= end + log.period))
        t, y = log.t_s[rows], getattr(log, estimate)[rows] / factor
        picks = extreme_indices(np.nan_to_num(y), _COLUMNS)
        marks: dict[str, Any] = {"marker": "o", "markersize": 2.2} if marked else {}
        axes.step((t[picks] - origin) / seconds, y[picks], where="post", zorder=3.0, **line_style(index), **marks)


def _seen(result: ScenarioResult, estimate: str, factor: float, begin: float, end: float) -> list[float]:
    """Every estimate of a stretch, in the axis' unit."""
    values: list[float] = []
    for _, _, log in _estimating(result):
        rows = (log.t_s > begin - 1e-9) & (log.t_s < end + 1e-9)
        values += [float(y) for y in getattr(log, estimate)[rows] / factor if np.isfinite(y)]
    return values


def _limit_rest(axes: Any, true: float, seen: Sequence[float]) -> None:
    """The truth in the middle, the estimates in sight, and rounding not blown up."""
    reach = max((1.5 * abs(value - true) for value in seen), default=0.0)
    half = max(reach, _LEAST_SHARE * abs(true), 1e-12)
    axes.set_ylim(true - half, true + half)


def _limit_change(axes: Any, seen: Sequence[float]) -> None:
    low, high = min(seen), max(seen)
    room = max(0.06 * (high - low), 1e-3 * abs(high), 1e-12)
    axes.set_ylim(low - room, high + room)


def _error_figure(result: ScenarioResult) -> NamedFigure:
    study = result.study
    duration, unit = study.simulation.duration, time_unit(study.simulation.duration)
    height, gap = 1.15, 0.1
    width = PAGE_IN - _LEFT - _RIGHT
    labels = event_labels([(e.t_s, short_name(e)) for e in study.events], duration, width)
    total = _BOTTOM + 2 * height + gap + labels.height_in + _legend_height(result, truth=False)
    figure = new_figure(PAGE_IN, total)
    panels = []
    for row, (truth, estimate, symbol, _, _) in enumerate(QUANTITIES):
        axes = add_axes(figure, _LEFT, _BOTTOM + (1 - row) * (height + gap), width, height)
        for index, _, log in _estimating(result):
            error = np.abs(relative_errors_pct(getattr(log, truth), getattr(log, estimate)))
            picks = extreme_indices(np.nan_to_num(error), _COLUMNS)
            axes.step(
                log.t_s[picks] / unit.seconds,
                np.maximum(error[picks], 1e-3),
                where="post",
                linewidth=0.8,
                **{**line_style(index), "linestyle": "-"},
            )
        axes.set_yscale("log")
        axes.set_ylabel(f"Error of ${symbol}_g$ [%]")
        mark_events(axes, [event.t_s for event in study.events], unit)
        whole_scenario(axes, duration, unit, label=row == 1)
        panels.append(axes)
    low = min(axes.get_ylim()[0] for axes in panels)
    high = max(axes.get_ylim()[1] for axes in panels)
    for axes in panels:
        axes.set_ylim(max(low, 1e-3), high)
    draw_labels(panels[0], labels, unit)
    figure.align_ylabels(panels)
    _legend(figure, result, total, truth=False)
    caption = (
        "Magnitude of the relative error of every window. A window that holds a change of grid belongs to two grids; "
        "after it " + ("the network sees" if result.ready.network else "the estimators see") + " the grid settle."
    )
    return NamedFigure("estimate_error", "Error of the estimated grid", caption, figure)


def _legend_labels(result: ScenarioResult, truth: bool) -> list[str]:
    return [*(symbols(f"estimate of {name}") for _, name, _ in _estimating(result)), *(["truth"] if truth else [])]


def _legend_height(result: ScenarioResult, truth: bool = True) -> float:
    labels = _legend_labels(result, truth)
    return 0.24 + 0.15 * (math.ceil(len(labels) / _columns(labels)) - 1)


def _legend(figure: Any, result: ScenarioResult, height: float, truth: bool = True) -> None:
    from matplotlib.lines import Line2D

    labels = _legend_labels(result, truth)
    lines = [Line2D([], [], **line_style(index)) for index, _, _ in _estimating(result)]
    lines += [Line2D([], [], **REFERENCE)] if truth else []
    figure.legend(
        lines,
        labels,
        ncols=_columns(labels),
        loc="upper left",
        bbox_to_anchor=(_LEFT / PAGE_IN, 1.0 - 0.05 / height),
    )


def _columns(labels: Sequence[str]) -> int:
    widest = max(text_width(label) for label in labels) + 0.55
    return max(min(int((PAGE_IN - _LEFT) / widest), len(labels)), 1)
