"""One test of a suite through the EMT: the study that it is, its run, its trace, and the judge's verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vsgdesign.compliance.network_in_si import fault_in_si, load_in_si
from vsgdesign.compliance.subject import Subject
from vsgdesign.compliance.suite import SuiteEvent, SuiteTest
from vsgdesign.compliance.trace import Trace
from vsgdesign.compliance.tracing import trace_of
from vsgdesign.compliance.words import event_in_words
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError, SimulationDivergedError
from vsgdesign.metrics.survival import DIVERGED, NO_REST, Survival, SurvivalDemand
from vsgdesign.parameters.network import Network
from vsgdesign.parameters.study import ControllerSpec, Event, Place, Study
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.scenario import feed_of
from vsgdesign.simulation.survival.cases import BASIS
from vsgdesign.simulation.survival.running import judge_scenario
from vsgdesign.simulation.timeline import build_timeline


@dataclass(frozen=True, kw_only=True)
class TestRun:
    """One run of one test with everything that its row is made of."""

    __test__ = False  # its name is no test's of pytest

    test: SuiteTest
    study: Study
    """With the events of the test, and with the current limit of the controller."""
    spec: ControllerSpec
    """The controller as it ran: with what it was told of the grid."""
    simulation: Simulation | None
    """None: the run could not begin, or diverged at once."""
    trace: Trace | None
    survival: Survival
    gains: PowerLoopGains | None = None
    """In force before the first event."""


def run_test(subject: Subject, test: SuiteTest) -> TestRun:
    """The run of a test with a controller. It does not fail: what goes wrong is the verdict."""
    study, spec = study_of(subject, test), subject.told(test.silent_s)
    timeline = build_timeline(study)
    try:
        feed = feed_of(study, spec, timeline, subject.ready)
        simulation = simulate(study, feed, bridge="averaged")
    except SimulationDivergedError as error:
        return _without(study, spec, test, Survival(status=DIVERGED, reason=str(error)))
    except InfeasibleStudyError as error:
        return _without(study, spec, test, Survival(status=NO_REST, reason=f"before the test: {error}"))
    survival = judge_scenario(study, spec, subject.ready, simulation, own_rest=True)
    return TestRun(
        test=test,
        study=study,
        spec=spec,
        simulation=simulation,
        trace=trace_of(study, simulation, subject.row_samples, subject.lead_s),
        survival=survival,
        gains=_gains_before(simulation, subject.lead_s),
    )


def study_of(subject: Subject, test: SuiteTest) -> Study:
    """The study that a test is: its grid, operating point and events, in SI, at rest for the lead time before them.

    The source of the study stays, for which closed forms are designed; an event at t = 0 gives that of the test.
    """
    study, lead_s = subject.own_study, subject.lead_s
    c = study.converter
    events = [_source_event(study, test)] if test.V_g_pu * c.V_rated_rms != study.grid_source.V_g_rms else []
    network = Network(load=None if test.load is None else load_in_si(test.load, c))
    begun = network
    for event in test.events:
        made, network = _event(study, event, lead_s, network)
        events.append(made)
    return replace(
        study,
        grid=Place(test.scr, test.x_over_r, BASIS).grid(c),
        network=begun,
        events=tuple(events),
        simulation=replace(
            study.simulation,
            duration=_whole_rows(subject, lead_s + cleared_s(test) + after_s(subject, test)),
            bridge="averaged",
            start="steady_state",
            log_interval=c.T_s,
            P_ref=test.P_pu * c.S_rated,
            Q_ref=test.Q_pu * c.S_rated,
            survival=True,
        ),
    )


def cleared_s(test: SuiteTest) -> float:
    """When the last event of a test, with its ramp, is over, s."""
    return max((event.t_s + event.over_s for event in test.events), default=0.0)


def after_s(subject: Subject, test: SuiteTest) -> float:
    """How long a test is watched after its last event, s: as long as it asks for, and as the judge needs."""
    c = subject.study.converter
    cycle_s = 2.0 * math.pi / c.omega_n
    demand = SurvivalDemand(
        S_rated=c.S_rated, settling_time=subject.settling_time, cycle_s=cycle_s, i_max_pu=subject.limit_pu
    )
    return max(demand.needed_s + 2.0 * cycle_s, test.duration_s or 0.0)


def _whole_rows(subject: Subject, duration_s: float) -> float:
    row_s = subject.row_samples * subject.study.converter.T_s
    return math.ceil(duration_s / row_s - 1e-9) * row_s


def _source_event(study: Study, test: SuiteTest) -> Event:
    return Event(0.0, f"V_g {test.V_g_pu:.4g} pu", V_g_rms=test.V_g_pu * study.converter.V_rated_rms)


def _event(study: Study, event: SuiteEvent, lead_s: float, network: Network) -> tuple[Event, Network]:
    """One event in SI, and the network from then on."""
    c = study.converter
    found = network
    if event.fault is not None:
        found = replace(found, fault=fault_in_si(event.fault, c))
    if event.fault_cleared:
        found = replace(found, fault=None)
    if event.load is not None:
        found = replace(found, load=load_in_si(event.load, c))
    if event.load_off:
        found = replace(found, load=None)
    if event.connected is not None:
        found = replace(found, connected=event.connected)
    grid = None
    if event.scr is not None and event.x_over_r is not None:
        grid = Place(event.scr, event.x_over_r, BASIS).grid(c)
    made = Event(
        t_s=lead_s + event.t_s,
        name=event_in_words(event),
        grid=grid,
        V_g_rms=None if event.V_g_pu is None else event.V_g_pu * c.V_rated_rms,
        omega_g=None if event.df_hz is None else c.omega_n + 2.0 * math.pi * event.df_hz,
        over=event.over_s,
        phase_jump=math.radians(event.phase_deg),
        P_ref=None if event.P_pu is None else event.P_pu * c.S_rated,
        Q_ref=None if event.Q_pu is None else event.Q_pu * c.S_rated,
        network=None if found == network else found,
    )
    return made, found


def _gains_before(simulation: Simulation, lead_s: float) -> PowerLoopGains:
    return [change.gains for change in simulation.gain_changes if change.t_s < lead_s or change.t_s == 0.0][-1]


def _without(study: Study, spec: ControllerSpec, test: SuiteTest, survival: Survival) -> TestRun:
    return TestRun(test=test, study=study, spec=spec, simulation=None, trace=None, survival=survival)


def finite(trace: Trace) -> bool:
    """Whether every value of a trace is a number."""
    return all(bool(np.isfinite(values).all()) for values in vars(trace).values())
