"""The field estimator in the EMT: the same as in plain Python on an independent circuit, and nothing lent to it.

The tolerances are those of tests/simulation/test_emt_against_dop853.py for the states. The estimator's answers divide
small differences of its sums by one another, which costs some digits more.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.gain_tables import table
from tests.oracles.emt_reference import run_reference
from tests.simulation.studies import lc_study, lcl_study
from tests.simulation.test_emt_against_dop853 import COMPONENTS, RAMPS, TOLERANCE, errors_pu, library_start
from vsgdesign.artifacts.ready import Ready
from vsgdesign.codegen.records import numbers_of, record_like, zero_record
from vsgdesign.equations.field import FieldAnswer, FieldSettings, FieldTrack, LockIn, first_lock_in, first_track
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError, StudyError
from vsgdesign.identification.field import FieldEstimator, FieldState, estimate_of
from vsgdesign.identification.interface import Estimate, Samples
from vsgdesign.runtime.scheduler import scheduler_of
from vsgdesign.simulation import GainChange, HeldBack, Probe, Recorder, Simulation, simulate
from vsgdesign.simulation.field_feed import FieldScheduler, MeasuredCycle, settings_of_study
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import Grid, Study

FOLLOWING = """
[[controllers]]
name = "field"
kind = "scheduled"
estimate = "field"
structure = "published"
operating_point = "reference"
"""

STEPS = """
[[events]]
time = "20.012 ms"
grid = { scr = 6 }
[[events]]
time = "45 ms"
P_ref = "3 kW"
phase_jump = "4 deg"
"""

SAG = """
[[events]]
time = "21.003 ms"
V_g_pu = 0.4
[[events]]
time = "40 ms"
V_g_pu = 1.0
"""


class InPython:
    """The oracle's probe: the estimator in plain Python, one sample after another."""

    def __init__(self, settings: FieldSettings) -> None:
        self.estimator = FieldEstimator(settings)
        self.state: FieldState = self.estimator.first()
        self.answers: list[Estimate] = []

    def value(self) -> complex:
        return complex(self.estimator.probe(self.state).values[0])

    def hear(self, v: complex, i: complex, u: complex, theta: float, limited: bool) -> None:
        v_s, i_s = (np.array([[part.real], [part.imag]]) for part in (v, i))
        samples = Samples(v_s, i_s, np.nan, np.array([theta]), np.array([u]), int(limited))
        self.state, found = self.estimator.update(self.state, samples)
        if found is not None:
            self.answers.append(found)


def field_run(study: Study, bridge: str, *, probe: bool = True) -> tuple[Simulation, FieldScheduler]:
    feed = FieldScheduler(study, study.controllers[-1], probe=probe)
    return simulate(study, feed, bridge=bridge, log_states=10**9), feed


def difference_of_answers(feed: FieldScheduler, answers: list[Estimate]) -> float:
    """Largest difference of R_g, L_g and their covariance in any answer, each relative to its largest value."""
    estimates = [estimate_of(row.answer) for row in feed.rows]
    assert [one.status for one in estimates] == [one.status for one in answers]
    ours, theirs = (
        np.array([(*one[:2], *np.ravel(np.array(one.covariance))) for one in some]) for some in (estimates, answers)
    )
    return float(np.max(np.abs(ours - theirs) / np.maximum(np.abs(theirs).max(axis=0), 1e-30)))


@pytest.mark.parametrize(("build", "bridge"), [(lc_study, "averaged"), (lcl_study, "pwm")])
def test_the_run_is_that_of_an_independent_circuit(build, bridge: str) -> None:
    """Circuit by DOP853, control in complex numbers, probe and estimator in plain Python: the same samples, the same
    answers. Steps of grid, source and reference are included, and the LCL filter has a delay of one sample."""
    study = build("50 ms", STEPS + FOLLOWING)
    run, feed = field_run(study, bridge)
    prober = InPython(settings_of_study(study))
    start = library_start(study, [GainChange(0.0, feed.first())])
    reference = run_reference(study, run.gain_changes, bridge == "pwm", start, prober=prober)
    errors = errors_pu(study, run, reference)
    print(f"{bridge}: worst {max(errors.values()):.1e} pu; {errors}")
    assert max(errors.values()) < TOLERANCE
    assert len(prober.answers) == len(feed.rows) == 2
    assert len(run.gain_changes) == 3  # they follow what is measured, from cycle to cycle
    # The probe is there: without it the angle would not move by this.
    silent = simulate(study, run.gain_changes, bridge=bridge)
    assert np.abs(run.column("theta") - silent.column("theta")).max() > 1e-3


