"""Tables and words about the estimated grid and the network that estimates it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vsgdesign.errors import counted, share_percent
from vsgdesign.identification import GUESS_SCR, Estimator, estimator_kind
from vsgdesign.identification.interface import needs_network
from vsgdesign.linear.stability.table_claims import CARRIED
from vsgdesign.metrics.answers import FOUND_PCT
from vsgdesign.report.drawing.quantities import DASH, number, percent, plain, plain_quantity
from vsgdesign.report.page.blocks import Table
from vsgdesign.report.page.converter import grid_label
from vsgdesign.runtime.guards import SchedulerSettings
from vsgdesign.simulation.estimated import estimator_of
from vsgdesign.simulation.field_feed import probe_of
from vsgdesign.simulation.scenario import ScenarioResult
from vsgdesign.simulation.scenario.judging import Judgement
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import ControllerSpec, Study

if TYPE_CHECKING:
    from vsgdesign.estimator.trained import TrainedEstimator


def network_table(result: ScenarioResult, trained: TrainedEstimator | None) -> Table:
    """What the network is and what it was trained on."""
    spec, weights = result.study.estimator, result.ready.network
    if spec is None or weights is None:
        raise ValueError("a scenario with estimates has a network")
    network, window, recipe = weights.network, weights.window, weights.recipe
    (R_low, R_high), (L_low, L_high) = weights.trained_on["R_g"], weights.trained_on["L_g"]
    rows = [
        ("Network", f"{network.W_1.shape[1]}–{len(network.b_1)}–2, tanh, linear outputs R_g and L_g"),
        (
            "Windows",
            f"{window.samples} samples every {plain_quantity(window.sample_interval, 's')} of v_pcc and i_pcc, "
            f"{window.channels.replace('_', ' ')}",
        ),
        ("Trained on", f"recipe {recipe.get('name', DASH)}, {recipe.get('bridge', DASH)} bridge, seed {weights.seed}"),
        (
            "Trained range",
            f"R_g {number(R_low)} to {number(R_high)} Ω, L_g {number(1e3 * L_low)} to {number(1e3 * L_high)} mH",
        ),
        (
            "Grid phase",
            "given by the simulation; no converter in the field can measure it" if window.synchronised else "not used",
        ),
        ("Weights", weights.hash[:12] + (f" from {spec.weights_file}" if spec.weights_file else "")),
    ]
    if spec.weights_file:
        rows.append((f"{CARRIED[:1].upper()}{CARRIED[1:]}", "the values of the weights, the recipe and the seed"))
    if trained is not None:
        rows.append(
            ("Training", f"{counted(trained.epochs, 'epoch')} on {counted(trained.components, 'principal component')}")
        )
    return Table("The network", ("Quantity", "Value"), tuple(rows), texts=2)


def methods_table(result: ScenarioResult) -> list[Table]:
    """What the estimators but the network are, how they are fed and what they send; no table where there are none."""
    rows, of_windows, by_sample = [], False, False
    for spec, estimator in untrained(result):
        needs = estimator.needs
        if estimator_kind(spec.estimate).by_sample:
            by_sample = True
            rows.append((spec.name, estimator.title, "a cycle of its own", _lines(result.study)))
            continue
        of_windows = True
        window = f"{needs.samples} × {plain_quantity(needs.sample_interval, 's')}"
        rows.append((spec.name, estimator.title, window, _probe(estimator)))
    head = ("Controller", "Estimator", "Window", "Probe")
    notes = (
        *(_OF_WINDOWS,) * of_windows,
        *(_OF_SAMPLES,) * by_sample,
    )
    title = "The other estimators" if result.ready.network else "The estimators"
    return [Table(title, head, tuple(rows), texts=4, notes=notes)] if rows else []


_OF_WINDOWS = (
    "Estimators of windows are given v_pcc, i_pcc, the converter's own angle and frequency, and nothing of the grid: "
    f"no phase, no impedance, no sensor noise. They begin with a guess of SCR {plain(GUESS_SCR)} and X/R 1."
)
_OF_SAMPLES = (
    "The field estimator is given the voltage at the filter's capacitor, the current into the grid and the probe as it "
    "was sent, and nothing of the grid. Until its first answer the gains are those of a safe place: that of the table, "
    "or the middle of the grids that the closed form is made for."
)


def _lines(study: Study) -> str:
    """The probe of the field estimator."""
    probe = probe_of(study)
    if not probe.send:
        return "none: send = false in [estimator.probe]"
    rest, burst = (f"{plain(100.0 * value, 2)} %" for value in (probe.limits.amplitude, probe.limits.amplitude_burst))
    return f"two lines, each at most {rest} {_OF['voltage']} at rest, {burst} while it learns"


def _probe(estimator: Estimator) -> str:
    probe = estimator.probe(estimator.first())
    if probe is None:
        return "none"
    return f"{plain(100.0 * float(np.abs(probe.values).max()), 2)} % {_OF[probe.quantity]}"


_OF = {"voltage": "of the rated voltage", "power": "of the rated power"}


def untrained(result: ScenarioResult) -> list[tuple[ControllerSpec, Estimator]]:
    """The controllers that estimate without a network, and what with."""
    specs = [c.spec for c in result.controllers if c.estimates is not None and not needs_network(c.spec.estimate)]
    return [(spec, estimator_of(result.study, spec, result.ready)) for spec in specs]


def training_table(trained: TrainedEstimator) -> Table:
    """How good the network is on each part of its windows."""
    rows = tuple(
        (
            name,
            str(len(part.truth)),
            number(part.mse),
            *(_correlation(value) for value in part.correlation),
            *(_within(part.errors[kind]["Z"]) for kind in ("rest", "after_change")),
        )
        for name, part in trained.parts.items()
    )
    head = ("Part", "Windows", "Mean squared error", "1 − R, R_g", "1 − R, L_g", "Z at rest", "Z after a change")
    notes = (
        "Mean squared error: of the outputs scaled to −1 … 1. R: correlation of outputs and targets. Z: median of "
        "|Ẑ − Z|/|Z|, and 95th percentile.",
    )
    return Table("The network on its windows", head, rows, notes=notes)


def _within(error: tuple[float, float]) -> str:
    median, most = error
    return f"{number(100.0 * median, 2)} %, {number(100.0 * most, 2)} %" if median >= 0.0 else DASH


def _correlation(value: float) -> str:
    return number(1.0 - value, 2)


def rest_table(result: ScenarioResult, judged: Judgement) -> Table:
    """Errors at rest."""
    rows = tuple(
        (
            f"{plain(rest.begin_s, 5)} … {plain(rest.end_s, 5)}",
            grid_label(result, Grid(rest.R_g, rest.L_g)),
            _signed(rest.R_mean_pct),
            _signed(rest.L_mean_pct),
            number(rest.R_worst_pct, 2),
            number(rest.L_worst_pct, 2),
        )
        for rest in judged.rest
    )
    head = ("Time [s]", "Grid", "R_g, mean", "L_g, mean", "R_g, worst", "L_g, worst")
    notes = (
        "In the last second before each event and the end (of a short stretch: its last quarter). Every estimate "
        "counts, whether the gains followed it or not.",
    )
    return Table(f"Error of {judged.name}'s estimate at rest [%]", head, rows, 2, notes=notes)


def _signed(value: float) -> str:
    return f"+{number(value, 2)}" if value > 0.0 else number(value, 2)


def changes_table(judged: Judgement) -> Table:
    """How each change of grid was followed."""
    rows = tuple(
        (
            f"{plain(change.t_s, 5)} s",
            _count(change.found_windows),
            _count(change.kept_windows),
            percent(change.worst_pct),
        )
        for change in judged.changes
    )
    head = ("Change of grid", "Found [windows]", "For good [windows]", "Largest error later [%]")
    notes = (
        f"Windows up to the first estimate within {plain(FOUND_PCT)} % of the new R_g and L_g, and up to the one from "
        "which on all are, until the next event. Largest error: after the first whole window on the new grid.",
    )
    return Table(f"Changes of grid as {judged.name} sees them", head, rows, notes=notes)


def _count(value: int | None) -> str:
    return DASH if value is None else str(value)


def truth_table(judged: Judgement) -> Table:
    """Reference steps with the estimate beside the same controller with the truth."""
    rows = tuple(
        (
            f"{step.name} at {plain(step.t_s, 5)} s",
            number(step.settling_time_s, 4),
            number(step.settling_time_truth_s, 4),
            percent(step.overshoot_pct),
            percent(step.overshoot_truth_pct),
        )
        for step in judged.steps
    )
    head = ("Step", "estimate", "truth", "estimate", "truth")
    groups = (("", 1), ("Settling time [s]", 2), ("Overshoot [%]", 2))
    return Table(f"{judged.name} beside {judged.with_the_truth}", head, rows, groups=groups)


def estimate_text(result: ScenarioResult, judgements: Sequence[Judgement]) -> list[str]:
    """What the estimate was worth, in words."""
    weights = result.ready.network
    estimates = {controller.spec.name: controller.spec.estimate for controller in result.controllers}
    paragraphs = []
    for judged in judgements:
        total = len(judged.log.status)
        believed = judged.statuses.get("ok", 0)
        others = ", ".join(f"{count} {status}" for status, count in judged.statuses.items() if status != "ok")
        text = f"{judged.name} estimates the grid once in {plain_quantity(judged.log.period, 's')}"
        if needs_network(estimates[judged.name]):
            text += f"; {total} windows"
            text += ", all within what the network knows." if believed == total else f", {believed} of them within "
            text += "" if believed == total else f"what the network knows ({others})."
        else:
            text += f" by {estimator_kind(estimates[judged.name]).title}; "
            text += f"its gains follow {believed} of {total} estimates"
            text += "." if believed == total else f" (the others: {others})."
        errors = [max(abs(rest.R_mean_pct), abs(rest.L_mean_pct)) for rest in judged.rest]
        errors = [error for error in errors if math.isfinite(error)]
        if errors:
            text += f" At rest its mean is off by {number(min(errors), 2)} to {number(max(errors), 2)} %."
        text += worst_text(judged)
        if judged.inside is not None and math.isfinite(judged.inside[0]):
            at_rest, of_all = (share_percent(share) for share in judged.inside)
            text += f" {at_rest} of its answers at rest and {of_all} of all are inside the error set of its table."
        if judged.steps:
            late = [
                abs(step.settling_time_s - step.settling_time_truth_s)
                for step in judged.steps
                if step.settling_time_s is not None and step.settling_time_truth_s is not None
            ]
            over = [abs((s.overshoot_pct or 0.0) - (s.overshoot_truth_pct or 0.0)) for s in judged.steps]
            if late:
                text += (
                    f" Beside {judged.with_the_truth}, which knows the truth, its steps settle within "
                    f"{number(max(late), 2)} s of the same time and overshoot within {number(max(over), 2)} "
                    "percentage points."
                )
        limit = rate_limit_text(judged.name, *judged.rate_limit) if judged.rate_limit else ""
        paragraphs.append(f"{text} {limit}".rstrip())
    if weights is not None and weights.window.synchronised:
        paragraphs.append(
            "The windows are synchronised with the grid's own voltage, as published, and the simulator lends its "
            "phase. No converter in the field has that signal: these figures are the scheme's at its best."
        )
    return paragraphs


def worst_errors(judged: Judgement) -> tuple[float | None, float | None]:
    """The largest error in R_g or L_g of a single answer in %: at rest, and after a change of the grid."""
    rest = [error for one in judged.rest for error in (one.R_worst_pct, one.L_worst_pct) if math.isfinite(error)]
    later = [one.worst_pct for one in judged.changes if one.worst_pct is not None and math.isfinite(one.worst_pct)]
    return max(rest, default=None), max(later, default=None)


def worst_text(judged: Judgement) -> str:
    """The same as a sentence; empty where neither is known."""
    rest, later = worst_errors(judged)
    parts = [] if rest is None else [f"{number(rest, 2)} % at rest"]
    parts += [] if later is None else [f"{number(later, 2)} % after a change of the grid"]
    return f" A single answer is off by up to {' and by up to '.join(parts)}." if parts else ""


def rate_limit_text(name: str, rate: float, held_s: float, total_s: float) -> str:
    """That the rate limit of a table's scheduler (1/s) has held gains back, for how long, and what to do."""
    held = (
        f"The scheduler of {name} held the gains behind the estimate for {plain(held_s, 3)} s of "
        f"{plain(total_s, 3)} s: it lets their SCR and R/X change by {plain(100.0 * rate, 3)} % per second."
    )
    if rate >= SchedulerSettings.rate:
        return held
    return f"{held} That is the rate that the table's certificate is good for; one for faster changes lifts it."
