"""A study changed in Python is the study that a file with these changes gives, faults included."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vsgdesign.errors import StudyError
from vsgdesign.study.parameters import Study, load_study, study_from_text
from vsgdesign.study.parameters.loading import built, merged_document
from vsgdesign.study.parameters.study import StudyOrigin

ROOT = Path(__file__).resolve().parents[2]
BASE = """
base = "case:hoang2025_5kva"
[simulation]
duration = "4 s"
P_ref = "1 kW"
Q_ref = 0
[[controllers]]
name = "AVSG"
kind = "scheduled"
"""


def test_no_change_gives_the_same_study() -> None:
    study = load_study(ROOT / "studies/structures/study.toml")
    again = study.with_changes()
    assert again == study
    assert again.hash == study.hash
    assert again.files == study.files


def test_a_change_equals_the_file_that_says_it() -> None:
    changed = study_from_text(BASE).with_changes(
        grid={"scr": np.float64(3.0), "x_over_r": 4}, simulation={"P_ref": "2 kW"}
    )
    written = study_from_text(BASE.replace('"1 kW"', '"2 kW"') + "[grid]\nscr = 3.0\nx_over_r = 4\n")
    assert changed == written
    assert changed.hash == written.hash


def test_controllers_and_events_are_replaced() -> None:
    study = study_from_text(BASE).with_controllers({"name": "a", "kind": "fixed"}, {"name": "b", "kind": "scheduled"})
    study = study.with_events({"time": 1, "P_ref": "2 kW"}).with_events({"time": "2 s", "Q_ref": "1 kvar"})
    assert [spec.name for spec in study.controllers] == ["a", "b"]
    assert [(event.t_s, event.P_ref, event.Q_ref) for event in study.events] == [(2.0, None, 1000.0)]


def test_every_fault_at_once_by_the_same_reader() -> None:
    with pytest.raises(StudyError) as caught:
        study_from_text(BASE).with_events({"time": "1 m", "P_reff": "2 kW"}, {"time": 9})
    fields = [fault.field for fault in caught.value.faults]
    assert {"events[0].time", "events[0].P_reff", "events[1].time"} <= set(fields)


def test_a_grid_that_is_no_table_is_a_fault() -> None:
    with pytest.raises(StudyError, match=r"events\[0\].grid"):
        study_from_text(BASE).with_events({"time": 1, "grid": 5})


def test_fields_that_were_replaced_directly_are_not_lost_silently() -> None:
    study = study_from_text(BASE)
    with pytest.raises(StudyError, match="with_changes"):
        replace(study, tau_P=0.02).with_events({"time": 1, "P_ref": "2 kW"})


def test_a_study_without_a_document_says_so() -> None:
    with pytest.raises(StudyError, match="document"):
        replace(study_from_text(BASE), origin=None).with_changes()


def system_alone(**changes: object) -> Study:
    document = merged_document({"base": "case:lab_12kva_lcl"})
    return built(document, StudyOrigin(document, ".", "lab", "lab"), changes, None)


def test_a_system_alone_gets_a_controller_references_and_a_duration() -> None:
    study = system_alone()
    assert [spec.kind for spec in study.controllers] == ["scheduled"]
    assert (study.simulation.P_ref, study.simulation.Q_ref, study.simulation.duration) == (0.0, 0.0, 3.0)


def test_the_duration_follows_the_last_event_until_it_is_given() -> None:
    study = system_alone().with_events({"time": "2 s", "P_ref": "4 kW"})
    assert study.simulation.duration == 5.0
    assert study.with_changes(simulation={"duration": 2.5}).simulation.duration == 2.5


def test_files_that_are_named_in_python_are_beside_where_it_runs() -> None:
    table = {"name": "table", "kind": "scheduled", "schedule": "table", "table": "mine.json"}
    (spec,) = study_from_text(BASE, folder="elsewhere").with_controllers(table).controllers
    assert spec.table_file == str(Path("mine.json").absolute())
