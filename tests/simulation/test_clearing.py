"""Faults that are cleared at the zeros of their currents: where these are, and what the converter then sees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.oracles.clearing_reference import Interrupting
from tests.oracles.emt_reference import run_reference
from tests.simulation.finding import finding, found_in
from tests.simulation.studies import lc_study, lcl_study
from tests.simulation.test_emt_against_dop853 import errors_pu, library_start
from tests.simulation.test_networks import with_networks
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.equations.frames import clarke_inverse
from vsgdesign.simulation import build_timeline, gain_changes, simulate
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.loop import LOG_COLUMNS
from vsgdesign.simulation.run import Simulation, run_together, simulation_of
from vsgdesign.simulation.run_asked import RunOf
from vsgdesign.simulation.run_state import RunState
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.search import found_events
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.grid import PHASE_TO_PHASE, PLAIN, Fault, Network

ASKED_S = 0.22


def faulted(fault: str, more: str = "", at_clearing: str = "", scr: float = 20.0, duration: float = 0.4) -> Study:
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
duration = "{duration} s"
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
    return found_in(study)


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


@pytest.mark.parametrize(
    ("build", "bridge", "fault", "within_s"),
    [
        (lcl_study, "averaged", Fault(at=0.5), 1e-9),
        (lc_study, "averaged", Fault(kind=PHASE_TO_PHASE, phases="ca", at=0.4, R=0.3), 1e-9),
        (lcl_study, "averaged", Fault(R=0.2), 1e-9),
        # The slope of the fault's current jumps with the voltage of the bridge: there the current is a straight line.
        (lc_study, "averaged", Fault(), 1e-8),
        # The slopes at the samples do not know the pulses between them.
        (lcl_study, "pwm", Fault(at=0.3, R=0.5), 2e-7),
    ],
)
def test_instants_and_states_against_the_oracle(
    build: Callable[..., Study], bridge: str, fault: Fault, within_s: float
) -> None:
    """The instants that the oracle finds on its own currents, and all states afterwards, to 1e-8 of rated."""
    asked_s = 12.3456e-3
    study = build("30 ms", f'[[events]]\ntime = "{1e3 * asked_s} ms"\ngrid = {{ scr = 2 }}\n')
    changes = ((2.01e-3, Network(fault=fault)), (asked_s, PLAIN))
    study = with_networks(study, *changes)
    found = found_in(study, bridge)
    gains = gain_changes(study, study.controllers[0], build_timeline(study))
    run = simulate(found, gains, bridge=bridge, log_states=10**9)
    start = library_start(study, gains)
    oracle = Interrupting(study, asked_s)
    own = run_reference(study, gains, bridge == "pwm", start, circuits=oracle)
    ours = [event.t_s for event in sorted(found.events, key=lambda event: event.t_s) if event.network is not None]
    np.testing.assert_allclose(ours[1:], [t_s for t_s, _ in oracle.found], rtol=0.0, atol=within_s)
    assert len(oracle.found) == (1 if fault.kind == PHASE_TO_PHASE else 2)
    reference = run_reference(found, gains, bridge == "pwm", start)
    assert max(errors_pu(study, run, reference).values()) < 1e-8
    # An instant that is off by its tolerance leaves a current of this size, which the slope of 20 pu and 50 Hz makes.
    assert max(errors_pu(study, run, own).values()) < 1e-8 + 20.0 * 314.0 * within_s


def networks_of(study: Study) -> list[tuple[float, str]]:
    """Every network that begins: when, and its fault in short."""
    found = []
    for t_s, network in build_timeline(resolved(study)).networks[1:]:
        fault = network.fault
        found.append((t_s, "none" if fault is None else fault.phases if fault.kind == PHASE_TO_PHASE else "abc"))
    return found


def test_a_line_is_out_when_its_last_phase_is_interrupted() -> None:
    """What comes at the same instant waits for it, in two events as in one; what comes in between holds on."""
    study = faulted(THREE_PHASE, f'[[events]]\ntime = {ASKED_S}\ngrid = {{ scr = 5 }}\nP_ref = "2 kW"', "V_g_pu = 0.95")
    found = resolved(study)
    (last,) = {event.t_s for event in found.events if event.network is not None and event.network.fault is None}
    timeline = build_timeline(found)
    assert timeline.grids[-1][0] == timeline.references[-1][0] == timeline.sources[-1].t_s == last > ASKED_S
    between = "[[events]]\ntime = 0.221\nV_g_pu = 0.9\n[[events]]\ntime = 0.222\nload = { P_pu = 0.2 }"
    timeline = build_timeline(resolved(faulted(THREE_PHASE, between, 'V_g_pu = 0.95\nP_ref = "2 kW"')))
    assert timeline.source_at(0.23).V_g_rms == pytest.approx(0.9 * study.converter.V_rated_rms)
    assert timeline.references_at(0.23)[0] == 2000.0
    assert timeline.network_at(0.2221).load == timeline.network_at(0.23).load is not None
    assert timeline.network_at(0.2221).fault is not None
    assert timeline.network_at(0.23).fault is None


def test_several_faults_in_one_study() -> None:
    """One after the other; a fault that another one replaces changes at once."""
    more = f"""
