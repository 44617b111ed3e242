"""The converter with ports of every controller: the EMT's own run, the bits of the exported C, starts and bad input."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.export.conftest import built
from tests.export.unit_loop import (
    FIXED,
    Library,
    control_of,
    phases,
    plain_c,
    run_loop,
    simulated,
    study_with,
    unit_with,
)
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.export import ExportedC, Unit, unit_of
from vsgdesign.export.c_code import export_unit_c
from vsgdesign.export.unit_content import lists_of
from vsgdesign.runtime.scheduler import Scheduler
from vsgdesign.simulation import simulate
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.following import KnownFirst, ScheduledAnswers
from vsgdesign.simulation.shipped import ShippedScheduler, true_grid
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import Grid, Study

SCHEDULED = 'kind = "scheduled"'
FIELD = 'kind = "scheduled", estimate = "field"'


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Any:
    kept: dict[tuple[int, str], tuple[ExportedC, Library]] = {}

    def make(delay: int, controller: str = FIXED) -> tuple[ExportedC, Library]:
        if (delay, controller) not in kept:
            place = tmp_path_factory.mktemp("unit")
            unit = unit_with(delay, controller)
            exported = export_unit_c(unit, place / "c")
            kept[delay, controller] = exported, Library(exported.folder, place, unit)
        return kept[delay, controller]

    return make


@pytest.mark.parametrize("delay", [0, 1])
def test_the_loop_is_the_simulation_and_the_exported_code(delay: int, made: Any) -> None:
    study, unit = study_with(delay), unit_with(delay)
    exported, library = made(delay)
    run = run_loop(study, unit, library.instance().step)
    assert run.outputs[:, [port.name for port in library.ports.outputs].index("limited")].sum() > 50
    assert np.max(np.abs(run.figures - simulated(study, unit))) <= 1e-11
    control = control_of(built(exported.folder, True), unit)
    same = run_loop(study, unit, plain_c(control, unit))
    assert np.array_equal(run.figures, same.figures)


def test_the_circuit_alone_meets_every_event_as_the_simulation(made: Any) -> None:
    """Ramps, a phase jump between two samples, a load and a fault: what a controller outside of the loop is shown."""
    study, unit = study_with(1, quiet=True), unit_with(1)
    study = study.with_events(
        {"time": "0.01 s", "V_g_pu": 0.9, "over": "20 ms"},
        {"time": "0.0201234 s", "phase_jump": "8 deg"},
        {"time": "0.035 s", "f_g": "50.4 Hz", "over": "10 ms"},
        {"time": "0.05 s", "load": {"P": "2 kW"}},
        {"time": "0.0700123 s", "fault": {"kind": "phase_to_phase", "R": "1 ohm", "at": 0.3}},
        {"time": "0.09 s", "fault": "cleared"},
    )
    run = run_loop(study, unit, made(1)[1].instance().step)
    assert np.max(np.abs(run.figures - simulated(study, unit))) <= 1e-9


def test_a_schedule_is_that_of_the_run(made: Any) -> None:
    """Gains in closed form, with the guards of the scheduler, which is told the true grid 20 ms late."""
    study, unit = study_with(0, SCHEDULED), unit_with(0, SCHEDULED)
    _, library = made(0, SCHEDULED)
    run = run_loop(study, unit, library.instance().step)
    runtime = Scheduler(unit.scheduler.lookup, unit.scheduler.settings)
    runtime.start(study.grid.R_g, study.grid.L_g)
    c = study.converter
    shipped = ShippedScheduler(runtime, estimate=true_grid(build_timeline(study)), sample_interval=c.T_s)
    emt = simulate(study, shipped)
    figures = np.column_stack([emt.column("P") / c.S_rated, emt.column("omega") / c.omega_n])
    assert np.max(np.abs(run.figures[:, [0, 2]] - figures)) <= 1e-11
    names = [port.name for port in library.ports.outputs]
    place = run.outputs[:, names.index("L_g_of_gains")]
    assert place[-1] > 1.1 * place[0]  # the gains have followed the jump
    assert set(run.outputs[:, names.index("status_fresh")]) == {0.0, 1.0}


class UnitsAnswers(ScheduledAnswers):
    """The schedule of an exported controller: a closed form with the guards of the scheduler, as of a table."""

    def __init__(self, study: Study, unit: Unit) -> None:
        super().__init__(study, study.controllers[0])
        self._first_gains = unit.gains
        self._runtime = Scheduler(unit.scheduler.lookup, unit.scheduler.settings)

    def first(
        self, told: Grid | None = None, *, known: bool = True, before: KnownFirst | None = None
    ) -> PowerLoopGains:
        del told, known, before
        return self._first_gains


class UnitsFeed(FieldScheduler):
    """A run with the field estimator and the schedule of an exported controller."""

    def __init__(self, study: Study, unit: Unit) -> None:
        super().__init__(study, study.controllers[0])
        self._answers, self._has_table = UnitsAnswers(study, unit), True
        self.begin()


@pytest.mark.parametrize("duration", [0.03, 0.4])
def test_the_field_estimator_is_that_of_the_run(duration: float, made: Any) -> None:
    """Its probe, what it hears and the gains that follow its answers, through a step and a jump of the grid."""
    bare = study_with(1, FIELD, duration, quiet=True)
    study = bare.with_events(
        {"time": "0.01 s", "P_ref": f"{0.6 * bare.converter.S_rated} W"},
        {"time": f"{0.6 * duration} s", "grid": {"scr": 1.5, "x_over_r": 5}},
    )
    unit = unit_of(study)
    _, library = made(1, FIELD)
    run = run_loop(study, unit, library.instance().step)
    feed = UnitsFeed(study, unit)
    assert np.max(np.abs(run.figures - simulated(study, unit, feed))) <= 1e-11  # 2e-14 at worst
    grids = np.unique(run.outputs[:, [port.name for port in library.ports.outputs].index("L_g_of_gains")])
    assert len(grids) >= (5 if duration > 0.1 else 1)
    assert len(feed.changes) >= round(duration / 0.02)


@pytest.mark.parametrize("controller", [FIXED, SCHEDULED, FIELD])
def test_a_saved_state_goes_on_with_the_same_bits(controller: str, made: Any) -> None:
    """Saved while the limiter acts in a sag, and loaded into another instance, beside a third one that runs along."""
    study, unit = study_with(0, controller), unit_with(0, controller)
    _, library = made(0, controller)
    one, other = library.instance(), library.instance()
    seen: list[tuple[np.ndarray, np.ndarray]] = []

    def step(given: np.ndarray) -> np.ndarray:
        if len(seen) == 1600:  # in the sag
            other.load(one.save())
        if len(seen) < 1600:
            other.step(given[::-1])  # two instances share nothing
        out = one.step(given)
        seen.append((given.copy(), out))
        if len(seen) > 1600:
            assert np.array_equal(other.step(given), out)
        return out

    run_loop(study, unit, step)
    assert np.array_equal(one.save(), other.save())
    limited = [port.name for port in library.ports.outputs].index("limited")
    assert sum(out[limited] for _, out in seen[1400:1600]) > 0


@pytest.mark.parametrize("controller", [FIXED, SCHEDULED])
def test_no_number_at_an_input_leaves_the_sample_out(controller: str, made: Any) -> None:
    study, unit = study_with(1, controller, 0.01, quiet=True), unit_with(1, controller)
    _, library = made(1, controller)
    one, names = library.instance(), [port.name for port in library.ports.outputs]
    bad = iter(range(10**6))

    def step(given: np.ndarray) -> np.ndarray:
        k = next(bad)
        given = given.copy()
        if k >= 50:  # every input once
            given[(k - 50) % len(given)] = math.nan
        return one.step(given)

    run = run_loop(study, unit, step)
    used = run.outputs[:, names.index("used")]
    assert used[:50].all()
    assert 0 < used[50:].sum() < len(used) - 50
    assert np.isfinite(run.outputs).all()
    assert np.isfinite(one.save()).all()
    assert np.max(np.abs(run.figures[:, 0] - 0.3)) < 0.3


def test_it_follows_a_live_bus_until_it_is_ready(made: Any) -> None:
    """``start`` = 1 with the breaker closed: the output is the measured voltage, and the angle never is zero."""
    study, unit = study_with(1, FIXED, 0.4, quiet=True), unit_with(1)
    _, library = made(1)
    names = [port.name for port in library.ports.outputs]
    one = library.instance(start=1.0)
    run = run_loop(study, unit, one.step)
    ready = run.outputs[:, names.index("ready")]
    first = int(np.argmax(ready))
    T_s = study.converter.T_s
    assert 0.2 <= first * T_s <= 0.25
    assert ready[first:].all()
    theta = np.unwrap(run.outputs[:, names.index("theta")])
    assert np.abs(np.diff(theta) / (study.converter.omega_n * T_s) - 1.0).max() < 0.1  # no jump at the release
    assert np.abs(run.figures[:, 3:]).max() < 1.0  # no surge
    assert run.figures[-1, 0] > run.figures[first, 0] + 0.02  # and then it takes up its power


def test_it_connects_behind_an_open_breaker(made: Any) -> None:
    """``closed`` = 0: it makes the grid's voltage at the capacitor, and is ready once they agree for 0.2 s."""
    study, unit = study_with(1, FIXED, 0.4, quiet=True), unit_with(1)
    _, library = made(1)
    names = [port.name for port in library.ports.outputs]
    at = [port.name for port in library.ports.inputs].index("closed")
    grid_at = [port.name for port in library.ports.inputs].index("v_grid_a")
    one, told = library.instance(start=1.0), []
    amplitude, T_s = rms_to_peak(study.converter.V_rated_rms), study.converter.T_s

    def step(given: np.ndarray) -> np.ndarray:
        given = given.copy()
        given[at] = 0.0
        given[grid_at : grid_at + 3] = phases(
            amplitude * np.exp(1j * (study.converter.omega_n * T_s * len(told) + 1.0))
        )
        out = one.step(given)
        told.append(out[names.index("ready")])
        return out

    far = replace(study, grid=replace(study.grid, L_g=1e6))  # H: the breaker is open
    run_loop(far, unit, step, empty=True)
    assert 0.2 / T_s <= told.index(1.0) <= 0.35 / T_s


