"""Droop and inertia of a gain table, measured in EMT: what a grid code asks for, on every grid."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.gain_tables import table
from vsgdesign.runtime.schedule import Schedule
from vsgdesign.runtime.table import table_schedule
from vsgdesign.simulation import GainChange, simulate
from vsgdesign.simulation.steps import references_at
from vsgdesign.study.parameters import Event, Grid, Study, load_study
from vsgdesign.study.parameters.grid import Place

P_0, Q_0 = 2000.0, 500.0
AXES: dict[str, Any] = {"scr": (1.5, 20.0), "x_over_r": (0.5, 5.0)}


@pytest.fixture(scope="module")
def published() -> Study:
    return replace(load_study("studies/published/study.toml"), scr_basis="impedance", tau_P=5e-3, tau_Q=5e-3)


def change_of_power(study: Study, grid: Grid, schedule: Schedule, f_g: float, over: float, until: float) -> float:
    """What P gains until ``until`` after the grid's frequency begins to move to f_g, W."""
    gains = schedule.gains(grid.R_g, grid.L_g)
    P_ref, Q_ref = references_at(study, grid, gains, P_0, Q_0)
    move = Event(0.1, "frequency", omega_g=2.0 * np.pi * f_g, over=over)
    spec = replace(
        study.simulation, duration=0.1 + until, start="steady_state", bridge="averaged", P_ref=P_ref, Q_ref=Q_ref
    )
    run = simulate(replace(study, grid=grid, simulation=spec, events=(move,)), [GainChange(0.0, gains)])
    return float(run.column("P")[-1]) - P_0


@pytest.mark.parametrize("scr", [1.5, 3.0, 8.0, 20.0])
@pytest.mark.parametrize("f_g", [49.9, 50.1])
def test_a_table_delivers_the_droop_it_was_asked_for(published: Study, scr: float, f_g: float) -> None:
    """5 % droop of 5 kVA: 200 W for 0.1 Hz, within 1 %, between the nodes of the table too."""
    schedule = replace(table_schedule(table(**AXES, D_p=5e3 / (0.05 * 100.0 * np.pi))), P=P_0, Q=Q_0)
    grid = Place(scr, 1.2, "impedance").grid(published.converter)
    found = change_of_power(published, grid, schedule, f_g, over=0.2, until=4.0)
    assert found == pytest.approx(-(f_g - 50.0) / 50.0 / 0.05 * 5e3, rel=0.01)


@pytest.mark.parametrize("scr", [1.5, 3.0, 20.0])
@pytest.mark.parametrize("x_over_r", [0.5, 5.0])
def test_a_table_has_its_inertia_on_a_ramp(published: Study, scr: float, x_over_r: float) -> None:
    """0.25 Hz/s ask H = 2 s of a 5 kVA converter for 2HS/ω_0·RoCoF = 100 W, without droop."""
    schedule = replace(table_schedule(table(law="inertia", **AXES, D_p=0.0)), P=P_0, Q=Q_0)
    grid = Place(scr, x_over_r, "impedance").grid(published.converter)
    found = change_of_power(published, grid, schedule, 49.25, over=3.0, until=3.0)
    assert found == pytest.approx(2.0 * 2.0 * 5e3 / 50.0 * 0.25, rel=0.05)
