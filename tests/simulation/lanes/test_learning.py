"""Controllers that learn their grids, many at once: against one run after the other."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.gain_tables import table
from tests.simulation.lanes.alone import run_alone
from tests.simulation.survival.subjects import TEXT
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.field import FieldAnswer
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.lanes.around import Around
from vsgdesign.simulation.lanes.cases import DISTURBANCE, REACTIVE, STEP, LaneCases, no_events
from vsgdesign.simulation.lanes.learning import Learning
from vsgdesign.simulation.lanes.results import JUDGED
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.study import ControllerSpec, Study

AROUND = """
[background]
level = "measured"
frequency_wander = "0 Hz"
frequency_deviation = "0 Hz"
voltage_wander = 0
voltage_deviation = 0
phase_noise = "0 rad"
voltage_noise = 0
voltage_steps_per_minute = 0
[sensors]
level = "typical"
"""
"""The background that is measured, without what wanders, and usual sensors."""

WANDERING = '[background]\nlevel = "measured"\n[sensors]\nlevel = "typical"\n'

FIELD = TEXT.replace('kind = "scheduled"', 'kind = "scheduled"\nestimate = "field"\nsettling_time = 0.3', 1)
TABLE = Ready(tables={"scheduled": table(time_scale=0.3, specification={"settling_time": 0.3})})
LAST_BITS = 1e-10
"""A batch compiles the scheduler; the logarithm and the like of machine code differ from NumPy's in the last bit."""


def field_study(schedule: str, estimate: str = "field", text: str = FIELD) -> tuple[Study, ControllerSpec]:
    study = study_from_text(text)
    spec = replace(study.controllers[0], schedule=schedule, estimate=estimate)
    return replace(study, controllers=(spec,)), spec


def cases() -> LaneCases:
    """Steps, a jump of the grid, a sag in which the limiter acts, and a ramp; each on a frequency of its own, so that
    the cycles of the estimators end at different samples."""
    count = 5
    events, zeros = no_events(count, 2), np.zeros(count)
    c = study_from_text(FIELD).converter
    events.t_s[:, 0] = 0.5 + 0.0037 * np.arange(count)
    events.P_ref[0, 0], events.Q_ref[1, 0] = 3e3, 800.0
    events.R_g[2, 0], events.L_g[2, 0], events.phase_jump[2, 0] = 0.6, 1.2e-3, 0.2
    events.t_s[3, 1], events.V_g_rms[3] = 0.62123, [0.35 * c.V_rated_rms, c.V_rated_rms]
    events.omega_g[4, 0], events.over[4, 0] = 1.004 * c.omega_n, 0.2
    return LaneCases(
        R_g=np.array([0.3, 0.5, 0.3, 0.4, 0.8]),
        L_g=np.array([1.8e-3, 3e-3, 2.5e-3, 2e-3, 1e-3]),
        V_g_rms=zeros + c.V_rated_rms,
        omega_g=c.omega_n * np.array([1.0, 1.002, 0.997, 1.001, 0.999]),
        P_ref=zeros + 1e3,
        Q_ref=zeros,
        events=events,
        error_R=zeros,
        error_X=zeros,
        silent_s=zeros,
        cleared_s=np.nanmax(np.where(np.isfinite(events.t_s), events.t_s + events.over, np.nan), axis=1),
        kind=np.array([STEP, STEP, DISTURBANCE, DISTURBANCE, DISTURBANCE], dtype=np.int8),
        signal=np.array([0, REACTIVE, 0, 0, 0], dtype=np.int8),
    )


