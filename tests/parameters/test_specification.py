"""The [specification] section: units, defaults, and every fault at once."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.parameters.documents import build, case_document, faults_of, the_fault
from vsgdesign.metrics.margins import guaranteed_margins
from vsgdesign.study.parameters.specification import DEFAULT_SCR, DEFAULT_X_OVER_R, Specification, margin_of


def document(**section: Any) -> dict[str, Any]:
    return case_document() | {"specification": section}


def read(**section: Any) -> Specification:
    found = build(document(**section)).specification
    assert found is not None
    return found


def test_no_section_is_no_specification() -> None:
    plain = case_document()
    del plain["specification"]
    plain["controllers"] = [one for one in plain["controllers"] if one.get("schedule") != "table"]
    assert build(plain).specification is None


def test_defaults() -> None:
    study = build(document())
    spec, target = study.specification, study.target
    assert spec is not None
    assert (spec.aim, spec.settling_time, spec.overshoot, spec.disk_margin) == (
        "settling",
        target.settling_time,
        0.05,
        1.0,
    )
    assert (spec.scr, spec.x_over_r, spec.scr_basis) == (DEFAULT_SCR, DEFAULT_X_OVER_R, study.scr_basis)
    assert (spec.box.P, spec.box.Q) == ((target.P,), (target.Q,))
    assert spec.box.omega_g == pytest.approx((study.grid_source.omega_g,), rel=1e-15)
    assert spec.box.V_g_rms == pytest.approx((study.grid_source.V_g_rms,), rel=1e-15)
    assert (spec.box.error_R, spec.box.error_X, spec.H, spec.H_min) == (0.0, 0.0, None, 0.0)
    assert spec.settles


def test_units() -> None:
    spec = read(
        settling_time="800 ms",
        overshoot="4 %",
        P=["-4 kW", "4 kW"],
        Q=["-1.5 kvar", 1000],
        error="20 %",
        error_X=0.1,
        f_g=["49.5 Hz", "50.5 Hz"],
        V_g_pu=[0.95, 1.05],
        H_min="100 ms",
        scr=[2, 8],
        x_over_r=[0.5, 5],
    )
    assert (spec.settling_time, spec.overshoot) == (0.8, pytest.approx(0.04))
    assert (spec.box.P, spec.box.Q) == ((-4000.0, 4000.0), (-1500.0, 1000.0))
    assert (spec.box.error_R, spec.box.error_X) == (0.2, 0.1)
    assert spec.box.omega_g == pytest.approx((2 * math.pi * 49.5, 2 * math.pi * 50.5))
    assert spec.box.V_g_rms == pytest.approx((104.5, 115.5))
    assert spec.H_min == pytest.approx(0.1)


def test_constant_inertia() -> None:
    spec = read(aim="inertia", H="4 s")
    assert (spec.settles, spec.H) == (False, 4.0)
    assert "missing" in the_fault(document(aim="inertia"), "specification.H").problem
    assert 'aim = "inertia"' in the_fault(document(H="4 s"), "specification.H").problem


def test_nothing_stands_back_in_silence_with_constant_inertia() -> None:
    """Settling, overshoot and bounds of H are no promises there: who asks for them is told, and how to have both."""
    for field, value in (("settling_time", "1 s"), ("overshoot", "5 %"), ("H_min", "2 s"), ("H_max", "9 s")):
        fault = the_fault(document(aim="inertia", H="4 s", **{field: value}), f"specification.{field}")
        assert "is not kept" in fault.problem
        assert read(**{field: value}) is not None
    assert (
        "H_min and H_max"
        in the_fault(document(aim="inertia", H=4, settling_time=1), "specification.settling_time").advice
    )


def test_an_error_of_both_has_no_say_beside_its_two_parts() -> None:
    fault = the_fault(document(error=0.1, error_R=0.2, error_X=0.3), "specification.error")
    assert "has no effect" in fault.problem
    assert read(error=0.1, error_R=0.2).box.error_X == 0.1


def test_an_error_in_any_direction() -> None:
    """It stands beside the others, is off by default, and must leave the estimates an inductance."""
    assert read(error="20 %").box.errors == (0.2, 0.2, 0.0)
    box = read(error="20 %", error_Z="6 %").box
    assert box.errors == (0.2, 0.2, pytest.approx(0.06))
    assert (box.exact().errors, box.exact().P) == ((0.0, 0.0, 0.0), box.P)
    fault = the_fault(document(error_Z=0.25, x_over_r=[0.25, 5]), "specification.error_Z")
    assert "must be less than 0.243" in fault.problem


def test_a_closed_forms_targets_have_no_say_beside_a_table() -> None:
    """The specification decides: they were read and forgotten."""
    for field in ("settling_time", "damping_ratio", "droop_ratio", "k_1", "d_1", "k_2", "share_P", "share_Q"):
        one = {"name": "t", "kind": "scheduled", field: 0.5}
        for schedule, faulty in (("closed_form", False), ("table", True)):
            found = document() | {"controllers": [one | {"schedule": schedule}]}
            if faulty:
                assert (
                    "the table is designed to the [specification]"
                    in the_fault(found, f"controllers[0].{field}").problem
                )
            else:
                build(found)


@given(st.floats(0.01, 1.99))
def test_gain_and_phase_margins_as_a_disk_margin(alpha: float) -> None:
    """The inverse of what a disk margin guarantees."""
    gain, phase = guaranteed_margins(alpha)  # type: ignore[arg-type]
    phase_deg = float(phase)
    assert margin_of(20.0 * math.log10(float(gain)), 0.0) == pytest.approx(alpha, rel=1e-9)
    assert margin_of(0.0, phase_deg) == pytest.approx(alpha, rel=1e-9)


def test_the_strictest_margin_counts() -> None:
    assert read(disk_margin=0.4, gain_margin_db=6.0).disk_margin == pytest.approx(2 * (1.9953 - 1) / 2.9953, rel=1e-4)
    assert read(disk_margin=0.4, phase_margin_deg=30.0).disk_margin == pytest.approx(2 * math.tan(math.radians(15)))
    assert read(disk_margin=1.1, gain_margin_db=6.0, phase_margin_deg=30.0).disk_margin == 1.1


def test_every_fault_at_once() -> None:
    faults = faults_of(
        document(
            aim="speed",
            settling_time="1 V",
            overshoot=float("nan"),
            scr=[5, 2],
            x_over_r=[1],
            P=[],
            error=-0.1,
            H_min="3 s",
            H_max="2 s",
            disc_margin=1.0,
            f_g=["50 Hz", float("inf")],
        )
    )
    by_field = {fault.field: str(fault) for fault in faults}
    assert set(by_field) == {
        f"specification.{name}"
        for name in (
            "aim",
            "settling_time",
            "overshoot",
            "scr",
            "x_over_r",
            "P",
            "error",
            "H_max",
            "disc_margin",
            "f_g[1]",
        )
    }
    for name, says in {
        "aim": "settling",
        "scr": "must increase",
        "x_over_r": "at least two nodes",
        "P": "at least one value",
        "H_max": "3 s",
        "disc_margin": "Did you mean disk_margin?",
    }.items():
        assert says in by_field[f"specification.{name}"], name


@pytest.mark.parametrize(
    ("field", "low", "high"),
    [
        ("settling_time", 1e-3, 1e3),
        ("overshoot", 0.001, 1.0),
        ("damping_ratio", 0.0, 1.0),
        ("disk_margin", 0.0, 1.9),
        ("gain_margin_db", 0.0, 60.0),
        ("phase_margin_deg", 0.0, 89.0),
        ("error", 0.0, 0.9),
        ("error_R", 0.0, 0.9),
        ("error_X", 0.0, 0.9),
        ("error_Z", 0.0, 0.3),
        ("H_min", 0.0, 1e3),
        ("H_max", 0.0, 1e6),
        ("bandwidth_max", 1e-2, 1e5),
    ],
)
def test_limits(field: str, low: float, high: float) -> None:
    for inside in (low, high):
        read(**{field: inside})
    for outside in (math.nextafter(low, -math.inf), math.nextafter(high, math.inf)):
        assert the_fault(document(**{field: outside}), f"specification.{field}")
