"""The session: answers of the package's own functions, faults, kept studies, and states of links."""

from __future__ import annotations

import json
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest

from tests.gain_tables import table
from vsgdesign.artifacts import write_table_file
from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.artifacts.ready import NOTHING, Ready, read_tables
from vsgdesign.errors import StudyError
from vsgdesign.report.explore import session as session_module
from vsgdesign.report.explore.fields import changed_study
from vsgdesign.report.explore.linear import linear_answer
from vsgdesign.report.explore.live import simulated
from vsgdesign.report.explore.maps import map_axes
from vsgdesign.report.explore.scene import scene_of, study_of
from vsgdesign.report.explore.session import Session, start_of
from vsgdesign.report.explore.state import StateError, state_of
from vsgdesign.report.explore.wire import Answer, as_bytes
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.loading import study_from_text


@pytest.fixture(scope="module")
def session() -> Session:
    return Session(load_study("studies/structures/study.toml"), NOTHING)


def test_answers_are_those_of_the_models_with_the_colours_of_the_study(session: Session) -> None:
    document = {"scr": 3.0, "changes": {"power_loops.tau_P": "8 ms"}, "controllers": ["decoupled"]}
    answer = session.answer("linear", document)
    assert answer is not None
    study = changed_study(session.study, document["changes"])
    direct = linear_answer(study, NOTHING, state_of(document, session.study))
    (row,) = answer.header["controllers"]
    names = [one["name"] for one in session.info()["controllers"]]
    assert row.pop("colour") == session.info()["controllers"][names.index("decoupled")]["colour"]
    assert json.dumps(row) == json.dumps(direct.header["controllers"][0])
    for name, values in direct.arrays.items():
        np.testing.assert_array_equal(answer.arrays[name], values)


def test_a_changed_study_is_read_once(session: Session) -> None:
    first, second = (
        session.study_of(session.state({"scr": scr, "changes": {"power_loops.tau_P": "9 ms"}})) for scr in (2, 3)
    )
    assert first is second
    assert first.tau_P == 9e-3
    for k in range(2 * session_module.KEPT):
        session.study_of(session.state({"changes": {"power_loops.tau_P": f"{k} ms"}}))
    assert len(session._changed) == session_module.KEPT


def test_faults_of_the_state_and_of_the_study_come_together(session: Session) -> None:
    document = {"scr": -1, "changes": {"power_loops.tau_P": "3 V"}, "typo": 1}
    faults = session.check(document)
    assert {fault["field"] for fault in faults} == {"scr", "power_loops.tau_P", "typo"}
    assert all(fault["text"] for fault in faults)
    for kind in ("linear", "emt", "map"):
        with pytest.raises(StateError) as caught:
            session.answer(kind, document)
        assert caught.value.faults == faults
    assert session.check({}) == []
    assert session.check([]) != []


@pytest.mark.parametrize("changes", [[], "x", {"power_loops.tau_P": None}, {"power_loops.tau_P": [1]}, {"nothing": 1}])
def test_changes_of_another_type_are_faults(session: Session, changes: Any) -> None:
    assert session.check({"changes": changes})


def test_an_overtaken_simulation_ends_early(session: Session) -> None:
    assert session.answer("emt", {}, lambda: True) is None


def test_the_page_learns_that_emt_is_compiled(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_module, "PATIENCE_S", 0.01)
    session._warm.clear()
    try:
        answer = session.answer("emt", {})
        assert answer is not None
        assert (answer.header["again"], answer.header["controllers"]) == (True, [])
        assert "Compiling" in answer.header["words"]
    finally:
        session._warm.set()


def test_answers_wait_for_a_warm_up_that_ends_soon(session: Session) -> None:
    session._warm.clear()
    threading.Timer(0.05, session._warm.set).start()
    begin = time.monotonic()
    answer = session.answer("emt", {"controllers": ["published"]})
    assert answer is not None
    assert len(answer.header["controllers"]) == 1
    assert time.monotonic() - begin > 0.04