[[events]]
time = "0.3 s"
fault = {THREE_PHASE}
[[events]]
time = "0.34 s"
fault = {{ kind = "phase_to_phase", phases = "ca", at = 0.2, R_pu = 0.01 }}
[[events]]
time = "0.36 s"
fault = "cleared"
"""
    study = faulted('{ kind = "phase_to_phase", at = 0.5, R = 0 }', more)
    found = networks_of(study)
    assert [what for _, what in found] == ["bc", "none", "abc", "ca", "none"]
    times = [t_s for t_s, _ in found]
    assert times[0] == 0.1
    assert times[2:4] == [0.3, 0.34]
    assert ASKED_S < times[1] < ASKED_S + 0.02
    assert 0.36 < times[4] < 0.38
    # Each instant is that of the fault alone, because a run does not know what comes later.
    assert networks_of(faulted('{ kind = "phase_to_phase", at = 0.5, R = 0 }'))[:2] == found[:2]


def test_a_fault_that_an_open_breaker_leaves_ends_at_its_own_zeros() -> None:
    """Nothing but the source feeds it then."""
    study = faulted(THREE_PHASE, '[[events]]\ntime = "0.15 s"\nbreaker = "open"')
    found = resolved(study)
    timeline = build_timeline(found)
    assert [t_s for t_s, _ in timeline.networks[1:3]] == [0.1, 0.15]
    assert timeline.network_at(0.15).fault is not None
    run = run_of(found)
    last = timeline.networks[-1][0]
    row = round(np.floor(last / study.converter.T_s))
    assert np.abs(run.circuit_log[row + 1 :, :4]).max() < 1e-9 * study.converter.I_rated_pk
    in_fault = np.abs(run.circuit_log[:row, 2:4]).max()
    assert np.abs(run.circuit_log[row, 2:4]).max() < 0.02 * in_fault


def test_a_current_without_a_zero_is_interrupted_after_five_cycles() -> None:
    """The source's voltage vanishes half a cycle after its current was small, and its inductance keeps a dc current."""
    dead = '[[events]]\ntime = "0.21 s"\nV_g_pu = 0'
    study = faulted(THREE_PHASE, dead, scr=5.0)
    study = replace(study, grid=replace(study.grid, R_g=1e-3 * study.converter.omega_n * study.grid.L_g))
    found = resolved(study)
    name = found.events[-1].name
    assert name.endswith(" without a zero until 0.3200 s")
    assert found.events[-1].t_s == pytest.approx(ASKED_S + 0.1, abs=1e-12)
    # The next fault comes before that.
    again = f'{dead}\n[[events]]\ntime = "0.25 s"\nfault = {THREE_PHASE}'
    study = replace(faulted(THREE_PHASE, again, scr=5.0), grid=study.grid)
    ended = networks_of(study)
    assert [t_s for t_s, what in ended if what == "abc"][-1] == 0.25
    assert build_timeline(resolved(study)).network_at(0.25).fault is not None


