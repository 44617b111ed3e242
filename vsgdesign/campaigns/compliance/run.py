"""One test of a suite through the EMT: its run, its trace, the judge's verdict, and what the linear model says."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.campaigns.compliance.case import Subject, test_as_run, test_closed, waiting_case
from vsgdesign.campaigns.compliance.measuring import Trace
from vsgdesign.campaigns.compliance.suite import SuiteTest
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.grid import capacitor_node_voltage
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import CircuitError, InfeasibleStudyError, SimulationDivergedError, StudyError, VsgDesignError
from vsgdesign.linear.operating_point.full_order import Cell, FullOrderModel, linearise_full_order
from vsgdesign.linear.stability.loops import network_frequency_perturbation
from vsgdesign.linear.stability.modes_of_units import differential_modes
from vsgdesign.metrics.step_response import unwrapped
from vsgdesign.metrics.survival import BLOCKED, DIVERGED, NO_REST, NOT_AT_REST, Survival
from vsgdesign.simulation.between_rows import RowsAsked, between_rows, taken_of_log
from vsgdesign.simulation.dc_start import dc_columns
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import Simulation, simulated, simulated_together
from vsgdesign.simulation.run_asked import RunOf
from vsgdesign.simulation.scenario.controllers import told_if_blocked
from vsgdesign.simulation.survival.verdicts import judge_scenario
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.grid import GridSource
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]


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
    ((_, found),) = run_tests(subject, [test])
    if isinstance(found, VsgDesignError):
        raise found
    return found


def run_tests(
    subject: Subject, tests: Sequence[SuiteTest]
) -> Iterator[tuple[int, TestRun | StudyError | CircuitError]]:
    """The runs of tests with a controller, side by side where they can be: each as :func:`run_test` gives it, or the
    error that it raises, with its place among the tests. The order is that in which they end."""
    begun: list[tuple[int, Study, RunOf]] = []
    for place, test in enumerate(tests):
        try:
            asked, ends = waiting_case(subject, test)
        except StudyError as error:
            yield place, error
            continue
        try:
            begun.append((place, asked, _run_of(subject, asked, ends)))
        except VsgDesignError as error:
            yield place, _test_run(subject, test, asked, error)
    for number, outcome in simulated_together([of for _, _, of in begun]):
        place, asked, _ = begun[number]
        yield place, _test_run(subject, tests[place], asked, outcome)


def _test_run(
    subject: Subject, test: SuiteTest, asked: Study, outcome: Simulation | VsgDesignError
) -> TestRun | StudyError | CircuitError:
    """What has become of a test, or the error of what no run of it can show."""
    spec = asked.controllers[0]
    try:
        if isinstance(outcome, VsgDesignError):
            raise outcome
        test, study = test_as_run(subject, test, asked, outcome.study)
    except StudyError as error:  # the test itself has been said above: its breaker never closes
        if any(one.synchro_check is not None and one.synchro_check.around for one in test.events):
            return error
        reason = "; ".join(str(fault) for fault in error.faults)
        return _without(asked, spec, test, Survival(status=NOT_AT_REST, reason=reason))
    except SimulationDivergedError as error:
        return _without(asked, spec, test, Survival(status=DIVERGED, reason=str(error)))
    except CircuitError as error:
        return error
    except InfeasibleStudyError as error:
        return _without(asked, spec, test, Survival(status=NO_REST, reason=f"before the test: {error}"))
    simulation = outcome
    survival = judge_scenario(study, spec, subject.ready, simulation, own_rest=True, rests=subject.rests)
    if survival.status == BLOCKED and (told := told_if_blocked(study, spec, subject.ready, "averaged")) is not None:
        survival = replace(survival, status=NO_REST, reason=told)
    before = [change.gains for change in simulation.gain_changes if change.t_s < subject.lead_s or change.t_s == 0.0]
    return TestRun(
        test=test,
        study=study,
        spec=spec,
        simulation=simulation,
        trace=_trace(subject, study, simulation),
        survival=survival,
        gains=before[-1],
    )


def run_of(subject: Subject, asked: Study, ends: Callable[[Study], float] | None) -> Simulation:
    """The run of :func:`vsgdesign.campaigns.compliance.case.waiting_case`, which finds the instants that only it can
    tell."""
    return simulated(_run_of(subject, asked, ends))


def _run_of(subject: Subject, asked: Study, ends: Callable[[Study], float] | None) -> RunOf:
    spec, timeline = asked.controllers[0], build_timeline(asked)
    feed = feed_of(asked, spec, timeline, subject.ready, subject.first_gains)
    # What is judged by more than SEEN_COLUMNS of every sample: a dc link, a protection, an island, units of a plant.
    connected = timeline.network_at(asked.simulation.duration).connected
    thin = asked.dc is None and asked.protection is None and subject.units == 1 and connected
    rows = rows_of_trace(asked, subject.row_samples, subject.lead_s)._replace(thin=thin)
    return RunOf(asked, feed, finds=spec, ends=ends, rows=rows, together=True)


def closed_test(subject: Subject, test: SuiteTest) -> SuiteTest:
    """The test with the instant at which its breaker closes in the place of a synchro-check, for a file. A test without
    one is returned as it is, and not run. Raises what :func:`run_test` raises."""
    if all(event.synchro_check is None for event in test.events):
        return test
    asked, ends = waiting_case(subject, test)
    return test if ends is None else test_closed(subject, test, asked, run_of(subject, asked, ends).study)


def _trace(subject: Subject, study: Study, simulation: Simulation) -> Trace | None:
    """The trace of a run; None where it diverged before its test began."""
    if float(simulation.each_s[-1]) <= subject.lead_s:
        return None
    return trace_of(study, simulation, subject.row_samples, subject.lead_s)


def _without(study: Study, spec: ControllerSpec, test: SuiteTest, survival: Survival) -> TestRun:
    return TestRun(test=test, study=study, spec=spec, simulation=None, trace=None, survival=survival)


BEFORE_S = 0.1
"""A trace begins so long before its test, s; what an estimator learned earlier is left out."""

_SAME_INSTANT = 1e-6
"""Share of a sample by which a row may lie before an event and is still after it: times are rounded."""


def rows_of_trace(study: Study, every: int, lead_s: float) -> RowsAsked:
    """The rows of a trace, one for every ``every`` samples."""
    return RowsAsked(max(round((lead_s - BEFORE_S) / study.converter.T_s) // every * every, 0), every)


def trace_of(study: Study, simulation: Simulation, every: int, lead_s: float) -> Trace:
    """The trace of a run with a row for every ``every`` samples; its log has every sample, or these rows alone.

    Values are those of the row's sample. Peaks are the largest since the row before, and the power of the dc link and
    the share of limited samples are means over this time.
    """
    c, circuit = study.converter, study.circuit()
    asked = rows_of_trace(study, every, lead_s)
    apart = round(simulation.interval / c.T_s)
    rows = slice(asked.first // apart, None, every // apart)
    t_s, at = simulation.t_s[rows], simulation.log[rows]
    node = [capacitor_node_voltage(at[:, k], at[:, 2 + k], at[:, 4 + k], circuit) for k in (0, 1)]
    V_pk = rms_to_peak(c.V_rated_rms)
    # One instant of rounding later: the row of an event belongs to the source after it.
    phase = simulation.timeline.source_phase(t_s + _SAME_INSTANT * c.T_s)
    taken = taken_of_log(study, simulation.log, asked) if simulation.between is None else simulation.between
    i_s, i_phase, P_dc = between_rows(study, at, taken, asked)
    counted = simulation.column("limited_samples")[rows]
    return Trace(
        t_s=np.round(t_s - lead_s, 9) + 0.0,
        P_pu=simulation.column("P")[rows] / c.S_rated,
        Q_pu=simulation.column("Q")[rows] / c.S_rated,
        f_hz=simulation.column("omega")[rows] / (2.0 * np.pi),
        V_pu=simulation.column("V_rms")[rows] / c.V_rated_rms,
        delta_rad=unwrapped(simulation.column("theta")[rows] - phase),
        i_s_pu=i_s / c.I_rated_pk,
        i_phase_pu=i_phase / c.I_rated_pk,
        v_alpha_pu=node[0] / V_pk,
        v_beta_pu=node[1] / V_pk,
        i_g_alpha_pu=at[:, 4] / c.I_rated_pk,
        i_g_beta_pu=at[:, 5] / c.I_rated_pk,
        P_dc_pu=P_dc / c.S_rated,
        v_dc_pu=np.ones(len(at)) if simulation.dc_log is None else _v_dc(study, simulation.dc_log[rows]) / c.V_dc,
        limited=np.diff(counted, prepend=counted[:1]) / every,
    )


def _v_dc(study: Study, rows: Array) -> Array:
    """The voltage of the dc link in rows of its log, V."""
    return rows[:, dc_columns(study).index("v")]


def differential_rests(run: TestRun, lead_s: float) -> float | str:
    """The slowest decay (1/s) of equal units against each other, each on its R_2 and L_2 alone (:eq:`plant-split`): at
    the powers, voltages and frequencies before the test and at its end, with the gains in force there. A text says why
    there is none."""
    simulation = run.simulation
    if simulation is None or not run.survival.survived:
        return "the run does not end at a rest"
    if (run.survival.limited_at_end or 0.0) > 0.0:
        return "the current limit acts at the end, which no linear model knows"
    if run.study.filter.L_2 == 0.0:
        return "nothing lies between the units"
    rows = [max(int(np.searchsorted(simulation.t_s, lead_s)) - 1, 0), -1]
    P, Q, V, omega = (simulation.column(name)[rows] for name in ("P", "Q", "V_rms", "omega"))
    t_s = simulation.t_s[rows]
    gains = [
        [one.gains for one in simulation.gain_changes if one.t_s <= at or one.t_s == 0.0][-1] for at in t_s.tolist()
    ]
    each = PowerLoopGains(*np.array(gains).T)
    free = replace(run.study, converter=replace(run.study.converter, current_limit_pu=None))
    slowest = differential_modes(free, each, P, Q, V, omega).real.max()
    return float(-slowest) if np.isfinite(slowest) else "a unit alone on its own path has no steady state"


Complex = NDArray[np.complexfloating[Any, Any]]


def nfp_of(study: Study, gains: PowerLoopGains | None) -> Callable[[Array], Complex | str]:
    """ΔP over Δω_g per unit (:eq:`nfp`) as a function of angular frequencies (F,), rad/s, at the first grid and
    references of a test's own study. The function gives a text where there is none: it says why.

    The model is linearised when the function is first called, and then kept.
    """

    @functools.cache
    def model() -> FullOrderModel | str:
        if gains is None:
            return "the gains before the first event are not known"
        if not study.network.plain:
            return "a load at the PCC is not in the linear model"
        start = build_timeline(study)
        source = start.source_at(0.0)
        cell = Cell.with_references(
            start.grid_at(0.0), gains, start.references_at(0.0), GridSource(source.V_g_rms, source.omega)
        )
        found = linearise_full_order(study.undisturbed, [cell])
        return found if found.faults[0] is None else f"no steady state before the test: {found.faults[0]}"

    def nfp(omega: Array) -> Complex | str:
        found = model()
        if isinstance(found, str):
            return found
        return network_frequency_perturbation(found, 0, omega, study.converter.S_rated, study.converter.omega_n)

    return nfp