def test_the_power_loops_alone_rest_and_turn_with_their_frame(made: Any) -> None:
    study, unit = study_with(0), unit_with(0)
    exported, _ = made(0)
    library = Library(exported.folder, exported.folder.parent, unit, "reference")
    one, rng = library.instance(), np.random.default_rng(3)
    inputs = {port.name: k for k, port in enumerate(library.ports.inputs)}
    outputs = [port.name for port in library.ports.outputs]
    given = np.array([port.start for port in library.ports.inputs])
    first = one.step(given)
    assert first[outputs.index("omega")] == pytest.approx(study.converter.omega_n, rel=1e-9)
    delta = []
    for _ in range(400):
        given[inputs["P"]] = unit.powers[0] * rng.uniform(0.9, 1.1)
        delta.append(one.step(given)[outputs.index("delta")])
    assert np.ptp(delta) < 0.2
    assert np.abs(np.diff(delta)).max() < 0.02  # its frame turns along


def test_the_list_has_every_number_with_unit_meaning_and_start() -> None:
    for controller in (FIXED, SCHEDULED, FIELD):
        for one in lists_of(unit_with(0, controller)).values():
            assert len({port.name for port in one.ports}) == len(one.ports)
            assert len({state.name for state in one.states}) == len(one.states)
            for port in one.ports:
                assert port.unit, port
                assert len(port.meaning) > 4, port
                assert math.isfinite(port.start)
                assert port.low <= port.start <= port.high, port
    names = {port.name for port in lists_of(unit_with(0))["controller"].ports}
    assert not {"R_g", "scheduling", "status_fresh"} & names  # fixed gains have no schedule
