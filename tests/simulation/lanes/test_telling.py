"""What the controllers of many runs are told, and their gains: against single runs, update by update."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.gain_tables import table
from tests.simulation.survival.subjects import TEXT
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.many_rests import rest_with_measured_gains
from vsgdesign.simulation import build_timeline
from vsgdesign.simulation.feeds import LateSchedule, safe_grid
from vsgdesign.simulation.following import KnownGridScheduler
from vsgdesign.simulation.gains import ListedGains, gain_changes
from vsgdesign.simulation.lanes.cases import DISTURBANCE, LaneCases, no_events
from vsgdesign.simulation.lanes.telling import Telling, telling
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import ControllerSpec, Event, Study

SPECIFIED = TEXT.replace(
    "[simulation]", "[specification]\nscr = [2, 10]\nx_over_r = [1, 5]\nP = [-0.5, 0.5]\nQ = [-0.2, 0.2]\n[simulation]"
)
TABLE = Ready(tables={"scheduled": table()})
LAST_BITS = 1e-12
"""A batch compiles the scheduler; the hypotenuse of machine code differs from NumPy's in its last bit."""
DURATION_S, EVENTS = 1.7, 3


def study_of(text: str, **changed: Any) -> tuple[Study, ControllerSpec]:
    study = study_from_text(text)
    return study, replace(study.controllers[0], **changed)


def random_cases(study: Study, count: int, seed: int = 5) -> LaneCases:
    """Grids and sources that jump, also within a silence, on a sample, and at an update."""
    rng, c = np.random.default_rng(seed), study.converter
    events = no_events(count, EVENTS)
    times = np.sort(rng.uniform(0.05, 0.8, (count, EVENTS)), axis=1)
    times[::4] = np.round(times[::4] / 0.02) * 0.02
    times[1::4, 1] = times[1::4, 0] + 0.004
    times[rng.random(count) < 0.2, -1] = np.inf
    events.t_s[:] = times
    R_g, L_g = rng.uniform(0.1, 1.2, (EVENTS + 1, count)), rng.uniform(1e-3, 6e-3, (EVENTS + 1, count))
    moves = rng.random((count, EVENTS)) < 0.6
    events.R_g[moves], events.L_g[moves] = R_g[1:].T[moves], L_g[1:].T[moves]
    events.P_ref[~moves] = 1e3
    events.phase_jump[rng.random((count, EVENTS)) < 0.2] = 0.1
    sags = rng.random((count, EVENTS)) < 0.2
    events.V_g_rms[sags] = 0.9 * c.V_rated_rms
    exact = rng.random(count) < 0.3
    return LaneCases(
        R_g=R_g[0],
        L_g=L_g[0],
        V_g_rms=np.full(count, c.V_rated_rms),
        omega_g=np.full(count, c.omega_n),
        P_ref=rng.uniform(-1e3, 1e3, count),
        Q_ref=np.zeros(count),
        events=events,
        error_R=np.where(exact, 0.0, rng.uniform(-0.2, 0.2, count)),
        error_X=np.where(exact, 0.0, rng.uniform(-0.2, 0.2, count)),
        silent_s=np.where(exact, 0.0, rng.choice([0.0, 0.013, 0.1, 0.7, np.inf], count)),
        cleared_s=times[:, -1],
        kind=np.full(count, DISTURBANCE, dtype=np.int8),
        signal=np.zeros(count, dtype=np.int8),
    )


def of_lane(study: Study, cases: LaneCases, lane: int) -> Study:
    """The study of one case."""
    events = []
    for k in range(cases.events.count):
        t_s, R_g, L_g, V_g, P_ref, jump = (
            float(getattr(cases.events, name)[lane, k])
            for name in ("t_s", "R_g", "L_g", "V_g_rms", "P_ref", "phase_jump")
        )
        if math.isfinite(t_s):
            events.append(
                Event(
                    t_s=t_s,
                    name="",
                    grid=None if math.isnan(R_g) else Grid(R_g, L_g),
                    V_g_rms=None if math.isnan(V_g) else V_g,
                    P_ref=None if math.isnan(P_ref) else P_ref,
                    phase_jump=jump,
                )
            )
    return replace(
        study,
        grid=Grid(float(cases.R_g[lane]), float(cases.L_g[lane])),
        simulation=replace(study.simulation, P_ref=float(cases.P_ref[lane]), Q_ref=0.0),
        events=tuple(events),
    )


def told_of(study: Study, cases: LaneCases, lane: int) -> tuple[tuple[float, Grid | None], ...]:
    """What a single run is told: read off the events one by one."""
    error_R, error_X, silent_s = (float(getattr(cases, n)[lane]) for n in ("error_R", "error_X", "silent_s"))
    timeline = build_timeline(study)

    def seen(t_s: float) -> Grid:
        grid = timeline.grid_at(t_s)
        return Grid(grid.R_g * (1.0 + error_R), grid.L_g * (1.0 + error_X))

    said: list[tuple[float, Grid | None]] = [(0.0, seen(0.0))]
    changes = [e.t_s for e in study.events if e.grid is not None or e.V_g_rms is not None or e.phase_jump != 0.0]
    for k, t_s in enumerate(changes):
        said.append((t_s, None))
        if t_s + silent_s < (changes[k + 1] if k + 1 < len(changes) else math.inf):
            said.append((t_s + silent_s, seen(t_s + 1e-9)))
    return tuple(said)


