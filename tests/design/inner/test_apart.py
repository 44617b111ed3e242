"""What inner loops keep between equal units: the damping as on a grid as strong as x_t, and the decay as in the model
of the whole plant."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.studies import LCL
from vsgdesign.design.inner import GridBox, check_apart, score_inner_loops
from vsgdesign.design.inner.designing import POWERS_PU
from vsgdesign.design.inner.grids import angle_damped_target
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.runtime.closed_form import closed_form_schedule
from vsgdesign.simulation.units.scenario import run_plant
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.power_plant import behind_its_path

STUDY = (
    LCL.replace("transient_resistance_pu = 0.0", "transient_resistance_pu = 0.1")
    + """
[power_loops]
structure = "angle_damped"
settling_time = "1 s"
tau_P = "5 ms"
tau_Q = "5 ms"
[simulation]
duration = "20 ms"
P_ref = "P kW"
Q_ref = "0 var"
[[controllers]]
name = "closed_form"
kind = "scheduled"
[plant]
units = 3
reactance = 0.05
resistance = 0.01
"""
)


def plant(P_kW: float = 2.0, scr: float = 5.0) -> Study:
    """Three units at SCR (on the impedance) and X/R 4."""
    text = STUDY.replace("P kW", f"{P_kW} kW")
    return study_from_text(text).with_changes(grid={"scr_basis": "impedance", "scr": scr, "x_over_r": 4.0})


def test_between_units() -> None:
    study = plant()
    whole, f = study.plant, study.filter
    assert whole is not None
    own = behind_its_path(study, whole.units[0])
    box = GridBox((1.5, 1.5), (4.0, 4.0))
    damping, decay = check_apart(
        study.converter, own.filter, study.inner_gains, study.omega_t, box, settling_time=1.0, decay=3.9
    )
    X, R = study.converter.omega_n * whole.units[0].L, whole.units[0].R
    strong = study.converter.Z_base / math.hypot(R, X)
    there = GridBox((strong, strong), (X / R, X / R))
    alone = score_inner_loops(study.converter, f, study.inner_gains, study.omega_t, there, settling_time=1.0)
    assert damping.value == pytest.approx(alone.promises[0].value, rel=1e-6)
    assert (decay.scr, decay.x_over_r, decay.score) == (1.5, 4.0, decay.value / 3.9)
    target, slowest = angle_damped_target(1.0, study.converter.omega_n), []
    for share in POWERS_PU:
        P = share * study.converter.S_rated
        one = plant(P / 1e3, 1.5)
        grid = np.array([3.0 * one.grid.R_g]), np.array([3.0 * one.grid.L_g])  # as a unit sees it
        gains = closed_form_schedule(own, target, P, 0.0).gains_over(*grid)
        fixed = replace(one.controllers[0], kind="fixed", gains=PowerLoopGains(*(float(value[0]) for value in gains)))
        split = run_plant(replace(one, controllers=(fixed,))).controllers[0].rests[0].split
        slowest += [] if split is None else [-split.differential[0].s.real]
    assert len(slowest) == 3
    assert decay.value == pytest.approx(min(slowest), rel=1e-4)