@pytest.mark.parametrize(
    ("schedule", "estimate", "ready"),
    [("closed_form", "field", NOTHING), ("table", "field_network", TABLE)],
)
def test_lanes_are_single_runs(schedule: str, estimate: str, ready: Ready) -> None:
    study, spec = field_study(schedule, estimate)
    drawn = cases()
    alone, lanes = run_alone(study, spec, ready, drawn), run_lanes(study, spec, ready, drawn)
    np.testing.assert_array_equal(lanes.status, alone.status)
    for f in fields(alone):
        one, other = getattr(alone, f.name), getattr(lanes, f.name)
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-9, err_msg=f.name)
    assert lanes.limited_s[3] > 0.01
    assert np.isfinite(lanes.overshoot[:2]).all()
    assert np.isfinite(lanes.swing_rad[2:]).all()


def test_a_lane_waits_for_its_place_on_the_carrier() -> None:
    """With a switched bridge and two samples in a carrier's period; the events of one lane fall inside an interval."""
    study, spec = field_study("closed_form")
    drawn = cases().take(np.array([2, 3]))
    alone = run_alone(study, spec, NOTHING, drawn, bridge="pwm")
    lanes = run_lanes(study, spec, NOTHING, drawn, bridge="pwm")
    for name in ("recovery_s", "swing_rad", "first_peak_pu", "peak_pu", "limited_s"):
        one, other = getattr(alone, name), getattr(lanes, name)
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-9, err_msg=name)
    assert (lanes.status == JUDGED).all()


@pytest.mark.parametrize(("around", "chosen"), [(AROUND, [0, 4]), (WANDERING, [2])], ids=["distorted", "wandering"])
def test_each_lane_has_a_background_and_sensors_of_its_own(around: str, chosen: list[int]) -> None:
    """A step and a ramp in distorted grids, and a jump of the grid in one that wanders, measured by sensors with
    errors, noise and bits, each with a draw of its own."""
    study, spec = field_study("closed_form", text=FIELD + around)
    drawn = cases().take(np.array(chosen))
    own = replace(drawn, around=Around.drawn(study, range(5, 5 + len(chosen))).neutral)
    alone, lanes = run_alone(study, spec, NOTHING, own), run_lanes(study, spec, NOTHING, own)
    np.testing.assert_array_equal(lanes.status, alone.status)
    for name in ("overshoot", "settling_s", "recovery_s", "swing_rad", "first_peak_pu", "peak_pu", "limited_s"):
        one, other = getattr(alone, name), getattr(lanes, name)
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-9, err_msg=name)
    one_for_all = run_lanes(study, spec, NOTHING, drawn.take(np.array([0])))
    assert one_for_all.peak_pu[0] != lanes.peak_pu[0]


def test_steps_in_other_groups_have_the_same_bits() -> None:
    """Steps go alone before their events and beside their twins behind them, so that groups are made anew in a run."""
    study, spec = field_study("closed_form", text=FIELD + AROUND)
    drawn = cases().take(np.arange(11) % 2)
    drawn = replace(drawn, around=Around.drawn(study, range(11)).neutral, omega_g=drawn.omega_g + 0.1 * np.arange(11))
    together = run_lanes(study, spec, NOTHING, drawn)
    assert np.isfinite(together.settling_s).all()
    assert len(set(together.noise)) == 11
    for some in (np.arange(3), np.arange(3, 11)):
        apart = run_lanes(study, spec, NOTHING, drawn.take(some))
        for f in fields(apart):
            assert getattr(apart, f.name).tobytes() == getattr(together, f.name)[some].tobytes(), f.name


