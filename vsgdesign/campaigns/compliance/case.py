"""What goes through a suite, and each test as a study of its own, in SI: the run of its row, the file that repeats it,
and the instants that only a run can tell."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.campaigns.compliance.suite import OURS, Source, SuiteTest
from vsgdesign.campaigns.verification.emt import base_document, controller_document
from vsgdesign.errors import Fault, StudyError
from vsgdesign.metrics.survival import SurvivalDemand
from vsgdesign.simulation.clearing import MOST_CYCLES, cleared_events, clearings
from vsgdesign.simulation.following import KnownFirst
from vsgdesign.simulation.lanes.telling import learns, told_controller
from vsgdesign.simulation.search import closings_of
from vsgdesign.simulation.survival.cases import LEAD_S, LEARNING_S, demand_of, settling_time_of, silent_s_of
from vsgdesign.simulation.survival.verdicts import KnownRests
from vsgdesign.study.given_files import toml_text
from vsgdesign.study.parameters.building import check_resonance
from vsgdesign.study.parameters.converter import scope_of
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.events import read_events
from vsgdesign.study.parameters.fields import DURATION
from vsgdesign.study.parameters.grid import GridEstimate, Network
from vsgdesign.study.parameters.loading import study_from_document
from vsgdesign.study.parameters.network_fields import CLEARED, Said, load_document
from vsgdesign.study.parameters.reader import TableReader
from vsgdesign.study.parameters.study import ControllerSpec, SimulationSpec, Study, StudyOrigin

WAIT_S = 5.0
"""For so long after its event a synchro-check may wait, s: an island 0.2 Hz off passes every angle in this time."""


ROW_S = 5e-4
"""Interval of a trace's rows, s; a sampling period where that is longer."""

FOR_EVER_S = 36000.0
"""How long a schedule without any further estimate is silent, s: what a study file takes at most."""


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A converter with one of its controllers, and the gain table that this controller follows."""

    study: Study
    spec: ControllerSpec
    ready: Ready = NOTHING
    units: int = 1
    """Equal units of a plant, of which the converter is one: all move alike, and then each is on x_t + N Z_g."""

    @cached_property
    def own_study(self) -> Study:
        """The study with the current limit of the controller."""
        return self.study.with_limit_of(self.spec)

    @cached_property
    def base(self) -> Study:
        """What the studies of all tests have in common."""
        none = Source(document="", edition="", confidence=OURS)
        test = SuiteTest(id="", group="", title="", source=none, scr=10.0, x_over_r=10.0)
        document, origin = _document(self, test, f"{self.study.name}_case", ".", None)
        return study_from_document(document | {"events": [{"time": 0.01, "P_ref": 0.0}]}, origin)

    @cached_property
    def rests(self) -> KnownRests:
        """Those to which its tests have led: many lead to the same one."""
        return {}

    @cached_property
    def first_gains(self) -> KnownFirst:
        """Those with which its tests have begun: many begin on the same grid at the same powers."""
        return {}

    @property
    def limit_pu(self) -> float:
        """Limit of the converter's current over the rated peak; infinite without one."""
        limit_pu = self.own_study.converter.current_limit_pu
        return math.inf if limit_pu is None else limit_pu

    @property
    def learns(self) -> bool:
        """Whether the controller estimates its grid by itself, in every sample."""
        return learns(self.spec)

    @property
    def settling_time(self) -> float:
        """T: that of its table's specification, or of its closed form, s."""
        return settling_time_of(self.spec, self.ready)

    @property
    def row_samples(self) -> int:
        """Samples of the controller in one row of a trace."""
        return max(round(ROW_S / self.study.converter.T_s), 1)

    @property
    def lead_s(self) -> float:
        """How long a run is at rest before its test begins, s: a whole number of rows of the trace. An estimator that
        is told nothing learns its grid in this time."""
        row_s = self.row_samples * self.study.converter.T_s
        return math.ceil((LEARNING_S if self.learns else LEAD_S) / row_s - 1e-9) * row_s

    def told(self, silent_s: float) -> ControllerSpec:
        """The controller as it runs: a schedule without an estimator of its own is told the grid, with the errors that
        the study gives it, and ``silent_s`` after every change."""
        spec = told_controller(self.spec)
        if spec.kind == "fixed" or self.learns:
            return spec
        known = spec.knowledge or GridEstimate()
        return replace(spec, knowledge=replace(known, silent_s=min(max(silent_s, known.silent_s), FOR_EVER_S)))


def case_of(subject: Subject, test: SuiteTest) -> Study:
    """The study that a test is for a controller.

    The converter is at rest for the lead time of the subject, and then the test begins. Raises StudyError where the
    study was built from its parts, or where the test cannot be said in a study.
    """
    base, c = subject.base, subject.study.converter
    spec = base.controllers[0]
    if spec.knowledge is not None:
        spec = replace(spec, knowledge=subject.told(test.silent_s).knowledge)
    network = Network(load=None if test.load is None else test.load.in_si(c.Z_base, c.omega_n))
    found = replace(
        base,
        title=f"{test.title}: {subject.spec.name}",
        controllers=(spec,),
        grid=test.place.grid(c),
        network=network,
        simulation=_simulation(subject, test, base.simulation),
    )
    return replace(found, events=_events(found, _event_documents(subject, test)))


