"""The page: well-formed, complete, self-contained, and true to the numbers."""

from __future__ import annotations

import functools
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from tests.simulation.studies import GAINS, lc_study
from vsgdesign.metrics import StepNoise
from vsgdesign.metrics.events import MEASURED, TOO_SHORT, UNSTABLE, lost_in_noise
from vsgdesign.metrics.step_response import no_figures
from vsgdesign.report.drawing.quantities import number, plain_quantity, prefix_for, quantity
from vsgdesign.report.page import converter
from vsgdesign.report.page.blocks import UNKNOWN
from vsgdesign.report.page.html import print_html
from vsgdesign.report.scenario import tables
from vsgdesign.report.scenario.answer import scenario_answer, steps_answer
from vsgdesign.report.scenario.outcomes import overshoot_of, settling_factor, step_outcomes, uncoupled_P
from vsgdesign.report.scenario.page import scenario_page
from vsgdesign.report.scenario.signals import source_frequency
from vsgdesign.report.scenario.verdict import explanation, verdict
from vsgdesign.simulation import build_timeline
from vsgdesign.simulation.scenario import run_scenario

VOID = {"meta", "br", "hr", "img", "input", "link"}


class Checker(HTMLParser):
    """Collects faults of nesting, tags, ids, references and the text of table cells."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.faults: list[str] = []
        self.ids: list[str] = []
        self.targets: list[str] = []
        self.rows: list[list[str]] = []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        values = {name: value or "" for name, value in attrs}
        self.ids += [values["id"]] if "id" in values else []
        self.targets += [values[name] for name in ("href", "xlink:href", "src") if name in values]
        self.targets += re.findall(r"url\(([^)]*)\)", " ".join(values.values()))
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.faults.append(f"</{tag}> closes nothing at {self.getpos()}")

    def handle_data(self, data):
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data


def checked(path) -> Checker:
    return checked_text(path.read_text(encoding="utf-8"))


@functools.cache
def checked_text(text: str) -> Checker:
    """Several tests look at one page; to read it takes longer than they do."""
    checker = Checker()
    checker.feed(text)
    checker.close()
    return checker


def test_the_page_is_well_formed_and_refers_to_itself_only(made):
    page = checked(made.page)
    assert page.faults == []
    assert page.open == []
    assert not {"script", "link", "img", "iframe", "object"} & set(page.tags)
    assert len(page.ids) == len(set(page.ids))
    assert page.targets
    assert all(target.startswith("#") and target[1:] in page.ids for target in page.targets)
    text = made.page.read_text(encoding="utf-8")
    assert "http" not in text.replace("http-equiv", "")
    assert "src=" not in text
    assert "@import" not in text


def test_every_figure_is_on_the_page(made):
    text = made.page.read_text(encoding="utf-8")
    assert text.count('<figure class="drawing"') == len(made.figures)
    for index, figure in enumerate(made.figures):
        assert f'id="figure-{figure.name}"' in text
        assert f"Figure {index + 1}. {figure.title}." in text


def test_every_row_of_every_table_is_on_the_page(made):
    shown = [["".join(cell.split()) for cell in row] for row in checked(made.page).rows]
    result = made.result
    outcomes = step_outcomes(result)
    expected = [
        converter.converter_table(result),
        converter.filter_table(result),
        tables.controllers_table(result),
        tables.rests_table(result),
        tables.margins_table(result),
        *(tables.gains_table(result, controller) for controller in result.controllers),
        *(tables.metrics_table(result, controller) for controller in result.controllers if controller.events),
    ]
    expected += [tables.targets_table(outcomes)] if outcomes else []
    expected += [tables.events_table(result)] if made.study.events else []
    for table in expected:
        assert table.rows
        for row in table.rows:
            assert len(row) == len(table.head)
            assert [re.sub(r"\s|_(?=[a-z])", "", cell) for cell in row] in [
                [re.sub(r"_(?=[a-z])", "", cell) for cell in cells] for cells in shown
            ], (table.title, row)


def test_the_page_says_where_it_comes_from(made):
    text = made.page.read_text(encoding="utf-8")
    assert made.study.hash in text
    assert f"<code>{made.study.name}</code>" in text
    assert "vsgdesign 0." in text


def test_titles_are_escaped(short):
    text = short.page.read_text(encoding="utf-8")
    assert "<h1>Published system, &lt;short&gt; &amp; sweet</h1>" in text
    assert "<short>" not in text


def test_two_builds_are_identical(made, tmp_path):
    again = print_html(scenario_page(made.result, made.figures), tmp_path / "again.html")
    assert again.read_bytes() == made.page.read_bytes()


def test_numbers_of_the_events_are_the_measured_ones(short):
    controller = short.result.controllers[0]
    table = tables.metrics_table(short.result, controller)
    row = next(row for row in table.rows if row[0] == "1 s" and row[2] == "P, step")
    metrics = next(e for e in controller.events if e.t_s == 1.0 and e.signal == "P_pcc")
    for first, figures in ((3, metrics.cycle_mean), (8, metrics.raw)):
        assert float(row[first]) == pytest.approx(figures.overshoot_pct, abs=0.05)
        assert float(row[first + 1]) == pytest.approx(figures.settling_time_s, rel=5e-3)
    assert float(row[13]) == pytest.approx(metrics.peak_current_pu, rel=5e-3)
    disturbance = next(row for row in table.rows if row[0] == "4 s" and row[2] == "P")
    assert disturbance[3] == "–"
    assert disturbance[5] == "–"


def test_voltage_outside_its_limits_is_said_in_words(short):
    rows = tables.rests_table(short.result).rows
    assert [(row[0], row[2], row[9]) for row in rows] == [
        ("0", "all", "within"),
        ("1", "all", "above 1.25 pu"),
        *((t_s, name, "within") for t_s in ("4", "6") for name in ("CVSG", "AVSG")),
    ]
    assert "2 of 8 rests" in " ".join(verdict(short.result, step_outcomes(short.result)))


def test_the_verdict_counts_and_explains(short):
    outcomes = step_outcomes(short.result)
    text = " ".join(verdict(short.result, outcomes))
    assert text.startswith("No controller meets")
    name = outcomes[-1].controller.spec.name
    excused = [replace(one, excuse="outside") if one.controller.spec.name == name else one for one in outcomes]
    assert verdict(short.result, excused)[0].endswith(f" on every step. No step of {name} is judged.")
    assert "settling time met on 0 and overshoot on 0 of 2 reference steps" in text
    first = outcomes[0]
    assert f"settled after {number(first.settling_time_s)} s" in text
    why = " ".join(explanation(outcomes))
    assert "5.83/ω_n = 1.46 s for AVSG" in why
    rest = next(rest for rest in short.result.controllers[0].rests if rest.t_s == 1.0)
    c = rest.point.B * rest.point.C / (rest.point.A * rest.point.D)
    assert number(c) in why
    assert "damping ratio" not in why, "both P steps are on the grid of the design"


def test_a_met_target_is_called_met(short):
    controller = short.result.controllers[1]
    slow = replace(controller.spec, target=replace(controller.spec.target, settling_time=2.0, damping_ratio=0.5))
    result = replace(short.result, controllers=(replace(controller, spec=slow),))
    outcomes = [outcome for outcome in step_outcomes(result) if outcome.metrics.signal == "P_pcc"]
    assert [outcome.misses for outcome in outcomes] == [False]
    assert verdict(result, outcomes)[0] == "AVSG meets its settling time and overshoot on every step."
    # "Every step" names what it leaves out.
    whole, meets = [*outcomes, replace(outcomes[0], excuse="outside")], "AVSG meets its settling time and overshoot"
    assert verdict(result, whole)[0] == f"{meets} on every step but 1, of which nothing is promised."
    unknown = replace(outcomes[0], metrics=replace(outcomes[0].metrics, status=TOO_SHORT))
    assert verdict(result, [*whole, unknown, unknown])[0] == (
        f"{meets} on every step but 1, of which nothing is promised, and 2, which cannot be judged."
    )
    assert explanation(outcomes) == []


def test_a_window_too_short_to_know_is_neither_met_nor_missed(short):
    controller = short.result.controllers[1]
    why = "the window is too short: 1 s after the step, the slowest mode needs 2.05 s"
    unknown = tuple(
        replace(e, status=TOO_SHORT, reason=why, raw=no_figures(2000.0, 2500.0), cycle_mean=no_figures(2000.0))
        for e in controller.events
    )
    result = replace(short.result, controllers=(replace(controller, events=unknown),))
    outcomes = step_outcomes(result)
    assert outcomes
    assert not any(outcome.misses or outcome.judged for outcome in outcomes)
    text = " ".join(verdict(result, outcomes))
    assert text.startswith("No reference step can be held to its target.")
    assert "cannot be judged, neither met nor missed" in text
    assert why in text
    table = tables.targets_table(outcomes)
    for row in table.rows:
        assert (row[3], row[4], row[6], row[7]) == ("window too short", "not known", "–", "not known")
    assert any(why in note for note in table.notes)
    assert not table.flagged


def test_a_loop_without_coupling_is_shown_where_a_structure_has_one(short):
    outcomes = step_outcomes(short.result)
    whole = tables.targets_table(outcomes)
    coupled = tables.targets_table([replace(outcome, uncoupled=None) for outcome in outcomes])
    assert [row[:8] + row[-1:] for row in whole.rows] == list(coupled.rows)
    assert len(coupled.head) == sum(count for _, count in coupled.groups) == len(whole.head) - 4
    assert any("Without coupling" in note for note in whole.notes)
    assert not any("Without coupling" in note for note in coupled.notes)


def test_a_step_beside_its_twin_is_told_with_its_noise(short):
    """The overshoot with its uncertainty, the noise in which the power rests, and what no noise allows to judge."""

    def outcomes_with(left, settled_s, overshoot_pct):
        events = []
        for e in short.result.controllers[1].events:
            mean = replace(e.cycle_mean, settling_time_s=settled_s, overshoot_pct=overshoot_pct)
            step = StepNoise(500.0, left, 13.6)
            events.append(replace(e, cycle_mean=mean, noise=step) if e.kind == "step" else e)
        found = replace(short.result, controllers=(replace(short.result.controllers[1], events=tuple(events)),))
        return found, step_outcomes(found)

    def row_of(outcomes):
        table = tables.targets_table(outcomes)
        assert tables.targets_table(outcomes).head[8] == "Rests in, rms"
        return table.rows[0][3:9]

    def cell_of(found, outcomes):
        answer = steps_answer(found, outcomes)
        assert answer is not None
        return answer.rows[0].cells[0]

    # AVSG is asked for 1 s and no overshoot of P and Q. 4.5 times 1.333 W of 500 W: 1.2 %.
    quiet, outcomes = outcomes_with(4 / 3, 0.9, 1.1)
    assert row_of(outcomes) == ("0.900", "met", "0.0", "1.1 ± 1.2", "met", "13.6 W")
    assert not any(outcome.misses for outcome in outcomes)
    assert verdict(quiet, outcomes)[0] == "AVSG meets its settling time and overshoot on every step."
    assert "0.900 s, 1.1 ± 1.2 %; rests in 13.6 W rms" in cell_of(quiet, outcomes).detail
    assert "difference from the same run without the step" in tables.targets_table(outcomes).notes[1]
    terminal = tables.responses_table(quiet)
    assert terminal.head[-1] == "rests in, rms"
    assert ("1.1 ± 1.2 %", "13.6 W") in {(row[4], row[-1]) for row in terminal.rows}
    assert all(outcome.misses for outcome in outcomes_with(4 / 3, 0.9, 1.3)[1])
    assert row_of(outcomes_with(4 / 3, 1.1, 1.1)[1])[:2] == ("1.10", "missed")
    # 4.5 times 3 W: 2.7 % is more than the band. Noise makes a settling time late, not early.
    loud, outcomes = outcomes_with(3.0, 1.1, 1.1)
    assert row_of(outcomes) == ("1.10", "cannot be judged", "0.0", "1.1 ± 2.7", "cannot be judged", "13.6 W")
    assert not any(outcome.misses or outcome.judged for outcome in outcomes)
    text = " ".join(verdict(loud, outcomes))
    assert "cannot be judged, neither met nor missed" in text
    assert "a step of at least 675 W can be judged" in text
    shown = cell_of(loud, outcomes)
    assert (shown.mark, shown.words) == (UNKNOWN, "cannot be judged")
    assert scenario_answer(loud, outcomes, (), ()).rows[0].cells[0].words == "cannot be judged"
    for settled in (0.9, None):
        early = row_of(outcomes_with(3.0, settled, 1.1)[1])
        assert early[1] == ("met" if settled else "cannot be judged")
        assert early[4] == "cannot be judged"


def test_a_disturbance_in_noise_has_no_settling_time(short):
    """It is a word in the table of events and on the terminal, and its reason stands below with the band."""
    controller = short.result.controllers[1]
    noise = StepNoise(5000.0, 40.0, 40.0, twin=False)
    lost = {"noise": noise, "reason": lost_in_noise(noise, "P_pcc")}
    events = tuple(
        replace(e, cycle_mean=replace(e.cycle_mean, settling_time_s=None), status=MEASURED, **lost)
        for e in controller.events
        if e.kind == "disturbance"
    )
    found = replace(short.result, controllers=(replace(controller, events=events),))
    table, terminal = tables.metrics_table(found, found.controllers[0]), tables.responses_table(found)
    assert {(row[4], row[-1].split()[0]) for row in table.rows} == {("cannot be judged", "40.0")}
    assert not any("±" in row[3] for row in table.rows)
    for notes in (table.notes, terminal.notes):
        assert any("Where 4.5 times this is more than the band of 2 % of the rating" in note for note in notes)
    assert {row[5] for row in terminal.rows} == {"cannot be judged"}


def test_an_unstable_end_is_a_miss_without_figures(short):
    controller = short.result.controllers[1]
    grown = tuple(
        replace(e, status=UNSTABLE, reason="unstable: a mode", raw=no_figures(0.0), cycle_mean=no_figures(0.0))
        for e in controller.events
    )
    result = replace(short.result, controllers=(replace(controller, events=grown),))
    outcomes = step_outcomes(result)
    assert all(outcome.misses for outcome in outcomes)
    assert "unstable: a mode" in " ".join(verdict(result, outcomes))
    assert explanation(outcomes) == []
    assert tables.targets_table(outcomes).rows[0][3:5] == ("unstable", "missed")


def test_without_events_nothing_is_judged(megawatt):
    text = megawatt.page.read_text(encoding="utf-8")
    assert "No event steps a reference" in text
    assert "Responses to the events" not in text
    assert "Why the closed form misses" not in text
    assert "switches ideally" in text


def test_yardsticks_of_second_order_loops():
    assert settling_factor(1.0) == pytest.approx(5.834, abs=1e-3)
    assert overshoot_of(0.5) == pytest.approx(16.303, abs=1e-3)
    assert overshoot_of(1.0) == 0.0
    assert settling_factor(0.0) == math.inf
    # Two real poles, the fast one far off: the slow one alone, ln 50 of its time constants.
    assert settling_factor(20.0) * (20.0 - math.sqrt(399.0)) == pytest.approx(math.log(50.0), rel=1e-3)
    response = uncoupled_P(16.0 / 8348.0, 8348.0 / 2.0, 8348.0)
    assert response.omega_n == pytest.approx(4.0)
    assert response.damping_ratio == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (9.996, "10.0"),
        (-0.00767, "−0.00767"),
        (123456.0, "123456"),
        (1.5e7, "1.50·10⁷"),
        (None, "–"),
        (float("nan"), "–"),
        (2e-9, "2.00·10⁻⁹"),
    ],
)
def test_numbers_have_sensible_digits(value, text):
    assert number(value) == text


def test_quantities_choose_their_prefix():
    assert quantity(0.011554, "H") == "11.6 mH"
    assert plain_quantity(2e6, "VA") == "2 MVA"
    assert prefix_for(999.9999999999) == (1000.0, "k")
    assert prefix_for(0.2) == (1.0, "")
    assert [prefix_for(10.0**k)[1] for k in (3, 6, 9)] == ["k", "M", "G"]
    assert np.isclose(prefix_for(3e4)[0], 1e3)


def test_the_page_says_background_sensors_and_record(tmp_path) -> None:
    sections = (
        '[background]\nlevel = "dirty"\nfrequency_offset = "0.1 Hz"\nphasor_walk = "0.03 %"\nharmonic_5 = "2.5 %"\n'
    )
    sections += 'modulation = "0.2 %"\nmodulation_frequency = "25 Hz"\nvoltage_steps_per_minute = 1.4\n'
    study = lc_study("0.1 s", sections + '[sensors]\nbits = 12\nnoise = "0.1 %"\nskew = "-0.03 deg"\n')
    text = "\n".join(converter.background_in_words(study))
    for said in (
        "dirty, seed 1: phase ",
        "frequency +0.1 Hz",
        "phasor walks by 0.03 % in a cycle",
        "1.4 steps of the voltage per minute, 0.3 % to 1 %",
        "order −5: 2.5 %",
        "modulated by 0.2 % at 25 Hz",
    ):
        assert said in text, said
    said = "ideal, seed 1: noise 0.1 % rms; 12 bits over ±3 pu; gain errors up to 0 %, offsets up to 0 %; "
    assert converter.sensors_in_words(study) == [said + "voltages 1.667 µs late"]
    assert converter.background_in_words(study.undisturbed) == converter.sensors_in_words(study.undisturbed) == []
    np.savez(tmp_path / "g.npz", v=np.cos(2.0 * np.pi * 50.2 * np.arange(5000) / 5000.0), fs=5000.0)
    recorded = lc_study("0.1 s", f'[replay]\nfile = "{tmp_path / "g.npz"}"\nscale = "rated"\n')
    assert converter.background_in_words(recorded)[0] == "recorded: g.npz, times 155.6 V, from 0 s on"


def test_the_frequency_of_a_restless_source(tmp_path) -> None:
    """Its mean over 0.1 s in the figure: the record's own, while the events know its beginning alone."""
    t_s = np.arange(10_000) / 5000.0
    np.savez(tmp_path / "g.npz", v=np.cos(2.0 * np.pi * (50.0 * t_s + 0.05 * t_s**2)), fs=5000.0)
    study = lc_study("1.2 s", f'[replay]\nfile = "{tmp_path / "g.npz"}"\nscale = "rated"\n')
    controllers = tuple(replace(spec, gains=GAINS) for spec in study.controllers)
    t_s, f = source_frequency(run_scenario(replace(study, controllers=controllers)))
    replay = build_timeline(study).replay
    assert replay is not None
    np.testing.assert_allclose(f, 50.0 + 0.1 * (t_s + replay.spec.origin - 1.0 / 50.0 / 3.0), atol=1e-3)