def test_all_lanes_play_one_record(tmp_path: Path) -> None:
    """A jump of the grid while a recorded voltage with harmonics is played."""
    t_s = np.arange(30_000) / 10_000.0
    x = 2.0 * np.pi * 50.03 * t_s - 2.0 * np.pi / 3.0 * np.arange(3)[:, None]
    np.savez(tmp_path / "grid.npz", v=(np.cos(x) + 0.02 * np.cos(7.0 * x)).T, sampling_rate=1e4)
    study, spec = field_study("closed_form", text=f'{FIELD}[replay]\nfile = "{tmp_path}/grid.npz"\nscale = "rated"\n')
    drawn = cases().take(np.array([2]))
    drawn.events.phase_jump[:] = 0.0
    assert study.replay is not None
    own = drawn.in_study(study)
    assert (own.V_g_rms[0], own.omega_g[0]) == (study.replay.V_g_rms, study.replay.omega_g)
    alone, lanes = run_alone(study, spec, NOTHING, own), run_lanes(study, spec, NOTHING, drawn)
    assert lanes.status[0] == alone.status[0] == JUDGED
    for name in ("recovery_s", "swing_rad", "first_peak_pu", "peak_pu", "limited_s"):
        assert getattr(lanes, name)[0] == pytest.approx(getattr(alone, name)[0], abs=1e-9), name
    with pytest.raises(InfeasibleStudyError, match="leave the source alone"):
        run_lanes(study, spec, NOTHING, cases().take(np.array([3])))
    with pytest.raises(InfeasibleStudyError, match="a case needs"):
        run_lanes(study, spec, NOTHING, drawn.later(2.0))


def random_answers(rng: np.random.Generator, count: int) -> FieldAnswer:
    """Answers of every kind: good, in doubt, spoilt, impossible, and far outside the box."""
    R_g, L_g = rng.uniform(-0.3, 2.0, count), rng.uniform(-1e-3, 12e-3, count)
    shares = {"valid": 0.8, "changed": 0.1, "event": 0.1, "doubt": 0.2, "spoilt": 0.1, "limited": 0.1}
    flags = {name: (rng.random(count) < share).astype(float) for name, share in shares.items()}
    sigma_R, sigma_L = np.abs(rng.normal(0.0, 0.1, count)), np.abs(rng.normal(0.0, 4e-4, count))
    return FieldAnswer(
        R_g=R_g, L_g=L_g, var_R=sigma_R**2, cov_RL=0.3 * sigma_R * sigma_L, var_L=sigma_L**2, sigma=sigma_R,
        mode=np.ones(count), amplitude=np.zeros(count), foreign=np.zeros(count), passive=np.ones(count), **flags,
    )  # fmt: skip


@pytest.mark.parametrize(("schedule", "ready"), [("closed_form", NOTHING), ("table", TABLE)])
def test_answers_are_followed_as_in_a_single_run(schedule: str, ready: Ready, monkeypatch: Any) -> None:
    """Gains and grids cycle by cycle, for the same answers, to the bit."""
    study, spec = field_study(schedule)
    rng, count = np.random.default_rng(4), 12
    learning = Learning(study, spec, ready, count)
    singles = [FieldScheduler(study, spec, ready) for _ in range(count)]
    start = np.full(count, study.simulation.P_ref), np.zeros(count), np.full(count, study.converter.V_rated_rms)
    learning.first(*start)
    learning.start_with(type(singles[0].first())(*(np.full(count, value) for value in singles[0].first())))
    samples, present = np.zeros(count, dtype=np.int64), [one.first() for one in singles]
    for _ in range(120):
        samples = samples + rng.integers(395, 405, count)
        said = random_answers(rng, count)
        P, Q, V_rms = rng.uniform(-4e3, 4e3, count), rng.uniform(-1e3, 1e3, count), rng.uniform(100.0, 120.0, count)
        gains, grid = learning.update(said, samples, P, Q, V_rms), learning.estimate()
        for lane, one in enumerate(singles):
            own = FieldAnswer(*(float(values[lane]) for values in said))
            monkeypatch.setattr(one, "concluded", lambda own=own: own)
            state: Any = type("State", (), {"P_f": float(P[lane]), "Q_f": float(Q[lane]), "V": float(V_rms[lane])})
            present[lane] = one.conclude(int(samples[lane]), present[lane], state)
            assert tuple(gain[lane] for gain in gains) == pytest.approx(tuple(present[lane]), rel=LAST_BITS)
            assert (grid[0][lane], grid[1][lane]) == pytest.approx((one.grid(0).R_g, one.grid(0).L_g), rel=LAST_BITS)
