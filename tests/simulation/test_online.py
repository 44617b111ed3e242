"""Gains decided during the run: the same traces as from a list, windows that hold what was measured, timing."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from tests.simulation.studies import FAST_GAINS, GAINS, lc_study, lcl_study
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation import (
    FixedGains,
    GainChange,
    HeldBack,
    MeasuredWindow,
    Recorder,
    build_timeline,
    simulate,
)
from vsgdesign.simulation.feeds import LateSchedule
from vsgdesign.simulation.following import MeasuredPowers
from vsgdesign.simulation.scenario import derive_series
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.grid import Grid

EVENTS = """
[[events]]
time = "23.113 ms"
phase_jump = "5 deg"
[[events]]
time = "47 ms"
grid = { scr = 8, x_over_r = 1 }
[[events]]
time = "60 ms"
P_ref = "2.5 kW"
f_g = "50.2 Hz"
"""
DAMPED = GAINS._replace(k_P=2e-4, k_Q=1e-4)
"""Gains with which ω is not the integrator alone."""


@dataclass
class Scripted:
    """Answers by window index; None elsewhere."""

    answers: dict[int, PowerLoopGains]
    first: PowerLoopGains = GAINS
    update_period: float = 20e-3
    sample_interval: float = 200e-6
    seen: list[float] = field(default_factory=list)

    def first_gains(self) -> PowerLoopGains:
        return self.first

    def update(self, window: MeasuredWindow) -> PowerLoopGains | None:
        self.seen.append(window.t_s)
        return self.answers.get(window.index)


def study_of(kind: str, log: str = "50 us", duration: str = "0.1 s") -> Study:
    return (lc_study if kind == "lc" else lcl_study)(duration, EVENTS, log=log)


@pytest.mark.parametrize("kind", ["lc", "lcl"])
@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_the_same_gains_at_the_same_instants_give_the_same_bits(kind: str, bridge: str) -> None:
    study = study_of(kind)
    # A list with an entry at every update cuts time at the same samples; the gains are those of two answers.
    held = [GAINS, GAINS, FAST_GAINS, DAMPED, DAMPED]
    listed = simulate(study, [GainChange(20e-3 * k, gains) for k, gains in enumerate(held)], bridge=bridge)
    online = simulate(study, Scripted({1: FAST_GAINS, 2: DAMPED, 3: DAMPED}), bridge=bridge)
    assert online.log.tobytes() == listed.log.tobytes()
    assert tuple(online.final_state) == tuple(listed.final_state)
    assert online.final_plant.tobytes() == listed.final_plant.tobytes()
    assert [(round(c.t_s, 9), c.gains) for c in online.gain_changes] == [
        (0.0, GAINS),
        (0.04, FAST_GAINS),
        (0.06, DAMPED),
    ]


class Asked(LateSchedule):
    """Counts its updates, all of which may answer something new if ``always``."""

    def __init__(self, *of: Any, always: bool, **more: Any) -> None:
        super().__init__(*of, **more)
        self.always, self.updates = always, 0

    @property
    def answers_after(self) -> tuple[float, ...] | None:
        return None if self.always else super().answers_after

    def update(self, window: MeasuredPowers) -> PowerLoopGains | None:
        self.updates += 1
        return super().update(window)


def test_a_schedule_is_asked_only_where_it_can_answer_anything_new() -> None:
    """It is told nothing from 30 ms on, is stale after 0.1 s, and is told another grid at 0.1799 s. The source's ramp
    keeps every update, and the bits stay those of a run that asks at every update."""
    ramp = '[[events]]\ntime = "0.31 s"\nf_g = "50.3 Hz"\nover = "0.1 s"\n'
    study = lc_study("1 s", EVENTS + ramp)
    spec = replace(study.controllers[0], kind="scheduled", gains=None)
    told = ((0.0, Grid(1.0, 8e-3)), (0.03, None), (0.1799, Grid(2.0, 6e-3)))
    runs = {}
    for always in (True, False):
        feed = Asked(study, spec, told, safe=Grid(1.0, 4e-3), stale_s=0.1, always=always)
        runs[always] = simulate(study, feed), feed.updates
    (every, of_every), (few, of_few) = runs[True], runs[False]
    assert few.log.tobytes() == every.log.tobytes()
    assert few.gain_changes == every.gain_changes
    assert len(few.gain_changes) >= 3
    assert of_every == 49
    assert 5 <= of_few <= 20


@pytest.mark.parametrize("kind", ["lc", "lcl"])
@pytest.mark.parametrize("log", ["50 us", "350 us", "2 ms"])
def test_a_window_holds_the_waveforms_at_the_pcc(kind: str, log: str) -> None:
    """Also across a change of grid inside a window, and whatever is logged."""
    recorder = Recorder(FixedGains(GAINS))
    simulate(study_of(kind, log), recorder)
    assert [w.index for w in recorder.windows] == [0, 1, 2, 3, 4]
    fine = study_of(kind)
    series = derive_series(fine, simulate(fine, Recorder(FixedGains(GAINS))))
    for window in recorder.windows:
        rows = slice(400 * window.index, 400 * window.index + 400, 4)
        assert window.v_pcc.shape == window.i_pcc.shape == (100, 2)
        np.testing.assert_allclose(window.v_pcc[:, 0], series["v_pcc_a"][rows], rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(window.i_pcc[:, 0], series["i_pcc_a"][rows], rtol=0.0, atol=1e-10)
        across = (series["v_pcc_b"] - series["v_pcc_c"])[rows] / 3.0**0.5
        np.testing.assert_allclose(window.v_pcc[:, 1], across, rtol=0.0, atol=1e-10)


def test_a_window_holds_the_controllers_own_quantities() -> None:
    """P, Q, V and the integrator as they stand at the sample at which the answer acts; ω with the damping."""
    study = lc_study("0.1 s", EVENTS, sections='[power_loops]\ntau_P = "5 ms"\ntau_Q = "5 ms"')
    recorder = Recorder(Scripted({}, first=DAMPED))
    run = simulate(study, recorder, log_states=10**9)
    timeline = build_timeline(study)
    assert len(recorder.windows) == 5
    for window in recorder.windows[:-1]:
        k = 400 * (window.index + 1)
        theta, omega_i, V, P_f, Q_f = run.controller_log[k, :5]
        assert (window.P, window.Q, window.V_rms) == (P_f, Q_f, V)
        expected = omega_i - DAMPED.k_P * P_f - DAMPED.k_Q * (Q_f + DAMPED.D_q * V)
        assert window.omega == pytest.approx(expected, rel=1e-14)
        assert window.t_s == pytest.approx(k * 50e-6, rel=1e-12)
        np.testing.assert_array_equal(window.theta, run.controller_log[k - 400 : k : 4, 0])
        assert theta != window.theta[-1]
        assert window.source_phase == pytest.approx(float(timeline.source_phase(np.array([window.t_s - 0.02]))[0]))
        assert window.refs.P_ref == timeline.references_at(window.t_s)[0]


def test_an_answer_held_back_acts_at_the_end_of_the_next_window() -> None:
    run = simulate(study_of("lc"), HeldBack(Scripted({0: FAST_GAINS, 2: DAMPED})))
    assert [(round(c.t_s, 9), c.gains) for c in run.gain_changes] == [(0.0, GAINS), (0.04, FAST_GAINS), (0.08, DAMPED)]


def test_no_answer_and_the_same_answer_change_nothing() -> None:
    study = study_of("lc")
    silent, repeating = Scripted({}), Scripted(dict.fromkeys(range(5), GAINS._replace()))
    a, b = simulate(study, silent), simulate(study, repeating)
    assert a.gain_changes == b.gain_changes == (GainChange(0.0, GAINS),)
    assert a.log.tobytes() == b.log.tobytes()
    # The window that ends with the run is measured too.
    np.testing.assert_allclose(silent.seen, [0.02, 0.04, 0.06, 0.08, 0.1], rtol=1e-12)


def test_a_recorder_forgets_the_run_before() -> None:
    recorder = Recorder(HeldBack(Scripted({0: FAST_GAINS}), windows=2))
    for _ in range(2):
        simulate(study_of("lc"), recorder)
        assert recorder.answers == [None, None, FAST_GAINS, None, None]


def test_what_is_logged_does_not_depend_on_the_windows_samples() -> None:
    coarse, fine = (simulate(study_of("lc", log), Scripted({})) for log in ("350 us", "50 us"))
    assert coarse.log.tobytes() == fine.log[::7].tobytes()
    np.testing.assert_allclose(coarse.t_s, fine.t_s[::7], rtol=1e-14)


@pytest.mark.parametrize(
    ("period", "interval", "named"),
    [
        (20e-3, 70e-6, "sample_interval"),
        (20.1e-3, 200e-6, "update_period"),
        (0.0, 200e-6, "update_period"),
        (20e-3, -200e-6, "sample_interval"),
        (float("nan"), 200e-6, "update_period"),
        (20e-3, float("inf"), "sample_interval"),
    ],
)
def test_times_that_do_not_fit_the_sampling_are_refused(period: float, interval: float, named: str) -> None:
    with pytest.raises(InfeasibleStudyError, match=f"{named} = .* is not a whole multiple of"):
        simulate(study_of("lc"), FixedGains(GAINS, period, interval))


def test_a_scheduler_may_stop_the_run() -> None:
    class Stops(Scripted):
        def update(self, window: MeasuredWindow) -> PowerLoopGains | None:
            super().update(window)
            raise KeyboardInterrupt

    stops = Stops({})
    with pytest.raises(KeyboardInterrupt):
        simulate(study_of("lc"), stops)
    assert len(stops.seen) == 1
