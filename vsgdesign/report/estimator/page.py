"""The pages of the estimator: the comparison of methods, and the stress page with its conclusion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from vsgdesign.errors import counted
from vsgdesign.estimator.comparison import WITHIN, Accuracy, Comparison
from vsgdesign.estimator.scores import AFTER, GROUP_WORDS, GROUPS, WAYS, GroupScore, verdict
from vsgdesign.estimator.stress import Stress
from vsgdesign.estimator.trained import TrainedFieldNetwork
from vsgdesign.identification import SIGNAL_SETS
from vsgdesign.report.drawing import spark
from vsgdesign.report.drawing.figures import WrittenFigure
from vsgdesign.report.drawing.quantities import DASH, number, plain
from vsgdesign.report.estimator.training import WAY_WORDS, coverage_table, runs_table, score_table
from vsgdesign.report.page.blocks import (
    BULLETS,
    FACT,
    MET,
    MISSED,
    NUMBERS,
    OPEN,
    UNKNOWN,
    Answer,
    Block,
    Box,
    Cell,
    Heading,
    Page,
    Row,
    Span,
    Table,
    answered,
    drawings,
    opening,
    without_empty,
    words,
)


def comparison_page(study: str, found: Comparison, figures: Sequence[WrittenFigure]) -> Page:
    """The page of the comparison: error and bound, disturbance, delay."""
    blocks = [
        *opening(comparison_headline(found), [comparison_answer(found)], figures, "estimator_accuracy"),
        *_in_words(comparison_conclusion(found)),
        Heading("Error and bound", numbered=True),
        accuracy_table(found),
        *drawings(figures, 1, without="estimator_accuracy"),
        Heading("Disturbance", numbered=True),
        *drawings(figures, 2),
        Heading("After a change of grid", numbered=True),
        delay_table(found),
        *drawings(figures, 3),
    ]
    return _page("Impedance estimators compared", study, blocks, found.weights)


def comparison_terminal(found: Comparison) -> list[Block]:
    """What a terminal prints of a comparison: the answer."""
    return answered(comparison_headline(found), comparison_answer(found))


def stress_terminal(found: Stress) -> list[Block]:
    """What a terminal prints of a stress test: the answer."""
    return answered(stress_headline(found), stress_answer(found))


def stress_page(study: str, found: Stress, figures: Sequence[WrittenFigure]) -> Page:
    """The page of the stress test: the error under everything that can disturb an estimator in the field."""
    blocks = [
        *opening(stress_headline(found), [stress_answer(found)], figures, "estimator_stress"),
        *_in_words(stress_conclusion(found)),
        Heading("Requirements for an estimator in the field", numbered=True),
        words(*needs(), style=NUMBERS),
        Heading("Errors", numbered=True),
        *(stress_table(found, k) for k in range(len(found.results))),
    ]
    return _page("Impedance estimators under stress", study, blocks, found.weights)


def field_training_page(study: str, trained: TrainedFieldNetwork, figures: Sequence[WrittenFigure]) -> Page:
    """The page of a training: the verdict, the three ways by kind of change, and the loss."""
    blocks = [
        *opening(training_headline(trained), [training_answer(trained)], figures, "after_a_change"),
        *_in_words(verdict(trained.scores)),
        Heading("After a change", numbered=True),
        *(score_table(trained, group) for group in GROUPS),
        *drawings(figures, 1, without="after_a_change"),
        Heading("Coverage", numbered=True),
        coverage_table(trained),
        Heading("Training", numbered=True),
        runs_table(trained),
        *drawings(figures, 3),
    ]
    return _page("The network of the field estimator", study, blocks, {"This network": trained.weights.hash})


def _page(title: str, study: str, blocks: Sequence[Block], weights: Mapping[str, str]) -> Page:
    """A page of the estimator, whose last line names the weights of its networks."""
    named = [part for name, hash in weights.items() for part in (f"{name}: weights ", Span(hash[:16], code=True), ". ")]
    return Page(title, [words(study), *blocks], tuple(named))


def _in_words(sentences: Sequence[str]) -> list[Block]:
    return [Heading("In words"), Box([words(*sentences, style=BULLETS)])]


def accuracy_table(found: Comparison) -> Table:
    """Rms error and bound on every SCR."""
    rows = []
    for one in found.accuracy:
        cells = (
            f"{number(100.0 * rms, 2)} ({DASH if not math.isfinite(bound) else number(100.0 * bound, 2)})"
            for rms, bound in zip(one.rms, one.bound, strict=True)
        )
        rows.append((one.method, SIGNAL_SETS[one.signals], *cells))
    head = ("Method", "Signals", *(f"SCR {plain(scr)}" for scr in found.settings.scr))
    notes = (
        "Rms error of Z in %, in brackets the Cramér–Rao bound of the signals. The bound of the windows about a power "
        "step takes the grid's phasor for constant: an error of its frequency is not in it, nor a bias of the samples.",
    )
    return Table("Rms error and bound [%]", head, tuple(rows), texts=2, notes=notes)


def delay_table(found: Comparison) -> Table:
    """Time until the estimate follows a new grid."""
    pairs = list(dict.fromkeys(step.scr for step in found.grid_steps))
    if not pairs:
        return Table("Time to within 10 % after a change of grid [ms]", ("Method",), ())
    rows = []
    for name in dict.fromkeys(step.method for step in found.grid_steps):
        cells = []
        for pair in pairs:
            step = next(s for s in found.grid_steps if s.method == name and s.scr == pair)
            cells += [_delay_text(float(np.median(step.delay))), _delay_text(max(step.delay))]
        rows.append((name, *cells))
    head = ("Method", *("median", "worst") * len(pairs))
    groups = (("", 1), *((f"SCR {plain(a)} to {plain(b)}", 2) for a, b in pairs))
    observed = 1e3 * float(found.grid_steps[0].t_s[-1])
    notes = (
        f"Until the error stays within {plain(100.0 * WITHIN)} %; > T: not within the T = {observed:.0f} ms seen.",
    )
    return Table("Time to within 10 % after a change of grid [ms]", head, tuple(rows), groups=groups, notes=notes)


def _delay_text(delay: float) -> str:
    return f"{1e3 * delay:.0f}" if math.isfinite(delay) else "> T"


def stress_table(found: Stress, index: int) -> Table:
    """One axis."""
    one = found.results[index]
    rows = tuple(
        (name, *(number(100.0 * value, 2) for value in errors))
        for name, errors in zip(found.methods, one.rms, strict=True)
    )
    flagged = frozenset(k for k, errors in enumerate(one.rms) if errors.max() > WITHIN)
    unit = "" if one.axis.unit == "1" else f" [{one.axis.unit}]"
    head = ("Method", *(plain(value) for value in one.axis.values))
    notes = (f"Rms error of Z in %. Marked: more than {plain(100.0 * WITHIN)} % somewhere.",)
    return Table(f"{one.axis.title}{unit}", head, rows, notes=notes, flagged=flagged)


def comparison_conclusion(found: Comparison) -> list[str]:
    """Sentences: the best method, its distance from the bound, the fastest method, and the cost of the probes."""
    sentences = list(found.left_out)
    for one in found.accuracy:
        worst = 100.0 * float(one.rms.max())
        ratio = np.median(one.rms / one.bound) if np.isfinite(one.bound).all() else math.nan
        beside = f", {number(float(ratio), 2)} times its bound (median)" if math.isfinite(ratio) else ""
        low = number(100.0 * float(one.rms.min()), 2)
        sentences.append(f"{one.method}: rms error of Z {low} to {number(worst, 2)} %{beside}.")
    for one in found.disturbances:
        where = int(np.argmax(one.P))
        sentences.append(
            f"{one.method} moves P by up to {number(100.0 * float(one.P[where]), 2)} % and Q by up to "
            f"{number(100.0 * float(one.Q.max()), 2)} % of the rating (SCR {plain(found.settings.scr[where])})."
        )
    return sentences


_AXIS_WORDS = {
    "frequency": "another grid frequency",
    "shift": "a shifted window",
    "V_g": "another grid voltage",
    "x_over_r": "another X/R",
    "scr": "another SCR",
    "noise": "sensor noise",
    "frequency_error": "a wrong grid frequency",
    "harmonics": "harmonics",
}


def stress_conclusion(found: Stress) -> list[str]:
    """Sentences: for every method, the axes on which it stays accurate."""
    sentences = list(found.left_out)
    for k, name in enumerate(found.methods):
        breaks = [_AXIS_WORDS[one.axis.name] for one in found.results if one.rms[k].max() > WITHIN]
        worst = max(float(one.rms[k].max()) for one in found.results)
        if breaks:
            sentences.append(f"{name}: off by more than 10 % with {', '.join(breaks)}.")
        else:
            sentences.append(f"{name}: within 10 % everywhere (worst {number(100.0 * worst, 2)} %).")
    return sentences


def needs() -> tuple[str, ...]:
    """The consequences for a converter in the field."""
    return (
        "A signal that makes the grid visible. One steady window with unknown grid phase says nothing of R_g and L_g, "
        "however good the estimator: the information is singular. The converter must move its own voltage, and "
        "know that it was itself who moved.",
        "No passive measurement. It asks for the grid's frequency to a tenth of a millihertz over the second that a "
        "power step takes; no grid is that steady.",
        "No trust in the grid's phase, frequency or voltage. A network that was trained on synchronised windows takes "
        "them for constants: a shift of one sample or a hundredth of a hertz is read as another grid.",
        "Lines beside the harmonics. A probe whose lines share no frequency with the fundamental and its harmonics "
        "is blind to them. A network that never saw them is not.",
        "Few components, or training on the sensors that it will have. On ideal samples a network may lean on "
        "differences that noise covers: on the published converter of 5 kVA and 50 Hz, 0.01 % of noise costs a network "
        "of 11 principal components 13 %, and one of 6 nothing.",
        "Both R_g and L_g. With X/R fixed in training the two outputs are one number.",
        "A covariance with every estimate, and silence where the bound says that nothing can be known.",
    )


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


_NAMED = 3
"""So many methods are named in the first line."""


def stress_headline(found: Stress) -> str:
    """Which methods stay within 10 % under everything."""
    good = [name for k, name in enumerate(found.methods) if all(one.rms[k].max() <= WITHIN for one in found.results)]
    if not good:
        return f"No method stays within {_LIMIT} under every disturbance."
    if len(good) == 1:
        return f"{good[0]} alone stays within {_LIMIT} under every disturbance."
    named = f": {'; '.join(good)}" if len(good) <= _NAMED else ""
    return f"{len(good)} of {len(found.methods)} methods stay within {_LIMIT} under every disturbance{named}."


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
