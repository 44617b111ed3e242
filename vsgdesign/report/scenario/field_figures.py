"""The field estimator on the pages of a scenario: its answers, the rests, and what the probe costs there; the grid with
its 95 % band, errors after changes, coverage, and the probe as figures.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.errors import share_percent
from vsgdesign.metrics import cycle_mean
from vsgdesign.metrics.answers import (
    FOUND,
    Answers,
    coverage,
    inside_ellipse,
    polar_band,
    share_valid,
    time_to_stay,
)
from vsgdesign.metrics.oscillation import interharmonic_rms, ripple_rms
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.look import round_decades
from vsgdesign.report.drawing.quantities import DASH, number, plain, plain_quantity
from vsgdesign.report.drawing.style import COLOURS, PAGE_IN, REFERENCE, add_axes, line_style, look, new_figure
from vsgdesign.report.drawing.time_axis import Row, RunFigure, View, legend, run_figure, symbols
from vsgdesign.report.page.blocks import Table
from vsgdesign.report.page.converter import grid_label
from vsgdesign.report.scenario.schedule_figures import change_zooms
from vsgdesign.report.scenario.signals import SETTLE_S, Rest, field_answers, field_controllers, rests_of, valid_at_rest
from vsgdesign.simulation.scenario import ControllerResult, ScenarioResult, samples_per_mean
from vsgdesign.simulation.scenario.judging import same_with_truth

Array = NDArray[np.float64]


def answers_table(result: ScenarioResult, controller: ControllerResult) -> Table:
    """Accuracy and coverage of each rest, and what the probe costs there."""
    answers, truth = field_answers(result, controller), same_with_truth(result, controller)
    rows = []
    for rest in rests_of(result):
        chosen = answers.rows(rest.begin_s, rest.end_s) & answers.valid
        error = 100.0 * answers.error[chosen]
        costs = [None if one is None else _cost(result, one, rest) for one in (controller, truth)]
        rows.append(
            (
                f"{plain(rest.begin_s, 5)} … {plain(rest.end_s, 5)}",
                grid_label(result, rest.grid),
                number(float(np.percentile(error, 95.0)), 2) if error.size else DASH,
                number(100.0 * coverage(answers, chosen), 3) if error.size else DASH,
                number(100.0 * share_valid(answers, rest.begin_s, rest.end_s), 3),
                *(DASH if cost is None else number(cost[k], 2) for k in range(3) for cost in costs),
            )
        )
    head = ("Time [s]", "Grid", "p95", "Truth inside", "Valid", *(("with", "without") * 3))
    f_n = result.study.converter.omega_n / (2.0 * math.pi)
    groups = (
        ("", 2),
        ("Error, coverage, time [%]", 3),
        (f"V, {f_n:g}–{2 * f_n:g} Hz [%]", 2),
        (f"V, {2 * f_n:g}–{3 * f_n:g} Hz [%]", 2),
        ("P, rms ripple [%]", 2),
    )
    beside = "No controller of the study differs by the truth alone and sends no probe."
    if truth is not None:
        beside = f"Without: {truth.spec.name}, which sends no probe."
    notes = (
        f"At rest: from {plain(SETTLE_S)} s after an event on. p95: 95th percentile of |Ẑ − Z|/|Z| of the valid "
        "answers. Truth inside: share of them whose 95 % ellipse holds the true grid. V: rms between two harmonics "
        "(centred interharmonic subgroup), of the rated voltage. P: instantaneous, of the rating. V and P come from "
        f"the log, a row every {plain_quantity(result.study.simulation.log_interval, 's')}. {beside}",
    )
    return Table(f"{controller.spec.name} at rest, and its probe", head, tuple(rows), 2, groups=groups, notes=notes)


def answers_text(result: ScenarioResult, controller: ControllerResult) -> str:
    """What the estimate was worth, in three sentences."""
    answers = field_answers(result, controller)
    found = [time_to_stay(answers, change, until) for change, until in _changes(result)]
    chosen = valid_at_rest(result, answers)
    text = f"{controller.spec.name} is lent nothing by the simulator: it hears its own probe in its own sensors."
    if chosen.any():
        most, held = float(np.percentile(answers.error[chosen], 95.0)), coverage(answers, chosen)
        text += (
            f" At rest 95 % of its answers are within {number(100.0 * most, 2)} % of the true Z, and "
            f"{share_percent(held)} of its 95 % ellipses hold it."
        )
    moved = _moved(result, controller)
    if moved > 0.0:
        text += (
            f" Its probe moves P at rest by up to {number(100.0 * moved, 2)} % of the rating (rms of the two-cycle "
            "mean), with a step as without, so that it is no part of the figures of a step."
        )
    if found and max(found) < math.inf:
        times = " and ".join(f"{plain(t, 2)} s" for t in found)
        text += f" After a change of the grid its answers are within 10 % for good from {times} on."
    elif found:
        text += " It did not find every changed grid within 10 % before the next event."
    return text


def _moved(result: ScenarioResult, controller: ControllerResult) -> float:
    """Rms of what is left of P's ripple at rest in the mean that steps are judged on, of the rating: the largest of the
    rests, less that of the same controller with the truth. Zero where there is none."""
    truth = same_with_truth(result, controller)
    if truth is None:
        return 0.0
    found = [0.0]
    for rest in rests_of(result):
        both = []
        for one in (controller, truth):
            t_s = one.simulation.t_s
            mean = cycle_mean(one.simulation.column("P")[rest.rows(t_s)], samples_per_mean(result.study, t_s))
            both.append(ripple_rms(mean[len(mean) // 10 :]) / result.study.converter.S_rated)
        found.append(math.sqrt(max(both[0] ** 2 - both[1] ** 2, 0.0)))
    return max(found)


def _cost(result: ScenarioResult, controller: ControllerResult, rest: Rest) -> tuple[float, float, float]:
    """Voltage beside the harmonics in the two gaps of the probe, and ripple of P, per cent."""
    c, simulation = result.study.converter, controller.simulation
    rows = rest.rows(simulation.t_s)
    t_s = simulation.t_s[rows]
    step = float(t_s[1] - t_s[0])
    f_n = c.omega_n / (2.0 * math.pi)
    frequency = float(np.mean(simulation.column("omega")[rows])) / (2.0 * math.pi)
    v = simulation.column("v_c_alpha")[rows]
    lines = [100.0 * interharmonic_rms(v, step, frequency, order, f_n) / c.V_rated_rms for order in (1, 2)]
    return lines[0], lines[1], 100.0 * ripple_rms(simulation.column("P")[rows]) / c.S_rated


_LEFT, _RIGHT, _BOTTOM = 0.6, 0.13, 0.36
_BEFORE_S, _AFTER_S = 0.1, 0.6
"""Stretch about a change of the grid that is enlarged, s."""

_LATEST_S = 1.0
"""End of the axis of time since a change, s."""

_MOST_ZOOMS = 3
_NOT_VALID: dict[str, Any] = {"facecolor": "#777777"}
_LEVELS = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99])
_HIGHEST_HZ = 420.0
_WINDOW_S = 1.0
"""Length of the windows of the spectrum, s."""


def field_figures(result: ScenarioResult) -> Iterator[NamedFigure]:
    """Impedance, errors and coverage, probe; nothing if no controller has the field estimator."""
    controllers = field_controllers(result)
    if not controllers:
        return
    for make in (_impedance_figure, _error_figure, _probe_figure):
        figure = make(result, controllers)
        if figure is not None:
            yield figure


@look()
def _impedance_figure(result: ScenarioResult, controllers: list[tuple[int, ControllerResult]]) -> NamedFigure:
    """|Z| and arg Z of the first controller with the field estimator."""
    index, controller = controllers[0]
    answers = field_answers(result, controller)
    result = replace(result, timeline=controller.simulation.timeline)  # a breaker may close at an instant of its own
    rows = [
        Row(label, functools.partial(_draw, result, answers, index, kind))
        for kind, label in (("size", "|$Z_g$| [Ω]"), ("angle", "arg $Z_g$ [°]"))
    ]
    caption = (
        f"Magnitude and angle of the grid's impedance at nominal frequency as {controller.spec.name} estimates them, "
        "with the 95 % band of its own covariance, and the truth. Grey at the top: the answer is not valid, and "
        "the gains hold. Below: changes of the grid, enlarged."
    )
    return run_figure(
        RunFigure(
            name="field_impedance",
            title="Estimated impedance with its 95 % band",
            caption=caption,
            duration_s=result.study.simulation.duration,
            events=result.study.events,
            columns=[rows],
            zooms=[change_zooms(result, _BEFORE_S, _AFTER_S)[:_MOST_ZOOMS]],
            entries=_legend_entries(index, controller.spec.name),
        )
    )


def _draw(result: ScenarioResult, answers: Answers, index: int, kind: str, axes: Any, view: View) -> None:
    rows = answers.rows(view.begin_s - 0.05, view.end_s + 0.05)
    arrays = ("t_s", "Z", "Z_hat", "covariance", "valid", "changed")
    answers = replace(answers, **{name: getattr(answers, name)[rows] for name in arrays})
    band = polar_band(answers)
    edges_s = np.append(answers.t_s, max(answers.end_s, answers.t_s[-1]))
    t = view.place(edges_s)
    times, true = _truth(result, edges_s)
    if kind == "size":
        truth, value, half = np.abs(true), band.size, band.size_half
        axes.set_yscale("log")
    else:
        truth, value, half = (np.degrees(x) for x in (np.angle(true), band.angle, band.angle_half))
    known = truth[np.isfinite(truth)] if np.isfinite(truth).any() else value[np.isfinite(value)]
    least, most = (float(known.min()), float(known.max())) if len(known) else (1.0, 1.0)
    low = least / 1.6 if kind == "size" else least - 25.0
    high = most * 1.6 if kind == "size" else most + 25.0
    axes.set_ylim(low, high)
    if kind == "size":
        round_decades(axes.yaxis, "{:g}".format)
    colour = COLOURS[index % len(COLOURS)]
    # A band beyond the axes says no more than one up to their edge.
    edges = (np.clip(np.nan_to_num(x, nan=end), low, high) for x, end in ((value - half, low), (value + half, high)))
    axes.fill_between(
        t, *(np.append(edge, edge[-1]) for edge in edges), step="post", color=colour, alpha=0.25, linewidth=0.0
    )
    axes.step(t, np.append(value, value[-1]), where="post", color=colour, linewidth=0.8, zorder=3.0)
    axes.step(view.place(times), truth, where="post", **REFERENCE)
    silent = [(t[k], t[k + 1] - t[k]) for k in np.flatnonzero(~answers.valid)]
    axes.broken_barh(silent, (0.95, 0.05), transform=axes.get_xaxis_transform(), linewidth=0.0, **_NOT_VALID)


def _truth(result: ScenarioResult, edges_s: Array) -> tuple[Array, NDArray[np.complex128]]:
    """Instants between the first and the last edge from which a grid holds, and its impedance; the end, too. NaN
    while the breaker is open."""
    omega_n = result.study.converter.omega_n
    begin, end = float(edges_s[0]), float(edges_s[-1])
    changes = {t_s for listed in (result.timeline.grids, result.timeline.networks) for t_s, _ in listed}
    times = [begin, *(t_s for t_s in sorted(changes) if begin < t_s < end), end]
    grids = [result.timeline.true_grid_at(t_s) for t_s in times]
    return np.array(times), np.array([complex(grid.R_g, omega_n * grid.L_g) for grid in grids])


@look()
def _error_figure(result: ScenarioResult, controllers: list[tuple[int, ControllerResult]]) -> NamedFigure:
    height, between = 1.7, 0.75
    wide = 0.6 * (PAGE_IN - _LEFT - _RIGHT - between)
    narrow = PAGE_IN - _LEFT - _RIGHT - between - wide
    total = _BOTTOM + height + 0.3
    figure = new_figure(PAGE_IN, total)
    left = add_axes(figure, _LEFT, _BOTTOM, wide, height)
    right = add_axes(figure, _LEFT + wide + between, _BOTTOM, narrow, height)
    for index, controller in controllers:
        answers, label = field_answers(result, controller), symbols(controller.spec.name)
        for change, until in _changes(result):
            rows = np.flatnonzero(answers.rows(change, min(until, change + _LATEST_S)))
            style = line_style(index) | {"linewidth": 0.9}
            since, error = answers.t_s[rows] - change, 100.0 * answers.error[rows]
            left.step(since, np.maximum(error, 0.1), where="post", label=label, **style)
            left.plot(
                since[answers.valid[rows]],
                np.maximum(error[answers.valid[rows]], 0.1),
                linestyle="none",
                marker="o",
                markersize=2.0,
                color=COLOURS[index % len(COLOURS)],
            )
            label = "_nolegend_"
        chosen = valid_at_rest(result, answers)
        if chosen.any():
            shares = [100.0 * float(np.mean(inside_ellipse(answers, level)[chosen])) for level in _LEVELS]
            right.plot(100.0 * _LEVELS, shares, marker="o", markersize=2.0, **line_style(index))
    left.set_yscale("log")
    left.set_xlim(0.0, _LATEST_S)
    left.axhline(100.0 * FOUND, **REFERENCE)
    left.set_xlabel("Time since a change of the grid [s]")
    left.set_ylabel("Error |Ẑ − Z|/|Z| [%]")
    left.set_title("(a) after each change of the grid; dots: valid answers")
    right.plot([0.0, 100.0], [0.0, 100.0], **REFERENCE)
    right.set_xlim(0.0, 100.0)
    right.set_ylim(0.0, 100.0)
    right.set_xlabel("Level of the ellipse [%]")
    right.set_ylabel("Truth inside [%]")
    right.set_title("(b) at rest")
    legend(figure, list(zip(*left.get_legend_handles_labels(), strict=True)), PAGE_IN - _LEFT)
    caption = (
        f"(a) Error of the answers against the time since a change of the grid, with the {100 * FOUND:g} % line. "
        "(b) How often the truth lies inside the ellipse of an answer's own covariance, against the ellipse's level. "
        "On the dashed line the covariance is right; above it, it is too large. The answers of a rest depend on each "
        "other, so the share of one run is a rough figure."
    )
    return NamedFigure("field_error", "Errors after a change, and coverage at rest", caption, figure)


@look()
def _probe_figure(result: ScenarioResult, controllers: list[tuple[int, ControllerResult]]) -> NamedFigure | None:
    index, controller = controllers[0]
    truth = same_with_truth(result, controller)
    rests = sorted(rests_of(result), key=lambda rest: rest.begin_s - rest.end_s)[:1]
    if not rests or rests[0].end_s - rests[0].begin_s < 2.0 * _WINDOW_S:
        return None
    height, between = 1.5, 0.65
    width = 0.5 * (PAGE_IN - _LEFT - _RIGHT - between)
    total = _BOTTOM + height + 0.3
    figure = new_figure(PAGE_IN, total)
    c = result.study.converter
    titles = ("(a) voltage at the capacitor", "(b) grid current")
    bases = (rms_to_peak(c.V_rated_rms), c.I_rated_pk)
    lines: list[Any] = []
    for column, (name, base, title) in enumerate(zip(("v_c_alpha", "i_g_alpha"), bases, titles, strict=True)):
        axes = add_axes(figure, _LEFT + column * (width + between), _BOTTOM, width, height)
        for one, style in (
            (truth, REFERENCE | {"linewidth": 0.6}),
            (controller, line_style(index) | {"linewidth": 0.8}),
        ):
            if one is None:
                continue
            f, amplitude = _spectrum(one, name, rests[0])
            lines += axes.plot(f, np.maximum(100.0 * amplitude / base, 1e-4), **style)
        axes.set_yscale("log")
        axes.set_xlim(0.0, _HIGHEST_HZ)
        axes.set_xlabel("Frequency [Hz]")
        axes.set_ylabel("Amplitude [% of rated peak]")
        axes.set_title(title)
    names = ([] if truth is None else [f"{truth.spec.name}, no probe"]) + [controller.spec.name]
    legend(figure, [(line, symbols(name)) for line, name in zip(lines, names, strict=False)], PAGE_IN - _LEFT)
    f_n = c.omega_n / (2.0 * math.pi)
    caption = (
        f"Spectra at rest, {rests[0].begin_s:g} to {rests[0].end_s:g} s, in windows of {_WINDOW_S:g} s. The probe's "
        f"two lines lie half-way between the harmonics, at {1.5 * f_n:g} and {2.5 * f_n:g} Hz on a grid of nominal "
        "frequency; its sign code spreads each of them over some hertz."
    )
    return NamedFigure("field_probe", "The probe in voltage and current", caption, figure)


def _spectrum(controller: ControllerResult, name: str, rest: Rest) -> tuple[Array, Array]:
    """Frequencies (Hz) and peak amplitudes of the lines of a logged quantity over a rest."""
    from scipy.signal import welch

    simulation = controller.simulation
    rows = rest.rows(simulation.t_s)
    step = float(simulation.t_s[1] - simulation.t_s[0])
    f, power = welch(
        simulation.column(name)[rows], 1.0 / step, window="hann", nperseg=round(_WINDOW_S / step), scaling="spectrum"
    )
    kept = f <= _HIGHEST_HZ
    return f[kept], rms_to_peak(np.sqrt(power[kept]))


def _changes(result: ScenarioResult) -> list[tuple[float, float]]:
    """Each change of the grid, and the next event after it, or the end."""
    end = [result.study.simulation.duration]
    instants = [event.t_s for event in result.study.events]
    changes = [t_s for t_s, _ in result.timeline.grids if t_s > 0.0]
    return [(change, min([t for t in instants if t > change + 1e-9] + end)) for change in changes]


def _legend_entries(index: int, name: str) -> list[tuple[Any, str]]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    colour = COLOURS[index % len(COLOURS)]
    return [
        (Line2D([], [], color=colour), symbols(f"estimate of {name}")),
        (Patch(facecolor=colour, alpha=0.25), "95 % band"),
        (Line2D([], [], **REFERENCE), "truth"),
        (Patch(**_NOT_VALID), "not valid"),
    ]
