"""The training of a network: its errors, its outputs and targets, and the search."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from vsgdesign.estimator.trained import PartOfData, TrainedEstimator
from vsgdesign.report.drawing.figure_types import NamedFigure
from vsgdesign.report.drawing.quantities import plain
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


def _errors(part: PartOfData, output: int) -> Any:
    return part.truth[:, output] - part.estimate[:, output]


@look()
def _histogram(trained: TrainedEstimator) -> NamedFigure:
    left, right, bottom, top, between, height = 0.55, 0.13, 0.36, 0.26, 0.5, 1.6
    width = 0.5 * (PAGE_IN - left - right - between)
    figure = new_figure(PAGE_IN, bottom + height + top)
    for output, (symbol, _, unit, _, factor) in enumerate(OUTPUTS):
        axes = add_axes(figure, left + output * (width + between), bottom, width, height)
        errors = [factor * _errors(trained.parts[name], output) for name in PARTS]
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
