"""Powers, voltage and frequency over a whole scenario, with zooms on the events that matter most."""

from __future__ import annotations

import functools
import operator
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.parameters.study import Event
from vsgdesign.report.drawing.decimation import Trace, envelope, extreme_indices
from vsgdesign.report.drawing.style import (
    BAND,
    LABEL_PT,
    LIMITS_BAND,
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
    EventLabels,
    TimeUnit,
    draw_labels,
    event_labels,
    mark_events,
    short_name,
    symbols,
    time_unit,
    whole_scenario,
)
from vsgdesign.report.figure_types import NamedFigure
from vsgdesign.report.scenario.schedule_figures import schedule_figures
from vsgdesign.report.scenario.signals import Signal, events_of, signals
from vsgdesign.simulation import ScenarioResult

_LEFT, _RIGHT, _BOTTOM = 0.58, 0.13, 0.36
_RIGHT_WITH_PU = 0.52
_MAIN_HEIGHT, _ZOOM_HEIGHT, _BETWEEN = 1.75, 1.25, 0.56
_LEGEND_ROW = 0.15
_MOST_ZOOMS = 4
_PIXELS_PER_IN = 100.0
_HIDING_RIPPLE = 0.004
"""Ripple, relative to the drawn range, above which it hides the mean."""
_LEAST_MOVE = 0.05
"""Share of the smallest axis range by which an event must move a signal to be enlarged."""
_COLUMNS_FOR_ALL = 300.0
"""Columns per inch that all curves of one axis share: keeps files small with many controllers."""


@dataclass(frozen=True)
class Zoom:
    """A stretch of time around one event. ``letter`` ties its panel to the overview."""

    event: Event
    letter: str
    begin_s: float
    end_s: float
    is_step: bool
    """Whether the event steps this signal's own reference."""


def scenario_figures(result: ScenarioResult) -> Iterator[NamedFigure]:
    """P, Q, V, frequency, grid impedance and gains of a scenario, each made when it is asked for."""
    for signal in signals(result):
        yield signal_figure(result, signal)
    yield from schedule_figures(result)


def signal_figure(result: ScenarioResult, signal: Signal) -> NamedFigure:
    """One signal: the whole scenario on top, the events below at their own scale."""
    with look():
        return _signal_figure(result, signal)


def _signal_figure(result: ScenarioResult, signal: Signal) -> NamedFigure:
    study = result.study
    duration = study.simulation.duration
    zooms = choose_zooms(result, signal)
    right = _RIGHT_WITH_PU if signal.per_unit else _RIGHT
    width = PAGE_IN - _LEFT - right
    letters = {zoom.event.t_s: f"({zoom.letter}) " for zoom in zooms}
    labels = event_labels([(e.t_s, letters.get(e.t_s, "") + short_name(e)) for e in study.events], duration, width)
    entries = _legend_entries(result, signal)
    columns, rows = _legend_shape([label for _, label in entries], width)
    below = _BOTTOM + (_ZOOM_HEIGHT + _BETWEEN if zooms else 0.0)
    top = labels.height_in + rows * _LEGEND_ROW + 0.12
    height = below + _MAIN_HEIGHT + top
    figure = new_figure(PAGE_IN, height)
    axes = add_axes(figure, _LEFT, below, width, _MAIN_HEIGHT)
    unit = time_unit(duration)
    rippled = _draw_main(axes, signal, zooms, study.events, labels, unit, width)
    whole_scenario(axes, duration, unit)
    axes.set_ylabel(f"{signal.axis_label} [{signal.unit}]")
    if signal.per_unit:
        _per_unit_axis(axes, signal.per_unit)
    for index, zoom in enumerate(zooms):
        gap = 0.46
        panel = min((width - gap * (len(zooms) - 1)) / len(zooms), 3.2)
        place = add_axes(figure, _LEFT + index * (panel + gap), _BOTTOM, panel, _ZOOM_HEIGHT)
        rippled |= _draw_zoom(place, result, signal, zoom, panel, first=index == 0)
    figure.legend(
        *zip(*entries, strict=True),
        ncols=columns,
        loc="upper left",
        bbox_to_anchor=(_LEFT / PAGE_IN, 1.0 - 0.04 / height),
    )
    return NamedFigure(signal.name, signal.title, _caption(result, signal, zooms, labels, rippled), figure)


def choose_zooms(result: ScenarioResult, signal: Signal) -> tuple[Zoom, ...]:
    """The signal's own reference steps first, then the events that move it most, in order of time."""
    duration = result.study.simulation.duration
    starts = sorted({event.t_s for event in result.study.events})
    ends = dict(zip(starts, [*starts[1:], duration], strict=False))
    ranked = []
    for event in {event.t_s: event for event in result.study.events}.values():
        is_step = any(
            (metrics := events_of(controller, signal.metrics_name or "").get(event.t_s)) is not None
            and metrics.kind == "step"
            for controller in result.controllers
        )
        moved = max((_moved(trace, event.t_s, ends[event.t_s]) for trace in signal.traces), default=0.0)
        if moved > _LEAST_MOVE * signal.smallest_range:
            ranked.append((is_step, moved, event))
    ranked.sort(key=lambda item: (item[0], item[1]), reverse=True)
    chosen = sorted(ranked[:_MOST_ZOOMS], key=lambda item: item[2].t_s)
    zooms = []
    for letter, (is_step, _, event) in zip("abcdefgh", chosen, strict=False):
        end_s = min(event.t_s + interesting_time(result, event, ends[event.t_s]), ends[event.t_s])
        begin_s = max(event.t_s - 0.08 * (end_s - event.t_s), 0.0)
        zooms.append(Zoom(event, letter, begin_s, end_s, is_step))
    return tuple(zooms)