def test_no_probe_follows_a_limited_sample() -> None:
    """The oracle sends none there by the estimator's own rule, and hears of every limited sample."""
    limit = "[converter]\ncurrent_limit_pu = 1.2\n[grid]\nscr = 8\n"
    study = lc_study("60 ms", SAG + FOLLOWING, limit)
    run, feed = field_run(study, "averaged")
    prober = InPython(settings_of_study(study))
    start = library_start(study, [GainChange(0.0, feed.first())])
    reference = run_reference(study, run.gain_changes, False, start, prober=prober)
    assert reference.current_limited > 50
    assert max(errors_pu(study, run, reference).values()) < TOLERANCE
    assert max(row.answer.limited for row in feed.rows) > 0.1


@pytest.mark.parametrize("build", [lc_study, lcl_study])
def test_recorded_samples_give_the_same_answers_in_plain_python(build) -> None:
    """From the log of a run alone: v, i, the angle and what was sent. Half a second, with the first answers."""
    study = build("0.5 s", STEPS + FOLLOWING)
    run, feed = field_run(study, "pwm")
    prober, R_c = InPython(settings_of_study(study)), study.filter.R_c
    limited = np.diff(run.column("limited_samples"), prepend=0.0)
    for k, row in enumerate(run.log):
        i_s, v_c, i_g = (complex(*row[at : at + 2]) for at in (0, 2, 4))
        u = prober.value()
        prober.hear(v_c + R_c * (i_s - i_g), i_g, u, row[12], limited[k] > 0.0)
    print(f"answers: {difference_of_answers(feed, prober.answers):.1e}")
    assert difference_of_answers(feed, prober.answers) < 1e-9
    assert feed.rows[-1].answer.valid == 1.0


class Recording(FieldScheduler):
    """Keeps what the schedule was given of each cycle, and its gains."""

    def begin(self) -> FieldScheduler:
        self.given: list[tuple[MeasuredCycle, PowerLoopGains | None]] = []
        return super().begin()

    def _followed(self, answer: FieldAnswer, measured: MeasuredCycle) -> tuple[PowerLoopGains | None, bool]:
        found = super()._followed(answer, measured)
        self.given.append((measured, found[0]))
        return found


def test_a_scheduler_that_is_fed_by_hand_does_the_same() -> None:
    """A table's scheduler with the estimator in plain Python (push, update_pushed) gives the run's gains, through
    learning, a change of the grid and the doubt about it."""
    jump = '[[events]]\ntime = "0.3 s"\ngrid = { scr = 8 }\n'
    study = lc_study("0.55 s", jump + FOLLOWING)
    spec, made = replace(study.controllers[-1], schedule="table"), table()
    feed = Recording(study, spec, Ready(tables={spec.name: made}))
    run = simulate(study, feed, bridge="averaged")
    scheduler = scheduler_of(made, FieldEstimator(settings_of_study(study)))
    first = run.gain_changes[0].gains
    assert scheduler.hold(*_rest_powers(study, feed), 0).gains == pytest.approx(first, rel=1e-9)
    limited = np.diff(run.column("limited_samples"), prepend=0.0)
    worst, given = 0.0, iter(feed.given)
    for k, row in enumerate(run.log):
        i_s, v_c, i_g = row[0:2], row[2:4], row[4:6]
        assert scheduler.probe is not None
        u = complex(scheduler.probe.values[0])
        v = v_c + study.filter.R_c * (i_s - i_g)
        if scheduler.push(v, i_g, theta=row[12], sent=u, limited=limited[k] > 0.0):
            measured, gains = next(given)
            ticks = round(measured.t_s / scheduler.settings.tick)
            found = scheduler.update_pushed(measured.P, measured.Q, measured.V_rms, ticks)
            assert gains is not None
            worst = max(worst, float(np.max(np.abs(np.subtract(found.gains, gains)) / np.abs(gains))))
    print(f"gains: {worst:.1e}")
    assert worst < 1e-9
    assert len(feed.given) == len(feed.rows)
    assert {row.answer.doubt for row in feed.rows} == {0.0, 1.0}
    assert any(row.answer.changed > 0.5 for row in feed.rows)


def _rest_powers(study: Study, feed: FieldScheduler) -> tuple[float, float, float]:
    rest = library_start(study, [GainChange(0.0, feed.first())]).controller
    return rest.S_f.real, rest.S_f.imag, rest.V


