"""Load, fault and breaker in the lanes of a batch, against single runs and the judges of their logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.one_by_one import step_of
from tests.simulation.test_lanes import study_named
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.metrics.survival import ExpectedRest, judge_survival
from vsgdesign.simulation import build_timeline, simulate
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.lanes.cases import (
    ACTIVE,
    DISTURBANCE,
    STEP,
    LaneCases,
    Networks,
    no_events,
    segments_of,
    study_of_case,
)
from vsgdesign.simulation.lanes.rests import ends_of, rests_of
from vsgdesign.simulation.lanes.results import JUDGED, NO_REST, LaneResults
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.simulation.lanes.telling import telling
from vsgdesign.simulation.run import Simulation
from vsgdesign.simulation.survival.cases import demand_of, settling_time_of
from vsgdesign.simulation.survival.running import record_of
from vsgdesign.study.parameters.grid import PHASE_TO_PHASE, PLAIN, Fault, Load, Network
from vsgdesign.study.parameters.study import ControllerSpec, Study


def cases_with(study: Study, kind: int, P_ref: float, *networks: Networks) -> LaneCases:
    """Cases on the grid of the study, whose events are the changes of these networks."""
    c, count = study.converter, len(networks)
    events, none = no_events(count, max(map(len, networks))), np.zeros(count)
    for k, listed in enumerate(networks):
        events.t_s[k, : len(listed) - 1] = [t_s for t_s, _ in listed[1:]]
    return LaneCases(
        R_g=np.full(count, study.grid.R_g),
        L_g=np.full(count, study.grid.L_g),
        V_g_rms=np.full(count, c.V_rated_rms),
        omega_g=np.full(count, c.omega_n),
        P_ref=np.full(count, P_ref),
        Q_ref=none,
        events=events,
        error_R=none,
        error_X=none,
        silent_s=none,
        cleared_s=np.array([listed[-1][0] for listed in networks]),
        kind=np.full(count, kind, dtype=np.int8),
        signal=np.full(count, ACTIVE, dtype=np.int8),
        networks=networks,
    )


def loads(study: Study) -> tuple[Load, Load]:
    """A resistance with a choke beside it, and a resistance, both with a third of the rated power."""
    Z, omega = study.converter.Z_base, study.converter.omega_n
    return Load(R_parallel=4.0 * Z, R_series=2.0 * Z, L_series=4.0 * Z / omega), Load(R_parallel=3.0 * Z)


def alone(study: Study, spec: ControllerSpec, cases: LaneCases, k: int, end: int, bridge: str) -> Simulation:
    one = study_of_case(study.with_limit_of(spec), cases, k, end)
    return simulate(one, feed_of(one, spec, build_timeline(one), NOTHING), bridge=bridge)


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_disturbances_with_networks_are_those_of_single_runs(bridge: str) -> None:
    """A fault between two phases that begins and ends inside intervals, one of three phases beside a load that leaves
    with it, and an island of 50 ms."""
    study, spec = study_named("survival", "published")
    (load, _), Z = loads(study), study.converter.Z_base
    with_load, two = Network(load=load), Fault(kind=PHASE_TO_PHASE, phases="ca", at=0.5, R=0.3 * Z)
    listed = (
        ((0.0, PLAIN), (0.10371, Network(fault=two)), (0.18013, PLAIN)),
        ((0.0, with_load), (0.1, replace(with_load, fault=Fault(at=0.3))), (0.15, PLAIN)),
        ((0.0, with_load), (0.10001, replace(with_load, connected=False)), (0.15002, with_load)),
    )
    listed = listed if bridge == "averaged" else listed[2:]
    cases = cases_with(study, DISTURBANCE, 0.3 * study.converter.S_rated, *listed)
    cases.events.phase_jump[:, 1] = (0.0, 0.2, 0.1)[-len(cases) :]  # with the end of what came before, at a sample too
    own = study.with_limit_of(spec)
    demand, segments = demand_of(own.converter, settling_time_of(spec, NOTHING)), segments_of(cases)
    told = telling(own, spec, NOTHING, cases)
    rests, _ = rests_of(own, cases, segments, told, demand, LaneResults.of_none(len(cases)))
    ends, cycle = ends_of(own, cases, segments, demand, bridge)
    results = run_lanes(study, spec, NOTHING, cases, bridge=bridge)
    assert (results.status >= JUDGED).all()
    for k in range(len(cases)):
        run = alone(study, spec, cases, k, int(ends[k]), bridge)
        rest = ExpectedRest(P=rests.P_end[k], Q=rests.Q_end[k], delta=rests.delta_end[k], i_s_pu=0.0)
        instants = [t_s for t_s, _ in listed[k][1:]]
        of_case = replace(demand, cycle_s=int(cycle[k]) * own.converter.T_s)
        verdict = judge_survival(record_of(run_study(own, cases, k, ends), run), instants, instants[-1], rest, of_case)
        assert results.peak_pu[k] == pytest.approx(verdict.peak_pu, abs=1e-10)
        assert results.first_peak_pu[k] == pytest.approx(verdict.first_peak_pu, abs=1e-10)
        assert results.limited_s[k] == pytest.approx(verdict.limited_s, abs=1e-12)
        if bridge == "averaged":  # a switched bridge is judged by its own rest
            assert verdict.survived == (results.status[k] == JUDGED)
            assert results.recovery_s[k] == pytest.approx(verdict.recovery_s, abs=1e-8)
        if verdict.swing_rad is not None:
            assert results.swing_rad[k] == pytest.approx(verdict.swing_rad, abs=1e-7)


def run_study(study: Study, cases: LaneCases, k: int, ends: np.ndarray) -> Study:
    return study_of_case(study, cases, k, int(ends[k]))


def test_a_step_beside_a_load_is_judged_at_the_pcc() -> None:
    """With a second inductor the PCC has a voltage of its own, which the load decides."""
    study, spec = study_named("laboratory", "scheduled")
    S = study.converter.S_rated
    cases = cases_with(study, STEP, 0.3 * S, *(((0.0, Network(load=load)),) for load in loads(study)))
    cases = replace(cases, events=no_events(2))
    cases.events.t_s[:, 0], cases.events.P_ref[:, 0] = (0.1, 0.10003), 0.6 * S
    own = study.with_limit_of(spec)
    demand, segments = demand_of(own.converter, settling_time_of(spec, NOTHING)), segments_of(cases)
    told, results = telling(own, spec, NOTHING, cases), LaneResults.of_none(2)
    rests, _ = rests_of(own, cases, segments, told, demand, results)
    ends, _ = ends_of(own, cases, segments, demand, "averaged")
    found = run_lanes(study, spec, NOTHING, cases)
    for k in range(2):
        run = alone(study, spec, cases, k, int(ends[k]), "averaged")
        overshoot, settling = step_of(run_study(own, cases, k, ends), run, cases, k, float(rests.P_end[k]))
        assert found.overshoot[k] == pytest.approx(overshoot, abs=1e-10)
        assert found.settling_s[k] == pytest.approx(settling, abs=1e-9)
    assert abs(rests.P_end[0] - rests.P_end[1]) > 1e-6 * S  # the PCC is not where P is controlled


def test_no_rest_is_known_with_a_fault_or_an_open_breaker() -> None:
    study, spec = study_named("survival", "decoupled")
    faulted, island = Network(fault=Fault()), Network(load=loads(study)[1], connected=False)
    cases = cases_with(study, DISTURBANCE, 0.0, ((0.0, PLAIN), (0.1, faulted)), ((0.0, island), (0.1, PLAIN)))
    assert run_lanes(study, spec, NOTHING, cases).status.tolist() == [NO_REST, NO_REST]


def test_cases_have_the_network_of_their_study() -> None:
    """Two lanes of a study with a load, taken apart and moved in time, keep it."""
    study, _ = study_named("survival", "decoupled")
    network = Network(load=loads(study)[0])
    cases = replace(cases_with(study, DISTURBANCE, 0.0, ((0.0, PLAIN),), ((0.0, PLAIN),)), networks=None)
    own = cases.in_study(replace(study, network=network))
    assert own.networks == (((0.0, network),),) * 2
    assert own.take(np.array([1])).networks == (((0.0, network),),)
    moved = replace(own, networks=(((0.0, network), (0.2, PLAIN)),) * 2).later(0.5)
    assert moved.networks is not None
    assert moved.networks[0] == ((0.0, network), (0.7, PLAIN))
    assert study_of_case(study, moved, 0, 1).network == network
