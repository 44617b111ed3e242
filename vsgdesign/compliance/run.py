"""One test of a suite through the EMT: its run, its trace, and the judge's verdict."""

from __future__ import annotations

from dataclasses import dataclass

from vsgdesign.compliance.case import Subject, case_of, closed_test, test_as_run
from vsgdesign.compliance.suite import SuiteTest
from vsgdesign.compliance.trace import Trace
from vsgdesign.compliance.tracing import trace_of
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import CircuitError, InfeasibleStudyError, SimulationDivergedError, StudyError
from vsgdesign.metrics.survival import DIVERGED, NO_REST, NOT_AT_REST, Survival
from vsgdesign.parameters.study import ControllerSpec, Study
from vsgdesign.simulation.clearing import with_instants
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.scenario import feed_of
from vsgdesign.simulation.survival.scenario import judge_scenario
from vsgdesign.simulation.timeline import build_timeline


@dataclass(frozen=True, kw_only=True)
class TestRun:
    """One run of one test with everything that its row is made of."""

    __test__ = False  # pytest takes no test for one of its own

    test: SuiteTest
    """With the instants at which a synchro-check has closed the breaker and the phases of faults were interrupted."""
    study: Study
    """With the events of the test, and with the current limit of the controller."""
    spec: ControllerSpec
    """The controller as it ran: with what it was told of the grid."""
    simulation: Simulation | None
    """None: the run could not begin, or diverged at once."""
    trace: Trace | None
    """None: there is no run, or it ended before its test began."""
    survival: Survival
    gains: PowerLoopGains | None = None
    """In force before the first event."""


def run_test(subject: Subject, test: SuiteTest) -> TestRun:
    """The run of a test with a controller. What goes wrong in the run is its verdict.

    A breaker that never closes in phase is a verdict, too. Raises StudyError where the test cannot be said in a study,
    and where an island does not drift to the angle at which its breaker is to close out of phase; CircuitError where
    the simulation cannot follow the circuit.
    """
    study = case_of(subject, test)
    spec = study.controllers[0]
    study = study.with_limit_of(spec)
    try:
        closed = closed_test(subject, test)
        if closed is not test:
            test = closed
            study = case_of(subject, test).with_limit_of(spec)
        found = with_instants(study, spec, subject.ready)
        if found is not study:
            test, study = test_as_run(test, study, found, subject.lead_s), found
        feed = feed_of(study, spec, build_timeline(study), subject.ready)
        simulation = simulate(study, feed)
    except StudyError as error:  # the test itself has been said above: its breaker never closes
        if any(one.synchro_check is not None and one.synchro_check.around for one in test.events):
            raise
        reason = "; ".join(str(fault) for fault in error.faults)
        return _without(study, spec, test, Survival(status=NOT_AT_REST, reason=reason))
    except SimulationDivergedError as error:
        return _without(study, spec, test, Survival(status=DIVERGED, reason=str(error)))
    except CircuitError:
        raise
    except InfeasibleStudyError as error:
        return _without(study, spec, test, Survival(status=NO_REST, reason=f"before the test: {error}"))
    before = [change.gains for change in simulation.gain_changes if change.t_s < subject.lead_s or change.t_s == 0.0]
    return TestRun(
        test=test,
        study=study,
        spec=spec,
        simulation=simulation,
        trace=_trace(subject, study, simulation),
        survival=judge_scenario(study, spec, subject.ready, simulation, own_rest=True),
        gains=before[-1],
    )


def _trace(subject: Subject, study: Study, simulation: Simulation) -> Trace | None:
    """The trace of a run; None where it diverged before its test began."""
    if float(simulation.t_s[-1]) <= subject.lead_s:
        return None
    return trace_of(study, simulation, subject.row_samples, subject.lead_s)


def _without(study: Study, spec: ControllerSpec, test: SuiteTest, survival: Survival) -> TestRun:
    return TestRun(test=test, study=study, spec=spec, simulation=None, trace=None, survival=survival)
