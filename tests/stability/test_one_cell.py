"""What one cell of a map asks for: some margins, steps by modes, all movements of modes, gains that are held."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from vsgdesign.linear.model.coupled import INPUTS, OUTPUTS
from vsgdesign.linear.operating_point.full_order import FullOrderModel, parameter_sensitivities, parameter_sensitivity
from vsgdesign.linear.stability.loci import RANKED, mode_movements, mode_sensitivities
from vsgdesign.linear.stability.maps import (
    CellSet,
    cells_under,
    full_order_cells,
    gains_in_force,
    grid_arrays,
    reduced_cells,
)
from vsgdesign.linear.stability.margins import MARGINS, full_order_margins, margins_named, reduced_margins
from vsgdesign.linear.stability.step_responses import full_order_settling, full_order_step, reduced_step
from vsgdesign.metrics.step_response import SETTLING_BAND, settling_time, settling_times
from vsgdesign.report.explore.maps import quick_figures
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study


@pytest.fixture(scope="module")
def study() -> Study:
    return load_study("studies/utility/study.toml")


@pytest.fixture(scope="module")
def cells(study: Study) -> CellSet:
    R_g, L_g = grid_arrays(study, np.array([1.5, 4.0, 15.0]), np.array([0.8, 6.0]))
    return cells_under(study, gain_law(study, study.controllers[0]), R_g, L_g, 0.4e6, 0.1e6)


@pytest.fixture(scope="module")
def model(study: Study, cells: CellSet) -> FullOrderModel:
    return full_order_cells(study, cells)


def test_margins_by_name_are_those_of_the_table(study: Study, cells: CellSet, model: FullOrderModel) -> None:
    for one, table in ((model, full_order_margins(model)), (reduced_cells(study, cells), None)):
        whole = reduced_margins(reduced_cells(study, cells)) if table is None else table
        for name in MARGINS:
            alone = margins_named(one, [name])
            assert alone.keys() == {name}
            for column in alone[name].__dataclass_fields__:
                np.testing.assert_array_equal(getattr(alone[name], column), getattr(getattr(whole, name), column))
    with pytest.raises(ValueError, match=r"names = \['M'\]: must be of disk_output"):
        margins_named(model, ["M"])


def test_steps_of_the_reduced_model_are_exact(study: Study, cells: CellSet) -> None:
    reduced = reduced_cells(study, cells)
    for signal in "PQ":
        t, y = reduced_step(reduced, f"{signal}_ref", signal, 1.5, 5e-3)
        column, row = INPUTS.index(f"{signal}_ref"), OUTPUTS.index(signal)
        for k, A in enumerate(reduced.A):
            b, c, d = reduced.B[k, :, column], reduced.C[k, row], reduced.D[k, row, column]
            for at in (0, 1, 40, 300):
                # A⁻¹ (e^{At} − I) b is the state after a step, by SciPy's exponential.
                expected = c @ np.linalg.solve(A, (expm(A * t[at]) - np.eye(len(A))) @ b) + d
                assert y[k, at] == pytest.approx(expected, abs=1e-9)


def test_all_movements_are_the_sensitivities_of_each_mode(model: FullOrderModel) -> None:
    each = np.array([parameter_sensitivity(model, 1, name) for name in RANKED])
    together = parameter_sensitivities(model, 1, RANKED)
    for one, alone in zip(together, each, strict=True):  # equal but for rounding of the steady state's movement
        np.testing.assert_allclose(one, alone, atol=1e-9 * np.abs(alone).max())
    movements = mode_movements(model, 1)
    for s in movements.s[np.argsort(-movements.s.real)][:3]:
        listed = mode_sensitivities(model, 1, s)[:4]
        for (name, change), expected in zip(movements.strongest(s, 4), listed, strict=True):
            assert name == expected.parameter
            assert change == pytest.approx(expected.relative, rel=1e-6)


def test_settling_times_are_those_of_each_response(model: FullOrderModel) -> None:
    rng = np.random.default_rng(0)
    t = 0.1 * np.arange(60, dtype=np.float64)
    error = np.exp(-t * rng.uniform(0.05, 3.0, (12, 1))) * np.abs(np.cos(t * rng.uniform(0.0, 9.0, (12, 1))))
    error[3] = 0.0
    expected = [settling_time(t, row, SETTLING_BAND) for row in error]
    assert None in expected
    assert expected[3] == 0.0
    found = settling_times(np.full(12, 0.1), error, SETTLING_BAND)
    np.testing.assert_allclose(found, [np.inf if one is None else one for one in expected], rtol=1e-12)
    # And of the sampled model, at every sample.
    settling, overshoot = full_order_settling(model, "P_ref", "P")
    t, y = full_order_step(model, "P_ref", "P", 30.0, 4)
    for k, response in enumerate(y):
        exact = settling_time(t, np.abs(response / response[-1] - 1.0), SETTLING_BAND)
        assert settling[k] == pytest.approx(exact, rel=1e-3)
        # The network's mode rings in the first milliseconds, where 4000 points are 1 to 5 ms apart.
        assert overshoot[k] == pytest.approx(max(response.max() / response[-1] - 1.0, 0.0), abs=1e-3)


def test_gains_in_force(study: Study) -> None:
    law = gain_law(study, study.controllers[1])
    near, far = Grid(0.05, 1e-3), Grid(0.02, 2e-4)
    P, Q = 0.4e6, 0.0
    own = gains_in_force(study, law, near.R_g, near.L_g, P, Q)
    held = gains_in_force(study, law, far.R_g, far.L_g, P, Q, held=near)
    wrong = gains_in_force(study, law, near.R_g, near.L_g, P, Q, error=(0.1, -0.2))
    assert held == own
    assert wrong == gains_in_force(study, law, 1.1 * near.R_g, 0.8 * near.L_g, P, Q)
    assert own != gains_in_force(study, law, far.R_g, far.L_g, P, Q)


def test_an_unknown_figure_is_refused(study: Study, cells: CellSet) -> None:
    with pytest.raises(ValueError, match='figure = "margin": must be one of disk_margin'):
        quick_figures(study, cells, "margin")
