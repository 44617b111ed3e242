"""The state of the explorer's page: read with every fault at once, and changes of the study by its one reader."""

from __future__ import annotations

import math
from typing import Any

import pytest

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.report.drawing.quantities import GAIN_UNITS
from vsgdesign.report.explore.fields import STUDY_FIELDS, changed_study, fields_of, gains_of, quantities_of
from vsgdesign.report.explore.state import OWN, StateError, defaults, state_of
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import Study

STUDIES = ("structures", "utility", "table")


@pytest.fixture(params=STUDIES)
def study(request: pytest.FixtureRequest) -> Study:
    return load_study(f"studies/{request.param}/study.toml")


def faults(function: Any, *arguments: Any) -> dict[str, dict[str, Any]]:
    with pytest.raises(StateError) as caught:
        function(*arguments)
    return {one["field"]: one for one in caught.value.faults}


def test_the_defaults_are_the_study(study: Study) -> None:
    state = state_of({}, study)
    assert state.document() == defaults(study) == state_of(state.document(), study).document()
    assert state.P_pu * study.converter.S_rated == pytest.approx(study.simulation.P_ref, rel=1e-12)
    assert 2.0 * math.pi * state.f_hz == pytest.approx(study.grid_source.omega_g, rel=1e-12)


def test_all_faults_at_once(study: Study) -> None:
    document = {
        "scr": math.nan,
        "P_pu": "a",
        "foo": 1,
        "hold": {"scr": -1},
        "event": {"kind": "blast", "size": True},
        "figure": ["disk_margin_output"],
        "own": {"K_ip": -1, "K_x": 2},
        "controllers": ["nobody"],
        "changes": {"power_loops.tau_P": None},
    }
    found = faults(state_of, document, study)
    assert found.keys() == {
        *("scr", "P_pu", "foo", "hold.scr", "hold.x_over_r", "event.kind", "event.size", "figure", "own.K_ip"),
        *("own.K_iq", "own.K_x", "controllers", "power_loops.tau_P"),
    }
    most = 2.0 * study.converter.S_rated / 1e3
    assert (found["P_pu"]["limit"], found["P_pu"]["unit"]) == (f"-{most:g} to {most:g}", "kW")
    assert found["P_pu"]["text"] == f"P must be a number between -{most:g} and {most:g} kW, not a."
    assert found["scr"]["value"] == "nan", "JSON has no NaN"


@pytest.mark.parametrize("document", [None, [], "x", 3])
def test_a_document_that_is_no_object(document: Any) -> None:
    study = load_study("studies/structures/study.toml")
    assert faults(state_of, document, study).keys() == {"state"}


def test_own_gains_have_the_limits_of_a_study_file() -> None:
    study = load_study("studies/structures/study.toml")
    good = {"K_ip": 0.002, "K_iq": 0.06, "D_p": 300.0}
    own = state_of({"own": good, "controllers": [OWN]}, study).own
    assert own == PowerLoopGains(0.002, 300.0, 0.06, 0.0, 0.0, 0.0, 0.0, 0.0)
    found = faults(state_of, {"own": good | {"K_ip": 1e9, "D_q": "", "k_P": math.nan}}, study)
    assert found.keys() == {"own.K_ip", "own.D_q", "own.k_P"}
    assert found["own.K_ip"]["text"] == "K_ip must be a number between 1e-15 and 1e+06 rad/(s²·W), not 1000000000.0."
    assert found["own.D_q"]["text"].endswith("not empty.")
    assert {row["name"]: row["unit"] for row in gains_of()} == GAIN_UNITS


def test_controllers_are_in_the_order_of_the_study() -> None:
    study = load_study("studies/structures/study.toml")
    document = {"controllers": [OWN, "angle_damped", "published"]}
    assert state_of(document, study).controllers == ("published", "angle_damped")
    assert state_of(document | {"own": {"K_ip": 0.002, "K_iq": 0.06}}, study).controllers[-1] == OWN


def test_fields_are_those_of_the_reader(study: Study) -> None:
    asked = quantities_of(study)
    fields = {row["path"]: row for row in fields_of(study)}
    shown = {one.path: one for one in STUDY_FIELDS if one.path in fields}
    assert {"power_loops.tau_P", "converter.current_limit_pu", "power_loops.settling_time"} <= shown.keys()
    for path, one in shown.items():
        assert fields[path]["high"] == asked[path].high * one.scale
        assert fields[path]["slider"][0] < fields[path]["slider"][1]
        if asked[path].value is not None:
            assert fields[path]["value"] == asked[path].value * one.scale


def test_changes_are_checked_by_the_reader() -> None:
    study = load_study("studies/structures/study.toml")
    changed = changed_study(study, {"power_loops.tau_P": "7 ms", "converter.delay_samples": "1 samples"})
    assert (changed.tau_P, changed.converter.delay_samples) == (0.007, 1)
    assert changed_study(study, {}) is study
    wrong = {
        "power_loops.P_droop": "500 %",
        "power_loops.tau_P": "5 kg",
        "converter.delay_samples": 2,
        "power_loops.k_2": math.nan,
        "study.name": "x",
    }
    found = faults(changed_study, study, wrong)
    assert found.keys() == wrong.keys()
    assert found["power_loops.P_droop"]["limit"] == "0 to 100 %"
    assert (found["power_loops.tau_P"]["limit"], found["power_loops.tau_P"]["unit"]) == ("0 to 1000 ms", "ms")
    assert found["power_loops.tau_P"]["text"] == "Filter of P must be a number between 0 and 1000 ms, not 5 kg."


def test_designed_inner_loops_are_kept() -> None:
    text = "studies/structures/study.toml"
    study = load_study(text)
    changed = changed_study(study, {"power_loops.settling_time": "0.5 s", "converter.delay_samples": 1})
    assert changed.inner_gains == study.inner_gains
    assert changed.controllers[0].target.settling_time == 0.5


def test_faults_are_in_the_units_of_the_fields(study: Study) -> None:
    """Before: a field in kW, in per cent or in ms named limits in per unit or in s."""
    document = {"P_pu": 3.0, "Q_pu": -3.0, "error_R": -1.5, "error_X": 20, "silent_s": -0.5, "V_g_pu": 9}
    found = faults(state_of, document, study)
    for field in fields_of(study):
        if field["path"] in document:
            one = found[field["path"]]
            shown = document[field["path"]] * field.get("scale", 1.0)
            assert one["unit"] == field["unit"]
            assert one["limit"] == f"{field['low']:.6g} to {field['high']:.6g}"
            ends = f"{field['low']:.6g} and {field['high']:.6g} {field['unit']}"
            assert one["text"] == f"{field['label']} must be a number between {ends}, not {shown:.6g}."
    assert found["error_R"]["text"] == "Error of R must be a number between -90 and 1000 %, not -150."
