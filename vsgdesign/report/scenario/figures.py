"""Every figure of a scenario; powers, voltage and frequency, with zooms on the events that matter most."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.report.drawing.figures import NamedFigure, WrittenFigure, write_all, write_figure
from vsgdesign.report.drawing.style import BAND, LABEL_PT, LIMITS_BAND, REFERENCE, line_style, look
from vsgdesign.report.drawing.time_axis import (
    LETTERS,
    Row,
    RunFigure,
    Trace,
    View,
    Zoom,
    envelope,
    extreme_indices,
    run_figure,
    short_name,
    symbols,
)
from vsgdesign.report.scenario.bode_figures import bode_figures
from vsgdesign.report.scenario.field_figures import field_figures
from vsgdesign.report.scenario.outcomes import ends_of_stretches
from vsgdesign.report.scenario.schedule_figures import estimate_figures, schedule_figures
from vsgdesign.report.scenario.signals import Signal, events_of, signals
from vsgdesign.simulation.scenario import ScenarioResult
from vsgdesign.study.parameters.study import Event

if TYPE_CHECKING:
    from vsgdesign.estimator.trained import TrainedEstimator

_MOST_ZOOMS = 4
_PIXELS_PER_IN = 100.0
_HIDING_RIPPLE = 0.004
"""Ripple, relative to the drawn range, above which it hides the mean."""
_LEAST_MOVE = 0.05
"""Share of the smallest axis range by which an event must move a signal to be enlarged."""
_COLUMNS_FOR_ALL = 300.0
"""Columns per inch that all curves of one axis share: keeps files small with many controllers."""


@dataclass(frozen=True)
class EventZoom(Zoom):
    """A stretch of time around one event. ``is_step``: whether the event steps this signal's own reference."""

    event: Event = field(kw_only=True)
    is_step: bool = field(kw_only=True)


def all_figures(result: ScenarioResult, trained: TrainedEstimator | None = None) -> Iterator[NamedFigure]:
    """Every figure of a scenario, and of the training of its network, one at a time."""
    yield from _figures_of_runs(result, trained)
    yield from bode_figures(result)


def _figures_of_runs(result: ScenarioResult, trained: TrainedEstimator | None) -> Iterator[NamedFigure]:
    yield from scenario_figures(result)
    yield from estimate_figures(result)
    yield from field_figures(result)
    if trained is not None:
        from vsgdesign.report.estimator.training import training_figures

        yield from training_figures(trained)


def begin_all(
    result: ScenarioResult,
    folder: Path,
    trained: TrainedEstimator | None = None,
    executor: Executor | None = None,
) -> Callable[[], list[WrittenFigure]]:
    """Begins to write every figure of a scenario into a folder (made if missing), and returns what waits for them.

    Workers of an ``executor`` draw what is laid out here: this takes three quarters of the time. Bode plots are begun
    when the figures are waited for: python-control is loaded for them while the workers are still busy. Without an
    executor a figure is written before the next one is laid out.
    """
    if executor is None:
        figures = write_all(all_figures(result, trained), folder)
        return lambda: figures
    from vsgdesign.execution.jobs import begun

    folder.mkdir(parents=True, exist_ok=True)
    waits = [begun(executor, write_figure, figure, folder) for figure in _figures_of_runs(result, trained)]

    def written() -> list[WrittenFigure]:
        last = [begun(executor, write_figure, figure, folder) for figure in bode_figures(result)]
        return [wait() for wait in [*waits, *last]]

    return written


def scenario_figures(result: ScenarioResult) -> Iterator[NamedFigure]:
    """P, Q, V, frequency, grid impedance and gains of a scenario, each made when it is asked for."""
    for signal in signals(result):
        yield signal_figure(result, signal)
    yield from schedule_figures(result)


@look()
def signal_figure(result: ScenarioResult, signal: Signal) -> NamedFigure:
    """One signal: the whole scenario on top, the events below at their own scale."""
    zooms = choose_zooms(result, signal)
    name, unit = signal.axis_label, signal.unit
    second = functools.partial(_per_unit_axis, signal.per_unit) if signal.per_unit else None
    row = Row(
        f"{name} [{unit}]",
        functools.partial(_draw, result, signal),
        f"{name.partition(',')[0]} [{unit}]",
        second,
    )
    return run_figure(
        RunFigure(
            name=signal.name,
            title=signal.title,
            caption=_caption(result, signal, zooms),
            duration_s=result.study.simulation.duration,
            events=result.study.events,
            columns=[[row]],
            zooms=[zooms],
            entries=_legend_entries(result, signal),
        )
    )


def choose_zooms(result: ScenarioResult, signal: Signal) -> tuple[EventZoom, ...]:
    """The signal's own reference steps first, then the events that move it most, in order of time."""
    ends, ranked = ends_of_stretches(result.study), []
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
    for is_step, _, event in chosen:
        end_s = min(event.t_s + interesting_time(result, event, ends[event.t_s]), ends[event.t_s])
        begin_s = max(event.t_s - 0.08 * (end_s - event.t_s), 0.0)
        zooms.append(EventZoom(begin_s, end_s, short_name(event), event.t_s, event=event, is_step=is_step))
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


