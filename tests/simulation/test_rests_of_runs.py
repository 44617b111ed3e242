"""One rest of a run, with both droops, the limits and the gains: lists, excuses, promises and verdicts stand on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.test_promises import ASKED, study_with
from vsgdesign.equations.frames import PHASES
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.report.scenario.outcomes import step_outcomes
from vsgdesign.report.scenario.verdict import verdict
from vsgdesign.simulation.scenario import ControllerResult, ScenarioResult, run_scenario
from vsgdesign.simulation.scenario.checking import refuse_impossible
from vsgdesign.simulation.scenario.judging import promises_kept
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import Event, study_from_text
from vsgdesign.study.parameters.grid import Place

TWO_PI = 2.0 * np.pi


def last_mean(run: ControllerResult, name: str, until_s: float, cycle_s: float) -> float:
    """The mean of a logged quantity over the last cycle before an instant."""
    t_s = run.simulation.t_s
    rows = (t_s >= until_s - cycle_s - 1e-9) & (t_s < until_s - 1e-9)
    return float(np.mean(run.simulation.column(name)[rows]))


FALSE_ALARM = """
base = "case:lab_12kva_lcl"
grid = { scr = 3, x_over_r = 4 }
simulation = { duration = "9 s", P_ref = "4 kW", Q_ref = "0 var" }
power_loops = { structure = "angle_damped", tau_P = "5 ms", tau_Q = "5 ms", P_droop = "5 %", Q_droop = "5 %" }
controllers = [ { name = "damped", kind = "scheduled", current_limiter = "none" } ]
events = [ { time = "2 s", V_g_pu = 0.8 }, { time = "5 s", f_g = "49.8 Hz" } ]
"""


def test_the_list_and_the_verdict_are_where_the_run_rests() -> None:
    """The list had P = 4000 W and the verdict 0.8188 pu, where the run rests at 5000 W and 0.981 pu."""
    result = run_scenario(study_from_text(FALSE_ALARM))
    (run,) = result.controllers
    c = result.study.converter
    assert [rest.t_s for rest in run.rests] == [0.0, 2.0, 5.0]
    for rest in run.rests:
        assert rest.point is not None
        # Against the log of the run, which knows nothing of the rest.
        for name, value in (("P", rest.point.P), ("Q", rest.point.Q)):
            mean = last_mean(run, name, rest.end_s, TWO_PI / rest.source.omega_g)
            assert value == pytest.approx(mean, abs=2e-3 * c.S_rated)
        mean = last_mean(run, "V_rms", rest.end_s, 0.02)
        assert rest.point.V_rms == pytest.approx(mean, rel=1e-3)
    assert run.rests[-1].point is not None
    assert pytest.approx(c.S_rated / (0.05 * 50.0) * 0.2, rel=1e-6) == run.rests[-1].point.P - 4000.0
    text = " ".join(verdict(result, step_outcomes(result)))
    assert "The voltage is within its limits" in text


def excuses(result: ScenarioResult) -> tuple[set[str], set[str]]:
    """Those of the margins and those of the steps."""
    return {one.excuse for one in promises_kept(result)}, {one.excuse for one in step_outcomes(result)}


def test_a_droop_that_keeps_the_voltage_in_the_table_leaves_no_excuse() -> None:
    """At the references V is 1.22 pu, outside the table; the droop of 50 % holds it at 1.13 pu, and the step counts."""
    study, ready = study_with(ASKED, Event(1.0, "more", P_ref=4300.0))
    run = replace(study.simulation, duration=4.0, P_ref=4100.0, Q_ref=1900.0)
    study = replace(study, simulation=run, grid=Place(3.0, 1.0, "impedance").grid(study.converter))
    table = ready.tables["table"]
    box = replace(table.validity, V_rms=(93.5, 130.0))
    result = run_scenario(study, ready.with_table("table", replace(table, validity=box)))
    for rest in result.controllers[0].rests:
        assert rest.point is not None
        # The grid's own equation, with Q = Q_ref + D_q (V_n − V).
        V, S = rest.point.V_rms, rest.point.P + 1j * rest.point.Q
        Z = study.filter.R_2 + rest.grid.R_g + 1j * rest.source.omega_g * (study.filter.L_2 + rest.grid.L_g)
        assert abs(V - Z * np.conj(S / (PHASES * V))) == pytest.approx(rest.source.V_g_rms, rel=1e-4)
        assert pytest.approx(1900.0 + 90.9 * (study.converter.V_rated_rms - V), abs=1.0) == rest.point.Q
        P, Q, R, X = rest.point.P, 1900.0, Z.real, Z.imag
        assert V < box.V_rms[1] < operating_point(P, Q, rest.source.V_g_rms, R, X)[0]
    assert excuses(result) == ({""}, {""})


def test_a_droop_that_leads_out_of_the_table_is_an_excuse() -> None:
    """P rests 600 W above its reference at 49.7 Hz, beyond the 4.5 kW of the table: this was called met."""
    study, ready = study_with(ASKED, Event(0.2, "low", omega_g=TWO_PI * 49.7), Event(1.2, "more", P_ref=4200.0))
    study = replace(study, simulation=replace(study.simulation, duration=3.2, P_ref=4000.0))
    result = run_scenario(study, ready)
    margins, steps = excuses(result)
    assert margins == {"", "P 4.6 outside -4.5 to 4.5 kW", "P 4.8 outside -4.5 to 4.5 kW"}
    assert steps == {"P 4.8 outside -4.5 to 4.5 kW"}


SAG = """
base = "case:utility_1mva_60hz"
grid = {{ scr = 1.5742, x_over_r = 1.703 }}
simulation = {{ duration = "{duration} s", P_ref = "-621.55 kW", Q_ref = "-193 kvar" }}
power_loops = {{ tau_P = "5 ms", tau_Q = "5 ms" }}
[[controllers]]
name = "c1"
kind = "fixed"
structure = "angle_damped"
settling_time = 0.39
design_grid = {{ scr = 1.47, x_over_r = 2.43 }}
[[events]]
time = 0.57
V_g_pu = {V_g_pu}
{end}
"""
BACK = "[[events]]\ntime = 0.67\nV_g_pu = 1\n"


@pytest.mark.parametrize("V_g_pu", [0.84, 0.86, 0.871])
def test_an_instant_without_an_operating_point_is_run_if_an_event_ends_it(V_g_pu: float) -> None:
    """A sag to 0.84 pu was simulated, and one to 0.871 pu was refused."""
    result = run_scenario(study_from_text(SAG.format(V_g_pu=V_g_pu, end=BACK, duration=0.7)))
    before, during, after = result.controllers[0].rests
    assert (before.obstacle, after.obstacle) == (None, None)
    assert during.point is None
    assert "no operating point" in str(during.obstacle)


@pytest.mark.parametrize("V_g_pu", [0.84, 0.86, 0.871])
def test_an_instant_without_an_operating_point_is_refused_if_none_does(V_g_pu: float) -> None:
    study = study_from_text(SAG.format(V_g_pu=V_g_pu, end="", duration=0.7))
    with pytest.raises(InfeasibleStudyError, match=r"^from 0.57 s on: no operating point.* No later event ends it\.$"):
        refuse_impossible(study, build_timeline(study))
    # A limiter that rests at its limit has somewhere to go, and with a better controller beside it the worse one runs.
    resting = study.with_changes(converter={"current_limit_pu": 1.3, "current_limiter": "projection"})
    refuse_impossible(resting, build_timeline(resting))
