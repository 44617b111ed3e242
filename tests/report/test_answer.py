"""The answer on top of a page: the verdicts of the tables below it, with words, and small pictures that are true."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from importlib import resources

import numpy as np
import pytest

from vsgdesign.metrics.events import UNSTABLE
from vsgdesign.metrics.step_response import no_figures
from vsgdesign.metrics.survival import Survival
from vsgdesign.report.drawing import spark
from vsgdesign.report.drawing.quantities import number, percent
from vsgdesign.report.drawing.sketch import Area, Sketch, Stroke, svg
from vsgdesign.report.page.blocks import FACT, MET, MISSED, OPEN, UNKNOWN, Answer, Cell, Row, counted, without_empty
from vsgdesign.report.page.html import print_fragment
from vsgdesign.report.scenario import tables
from vsgdesign.report.scenario.answer import MOST_STEPS, scenario_answer, scenario_headline, steps_answer
from vsgdesign.report.scenario.outcomes import step_outcomes
from vsgdesign.report.scenario.verdict import survival_text
from vsgdesign.simulation.outcome import Outcome
from vsgdesign.simulation.scenario.judging import judge_estimates, promises_kept


def answered(result):
    return scenario_answer(result, step_outcomes(result), promises_kept(result), judge_estimates(result))


def cell(answer: Answer, name: str, head: str) -> Cell:
    return next(row for row in answer.rows if row.name == name).cells[answer.head.index(head)]


class Cells(HTMLParser):
    """Text of each cell of the tables of class ``answer``, row by row."""

    def __init__(self) -> None:
        super().__init__()
        self.inside = self.in_cell = False
        self.rows: list[list[str]] = []

    def handle_starttag(self, tag, attrs):
        if tag == "figure":
            self.inside = "answer" in (dict(attrs).get("class") or "")
        if self.inside and tag == "tr":
            self.rows.append([])
        if self.inside and tag in ("td", "th"):
            self.rows[-1].append("")
            self.in_cell = True

    def handle_endtag(self, tag):
        self.in_cell &= tag not in ("td", "th")

    def handle_data(self, data):
        if self.inside and self.in_cell:
            self.rows[-1][-1] += data


def rows_on(page) -> list[list[str]]:
    parser = Cells()
    parser.feed(page.read_text(encoding="utf-8"))
    return [[" ".join(text.split()) for text in row] for row in parser.rows]


def test_the_answer_stands_before_every_other_table_and_figure(made):
    text = made.page.read_text(encoding="utf-8")
    first = text.index('class="table answer')
    assert first < text.index('class="drawing"') < text.index("<h2>In words</h2>")
    assert text.index('id="figure-active_power"') == text.index('id="figure-')


def test_counts_are_those_of_the_tables(short):
    """Counted again from the texts of the tables below, which do not know the answer."""
    answer = answered(short.result)
    table = tables.targets_table(step_outcomes(short.result))
    for controller in short.result.controllers:
        name = controller.spec.name
        for head, column in (("Settling time", 4), ("Overshoot", 7)):
            verdicts = [row[column] for row in table.rows if row[0] == name]
            missed = verdicts.count("missed")
            shown = cell(answer, name, head)
            expected = f"missed {missed} of {len(verdicts)}" if missed else f"met {len(verdicts)} of {len(verdicts)}"
            assert (shown.words, shown.mark) == (expected, MISSED if missed else MET)
        kept = [one for one in promises_kept(short.result) if one.controller == name and not one.excuse]
        missed = sum(not one.kept for one in kept)
        assert cell(answer, name, "Margins").words == (
            f"missed {missed} of {len(kept)}" if missed else f"met {len(kept)} of {len(kept)}"
        )


def test_the_page_shows_the_worst_figures(short):
    on_page = {row[0]: row for row in rows_on(short.page) if "pu" in row[-1]}
    assert set(on_page) == {"CVSG", "AVSG"}
    for controller in short.result.controllers:
        row = on_page[controller.spec.name]
        steps = [event.cycle_mean for event in controller.events if event.kind == "step"]
        assert f"{number(max(step.settling_time_s for step in steps))} s, asked ≤" in row[1]
        assert f"{percent(max(step.overshoot_pct for step in steps))} %, asked ≤" in row[2]
        peak = max(event.peak_current_pu for event in controller.events)
        assert row[-1] == f"{number(peak)} pu no limit is set"


def test_each_step_has_its_picture_its_figures_and_its_verdict(short):
    outcomes = step_outcomes(short.result)
    answer = steps_answer(short.result, outcomes)
    assert answer is not None
    assert answer.head == ("P_ref 2.5 kW at 1 s", "Q_ref 1.5 kvar at 6 s")
    for outcome in outcomes:
        column = [1.0, 6.0].index(outcome.metrics.t_s)
        shown = next(row for row in answer.rows if row.name == outcome.controller.spec.name).cells[column]
        assert shown.words == ("missed" if outcome.misses else "met")
        assert shown.detail == f"{number(outcome.settling_time_s)} s, {percent(outcome.overshoot_pct)} %"
        assert shown.picture is not None
        assert shown.detail in shown.picture.label


def test_a_step_of_which_nothing_is_promised_is_not_hidden(short):
    outcomes = [
        replace(one, excuse="above the box" if k == 0 else "") for k, one in enumerate(step_outcomes(short.result))
    ]
    answer = scenario_answer(short.result, outcomes, (), ())
    assert cell(answer, "CVSG", "Settling time").words == "missed"
    assert cell(answer, "CVSG", "Settling time").detail.endswith("; 1 more not judged")
    assert "not judged" not in cell(answer, "AVSG", "Settling time").detail
    steps = steps_answer(short.result, outcomes)
    assert steps is not None
    assert (steps.rows[0].cells[0].mark, steps.rows[0].cells[0].words) == (UNKNOWN, "not promised")


def test_without_steps_there_is_no_picture_and_no_column(megawatt):
    assert steps_answer(megawatt.result, step_outcomes(megawatt.result)) is None
    assert not {"Settling time", "Overshoot", "Survival", "Estimate"} & set(answered(megawatt.result).head)


def test_an_unstable_controller_misses_everything(short):
    controller = short.result.controllers[1]
    grown = tuple(
        replace(e, status=UNSTABLE, reason="unstable: a mode", raw=no_figures(0.0), cycle_mean=no_figures(0.0))
        for e in controller.events
    )
    result = replace(short.result, controllers=(replace(controller, events=grown),))
    answer = answered(result)
    assert cell(answer, "AVSG", "Settling time").words == "missed 2 of 2"
    assert cell(answer, "AVSG", "Overshoot").detail.startswith("unstable, asked")
    steps = steps_answer(result, step_outcomes(result))
    assert steps is not None
    assert {(one.words, one.detail) for one in steps.rows[0].cells} == {("missed", "unstable")}


def test_survival_is_the_headline_where_no_step_is_judged(short):
    assert scenario_headline(short.result, step_outcomes(short.result)).startswith("No controller meets")
    verdicts = (
        Survival(status="survived", recovery_s=0.4),
        Survival(status="slipped", reason="by a turn"),
        Survival(status="not known", reason="too short"),
    )
    first = short.result.controllers[0]
    first = replace(first, events=())
    for some, said in (
        (verdicts[:1], "CVSG survives the events."),
        (verdicts[:2], "CVSG alone survives the events."),
        (verdicts[1:2], "CVSG does not survive the events."),
        (verdicts[2:], "No event steps a reference, so there is"),
    ):
        controllers = tuple(
            replace(first, spec=replace(first.spec, name=name), survival=one)
            for name, one in zip(("CVSG", "AVSG"), some, strict=False)
        )
        result = replace(short.result, study=replace(short.study, events=()), controllers=controllers)
        assert scenario_headline(result, []).startswith(said)
        if len(some) == 2:
            answer = scenario_answer(result, [], (), ())
            assert cell(answer, "CVSG", "Survival") == Cell(MET, "survived", "at rest after 0.4 s")
            assert cell(answer, "AVSG", "Survival") == Cell(MISSED, "not survived", "slipped")


def test_a_current_that_no_hardware_carries_is_told_beside_survived(short):
    first = replace(short.result.controllers[0], events=())
    for peak_pu, mark, detail in (
        (1.99, MET, "at rest after 0.4 s"),
        (39.0, FACT, "at rest after 0.4 s; 39 pu, more than hardware carries"),
    ):
        verdict = Survival(status="survived", recovery_s=0.4, peak_pu=peak_pu)
        study = replace(short.study, events=())
        result = replace(short.result, study=study, controllers=(replace(first, survival=verdict),))
        assert cell(scenario_answer(result, [], (), ()), "CVSG", "Survival") == Cell(mark, "survived", detail)
        assert ("This is more than hardware carries" in survival_text(result)) == (peak_pu > 2.0)


@pytest.mark.parametrize(("limit", "mark", "words"), [(9.0, MET, "within the limit"), (0.7, MISSED, "above the limit")])
def test_the_current_is_held_against_the_limit(short, limit, mark, words):
    study = replace(short.study, converter=replace(short.study.converter, current_limit_pu=limit))
    result = replace(short.result, study=study)
    rows = scenario_answer(result, step_outcomes(result), (), ()).rows
    for row, controller in zip(rows, result.controllers, strict=True):
        shown = row.cells[-1]
        assert (shown.mark, shown.words) == (mark, words)
        # The converter's own current, read again from the log: later than 5 ms after every event.
        t_s, log = controller.simulation.t_s, controller.simulation.log
        late = (t_s >= 1.0) & np.logical_and.reduce([(t_s < t) | (t_s > t + 4.9e-3) for t in (1.0, 4.0, 6.0)])
        peak = np.hypot(log[late, 0], log[late, 1]).max() / study.converter.I_rated_pk
        first = max(event.peak_current_pu for event in controller.events)
        assert shown.detail == f"{number(first)} pu; converter {number(peak)} pu after 5 ms; limit {limit:g} pu"
        assert shown.picture is not None
        assert ("#7A2E00" in svg(shown.picture)) == (first > limit), "the part beyond the limit is hatched"


def test_the_column_of_rests_is_there_where_one_has_none(short):
    assert "Rest" not in answered(short.result).head
    first, second = short.result.controllers
    gone = replace(second, outcome=Outcome("diverged", "a current of 10 kA", 4.2))
    answer = answered(replace(short.result, controllers=(first, gone)))
    assert cell(answer, "CVSG", "Rest") == Cell(MET, "settled")
    assert cell(answer, "AVSG", "Rest") == Cell(MISSED, "diverged", "at 4.2 s")


def test_no_more_steps_than_fit(short):
    outcomes = [
        replace(one, metrics=replace(one.metrics, t_s=one.metrics.t_s))
        for one in step_outcomes(short.result)
        if one.metrics.t_s == 1.0
    ]
    events = tuple(replace(short.study.events[0], t_s=1.0 + 0.1 * k) for k in range(9))
    many = [replace(one, metrics=replace(one.metrics, t_s=event.t_s)) for event in events for one in outcomes]
    result = replace(short.result, study=replace(short.study, events=events))
    answer = steps_answer(result, many)
    assert answer is not None
    assert len(answer.head) == MOST_STEPS
    assert "3 more steps are in the table below." in answer.notes[0]


def test_counted_cells():
    assert counted([], "x").mark == OPEN
    asked = Row("a", (Cell(UNKNOWN, "not known"), Cell(FACT, "1 pu")))
    assert without_empty(Answer("t", ("A", "B"), (asked,))).head == ("A", "B"), "what was asked for is not hidden"
    assert counted([True], "x") == Cell(MET, "met", "x")
    assert counted([False], "x") == Cell(MISSED, "missed", "x")
    assert counted([True, False, True], "x").words == "missed 1 of 3"
    some = Row("a", (Cell(OPEN, "–"), Cell(FACT, "1 pu")))
    assert without_empty(Answer("t", ("A", "B"), (some, some))).head == ("B",)


def test_words_and_signs_stand_beside_colours():
    answer = Answer("t", ("A", "B"), (Row("n <&>", (Cell(MET, "met 2 of 2"), Cell(MISSED, "missed", "P_ref 1 s"))),))
    text = print_fragment([answer])
    assert "✓</span>&nbsp;met 2 of 2</span>" in text
    assert "✗</span>&nbsp;missed</span>" in text
    assert "n &lt;&amp;&gt;" in text
    assert "<i>P</i><sub>ref</sub> 1\N{NO-BREAK SPACE}s" in text


def test_the_colours_of_words_keep_their_contrast():
    """At least 4.5 to 1 on white, as WCAG 2.1 AA asks for text."""

    def luminance(colour: str) -> float:
        digits = colour if len(colour) == 6 else "".join(2 * c for c in colour)
        parts = [int(digits[k : k + 2], 16) / 255.0 for k in (0, 2, 4)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    style = (resources.files("vsgdesign.report") / "templates" / "style.css").read_text(encoding="utf-8")
    for rule in (r"\.met", r"\.missed", r"\.unknown", r"\.open", r"\.answer small"):
        found = re.search(rule + r" \{[^}]*?color: #([0-9A-F]+);", style, re.IGNORECASE)
        assert found is not None, rule
        assert 1.05 / (luminance(found[1]) + 0.05) >= 4.5, rule


def strokes_of(sketch: Sketch) -> list[Stroke]:
    """The lines of a sketch; the curve is the last one."""
    return [part for part in sketch.parts if isinstance(part, Stroke)]


def test_a_small_step_is_true_to_its_values():
    t = np.linspace(0.0, 2.0, 5001)
    y = 1.0 - np.exp(-3.0 * t)
    sketch = spark.step(t, y, (0.0, 2.0), (-0.1, 1.1), 1, 'a "b"', final=1.0, due=1.0, settled=0.5)
    x, down = strokes_of(sketch)[-1].points.T
    back_t, back_y = 2.0 * x / spark.WIDTH, 1.1 - 1.2 * down / spark.HEIGHT
    np.testing.assert_allclose(back_y, 1.0 - np.exp(-3.0 * back_t), atol=1e-9)
    (circle,) = [part for part in sketch.parts if isinstance(part, Area)]
    middle = 0.5 * (circle.points.min(axis=0) + circle.points.max(axis=0))
    assert middle[0] == pytest.approx(0.25 * spark.WIDTH, abs=1e-6)
    assert middle[1] == pytest.approx((1.1 - (1.0 - np.exp(-1.5))) / 1.2 * spark.HEIGHT, abs=1e-3)
    assert "&#34;b&#34;" in svg(sketch)
    banded = spark.step(t, y, (0.0, 2.0), (-0.1, 1.1), 1, "", final=1.0, band=0.02)
    (grey,) = [part for part in banded.parts if isinstance(part, Area)]
    edges = 1.1 - 1.2 * grey.points[:, 1] / spark.HEIGHT
    assert (edges.min(), edges.max()) == pytest.approx((0.98, 1.02), abs=1e-9)


def test_a_curve_that_diverges_stays_small_and_finite():
    t = np.linspace(0.0, 1.0, 1000)
    y = np.exp(200.0 * t)
    y[990:] = np.nan
    sketch = spark.step(t, y, (0.0, 1.0), (0.0, 2.0), 0, "diverged")
    assert "nan" not in svg(sketch)
    assert "inf" not in svg(sketch)
    assert np.abs(strokes_of(sketch)[-1].points).max() <= 2.0 * spark.WIDTH
    assert not spark.step(t[:0], y[:0], (0.0, 1.0), (0.0, 2.0), 0, "nothing was kept").parts


def test_a_bar_is_as_long_as_its_value():
    def widths(value: float, limit: float | None) -> list[float]:
        areas = [part.points for part in spark.bar(value, limit, 2.0, "").parts if isinstance(part, Area)]
        return [float(np.ptp(points[:, 0])) for points in areas]

    # The whole scale first, then what is within the limit, then what is beyond it.
    assert widths(1.0, None) == [90.0, 45.0]
    assert widths(1.0, 1.5) == [90.0, 45.0]
    assert widths(1.5, 1.0) == [90.0, 45.0, 22.5]


def test_levels_are_never_a_range_of_zero():
    low, high = spark.levels_of([np.full(5, 3.0)], [3.0])
    assert low < 3.0 < high
    assert spark.levels_of([], [])[0] < spark.levels_of([], [])[1]


@pytest.mark.parametrize(("columns", "close"), [(6, False), (8, True)])
def test_an_answer_of_many_columns_is_set_closer(columns, close):
    rows = (Row("One", (Cell(MET, "within", "27 % at 59.95 Hz"),) * columns),)
    text = print_fragment([Answer("Each", ("Grid frequency",) * columns, rows)])
    assert ('class="table answer many"' in text) == close
