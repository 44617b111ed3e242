"""The quantities that are drawn over a scenario, taken from its results."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.dc_sources.converter import UNLIMITED_J
from vsgdesign.equations.frames import clarke, peak_to_rms
from vsgdesign.metrics import EventMetrics, cycle_mean
from vsgdesign.metrics.answers import Answers, answers_of
from vsgdesign.report.drawing.quantities import prefix_for
from vsgdesign.report.drawing.time_axis import Trace, ripple_level
from vsgdesign.simulation.scenario import ControllerResult, ScenarioResult, samples_per_mean
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.grid import Grid

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Signal:
    """One quantity of all controllers, in a unit fit for an axis."""

    name: str
    title: str
    axis_label: str
    unit: str
    caption: str
    traces: tuple[Trace, ...]
    smallest_range: float
    """The axis spans at least this much, so that rounding errors are not blown up."""
    target: tuple[Array, Array] | None = None
    """(t_s, value) of what the quantity should follow, as a polygon line."""
    target_label: str = "reference"
    band: tuple[float, float] | None = None
    band_label: str = ""
    per_unit: float | None = None
    """Value of one pu, for a second axis."""
    metrics_name: str | None = None
    """The signal of the event metrics, for the bands of steps."""
    si_factor: float = 1.0


def signals(result: ScenarioResult) -> Iterator[Signal]:
    """Active power, reactive power, voltage and frequency, one after the other."""
    yield from power_signals(result)
    yield _voltage(result)
    yield _frequency(result)
    if result.study.dc is not None:
        yield _dc_link(result.study.dc, result)
        yield from _charge(result.study.dc, result)


def power_signals(result: ScenarioResult) -> Iterator[Signal]:
    """Active power and reactive power."""
    yield _power(result, "P_pcc", "active_power", "Active power", "W")
    yield _power(result, "Q_pcc", "reactive_power", "Reactive power", "var")


def events_of(controller: ControllerResult, signal: str) -> dict[float, EventMetrics]:
    """The figures of one signal by the time of their event."""
    return {event.t_s: event for event in controller.events if event.signal == signal}


def _traces(result: ScenarioResult, values: list[Array], factor: float, power: str = "") -> tuple[Trace, ...]:
    """``power``: the name of the power that it is. The mean of a power comes from every sample."""
    traces = []
    for controller, y in zip(result.controllers, values, strict=True):
        t = controller.series["t_s"]
        scaled = y / factor
        mean = controller.means[power] / factor if power else cycle_mean(scaled, samples_per_mean(result.study, t))
        ripple = ripple_level(scaled, mean) if controller.ripples else 0.0
        traces.append(Trace(t, scaled, mean, ripple, controller.simulation.divergence is not None))
    return tuple(traces)


_AT_REST = {
    "P_pcc": "At rest the droop adds D_p·(ω_n − ω_g) to the reference",
    "Q_pcc": "At rest the droop adds D_q·(V_n − V) to the reference, which is reached at nominal voltage only",
}
"""What a reader needs to see that a power beside its reference is no error."""


def _power(result: ScenarioResult, series: str, name: str, title: str, unit: str) -> Signal:
    values = [controller.series[series] for controller in result.controllers]
    to_the_end = [y for c, y in zip(result.controllers, values, strict=True) if c.simulation.divergence is None]
    largest = max(float(np.max(np.abs(y))) for y in to_the_end or values)
    factor, prefix = prefix_for(largest)
    column = 0 if series == "P_pcc" else 1
    changes = result.timeline.references
    t_ref, reference = _staircase([t_s for t_s, _ in changes], [refs[column] for _, refs in changes], _duration(result))
    return Signal(
        name=name,
        title=title,
        axis_label=title,
        unit=f"{prefix}{unit}",
        caption=f"{title} at the point of common coupling, positive into the grid. {_AT_REST[series]}",
        traces=_traces(result, values, factor, series),
        smallest_range=0.01 * result.study.converter.S_rated / factor,
        target=(t_ref, reference / factor),
        metrics_name=series,
        si_factor=factor,
    )


def _voltage(result: ScenarioResult) -> Signal:
    values = []
    for controller in result.controllers:
        series = controller.series
        alpha, beta = clarke(series["v_pcc_a"], series["v_pcc_b"], series["v_pcc_c"])
        values.append(peak_to_rms(np.hypot(alpha, beta)))
    converter = result.study.converter
    factor, prefix = prefix_for(converter.V_rated_rms)
    low, high = converter.V_limits_rms
    return Signal(
        name="voltage",
        title="Voltage",
        axis_label="Voltage, phase rms",
        unit=f"{prefix}V",
        caption="Phase voltage at the point of common coupling (rms, from the length of the voltage vector)",
        traces=_traces(result, values, factor),
        smallest_range=0.01 * converter.V_rated_rms / factor,
        band=(low / factor, high / factor),
        band_label=f"limits {converter.V_min_pu:g} … {converter.V_max_pu:g} pu",
        per_unit=converter.V_rated_rms / factor,
        si_factor=factor,
    )


def _frequency(result: ScenarioResult) -> Signal:
    turn = 2.0 * math.pi
    values = [controller.series["omega"] / turn for controller in result.controllers]
    return Signal(
        name="frequency",
        title="Frequency",
        axis_label="Frequency",
        unit="Hz",
        caption="Frequency of each converter's power loop",
        traces=_traces(result, values, 1.0),
        smallest_range=0.01,
        target=source_frequency(result),
        target_label="grid source",
    )


def _dc_link(link: DcLink, result: ScenarioResult) -> Signal:
    factor, prefix = prefix_for(result.study.converter.V_dc)
    return Signal(
        name="dc_link",
        title="dc link",
        axis_label="Voltage of the dc link",
        unit=f"{prefix}V",
        caption="Voltage of the dc link. Outside the band the bridge blocks",
        traces=_traces(result, [controller.series["v_dc"] for controller in result.controllers], factor),
        smallest_range=0.01 * result.study.converter.V_dc / factor,
        band=(link.V_low / factor, link.V_high / factor),
        band_label="limits of the link",
        si_factor=factor,
    )


def _charge(link: DcLink, result: ScenarioResult) -> Iterator[Signal]:
    """The state of charge of the source; nothing for one without a charge or without a limit of its energy."""
    study = result.study
    if link.kind.recharged is None or link.values.get("energy", 0.0) >= UNLIMITED_J:
        return
    ((name, full),) = link.kind.recharged(1.0, link.settings(study.converter, study.filter).source).items()
    values = [100.0 * controller.series[f"dc_{name}"] / full for controller in result.controllers]
    yield Signal(
        name="dc_charge",
        title="charge",
        axis_label="State of charge",
        unit="%",
        caption="State of charge of the source of the dc link",
        traces=_traces(result, values, 1.0),
        smallest_range=0.1,
    )


_MEAN_S = 0.1
"""Over how long the frequency of a source that wanders is averaged, s: its phase is noisy."""


def source_frequency(result: ScenarioResult) -> tuple[Array, Array]:
    """Corners of the source's frequency (s, Hz): as the events say, and with what a background or a record adds."""
    turn, timeline, end = 2.0 * math.pi, result.timeline, _duration(result)
    t_grid: list[float] = []
    f_grid: list[float] = []
    ends = [source.t_s for source in timeline.sources[1:]] + [end]
    for source, end_s in zip(timeline.sources, ends, strict=True):
        t_grid += [source.t_s, end_s]
        f_grid += [source.omega / turn, (source.omega + source.omega_slope * (end_s - source.t_s)) / turn]
    moving = timeline.wander or timeline.replay
    if moving is None or end < 2.0 * _MEAN_S:
        return np.array(t_grid), np.array(f_grid)
    edges = np.arange(0, math.floor(end / _MEAN_S) + 1) * round(_MEAN_S / moving.T_s)
    own = np.diff(moving.angle_at(edges[edges * moving.T_s < end])) / (turn * _MEAN_S)
    t_s: Array = (np.arange(len(own), dtype=np.float64) + 0.5) * _MEAN_S
    return t_s, np.array([timeline.source_at(t).omega / turn for t in t_s]) + own


