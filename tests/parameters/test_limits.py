"""Every limit of every field: the last value inside passes, the first one outside is caught and named."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.parameters.documents import MISSING, build, case_document, changed, faults_of, the_fault
from vsgdesign.errors import StudyError
from vsgdesign.study.parameters import study_from_text

Z_BASE = 3.0 * 110.0**2 / 5000.0
OMEGA = 2.0 * math.pi * 50.0
GAINS = {"K_ip": 0.00767, "D_p": 2087.0, "K_iq": 0.115, "D_q": 0.687}


def document_with(*changes: tuple[str, Any]) -> dict[str, Any]:
    document = case_document()
    for path, value in changes:
        document = changed(path, value, document)
    return document


PLAIN = case_document()
PHASE_TO_PHASE = document_with(("converter.V_rated_rms", MISSING), ("converter.V_rated_ll_rms", "190.5 V"))
LCL = document_with(
    ("filter.kind", "LCL"), ("filter.L_2", "0.5 mH"), ("filter.R_2", "20 mohm"), ("filter.R_c", "2 ohm")
)
GIVEN_GAINS = document_with(("inner_loops", {"K_pc": 12.6, "K_ic": 3.9e4, "K_pv": 0.0628, "K_iv": 19.7}))
TRANSIENT = document_with(("inner_loops.transient_resistance_pu", 0.08), ("inner_loops.transient_corner", "25 Hz"))
OHMS = document_with(("grid", {"R_g": 3.6, "L_g": 0.0116}))
FIXED_GAINS = document_with(
    ("controllers.0", {"name": "a", "kind": "fixed", "gains": GAINS}),
)
EVENT = document_with(
    ("events", [{"time": 10.0, "V_g_pu": 0.9, "f_g": 50.1, "over": 0.5, "phase_jump": 0.1, "P_ref": 1.0, "Q_ref": 1.0}])
)
EVENT_GRID = document_with(("events", [{"time": 10.0, "grid": {"scr": 2.0, "x_over_r": 3.0}}]))
EVENT_OHMS = document_with(("events", [{"time": 10.0, "grid": {"R_g": 3.6, "L_g": 0.0116}}]))
TARGET = [("settling_time", 0.01, 1000.0), ("damping_ratio", 0.05, 20.0), ("droop_ratio", 0.0, 10.0)]
POWERS = [("P_design", -1e4, 1e4), ("Q_design", -1e4, 1e4)]

LIMITS: list[tuple[str, dict[str, Any], str, float, float]] = [
    *(("converter", PLAIN, f"converter.{field}", low, high) for field, low, high in [
        ("S_rated", 10.0, 1e10), ("V_rated_rms", 5.0, 5e5), ("f_n", 10.0, 1000.0), ("V_dc", 10.0, 1e6),
        ("f_sw", 300.0, 1e6), ("samples_per_carrier", 1, 64), ("delay_samples", 0, 1),
        ("current_limit_pu", 0.5, 20.0), ("V_min_pu", 0.0, 1.0), ("V_max_pu", 1.0, 3.0),
    ]),
    ("line to line", PHASE_TO_PHASE, "converter.V_rated_ll_rms", 10.0, 1e6),
    *(("filter", LCL, f"filter.{field}", low, high) for field, low, high in [
        ("L_1", 1e-7, 0.5), ("R_1", 0.0, 100.0), ("C", 1e-8, 0.1), ("R_c", 0.0, 1000.0), ("L_2", 1e-7, 0.5),
        ("R_2", 0.0, 100.0),
    ]),
    *(("inner gains", GIVEN_GAINS, f"inner_loops.{field}", 1e-9, high) for field, high in [
        ("K_pv", 1e6), ("K_iv", 1e9), ("K_pc", 1e6), ("K_ic", 1e9),
    ]),
    *(("inner times", PLAIN, f"inner_loops.{field}", low, high) for field, low, high in [
        ("damping_ratio", 0.1, 10.0), ("current_feedforward", -1.0, 1.5), ("transient_resistance_pu", 0.0, 1.0),
        ("transient_reactance_pu", -1.0, 1.0), ("current_prediction", 0.0, 2.0),
        ("current_response_time", 1e-5, 1.0), ("voltage_response_time", 1e-5, 1.0),
    ]),
    ("transient", TRANSIENT, "inner_loops.transient_corner", 0.5, 500.0),
    *(("grid", PLAIN, f"grid.{field}", low, high) for field, low, high in [
        ("scr", 0.05, 1e4), ("x_over_r", 1e-3, 1e4), ("V_g_pu", 0.1, 2.0), ("f_g", 40.0, 60.0),
    ]),
    ("grid", OHMS, "grid.R_g", 0.0, 20.0 * Z_BASE),
    ("grid", OHMS, "grid.L_g", 1e-4 * Z_BASE / OMEGA, 20.0 * Z_BASE / OMEGA),
    *(("power loops", PLAIN, f"power_loops.{field}", low, high)
      for field, low, high in [*TARGET, *POWERS, ("tau_P", 0.0, 1.0), ("tau_Q", 0.0, 1.0)]),
    *(("simulation", PLAIN, f"simulation.{field}", low, high) for field, low, high in [
        ("duration", 1e-3, 36000.0), ("csv_interval", 0.0, 10.0), ("P_ref", -1e4, 1e4), ("Q_ref", -1e4, 1e4),
        ("reference_limit_pu", 0.1, 100.0),
    ]),
    *(("event", EVENT, f"events.0.{field}", low, high) for field, low, high in [
        ("time", 0.0, 60.0), ("V_g_pu", 0.0, 2.0), ("f_g", 40.0, 60.0), ("over", 0.0, 60.0),
        ("phase_jump", -math.pi, math.pi), ("P_ref", -1e4, 1e4), ("Q_ref", -1e4, 1e4),
    ]),
    ("event grid", EVENT_GRID, "events.0.grid.scr", 0.05, 1e4),
    ("event grid", EVENT_GRID, "events.0.grid.x_over_r", 1e-3, 1e4),
    ("event grid", EVENT_OHMS, "events.0.grid.R_g", 0.0, 20.0 * Z_BASE),
    ("event grid", EVENT_OHMS, "events.0.grid.L_g", 1e-4 * Z_BASE / OMEGA, 20.0 * Z_BASE / OMEGA),
    *(("controller", PLAIN, f"controllers.1.{field}", low, high)
      for field, low, high in [*TARGET, *POWERS, ("update_period", 50e-6, 60.0)]),
    *(("power gains", FIXED_GAINS, f"controllers.0.gains.{field}", low, high) for field, low, high in [
        ("K_ip", 1e-15, 1e6), ("D_p", 0.0, 1e12), ("K_iq", 1e-15, 1e6), ("D_q", 0.0, 1e12),
    ]),
    ("schema", PLAIN, "schema", 1, 1),
]  # fmt: skip

DERIVED = ("grid.R_g", "grid.L_g", "events.0.f_g", "grid.f_g", "update_period")
"""Limits that follow from other fields: their last bit depends on the order of multiplication."""


def field_name(path: str) -> str:
    """``events.0.time`` as messages write it: ``events[0].time``."""
    return path.replace(".0", "[0]").replace(".1", "[1]")


def out_of_range(document: dict[str, Any], path: str) -> list[str]:
    """Range faults of a field. Other rules may object to an extreme value; that is not asked here."""
    try:
        build(document)
    except StudyError as error:
        return [
            str(f)
            for f in error.faults
            if f.field == field_name(path) and f.problem.startswith(("outside", "below", "must be a whole number"))
        ]
    return []


@pytest.mark.parametrize(
    ("document", "path", "low", "high"),
    [row[1:] for row in LIMITS],
    ids=[f"{row[0]}: {row[2]}" for row in LIMITS],
)
def test_limits(document: dict[str, Any], path: str, low: float, high: float) -> None:
    for inside in (low, high):
        slack = 1e-12 if path.endswith(DERIVED) else 0.0
        value = inside if isinstance(inside, int) else inside + slack * abs(inside) * (1 if inside == low else -1)
        assert out_of_range(changed(path, value, document), path) == []
    for limit, outwards in ((low, -math.inf), (high, math.inf)):
        if isinstance(limit, int):
            outside: float = limit - 1 if outwards < 0.0 else limit + 1
        elif path.endswith(DERIVED):
            outside = limit * (1.0 + math.copysign(1e-9, outwards)) or -1e-9
        else:
            outside = float(np.nextafter(limit, outwards))
        found = out_of_range(changed(path, outside, document), path)
        assert len(found) == 1, f"{path} = {outside} passed"


CHOICES = [
    ("converter.modulation", PLAIN),
    ("filter.kind", PLAIN),
    ("grid.scr_basis", PLAIN),
    ("simulation.bridge", PLAIN),
    ("simulation.start", PLAIN),
    ("controllers.0.kind", PLAIN),
    ("power_loops.structure", PLAIN),
]


@pytest.mark.parametrize(("path", "document"), CHOICES, ids=[path for path, _ in CHOICES])
@pytest.mark.parametrize("value", ["nonsense", "", 3, True, ["LC"], {"a": 1}])
def test_choices(path: str, document: dict[str, Any], value: Any) -> None:
    fault = the_fault(changed(path, value, document), field_name(path))
    assert fault.problem.startswith("must be one of")


RULES = [
    ("converter.V_dc", 311.0, "converter.V_dc", "too low"),
    ("converter.f_sw", 499.0, "converter.f_sw", "samples fewer than 20 times a cycle"),
    ("filter.L_2", "1 mH", "filter.L_2", "an LC filter has none"),
    ("filter.R_2", 0.1, "filter.R_2", "an LC filter has none"),
    ("filter.C", "0.1 uF", "filter.C", "frequency (1e+04 Hz)"),
    ("events.1.grid", {"R_g": 0.1, "L_g": "4 uH"}, "filter.C", "strongest grid"),
    ("simulation.log_interval", "70 us", "simulation.log_interval", "not a multiple of the sampling period"),
    ("simulation.log_interval", 0.0, "simulation.log_interval", "not a multiple of the sampling period"),
    ("controllers.1.update_period", "1.01 ms", "controllers[1].update_period", "not a whole number of sampling"),
    ("controllers.1.name", "CVSG", "controllers[1].name", "used twice"),
    ("controllers.1.name", "a/b", "controllers[1].name", "may hold letters"),
    ("controllers.1.name", "-rf", "controllers[1].name", "begins as an option does"),
    ("controllers.1.name", ".hidden", "controllers[1].name", "begins as a hidden file does"),
    ("controllers.1.name", "..", "controllers[1].name", "begins as a hidden file does"),
    ("controllers.1.name", "nul", "controllers[1].name", "cannot be the name of a file on Windows"),
    ("controllers.1.name", "COM1.a", "controllers[1].name", "cannot be the name of a file on Windows"),
    ("controllers.1.name", "fixed.", "controllers[1].name", "cannot be the name of a file on Windows"),
    ("study.name", "aux", "study.name", "cannot be the name of a file on Windows"),
    ("events.0.time", "60 s", "events[0].time", "0 s are left after it"),
    ("events.0.time", "59.99999 s", "events[0].time", "1e-05 s are left after it, less than one sampling period"),
    ("controllers.0.gains", GAINS, "controllers[0].design_grid", "gains are given too"),
    ("controllers", [], "controllers", "none given"),
    ("events.0.over", "1 s", "events[0].over", "there is nothing to ramp"),
    ("events.0", {"time": 1.0}, "events[0]", "changes nothing"),
    ("events.0.time", "61 s", "events[0].time", "outside 0 s to 60 s"),
    ("grid.R_g", 1.0, "grid", "not both"),
    ("converter.V_rated_ll_rms", 190.0, "converter", "not both"),
    ("inner_loops.K_pc", 1.0, "inner_loops", "not both"),
    ("inner_loops.transient_corner", "25 Hz", "inner_loops.transient_corner", "there is no transient impedance"),
    ("grid.scr", MISSING, "grid.scr", "missing"),
    ("converter.S_rated", MISSING, "converter.S_rated", "missing"),
    ("filter", MISSING, "filter", "missing table"),
    ("simulation", MISSING, "simulation", "missing table"),
    ("converter", 3, "converter", "expected a table"),
    ("events", 3, "events", "expected a list of tables"),
    ("study.title", " ", "study.title", "non-empty text"),
]


@pytest.mark.parametrize(("path", "value", "field", "problem"), RULES, ids=[f"{r[0]} {r[3]}" for r in RULES])
def test_rules_between_fields(path: str, value: Any, field: str, problem: str) -> None:
    matching = [f for f in faults_of(changed(path, value)) if f.field == field and problem in f.problem]
    assert len(matching) == 1
    assert problem in ("non-empty text", "not both") or matching[0].advice  # those two say it in the problem


def test_just_inside_the_rules() -> None:
    """The rules do not bite where they should not."""
    assert build(changed("converter.V_dc", 311.2)).converter.V_dc == 311.2
    assert build(document_with(("converter.V_dc", 270.0), ("converter.modulation", "min_max")))
    assert build(
        document_with(
            ("converter.f_sw", 1250.0), ("controllers.1.update_period", "20 ms"), ("simulation.log_interval", "400 us")
        )
    )
    assert build(changed("simulation.log_interval", "50 us")).simulation.log_interval == 50e-6


@pytest.mark.parametrize("f_g", [48.0, 72.0])
def test_a_limit_in_times_of_the_frequency_is_a_round_one(f_g: float) -> None:
    """2π times 60 Hz over 2π is not 60 Hz, and 72 Hz is 1.2 times 60 Hz."""
    study = study_from_text(f"""
base = "case:utility_1mva_60hz"
simulation = {{ duration = 1, P_ref = 0, Q_ref = 0 }}
controllers = [{{ name = "a", kind = "fixed" }}]
events = [{{ time = 0.1, f_g = {f_g} }}]
""")
    assert study.events[0].omega_g == 2.0 * math.pi * f_g