def exact(cases: LaneCases, lane: int) -> bool:
    return bool(cases.error_R[lane] == 0.0 and cases.error_X[lane] == 0.0 and cases.silent_s[lane] == 0.0)


def measured(rng: np.random.Generator, count: int) -> tuple[Any, ...]:
    P, Q, V_rms = rng.uniform(-4e3, 4e3, count), rng.uniform(-1e3, 1e3, count), rng.uniform(100.0, 120.0, count)
    return P, Q, V_rms, (rng.random(count) < 0.1).astype(int)


@pytest.mark.parametrize(("text", "ready"), [(SPECIFIED, TABLE), (SPECIFIED, NOTHING), (TEXT, NOTHING)])
def test_gains_that_follow_the_measured_powers(text: str, ready: Ready) -> None:
    """A table with its guards, and a closed form with and without a safe place: as in single runs."""
    study, spec = study_of(text, schedule="closed_form" if ready is NOTHING else "table")
    cases = random_cases(study, 24)
    if ready is TABLE:
        # To a grid that is not plausible, without a silence: the guards ask whether the current was limited.
        cases.events.t_s[-4:, 1:], cases.events.R_g[-4:, 0], cases.events.L_g[-4:, 0] = np.inf, 1.0, 60e-3
        cases.error_R[-4:], cases.error_X[-4:], cases.silent_s[-4:] = 0.0, 0.0, 0.0
    told = telling(study, spec, ready, cases)
    T_s, rng = study.converter.T_s, np.random.default_rng(1)
    assert told.update_samples == round(0.02 / T_s)
    assert len(told.changes.lane) == 0
    singles = []
    for lane in range(len(cases)):
        one = of_lane(study, cases, lane)
        if exact(cases, lane):
            single: Any = KnownGridScheduler(one, spec, build_timeline(one), ready)
        else:
            single = LateSchedule(one, spec, told_of(one, cases, lane), ready, safe=safe_grid(study, spec, ready))
        singles.append((single, single.first_gains()))
        here = tuple(value[lane] for value in told.estimate())
        assert here == pytest.approx((single.grid.R_g, single.grid.L_g), rel=LAST_BITS)
    told.first(*np.array([(float(P), 0.0, study.converter.V_rated_rms) for P in cases.P_ref]).T)
    present = [list(gains) for _, gains in singles]
    for sample in range(told.update_samples, round(DURATION_S / T_s), told.update_samples):
        P, Q, V_rms, limited = measured(rng, len(cases))
        found = told.update(sample, P, Q, V_rms, limited)
        grid = told.estimate()
        assert found is not None
        for lane, (single, _) in enumerate(singles):
            values = (float(P[lane]), float(Q[lane]), float(V_rms[lane]), int(limited[lane]))
            window = SimpleNamespace(t_s=sample * T_s, **dict(zip(("P", "Q", "V_rms", "limited"), values, strict=True)))
            answer = single.update(window)
            present[lane] = list(answer) if answer is not None else present[lane]
            assert [gain[lane] for gain in found] == pytest.approx(present[lane], rel=LAST_BITS)
            assert (grid[0][lane], grid[1][lane]) == pytest.approx((single.grid.R_g, single.grid.L_g), rel=LAST_BITS)


@pytest.mark.parametrize("ready", [TABLE, NOTHING])
def test_gains_of_the_start_are_those_of_single_runs(ready: Ready) -> None:
    study, spec = study_of(SPECIFIED, schedule="closed_form" if ready is NOTHING else "table")
    cases = random_cases(study, 4)
    for lane in range(4):
        one, told = of_lane(study, cases, lane), telling(study, spec, ready, cases.take(np.array([lane])))

        def gains_of(*at: Any, told: Telling = told) -> PowerLoopGains:
            return PowerLoopGains(*(float(gain[0]) for gain in told.first(*(np.array([value]) for value in at))))

        refs = study.converter.references(float(cases.P_ref[lane]), 0.0)
        _, gains = rest_with_measured_gains(one, one.grid, one.grid_source, refs, gains_of)
        expected = LateSchedule(one, spec, told_of(one, cases, lane), ready).first_gains()
        assert gains == pytest.approx(expected, rel=LAST_BITS)


