"""Events to a timeline: sorted, continuous where nothing jumps, and equal to an independent description."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from tests.examples import examples
from tests.oracles.emt_source import StiffSource
from tests.simulation.studies import GAINS, lc_study
from vsgdesign.simulation import GainChange
from vsgdesign.simulation.run import begin_together
from vsgdesign.simulation.run_asked import RunOf
from vsgdesign.simulation.run_state import RunState
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import Event, Grid

STUDY = lc_study("1 s")
GRID = st.builds(Grid, st.floats(0.1, 5.0), st.floats(1e-4, 1e-2))
TIME = st.one_of(st.floats(0.0, 1.0), st.integers(0, 20).map(lambda k: 0.05 * k))  # the latter to collide
EVENT = st.builds(
    Event,
    t_s=TIME,
    name=st.just("event"),
    grid=st.none() | GRID,
    V_g_rms=st.none() | st.floats(0.0, 220.0),
    omega_g=st.none() | st.floats(300.0, 330.0),
    over=st.just(0.0) | st.floats(1e-3, 0.5) | st.integers(1, 6).map(lambda k: 0.05 * k),
    phase_jump=st.just(0.0) | st.floats(-3.0, 3.0),
    P_ref=st.none() | st.floats(-5e3, 5e3),
    Q_ref=st.none() | st.floats(-5e3, 5e3),
)
EVENTS = st.lists(EVENT, max_size=8).map(lambda events: tuple(sorted(events, key=lambda e: e.t_s)))
HYPOTHESIS = examples(60)


@HYPOTHESIS
@given(EVENTS, st.lists(st.floats(0.0, 1.6), min_size=1, max_size=10))
def test_source_against_an_independent_one(events: tuple[Event, ...], instants: list[float]) -> None:
    study = replace(STUDY, events=events)
    timeline, reference = build_timeline(study), StiffSource(study)
    for t_s in instants:
        source = timeline.source_at(t_s)
        peak, peak_slope, phase, omega, omega_slope = reference.held(t_s, t_s)
        # Some 500 rad of phase and sums of up to a dozen pieces.
        assert source.V_g_rms * 2.0**0.5 == pytest.approx(peak, abs=1e-9)
        assert source.V_slope * 2.0**0.5 == pytest.approx(peak_slope, rel=1e-9, abs=1e-9)
        assert source.phase == pytest.approx(phase, abs=1e-9)
        assert source.omega == pytest.approx(omega, abs=1e-9)
        assert source.omega_slope == pytest.approx(omega_slope, rel=1e-9, abs=1e-9)
    ordered = np.sort(np.array(instants))
    np.testing.assert_allclose(
        timeline.source_phase(ordered), [timeline.source_at(t).phase for t in ordered], rtol=0.0, atol=1e-12
    )


@HYPOTHESIS
@given(EVENTS)
def test_sorted_and_continuous(events: tuple[Event, ...]) -> None:
    timeline = build_timeline(replace(STUDY, events=events))
    starts = [source.t_s for source in timeline.sources]
    assert starts[0] == 0.0
    assert all(a < b for a, b in itertools.pairwise(starts))
    for items in (timeline.grids, timeline.references):
        times = [item[0] for item in items]
        assert times == sorted(times)
    assert list(timeline.plant_changes()) == sorted(set(timeline.plant_changes()))
    for before, after in itertools.pairwise(timeline.sources):
        until = before.at(after.t_s)
        here = [event for event in events if event.t_s == after.t_s]
        jump = sum(event.phase_jump for event in here)
        assert after.phase - until.phase == pytest.approx(jump, abs=1e-10)
        if not any(event.V_g_rms is not None and event.over == 0.0 for event in here):
            assert after.V_g_rms == pytest.approx(until.V_g_rms, abs=1e-9)
        if not any(event.omega_g is not None and event.over == 0.0 for event in here):
            assert after.omega == pytest.approx(until.omega, abs=1e-9)


@HYPOTHESIS
@given(EVENTS)
def test_ramps_meet_their_goal_and_everything_ends_steady(events: tuple[Event, ...]) -> None:
    timeline = build_timeline(replace(STUDY, events=events))
    assert timeline.source_at(10.0).steady
    for field, event_field in (("V_g_rms", "V_g_rms"), ("omega", "omega_g")):
        moves = [event for event in events if getattr(event, event_field) is not None]
        for event, following in itertools.zip_longest(moves, moves[1:]):
            end = event.t_s + event.over
            if following is None or following.t_s > end:
                # Exactly: the value is set at the end of a ramp, not accumulated.
                assert getattr(timeline.source_at(end), field) == getattr(event, event_field)


@HYPOTHESIS
@given(EVENTS, st.floats(0.0, 1.0))
def test_grids_and_references_hold_until_the_next(events: tuple[Event, ...], t_s: float) -> None:
    timeline = build_timeline(replace(STUDY, events=events))
    P_ref, Q_ref, grid = 2000.0, 500.0, STUDY.grid
    for event in events:
        if event.t_s <= t_s:
            P_ref = event.P_ref if event.P_ref is not None else P_ref
            Q_ref = event.Q_ref if event.Q_ref is not None else Q_ref
            grid = event.grid or grid
    assert timeline.references_at(t_s) == STUDY.converter.references(P_ref, Q_ref)
    assert timeline.grid_at(t_s) == grid


def test_phase_is_the_integral_of_frequency() -> None:
    events = (
        Event(0.1, "", omega_g=320.0, over=0.3),
        Event(0.25, "", omega_g=305.0, over=0.2),  # takes over half-way
        Event(0.6, "", V_g_rms=100.0, over=0.1, phase_jump=0.4),
        Event(0.8, "", omega_g=314.0),
    )
    timeline = build_timeline(replace(STUDY, events=events))
    assert timeline.source_at(0.25).omega == pytest.approx(
        STUDY.grid_source.omega_g + 0.5 * (320.0 - STUDY.grid_source.omega_g)
    )
    for t_s in (0.05, 0.2, 0.25, 0.4, 0.7, 0.95):
        turned, _ = quad(lambda s: timeline.source_at(s).omega, 0.0, t_s, points=[0.1, 0.25, 0.45, 0.8], epsabs=1e-12)
        expected = -0.5 * np.pi + turned + (0.4 if t_s >= 0.6 else 0.0)
        assert timeline.source_phase(np.array([t_s]))[0] == pytest.approx(expected, abs=1e-9)


@HYPOTHESIS
@given(EVENTS, st.lists(st.floats(0.0, 1.0), max_size=4))
def test_stretches_cover_every_sample_once(events: tuple[Event, ...], changes: list[float]) -> None:
    study = replace(STUDY, events=events, simulation=replace(STUDY.simulation, start="cold"))
    timeline = build_timeline(study)
    T_s, samples = study.converter.T_s, 20000
    run = RunState(RunOf(study, [GainChange(t_s, GAINS) for t_s in [0.0, *changes]]))
    begin_together([run], switched=False)
    following = 0
    for first, end in itertools.pairwise(run.marks()):
        assert first == following
        assert end > first
        following, count = end, end - first
        # What changes within a stretch of several samples changes at none of its inner instants.
        if count > 1:
            begin, end = first + 1e-5, first + count - 1e-5
            inner = [t / T_s for t in timeline.plant_changes() if begin < t / T_s < end]
            assert inner == []
            told = [t / T_s for t, _ in timeline.references] + [t / T_s for t in changes]
            assert [t for t in told if first + 1e-5 < t < first + count - 1.0 - 1e-5] == []
    assert following == samples
