"""A small sample of the random studies, and that the reader of logs sees what is wrong."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evidence._log_reader import Converter, differences
from evidence._random_studies import CASES, drawn_study
from evidence.random_studies import many, ran
from vsgdesign.study.parameters import study_from_text

SAMPLE = 25
"""Studies of a block: the blocks run side by side."""


@pytest.mark.parametrize("first", range(0, 4 * SAMPLE, SAMPLE))
def test_random_studies_have_one_answer_whatever_is_logged_and_that_of_their_logs(first: int, tmp_path: Path) -> None:
    outcomes, rows = many(SAMPLE, first, tmp_path)
    assert rows == []
    assert outcomes["settled"] > SAMPLE // 2


def test_the_sample_has_all_that_is_drawn(tmp_path: Path) -> None:
    texts = [drawn_study(np.random.default_rng(k), tmp_path, f"s{k}") for k in range(SAMPLE)]
    for part in (*CASES, '"pwm"', "table = ", "published", "decoupled", "over = ", "phase_jump", "projection"):
        assert any(part in text for text in texts), part
    assert any("table = " in text and float(text.split("scr = ")[1].split(",")[0]) > 8.0 for text in texts)


@pytest.fixture(scope="module")
def one() -> tuple[dict[str, Any], dict[str, np.ndarray], Converter]:
    """A run of the published case with a step, and the log of its every sample."""
    study = study_from_text("""
base = "case:hoang2025_5kva"
grid = { scr_basis = "impedance", scr = 5, x_over_r = 3 }
power_loops = { structure = "angle_damped", settling_time = "0.3 s" }
simulation = { duration = "1 s", P_ref = "1 kW", Q_ref = "0 var", log_interval = 5e-5 }
controllers = [{ name = "a", kind = "fixed" }]
events = [{ time = "0.1 s", P_ref = "2 kW" }]
""")
    result, document = ran(study)
    c, f = study.converter, study.filter
    numbers = Converter(c.S_rated, c.V_rated_rms, c.omega_n, c.T_s, f.R_2, f.L_2)
    return document, result.controllers[0].series, numbers


BENT = {
    "overshoot": lambda d: d["controllers"]["a"]["events"][0].update(overshoot_pct=0.1),
    "settling time": lambda d: d["controllers"]["a"]["events"][0].update(settling_time_s=0.25),
    "instantaneous": lambda d: d["controllers"]["a"]["events"][1]["instantaneous"].update(settling_time_s=0.01),
    "peak": lambda d: d["controllers"]["a"]["events"][0].update(peak_current_pu=0.5),
    "final": lambda d: d["controllers"]["a"]["events"][0].update(final=2100.0),
    "rest": lambda d: d["operating_points"][1].update(P=2100.0),
    "grid": lambda d: d["operating_points"][1].update(L_g=1e-3),
}


@pytest.mark.parametrize("what", BENT)
def test_the_reader_sees_a_wrong_figure(
    what: str, one: tuple[dict[str, Any], dict[str, np.ndarray], Converter]
) -> None:
    document, series, numbers = one
    assert differences(document, series, numbers, "a", pwm=False) == []
    bent = copy.deepcopy(document)
    BENT[what](bent)
    assert differences(bent, series, numbers, "a", pwm=False)
