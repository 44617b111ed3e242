"""What the angle-damped structure promises, held in EMT with the published inner loops."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.metrics import step_response
from vsgdesign.runtime import closed_form_schedule
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.simulation.feeds import gain_feed
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters import Event, Grid, GridSource, Study, load_study
from vsgdesign.study.parameters.grid import Place

P_0, Q_0, STEP = 2000.0, 1000.0, 250.0
TAU = 5e-3
"""Power filter: without it the damping feeds network oscillation to ω on strong, lossless grids."""


@pytest.fixture(scope="module")
def published() -> Study:
    study = load_study("studies/published_averaged/study.toml")
    return replace(study, scr_basis="impedance", tau_P=TAU, tau_Q=TAU)


def angle_damped(study: Study, grid: Grid) -> PowerLoopGains:
    target = replace(study.controllers[1].target, structure="angle_damped")
    return closed_form_schedule(study, target, P_0, Q_0).gains(grid.R_g, grid.L_g)


def at_rest(study: Study, grid: Grid, gains: PowerLoopGains, duration: float) -> Study:
    """The study on a grid, with references that put it at (P_0, Q_0) in spite of droop."""
    R, X = study.path_to_grid(grid)
    V = float(operating_point(P_0, Q_0, study.grid_source.V_g_rms, R, X)[0])
    Q_ref = Q_0 - gains.D_q * (study.converter.V_rated_rms - V)
    spec = replace(study.simulation, duration=duration, P_ref=P_0, Q_ref=Q_ref, log_interval=200e-6)
    return replace(study, grid=grid, simulation=spec, events=())


GRIDS = [
    (1.5, 0.5),
    (1.5, 3.0),
    (2.0, 1.0),
    (3.0, 0.3),
    (5.0, 10.0),
    (8.0, 2.0),
    (10.0, 20.0),
    (20.0, 0.3),
    (20.0, 10.0),
]


@pytest.mark.parametrize(("scr", "x_over_r"), GRIDS)
@pytest.mark.parametrize("signal", ["P", "Q"])
def test_the_placed_time_on_every_grid(published: Study, scr: float, x_over_r: float, signal: str) -> None:
    grid = Place(scr, x_over_r, "impedance").grid(published.converter)
    gains = angle_damped(published, grid)
    study = at_rest(published, grid, gains, 4.0)
    spec = study.simulation
    step: dict[str, Any] = {"P_ref": P_0 + STEP} if signal == "P" else {"Q_ref": spec.Q_ref + STEP}
    run = simulate(replace(study, events=(Event(0.5, "step", **step),)), [GainChange(0.0, gains)])
    y, after = run.column(signal), run.t_s >= 0.5
    found = step_response(run.t_s[after] - 0.5, y[after], float(y[~after][-1]), float(y[-1]))
    assert found.overshoot_pct is not None
    assert found.overshoot_pct <= 1.0
    assert found.settling_time_s == pytest.approx(published.target.placing_time, abs=0.05)


@pytest.mark.parametrize("scr", [1.5, 5.0, 20.0])
@pytest.mark.parametrize("f_g", [49.9, 50.1])
def test_the_droop_is_the_specified_one_on_every_grid(published: Study, scr: float, f_g: float) -> None:
    """5 % droop: 0.1 Hz, 0.2 % of 50 Hz, is 4 % of rated power."""
    grid = Place(scr, 1.0, "impedance").grid(published.converter)
    gains = angle_damped(published, grid)
    study = at_rest(published, grid, gains, 0.5)
    study = replace(study, grid_source=GridSource(study.grid_source.V_g_rms, 2.0 * np.pi * f_g))
    run = simulate(study, [GainChange(0.0, gains)])
    expected = -(f_g - 50.0) / 50.0 / 0.05 * study.converter.S_rated
    assert run.column("P")[-1] - P_0 == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("f_g", [49.6, 50.0, 50.5])
def test_rescheduling_at_rest_moves_nothing(published: Study, f_g: float) -> None:
    """Gains of another grid come at 0.2 s, on a grid of any frequency, and P, Q, V and ω stay where they are.

    Without the transfer the frequency would jump by 0.1 rad/s and more.
    """
    grid = Place(5.0, 1.0, "impedance").grid(published.converter)
    old = angle_damped(published, grid)
    new = angle_damped(published, Place(2.0, 1.0, "impedance").grid(published.converter))
    study = at_rest(published, grid, old, 0.5)
    study = replace(study, grid_source=GridSource(study.grid_source.V_g_rms, 2.0 * np.pi * f_g))
    run = simulate(study, [GainChange(0.0, old), GainChange(0.2, new)])
    assert abs((new.k_P - old.k_P) * P_0 + (new.k_Q - old.k_Q) * Q_0) > 0.1
    after = run.t_s > 0.2 - 1e-9
    for name, size in (("omega", 314.0), ("V_rms", 110.0), ("P", 5e3), ("Q", 5e3)):
        values = run.column(name)
        assert np.abs(values[after] - values[~after][-1]).max() < 1e-9 * size, name


def test_a_step_of_references_with_the_gains_does_not_jump(published: Study) -> None:
    """The old references belong to the old gains: with the new ones ω would jump by k_P ΔP_ref/(1 − k_P D_p)."""
    grid = Place(5.0, 1.0, "impedance").grid(published.converter)
    old = angle_damped(published, grid)
    new = angle_damped(published, Place(2.0, 1.0, "impedance").grid(published.converter))
    study = replace(at_rest(published, grid, old, 0.3), events=(Event(0.2, "step", P_ref=P_0 + 1000.0),))
    run = simulate(study, [GainChange(0.0, old), GainChange(0.2, new)])
    omega, k = run.column("omega"), int(np.searchsorted(run.t_s, 0.2 - 1e-9))
    assert old.k_P * 1000.0 > 0.1
    assert abs(omega[k] - omega[k - 1]) < 1e-6


@pytest.mark.parametrize(("scr", "x_over_r", "P_ref"), [(1.5, 3.0, 1000.0), (2.0, 10.0, -2500.0)])
def test_a_jump_of_the_grid_leaves_the_integrator_alone(
    published: Study, scr: float, x_over_r: float, P_ref: float
) -> None:
    """To SCR 20, with gains that follow 20 ms later, and no limit of the current: a surge of several pu.

    A transfer that keeps ω with the measured powers throws ω_i away by tens of rad/s here, and P never returns.
    """
    before, after = (Place(s, x_over_r, "impedance").grid(published.converter) for s in (scr, 20.0))
    spec = replace(published.simulation, duration=3.0, P_ref=P_ref, Q_ref=1000.0, log_interval=1e-3)
    study = replace(published, grid=before, simulation=spec, events=(Event(0.5, "grid", grid=after),))
    target = replace(published.controllers[1].target, structure="angle_damped", follow_references=True)
    controller = replace(published.controllers[1], target=target)
    run = simulate(study, gain_feed(study, controller, build_timeline(study)))
    P, late = run.column("P"), run.t_s > 2.8
    assert np.abs(P).max() > 1.5 * study.converter.S_rated
    assert np.abs(P[late] - P_ref).max() < 0.02 * study.converter.S_rated