def _draw(result: ScenarioResult, signal: Signal, axes: Any, view: View) -> None:
    """The curves, what they should follow, and their limits, in the whole run or around one event."""
    zoom = view.zoom
    traces = _shown(signal, zoom)
    if isinstance(zoom, EventZoom) and zoom.is_step:
        _draw_step_bands(axes, result, signal, zoom)
    draw_traces(axes, signal, view, traces)
    if zoom is None:
        _draw_target(axes, signal, view)
        low, high = _limits(axes, signal)
    else:
        low, high = _limits(axes, signal)
        axes.set_ylim(low, high)
        _draw_target(axes, signal, view)
        low, high = _with_near_target(signal, zoom, low, high)
    if signal.band is not None:
        axes.axhspan(*signal.band, **LIMITS_BAND)
        span = high - low
        # Limits just outside the data are worth showing, far ones would flatten the curves.
        for limit in signal.band if zoom is None else ():
            low = min(low, limit - 0.05 * span) if limit > low - 1.0 * span else low
            high = max(high, limit + 0.05 * span) if limit < high + 1.0 * span else high
    axes.set_ylim(low, high)


def _shown(signal: Signal, zoom: Zoom | None) -> Sequence[Trace]:
    return signal.traces if zoom is None else [trace.between(zoom.begin_s, zoom.end_s) for trace in signal.traces]


def _draw_target(axes: Any, signal: Signal, view: View) -> None:
    if signal.target is not None:
        t_s, values = signal.target
        axes.plot(view.place(t_s), values, **REFERENCE)


def _with_near_target(signal: Signal, zoom: Zoom, low: float, high: float) -> tuple[float, float]:
    """Limits with the reference inside. One far away (a ramp elsewhere in the scenario) does not set the scale."""
    if signal.target is None:
        return low, high
    t_s, values = signal.target
    seen = values[(t_s >= zoom.begin_s) & (t_s <= zoom.end_s)]
    lowest, highest = min([low, *seen]), max([high, *seen])
    room = 0.04 * (highest - lowest)
    return (lowest - room if lowest < low else low), (highest + room if highest > high else high)


def draw_traces(axes: Any, signal: Signal, view: View, traces: Sequence[Trace]) -> None:
    """Draw every controller's curve; for large ripple, a light envelope and the dark mean."""
    columns = round(view.width_in * min(_PIXELS_PER_IN, _COLUMNS_FOR_ALL / len(traces)))
    rippled = _is_rippled(signal, traces)
    for index, trace in enumerate(traces):
        if not len(trace.y):  # a simulation that had diverged before
            continue
        style = line_style(index)
        t = view.place(trace.t)
        if rippled:
            axes.fill_between(*envelope(t, trace.y, columns), color=style["color"], alpha=0.25, linewidth=0.3, zorder=2)
        y = trace.mean if rippled else trace.y
        picks = extreme_indices(y, columns)
        axes.plot(t[picks], y[picks], zorder=3 + 0.01 * index, **style)


def _is_rippled(signal: Signal, traces: Sequence[Trace]) -> bool:
    """Whether the ripple is so large beside what is drawn that it would hide the mean."""
    drawn_range = max([signal.smallest_range, *(float(np.ptp(trace.y)) for trace in traces if len(trace.y))])
    return any(trace.ripple > _HIDING_RIPPLE * drawn_range for trace in traces)


def _limits(axes: Any, signal: Signal) -> tuple[float, float]:
    low, high = axes.get_ylim()
    whole = [trace.y for trace in signal.traces if not trace.broken]
    if whole and len(whole) < len(signal.traces):  # a simulation that diverged must not set the scale
        low, high = min(float(y.min()) for y in whole), max(float(y.max()) for y in whole)
        low, high = low - 0.05 * (high - low), high + 0.05 * (high - low)
    missing = signal.smallest_range - (high - low)
    return (low - 0.5 * missing, high + 0.5 * missing) if missing > 0.0 else (low, high)


def _draw_step_bands(axes: Any, result: ScenarioResult, signal: Signal, zoom: EventZoom) -> None:
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


def _per_unit_axis(per_unit: float, axes: Any) -> None:
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


def _caption(result: ScenarioResult, signal: Signal, zooms: Sequence[EventZoom]) -> str:
    parts = [f"{signal.caption}."]
    if zooms:
        names = ", ".join(
            f"({letter}) {zoom.event.name} at {zoom.event.t_s:g} s"
            for letter, zoom in zip(LETTERS, zooms, strict=False)
        )
        more = len({event.t_s for event in result.study.events}) - len(zooms)
        rest = f"; {more} other event{'s' if more > 1 else ''} not enlarged" if more > 0 else ""
        parts.append(f"Top: the whole scenario; below: the stretches marked on its time axis, enlarged, {names}{rest}.")
    if any(zoom.is_step for zoom in zooms):
        parts.append(
            "Bands: ±2 % of the step about the value that the response ends at, in a controller's colour where the "
            "controllers end apart."
        )
    if any(_is_rippled(signal, _shown(signal, zoom)) for zoom in (None, *zooms)):
        parts.append("Light: range of the instantaneous value; dark: its mean over the preceding cycle.")
    return " ".join(parts)
