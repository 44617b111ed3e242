"""Field estimators of the units of a plant, against the run of one converter and against what a unit sees alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.equations.field import FieldAnswer
from vsgdesign.metrics import answers as metrics
from vsgdesign.simulation import simulate
from vsgdesign.simulation.estimated import EstimateLog
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.simulation.units import plant_timeline, simulate_plant
from vsgdesign.simulation.units.runs_again import twins_of
from vsgdesign.simulation.units.scenario import PlantResult, run_plant
from vsgdesign.simulation.units.unit_result import signals_of
from vsgdesign.simulation.units.windows import Tape
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.grid import Grid

STUDY = """
base = "case:lab_12kva_lcl"
grid = {{ scr = 6, x_over_r = 4 }}
simulation = {{ duration = "{duration}", P_ref = "5 kW", Q_ref = "0 var" }}
sensors = {{ level = "typical", seed = 3 }}
background = {{ level = "clean", harmonic_5 = "2 %", harmonic_7 = "1.5 %", negative_sequence = "1 %" }}
controllers = [{{ name = "field", kind = "scheduled", estimate = "field" }}]
{more}
"""


def study_with(more: str = "", duration: str = "1 s") -> Study:
    return study_from_text(STUDY.format(duration=duration, more=more))


def answers_of(log: EstimateLog | None) -> FieldAnswer:
    assert log is not None
    assert log.cycles is not None
    return log.cycles


@cache
def plant(units: int, pairs: tuple[int, ...] = (), more: str = "", duration: str = "1.6 s") -> PlantResult:
    """A plant, whose units may be given pairs that no study may have."""
    study = study_with(f"plant = {{ units = {units}, reactance = 0.06, resistance = 0.01 }}\n{more}", duration)
    assert study.plant is not None
    own = pairs or tuple(one.pair for one in study.plant.units)
    some = tuple(replace(one, pair=pair) for one, pair in zip(study.plant.units, own, strict=True))
    return run_plant(replace(study, plant=replace(study.plant, units=some)), NOTHING)


def test_one_unit_of_a_plant_is_one_converter() -> None:
    """The same answers as in the loop of one converter, with the same sensors and the same harmonics."""
    alone, shared = study_with(), study_with("plant = { units = 1 }")
    scheduler = FieldScheduler(alone, alone.controllers[0])
    simulate(alone, scheduler)
    found = answers_of(run_plant(shared, NOTHING).controllers[0].units[0].estimates)
    expected = np.array([row.answer for row in scheduler.rows])
    assert len(found.R_g) == len(expected)
    for name, values in zip(FieldAnswer._fields, expected.T, strict=True):
        known = np.isfinite(getattr(found, name))  # what is not known yet
        np.testing.assert_allclose(getattr(found, name)[known], values[known], rtol=1e-7, atol=1e-9, err_msg=name)


def test_a_unit_whose_neighbours_are_away_sees_the_grid_alone() -> None:
    """Behind its own transformer, which it knows: the 95 % ellipse contains the grid in most cycles."""
    result = plant(2, more='events = [{ time = "1 ms", element = "unit2", breaker = "open" }]')
    study, log = result.study, result.controllers[0].units[0].estimates
    found, c = answers_of(log), study.converter
    assert log is not None
    R, L = study.grid.R_g, study.grid.L_g
    seen = metrics.answers_of(
        log.t_s,
        (np.full(len(log.t_s), R), np.full(len(log.t_s), L)),
        (found.R_g, found.L_g),
        (found.var_R, found.cov_RL, found.var_L),
        found.valid,
        found.changed,
        omega_n=c.omega_n,
        end_s=study.simulation.duration,
    )
    assert found.valid[-20:].all()
    assert metrics.inside_ellipse(seen)[-20:].mean() > 0.8


def test_units_on_their_own_lines_do_not_hear_each_other() -> None:
    for one in plant(2).controllers[0].units:
        found = answers_of(one.estimates)
        assert found.valid[-20:].all()
        assert not found.foreign.any()
        assert not found.changed.any()


def test_one_estimate_for_all_units() -> None:
    """Six units, more than there are pairs, find the grid of the common mode, and that of five after the first is
    lost: within 3 % of x_t + n Z_g. Of one unit it is what this unit finds by itself, to the digit."""
    common = 'plant = {{ units = {n}, reactance = 0.06, resistance = 0.01, estimators = "{kind}" }}\n'
    lost = 'events = [{ time = 0.8, element = "unit1", breaker = "open" }]'
    study = study_with(common.format(n=6, kind="common") + lost, "1.6 s")
    unit = run_plant(study, NOTHING).controllers[0].units[-1]
    found, t_s = answers_of(unit.estimates), unit.estimates.t_s if unit.estimates is not None else np.zeros(0)
    c = study.converter
    for units, begin, end in ((6, 0.5, 0.8), (5, 1.3, 1.6)):
        rows = (t_s > begin) & (t_s < end)
        Z = units * complex(study.grid.R_g, c.omega_n * study.grid.L_g)
        error = np.abs(found.R_g + 1j * c.omega_n * found.L_g - Z)[rows] / abs(Z + complex(0.01, 0.06) * c.Z_base)
        assert error.max() < 0.03
        assert found.valid[rows].all()
    assert found.changed[t_s > 0.8].sum() == 1
    own, shared = (
        answers_of(run_plant(study_with(common.format(n=1, kind=kind), "0.4 s")).controllers[0].units[0].estimates)
        for kind in ("own", "common")
    )
    np.testing.assert_array_equal(own, shared)


def test_units_on_one_pair_hear_each_other_and_say_so() -> None:
    """With other sign codes; the answers are then not valid."""
    units = plant(3, (1, 1, 1), duration="2 s").controllers[0].units
    said = [answers_of(one.estimates) for one in units]
    assert sum(bool(found.foreign.any()) for found in said) >= 2
    assert not any(found.valid[found.foreign > 0.5].any() for found in said)


def test_beside_a_large_inverter_the_estimator_says_that_the_grid_is_not_passive() -> None:
    """1.6 times the rating, at SCR 3: within half a second, without a new event in cycle after cycle, and the log
    says why."""
    study = study_with(
        """
        network = { nodes = [{ name = "pcc" }], units = [{ name = "unit", node = "pcc" }], inverters = [
            { name = "pv", node = "pcc", S_rated = "20 kVA", P_ref = "14 kW", reactance = 0.06, pll_bandwidth = 20 },
        ] }
        """.replace("\n", " "),
        "1.5 s",
    )
    study = replace(study, grid=Grid(2.0 * study.grid.R_g, 2.0 * study.grid.L_g))
    log = run_plant(study, NOTHING).controllers[0].units[0].estimates
    found = answers_of(log)
    assert log is not None
    late = log.t_s > 0.5
    assert not found.passive[late].any()
    assert not found.valid[late].any()
    assert found.event[late].sum() < 5


STEP = 'events = [{ time = "0.6 s", P_ref = "9 kW" }]'


def test_the_steps_of_one_unit_are_judged_as_those_of_one_converter() -> None:
    """Beside its twin, with the same figures."""
    (alone,) = run_scenario(study_with(STEP, "3.2 s")).controllers
    (unit,) = run_plant(study_with(f"plant = {{ units = 1 }}\n{STEP}", "3.2 s"), NOTHING).controllers[0].units
    assert len(alone.events) == len(unit.events) == 2
    for expected, found in zip(alone.events, unit.events, strict=True):
        assert (found.noise is None) == (expected.noise is None)
        for name in ("settling_time_s", "overshoot_pct", "final", "initial"):
            value = getattr(expected.cycle_mean, name)
            assert getattr(found.cycle_mean, name) == (None if value is None else pytest.approx(value, rel=1e-6)), name
    step = unit.events[0]
    assert step.noise is not None
    assert step.noise.twin
    assert step.cycle_mean.settling_time_s is not None
    for name in ("P_pcc", "Q_pcc"):
        np.testing.assert_allclose(unit.without[0.6][name], alone.without[0.6][name], rtol=1e-7, atol=1e-5)


def test_the_twin_of_a_plant_has_the_estimators_of_its_run() -> None:
    """Two units, one of which is asked for more: up to the step the twin is the run to the bit, then it has the gains
    of the run. Estimators of its own would give others."""
    event = 'events = [{ time = "0.6 s", element = "unit1", P_ref = "7 kW" }]'
    study = study_with(f"plant = {{ units = 2, reactance = 0.06, resistance = 0.01 }}\n{event}", "1.2 s")
    spec, timeline = study.controllers[0], plant_timeline(study)
    schedules = [FieldScheduler(one, one.controllers[0]) for one in timeline.units]
    tape, interval = Tape(), study.converter.T_s
    run = simulate_plant(study, schedules, timeline=timeline, log_interval=interval, tape=tape)
    twin = twins_of(study, spec, run, schedules, tape, interval)[0.6]
    before = twin.t_s < 0.6
    for own, other in zip(run.units, twin.units, strict=True):
        assert np.array_equal(own.log[: before.sum()], other.log[before])
        assert own.gain_changes == other.gain_changes
    after = twin.t_s > 1.1
    P = signals_of(twin, 0).P_pcc[after].mean(), signals_of(run, 0).P_pcc[: len(after)][after].mean()
    assert P[1] - P[0] > 1e3
    held = replace(study, events=())
    others = simulate_plant(held, schedules, timeline=plant_timeline(held), log_interval=interval)
    assert others.units[0].gain_changes != run.units[0].gain_changes
