"""Two small scenarios with their reports, made once for all tests of a worker."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from vsgdesign.report.drawing.figures import WrittenFigure
from vsgdesign.report.page.html import print_html
from vsgdesign.report.scenario.figures import begin_all
from vsgdesign.report.scenario.page import scenario_page
from vsgdesign.simulation.scenario import ScenarioResult, run_scenario
from vsgdesign.study.parameters import Study, study_from_text

SHORT = """
base = "case:hoang2025_5kva"
[study]
name = "short"
title = "Published system, <short> & sweet"
[simulation]
duration = "9 s"
P_ref = "2 kW"
Q_ref = "1 kvar"
log_interval = "500 us"
[[controllers]]
name = "CVSG"
kind = "fixed"
settling_time = "0.5 s"
design_grid = { R_g = 3.64097929, L_g = "11.6 mH" }
[[controllers]]
name = "AVSG"
kind = "scheduled"
[[events]]
time = "1 s"
P_ref = "2.5 kW"
[[events]]
time = "4 s"
grid = { scr = 8 }
[[events]]
time = "6 s"
Q_ref = "1.5 kvar"
"""

MEGAWATT = """
[study]
name = "megawatt"
[converter]
S_rated = "2 MVA"
V_rated_ll_rms = "690 V"
f_n = "60 Hz"
V_dc = "1500 V"
f_sw = "10 kHz"
samples_per_carrier = 2
delay_samples = 0
modulation = "min_max"
[filter]
kind = "LCL"
L_1 = "60 uH"
R_1 = "1 mohm"
C = "600 uF"
R_c = "0.02 ohm"
L_2 = "15 uH"
R_2 = "0.5 mohm"
[inner_loops]
current_response_time = "1 ms"
voltage_response_time = "10 ms"
[grid]
scr = 4
x_over_r = 5
[simulation]
duration = "0.3 s"
bridge = "pwm"
P_ref = "1.2 MW"
Q_ref = "0.1 Mvar"
log_interval = "50 us"
[[controllers]]
name = "sole"
kind = "scheduled"
"""


@dataclass(frozen=True)
class Made:
    """A scenario, its figures on disk and its page."""

    study: Study
    result: ScenarioResult
    figures: list[WrittenFigure]
    page: Path


def make(text: str, folder: Path) -> Made:
    study = study_from_text(text)
    result = run_scenario(study)
    figures = begin_all(result, folder / "figures")()
    return Made(study, result, figures, print_html(scenario_page(result, figures), folder / "report.html"))


@pytest.fixture(scope="session")
def short(tmp_path_factory: pytest.TempPathFactory) -> Made:
    return make(SHORT, tmp_path_factory.mktemp("short"))


@pytest.fixture(scope="session")
def megawatt(tmp_path_factory: pytest.TempPathFactory) -> Made:
    return make(MEGAWATT, tmp_path_factory.mktemp("megawatt"))


@pytest.fixture(params=["short", "megawatt"])
def made(request: pytest.FixtureRequest) -> Made:
    return request.getfixturevalue(request.param)
