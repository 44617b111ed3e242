"""Negative sequence and harmonics of the source in a study file."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tests.parameters.documents import build, case_document, changed, faults_of, the_fault
from vsgdesign.artifacts.design_inputs import design_inputs
from vsgdesign.study.parameters.grid import SourceComponent

V2: dict[str, Any] = {"order": -1, "amplitude_pu": 0.02, "phase": "90 deg"}


def with_components(*components: dict[str, Any]) -> dict[str, Any]:
    return changed("grid.components", list(components))


def test_they_are_read_with_their_units() -> None:
    study = build(with_components(V2, {"order": 7, "amplitude_pu": "1 %"}))
    assert study.grid_source.components == (SourceComponent(-1.0, 0.02, math.pi / 2), SourceComponent(7.0, 0.01, 0.0))
    assert study.has_components
    assert not build(case_document()).has_components


def test_an_event_replaces_all_of_them_and_says_so() -> None:
    document = with_components(V2)
    document["events"] += [
        {"time": "51 s", "components": [{"order": -5, "amplitude_pu": 0.03}]},
        {"time": "52 s", "components": []},
    ]
    events = build(document).events
    assert [event.components for event in events if event.t_s > 50.5] == [(SourceComponent(-5.0, 0.03, 0.0),), ()]
    assert [event.name for event in events if event.t_s > 50.5] == ["source -5: 3 %", "no source components"]
    assert all(event.components is None for event in events if event.t_s < 50.5)


@pytest.mark.parametrize(
    ("component", "field", "problem"),
    [
        ({"order": 1, "amplitude_pu": 0.02}, "order", "is the fundamental itself, which V_g_pu gives"),
        ({"order": 0, "amplitude_pu": 0.02}, "order", "is a dc voltage"),
        ({"order": -1, "amplitude_pu": 2}, "amplitude_pu", "outside 0 to 1"),
        ({"order": -1, "amplitude_pu": float("nan")}, "amplitude_pu", ""),
        ({"order": 5}, "amplitude_pu", "missing"),
        ({"order": 7, "amplitude_pu": 0.02, "phase": "1 s"}, "phase", ""),
        ({"order": 7, "amplitud_pu": 0.02, "amplitude_pu": 0.02}, "amplitud_pu", "unknown field"),
        ({"order": 13, "amplitude_pu": 0.02}, "order", "is given twice"),
    ],
)
def test_a_faulty_component_is_named(component: dict[str, Any], field: str, problem: str) -> None:
    document = with_components({"order": 13, "amplitude_pu": 0.01}, component)
    fault = the_fault(document, f"grid.components[1].{field}")
    assert problem in fault.problem


def test_a_list_of_something_else_is_a_fault() -> None:
    assert [fault.field for fault in faults_of(changed("grid.components", 0.02))] == ["grid.components"]
    document = case_document()
    document["events"].append({"time": "51 s", "components": 0.02})
    assert {fault.field.split("].")[-1] for fault in faults_of(document)} == {"components"}


def test_two_events_at_one_instant_may_not_disagree() -> None:
    document = case_document()
    document["events"] += [{"time": "51 s", "components": []}, {"time": "51 s", "components": [V2]}]
    assert "gives other components at the same instant" in faults_of(document)[0].problem


def test_a_table_does_not_depend_on_them() -> None:
    clean, distorted = build(case_document()), build(with_components(V2))
    target = clean.controllers[0].target
    assert design_inputs(clean, target) == design_inputs(distorted, target)
