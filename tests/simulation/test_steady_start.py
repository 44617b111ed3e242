"""A steady start stays put: nothing moves for a second, on whatever grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.studies import GAINS, lc_study, lcl_study
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.sampled import cold_start, steady_state
from vsgdesign.simulation import GainChange, gain_changes, simulate
from vsgdesign.simulation.every_sample import signals_at_pcc
from vsgdesign.simulation.rest import rests
from vsgdesign.simulation.scenario import measure_events
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import Study, study_from_text

GRIDS = {
    "SCR 2": "[grid]\nscr = 2\n",
    "SCR 8": "[grid]\nscr = 8\n",
    "SCR 20": "[grid]\nscr = 20\n",
    "X/R 10": "[grid]\nscr = 3\nx_over_r = 10\n",
    "X/R 0.5": "[grid]\nscr = 6\nx_over_r = 0.5\n",
    "50.05 Hz": "[grid]\nscr = 5\nf_g = 50.05\n",
    "49.9 Hz": "[grid]\nscr = 5\nf_g = 49.9\n",
    "0.93 pu": "[grid]\nscr = 5\nV_g_pu = 0.93\n",
    "low and slow": "[grid]\nscr = 4\nx_over_r = 3\nV_g_pu = 1.06\nf_g = 49.95\n",
    "delayed": "[converter]\ndelay_samples = 1\n[inner_loops]\ncurrent_response_time = 2e-3\n"
    "[grid]\nscr = 5\nf_g = 50.1\n",
    "filtered": '[power_loops]\ntau_P = "2 ms"\ntau_Q = "4 ms"\n',
}


def drift_pu(study: Study, changes: list[GainChange]) -> float:
    """How far P, Q and V move from their first value, over rated."""
    run = simulate(study, changes, bridge="averaged")
    c = study.converter
    scales = {"P": c.S_rated, "Q": c.S_rated, "V_rms": c.V_rated_rms}
    return max(float(np.max(np.abs(run.column(name) - run.column(name)[0]))) / s for name, s in scales.items())


@pytest.mark.parametrize("name", GRIDS)
def test_nothing_moves_for_a_second(name: str) -> None:
    # Rounding of 1e-14 through loops of 1 s: measured 3e-12 to 2e-11.
    assert drift_pu(lc_study("1 s", sections=GRIDS[name]), [GainChange(0.0, GAINS)]) < 1e-9


def test_nothing_moves_behind_an_lcl_filter() -> None:
    assert drift_pu(lcl_study("1 s"), [GainChange(0.0, GAINS)]) < 1e-9


@pytest.mark.parametrize(("case", "P_ref"), [("lab_12kva_lcl", "8 kW"), ("utility_1mva_60hz", "-600 kW")])
def test_nothing_moves_in_the_packaged_cases(case: str, P_ref: str) -> None:
    text = f'base = "case:{case}"\n[simulation]\nduration = "1 s"\nP_ref = "{P_ref}"\nQ_ref = 0\n'
    study = study_from_text(text + '[[controllers]]\nname = "a"\nkind = "fixed"\n')
    assert drift_pu(study, list(gain_changes(study, study.controllers[0], build_timeline(study)))) < 1e-9


def test_the_drift_would_show() -> None:
    """The same measure sees 1 mW·s of a wrong start: a reference that steps by a millionth of the rating."""
    event = '[[events]]\ntime = "0.1 s"\nP_ref = 2000.005\n'
    assert drift_pu(lc_study("1 s", event), [GainChange(0.0, GAINS)]) > 1e-7


def test_where_it_starts_is_what_was_asked_for() -> None:
    """At nominal frequency P = P_ref; Q and the frequency follow their droops, off-nominal too."""
    for f_g in (50.0, 50.05):
        study = lc_study("1 ms", sections=f"[grid]\nscr = 5\nf_g = {f_g}\n")
        state = steady_state(
            study, study.grid, study.grid_source, study.converter.references(2000.0, 500.0), GAINS
        ).controller
        omega_n, omega_g = 2.0 * np.pi * 50.0, 2.0 * np.pi * f_g
        assert state.omega_i == pytest.approx(omega_g, rel=1e-13)
        assert state.P_f == pytest.approx(2000.0 + GAINS.D_p * (omega_n - omega_g), rel=1e-10)
        assert state.Q_f == pytest.approx(500.0 + GAINS.D_q * (110.0 - state.V), rel=1e-10)


def test_a_start_outside_the_limits_is_refused_with_the_reason() -> None:
    for sections, P_ref, reason in (
        ('[converter]\nV_dc = "312 V"\n', 2000.0, "bridge makes at most 156 V"),
        ("[converter]\ncurrent_limit_pu = 0.5\n[grid]\nscr = 20\n", 4500.0, "Raise current_limit_pu"),
    ):
        study = lc_study("1 ms", sections=sections)
        study = replace(study, simulation=replace(study.simulation, P_ref=P_ref))
        with pytest.raises(InfeasibleStudyError, match=reason):
            simulate(study, [GainChange(0.0, GAINS)])


def test_a_start_that_the_grid_cannot_carry_is_refused() -> None:
    study = lc_study("1 ms", sections="[grid]\nscr = 0.3\nx_over_r = 5\n")
    study = replace(study, simulation=replace(study.simulation, P_ref=9000.0, Q_ref=-2000.0))
    with pytest.raises(InfeasibleStudyError, match="the start: no operating point"):
        simulate(study, [GainChange(0.0, GAINS._replace(D_q=0.0))])


def test_a_steady_start_inside_a_ramp_is_refused() -> None:
    study = lc_study("10 ms", '[[events]]\ntime = 0\nf_g = 50.1\nover = "9 ms"\n')
    with pytest.raises(InfeasibleStudyError, match="cannot begin inside a ramp"):
        simulate(study, [GainChange(0.0, GAINS)])


def test_an_event_at_zero_is_where_the_run_starts() -> None:
    study = lc_study("20 ms", '[[events]]\ntime = 0\ngrid = { scr = 6 }\nP_ref = "1 kW"\n')
    assert drift_pu(study, [GainChange(0.0, GAINS)]) < 1e-9
    assert simulate(study, [GainChange(0.0, GAINS)]).column("P")[0] == pytest.approx(1000.0, rel=1e-10)


def test_an_event_at_zero_has_figures_after_a_cold_start_alone() -> None:
    events = '[[events]]\ntime = 0\nP_ref = "1 kW"\n[[events]]\ntime = "10 ms"\nP_ref = "1.1 kW"\n'
    study = lc_study("20 ms", events)
    cold = replace(study, simulation=replace(study.simulation, start="cold"))
    for run, expected in ((study, [0.01, 0.01]), (cold, [0.0, 0.0, 0.01, 0.01])):
        gains = [GainChange(0.0, GAINS)]
        found = simulate(run, gains)
        seen, ends = signals_at_pcc(run, found), rests(run, found.timeline, gains)
        assert [event.t_s for event in measure_events(run, seen, ends, ripples=False)] == pytest.approx(expected)


def test_cold_start_is_at_rest() -> None:
    study = lc_study("1 ms")
    start = cold_start(study, -0.5 * np.pi)
    assert not start.plant.any()
    assert not start.pending.any()
    state = start.controller
    assert (state.V, state.omega_i, state.P_f, state.Q_f) == (110.0, study.converter.omega_n, 0.0, 0.0)
    assert state.theta == -0.5 * np.pi
