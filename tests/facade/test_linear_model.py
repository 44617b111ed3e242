"""``vd.linear_model``: systems of python-control, by which its poles, margins and steps are those that we state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

import vsgdesign as vd
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.stability.maps import cells_under, full_order_cells, reduced_cells
from vsgdesign.linear.stability.margins import MarginTable, full_order_margins, reduced_margins
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation.steps import simulate_step

ROOT = Path(__file__).resolve().parents[2]
GRIDS = 20
"""Random grids, of which `make test` takes the first ones."""


@cache
def laboratory() -> vd.Study:
    return vd.load(ROOT / "studies" / "laboratory" / "study.toml")


@dataclass(frozen=True)
class Drawn:
    """A grid and the powers of a rest, drawn at random, with the gains and the tables that we state of it."""

    study: vd.Study
    P: float
    Q: float
    gains: PowerLoopGains
    tables: dict[str, MarginTable]

    def system(self, model: Any, part: Any = "closed") -> control.StateSpace:
        return vd.linear_model(
            laboratory(), "scheduled", grid=self.study.grid, model=model, part=part, P=self.P, Q=self.Q
        )


@cache
def drawn(seed: int) -> Drawn:
    rng = np.random.default_rng([31, seed])
    scr, x_over_r = np.exp(rng.uniform(np.log([1.5, 0.5]), np.log([20.0, 15.0])))
    P, Q = rng.uniform([-0.6, -0.2], [0.6, 0.2]) * laboratory().converter.S_rated
    study = laboratory().with_changes(grid=vd.grid(scr=scr, x_over_r=x_over_r))
    cells = cells_under(study, gain_law(study, study.controllers[1]), study.grid.R_g, study.grid.L_g, P, Q)
    assert cells.faults == (None,)
    tables = {
        "reduced": reduced_margins(reduced_cells(study, cells)),
        "full": full_order_margins(full_order_cells(study, cells)),
    }
    gains = PowerLoopGains(*(float(value[0]) for value in cells.gains))
    return Drawn(study, float(P), float(Q), gains, tables)


def least_margin(loop: control.StateSpace) -> float:
    """The disk margin by python-control and Slycot, on a grid of frequencies that becomes finer about its minimum."""
    high = 0.999 * np.pi / loop.dt if loop.dt else 1e4
    omega = np.geomspace(1e-3, high, 600)
    found = control.disk_margins(loop, omega, returnall=True)[0]
    for _ in range(2):
        k = int(np.argmin(found))
        omega = np.linspace(omega[max(k - 2, 0)], omega[min(k + 2, len(omega) - 1)], 60)
        found = control.disk_margins(loop, omega, returnall=True)[0]
    return float(np.min(found))


@pytest.mark.parametrize("model", ["reduced", "full"])
@pytest.mark.parametrize("seed", range(GRIDS))
def test_poles_and_disk_margin_are_ours(model: str, seed: int) -> None:
    here = drawn(seed)
    ours, closed = here.tables[model], here.system(model)
    poles = closed.poles() if model == "reduced" else np.log(closed.poles()) / closed.dt
    a, b = np.sort_complex(np.asarray(poles)), np.sort_complex(ours.eigenvalues[0])
    assert np.max(np.abs(a - b) / np.maximum(np.abs(b), 1.0)) < 1e-9
    margin = float(ours.disk_output.value[0])
    assert least_margin(here.system(model, "loop")) == pytest.approx(margin, rel=1e-3)


@pytest.mark.parametrize("seed", range(GRIDS))
def test_a_step_is_that_of_emt(seed: int) -> None:
    """A small step of P_ref and of Q_ref by python-control and in EMT, to 0.5 % of the step."""
    here = drawn(seed)
    closed, size = here.system("full"), 0.002 * here.study.converter.S_rated
    for signal in ("P", "Q"):
        t_s, emt = simulate_step(here.study, here.study.grid, here.gains, here.P, here.Q, signal, size, 1.0, 1)
        found = control.forced_response(closed[signal, f"{signal}_ref"], T=t_s, inputs=np.full(len(t_s), size))
        assert np.max(np.abs(found.outputs - emt)) < 0.005 * size


@pytest.mark.parametrize("name", ["fixed", "scheduled"])
@pytest.mark.parametrize("model", ["reduced", "full"])
def test_plant_and_controller_close_to_the_whole(model: Any, name: str) -> None:
    """python-control closes G and K to the poles of the closed loop, and finds −G K in the loop."""
    closed, loop, plant, controller = (
        vd.linear_model(laboratory(), name, model=model, part=part, P="4 kW")
        for part in ("closed", "loop", "plant", "controller")
    )
    a, b = (np.sort_complex(one.poles()) for one in (control.feedback(plant, controller, sign=1), closed))
    assert np.max(np.abs(a - b)) < 1e-9
    s = 20.0j if model == "reduced" else np.exp(20.0j * closed.dt)
    np.testing.assert_allclose((-(plant * controller))(s), loop(s), rtol=1e-6, atol=1e-6)


def test_names_and_times() -> None:
    reduced, full = (vd.linear_model(laboratory(), "fixed", model=model) for model in ("reduced", "full"))
    assert (reduced.dt, full.dt) == (0.0, laboratory().converter.T_s)
    assert reduced.state_labels == ["delta", "omega_i", "V"]
    assert reduced.input_labels == ["P_ref", "Q_ref", "omega_g", "V_g"]
    assert full.output_labels[:4] == reduced.output_labels == ["P", "Q", "omega", "V"]
    assert "pending_d" in full.state_labels


def test_fixed_gains_stay_and_scheduled_ones_follow() -> None:
    """K has the gains of the study where they are fixed, whatever the grid is."""
    study, weak = laboratory(), vd.grid(scr=2.0, x_over_r=3.0)
    for name, same in (("fixed", True), ("scheduled", False)):
        here, there = (vd.linear_model(study, name, grid=grid, part="controller") for grid in (None, weak))
        assert np.allclose(here.B, there.B, rtol=1e-12) == same


def test_what_cannot_be_is_told() -> None:
    study = laboratory()
    with pytest.raises(vd.VsgDesignError, match=r'controller = "fxed": unknown\. The study has: fixed, scheduled'):
        vd.linear_model(study, "fxed")
    with pytest.raises(vd.VsgDesignError, match=r"grid.scr = -1"):
        vd.linear_model(study, grid=vd.grid(scr=-1, x_over_r=3))
    with pytest.raises(vd.VsgDesignError, match=r"simulation.P_ref"):
        vd.linear_model(study, P=float("nan"))
    for model in ("reduced", "full"):
        with pytest.raises(vd.VsgDesignError, match=r"fixed on SCR 0.5, X/R 3: no operating point"):
            vd.linear_model(study, "fixed", grid=vd.grid(scr=0.5, x_over_r=3), P="10 kW", model=model)
    with pytest.raises(ValueError, match="reduced, full"):
        vd.linear_model(study, model="fully")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="closed, loop, plant, controller"):
        vd.linear_model(study, part="open")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="linear_model takes a study"):
        vd.linear_model(3)  # type: ignore[arg-type]


def test_a_limiter_that_couples_them_leaves_no_part_alone() -> None:
    """The closed loop and the loop are there; plant and controller are not."""
    own = laboratory().with_changes(controllers=[vd.controller("own", current_limiter="projection")])
    closed, loop = (vd.linear_model(own, model="full", part=part) for part in ("closed", "loop"))
    assert closed.nstates == loop.nstates
    for part in ("plant", "controller"):
        with pytest.raises(vd.VsgDesignError, match="couples the power loops"):
            vd.linear_model(own, model="full", part=part)  # type: ignore[arg-type]
