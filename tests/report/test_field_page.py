"""What a page says of a field estimator: the same numbers as the metrics, and figures that exist."""

from __future__ import annotations

import functools
import re
from pathlib import Path

import numpy as np
import pytest

from vsgdesign.metrics.answers import time_to_stay
from vsgdesign.report.drawing.figures import write_figure
from vsgdesign.report.page.html import print_html
from vsgdesign.report.scenario.field_figures import answers_table, answers_text, field_figures
from vsgdesign.report.scenario.page import scenario_page
from vsgdesign.report.scenario.signals import field_answers, field_controllers, rests_of
from vsgdesign.simulation.scenario import ScenarioResult, mean_cycles, run_scenario
from vsgdesign.study.parameters import study_from_text

STUDY = """
base = "case:hoang2025_5kva"
simulation = { duration = "12.5 s", P_ref = "2 kW", Q_ref = "0.5 kvar" }
background = { level = "measured", seed = 3, voltage_factor = 1.0, frequency_offset = "0.02 Hz" }
sensors = { level = "typical", seed = 3 }
grid = { scr_basis = "impedance", scr = 3, x_over_r = 2 }
inner_loops = { transient_resistance_pu = 0.08 }
power_loops = { structure = "angle_damped", P_droop = "5 %", Q_droop = "5 %", settling_time = "1 s" }
controllers = [
    { name = "known", kind = "scheduled", update_period = "20 ms" },
    { name = "field", kind = "scheduled", estimate = "field" },
]
events = [{ time = "6 s", grid = { scr = 8 } }]
"""


@functools.cache
def result() -> ScenarioResult:
    return run_scenario(study_from_text(STUDY))


def test_the_page_says_what_the_metrics_say() -> None:
    ((index, controller),) = field_controllers(result())
    assert (index, controller.spec.name) == (1, "field")
    answers = field_answers(result(), controller)
    found = re.search(r"for good from ([\d.]+) s on", answers_text(result(), controller))
    assert found is not None
    assert float(found[1]) == pytest.approx(time_to_stay(answers, 6.0, 12.5), rel=0.06)  # two digits are shown
    rows = answers_table(result(), controller).rows
    assert len(rows) == len(rests_of(result())) == 2
    for rest, row in zip(rests_of(result()), rows, strict=True):
        chosen = answers.rows(rest.begin_s, rest.end_s) & answers.valid
        error = 100.0 * float(np.percentile(answers.error[chosen], 95.0))
        assert float(row[2]) == pytest.approx(error, rel=0.06)
        with_probe, without = float(row[5]), float(row[6])
        assert with_probe > 2.0 * without  # the probe is there, and the twin sends none


def test_steps_are_judged_on_whole_periods_of_the_probe() -> None:
    assert mean_cycles(result().study) == 2
    assert mean_cycles(study_from_text(STUDY.replace('estimate = "field"', 'estimate = "kalman"'))) == 1


def test_figures_and_page(tmp_path: Path) -> None:
    figures = [write_figure(figure, tmp_path) for figure in field_figures(result())]
    assert [figure.name for figure in figures] == ["field_impedance", "field_error", "field_probe"]
    text = print_html(scenario_page(result(), figures), tmp_path / "report.html").read_text(encoding="utf-8")
    assert (
        text.index("<h2>In words</h2>") < text.index("lent nothing by the simulator") < text.index("<h2>Figures</h2>")
    )
    assert "two-cycle mean" in text