def _moved(trace: Trace, begin_s: float, end_s: float) -> float:
    """How far the mean travels in a window; zero where there is too little to draw."""
    part = trace.between(begin_s, end_s)
    return float(np.ptp(part.mean)) if len(part.t) > 4 else 0.0


def interesting_time(result: ScenarioResult, event: Event, end_s: float) -> float:
    """The time until every controller has settled, and half as long again, but at least five cycles."""
    longest = 0.0
    for controller in result.controllers:
        for signal in ("P_pcc", "Q_pcc"):
            metrics = events_of(controller, signal).get(event.t_s)
            if metrics is not None:
                settled = metrics.cycle_mean.settling_time_s
                longest = max(longest, end_s - event.t_s if settled is None else settled)
    cycle = 2.0 * np.pi / result.study.converter.omega_n
    return max(1.5 * longest, event.over * 1.2, 5.0 * cycle)


def _draw_main(
    axes: Any,
    signal: Signal,
    zooms: Sequence[Zoom],
    events: Sequence[Event],
    labels: EventLabels,
    unit: TimeUnit,
    width_in: float,
) -> bool:
    for zoom in zooms:
        axes.axvspan(zoom.begin_s / unit.seconds, zoom.end_s / unit.seconds, ymax=0.03, **ZOOM_SPAN)
    mark_events(axes, [event.t_s for event in events], unit)
    draw_labels(axes, labels, unit)
    rippled = draw_traces(axes, signal, 0.0, unit, width_in, signal.traces)
    if signal.target is not None:
        t_s, values = signal.target
        axes.plot(t_s / unit.seconds, values, **REFERENCE)
    low, high = _limits(axes, signal)
    if signal.band is not None:
        axes.axhspan(*signal.band, **LIMITS_BAND)
        span = high - low
        # Limits just outside the data are worth showing, far ones would flatten the curves.
        for limit in signal.band:
            low = min(low, limit - 0.05 * span) if limit > low - 1.0 * span else low
            high = max(high, limit + 0.05 * span) if limit < high + 1.0 * span else high
    axes.set_ylim(low, high)
    return rippled


def draw_traces(
    axes: Any, signal: Signal, origin_s: float, unit: TimeUnit, width_in: float, traces: Sequence[Trace]
) -> bool:
    """Draw every controller's curve; for large ripple, a light envelope and the dark mean. Returns whether it is
    large.
    """
    columns = round(width_in * min(_PIXELS_PER_IN, _COLUMNS_FOR_ALL / len(traces)))
    drawn_range = max([signal.smallest_range, *(float(np.ptp(trace.y)) for trace in traces if len(trace.y))])
    rippled = any(trace.ripple > _HIDING_RIPPLE * drawn_range for trace in traces)
    for index, trace in enumerate(traces):
        if not len(trace.y):  # a simulation that had diverged before
            continue
        style = line_style(index)
        t = (trace.t - origin_s) / unit.seconds
        if rippled:
            axes.fill_between(*envelope(t, trace.y, columns), color=style["color"], alpha=0.25, linewidth=0.3, zorder=2)
        y = trace.mean if rippled else trace.y
        picks = extreme_indices(y, columns)
        axes.plot(t[picks], y[picks], zorder=3 + 0.01 * index, **style)
    return rippled


def _limits(axes: Any, signal: Signal) -> tuple[float, float]:
    low, high = axes.get_ylim()
    whole = [trace.y for trace in signal.traces if not trace.broken]
    if whole and len(whole) < len(signal.traces):  # a simulation that diverged must not set the scale
        low, high = min(float(y.min()) for y in whole), max(float(y.max()) for y in whole)
        low, high = low - 0.05 * (high - low), high + 0.05 * (high - low)
    missing = signal.smallest_range - (high - low)
    return (low - 0.5 * missing, high + 0.5 * missing) if missing > 0.0 else (low, high)


