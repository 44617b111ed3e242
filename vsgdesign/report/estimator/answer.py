"""The answers on top of the estimator's pages: each method against 10 % of error, and what a network adds."""

from __future__ import annotations

import math

import numpy as np

from vsgdesign.errors import counted
from vsgdesign.estimator.comparison import WITHIN, Accuracy, Comparison
from vsgdesign.estimator.scores import AFTER, GROUP_WORDS, GROUPS, WAYS, GroupScore
from vsgdesign.estimator.stress import Stress
from vsgdesign.estimator.trained import TrainedFieldNetwork
from vsgdesign.report.drawing import spark
from vsgdesign.report.page.blocks import FACT, MET, MISSED, OPEN, UNKNOWN, Answer, Cell, Row, without_empty
from vsgdesign.report.quantities import number, plain

_LIMIT = f"{plain(100.0 * WITHIN)} %"


def comparison_headline(found: Comparison) -> str:
    """The method with the smallest worst error."""
    known = [one for one in found.accuracy if np.isfinite(one.rms).all()]
    if not known:
        return "No method could be judged on every grid."
    best = min(known, key=lambda one: float(one.rms.max()))
    worst = number(100.0 * float(best.rms.max()), 2)
    return f"{best.method} is the most accurate: its rms error of Z is at most {worst} %."


def comparison_answer(found: Comparison) -> Answer:
    """One row a method: its error, what its probe does, how fast it follows."""
    rows = []
    for k, one in enumerate(found.accuracy):
        moved = next((d for d in found.disturbances if d.method == one.method), None)
        delays = [delay for step in found.grid_steps if step.method == one.method for delay in step.delay]
        rows.append(
            Row(
                one.method,
                (
                    _error(one),
                    Cell(OPEN, "no probe")
                    if moved is None
                    else Cell(
                        FACT, f"P {_percent(moved.P.max())}, Q {_percent(moved.Q.max())}", "of the rating, at most"
                    ),
                    _followed(delays),
                ),
                spark.key(k),
            )
        )
    head = (f"Error of Z within {_LIMIT}", "Its probe moves", "Follows a new grid")
    return without_empty(Answer("Each method", head, tuple(rows), "Method"))


def _error(one: Accuracy) -> Cell:
    if not np.isfinite(one.rms).all():
        return Cell(UNKNOWN, "not known")
    low, high = (_percent(value) for value in (one.rms.min(), one.rms.max()))
    detail = f"rms {low}" if low == high else f"rms {low.removesuffix(' %')} to {high}"
    if np.isfinite(one.bound).all():
        detail += f", {number(float(np.median(one.rms / one.bound)), 2)} times its bound"
    return Cell(MET, "on every grid", detail) if one.rms.max() <= WITHIN else Cell(MISSED, "not on every grid", detail)


def _followed(delays: list[float]) -> Cell:
    if not delays:
        return Cell(OPEN, "not tried")
    late = sum(not math.isfinite(delay) for delay in delays)
    if late:
        return Cell(MISSED, f"not in {late} of {len(delays)} runs")
    return Cell(MET, "in every run", f"within {1e3 * max(delays):.0f} ms")


def stress_headline(found: Stress) -> str:
    """Which methods stay within 10 % under everything."""
    good = [name for k, name in enumerate(found.methods) if all(one.rms[k].max() <= WITHIN for one in found.results)]
    if not good:
        return f"No method stays within {_LIMIT} under every disturbance."
    if len(good) == 1:
        return f"{good[0]} alone stays within {_LIMIT} under every disturbance."
    return f"{len(good)} of {len(found.methods)} methods stay within {_LIMIT} under every disturbance."


def stress_answer(found: Stress) -> Answer:
    """One row a method, one column an axis."""
    rows = []
    for k, name in enumerate(found.methods):
        cells = []
        for one in found.results:
            worst = float(one.rms[k].max())
            at = _at(one.axis.values[int(np.argmax(one.rms[k]))], one.axis.unit)
            mark, words = (MET, "within") if worst <= WITHIN else (MISSED, "beyond")
            cells.append(Cell(mark, words, f"{_percent(worst)} at {at}"))
        rows.append(Row(name, tuple(cells), spark.key(k)))
    note = f"Whether the rms error of Z stays within {_LIMIT} over the whole axis, and its largest value."
    return Answer("Each method", tuple(one.axis.title for one in found.results), tuple(rows), "Method", (note,))


def _at(value: float, unit: str) -> str:
    """A value of an axis with its unit: 60.1 Hz, −2 samples, 1 sample."""
    if unit == "samples" and abs(value) == 1.0:
        unit = "sample"
    return plain(value) if unit == "1" else f"{plain(value)} {unit}"


WAY_WORDS = {
    "physics": "Recursions alone",
    "gated": "Network behind its gate",
    "ungated": "Network at all times",
}


def training_headline(trained: TrainedFieldNetwork) -> str:
    """In how many kinds of change the network behind its gate answers more often than the recursions alone."""
    groups = [group for group in GROUPS if trained.scores["physics"][group].changes]
    shares = [[trained.scores[way][group].valid_share[AFTER[0]] for way in ("physics", "gated")] for group in groups]
    if not groups:
        return "No test run has a change, so that the network cannot be judged."
    more = sum(gated > alone for alone, gated in shares)
    return (
        f"With the network behind its gate, more answers are valid {AFTER[0]} cycles after the change in {more} of "
        f"{counted(len(groups), 'kind')} of change."
    )


def training_answer(trained: TrainedFieldNetwork) -> Answer:
    """One row for each way of answering, one column for each kind of change."""
    rows = tuple(
        Row(WAY_WORDS[way], tuple(_score(trained.scores[way][group]) for group in GROUPS), spark.key(k))
        for k, way in enumerate(WAYS)
    )
    notes = (f"Valid answers {AFTER[0]} cycles after the change, and the 95th percentile of their error of Z.",)
    head = tuple(GROUP_WORDS[group] for group in GROUPS)
    return without_empty(Answer("Answers after a change", head, rows, "Way of answering", notes))


def _score(score: GroupScore) -> Cell:
    if not score.changes:
        return Cell(OPEN, "no such change")
    share, error = score.valid_share[AFTER[0]], score.valid_error_p95[AFTER[0]]
    said = f"error {_percent(error)}" if math.isfinite(error) else "no valid answer"
    return Cell(FACT, f"{_percent(share, 3)} valid", said)


def _percent(share: float, digits: int = 2) -> str:
    return f"{number(100.0 * float(share), digits)} %"
