"""Figures of the methods: error and bound, effect of a probe, a change of the grid, and where each method fails."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from vsgdesign.estimator.comparison import WITHIN, Comparison, GridStep
from vsgdesign.estimator.stress import AxisResult, Stress
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.quantities import plain
from vsgdesign.report.drawing.style import (
    BAND,
    EVENT_LINE,
    NOTE_COLOUR,
    PAGE_IN,
    REFERENCE,
    add_axes,
    line_style,
    look,
    new_figure,
)

LOW_PCT, HIGH_PCT = 0.03, 1000.0
"""Range of the error axes. Values beyond it are drawn on the edge."""

_LEFT, _RIGHT, _GAP, _ROW = 0.52, 0.1, 0.14, 1.42
_MARKS = "os^DvP*X"


def comparison_figures(found: Comparison) -> Iterator[NamedFigure]:
    """Part 1: accuracy; 2: disturbance; 3: change of grid."""
    with look():
        yield _accuracy(found)
        yield _disturbance(found)
        for pair in dict.fromkeys(step.scr for step in found.grid_steps):
            yield _grid_step([step for step in found.grid_steps if step.scr == pair])


def stress_figures(found: Stress) -> Iterator[NamedFigure]:
    """One figure, a panel for every axis."""
    with look():
        yield _stress(found)


def _clipped(share: Any) -> Any:
    return np.clip(100.0 * np.nan_to_num(share, nan=10.0, posinf=10.0), LOW_PCT, HIGH_PCT)


def _panels(count: int, columns: int, height: float, top: float, bottom: float = 0.42) -> tuple[Any, list[Any]]:
    """A figure with rows of equal axes that share their scales, the labels at the left and below."""
    rows = -(-count // columns)
    width = (PAGE_IN - _LEFT - _RIGHT - (columns - 1) * _GAP) / columns
    gap = 0.34
    figure = new_figure(PAGE_IN, bottom + rows * height + (rows - 1) * gap + top)
    axes = []
    for k in range(count):
        row, column = divmod(k, columns)
        place = (_LEFT + column * (width + _GAP), bottom + (rows - 1 - row) * (height + gap), width, height)
        axes.append(add_axes(figure, *place))
    return figure, axes


def _legend_above(figure: Any, entries: dict[str, Any]) -> None:
    figure.legend(
        list(entries.values()), list(entries), loc="upper left", ncols=4, bbox_to_anchor=(_LEFT / PAGE_IN, 0.995)
    )


def _error_axis(axes: Any, first: bool) -> None:
    axes.set_yscale("log")
    axes.set_ylim(LOW_PCT, HIGH_PCT)
    axes.set_yticks([0.1, 1.0, 10.0, 100.0, 1000.0])
    axes.set_yticklabels(["0.1", "1", "10", "100", "1000"] if first else [])
    axes.minorticks_off()
    if first:
        axes.set_ylabel("Error of Z [%]")


def _value_axis(axes: Any, values: Sequence[float], logarithmic: bool, labels: bool = True) -> None:
    if logarithmic:
        axes.set_xscale("log")
    axes.set_xticks(list(values))
    axes.set_xticklabels([plain(value, 4) for value in values] if labels else [])
    axes.minorticks_off()


def _accuracy(found: Comparison) -> NamedFigure:
    scr = np.array(found.settings.scr)
    columns = 4
    count = len(found.accuracy)
    figure, panels = _panels(count, columns, _ROW, 0.36)
    entries: dict[str, Any] = {}
    for k, (axes, one) in enumerate(zip(panels, found.accuracy, strict=True)):
        style = line_style(k)
        (entries["rms"],) = axes.plot(scr, _clipped(one.rms), marker="o", markersize=2.4, color=style["color"])
        (entries["95th percentile"],) = axes.plot(
            scr, _clipped(one.p95), color=style["color"], linewidth=0.6, linestyle=(0, (2, 1.5))
        )
        if np.isfinite(one.bound).any():
            (entries["Cramér–Rao bound of its signals"],) = axes.plot(scr, _clipped(one.bound), **REFERENCE)
        axes.axhspan(LOW_PCT, 10.0, **{**BAND, "alpha": 0.18})
        _value_axis(axes, found.settings.scr, True, k >= count - columns)
        _error_axis(axes, k % columns == 0)
        axes.set_title(one.method)
        if k >= count - columns:
            axes.set_xlabel("SCR [1]")
    _legend_above(figure, entries)
    s = found.settings
    around = found.around or f"noise {plain(100.0 * s.noise)} % of the rated peak, {s.adc_bits} bit"
    networks = "The networks are given the grid's phase, and X/R is what they were trained on."
    if found.around:
        networks = "The networks' windows begin at an unknown phase of the grid, as in the field."
    caption = (
        f"How to read: error |Ẑ − Z|/|Z| on each grid after a power step of {plain(s.P_step_pu)} pu, X/R "
        f"{plain(s.x_over_r)}, {around}, switched bridge. "
        "No unbiased estimator of the same signals gets below the dashed line. Shaded: 10 % and better, enough for a "
        f"schedule. {networks}"
    )
    return NamedFigure("estimator_accuracy", "Error of every method and its bound", caption, figure, 1)


def _disturbance(found: Comparison) -> NamedFigure:
    height = 1.5
    figure, panels = _panels(2, 2, height, 0.36)
    for axes, quantity in zip(panels, ("P", "Q"), strict=True):
        for k, one in enumerate(found.disturbances):
            values = 100.0 * getattr(one, quantity)
            axes.plot(found.settings.scr, values, marker=_MARKS[k], markersize=2.6, label=one.method, **line_style(k))
        _value_axis(axes, found.settings.scr, True)
        axes.set_ylim(0.0, 1.08 * max(100.0 * max(one.P.max(), one.Q.max()) for one in found.disturbances))
        axes.set_xlabel("SCR [1]")
        axes.set_title(f"Largest move of {quantity}")
    panels[0].set_ylabel("Of rated power [%]")
    panels[1].set_yticklabels([])
    _legend_above(figure, {line.get_label(): line for line in panels[0].lines})
    caption = (
        "How to read: the price of a probe, the largest move of P and Q at rest. Injection and sequence send 0.5 % of "
        "the rated voltage on every grid, and the power that it moves grows with the SCR. The field estimator limits "
        "what its probe moves; the first second, in which it learns, is not shown."
    )
    return NamedFigure("estimator_disturbance", "What the probes do to P and Q", caption, figure, 2)


def _grid_step(steps: Sequence[GridStep]) -> NamedFigure:
    columns = 4
    figure, panels = _panels(len(steps), columns, _ROW, 0.36)
    top = 1.35 * float(np.max(steps[0].Z_true))
    entries: dict[str, Any] = {}
    for k, (axes, step) in enumerate(zip(panels, steps, strict=True)):
        t_ms = 1e3 * step.t_s
        axes.axhspan((1.0 - WITHIN) * step.Z_true[-1], (1.0 + WITHIN) * step.Z_true[-1], **BAND)
        (entries["true"],) = axes.step(t_ms, step.Z_true, where="pre", **REFERENCE)
        dotted = {"marker": ".", "markersize": 2.2, "linewidth": 0.8, "color": line_style(k)["color"]}
        estimated = np.clip(step.Z[0], 0.0, top)
        (entries["estimated, at the end of each window"],) = axes.plot(t_ms, estimated, **dotted)
        axes.axvline(0.0, **EVENT_LINE)
        axes.set_ylim(0.0, 1.2 * top)  # the words have a line of their own
        axes.set_xlim(t_ms[0], t_ms[-1])
        delay = 1e3 * float(np.median(step.delay))
        words = f"within 10 % after {delay:.0f} ms" if np.isfinite(delay) else "not within 10 %"
        axes.text(
            0.96,
            0.93,
            words,
            transform=axes.transAxes,
            ha="right",
            va="top",
            fontsize=6.5,
            color=NOTE_COLOUR,
            bbox={"facecolor": "#FFFFFF", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
            zorder=5,
        )
        axes.set_title(step.method)
        if k >= len(steps) - columns:
            axes.set_xlabel("Time after the change [ms]")
        else:
            axes.set_xticklabels([])
        if k % columns == 0:
            axes.set_ylabel("|Z| [Ω]")
        else:
            axes.set_yticklabels([])
    _legend_above(figure, entries)
    first, then = steps[0].scr
    name = f"estimator_grid_step_{plain(first)}_{plain(then)}".replace(".", "p")
    caption = (
        f"How to read: the grid changes from SCR {plain(first)} to {plain(then)} at t = 0. Band: ±10 % of the new "
        "value. Time to within: from the change to the end of the first window from which the error stays within; "
        f"median over the draws of noise. What is above {plain(top, 2)} Ω is drawn there."
    )
    return NamedFigure(name, f"From SCR {plain(first)} to {plain(then)}", caption, figure, 3)


def _stress(found: Stress) -> NamedFigure:
    columns = 3
    figure, panels = _panels(len(found.results), columns, 1.5, 0.2)
    for k, (axes, one) in enumerate(zip(panels, found.results, strict=True)):
        _stress_panel(axes, one)
        _error_axis(axes, k % columns == 0)
        title = one.axis.title if one.axis.unit == "1" else f"{one.axis.title} [{one.axis.unit}]"
        axes.set_title(title)
    place = panels[-1].get_position()
    figure.legend(
        panels[0].lines[: len(found.methods)],
        found.methods,
        loc="upper left",
        bbox_to_anchor=(place.x1 + 0.06, place.y1),
        ncols=2 if len(found.results) % columns == 1 else 1,
    )
    caption = (
        "How to read: rms error |Ẑ − Z|/|Z|, one quantity at a time taken from its nominal value (dotted); otherwise "
        f"SCR 8, X/R 1, {found.f_n:g} Hz, {found.around or 'ideal sensors'}. Shaded: 10 % and better. "
        "What is beyond the axis is drawn on its edge."
    )
    return NamedFigure("estimator_stress", "Where each method breaks", caption, figure, 1)


def _stress_panel(axes: Any, one: AxisResult) -> None:
    axis = one.axis
    # Evenly spaced: what matters is near the nominal value, and no scale shows that of all axes.
    places = np.arange(len(axis.values))
    for k, errors in enumerate(one.rms):
        axes.plot(places, _clipped(errors), marker=_MARKS[k % len(_MARKS)], markersize=2.2, **line_style(k))
    axes.axhspan(LOW_PCT, 10.0, **{**BAND, "alpha": 0.18})
    axes.axvline(axis.values.index(axis.nominal), **EVENT_LINE)
    axes.set_xticks(places)
    axes.set_xticklabels([plain(value, 4) for value in axis.values])
    axes.minorticks_off()