def case_text(subject: Subject, test: SuiteTest, *, name: str, folder: str | Path, table: str | None = None) -> str:
    """The text of the same study, for a file in ``folder``. ``table``: the gain table of the controller as the file is
    to name it; None: as the study names it."""
    document, _ = _document(subject, test, name, folder, table)
    return toml_text(document, (document["study"]["title"],))


def _document(
    subject: Subject, test: SuiteTest, name: str, folder: str | Path, table: str | None
) -> tuple[dict[str, Any], StudyOrigin]:
    study, spec = subject.study, subject.told(test.silent_s)
    c, source, title = study.converter, study.grid_source, f"{test.title}: {subject.spec.name}"
    document, origin = base_document(study, spec, folder, name, title)
    grid, simulation = test.place.grid(c), _simulation(subject, test, study.simulation)
    # The source of the study stays, for which closed forms are designed; an event at t = 0 gives that of the test.
    document["grid"] = {
        "scr_basis": study.scr_basis,
        "R_g": grid.R_g,
        "L_g": grid.L_g,
        "V_g_pu": source.V_g_rms / c.V_rated_rms,
        "f_g": source.omega_g / (2.0 * math.pi),
    }
    names = "duration", "bridge", "start", "log_interval", "reference_limit_pu", "P_ref", "Q_ref", "survival"
    document["simulation"] = {name: getattr(simulation, name) for name in names}
    if simulation.survival_settling_time is not None:
        document["simulation"]["survival_settling_time"] = simulation.survival_settling_time
    document["controllers"] = [controller_document(study, spec, document, spec.knowledge, table)]
    if test.load is not None:
        document["network"] = {"load": load_document(test.load, per_unit=True)}
    document["events"] = _event_documents(subject, test)
    return document, origin


def _simulation(subject: Subject, test: SuiteTest, like: SimulationSpec) -> SimulationSpec:
    c = subject.study.converter
    return replace(
        like,
        duration=_whole_rows(subject, subject.lead_s + test.cleared_s + after_s(subject, test)),
        bridge="averaged",
        start="steady_state",
        log_interval=c.T_s,
        reference_limit_pu=100.0,
        P_ref=test.P_pu * c.S_rated,
        Q_ref=test.Q_pu * c.S_rated,
        survival=True,
        survival_settling_time=test.T_at_most,
    )


def _event_documents(subject: Subject, test: SuiteTest) -> list[dict[str, Any]]:
    """The events of a test as a study has them."""
    c, source = subject.study.converter, subject.study.grid_source
    same = test.V_g_pu * c.V_rated_rms == source.V_g_rms and source.omega_g == c.omega_n and test.df_hz == 0.0
    first = Event(0.0, V_g_rms=test.V_g_pu, omega_g=test.df_hz, per_unit=True)
    begin = [] if same else [first.document(c)]
    return [*begin, *(event.document(c, subject.lead_s) for event in test.events)]


def _events(study: Study, documents: list[dict[str, Any]]) -> tuple[Event, ...]:
    faults: list[Fault] = []
    tables = [TableReader(one, f"events[{k}]", faults) for k, one in enumerate(documents)]
    source = replace(study.grid_source, components=())
    c, simulation = study.converter, study.simulation
    scope = scope_of(c, simulation.reference_limit_pu) | {DURATION.of: simulation.duration}
    events = read_events(tables, scope, study.grid, study.scr_basis, c, source, study.network)
    check_resonance(study.filter, c, [study.grid, *(event.grid for event in events if event.grid)], faults)
    components = [event.components for event in events if event.components is not None]
    if components and components[-1]:
        problem = "powers do not come to rest with components of the source"
        advice = "Leave survival out, or take that away. vsgdesign survive judges such grids."
        faults.append(Fault("simulation.survival", "true", problem, advice))
    if faults:
        raise StudyError(study.name, faults)
    return events


def demand_in(subject: Subject, test: SuiteTest) -> SurvivalDemand:
    """What the judge of survival asks of a controller in a test: with its own T, or with the longest of the test."""
    T = subject.settling_time if test.T_at_most is None else min(subject.settling_time, test.T_at_most)
    silent_s = silent_s_of(subject.told(test.silent_s))
    return demand_of(subject.study.converter, T, silent_s=silent_s, limit_pu=subject.limit_pu)


