"""A test whose breaker closes behind a synchro-check: when it does."""

from __future__ import annotations

from dataclasses import replace

from vsgdesign.compliance.case import case_of
from vsgdesign.compliance.subject import Subject
from vsgdesign.compliance.suite import SuiteTest
from vsgdesign.errors import Fault, StudyError
from vsgdesign.simulation.reclosing import reclosed

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
    resolved = reclosed(study, spec, subject.ready)
    found = [event for event in resolved.events if event not in study.events and event.synchro_check is None]
    closings = [event for event in found if event.network is not None and event.network.connected]
    if not closings:
        problem = f"both sides are never near enough within {WAIT_S:g} s, so the breaker stays open"
        advice = "An island whose frequency is near that of the grid takes long to drift there."
        raise StudyError(test.id, [Fault("synchro_check", "", problem, advice)])
    closed = replace(waits[0], t_s=closings[-1].t_s - subject.lead_s, synchro_check=None)
    events = tuple(closed if event is waits[0] else event for event in test.events)
    return replace(test, events=tuple(sorted(events, key=lambda event: event.t_s)))
