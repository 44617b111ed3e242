"""The runtime that ships in the EMT loop: gains follow the grid, statuses say how, and C gives the same run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.export.conftest import FIT, built
from tests.export.exchange import exported, written
from tests.simulation.studies import lc_study
from vsgdesign.equations.scheduler_data import FALLBACK, FRESH, HELD, JUMP, LIMITED, NO_ESTIMATE
from vsgdesign.export import export_c_files
from vsgdesign.runtime import load_scheduler, status_text
from vsgdesign.simulation import MeasuredWindow, Simulation, build_timeline, simulate
from vsgdesign.simulation.shipped import ShippedScheduler, true_grid
from vsgdesign.study.parameters import Study

EVENTS = """
[[events]]
time = "0.3 s"
grid = { scr = 8, x_over_r = 1 }
[[events]]
time = "0.7 s"
P_ref = "2.5 kW"
"""


def study_of(duration: str = "1 s") -> Study:
    return lc_study(duration, EVENTS, "[grid]\nscr = 3\nx_over_r = 1\n", log="2 ms")


def run(runtime: object, study: Study, blind: tuple[float, float] | None = None) -> tuple[Simulation, ShippedScheduler]:
    truth = true_grid(build_timeline(study))

    def estimate(window: MeasuredWindow) -> tuple[float, float] | None:
        return None if blind is not None and blind[0] < window.t_s < blind[1] else truth(window)

    shipped = ShippedScheduler(runtime, estimate=estimate)  # type: ignore[arg-type]
    return simulate(study, shipped), shipped


def test_gains_follow_a_step_of_the_grid(tmp_path: Path) -> None:
    study = study_of()
    scheduler = load_scheduler(written(tmp_path)[0])
    scheduler.start(study.grid.R_g, study.grid.L_g)
    simulation, shipped = run(scheduler, study)
    statuses = [answer.status for answer in shipped.answers]
    assert statuses[:15] == [FRESH] * 15
    assert [answer.reason for answer in shipped.answers[15:17]] == [JUMP, JUMP]
    assert statuses[17] == FRESH | LIMITED
    assert statuses[-10:] == [FRESH] * 10
    steps = np.diff(np.log([answer.scr for answer in shipped.answers]))
    assert np.abs(steps).max() <= 10.0 * 0.02
    grid = build_timeline(study).grid_at(0.9)
    last, window = simulation.gain_changes[-1].gains, simulation.final_state
    expected = scheduler.lookup.gains(
        scheduler.lookup.normalised(*scheduler.lookup.coordinates(grid.R_g, grid.L_g)),  # type: ignore[arg-type]
        *scheduler.lookup.coordinates(grid.R_g, grid.L_g),
        window.P_f,
        window.Q_f,
        window.V,
    )
    np.testing.assert_allclose(last, expected, rtol=0.05)  # powers of one window earlier
    # ω does not jump where the gains do: its largest change in 2 ms is that of the grid's own step.
    omega = simulation.column("omega")
    at_grid_step = np.abs(np.diff(omega))[148:153].max()
    assert np.abs(np.diff(omega))[155:200].max() < at_grid_step


def test_without_estimates_it_falls_back_and_the_run_goes_on(tmp_path: Path) -> None:
    study = study_of("2.4 s")
    scheduler = load_scheduler(written(tmp_path)[0], stale_ticks=200_000, lost_ticks=200_000)
    scheduler.start(study.grid.R_g, study.grid.L_g)
    simulation, shipped = run(scheduler, study, blind=(0.4, 5.0))
    assert shipped.answers[24].status & HELD
    assert shipped.answers[24].reason == NO_ESTIMATE
    assert shipped.answers[-1].status == HELD | FALLBACK, status_text(shipped.answers[-1].status)
    assert shipped.answers[-1].scr == pytest.approx(scheduler.settings.safe_scr, rel=1e-4)
    P = simulation.column("P")
    assert np.all(np.abs(P[-50:] - 2.5e3) < 50.0)  # at rest again, 1 % of rated


@pytest.mark.parametrize(("double", "tolerance"), [(True, 1e-12), (False, 2e-6)])
@pytest.mark.parametrize("windows", [False, True])
def test_the_compiled_c_gives_the_same_run(double: bool, tolerance: float, windows: bool, tmp_path: Path) -> None:
    """At every logged sample, of the largest value of its column; ω about the nominal."""
    study = study_of("0.8 s")
    tables = written(tmp_path)
    compiled = built(exported(tmp_path), double)
    scheduler = load_scheduler(*tables, fit=FIT)
    runs = []
    for runtime in (scheduler, compiled):
        runtime.start(study.grid.R_g, study.grid.L_g)
        if windows:
            shipped = ShippedScheduler(runtime)
            runs.append((simulate(study, shipped), shipped))
        else:
            runs.append(run(runtime, study))
    (python, a), (c, b) = runs
    assert [x[1:3] for x in a.answers] == [x[1:3] for x in b.answers]
    size = np.abs(python.log).max(axis=0)
    assert np.all(np.abs(c.log - python.log) <= tolerance * size)


@pytest.mark.parametrize(("double", "tolerance"), [(True, 1e-12), (False, 1e-3)])
def test_the_compiled_scheduler_falls_back_while_the_current_is_limited(
    double: bool, tolerance: float, tmp_path: Path
) -> None:
    """A jump that the estimator never sees. The projection limiter is told the grid that the gains are for."""
    limited = '[converter]\ncurrent_limit_pu = 1.2\ncurrent_limiter = "projection"\n'
    jump = '[[events]]\ntime = "0.1 s"\ngrid = { scr = 20, x_over_r = 1 }\n'
    study = lc_study("0.8 s", jump, f"[grid]\nscr = 3\nx_over_r = 1\n{limited}", log="2 ms")
    table_file = written(tmp_path)[0]
    folder = export_c_files(table_file, tmp_path / "c", limiter="projection", stale_ticks=200_000).folder
    runs = []
    for runtime in (load_scheduler(table_file, stale_ticks=200_000), built(folder, double)):
        assert runtime.start(study.grid.R_g, study.grid.L_g) is not False
        assert runtime.grid == pytest.approx((study.grid.R_g, study.grid.L_g), rel=1e-6)
        runs.append(run(runtime, study, blind=(0.09, 5.0)))
    (python, a), (c, b) = runs
    assert [x[1:3] for x in a.answers] == [x[1:3] for x in b.answers]
    assert a.answers[-1].status & FALLBACK
    assert a.answers[-1].scr > 5.0
    assert python.column("limited_samples")[-1] > 100
    size = np.abs(python.log).max(axis=0)
    assert np.all(np.abs(c.log - python.log) <= tolerance * size)
