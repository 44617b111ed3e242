"""What the pages of a scenario say of a field estimator: its answers, the rests, and what the probe costs there."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import share_percent
from vsgdesign.metrics import cycle_mean
from vsgdesign.metrics.answers import Answers, answers_of, coverage, share_valid, time_to_stay
from vsgdesign.metrics.oscillation import interharmonic_rms, ripple_rms
from vsgdesign.report.drawing.quantities import DASH, number, plain, plain_quantity
from vsgdesign.report.page.blocks import Table
from vsgdesign.report.page.converter import grid_label
from vsgdesign.simulation.scenario import ControllerResult, ScenarioResult, samples_per_mean
from vsgdesign.simulation.scenario.judging import same_with_truth
from vsgdesign.study.parameters.grid import Grid

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
    answers, duration = field_answers(result, controller), result.study.simulation.duration
    instants = sorted({event.t_s for event in result.study.events})
    found = []
    for change in (t_s for t_s, _ in result.timeline.grids if t_s > 0.0):
        until = min([t for t in instants if t > change + 1e-9] + [duration])
        found.append(time_to_stay(answers, change, until))
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
            rows = (t_s >= rest.begin_s) & (t_s < rest.end_s)
            mean = cycle_mean(one.simulation.column("P")[rows], samples_per_mean(result.study, t_s))
            both.append(ripple_rms(mean[len(mean) // 10 :]) / result.study.converter.S_rated)
        found.append(math.sqrt(max(both[0] ** 2 - both[1] ** 2, 0.0)))
    return max(found)


def _cost(result: ScenarioResult, controller: ControllerResult, rest: Rest) -> tuple[float, float, float]:
    """Voltage beside the harmonics in the two gaps of the probe, and ripple of P, per cent."""
    c, simulation = result.study.converter, controller.simulation
    rows = (simulation.t_s >= rest.begin_s) & (simulation.t_s < rest.end_s)
    t_s = simulation.t_s[rows]
    step = float(t_s[1] - t_s[0])
    f_n = c.omega_n / (2.0 * math.pi)
    frequency = float(np.mean(simulation.column("omega")[rows])) / (2.0 * math.pi)
    v = simulation.column("v_c_alpha")[rows]
    lines = [100.0 * interharmonic_rms(v, step, frequency, order, f_n) / c.V_rated_rms for order in (1, 2)]
    return lines[0], lines[1], 100.0 * ripple_rms(simulation.column("P")[rows]) / c.S_rated
