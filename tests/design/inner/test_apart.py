"""What inner loops keep between equal units: the damping as on a grid as strong as x_t, and the decay as in the model
of the whole plant."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.studies import LCL
from vsgdesign.artifacts.inner_loops_file import request_document
from vsgdesign.design.inner import GridBox, check_apart, design_inner_loops, score_inner_loops
from vsgdesign.design.inner.grids import POWERS_PU, angle_damped_target
from vsgdesign.design.inner.passivity import FASTER, searched_apart
from vsgdesign.design.inner.search import Effort
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.runtime.schedule import closed_form_schedule
from vsgdesign.simulation.units.scenario import run_plant
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.study.parameters.power_plant import behind_its_path
from vsgdesign.study.parameters.study import InnerLoopRequest

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
    damping, decay = check_apart(study.converter, own.filter, study.inner_gains, study.omega_t, box, decay=3.9)
    X, R = study.converter.omega_n * whole.units[0].L, whole.units[0].R
    strong = study.converter.Z_base / math.hypot(R, X)
    there = GridBox((strong, strong), (X / R, X / R))
    alone = score_inner_loops(study.converter, f, study.inner_gains, study.omega_t, there, settling_time=1.0)
    assert damping.value == pytest.approx(alone.promises[0].value, rel=1e-6)
    assert (decay.scr, decay.x_over_r, decay.score) == (1.5, 4.0, decay.value / 3.9)
    target, slowest = angle_damped_target(FASTER, study.converter.omega_n), []  # 3.9 1/s: 1 s
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


def test_what_it_leaves_of_a_score() -> None:
    """Of three gain sets: the share of the decay where the units grow, that of the damping where this is missed, and
    nothing is looked at of one that is unstable by itself."""
    study, box = plant(), GridBox((1.5, 20.0), (1.0, 20.0))
    assert study.plant is not None
    c, f, own = study.converter, behind_its_path(study, study.plant.units[0]).filter, study.inner_gains
    bench, _ = searched_apart(c, f, box, 3.0)
    assert bench is not None
    omega_t, of = np.array([study.omega_t, 40.0, 40.0]), np.array([1.2, 0.9, -0.3])
    each = [check_apart(c, f, own, at, box, decay=3.0) for at in omega_t.tolist()]
    assert each[0][1].score < 0.0
    assert 0.5 < each[1][0].score < 0.9 < 1.0 < each[1][1].score
    bench = bench.joined(own, study.omega_t)
    gains = InnerLoopGains(*(np.full(3, value) for value in own))
    expected = [each[0][1].score, each[1][0].score, -0.3]
    np.testing.assert_allclose(bench.scores(gains, omega_t, of), expected, rtol=1e-6)


def test_a_design_keeps_the_units_from_swinging() -> None:
    """Designed for one converter, they grow against each other; designed for units, they decay as asked. The request
    of a plant without gains asks for it, with the transformer of a unit."""
    study, box, effort = plant(), GridBox((1.5, 20.0), (1.0, 20.0)), Effort(heat=2, generations=6, joined=2, rounds=1)
    c, f = study.converter, behind_its_path(study, study.plant.units[0]).filter if study.plant else study.filter
    decays = []
    for asked in (0.0, 3.0):
        found = design_inner_loops(c, f, box, settling_time=1.3, decay_apart=asked, effort=effort)
        apart = check_apart(c, f, found.gains, found.omega_t, box, decay=3.0)
        decays.append(apart[1].value)
        assert found.promises[6:] == (apart if asked else ())
        assert found.t <= min(one.score for one in found.promises)
    assert decays[0] < 1.0 < 2.7 < decays[1]


def test_a_plant_asks_for_it() -> None:
    text = STUDY.replace("P kW", "2 kW") + "[grid]\nscr = 5\nx_over_r = 4\n"
    begin, end = text.index("[inner_loops]"), text.index("[power_loops]")
    given: list[InnerLoopRequest] = []

    def kept(request: InnerLoopRequest) -> tuple[InnerLoopGains, float]:
        given.append(request)
        return plant().inner_gains, 300.0

    study = study_from_text(text[:begin] + text[end:], inner_loops=kept)
    assert study.plant is not None
    assert given[0].filter == behind_its_path(study, study.plant.units[0]).filter
    assert given[0].decay_apart == pytest.approx(3.9)
    study_from_text(text[:begin] + text[end:].replace("units = 3", "units = 1"), inner_loops=kept)
    assert given[1].decay_apart == 0.0
    assert "decay_apart" not in request_document(given[1])