@pytest.mark.parametrize(
    ("closing", "name"),
    [
        ('synchro_check = { angle = "90 deg", V_pu = 0.5, df = "5 Hz" }', "breaker waits to close within 90°"),
        ("synchronise = true", "converter synchronises"),
    ],
)
def test_an_island_between_two_faults(closing: str, name: str) -> None:
    """The instants are found in order of time: the breaker's closing counts for the second fault alone."""
    more = f"""
[[events]]
time = "0.24 s"
breaker = "open"
P_ref = 0
[[events]]
time = "0.26 s"
breaker = "closed"
{closing}
[[events]]
time = "0.7 s"
fault = {THREE_PHASE}
[[events]]
time = "0.75 s"
fault = "cleared"
"""
    study = faulted(THREE_PHASE, more, duration=0.8)
    found = found_in(study)
    states = [(network.connected, network.fault is not None) for _, network in build_timeline(found).networks[1:]]
    fault, none = (True, True), (True, False)
    assert states == [fault, fault, none, (False, False), none, fault, fault, none]
    assert [event.name.partition(" ")[0] for event in found_events(study, found)] == ["fault", "breaker", "fault"]
    assert name in [event.name for event in found.events]
    # A converter that has set itself to the grid is not set any more.
    assert run_of(found).divergence is None


def test_with_the_instants_as_events_a_run_is_the_same() -> None:
    """A run that is told the instants is an oracle that looks for nothing. The source's phase is taken up anew at an
    event, so that the last bits of v_g in the row before may differ."""
    line = f'[[events]]\ntime = {ASKED_S}\ngrid = {{ scr = 5 }}\nP_ref = "2 kW"\n'
    line += "[[events]]\ntime = 0.2231\nV_g_pu = 0.9"
    run = finding(faulted(THREE_PHASE, line))
    again = run_of(run.study)
    assert len(build_timeline(run.study).networks) == 4
    voltages = [LOG_COLUMNS.index(name) for name in ("v_g_alpha", "v_g_beta")]
    np.testing.assert_allclose(run.log[:, voltages], again.log[:, voltages], rtol=0.0, atol=1e-10)
    np.testing.assert_array_equal(np.delete(run.log, voltages, 1), np.delete(again.log, voltages, 1))
    np.testing.assert_array_equal(run.circuit_log, again.circuit_log)


def test_runs_side_by_side_find_their_own_instants() -> None:
    """One stands still where its instant is found, and the others finish the sample: the bits are those of runs alone.
    The first one has nothing to find."""
    two, whole = '{ kind = "phase_to_phase", at = 0.5, R = 0 }', faulted(THREE_PHASE)
    studies = [replace(whole, events=()), whole, faulted(two), faulted(THREE_PHASE, scr=15.0)]
    runs = [
        RunState(RunOf(one, feed_of(one, one.controllers[0], build_timeline(one), NOTHING), finds=one.controllers[0]))
        for one in studies
    ]
    run_together(runs, switched=False)
    for study, run in zip(studies[1:], runs[1:], strict=True):
        alone, found = finding(study), simulation_of(run)
        assert found.study.events == alone.study.events
        np.testing.assert_array_equal(found.log, alone.log)
        np.testing.assert_array_equal(found.circuit_log, alone.circuit_log)
    assert np.abs(simulation_of(runs[0]).column("P") - 2500.0).max() < 1e-3


def test_a_study_without_faults_is_returned_as_it_is() -> None:
    study = replace(faulted(THREE_PHASE), events=())
    assert resolved(study) is study