def test_processes_of_their_own_give_the_same_emt(session: Session) -> None:
    """Also with a changed study and with words in place of curves; and without the process, once it is lost."""
    apart = Session(session.study, session.ready)
    apart.warm_up(apart=2)
    assert len(apart._apart) == 2
    states: list[dict[str, Any]] = [
        {"scr": 3.0, "event": {"kind": "sag", "size": 0.4}},
        {"changes": {"power_loops.tau_P": "9 ms"}, "controllers": ["published"]},
        {"scr": 0.6, "P_pu": 1.9},
    ]
    try:
        for lost in (False, True):
            for document in states:
                here, there = session.answer("emt", document), apart.answer("emt", document)
                assert here is not None
                assert there is not None
                assert there.header == here.header
                assert there.arrays.keys() == here.arrays.keys()
                assert all(np.array_equal(there.arrays[name], values) for name, values in here.arrays.items())
            assert lost or all(process.alive for process in apart._apart)
            apart._apart[-1].close()
        assert apart.answer("emt", {}, lambda: True) is None
    finally:
        apart.close()


def test_the_study_in_json(session: Session) -> None:
    info = json.loads(json.dumps(plain(session.info()), allow_nan=False))
    study = session.study
    (low, high), (left, right) = info["map"]["scr"], info["map"]["x_over_r"]
    grids = [study.grid, *(event.grid for event in study.events if event.grid is not None)]
    for place in (grid.place(study.converter, study.scr_basis) for grid in grids):
        assert low < place.scr < high
        assert left < place.x_over_r < right
    assert low < info["defaults"]["scr"] < high
    assert {one["kind"] for one in info["events"]} == {"step", "grid", "phase", "sag", "ramp", "voltage_set_point"}
    assert info["modes"]["re"][0] < 0.0 < info["modes"]["re"][1]
    assert session.info() is session.info()


def test_the_window_of_the_modes_holds_them(session: Session) -> None:
    window = session.info()["modes"]
    for scr, x_over_r in ((2.0, 1.0), (10.0, 5.0)):
        answer = session.answer("linear", {"scr": scr, "x_over_r": x_over_r})
        assert answer is not None
        for row in answer.header["controllers"]:
            slowest = row["modes"][0]
            assert window["re"][0] < slowest["re"] < window["re"][1]
            assert abs(slowest["im"]) < window["im"][1]


def test_a_map_that_a_far_grid_widens() -> None:
    study = load_study("studies/structures/study.toml")
    far = study.with_events({"time": "1 s", "grid": {"scr": 60.0, "x_over_r": 0.1}})
    (low, high), (left, right) = map_axes(far)
    place = Place(60.0, 0.1, study.scr_basis)
    assert low < place.scr < high
    assert left < place.x_over_r < right


def test_the_state_of_a_link(session: Session) -> None:
    part = quote(json.dumps({"scr": 4.0, "figure": "damping"}))
    for text in (f"http://127.0.0.1:1/token/#{part}", f"#{part}", part, '{"scr": 4.0, "figure": "damping"}'):
        state = session.state(start_of(text, session.study))
        assert (state.scr, state.figure) == (4.0, "damping_all_modes")  # the link has its name of before
        assert state.x_over_r == session.start.x_over_r
    for text in ("nonsense", "#[1]", "#" + "[" * 100_000):
        with pytest.raises(StateError, match="not the state of a link"):
            start_of(text, session.study)


def test_a_wrong_start_is_refused(session: Session) -> None:
    with pytest.raises(StateError, match="SCR"):
        Session(session.study, NOTHING, start={"scr": 0})


def test_numbers_that_json_has_no_word_for() -> None:
    header = {"a": float("inf"), "b": np.float64("nan"), "c": np.arange(2), "d": (np.int64(1), np.bool_(True))}
    body = as_bytes(Answer(header, {}), seq=3)
    length = int.from_bytes(body[:4], "little")
    found = json.loads(body[4 : 4 + length])
    assert found == {"a": None, "b": None, "c": [0, 1], "d": [1, True], "seq": 3, "arrays": []}
    with pytest.raises(TypeError, match="object"):
        as_bytes(Answer({"a": object()}))


SAVED: tuple[dict[str, Any], ...] = (
    {},
    {"scr": 3.0, "x_over_r": 0.7, "P_pu": 0.3, "Q_pu": -0.1, "V_g_pu": 1.03, "f_hz": 49.8},
    {"error_R": 0.1, "error_X": -0.05, "silent_s": 0.04, "event": {"kind": "grid", "to_scr": 4.0, "to_x_over_r": 2.0}},
    {"hold": {"scr": 8.0, "x_over_r": 3.0}, "event": {"kind": "phase", "size": 15.0}},
    {
        "changes": {"power_loops.tau_P": "8 ms", "converter.current_limit_pu": 1.4},
        "event": {"kind": "sag", "size": 0.3},
    },
    {
        "own": {"K_ip": 0.003, "K_iq": 0.05, "D_p": 400.0},
        "controllers": ["own"],
        "event": {"kind": "ramp", "size": -0.4},
    },
)