@pytest.mark.parametrize("events", [RAMPS, COMPONENTS])
def test_stopping_for_a_cycle_changes_no_bit(events: str) -> None:
    """Without its probe the estimator never answers, and the run is that of the first gains to the last bit."""
    study = lc_study("0.1 s", events + FOLLOWING.replace('"reference"', '"design"'))
    run, feed = field_run(study, "pwm", probe=False)
    plain = simulate(study, [GainChange(0.0, feed.first(), feed.grid(0))], bridge="pwm", log_states=10**9)
    assert len(feed.rows) >= 4
    assert np.array_equal(run.log, plain.log)
    assert np.array_equal(run.controller_log, plain.controller_log)


def test_nothing_of_the_grid_is_lent() -> None:
    """The first gains are made for the middle of what the controller was designed for, wherever the run begins."""
    first = {}
    for scr in (2.0, 15.0):
        study = lc_study("60 ms", FOLLOWING, f"[grid]\nscr = {scr}\n")
        study = replace(study, grid=Grid(study.grid.R_g, study.grid.L_g))
        feed = FieldScheduler(study, study.controllers[-1])
        first[scr] = feed.grid(0)
        assert feed.grid(0) != study.grid
    assert first[2.0] == first[15.0]


def test_what_is_no_grid_is_not_followed() -> None:
    """A valid answer with a negative inductance leaves the gains alone; one beyond the range is clipped to it."""
    study = lc_study("40 ms", FOLLOWING)
    _, feed = field_run(study, "averaged")
    answer, at = feed.rows[-1].answer._replace(valid=1.0), MeasuredCycle(0.04, 2e3, 500.0, 110.0, 0)
    before = feed.grid(0)
    for R_g, L_g in ((1.0, -1e-3), (-2.0, 1e-3), (math.nan, 1e-3)):
        assert feed._followed(answer._replace(R_g=R_g, L_g=L_g), at) == (None, False)
        assert feed.grid(0) == before
    feed._followed(answer._replace(R_g=0.01, L_g=1e-5), at)  # SCR 600
    assert feed.grid(0).scr(study.converter, "impedance") == pytest.approx(25.0)


def test_a_second_run_starts_afresh() -> None:
    study = lc_study("0.3 s", FOLLOWING)
    run, feed = field_run(study, "averaged")
    answers = [row.answer for row in feed.rows]
    again = simulate(study, feed, bridge="averaged")
    assert np.array_equal(run.log, again.log)
    assert [row.answer for row in feed.rows] == answers


def test_records_keep_their_numbers_in_an_array() -> None:
    settings = settings_of_study(lcl_study("20 ms"))
    for record, kind in ((first_lock_in(settings, 314.0), LockIn), (first_track(settings), FieldTrack)):
        values = numbers_of(record)
        assert record_like(zero_record(kind), iter(values)) == record
        assert numbers_of(zero_record(kind)) == [0.0] * len(values)


def test_a_study_can_ask_for_it() -> None:
    study = lc_study("0.6 s", FOLLOWING, log="1 ms")
    result = run_scenario(study).controllers[-1]
    log = result.estimates
    assert log is not None
    assert log.cycles is not None
    ok = np.array(log.status) == "ok"
    assert ok[-10:].all()
    error = np.hypot(log.R_g_hat - log.R_g, 314.159 * (log.L_g_hat - log.L_g)) / np.hypot(log.R_g, 314.159 * log.L_g)
    assert error[-10:].max() < 0.02
    assert {"cov_RL", "valid", "doubt", "mode", "amplitude"} <= set(log.series())


def test_another_probe_is_refused() -> None:
    study = lc_study("40 ms", FOLLOWING)
    with pytest.raises(InfeasibleStudyError, match="sends its own"):
        simulate(study, FieldScheduler(study, study.controllers[-1]), probe=Probe(np.zeros(1, dtype=complex), 1e-3))


@pytest.mark.parametrize("wrapped", [HeldBack, Recorder])
def test_what_counts_windows_says_that_there_are_none(wrapped: type[HeldBack | Recorder]) -> None:
    study = lc_study("40 ms", FOLLOWING)
    feed: Any = FieldScheduler(study, study.controllers[-1])
    with pytest.raises(TypeError, match="cycles of its own"):
        wrapped(feed)


def test_update_period_is_refused() -> None:
    with pytest.raises(StudyError, match="update_period"):
        lc_study("0.1 s", FOLLOWING + 'update_period = "20 ms"\n')