@pytest.mark.parametrize("specified", [True, False])
def test_gains_at_the_design_point_are_known_beforehand(specified: bool) -> None:
    study, spec = study_of(SPECIFIED if specified else TEXT)
    spec = replace(spec, target=replace(spec.target, follow_references=False))
    cases = random_cases(study, 40)
    told = telling(study, spec, NOTHING, cases)
    T_s, every = study.converter.T_s, round(0.02 / study.converter.T_s)
    samples = round(DURATION_S / T_s)
    assert told.update_samples == 0
    changes, first = told.changes, told.first(cases.P_ref, cases.Q_ref, cases.V_g_rms)
    assert len(changes.lane) > 20
    for lane in range(len(cases)):
        one = of_lane(study, cases, lane)
        expected = {}
        if exact(cases, lane):
            listed = ListedGains(gain_changes(one, spec, build_timeline(one)), T_s)
            expected = {k: (one.gains, one.grid) for k, one in listed._at.items() if k < samples}
        else:
            single = LateSchedule(one, spec, told_of(one, cases, lane), safe=safe_grid(study, spec))
            expected = {0: (single.first_gains(), single.grid)}
            for sample in range(every, samples, every):
                window: Any = SimpleNamespace(t_s=sample * T_s, P=0.0, Q=0.0, V_rms=110.0, limited=0)
                gains = single.update(window)
                if gains is not None and single.grid != list(expected.values())[-1][1]:
                    expected[sample] = gains, single.grid
        found = {0: (tuple(gain[lane] for gain in first), tuple(value[lane] for value in told.estimate()))}
        for k in np.flatnonzero((changes.lane == lane) & (changes.sample < samples)):
            grid = changes.R_g[k], changes.L_g[k]
            if grid != list(found.values())[-1][1]:  # the same grid told again changes nothing
                found[int(changes.sample[k])] = tuple(gain[k] for gain in changes.gains), grid
        assert found == {k: (tuple(gains), grid and (grid.R_g, grid.L_g)) for k, (gains, grid) in expected.items()}


def test_fixed_gains_never_change() -> None:
    study = study_from_text(SPECIFIED)
    spec = study.controllers[1]
    cases = random_cases(study, 6)
    designed = telling(study, spec, NOTHING, cases)
    given = telling(study, replace(spec, gains=designed.first(*np.ones((3, 6)))._replace()), NOTHING, cases)
    assert (designed.update_samples, len(designed.changes.lane)) == (0, 0)
    assert designed.update(400, *np.ones((3, 6))) is None
    assert set(designed.estimate()[0]) == {study.grid.R_g}
    np.testing.assert_array_equal(given.estimate()[1], cases.L_g)


def at_the_end(told: Telling, count: int) -> np.ndarray[Any, Any]:
    P, Q, V_rms, _ = measured(np.random.default_rng(2), count)
    return np.stack(told.known_at_end()(P, Q, V_rms))


@pytest.mark.parametrize("ready", [TABLE, NOTHING])
def test_gains_at_the_end_are_those_that_updates_come_to(ready: Ready) -> None:
    study, spec = study_of(SPECIFIED, schedule="closed_form" if ready is NOTHING else "table")
    cases = random_cases(study, 20)
    told = telling(study, spec, ready, cases)
    P, Q, V_rms, _ = measured(np.random.default_rng(2), 20)
    told.first(P, Q, V_rms)
    found = None
    for sample in range(told.update_samples, round(6.0 / study.converter.T_s), told.update_samples):
        found = told.update(sample, P, Q, V_rms)
    assert found is not None
    # A table's place may lie 2 % beside its estimate (hysteresis).
    np.testing.assert_allclose(
        np.stack(found), at_the_end(told, 20), rtol=0.05 if ready is TABLE else 1e-12, atol=1e-12
    )


@pytest.mark.parametrize("ready", [TABLE, NOTHING])
def test_some_lanes_go_on_alone(ready: Ready) -> None:
    study, spec = study_of(SPECIFIED, schedule="closed_form" if ready is NOTHING else "table")
    cases, lanes = random_cases(study, 12), np.array([2, 3, 7])
    whole = telling(study, spec, ready, cases)
    inputs = measured(np.random.default_rng(3), 12)[:3]
    whole.first(*inputs)
    for sample in range(400, 8000, 400):
        whole.update(sample, *inputs)
    part = whole.take(lanes)
    for sample in range(8000, 24000, 400):
        expected, found = whole.update(sample, *inputs), part.update(sample, *(values[lanes] for values in inputs))
        assert expected is not None
        np.testing.assert_array_equal(np.stack(found or ()), np.stack(expected)[:, lanes])
        np.testing.assert_array_equal(part.estimate()[0], whole.estimate()[0][lanes])
    np.testing.assert_array_equal(at_the_end(part, 3).shape, (8, 3))


def test_what_is_told_nothing_says_so() -> None:
    study, spec = study_of(SPECIFIED, estimate="field")
    with pytest.raises(ValueError, match="learns its grid"):
        telling(study, spec, NOTHING, random_cases(study, 2))
    with pytest.raises(InfeasibleStudyError, match=r"update_period = 0.02001 s is not a whole multiple"):
        telling(study, replace(spec, estimate="truth", update_period=0.02001), NOTHING, random_cases(study, 2))
