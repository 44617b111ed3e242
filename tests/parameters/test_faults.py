"""What a user is told: everything at once, each with its field, its value, the limit and what to do."""

from __future__ import annotations

from typing import Any

import pytest

from tests.parameters.documents import MISSING, build, case_document, changed, faults_of, the_fault
from vsgdesign.errors import StudyError


def test_every_fault_is_reported_at_once() -> None:
    document = case_document()
    for path, value in [
        ("converter.S_rated", "5 kV"),
        ("converter.f_n", True),
        ("filter.L_1", "1"),
        ("filter.kind", "CL"),
        ("inner_loops.current_response_time", float("nan")),
        ("grid.scr", -2),
        ("power_loops.droop_ratio", float("inf")),
        ("simulation.duration", MISSING),
        ("events.2.P_ref", "3 kvar"),
        ("controllers.0.kind", "fixd"),
        ("controllers.1.updat_period", "20 ms"),
        ("nonsense", 1),
    ]:
        document = changed(path, value, document)
    found = {fault.field: fault for fault in faults_of(document)}
    expected = {
        "converter.S_rated",
        "converter.f_n",
        "filter.L_1",
        "filter.kind",
        "inner_loops.current_response_time",
        "grid.scr",
        "power_loops.droop_ratio",
        "simulation.duration",
        "events[2].P_ref",
        "controllers[0].kind",
        "controllers[1].updat_period",
        "nonsense",
    }
    assert found.keys() == expected
    for fault in found.values():
        assert fault.problem


def test_a_wrong_unit_shows_value_limits_and_what_was_read() -> None:
    """1 for 1 mH: the classic. The message has all four parts."""
    fault = the_fault(changed("filter.L_1", 1), "filter.L_1")
    assert str(fault) == (
        "filter.L_1 = 1: outside 100 nH to 500 mH (read as 1 H). Check the unit: a bare number is SI."
    )
    ratio = the_fault(changed("grid.scr", -3), "grid.scr")
    assert str(ratio) == "grid.scr = -3: outside 0.05 to 10000. Give a value within these limits."
    written = the_fault(changed("filter.L_1", True), "filter.L_1")
    assert str(written).startswith("filter.L_1 = true: expected a number in H")


@pytest.mark.parametrize(
    ("path", "typo", "suggestion"),
    [
        ("converter", "S_ratd", "S_rated"),
        ("converter", "fsw", "f_sw"),
        ("filter", "L1", "L_1"),
        ("grid", "SCR", "scr"),
        ("simulation", "durations", "duration"),
        ("events.0", "tim", "time"),
        ("controllers.1", "update_periods", "update_period"),
        ("power_loops", "settling_tme", "settling_time"),
    ],
)
def test_an_unknown_field_names_its_neighbour(path: str, typo: str, suggestion: str) -> None:
    found = faults_of(changed(f"{path}.{typo}", 1))
    unknown = [fault for fault in found if fault.problem == "unknown field"]
    assert len(unknown) == 1
    assert unknown[0].field.endswith("." + typo)
    if typo == "SCR":  # nothing near in letters: the known ones are listed
        assert suggestion in unknown[0].advice
    else:
        assert unknown[0].advice == f"Did you mean {suggestion}?"


def test_an_unknown_section_names_its_neighbour() -> None:
    assert the_fault(changed("convertr", {"S_rated": 1}), "convertr").advice == "Did you mean converter?"


@pytest.mark.parametrize(
    ("field", "section"),
    [
        (field, section)
        for section, fields in {
            "converter": ("S_rated", "f_n", "V_dc", "f_sw"),
            "filter": ("kind", "L_1", "R_1", "C"),
            "inner_loops": ("current_response_time", "voltage_response_time"),
            "grid": ("scr", "x_over_r"),
            "simulation": ("duration", "P_ref", "Q_ref"),
        }.items()
        for field in fields
    ],
)
def test_a_missing_field_is_asked_for_once(section: str, field: str) -> None:
    fault = the_fault(changed(f"{section}.{field}", MISSING), f"{section}.{field}")
    assert fault.problem == "missing"
    assert fault.advice.startswith("Give ")


@pytest.mark.parametrize("value", [True, [1], {"a": 1}, "", "1 kg", float("nan"), float("inf"), 10**400])
@pytest.mark.parametrize("path", ["converter.S_rated", "converter.f_sw", "simulation.duration", "grid.scr"])
def test_a_value_of_the_wrong_kind_is_one_fault(path: str, value: Any) -> None:
    """A faulty field must not bring down, or be blamed on, those that depend on it."""
    found = faults_of(changed(path, value))
    assert [fault.field for fault in found] == [path]


