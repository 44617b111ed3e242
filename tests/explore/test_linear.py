"""The linear answer against the package's own functions, to the last printed digit, in random states."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.examples import TIMES
from tests.gain_tables import table
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.stability.loci import mode_sensitivities, modes
from vsgdesign.linear.stability.maps import cells_under, full_order_cells
from vsgdesign.linear.stability.margins import full_order_margins
from vsgdesign.linear.stability.step_responses import full_order_step
from vsgdesign.metrics.step_response import step_response
from vsgdesign.report.explore.fields import changed_study
from vsgdesign.report.explore.linear import linear_answer, modes_answer
from vsgdesign.report.explore.state import OWN, State, state_of
from vsgdesign.report.explore.wire import Answer, as_bytes
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.grid import Place
from vsgdesign.study.parameters.study import Study

STATES = 10 * TIMES
"""Of each of two studies."""
DIGITS = 6


def printed(value: float | None) -> str:
    """A value as the page prints it, or with more digits."""
    return "none" if value is None or not math.isfinite(value) else f"{value:.{DIGITS}g}"


def drawn(rng: np.random.Generator) -> dict[str, Any]:
    document: dict[str, Any] = {
        "scr": math.exp(rng.uniform(math.log(1.3), math.log(20.0))),
        "x_over_r": math.exp(rng.uniform(math.log(0.4), math.log(12.0))),
        "P_pu": rng.uniform(-0.9, 0.9),
        "Q_pu": rng.uniform(-0.3, 0.3),
        "error_R": rng.uniform(-0.2, 0.2),
        "error_X": rng.uniform(-0.2, 0.2),
        "V_g_pu": rng.uniform(0.95, 1.05),
        "event": {"kind": "step", "size": 0.1, "signal": rng.choice(["P", "Q"]).item()},
    }
    if rng.random() < 0.5:
        document["hold"] = {"scr": rng.uniform(2.0, 20.0), "x_over_r": rng.uniform(0.5, 8.0)}
    if rng.random() < 0.3:
        document["changes"] = {"power_loops.tau_P": f"{rng.uniform(1.0, 20.0)} ms"}
    return document


def answered(study: Study, document: dict[str, Any]) -> tuple[Study, State, Answer]:
    state = state_of(document, study)
    study = changed_study(study, state.changes)
    return study, state, linear_answer(study, NOTHING, state, details=True)


@pytest.mark.parametrize("name", ["structures", "utility"])
def test_values_are_those_of_the_functions(name: str) -> None:
    """Every figure of the page equals that of the public functions for one controller at a time."""
    base, rng = load_study(f"studies/{name}/study.toml"), np.random.default_rng(16)
    seen = 0
    for _ in range(STATES):
        study, state, answer = answered(base, drawn(rng))
        c = study.converter
        study = replace(study, grid_source=replace(study.grid_source, V_g_rms=state.V_g_pu * c.V_rated_rms))
        k = int(rng.integers(len(study.controllers)))
        row, spec = answer.header["controllers"][k], study.controllers[k]
        grid = Place(state.scr, state.x_over_r, study.scr_basis).grid(c)
        P, Q = state.P_pu * c.S_rated, state.Q_pu * c.S_rated
        law = gain_law(study, spec)
        if state.hold is None:
            R_hat, L_hat = grid.R_g * (1.0 + state.error_R), grid.L_g * (1.0 + state.error_X)
            cells = cells_under(study, law, grid.R_g, grid.L_g, P, Q, R_hat, L_hat)
        else:
            held = Place(state.hold.scr, state.hold.x_over_r, study.scr_basis).grid(c)
            R_hat, L_hat = held.R_g * (1.0 + state.error_R), held.L_g * (1.0 + state.error_X)
            made = cells_under(study, law, held.R_g, held.L_g, P, Q, R_hat, L_hat).gains
            cells = cells_under(study, lambda *_, made=made: made, grid.R_g, grid.L_g, P, Q)
        model = full_order_cells(study.with_limit_of(spec), cells)
        fault = cells.faults[0] or model.faults[0]
        assert row["why"] == fault
        if fault is not None:
            assert f"{k}/step_full" not in answer.arrays
            continue
        seen += 1
        table = full_order_margins(model)
        expected = {
            "damping_all_modes": table.least_damping[0],
            "decay": -table.spectral_abscissa[0],
            "M_s": table.M_s.value[0],
            "gain_margin_db": table.loop_P.gain_margin_db[0],
            "phase_margin_deg": table.loop_P.phase_margin_deg[0],
            "crossover_rad_s": table.loop_P.phase_crossing_rad_s[0],
            "phase_margin_Q_deg": table.loop_Q.phase_margin_deg[0],
            "crossover_Q_rad_s": table.loop_Q.phase_crossing_rad_s[0],
            "phase_crossover_Q_rad_s": table.loop_Q.gain_crossing_rad_s[0],
        }
        assert {key: printed(row[key]) for key in expected} == {key: printed(v) for key, v in expected.items()}
        assert printed(row["disk_margin_output"]) == printed(table.disk_output.value[0])
        assert printed(row["disk_margin_input"]) == printed(table.disk_input.value[0])
        assert row["stable"] == bool(table.stable[0])
        gains = PowerLoopGains(*(float(value[0]) for value in cells.gains))
        assert {key: printed(v) for key, v in row["gains"].items()} == {
            key: printed(v) for key, v in gains._asdict().items()
        }
        slowest = modes(model.states, model.A[0], model.T_s)[0]
        listed = row["modes"][0]
        assert printed(listed["re"]) == printed(slowest.s.real)
        strongest = mode_sensitivities(model, 0, slowest.s)[0]
        assert listed["moved_by"][0][0] == strongest.parameter
        assert listed["moved_by"][0][1] == pytest.approx(0.01 * strongest.relative.real, rel=1e-5, abs=1e-9)
        if row["stable"] and row["settling_s"] is not None and row["settling_s"] < 10.0:
            signal = state.event.signal
            t, y = full_order_step(model, f"{signal}_ref", signal, 20.0, 4)
            response = step_response(t, y[0], 0.0, float(y[0, -1]))
            # One value at every fourth sample instead of 4000 over ten time constants.
            assert row["settling_s"] == pytest.approx(response.settling_time_s, rel=2e-3, abs=1e-3)
            assert row["overshoot"] == pytest.approx(0.01 * (response.overshoot_pct or 0.0), abs=2e-4)
    assert seen > STATES // 2


def test_modes_are_the_same_with_and_without_what_moves_them() -> None:
    study, state, answer = answered(load_study("studies/structures/study.toml"), {"scr": 3.0, "x_over_r": 1.0})
    whole = [row["modes"] for row in answer.header["controllers"]]
    assert [row["modes"] for row in modes_answer(study, NOTHING, state).header["controllers"]] == whole
    quick = linear_answer(study, NOTHING, state)
    more = ("participation", "moved_by")
    for row, modes_of_one in zip(quick.header["controllers"], whole, strict=True):
        assert row["modes"] == [{key: mode[key] for key in mode if key not in more} for mode in modes_of_one]
        assert all(mode[key] for mode in modes_of_one for key in more)
    assert quick.arrays.keys() == answer.arrays.keys()


def test_steps_begin_at_the_operating_point_and_end_there_plus_the_step() -> None:
    study = load_study("studies/structures/study.toml")
    document = {"scr": 5.0, "x_over_r": 2.0, "P_pu": 0.3, "event": {"kind": "step", "size": 0.2, "signal": "P"}}
    _, _, answer = answered(study, document)
    for k in range(3):
        for model in ("step_full", "step_reduced"):
            line = answer.arrays[f"{k}/{model}"]
            assert line[0] == pytest.approx(0.3, abs=1e-3)
            assert line[-1] == pytest.approx(0.5, abs=0.01)


def test_a_point_that_does_not_exist_says_why() -> None:
    study = load_study("studies/structures/study.toml")
    _, _, answer = answered(study, {"scr": 0.5, "P_pu": 1.0, "x_over_r": 5.0})
    for row in answer.header["controllers"]:
        assert row["why"].startswith("no operating point: the grid cannot carry P = 5 kW")
        assert row["disk_margin_output"] is None
        assert row["modes"] == []
    assert answer.arrays == {}
    assert as_bytes(answer)


def test_a_table_that_is_missing_is_no_fault_of_the_others() -> None:
    study = load_study("studies/table/study.toml")
    _, _, answer = answered(study, {"scr": 5.0})
    closed_form, designed = answer.header["controllers"]
    assert closed_form["why"] is None
    assert closed_form["stable"]
    assert closed_form["schedule"] == "fresh"
    assert "its gain table is missing" in designed["why"]


def test_a_table_says_when_it_is_clamped_and_when_its_data_differ() -> None:
    study = load_study("studies/table/study.toml")
    ready = Ready(tables={"table": table(base=base_of(study, "impedance"))})

    def row(**document: Any) -> dict[str, Any]:
        state = state_of({"controllers": ["table"], **document}, study)
        return linear_answer(changed_study(study, state.changes), ready, state).header["controllers"][0]

    inside = row(scr=5.0)
    assert (inside["schedule"], inside["note"], inside["why"]) == ("fresh", None, None)
    assert row(scr=50.0)["schedule"] == "clamped"
    # SCR 26 on the study's basis of reactance is 18.4 on the table's; with L 30 % too small it is 21.3, beyond 20.
    assert row(scr=26.0)["schedule"] == "fresh"
    assert row(scr=26.0, error_X=-0.3)["schedule"] == "clamped"
    assert row(scr=50.0, hold={"scr": 5.0, "x_over_r": 1.0})["schedule"] == "held"
    changed = row(scr=5.0, changes={"power_loops.tau_P": "20 ms"})
    assert changed["gains"] == inside["gains"]
    assert changed["disk_margin_output"] != inside["disk_margin_output"]
    assert changed["note"] is not None
    assert "base.tau_P is 0.005, the study has 0.02" in changed["note"]


def test_own_gains_are_those_of_a_controller_with_them() -> None:
    study = load_study("studies/structures/study.toml")
    _, _, first = answered(study, {"scr": 4.0})
    gains = first.header["controllers"][2]["gains"]
    _, _, answer = answered(study, {"scr": 4.0, "own": gains, "controllers": ["angle_damped", OWN]})
    angle_damped, own = answer.header["controllers"]
    assert own["name"] == OWN
    same = (
        "gains",
        "disk_margin_output",
        "disk_margin_input",
        "M_s",
        "settling_s",
        "droop_P",
        "droop_Q",
        "H_s",
        "modes",
    )
    assert {key: own[key] for key in same} == {key: angle_damped[key] for key in same}


def test_droops_are_those_of_a_steady_state() -> None:
    """The frequency of the grid changes by 0.1 Hz, and its voltage until V has changed by 1 %: P and Q answer so."""
    from vsgdesign.linear.model.coupled import INPUTS, OUTPUTS
    from vsgdesign.linear.stability.maps import reduced_cells

    study = load_study("studies/structures/study.toml")
    _, state, answer = answered(study, {"scr": 4.0})
    row, spec, c = answer.header["controllers"][2], study.controllers[2], study.converter
    grid = Place(state.scr, state.x_over_r, study.scr_basis).grid(c)
    cells = cells_under(
        study, gain_law(study, spec), grid.R_g, grid.L_g, state.P_pu * c.S_rated, state.Q_pu * c.S_rated
    )
    m = reduced_cells(study, cells)
    gain = m.D[0] - m.C[0] @ np.linalg.solve(m.A[0], m.B[0])
    P_of_omega = gain[OUTPUTS.index("P"), INPUTS.index("omega_g")]
    assert row["droop_P"] == pytest.approx(-c.S_rated / (P_of_omega * c.omega_n), rel=1e-9)
    column = INPUTS.index("V_g")
    Q_of_V = gain[OUTPUTS.index("Q"), column] / gain[OUTPUTS.index("V"), column]
    assert row["droop_Q"] == pytest.approx(-c.S_rated / (Q_of_V * c.V_rated_rms), rel=1e-9)
