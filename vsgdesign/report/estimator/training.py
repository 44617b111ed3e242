"""Trainings of the networks: their figures and tables, and what they say of themselves on a terminal and in Python."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from vsgdesign.errors import counted
from vsgdesign.estimator.scenarios import describe_draws
from vsgdesign.estimator.scores import AFTER, GROUP_WORDS, GROUPS, SEEN, WAYS, WINDOWS
from vsgdesign.estimator.trained import PartOfData, TrainedEstimator, TrainedFieldNetwork
from vsgdesign.report.drawing.figures import NamedFigure
from vsgdesign.report.drawing.quantities import DASH, number, plain
from vsgdesign.report.drawing.style import (
    COLOURS,
    COLUMN_IN,
    NOTE_COLOUR,
    PAGE_IN,
    REFERENCE,
    add_axes,
    line_style,
    look,
    new_figure,
)
from vsgdesign.report.page.blocks import Table

PARTS = ("training", "validation", "test")
OUTPUTS = (("R", "Ω", "mΩ", 1.0, 1e3), ("L", "mH", "µH", 1e3, 1e6))
"""Of each output its symbol, unit of values, unit of errors, and SI to either."""

_STOPS = {
    "goal": "the error reached its goal",
    "gradient": "the gradient vanished",
    "validation": "the validation error rose too often in a row",
    "damping": "no damping improved the error",
    "epochs": "its epochs were used up",
}

_BINS = 20
_MOST_TICKS = 5


def training_figures(trained: TrainedEstimator) -> Iterator[NamedFigure]:
    """Error histogram, regression and progress of the search, as in the published paper."""
    for make in (_histogram, _regression, _progress):
        yield make(trained)


def _errors_of(part: PartOfData, output: int) -> Any:
    return part.truth[:, output] - part.estimate[:, output]


@look()
def _histogram(trained: TrainedEstimator) -> NamedFigure:
    left, right, bottom, top, between, height = 0.55, 0.13, 0.36, 0.26, 0.5, 1.6
    width = 0.5 * (PAGE_IN - left - right - between)
    figure = new_figure(PAGE_IN, bottom + height + top)
    for output, (symbol, _, unit, _, factor) in enumerate(OUTPUTS):
        axes = add_axes(figure, left + output * (width + between), bottom, width, height)
        errors = [factor * _errors_of(trained.parts[name], output) for name in PARTS]
        edges = np.linspace(min(e.min() for e in errors), max(e.max() for e in errors), _BINS + 1)
        bars = axes.hist(errors, bins=edges, stacked=True, color=COLOURS[:3], linewidth=0.3, edgecolor="white")
        axes.axvline(0.0, **{**REFERENCE, "zorder": 4})
        axes.set_xlabel(f"Target − output, ${symbol}_g$ [{unit}]")
        axes.set_axisbelow(True)
        if output == 0:
            axes.set_ylabel("Windows")
            handles = [patches[0] for patches in bars[2]]
            labels = [f"{name} ({len(trained.parts[name].truth)})" for name in PARTS]
            figure.legend(
                handles,
                labels,
                ncols=3,
                loc="upper left",
                bbox_to_anchor=(left / PAGE_IN, 1.0 - 0.05 / (bottom + height + top)),
            )
    caption = (
        f"Errors of the network on the windows of recipe {trained.weights.recipe.get('name')}, in {_BINS} bins, the "
        "three parts stacked. Windows of one run are in one part only."
    )
    return NamedFigure("error_histogram", "Error histogram of the network", caption, figure)


@look()
def _regression(trained: TrainedEstimator) -> NamedFigure:
    left, right, bottom, top, gap_x, gap_y = 0.55, 0.13, 0.36, 0.22, 0.45, 0.55
    side = (PAGE_IN - left - right - 2 * gap_x) / 3.0
    figure = new_figure(PAGE_IN, bottom + 2 * side + gap_y + top)
    for output, (symbol, unit, _, factor, _) in enumerate(OUTPUTS):
        for column, name in enumerate(PARTS):
            part = trained.parts[name]
            axes = add_axes(figure, left + column * (side + gap_x), bottom + (1 - output) * (side + gap_y), side, side)
            truth, estimate = factor * part.truth[:, output], factor * part.estimate[:, output]
            low, high = float(min(truth.min(), estimate.min())), float(max(truth.max(), estimate.max()))
            room = 0.05 * (high - low)
            ends = [low - room, high + room]
            # Thousands of points: as pixels, also where the figure is a drawing.
            axes.plot(
                truth,
                estimate,
                linestyle="",
                marker="o",
                markersize=3.0,
                markerfacecolor="none",
                markeredgewidth=0.6,
                color=COLOURS[column],
                rasterized=True,
            )
            slope, offset = np.polyfit(truth, estimate, 1)
            axes.plot(ends, slope * np.array(ends) + offset, color=COLOURS[column], linewidth=0.9)
            axes.plot(ends, ends, **REFERENCE)
            axes.set_xlim(ends)
            axes.set_ylim(ends)
            axes.set_title(f"{name}: R = {_correlation(part.correlation[output])}")
            axes.text(
                0.95,
                0.05,
                f"slope {slope:.5g}\noffset {offset:+.2g} {unit}".replace("-", "−"),
                transform=axes.transAxes,
                ha="right",
                va="bottom",
                color=NOTE_COLOUR,
            )
            axes.locator_params(nbins=_MOST_TICKS)
            axes.set_xlabel(f"Target ${symbol}_g$ [{unit}]")
            if column == 0:
                axes.set_ylabel(f"Output ${symbol}_g$ [{unit}]")
    caption = (
        "The network's outputs against their targets, one circle a window, with the line of best fit and the line on "
        "which they are equal (dashed). R: correlation."
    )
    if _one_ratio(trained):
        caption += (
            " X/R is the same in all windows. The two outputs are therefore one number, and their correlations agree."
        )
    return NamedFigure("regression", "Regression of the network", caption, figure)


def _one_ratio(trained: TrainedEstimator) -> bool:
    truth = trained.parts["training"].truth
    ratio = truth[:, 1] / truth[:, 0]
    return bool(np.ptp(ratio) < 1e-6 * abs(ratio[0]))


def _correlation(value: float) -> str:
    """As many nines as are needed to distinguish the value from one."""
    return next((f"{value:.{digits}f}" for digits in range(5, 12) if f"{value:.{digits}f}" < "1"), "1")


@look()
def _progress(trained: TrainedEstimator) -> NamedFigure:
    left, right, bottom, top, height, gap = 0.62, 0.13, 0.36, 0.4, 0.85, 0.1
    total = bottom + 4 * height + 3 * gap + top
    figure = new_figure(COLUMN_IN, total)
    history, width = trained.history, COLUMN_IN - left - right
    epochs = history["epoch"] - history["epoch"][0]
    best = trained.best_epoch - history["epoch"][0]
    panels = [add_axes(figure, left, bottom + (3 - row) * (height + gap), width, height) for row in range(4)]
    errors, gradient, damping, checks = panels
    for index, (name, column) in enumerate(zip(PARTS, ("cost", "validation", "test"), strict=True)):
        errors.semilogy(epochs, history[column], label=name, **line_style(index))
    gradient.semilogy(epochs, history["gradient"], color=COLOURS[0])
    damping.semilogy(epochs, history["mu"], color=COLOURS[0])
    checks.plot(epochs, history["checks"], linestyle="", marker="D", markersize=2.2, color=COLOURS[0])
    checks.set_ylim(-0.5, max(float(history["checks"].max()) + 0.5, 6.5))
    for axes, label in zip(panels, ("Mean sq. error", "Gradient", "$\\mu$", "Val. checks"), strict=True):
        axes.set_ylabel(label)
        axes.set_xlim(0.0, max(float(epochs[-1]), 1.0))
        axes.axvline(best, **REFERENCE)
        axes.tick_params(labelbottom=axes is checks)
    checks.set_xlabel("Epoch")
    figure.align_ylabels(panels)
    lines = errors.get_lines()[:3]
    figure.legend(lines, PARTS, ncols=3, loc="upper left", bbox_to_anchor=(left / COLUMN_IN, 1.0 - 0.05 / total))
    first, last = (f"{trained.history[name][-1]:.2g}" for name in ("gradient", "mu"))
    errors.set_title(f"at the end: gradient {first}, $\\mu$ = {last}, checks {history['checks'][-1]:.0f}")
    starts = (
        "" if len(epochs) >= trained.epochs else f" {trained.epochs} epochs in all starts; the start taken is drawn."
    )
    caption = (
        f"Levenberg–Marquardt on {plain(trained.components)} principal components: error of the scaled outputs, "
        "gradient of the cost, damping μ and how often in a row the validation error had not fallen. Dashed: the epoch "
        f"whose network was taken. It ended: {_STOPS[trained.stop]}.{starts}"
    )
    return NamedFigure("training_progress", "Progress of the training", caption, figure)


WAY_WORDS = {
    "physics": "Recursions alone",
    "gated": "Network behind its gate",
    "ungated": "Network at all times",
}
"""Ways of answering, as pages call them."""

_TITLES = {
    "jump": "Jump of Z",
    "jump_and_step": "Jump with a step",
    "small_jump": "Small jump of Z",
    "grid_step": "Step of V, phase, f",
    "rest": "No event",
}


def field_training_figures(trained: TrainedFieldNetwork) -> Iterator[NamedFigure]:
    """Part 1: valid answers and their error by cycle after a change; part 2: the loss."""
    for make in (_after_a_change, _loss):
        yield make(trained)


@look()
def _after_a_change(trained: TrainedFieldNetwork) -> NamedFigure:
    left, right, bottom, top, gap, height = 0.5, 0.1, 0.36, 0.46, 0.12, 1.15
    width = (PAGE_IN - left - right - (len(GROUPS) - 1) * gap) / len(GROUPS)
    total = bottom + 2 * height + gap + top
    figure = new_figure(PAGE_IN, total)
    cycles = np.arange(SEEN)
    rows: tuple[list[Any], list[Any]] = ([], [])
    for column, group in enumerate(GROUPS):
        for row in range(2):
            place = (left + column * (width + gap), bottom + (1 - row) * (height + gap), width, height)
            axes = add_axes(figure, *place)
            rows[row].append(axes)
            for k, way in enumerate(WAYS):
                score = trained.scores[way][group]
                values = score.valid_share if row == 0 else score.valid_error_p95
                axes.plot(cycles, 100.0 * np.array(values), label=WAY_WORDS[way], **line_style(k))
            axes.set_xlim(0, SEEN - 1)
            axes.set_xticks([0, 10, 20])
            axes.tick_params(labelbottom=row == 1, labelleft=column == 0)
            if row == 0:
                axes.set_ylim(-3.0, 103.0)
                axes.set_title(f"{_TITLES[group]} ({trained.scores['physics'][group].changes})")
            else:
                axes.set_yscale("log")
                axes.set_ylim(1.0, 300.0)
                axes.set_yticks([1.0, 10.0, 100.0])
                axes.set_yticklabels(["1", "10", "100"] if column == 0 else [])
                axes.minorticks_off()
                axes.axhline(10.0, **REFERENCE)
                axes.set_xlabel("Cycles after it")
    rows[0][0].set_ylabel("Valid answers [%]")
    rows[1][0].set_ylabel("Error of these, p95 [%]")
    figure.align_ylabels([rows[0][0], rows[1][0]])
    handles = rows[0][0].get_lines()
    figure.legend(
        handles,
        [line.get_label() for line in handles],
        ncols=3,
        loc="upper left",
        bbox_to_anchor=(left / PAGE_IN, 1.0 - 0.05 / total),
    )
    caption = (
        f"The three ways of answering on the {trained.runs['test']} test runs, by what changed (number of changes). "
        "Above: how many answers are valid in each cycle after the cycle of the change. Below: the 95th percentile of "
        "their error of Z (dashed: 10 %)."
    )
    return NamedFigure("after_a_change", "What the network adds after a change", caption, figure, 1)


@look()
def _loss(trained: TrainedFieldNetwork) -> NamedFigure:
    left, right, bottom, top, height = 0.62, 0.13, 0.36, 0.3, 1.5
    total = bottom + height + top
    figure = new_figure(COLUMN_IN, total)
    axes = add_axes(figure, left, bottom, COLUMN_IN - left - right, height)
    for k, name in enumerate(("training", "validation")):
        axes.plot(trained.history["epoch"] + 1, trained.history[name], label=name, **line_style(k))
    axes.axvline(trained.best_epoch + 1, **REFERENCE)
    axes.set_xlabel("Epoch")
    axes.set_ylabel("Mean loss")
    axes.set_xlim(1, max(len(trained.history["epoch"]), 2))
    figure.legend(
        axes.get_lines()[:2],
        ["training runs", "validation runs"],
        ncols=2,
        loc="upper left",
        bbox_to_anchor=(left / COLUMN_IN, 1.0 - 0.05 / total),
    )
    caption = (
        "Mean loss of the training runs and of the validation runs after each epoch. Dashed: the epoch whose network "
        "is taken."
    )
    return NamedFigure("training_loss", "Progress of the training", caption, figure, 3)


def score_table(trained: TrainedFieldNetwork, group: str) -> Table:
    """Errors, shares and times of the three ways of answering after one kind of change."""
    rows = []
    for way in WAYS:
        score = trained.scores[way][group]
        at = [f"{_percent(score.valid_error_p95[k])} ({_percent(score.valid_share[k], digits=3)})" for k in AFTER]
        times = [_milliseconds(t) for t in score.t10_s]
        rows.append((WAY_WORDS[way], *at, *times, _milliseconds(score.wrong_s), _percent(score.worst)))
    head = (
        "",
        *(f"{k} cycles" for k in AFTER),
        *("median", "p90", "p95"),
        "wrong",
        "worst",
    )
    groups = (("", 1), ("p95 error (valid share)", len(AFTER)), ("to within 10 %", 3), ("valid and > 20 %", 2))
    count = trained.scores["physics"][group].changes
    notes = (
        "95th percentile of the error of the valid answers, and their share, in %, by cycle after the change; time to "
        f"stay within 10 % in ms ({DASH}: the impedance stays, or no such change); mean time per change in which a "
        "valid answer is wrong by more than 20 %, in ms, and the largest error of a valid answer in %, both from 40 ms "
        "after the change.",
    )
    explained = notes if group == next(iter(GROUPS)) else ()
    return Table(f"{GROUP_WORDS[group]}: {count}", head, tuple(rows), groups=groups, notes=explained)


def coverage_table(trained: TrainedFieldNetwork) -> Table:
    """How often the truth is inside the ellipse of an answer."""
    rows = []
    for way in WAYS:
        for group in GROUPS:
            score = trained.scores[way][group]
            cells = (_percent(score.coverage[name], digits=3) for name in WINDOWS)
            rows.append((WAY_WORDS[way], GROUP_WORDS[group], *cells, _percent(score.rest_coverage, digits=3)))
    head = ("", "After", *(f"cycles {name}" for name in WINDOWS), "before it")
    notes = (
        "Share of the valid answers whose 95 % ellipse contains the true impedance, in %; five cycles before a change.",
    )
    return Table("Coverage of the 95 % ellipse [%]", head, tuple(rows), texts=2, notes=notes)


def runs_table(trained: TrainedFieldNetwork) -> Table:
    """Runs and cycles of each part of the data."""
    rows = [(name, str(trained.runs[name]), str(trained.cycles[name])) for name in trained.runs]
    names = ", ".join(one["name"] for one in trained.weights.converters)
    notes = (f"Converters: {names}. All cycles of a run are in one part.",)
    return Table("Runs", ("Part", "Runs", "Cycles"), tuple(rows), notes=notes)


def _percent(share: float, digits: int = 2) -> str:
    return number(100.0 * share, digits) if math.isfinite(share) else DASH


def _milliseconds(seconds: float) -> str:
    if math.isnan(seconds):
        return DASH
    return f"{1e3 * seconds:.0f}" if math.isfinite(seconds) else "> T"


SYNCHRONISED = "synchronised with the grid's phase, as published; no converter in the field can measure it"


def trained_sentences(document: Mapping[str, Any]) -> list[str]:
    """The lines of ``vsgdesign estimator train``, from its JSON; the file of the weights comes first."""
    return _field_sentences(document) if "runs" in document else _window_sentences(document)


def window_sentences(sampling: str, draws: dict[str, Any]) -> list[str]:
    """How windows are sampled, and what was drawn again."""
    again = describe_draws(draws)
    return [f"windows of {sampling}", *([again] if again else [])]


def _window_sentences(document: Mapping[str, Any]) -> list[str]:
    test = document["parts"]["test"]["correlation"]
    return [
        f"{document['file']}: recipe {document['recipe']}, {counted(document['epochs'], 'epoch')}, {document['stop']}; "
        f"on the windows for test R = {test['R_g']:.6f} (R_g), {test['L_g']:.6f} (L_g)",
        f"error of Z on grids that it was not trained on: {_errors(document['parts']['test']['errors'])}",
        *window_sentences(document["window"]["text"], document["draws"]),
        *([SYNCHRONISED] if document["synchronised"] else []),
    ]


def _field_sentences(document: Mapping[str, Any]) -> list[str]:
    runs, seconds = document["runs"], document["timing_s"]
    broken = document["broken_off"]
    return [
        f"{document['file']}: recipe {document['recipe']}, {counted(sum(runs.values()), 'run')} in "
        f"{seconds['runs']:.0f} s, trained in {seconds['training']:.0f} s; on the {counted(runs['test'], 'run')} "
        "for test, with the network behind its gate instead of the recursions alone:",
        *(f"- {sentence}" for sentence in document["verdict"]),
        *([f"{counted(broken, 'run')} diverged and ended early"] if broken else []),
    ]


def _errors(found: Mapping[str, Mapping[str, tuple[float, float]]]) -> str:
    """Median and 95th percentile of the error, at rest and after a change, as far as there are windows."""
    parts = [
        f"{words} {100.0 * found[kind]['Z'][0]:.2g} % (95th percentile {100.0 * found[kind]['Z'][1]:.2g} %)"
        for kind, words in (("rest", "at rest"), ("after_change", "after a change"))
        if found[kind]["Z"][0] >= 0.0
    ]
    return ", ".join(parts)
