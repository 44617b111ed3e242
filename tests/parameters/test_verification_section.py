"""[verification]: its defaults from the other sections, and every fault named at once."""

from __future__ import annotations

import math

import pytest

from vsgdesign.errors import StudyError
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.verification import VerificationSpec

SPECIFICATION = """
[specification]
scr = [1.5, 5, 20]
x_over_r = [0.5, 3, 10]
P = ["-4 kW", "4 kW"]
Q = ["0 var"]
error_R = "20 %"
error_Z = "5 %"
V_g_pu = [0.95, 1.05]
f_g = ["49.5 Hz", "50.5 Hz"]
"""


def study(more: str = "") -> Study:
    return study_from_text(f"""
base = "case:hoang2025_5kva"
simulation = {{ duration = "1 s", P_ref = "2 kW", Q_ref = "0 var" }}
controllers = [{{ name = "a", kind = "scheduled" }}]
{more}
""")


def section(more: str = "") -> VerificationSpec:
    found = study(more).verification
    assert found is not None
    return found


def faults(more: str) -> str:
    with pytest.raises(StudyError) as caught:
        study(more)
    return str(caught.value)


def test_nothing_has_to_be_written() -> None:
    spec = section()
    assert (spec.runs, spec.confidence, spec.seed, spec.silent_s) == (100_000, 0.99, 1, (0.02, 1.0))
    assert (spec.box.scr, spec.box.x_over_r) == ((1.2, 20.0), (0.3, 20.0))
    assert (spec.box.P, spec.box.Q, spec.box.errors) == ((-4500.0, 4500.0), (-1500.0, 1500.0), (0.0, 0.0, 0.0))
    assert spec.box.V_g_rms == pytest.approx((110.0, 110.0))


def test_the_box_is_that_of_the_specification() -> None:
    box = section(SPECIFICATION).box
    assert (box.scr, box.x_over_r, box.P, box.Q) == ((1.5, 20.0), (0.5, 10.0), (-4000.0, 4000.0), (0.0, 0.0))
    assert box.errors == (0.2, 0.0, 0.05)
    assert box.V_g_rms == pytest.approx((0.95 * 110.0, 1.05 * 110.0))
    assert box.omega_g == pytest.approx((2.0 * math.pi * 49.5, 2.0 * math.pi * 50.5))


def test_axes_of_the_maps_count_only_where_the_study_gives_them() -> None:
    box = section('[stability]\nscr = [2, 8]\nP = ["1 kW"]\n').box
    assert (box.scr, box.x_over_r, box.P, box.Q) == ((2.0, 8.0), (0.3, 20.0), (1000.0, 1000.0), (-1500.0, 1500.0))


def test_disturbances_beyond_steps_and_grids_need_a_limiter_that_rests_or_a_weight() -> None:
    spec = section("[verification.ramp]\nweight = 3\n")
    always = {"step": 1.0, "grid": 1.0, "ramp": 3.0, "reference": 0.0, "voltage_set_point": 0.0, "loss": 0.0}
    always |= dict.fromkeys(("dc_power", "dc_charge", "irradiance"), 0.0)
    assert spec.weights(True) == always | {"phase": 1.0, "sag": 1.0}
    assert spec.weights(False) == always | {"phase": 0.0, "sag": 0.0}
    assert spec.ranges("grid", False) == {"phase": (0.0, 0.0)}
    assert spec.ranges("grid", True)["phase"][1] == pytest.approx(math.pi / 6.0)


def test_a_part_of_the_box_and_ranges_with_units() -> None:
    spec = section(
        SPECIFICATION
        + """
[verification]
runs = 5000
scr = [2, 6]
P = "1 kW"
silent = "100 ms"
error_R = "10 %"
[verification.sag]
depth = ["10 %", "90 %"]
phase = ["0 deg", "15 deg"]
"""
    )
    assert (spec.runs, spec.box.scr, spec.box.P, spec.silent_s) == (5000, (2.0, 6.0), (1000.0, 1000.0), (0.1, 0.1))
    assert spec.box.errors == (0.1, 0.0, 0.05)
    assert spec.ranges("sag", True)["depth"] == (0.1, 0.9)


def test_every_fault_is_named() -> None:
    said = faults(
        SPECIFICATION
        + """
[verification]
runs = 0
confidence = 2
scr = [1, 30]
x_over_r = [3, 1]
error_X = "10 %"
silent = "1 V"
sead = 3
[verification.sag]
weight = 0
depth = nan
[verification.phase]
jump = "200 deg"
"""
    )
    for text in (
        "verification.runs = 0",
        "verification.confidence = 2",
        "verification.scr = [1, 30]: goes beyond scr of the [specification], 1.5 to 20, where nothing is promised",
        "verification.x_over_r = [3, 1]: the range is reversed",
        "verification.error_X = 10 %: goes beyond error_X of the [specification], 0 to 0",
        "verification.silent",
        "verification.sead: unknown field",
        "verification.sag.depth = nan",
        "verification.sag.weight",
        "verification.phase.jump",
    ):
        assert text.replace(" = 10 %", ' = "10 %"') in said, said


def test_something_has_to_be_drawn() -> None:
    never = "".join(f"[verification.{name}]\nweight = 0\n" for name in ("step", "grid", "phase", "sag"))
    assert "no family has a weight above zero" in faults(never)