@pytest.mark.parametrize("document", SAVED)
def test_a_saved_study_runs_as_the_page_shows(session: Session, document: dict[str, Any]) -> None:
    document = {"controllers": ["angle_damped"]} | document
    state = session.state(document)
    study = session.study_of(state)
    saved = session.save(document)
    assert saved["name"].endswith(".toml")
    read = study_from_text(saved["toml"], folder="/nowhere")
    expected = study_of(scene_of(study, NOTHING, state), NOTHING, state, 0)
    logs = [simulated(one, NOTHING).log for one in (read, expected)]
    assert logs[0].shape == logs[1].shape
    # The file gives SCR and X/R, the page's study R_g and L_g: they differ in the last bits.
    np.testing.assert_allclose(logs[0], logs[1], rtol=1e-6, atol=1e-6 * np.abs(logs[1]).max())


def test_controllers_that_need_other_references_are_left_out(session: Session) -> None:
    # At SCR 2 the voltage is 1.2 pu: another droop of V adds another Q, and one study has one Q_ref.
    saved = session.save({"map_of": "decoupled"})
    read = study_from_text(saved["toml"])
    assert [spec.name for spec in read.controllers] == ["decoupled", "angle_damped"]
    assert "published is left out: with its droops it needs other references" in saved["words"]
    assert "# published is left out" in saved["toml"]
    result = run_scenario(read, NOTHING).controllers[0]
    answer = session.answer("emt", {"controllers": ["decoupled"]})
    assert answer is not None
    P = result.simulation.column("P") / read.converter.S_rated
    np.testing.assert_allclose(answer.arrays["0/P"][[0, -1]], P[[0, -1]], rtol=1e-4)


def test_controllers_with_the_same_references_are_saved_together(session: Session) -> None:
    # Without droop of V, and at the nominal frequency, every controller takes the powers themselves.
    document = {"changes": {"power_loops.Q_droop": 0, "power_loops.droop_ratio": 0}}
    saved = session.save(document | {"controllers": ["decoupled", "angle_damped"]})
    read = study_from_text(saved["toml"])
    assert [spec.name for spec in read.controllers] == ["decoupled", "angle_damped"]
    assert saved["words"] == ""
    assert len(run_scenario(read, NOTHING).controllers) == 2


def test_a_saved_table_is_named_by_its_file(tmp_path: Path) -> None:
    study = load_study("studies/table/study.toml")
    made, path = table(name="table", base=base_of(study, "impedance")), tmp_path / "table.json"
    write_table_file(made, path)
    session = Session(study, Ready(tables={"table": made}), files={"table": path})
    read = study_from_text(session.save({"controllers": ["table"]})["toml"])
    assert [spec.table_file for spec in read.controllers] == [str(path)]
    assert read_tables(read)["table"].sha256 == made.sha256
    # With another filter of P the same table would be refused: a run designs it for the changed study.
    text = session.save({"changes": {"power_loops.tau_P": "8 ms"}, "controllers": ["table"]})["toml"]
    assert "designs it again" in text
    assert study_from_text(text).controllers[0].table_file is None
    # Held gains are numbers.
    held = study_from_text(session.save({"hold": {"scr": 5.0, "x_over_r": 1.0}, "controllers": ["table"]})["toml"])
    assert [spec.kind for spec in held.controllers] == ["fixed"]


def test_what_cannot_be_saved_says_why(session: Session) -> None:
    with pytest.raises(StateError, match="nothing can be saved"):
        session.save({"scr": 0.2, "P_pu": 1.5})
    with pytest.raises(StateError, match="no controller"):
        session.save({"controllers": []})


def test_the_session_of_a_study_without_a_document_cannot_be_changed() -> None:
    study = replace(load_study("studies/structures/study.toml"), origin=None)
    with pytest.raises((StateError, StudyError), match="document"):
        Session(study, NOTHING).save({})
