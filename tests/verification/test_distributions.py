"""What is drawn, in words: the numbers are those of the section that the draws read."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from vsgdesign.campaigns.verification.document import distributions
from vsgdesign.study.parameters import study_from_text

STUDY = """
base = "case:lab_12kva_lcl"
[converter]
current_limit_pu = 1.2
current_limiter = "{limiter}"
[simulation]
duration = "1 s"
P_ref = 0
Q_ref = 0
[grid]
scr = 4
x_over_r = 4
[verification]
scr = [2, 10]
x_over_r = 4
P = ["-5 kW", "10 kW"]
Q = 0
f_g = [49, 51]
error_R = 0.3
error_X = 0.1
silent = [0, 0.5]
[verification.ramp]
weight = 1
[[controllers]]
name = "fixed"
kind = "fixed"
design_grid = {{ scr = 2, x_over_r = 4 }}
[[controllers]]
name = "scheduled"
kind = "scheduled"
"""


def drawn(limiter: str, controller: int) -> dict[str, str]:
    study = study_from_text(STUDY.format(limiter=limiter))
    return {row["quantity"]: row["words"] for row in distributions(study, study.controllers[controller])}


def test_ranges_and_numbers() -> None:
    found = drawn("circular", 1)
    assert found["X/R"] == "4"
    assert next(words for name, words in found.items() if name.startswith("SCR")) == "2 to 10, uniform in the logarithm"
    assert found["P at rest"].startswith("-0.4 pu to 0.8 pu, uniform; ")
    assert found["Source frequency"] == "49 Hz to 51 Hz, uniform"
    assert (found["Estimate of R_g"], found["Estimate of L_g"]) == ("±30 %, uniform", "±10 %, uniform")
    # A range from zero on has no logarithm.
    assert found["Silence of the estimator"].endswith("0 ms to 500 ms, uniform")


@pytest.mark.parametrize(("limiter", "share"), [("circular", "33.3 %"), ("projection", "20 %")])
def test_shares_of_the_families(limiter: str, share: str) -> None:
    found = drawn(limiter, 1)
    assert found["Frequency ramps"].startswith(f"{share} of the cases: by 0.1 Hz to 1 Hz, uniform at 0.5 to 4")
    assert ("Voltage sags" in found) == (limiter == "projection")
    assert ("phase jump" in found["Jumps of the grid"]) == (limiter == "projection")


def test_a_fixed_controller_is_told_nothing() -> None:
    assert not [name for name in drawn("circular", 0) if "stimat" in name]


@pytest.mark.parametrize(
    ("estimate", "cycles"), [("truth", "one nominal cycle$"), ("field", "2 nominal cycles, because")]
)
@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_the_signal_of_a_step_is_told(estimate: str, cycles: str, bridge: str) -> None:
    study = study_from_text(STUDY.format(limiter="circular"))
    spec = replace(study.controllers[1], estimate=estimate)
    found = {row["quantity"]: row["words"] for row in distributions(study, spec, bridge)}
    assert re.search(f"^of the mean of its power over {cycles}", found["Figures of a step"])
    assert ("Bridge" in found) == (bridge == "pwm")
    if bridge == "pwm":
        assert found["Bridge"].startswith("switched; each case runs for 2.5 settling times before its event, and")
