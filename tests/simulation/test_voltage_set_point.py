"""A step of the voltage set point: the V_n of the Q–V droop, everywhere that events are run."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import root

from tests.simulation import event_kinds as everywhere
from vsgdesign.campaigns.verification.draws import cases_of, families, uniforms_of
from vsgdesign.errors import StudyError
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS


def rest_of(study: Study, P_ref: float, Q_ref: float, V_n: float, D_q: float) -> tuple[float, float]:
    """Q (var) and V (phase rms, V) on the droop and on the grid, by a solver of its own."""
    c, grid = study.converter, study.grid
    R, X = study.path_to_grid(grid, c.omega_n)
    V_g = study.grid_source.V_g_rms

    def residual(at: np.ndarray) -> list[float]:
        V, delta = at[0] * V_g, at[1]
        S = 3.0 * V * np.exp(1j * delta) * np.conj((V * np.exp(1j * delta) - V_g) / complex(R, X))
        return [(S.real - P_ref) / c.S_rated, (S.imag - Q_ref - D_q * (V_n - V)) / c.S_rated]

    V = float(root(residual, [1.0, 0.1], tol=1e-13).x[0]) * V_g
    return Q_ref + D_q * (V_n - V), V


@pytest.mark.parametrize("V_ref_pu", [0.97, 1.04])
def test_a_run_rests_on_the_new_droop_line(V_ref_pu: float) -> None:
    """V moves by the share that droop and grid allow, and P comes back."""
    study, run, recovery_s = everywhere.in_simulate(f"V_ref_pu = {V_ref_pu}")
    found = everywhere.judged(study, run, 0.2)
    c, D_q = study.converter, float(run.gain_changes[-1].gains.D_q)
    Q, V = rest_of(study, 2000.0, 500.0, V_ref_pu * c.V_rated_rms, D_q)
    before = rest_of(study, 2000.0, 500.0, c.V_rated_rms, D_q)
    assert (pytest.approx(2000.0, abs=1e-4 * c.S_rated), pytest.approx(Q, abs=2e-4 * c.S_rated)) == (found.P, found.Q)
    assert pytest.approx(V, rel=1e-4) == found.V
    share = (V - before[1]) / ((V_ref_pu - 1.0) * c.V_rated_rms)
    assert 0.05 < share < 0.95
    assert recovery_s is not None
    assert recovery_s == pytest.approx(found.recovery_s, abs=everywhere.SAME_S)
    assert recovery_s > 0.01


def test_it_reaches_the_controller_at_its_next_sample_with_other_set_points() -> None:
    text = "[[events]]\ntime = '0.20003 s'\nV_ref_pu = 1.02\nP_ref = '2.5 kW'\nQ_ref = '1 kvar'\n"
    study = everywhere.study_with(text)
    assert study.events[0].name == "P_ref 2.5 kW, Q_ref 1 kvar, V_ref 1.02 pu"
    refs = build_timeline(study).references_at(0.21)
    c = study.converter
    assert refs == (2500.0, 1000.0, c.omega_n, 1.02 * c.V_rated_rms)
    one = run_scenario(study).controllers[0]
    D_q = one.gain_changes[-1].gains.D_q
    Q, _ = rest_of(study, 2500.0, 1000.0, 1.02 * c.V_rated_rms, D_q)
    figures = {event.signal: event for event in one.events}
    assert {signal: event.status for signal, event in figures.items()} == {"P_pcc": "measured", "Q_pcc": "measured"}
    assert figures["Q_pcc"].raw.final == pytest.approx(Q, abs=2e-3 * c.S_rated)
    V = one.simulation.column("V_rms")
    first_s = one.simulation.t_s[np.flatnonzero(np.abs(V - V[0]) > 1e-6)[0]]
    assert 0.20003 < first_s < 0.20003 + 2.0 * c.T_s


def test_p_and_q_are_judged_as_after_a_disturbance() -> None:
    one = run_scenario(everywhere.study_with("[[events]]\ntime = '0.2 s'\nV_ref_pu = 1.03\n")).controllers[0]
    assert [(event.kind, event.status, event.reason) for event in one.events] == [("disturbance", "measured", None)] * 2
    assert one.outcome.status == "settled"


def test_a_controller_without_the_droop_does_not_answer_and_the_run_says_so() -> None:
    text = everywhere.TEXT.replace('Q_droop = "5 %"', 'Q_droop = "0 %"')
    study = everywhere.study_with("[[events]]\ntime = '0.2 s'\nV_ref_pu = 1.03\n", text)
    told: list[str] = []
    one = run_scenario(study, warn=told.append).controllers[0]
    words = "the controller has no Q–V droop, so it does not answer V_ref_pu"
    assert told == [f"damped, from 0.2 s on: {words}."]
    assert {event.reason for event in one.events} == {words}
    after = one.simulation.t_s > 0.2
    assert np.ptp(one.simulation.column("V_rms")[after]) < 1e-6


def test_no_verification_draws_it_unless_it_is_asked_to() -> None:
    study = everywhere.study_with()
    spec = study.controllers[0]
    assert study.verification is not None
    assert study.verification.weights(True)["voltage_set_point"] == 0.0
    _, family = cases_of(study, spec, uniforms_of(1, 0, 2000))
    assert families().index("voltage_set_point") not in family
    everywhere.in_verify("voltage_set_point", 8)


def test_a_survival_case_a_suite_and_the_explorer_have_it() -> None:
    everywhere.in_survive(Event.of_pu(0.0, V_ref_pu=1.04))
    everywhere.in_a_suite("V_ref_pu = 0.96")
    everywhere.in_the_explorer("voltage_set_point", 0.04)


def test_its_limits_are_those_of_the_converter() -> None:
    study = everywhere.study_with()
    low, high = study.converter.V_min_pu, study.converter.V_max_pu
    for V in (low - 0.01, high + 0.01):
        with pytest.raises(StudyError, match=r"V_ref_pu = .*outside"):
            everywhere.study_with(f"[[events]]\ntime = '0.2 s'\nV_ref_pu = {V}\n")


def test_it_is_written_back_to_the_bit() -> None:
    study = everywhere.study_with("[[events]]\ntime = '0.2 s'\nV_ref_pu = 1.03\n")
    (event,) = study.events
    written = replace(event, name="").document(study.converter)
    assert math.isclose(written["V_ref_pu"], 1.03, rel_tol=1e-15)
    assert EVENT_KINDS["V_ref_pu"].one(study.converter) * written["V_ref_pu"] == event.V_n