def _draw_zoom(axes: Any, result: ScenarioResult, signal: Signal, zoom: Zoom, width_in: float, first: bool) -> bool:
    unit = time_unit(zoom.end_s - zoom.event.t_s)
    origin = zoom.event.t_s
    parts = [trace.between(zoom.begin_s, zoom.end_s) for trace in signal.traces]
    if zoom.is_step:
        _draw_step_bands(axes, result, signal, zoom)
    rippled = draw_traces(axes, signal, origin, unit, width_in, parts)
    axes.set_ylim(*_limits(axes, signal))
    if signal.target is not None:
        limits = axes.get_ylim()
        t_s, values = signal.target
        axes.plot((t_s - origin) / unit.seconds, values, **REFERENCE)
        # A reference far away (a ramp elsewhere in the scenario) must not set the scale; a near one may.
        seen = values[(t_s >= zoom.begin_s) & (t_s <= zoom.end_s)]
        low, high = min([limits[0], *seen]), max([limits[1], *seen])
        room = 0.04 * (high - low)
        axes.set_ylim(low - room if low < limits[0] else low, high + room if high > limits[1] else high)
    if signal.band is not None:
        limits = axes.get_ylim()
        axes.axhspan(*signal.band, **LIMITS_BAND)
        axes.set_ylim(limits)
    mark_events(axes, [0.0], unit)
    axes.set_xlim((zoom.begin_s - origin) / unit.seconds, (zoom.end_s - origin) / unit.seconds)
    axes.set_xlabel(f"Time after event [{unit.symbol}]")
    axes.set_title(symbols(_fitting(f"({zoom.letter}) {short_name(zoom.event)}", width_in)))
    axes.locator_params(axis="x", nbins=max(int(width_in / 0.28), 2))
    axes.locator_params(axis="y", nbins=5)
    if first:
        axes.set_ylabel(f"{signal.axis_label.partition(',')[0]} [{signal.unit}]")
    return rippled


def _fitting(text: str, width_in: float) -> str:
    room = max(int((width_in + 0.3) / text_width("x")), 6)
    return text if len(text) <= room else text[: room - 1] + "…"


def _draw_step_bands(axes: Any, result: ScenarioResult, signal: Signal, zoom: Zoom) -> None:
    """The ±2 % band of the step about each final value; one grey band where the controllers end together."""
    bands = []
    for index, controller in enumerate(result.controllers):
        metrics = events_of(controller, signal.metrics_name or "").get(zoom.event.t_s)
        # Without an end that it has come to there is no band to draw.
        if metrics is None or metrics.kind != "step" or metrics.cycle_mean.settling_time_s is None:
            continue
        end, initial = metrics.raw.final, metrics.raw.initial
        if end is None:
            continue
        final = end / signal.si_factor
        half = SETTLING_BAND * abs(end - initial) / signal.si_factor
        bands.append((final, half, line_style(index)["color"]))
    together = all(abs(final - bands[0][0]) < 0.25 * half for final, half, _ in bands)
    for final, half, colour in bands[:1] if together else bands:
        style = BAND if together else {**BAND, "color": colour, "alpha": 0.25}
        axes.axhspan(final - half, final + half, **style)


def _per_unit_axis(axes: Any, per_unit: float) -> None:
    # No lambdas: the figure may be sent to another process.
    functions = functools.partial(_in_per_unit, per_unit), functools.partial(operator.mul, per_unit)
    second = axes.secondary_yaxis("right", functions=functions)
    second.set_ylabel("[pu]", fontsize=LABEL_PT)


def _in_per_unit(per_unit: float, y: Any) -> Any:
    return y / per_unit


def _legend_entries(result: ScenarioResult, signal: Signal) -> list[tuple[Any, str]]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: list[tuple[Any, str]] = [
        (Line2D([], [], **line_style(index)), symbols(controller.spec.name))
        for index, controller in enumerate(result.controllers)
    ]
    if signal.target is not None:
        entries.append((Line2D([], [], **REFERENCE), signal.target_label))
    if signal.metrics_name is not None and any(
        event.kind == "step" and event.signal == signal.metrics_name for c in result.controllers for event in c.events
    ):
        entries.append((Patch(**{**BAND, "zorder": 1}), "±2 % of the step"))
    if signal.band is not None:
        entries.append((Patch(**LIMITS_BAND), signal.band_label))
    return entries


def _legend_shape(labels: Sequence[str], width_in: float) -> tuple[int, int]:
    """(columns, rows) of a legend that stays within the axes' width."""
    widest = max(text_width(label) for label in labels) + 0.55
    columns = max(min(int(width_in / widest), len(labels)), 1)
    return columns, -(-len(labels) // columns)


def _caption(result: ScenarioResult, signal: Signal, zooms: Sequence[Zoom], labels: EventLabels, rippled: bool) -> str:
    parts = [f"{signal.caption}."]
    if zooms:
        names = ", ".join(f"({zoom.letter}) {zoom.event.name} at {zoom.event.t_s:g} s" for zoom in zooms)
        more = len({event.t_s for event in result.study.events}) - len(zooms)
        rest = f"; {more} other event{'s' if more > 1 else ''} not enlarged" if more > 0 else ""
        parts.append(f"Top: the whole scenario; below: the stretches marked on its time axis, enlarged, {names}{rest}.")
    if any(zoom.is_step for zoom in zooms):
        parts.append(
            "Bands: ±2 % of the step about the value that the response ends at, in a controller's colour where the "
            "controllers end apart."
        )
    if rippled:
        parts.append("Light: range of the instantaneous value; dark: its mean over the preceding cycle.")
    if labels.numbered:
        parts.append("Numbers above the axes: events as numbered in the study.")
    return " ".join(parts)
