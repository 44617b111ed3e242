"""The twin of a step: the same run without the step, with the same noise, probe and gains."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vsgdesign.artifacts.ready import Ready
from vsgdesign.simulation.every_sample import with_every_sample
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.gains import GainChange
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.simulation.twin import steps_with_twin
from vsgdesign.study.parameters import study_from_text
from vsgdesign.study.parameters.study import Study

STEP_S = 0.71003  # between two samples
STUDY = """
base = "case:hoang2025_5kva"
converter = { current_limit_pu = 1.2, current_limiter = "projection" }
simulation = { duration = "1.4 s", bridge = "BRIDGE", P_ref = "2 kW", Q_ref = "0.5 kvar" }
background = { level = "measured", seed = 3, voltage_factor = 1.0 }
sensors = { level = "typical", seed = 3 }
grid = { scr_basis = "impedance", scr = 6, x_over_r = 2 }
inner_loops = { transient_resistance_pu = 0.08 }
power_loops = { structure = "angle_damped", P_droop = "5 %", Q_droop = "5 %", settling_time = "0.3 s" }
controllers = [
    { name = "field", kind = "scheduled", estimate = "field" },
    { name = "known", kind = "scheduled", update_period = "20 ms" },
]
events = [
    { time = "0.3 s", grid = { scr = 8 } },
    { time = "0.71003 s", P_ref = "2.6 kW" },
    { time = "1.3 s", Q_ref = "0.6 kvar", grid = { scr = 7 } },
]
"""


class Noted(FieldScheduler):
    """Notes what it sends, its gains and the grid that the limiter is told, cycle by cycle."""

    def begin(self) -> FieldScheduler:
        super().begin()
        self.tape: list[Any] = []
        return self

    def conclude(self, sample: int, present: Any, state: Any) -> Any:
        gains = super().conclude(sample, present, state)
        self.tape.append((sample, self._memory.lock_in, gains, super().grid(sample)))
        return gains


SENT = ("phi", "omega", "half_re", "half_im", "step_less_one", "step_im", "a_1", "a_2")


class Played(FieldScheduler):
    """Listens as any other, and does what is on a tape."""

    def play(self, main: Noted) -> Played:
        self._tape, self._told, self._first = iter(main.tape), None, main._first
        return self

    def grid(self, sample: int) -> Any:
        told = getattr(self, "_told", None)
        return super().grid(sample) if told is None else told

    def conclude(self, sample: int, present: Any, state: Any) -> Any:  # noqa: ARG002 - as it is called
        self._memory.conclude()
        at, lock, gains, self._told = next(self._tape)
        assert at == sample
        names = [name for name, value in zip(*_flat(lock), strict=True)]
        numbers = dict(zip(names, self._memory.lock.tolist(), strict=True))
        numbers |= {name: getattr(lock, name) for name in SENT}
        self._memory.lock[:] = list(numbers.values())
        if gains != present:
            self.changes.append(GainChange(0.0, gains, self._told))
        return gains


def _flat(record: Any, head: str = "") -> tuple[list[str], list[float]]:
    names, values = [], []
    for name, value in record._asdict().items():
        if isinstance(value, tuple):
            more = _flat(value, f"{name}.")
            names, values = names + more[0], values + more[1]
        else:
            names, values = [*names, f"{head}{name}"], [*values, value]
    return names, values


def study_of(bridge: str, controller: str) -> Study:
    study = study_from_text(STUDY.replace("BRIDGE", bridge))
    spec = next(one for one in study.controllers if one.name == controller)
    return with_every_sample(replace(study, controllers=(spec,)).with_limit_of(spec))


def without_the_step(study: Study) -> Study:
    """The event sets P_ref to what it is. It stays where it is, because the loop takes up the phase of the source anew
    at every event, which moves the last bit."""
    events = (replace(one, P_ref=2e3) if one.t_s == STEP_S else one for one in study.events)
    return replace(study, events=tuple(events))


def main_run(study: Study) -> Simulation:
    (spec,) = study.controllers
    assert steps_with_twin(study, spec) == (STEP_S,)  # at 1.3 s the grid changes, too
    return simulate(study, feed_of(study, spec, build_timeline(study), Ready()), twins=(STEP_S,))


def same(run: Simulation, other: Simulation) -> None:
    """A run's twin is another run of its own, and both are the same before the step."""
    (twin,), first = run.twins, int(np.searchsorted(run.t_s, STEP_S))
    rows = slice(first, first + len(twin.t_s))
    assert (twin.event_s, len(twin.t_s)) == (STEP_S, round(1.3 / 5e-5) - first)
    np.testing.assert_array_equal(twin.t_s, run.t_s[rows])
    np.testing.assert_array_equal(twin.log, other.log[rows])
    np.testing.assert_array_equal(run.log[:first], other.log[:first])
    assert np.abs(run.column("P")[rows] - twin.log[:, 8]).max() > 500.0  # the step itself