def after_s(subject: Subject, test: SuiteTest) -> float:
    """How long a test is watched after its last event, s: as long as it asks for, and as the judge needs."""
    demand, cycle_s = demand_in(subject, test), 2.0 * math.pi / subject.study.converter.omega_n
    # The last phase of a fault may be interrupted so long after the instant at which the test clears it.
    late_s = MOST_CYCLES * cycle_s if any(event.switched.fault == CLEARED for event in test.events) else 0.0
    return late_s + max(demand.needed_s + 2.0 * cycle_s, test.duration_s or 0.0)


def _whole_rows(subject: Subject, duration_s: float) -> float:
    row_s = subject.row_samples * subject.study.converter.T_s
    return math.ceil(duration_s / row_s - 1e-9) * row_s


def waiting_case(subject: Subject, test: SuiteTest) -> tuple[Study, Callable[[Study], float] | None]:
    """The study of a test, with the current limit of the controller, for a run that finds the instants which only it
    can tell, and when that run may end, s; None: at the end of the study.

    With a synchro-check it may wait for WAIT_S, and the test goes on from the closing of the breaker. Raises StudyError
    where the test cannot be said in a study.
    """
    asked = case_of(subject, test)
    spec = asked.controllers[0]
    if _waiting(test) is None:
        return asked.with_limit_of(spec), None
    asked = case_of(subject, replace(test, duration_s=max(test.duration_s or 0.0, WAIT_S))).with_limit_of(spec)
    until_s = asked.simulation.duration
    longest = replace(asked.simulation, duration=_whole_rows(subject, until_s + after_s(subject, test)))

    def ends(found: Study) -> float:
        closings = closings_of(asked, found)
        if not closings:
            return until_s
        return _simulation(subject, _closed(subject, test, closings[-1].t_s), asked.simulation).duration

    return replace(asked, simulation=longest), ends


def _waiting(test: SuiteTest) -> Event | None:
    return next((event for event in test.events if event.synchro_check is not None), None)


def _closed(subject: Subject, test: SuiteTest, t_s: float) -> SuiteTest:
    """The test with the instant of its run at which the breaker closes in the place of the synchro-check."""
    waiting = _waiting(test)
    events = (
        replace(event, t_s=t_s - subject.lead_s, synchro_check=None) if event is waiting else event
        for event in test.events
    )
    return replace(test, events=tuple(sorted(events, key=lambda event: event.t_s)))


def test_closed(subject: Subject, test: SuiteTest, asked: Study, found: Study) -> SuiteTest:
    """The test with the instant at which its breaker closed in the place of a synchro-check; ``asked`` and ``found`` as
    in :func:`test_as_run`. Raises StudyError where it never closes."""
    closings = closings_of(asked, found)
    if not closings:
        problem = f"both sides are never near enough within {WAIT_S:g} s, so the breaker stays open"
        advice = "An island whose frequency is near that of the grid takes long to drift there."
        raise StudyError(test.id, [Fault("synchro_check", "", problem, advice)])
    return _closed(subject, test, closings[-1].t_s)


def test_as_run(subject: Subject, test: SuiteTest, asked: Study, found: Study) -> tuple[SuiteTest, Study]:
    """The test and its study with the instants at which the breaker closed and the phases of faults were interrupted.

    ``asked``: the study of :func:`waiting_case`; ``found``: as its run was. Everything that comes with a clearing moves
    to the last interruption, and the first one of a three-phase fault is an event of its own. Raises StudyError where a
    breaker that waits never closes.
    """
    events, study, lead_s = list(found.events), found, subject.lead_s
    if _waiting(test) is not None:
        test, closing = test_closed(subject, test, asked, found), closings_of(asked, found)[-1]
        study = case_of(subject, test).with_limit_of(asked.controllers[0])
        told = {closing.name, *(event.name for event in asked.events if event.synchro_check is not None)}
        events = [event for event in events if event.name not in told]
        events += [event for event in study.events if abs(event.t_s - closing.t_s) < 1e-9]
    if cleared_events(asked, found):
        study = replace(study, events=tuple(sorted(events, key=lambda event: event.t_s)))
    return _with_clearings(test, asked, found, lead_s), study


def _with_clearings(test: SuiteTest, study: Study, found: Study, lead_s: float) -> SuiteTest:
    """The test with the instants at which the phases of its faults were interrupted; ``study``: as it was asked for."""
    events = list(test.events)
    for asked_s, cleared in zip(clearings(study), cleared_events(study, found), strict=True):
        moved = {k for k, event in enumerate(events) if abs(lead_s + event.t_s - asked_s) < 1e-9}
        events = [replace(event, t_s=cleared.t_s - lead_s) if k in moved else event for k, event in enumerate(events)]
        for event in found.events:
            left = None if event.network is None else event.network.fault
            if (
                asked_s < event.t_s < cleared.t_s
                and left is not None
                and event.t_s not in {e.t_s for e in study.events}
            ):
                in_pu = Said(None, replace(left, R=left.R / study.converter.Z_base), None)
                events.append(Event(event.t_s - lead_s, switched=in_pu, per_unit=True))
    return replace(test, events=tuple(sorted(events, key=lambda event: event.t_s)))
