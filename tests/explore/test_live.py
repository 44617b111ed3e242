"""The page's EMT: the same figures as ``vsgdesign run`` and the judge of survival, for every event and every state."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.examples import TIMES
from tests.gain_tables import table
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.report.explore import live, page_verdicts
from vsgdesign.report.explore.live import SIGNALS, emt_answer
from vsgdesign.report.explore.scene import LEAD_S, scene_of, study_of
from vsgdesign.report.explore.state import state_of
from vsgdesign.report.explore.wire import MOST, thinned
from vsgdesign.report.scenario.outcomes import step_outcomes
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import Study

EVENTS: tuple[dict[str, Any], ...] = (
    {"kind": "step", "size": 0.1},
    {"kind": "step", "size": -0.05, "signal": "Q"},
    {"kind": "grid", "to_scr": 3.0, "to_x_over_r": 3.0},
    {"kind": "phase", "size": 20.0},
    {"kind": "sag", "size": 0.6, "length_s": 0.15},
    {"kind": "ramp", "size": -0.1, "length_s": 0.5},
)
"""Every kind of event."""


@cache
def structures() -> Study:
    return load_study("studies/structures/study.toml")


def random_document(rng: np.random.Generator, k: int) -> dict[str, Any]:
    """A random state of the page with one controller; the kinds of events in turn."""
    study = structures()
    hold = {"scr": rng.uniform(2.0, 8.0), "x_over_r": rng.uniform(0.5, 3.0)} if rng.random() < 0.3 else None
    return {
        "scr": math.exp(rng.uniform(math.log(1.6), math.log(15.0))),
        "x_over_r": math.exp(rng.uniform(math.log(0.5), math.log(8.0))),
        "P_pu": rng.uniform(-0.7, 0.7),
        "Q_pu": rng.uniform(-0.2, 0.2),
        "error_R": rng.uniform(-0.2, 0.2) if rng.random() < 0.6 else 0.0,
        "error_X": rng.uniform(-0.2, 0.2) if rng.random() < 0.6 else 0.0,
        "silent_s": rng.choice([0.0, 0.1, 0.4]),
        "hold": hold,
        "event": EVENTS[k % len(EVENTS)],
        "controllers": [study.controllers[k % 3].name],
    }


def as_a_file_says(study: Study, document: dict[str, Any], end_s: float) -> Study:
    """The study of a state, written as a study file and read by the reader. The frequency and the voltage are nominal.

    Droops of the published structure and of a nominal frequency need no correction of the references; a droop of Q
    does, which the references of the page's own study tell.
    """
    state = state_of(document, study)
    scene = scene_of(study, NOTHING, state)
    of_page = study_of(scene, NOTHING, state, 0).simulation
    event, name = document["event"], document["controllers"][0]
    c, kind = study.converter, event["kind"]
    changed: dict[str, Any] = {"time": LEAD_S}
    more = []
    if kind == "step":
        changed[f"{event.get('signal', 'P')}_ref"] = event["size"] * c.S_rated + (
            of_page.P_ref if event.get("signal", "P") == "P" else of_page.Q_ref
        )
    elif kind == "grid":
        changed["grid"] = {"scr": event["to_scr"], "x_over_r": event["to_x_over_r"]}
    elif kind == "phase":
        changed["phase_jump"] = f"{event['size']} deg"
    elif kind == "sag":
        changed["V_g_pu"] = 1.0 - event["size"]
        more.append({"time": LEAD_S + event["length_s"], "V_g_pu": 1.0})
    else:
        changed |= {"f_g": c.omega_n / (2.0 * math.pi) + event["size"], "over": event["length_s"]}
    written = next(dict(one) for one in study.origin.document["controllers"] if one["name"] == name)  # type: ignore[union-attr]
    if document["hold"] is None:
        known = {"error_R": document["error_R"], "error_X": document["error_X"], "silent": document["silent_s"]}
        written |= {"knowledge": known} if any(known.values()) else {}
    else:
        gains = {field: float(value[0]) for field, value in scene.cells.gains._asdict().items() if value[0] != 0.0}
        written = {key: written[key] for key in ("name", "structure") if key in written}
        written |= {"kind": "fixed", "gains": gains}
    return study.with_changes(
        grid={"scr": document["scr"], "x_over_r": document["x_over_r"]},
        simulation={
            "duration": end_s,
            "bridge": "averaged",
            "P_ref": of_page.P_ref,
            "Q_ref": of_page.Q_ref,
            "survival": kind != "step",
            "reference_limit_pu": 10.0,
        },
        controllers=[written],
        events=[changed, *more],
    )


def test_the_figures_are_those_of_a_run() -> None:
    """Overshoot, settling time, recovery, peak, limited time and swing of ``vsgdesign run``, in random states."""
    study, rng = structures(), np.random.default_rng(16)
    good = 0
    for k in range(10 * TIMES):
        document = random_document(rng, k)
        answer = emt_answer(study, NOTHING, state_of(document, study))
        assert answer is not None
        (row,) = answer.header["controllers"]
        if not answer.arrays:
            assert row["why"]
            continue
        run = study_of(scene_of(study, NOTHING, state_of(document, study)), NOTHING, state_of(document, study), 0)
        try:
            result = run_scenario(as_a_file_says(study, document, run.simulation.duration)).controllers[0]
        except InfeasibleStudyError:  # the references alone have no operating point; the page shows what the droops do
            continue
        good += 1
        if document["event"]["kind"] == "step":
            signal = f"{document['event'].get('signal', 'P')}_pcc"
            event = next(one for one in result.events if one.signal == signal)
            assert row["status"] == {"measured": "settled"}.get(event.status, event.status)
            expected = {"settling_s": event.cycle_mean.settling_time_s}
            over = event.cycle_mean.overshoot_pct
            expected["overshoot"] = None if over is None else over / 100.0
        else:
            verdict = result.survival
            assert verdict is not None
            assert row["status"] == verdict.status
            assert row["why"] == (verdict.reason or "") * (not verdict.survived)
            expected = {name: getattr(verdict, name) for name in ("recovery_s", "peak_pu", "limited_s")}
            expected["swing_deg"] = None if verdict.swing_rad is None else math.degrees(verdict.swing_rad)
        for name, value in expected.items():
            assert row[name] == (None if value is None else pytest.approx(value, rel=1e-9, abs=1e-9)), (k, name)
    assert good >= 0.75 * 10 * TIMES


def test_a_step_ends_at_the_rest_of_the_run_off_nominal() -> None:
    """At 50.15 Hz and 1.03 pu both droops move the rest: P_ref + 0.1 pu is not where the power ends."""
    study = structures()
    document = {"scr": 4.0, "x_over_r": 2.0, "P_pu": 0.3, "Q_pu": -0.05, "V_g_pu": 1.03, "f_hz": 50.15}
    for name in ("published", "decoupled", "angle_damped"):
        state = state_of(document | {"event": {"kind": "step", "size": 0.1}, "controllers": [name]}, study)
        answer = emt_answer(study, NOTHING, state)
        assert answer is not None
        (row,) = answer.header["controllers"]
        result = run_scenario(study_of(scene_of(study, NOTHING, state), NOTHING, state, 0))
        step = next(one for one in step_outcomes(result) if one.metrics.signal == "P_pcc")
        assert row["settling_s"] == pytest.approx(step.settling_time_s, rel=1e-9)
        assert row["overshoot"] == pytest.approx((step.measured_overshoot_pct or 0.0) / 100.0, rel=1e-9)


def test_curves_begin_at_the_states_powers_and_keep_their_extremes() -> None:
    study = structures()
    for event in EVENTS:
        state = state_of({"scr": 4.0, "x_over_r": 2.0, "P_pu": 0.4, "Q_pu": -0.1, "event": event}, study)
        answer = emt_answer(study, NOTHING, state)
        assert answer is not None
        assert [row["name"] for row in answer.header["controllers"]] == [one.name for one in study.controllers]
        for k in range(3):
            t, *curves = (answer.arrays[f"{k}/{name}"] for name in ("t", *SIGNALS))
            assert t[0] == pytest.approx(-LEAD_S)
            assert (np.diff(t) > 0.0).all()
            assert all(len(curve) == len(t) <= MOST for curve in curves)
            before = t < -1e-3
            assert curves[0][before] == pytest.approx(0.4, abs=1e-4)
            assert curves[1][before] == pytest.approx(-0.1, abs=1e-4)
            largest = max(answer.header["controllers"][k][name] for name in ("peak_pu", "first_peak_pu"))
            assert float(curves[2].max()) == pytest.approx(largest, rel=1e-6)


def test_thinned_rows_keep_extremes_and_draw_the_rest() -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 1.0, 20011)
    smooth = np.sin(9.0 * t) * np.exp(-2.0 * t)
    spike = np.where(np.arange(len(t)) == 7777, 5.0, smooth)
    ripple = smooth + 0.2 * np.sin(4000.0 * t)
    noise = rng.normal(size=len(t))
    rows = thinned([smooth, spike, ripple, noise])
    assert len(rows) <= MOST
    assert rows[0] == 0
    assert rows[-1] == len(t) - 1
    for signal in (smooth, spike, ripple, noise):
        assert {int(np.argmin(signal)), int(np.argmax(signal))} <= set(rows.tolist())
    rows = thinned([smooth])
    assert np.interp(t, t[rows], smooth[rows]) == pytest.approx(smooth, abs=2e-3)
    assert thinned([smooth[:500]]).tolist() == list(range(500))


def test_words_where_nothing_can_be_simulated() -> None:
    study = structures()
    answer = emt_answer(study, NOTHING, state_of({"scr": 0.6, "x_over_r": 2.0, "P_pu": 1.9}, study))
    assert answer is not None
    assert answer.arrays == {}
    for row in answer.header["controllers"]:
        assert row["status"] == "no operating point"
        assert row["why"]
        assert row["verdict"]
        assert row["peak_pu"] is None


def test_a_newer_request_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    study, begun = structures(), []
    one = live._run
    monkeypatch.setattr(live, "_run", lambda *given: begun.append(1) or one(*given))
    assert emt_answer(study, NOTHING, state_of({}, study), lambda: len(begun) > 0) is None
    assert len(begun) == 1


def test_held_gains_stay_through_a_jump_of_the_grid() -> None:
    """With the gains of SCR 2 a step on a strong grid overshoots more than with those of its own grid."""
    study = structures()
    document = {"scr": 5.0, "x_over_r": 3.0, "P_pu": 0.5, "Q_pu": 0.1, "controllers": ["published"]}
    own, held = (
        emt_answer(study, NOTHING, state_of(document | {"hold": hold}, study))
        for hold in (None, {"scr": 2.0, "x_over_r": 1.0})
    )
    assert own is not None
    assert held is not None
    assert held.header["controllers"][0]["overshoot"] > own.header["controllers"][0]["overshoot"] + 0.1


def test_a_table_is_held_and_told_as_in_a_run() -> None:
    """A gain table follows the measured powers; late and wrong, held, and exact."""
    study = structures().with_controllers({"name": "a", "kind": "scheduled", "schedule": "table"})
    ready = NOTHING.with_table("a", table())
    for more in ({}, {"error_X": 0.2, "silent_s": 0.3}, {"hold": {"scr": 3.0, "x_over_r": 1.0}}):
        document = {"scr": 6.0, "x_over_r": 2.0, "event": EVENTS[2], "controllers": ["a"]} | more
        state = state_of(document, study)
        answer = emt_answer(study, ready, state)
        assert answer is not None
        (row,) = answer.header["controllers"]
        run = run_scenario(study_of(scene_of(study, ready, state), ready, state, 0), ready).controllers[0]
        assert run.survival is not None
        assert row["status"] == run.survival.status == "survived"
        assert row["recovery_s"] == pytest.approx(run.survival.recovery_s, rel=1e-9)
        assert len({change.gains for change in run.gain_changes}) == (1 if "hold" in more else len(run.gain_changes))


def test_a_sag_fills_the_current_limit() -> None:
    study = load_study("studies/survival/study.toml")
    event = {"kind": "sag", "size": 0.6, "length_s": 0.15}
    state = state_of({"event": event, "controllers": ["angle_damped"]}, study)
    answer = emt_answer(study, NOTHING, state)
    assert answer is not None
    (row,) = answer.header["controllers"]
    assert row["status"] == "survived"
    assert row["limited_s"] > 0.05
    assert row["peak_pu"] < 1.3
    assert "limiter acts" in row["verdict"]
    assert [band["high"] for band in answer.header["bands"] if band["signal"] == "i_s_pu"] == [1.2]


def test_an_estimator_of_its_own_does_not_run() -> None:
    """A controller with the published network is told the grid; a rest that is not there is named."""
    study = load_study("studies/published/study.toml")
    event = {"kind": "grid", "to_scr": 0.5, "to_x_over_r": 1.0}
    state = state_of({"scr": 6.0, "P_pu": 0.8, "event": event, "controllers": ["DAMPED-ANN"]}, study)
    answer = emt_answer(study, NOTHING, state)
    assert answer is not None
    (row,) = answer.header["controllers"]
    assert "estimator" in row["note"]
    assert row["status"] == "no rest"
    assert row["why"].startswith("after the events")
    assert row["peak_pu"] < 1.4
    assert "no steady state after the event" in row["verdict"]


def test_a_current_that_no_hardware_carries_is_told_beside_survived() -> None:
    said = {}
    for peak_pu in (1.9, 2.1):
        found = live.NOTHING | {"status": "survived", "recovery_s": 0.5, "peak_pu": peak_pu, "why": ""}
        said[peak_pu] = page_verdicts.verdict(found, page_verdicts.asked_of(structures()), "phase", "P")
    assert said[1.9].endswith("The current reaches 1.90 pu.")
    assert said[2.1].endswith("The current reaches 2.10 pu, more than hardware carries.")