@pytest.mark.parametrize("bridge", ["averaged", "pwm"])
def test_the_twin_is_the_run_without_the_step_and_with_the_tape(bridge: str) -> None:
    """Beside a field estimator: the probe, the gains and the told grid of the main run, to the bit."""
    study = study_of(bridge, "field")
    (spec,) = study.controllers
    noted = Noted(study, spec)
    run = simulate(study, noted, twins=(STEP_S,))
    less = without_the_step(study)
    same(run, simulate(less, Played(less, spec).play(noted)))
    assert len({gains for _, _, gains, _ in noted.tape}) > 20  # gains that move


def test_gains_that_follow_what_is_measured_are_those_of_the_main_run() -> None:
    run = main_run(study := study_of("averaged", "known"))
    assert len(run.gain_changes) > 20
    same(run, simulate(without_the_step(study), run.gain_changes))


def test_a_record_is_played_to_both(tmp_path: Path) -> None:
    """A recorded voltage that is not symmetrical: no power rests in it."""
    t_s = np.arange(16_000) / 10_000.0
    x = 2.0 * np.pi * 50.03 * t_s - 2.0 * np.pi / 3.0 * np.arange(3)[:, None]
    np.savez(tmp_path / "grid.npz", v=(np.cos(x) * np.array([[1.0], [0.98], [1.0]])).T, sampling_rate=1e4)
    text = STUDY.replace('background = { level = "measured", seed = 3, voltage_factor = 1.0 }\n', "")
    text = text.replace(
        'sensors = { level = "typical", seed = 3 }', f'replay = {{ file = "{tmp_path}/grid.npz", scale = "rated" }}'
    )
    study = study_from_text(text.replace("BRIDGE", "averaged"))
    study = with_every_sample(replace(study, controllers=study.controllers[1:]))
    assert study.sensors is None
    run = main_run(study)
    same(run, simulate(without_the_step(study), run.gain_changes))


def test_without_noise_there_is_no_twin() -> None:
    study = study_of("averaged", "known")
    (spec,) = study.controllers
    clean = replace(study, background=None, sensors=None)
    still = {"frequency_wander": 0.0, "voltage_wander": 0.0, "phase_noise": 0.0, "voltage_noise": 0.0}
    assert study.background is not None
    harmonics = replace(study.background, **still, voltage_steps_per_minute=0.0)
    assert steps_with_twin(clean, spec) == ()
    assert steps_with_twin(replace(clean, background=harmonics), spec) == ()
    assert steps_with_twin(replace(clean, background=study.background), spec) == (STEP_S,)
    assert steps_with_twin(replace(clean, sensors=study.sensors), spec) == (STEP_S,)
    assert steps_with_twin(clean, study_of("averaged", "field").controllers[0]) == (STEP_S,)  # its probe
    assert steps_with_twin(clean, spec, probes=True) == (STEP_S,)
    (events,) = (one.events for one in run_scenario(clean).controllers)
    assert all(event.noise is None for event in events)


def test_a_scenario_judges_its_steps_beside_their_twins() -> None:
    """In a grid that wanders by some watts a step of 600 W has the figures that it has in one that does not."""
    noisy = study_of("averaged", "known")
    (controller,) = run_scenario(noisy).controllers
    clean = replace(noisy, background=None, sensors=None)
    (expected,) = run_scenario(clean).controllers
    ours, theirs = (
        next(event for event in one.events if (event.t_s, event.signal) == (STEP_S, "P_pcc"))
        for one in (controller, expected)
    )
    assert ours.noise is not None
    assert ours.noise.judgeable
    assert ours.noise.rest > 2.0 * ours.noise.left
    assert ours.cycle_mean.settling_time_s == pytest.approx(theirs.cycle_mean.settling_time_s, abs=0.03)
    assert abs(ours.noise.step / 600.0 - 1.0) < 0.01
    assert ours.drift == 0.0
    others = [event for event in controller.events if event.t_s != STEP_S]
    assert others
    assert not any(event.noise is not None and event.noise.twin for event in others)
    # The curve that is drawn: the difference of the means from the run without the step.
    drawn = controller.means["P_pcc"] - controller.without[STEP_S]["P_pcc"]
    before = controller.series["t_s"] < STEP_S
    np.testing.assert_allclose(drawn[before], 0.0, atol=1e-6)
    assert drawn[controller.series["t_s"] < 1.3][-1] == pytest.approx(ours.noise.step, rel=0.02)


def test_a_change_of_a_grid_that_wanders_cannot_be_judged() -> None:
    """The rest of Q after a change of the grid moves by more than its band, which a run in a still grid does not."""
    noisy = replace(study_of("averaged", "known"), events=study_of("averaged", "known").events[:1])
    noisy = replace(noisy, simulation=replace(noisy.simulation, duration=2.3))
    (moves,), (rests,) = (
        run_scenario(one).controllers for one in (noisy, replace(noisy, background=None, sensors=None))
    )
    Q, expected = (one.events[1] for one in (moves, rests))
    assert (Q.signal, Q.lost_in_noise, Q.cycle_mean.settling_time_s) == ("Q_pcc", True, None)
    assert Q.noise is not None
    late = moves.means["Q_pcc"][moves.series["t_s"] > 1.3]
    assert Q.noise.rest == pytest.approx(float(np.std(late)), rel=0.05)
    assert 4.5 * Q.noise.rest > 0.02 * noisy.converter.S_rated
    assert (expected.noise, expected.lost_in_noise) == (None, False)
