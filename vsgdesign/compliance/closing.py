"""A test with the instants that only a run can tell: of a breaker behind a synchro-check, and of faults that end."""

from __future__ import annotations

from dataclasses import replace

from vsgdesign.compliance.case import case_of
from vsgdesign.compliance.subject import Subject
from vsgdesign.compliance.suite import SuiteEvent, SuiteTest
from vsgdesign.errors import Fault, StudyError
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.clearing import cleared_events, clearings, with_instants
from vsgdesign.simulation.reclosing import closings_of

WAIT_S = 5.0
"""For so long after its event a synchro-check may wait, s: an island 0.2 Hz off passes every angle in this time."""


def closed_test(subject: Subject, test: SuiteTest) -> SuiteTest:
    """The test with the instant at which the breaker closes in the place of the synchro-check.

    A test without a synchro-check is returned as it is. Raises StudyError where the breaker never closes or where the
    test cannot be said in a study, and what a simulation raises.
    """
    waits = [event for event in test.events if event.synchro_check is not None]
    if not waits:
        return test
    study, _ = case_of(subject, replace(test, duration_s=max(test.duration_s or 0.0, WAIT_S)))
    spec = study.controllers[0]
    study = study.with_limit_of(spec)
    closings = closings_of(study, with_instants(study, spec, subject.ready))
    if not closings:
        problem = f"both sides are never near enough within {WAIT_S:g} s, so the breaker stays open"
        advice = "An island whose frequency is near that of the grid takes long to drift there."
        raise StudyError(test.id, [Fault("synchro_check", "", problem, advice)])
    closed = replace(waits[0], t_s=closings[-1].t_s - subject.lead_s, synchro_check=None)
    events = tuple(closed if event is waits[0] else event for event in test.events)
    return replace(test, events=tuple(sorted(events, key=lambda event: event.t_s)))


def test_as_run(test: SuiteTest, study: Study, found: Study, lead_s: float) -> SuiteTest:
    """The test with the instants at which the phases of its faults were interrupted.

    ``study``: the test as it was asked for; ``found``: with these instants
    (:func:`vsgdesign.simulation.clearing.with_instants`). Everything that comes with a clearing moves to the last
    interruption, and the first one of a three-phase fault is an event of its own.
    """
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
                R_pu = left.R / study.converter.Z_base
                events.append(SuiteEvent(t_s=event.t_s - lead_s, fault=replace(left, R=R_pu)))
    return replace(test, events=tuple(sorted(events, key=lambda event: event.t_s)))
