"""Faults that are cleared at the zeros of their currents: where these are, and what the converter then sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.frames import clarke_inverse
from vsgdesign.parameters import Study, study_from_text
from vsgdesign.parameters.network import PHASE_TO_PHASE
from vsgdesign.simulation import build_timeline, run_scenario, simulate
from vsgdesign.simulation.clearing import cleared_at_zeros
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import Simulation

ASKED_S = 0.22


def faulted(fault: str, more: str = "", at_clearing: str = "", scr: float = 20.0) -> Study:
    """The converter of the survival study with its limiter: a fault for 120 ms."""
    study = study_from_text(f"""
base = "case:hoang2025_5kva"
[converter]
current_limit_pu = 1.2
current_limiter = "projection"
[inner_loops]
K_pv = 0.16594
K_iv = 74.024
K_pc = 10.543
K_ic = 279.38
current_feedforward = 0.57889
transient_resistance_pu = 0.02648
transient_reactance_pu = 0.25832
transient_corner = "48.732 Hz"
[power_loops]
structure = "angle_damped"
tau_P = "5 ms"
tau_Q = "5 ms"
P_droop = "5 %"
Q_droop = "5 %"
settling_time = "1 s"
[grid]
scr_basis = "impedance"
scr = {scr}
x_over_r = 3
[simulation]
duration = "0.4 s"
P_ref = "2.5 kW"
Q_ref = "0 var"
[[controllers]]
name = "a"
kind = "scheduled"
[[events]]
time = "0.1 s"
fault = {fault}
[[events]]
time = "{ASKED_S} s"
fault = "cleared"
{at_clearing}
{more}
""")
    study = study.with_limit_of(study.controllers[0])
    return replace(study, simulation=replace(study.simulation, log_interval=study.converter.T_s))


def run_of(study: Study) -> Simulation:
    return simulate(study, feed_of(study, study.controllers[0], build_timeline(study), NOTHING))


def resolved(study: Study) -> Study:
    return cleared_at_zeros(study, study.controllers[0])


def peak_pu(study: Study) -> float:
    """Largest converter current from the asked instant until 5 ms after the last interruption."""
    run = run_of(study)
    last = max(t_s for t_s, _ in run.timeline.networks)
    rows = (run.t_s > ASKED_S) & (run.t_s < last + 5e-3)
    return float(np.hypot(*run.log[rows, :2].T).max()) / study.converter.I_rated_pk


THREE_PHASE = '{ kind = "three_phase", at = 0.5, R = 0 }'


def test_a_bolted_fault_in_the_grid_forces_no_current_through_the_converter() -> None:
    study = faulted(THREE_PHASE)
    assert peak_pu(study) > 10.0
    assert peak_pu(resolved(study)) < 1.25


def test_a_three_phase_fault_ends_phase_by_phase() -> None:
    study = faulted(THREE_PHASE.replace("R = 0", "R_pu = 0.02"))
    found = resolved(study)
    _, first, last = found.events
    assert first.network is not None
    left, given = first.network.fault, study.events[0].network
    assert left is not None
    assert given is not None
    assert given.fault is not None
    assert left.kind == PHASE_TO_PHASE
    assert pytest.approx(2.0 * given.fault.R) == left.R
    ended = first.name.removeprefix("fault current of phase ")[0]
    assert sorted(ended + left.phases) == ["a", "b", "c"]
    words = (
        f"fault cleared: phase {ended} at {first.t_s:.4f} s, {' and '.join(sorted(left.phases))} at {last.t_s:.4f} s"
    )
    assert last.name == words
    assert ASKED_S < first.t_s < last.t_s < ASKED_S + 0.02
    # The currents of the fault, as the difference of those of both parts of the grid, in the run with these instants.
    run = run_of(found)
    T_s = study.converter.T_s
    i_f = np.column_stack(clarke_inverse(*(run.circuit_log[:, 0:2] - run.circuit_log[:, 2:4]).T))
    peak = np.abs(i_f).max()
    for t_s, phase in ((first.t_s, ended), (last.t_s, left.phases[0])):
        before = round(np.floor(t_s / T_s))
        rows = i_f[before - 1 : before + 1, "abc".index(phase)]
        at_zero = rows[1] + (rows[1] - rows[0]) * (t_s / T_s - before)
        assert abs(at_zero) < 1e-3 * peak
        # The first zero after the asked instant, or after the first interruption.
        since = np.ceil((ASKED_S if phase == ended else first.t_s) / T_s).astype(int)
        assert len(set(np.sign(i_f[since : before + 1, "abc".index(phase)]))) == 1
    after = np.ceil(last.t_s / T_s).astype(int) + 1
    assert np.abs(i_f[after:]).max() < 1e-9 * peak


def test_pages_tell_the_instants() -> None:
    result = run_scenario(faulted('{ kind = "phase_to_phase", at = 0.5, R = 0, phases = "ca" }'))
    (found,) = result.controllers[0].found
    assert found.name == f"fault cleared: phases a and c at {found.t_s:.4f} s"
    assert [event.name for event in result.study.events][-1] == found.name
    assert result.controllers[0].simulation.timeline.network_at(found.t_s).fault is None
    assert result.controllers[0].simulation.timeline.network_at(found.t_s - 1e-5).fault is not None