def test_the_error_lists_the_faults_and_the_file() -> None:
    document = changed("filter.C", 1, changed("filter.L_1", 1))
    with pytest.raises(StudyError) as caught:
        build(document)
    text = str(caught.value)
    assert text.splitlines()[0] == "study text: 2 faults"
    assert text.count("\n  - filter.") == 2
    assert len(caught.value.faults) == 2


def test_event_faults_are_named_by_their_place_in_the_file() -> None:
    """Events are sorted by time when read; a message still counts them as written."""
    document = case_document()
    document["events"] = [{"time": 30.0, "P_ref": "x"}, {"time": 10.0, "P_ref": 1.0}]
    assert [fault.field for fault in faults_of(document)] == ["events[0].P_ref"]


def test_events_are_sorted_whatever_their_order() -> None:
    document = case_document()
    document["events"].reverse()
    assert [event.t_s for event in build(document).events] == [10.0, 20.0, 30.0, 40.0, 50.0]


def test_an_event_keeps_what_it_does_not_change() -> None:
    """SCR alone keeps the X/R of the event before, X/R alone the SCR; lossless stays lossless, on both bases."""
    for basis in ("impedance", "reactance"):
        document = changed("grid", {"scr": 2.0, "x_over_r": 3.0, "scr_basis": basis})
        document["events"] = [
            {"time": 1.0, "grid": {"scr": 5.0}},
            {"time": 2.0, "grid": {"x_over_r": 0.5}},
            {"time": 3.0, "grid": {"scr": 7.0}},
            {"time": 4.0, "grid": {"R_g": 0.0, "L_g": "5 mH"}},
            {"time": 5.0, "grid": {"scr": 4.0}},
        ]
        study = build(document)
        seen = [
            (e.grid.scr(study.converter, basis), e.grid.x_over_r(study.converter.omega_n))
            for e in study.events
            if e.grid is not None
        ]
        for (scr, ratio), (expected_scr, expected_ratio) in zip(
            seen[:3], [(5.0, 3.0), (5.0, 0.5), (7.0, 0.5)], strict=True
        ):
            assert scr == pytest.approx(expected_scr, rel=1e-13)
            assert ratio == pytest.approx(expected_ratio, rel=1e-13)
        last = study.events[4].grid
        assert last is not None
        assert last.R_g == 0.0
        assert last.scr(study.converter, basis) == pytest.approx(4.0, rel=1e-13)


def test_line_to_line_and_phase_voltage_say_the_same() -> None:
    phase = build(case_document()).converter.V_rated_rms
    document = changed("converter.V_rated_ll_rms", 110.0 * 3.0**0.5, changed("converter.V_rated_rms", MISSING))
    assert build(document).converter.V_rated_rms == pytest.approx(phase, rel=1e-15)


def same_instant(*events: dict[str, Any]) -> list[str]:
    document = case_document()
    document["events"] = [{"time": "1 s", **event} for event in events]
    return [str(fault) for fault in faults_of(document)]


def test_events_of_one_instant_that_contradict_each_other() -> None:
    """The last one used to win in silence. All contradictions at once, with both events and both values."""
    found = same_instant(
        {"P_ref": "2.5 kW", "V_g_pu": 0.9, "over": "20 ms", "grid": {"scr": 4}},
        {"P_ref": "3 kW", "V_g_pu": 0.9, "grid": {"scr": 5}},
        {"grid": {"R_g": "1 ohm", "L_g": "3 mH"}, "phase_jump": "5 deg"},
        {"phase_jump": "-5 deg"},
    )
    assert len(found) == 6
    assert (
        'events[1].P_ref = "3 kW": events[0] sets it to 2.5 kW at the same instant, 1 s. '
        "Give one value, or different times." in found
    )
    for start in ("events[1].over = 0", "events[1].grid.scr = 5", "events[3].phase_jump"):
        assert sum(text.startswith(start) for text in found) == 1
    assert sum("gives the grid in other terms" in text for text in found) == 2


def test_events_of_one_instant_that_agree_or_change_different_things() -> None:
    document = case_document()
    document["events"] = [
        {"time": "1 s", "P_ref": "2.5 kW", "grid": {"scr": 4}},
        {"time": "1000 ms", "P_ref": 2500, "Q_ref": "1 kvar", "grid": {"x_over_r": 2}},
        {"time": "2 s", "P_ref": "3 kW", "grid": {"scr": 8}},
    ]
    study = build(document)
    assert [event.grid.x_over_r(study.converter.omega_n) for event in study.events if event.grid][-1] == pytest.approx(
        2
    )
