"""The training of the field estimator's network: figures, tables and a page of what it adds to the recursions alone."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from vsgdesign.estimator.scores import AFTER, GROUP_WORDS, GROUPS, SEEN, WAYS, WINDOWS
from vsgdesign.estimator.trained import TrainedFieldNetwork
from vsgdesign.report.drawing.figure_types import NamedFigure
from vsgdesign.report.drawing.quantities import DASH, number
from vsgdesign.report.drawing.style import (
    COLUMN_IN,
    PAGE_IN,
    REFERENCE,
    add_axes,
    line_style,
    look,
    new_figure,
)
from vsgdesign.report.page.blocks import Table

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