def _duration(result: ScenarioResult) -> float:
    return result.study.simulation.duration


def _staircase(times: list[float], values: list[float], end_s: float) -> tuple[Array, Array]:
    """Corners of a piecewise constant quantity up to ``end_s``."""
    edges = [*times, end_s]
    t = np.repeat(edges, 2)[1:-1]
    return t, np.repeat(np.asarray(values, dtype=float), 2)


SETTLE_S = 4.0
"""From an event to the rest after it, s. What the estimator reaches at rest needs this long."""

LEAST_S = 0.5
"""Shortest rest that says anything, s."""


@dataclass(frozen=True)
class Rest:
    """A stretch of a scenario in which nothing happens."""

    begin_s: float
    end_s: float
    grid: Grid

    def rows(self, t_s: Array) -> NDArray[np.bool_]:
        """Which instants belong to it."""
        return (t_s >= self.begin_s) & (t_s < self.end_s)


def field_controllers(result: ScenarioResult) -> list[tuple[int, ControllerResult]]:
    """Place among all controllers, which gives the colour, and the controllers that have the field estimator."""
    return [
        (k, controller)
        for k, controller in enumerate(result.controllers)
        if controller.estimates is not None and controller.estimates.cycles is not None
    ]


def field_answers(result: ScenarioResult, controller: ControllerResult) -> Answers:
    """The answers of a controller with the field estimator, as the metrics take them."""
    log = controller.estimates
    if log is None or log.cycles is None:
        raise ValueError(f"{controller.spec.name} has no field estimator")
    said = log.cycles
    return answers_of(
        log.t_s,
        (log.R_g, log.L_g),
        (log.R_g_hat, log.L_g_hat),
        (said.var_R, said.cov_RL, said.var_L),
        np.asarray(said.valid) > 0.5,
        np.asarray(said.changed) > 0.5,
        omega_n=result.study.converter.omega_n,
        end_s=result.study.simulation.duration,
    )


def rests_of(result: ScenarioResult) -> tuple[Rest, ...]:
    """From ``SETTLE_S`` after each event, or after the start, to the next event or the end, while the grid
    is there."""
    duration = result.study.simulation.duration
    edges = [0.0, *sorted({event.t_s for event in result.study.events if 0.0 < event.t_s < duration}), duration]
    return tuple(
        Rest(begin + SETTLE_S, end, result.timeline.grid_at(begin + SETTLE_S))
        for begin, end in itertools.pairwise(edges)
        if end - begin >= SETTLE_S + LEAST_S and result.timeline.network_at(begin).connected
    )


def valid_at_rest(result: ScenarioResult, answers: Answers) -> NDArray[np.bool_]:
    """Which answers are valid and belong to a rest."""
    at_rest = np.zeros(len(answers.t_s), dtype=bool)
    for rest in rests_of(result):
        at_rest |= answers.rows(rest.begin_s, rest.end_s)
    return at_rest & answers.valid
