"""A kind of event that exists in this file alone: a step of the frequency set point of the P–f droop.

Nothing in the package knows it. It runs in a study, a verification, a survival case, a suite and the explorer, and a
judge of its own on a log of every sample says the same of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest

from tests.simulation import event_kinds as everywhere
from vsgdesign.errors import StudyError
from vsgdesign.simulation.lanes.cases import LaneEvents
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS, EventKind, OfSuite, StepOfKind
from vsgdesign.study.parameters.fields import F_N
from vsgdesign.study.parameters.loading import study_from_text

F_REF = EventKind(
    name="f_ref",
    quantity="omega_0",
    unit="Hz",
    low=0.98 * F_N,
    high=1.02 * F_N,
    meaning="frequency set point of the P–f droop",
    one=lambda _: 2.0 * math.pi,
    words=lambda omega, _: f"f_ref {omega / (2.0 * math.pi):.5g} Hz",
    of_suite=OfSuite(
        name="df_ref",
        unit="Hz",
        limits=(-1.0, 1.0),
        of_study=lambda df, c: c.omega_n / (2.0 * math.pi) + df,
        words="f_ref {:+}",
        sentence="f_ref {} off nominal",
        signed=True,
        short=lambda df: f"f_ref {df:+.3g} Hz",
    ),
    step=StepOfKind(
        name="frequency_set_point",
        title="Steps of f_ref",
        noun="steps of f_ref",
        label="step of f_ref",
        unit="Hz",
        start=lambda c: c.omega_n,
        one=lambda _: 2.0 * math.pi,
        size=(0.1, 0.25),
        most=0.5,
    ),
    answers="D_p",
    needs="P–f droop",
)
DROOP = 0.05


@pytest.fixture(autouse=True)
def _registered() -> Iterator[None]:
    before = dict(EVENT_KINDS)
    forget = EVENT_KINDS.register(F_REF)
    yield
    forget()
    assert dict(EVENT_KINDS) == before


def test_a_run_ends_where_the_droop_says() -> None:
    study, run, recovery_s = everywhere.in_simulate('f_ref = "50.2 Hz"')
    assert [event.name for event in study.events] == ["f_ref 50.2 Hz"]
    found = everywhere.judged(study, run, 0.2)
    c = study.converter
    assert pytest.approx(2000.0 + 0.2 / (DROOP * 50.0) * c.S_rated, abs=1e-4 * c.S_rated) == found.P
    assert recovery_s is not None
    assert recovery_s == pytest.approx(found.recovery_s, abs=everywhere.SAME_S)
    assert recovery_s > 0.02


def test_it_is_drawn_where_a_study_asks_for_it() -> None:
    everywhere.in_verify("frequency_set_point", 8)


def test_a_survival_case_and_a_suite_have_it() -> None:
    everywhere.in_survive(Event.of_pu(0.0, df_ref=0.2))
    everywhere.in_a_suite('df_ref = "-0.2 Hz"')


def test_the_explorer_shows_it() -> None:
    everywhere.in_the_explorer("frequency_set_point", 0.2)


def test_its_limits_are_read_and_two_events_agree() -> None:
    with pytest.raises(StudyError, match=r"f_ref = .52 Hz.: outside 49 Hz to 51 Hz"):
        everywhere.study_with("[[events]]\ntime = 1\nf_ref = '52 Hz'\n")
    twice = "[[events]]\ntime = 1\nf_ref = '50.1 Hz'\n[[events]]\ntime = 1\nf_ref = '50.2 Hz'\n"
    with pytest.raises(StudyError, match=r"sets it to 50\.1 Hz at the same instant"):
        everywhere.study_with(twice)
    with pytest.raises(ValueError, match="'P_ref' is already the name of another kind"):
        EVENT_KINDS.register(replace(F_REF, name="P_ref"))


def test_arrays_and_documents_have_it() -> None:
    event = Event(0.3, omega_0=2.0 * math.pi * 50.2, P_ref=100.0)
    assert LaneEvents.of([[event], []]).events(0) == (event,)
    assert LaneEvents.of([[event], []]).events(1) == ()
    c = study_from_text(everywhere.TEXT).converter
    assert event.document(c) == {"time": 0.3, "P_ref": 100.0, "f_ref": 50.2}
