"""The table of a comparison on the terminal shows why a limit is missed."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest

from vsgdesign.cli.console.compare import comparison_table


def document(**worst: float) -> dict[str, Any]:
    """A contender whose worst values with a wrong estimate are these; it keeps the others."""
    kept = {"overshoot": 0.02, "settling_time": 0.9, "disk_margin": 0.6}
    box = {"error_R": 0.1, "error_X": 0.1, "error_Z": 0.0}
    contender = {
        "name": "angle_damped",
        "origin": "closed form",
        "grids": [{}],
        "worst_exact": kept,
        "worst_wrong": kept | worst,
        "kept_exact": 1.0,
        "kept_wrong": 0.5,
        "kept_exact_ideal": 1.0,
        "kept_wrong_ideal": 0.5,
        "shares": {"unstable": 0.0},
        "droop_W_per_Hz": (2000.0, 2000.0),
        "inertia_s": None,
        "emt": {"overshoot": 0.01, "settling_time": 1.30004, "steps": 4, "not_settled": 0},
        "broken": {},
    }
    limits = {"overshoot": 0.05, "settling_time": 1.3, "disk_margin": 0.5, "damping_ratio": 0.3}
    spec = limits | {"H_min": 0.0, "H_max": math.inf, "box": box}
    return {"study": {"title": "small"}, "specification": spec, "contenders": [contender]}


@pytest.mark.parametrize(
    ("worst", "said"),
    [
        ({"settling_time": 1.3004}, "1.3004"),
        ({"settling_time": 1.2996}, "1.30"),
        ({"overshoot": 0.050002}, "5.0002"),
        ({"disk_margin": 0.49996}, "0.49996"),
        ({"disk_margin": 0.50004}, "0.500"),
        ({"settling_time": math.inf}, "∞"),
    ],
)
def test_a_missed_limit_is_shown_with_the_digits_that_tell_it(
    worst: dict[str, float], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    comparison_table(document(**worst))
    cells = re.split(r"\s+", capsys.readouterr().out)
    assert said in cells
    assert "1.30004" in cells
