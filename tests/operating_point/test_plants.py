"""Exact steps of many circuits at once: each lane is the step of its own circuit, whatever its neighbours are."""

from __future__ import annotations

import numpy as np
import pytest

from tests.simulation.studies import lc_study, lcl_study
from vsgdesign.linear.operating_point.plant import averaged_steps, plant_step, plant_steps
from vsgdesign.study.parameters.grid import Grid

STUDIES = {"LC": lc_study("1 s"), "LCL": lcl_study("1 s")}


@pytest.mark.parametrize("name", STUDIES)
def test_each_lane_is_the_step_of_its_own_circuit(name: str) -> None:
    """To the last bit, over grids whose matrices need different numbers of squarings and pieces of an interval."""
    study, rng, N = STUDIES[name], np.random.default_rng(3), 40
    R_g, L_g = study.grid.R_g * rng.uniform(0.0, 2.0, N), study.grid.L_g * 10.0 ** rng.uniform(-2.0, 1.0, N)
    h, omega = study.converter.T_s * 10.0 ** rng.uniform(-4.0, 0.0, N), rng.uniform(280.0, 400.0, N)
    steps = plant_steps(study, R_g, L_g, h, omega, edges=True)
    degrees = set()
    for k in range(N):
        alone = plant_step(study.circuit(Grid(R_g[k], L_g[k])), h[k], omega[k])
        for field in ("transition", "bridge", "source"):
            np.testing.assert_array_equal(getattr(steps, field)[k], getattr(alone, field))
        np.testing.assert_array_equal(steps.edge[k, : len(alone.edge)], alone.edge)
        assert not steps.edge[k, len(alone.edge) :].any()
        degrees.add(len(alone.edge))
    assert len(degrees) > 3


def test_numbers_broadcast_and_averaged_bridges_have_no_edges() -> None:
    study = STUDIES["LCL"]
    L_g = study.grid.L_g * np.array([0.5, 1.0, 2.0])
    steps = plant_steps(study, study.grid.R_g, L_g, study.converter.T_s, 314.0)
    assert steps.h.shape == (3,)
    assert steps.transition.shape == (3, 3, 3)
    assert steps.edge.shape == (3, 0, 3)
    circuits = [study.circuit(Grid(study.grid.R_g, L)) for L in L_g]
    transition, bridge = averaged_steps(circuits, study.converter.T_s)
    np.testing.assert_array_equal(steps.transition, transition)
    np.testing.assert_array_equal(steps.bridge, bridge)


def test_a_lane_too_stiff_to_switch_is_marked_and_disturbs_no_other() -> None:
    """The resistive grid's fastest mode dies out some hundred times within the interval."""
    study = STUDIES["LC"]
    R_g, L_g = np.array([study.grid.R_g, 3.63]), np.array([study.grid.L_g, 3.63e-3 / 314.0])
    both = plant_steps(study, R_g, L_g, 3e-3, 314.0, edges=True)
    alone = plant_steps(study, R_g[:1], L_g[:1], 3e-3, 314.0, edges=True)
    assert np.isnan(both.edge[1]).all()
    np.testing.assert_array_equal(both.edge[0], alone.edge[0])
    only_stiff = plant_steps(study, R_g[1:], L_g[1:], 3e-3, 314.0, edges=True)
    assert only_stiff.edge.shape == (1, 1, 3)
    assert np.isnan(only_stiff.edge).all()
