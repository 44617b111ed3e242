"""Maps: marked cells instead of holes, fields that equal single cells, axes in order, both models where they agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.stability.studies import LABORATORY, PUBLISHED, case_study, designed, situation
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.operating_point.full_order import Cell
from vsgdesign.linear.stability.maps import (
    MODELS,
    MarginMap,
    cell_set,
    estimate_error_map,
    full_order_cells,
    margin_map,
    reduced_cells,
    stale_schedule_matrix,
)
from vsgdesign.linear.stability.margins import MarginTable, full_order_margins, reduced_margins
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.grid import Grid, Place

Array = NDArray[np.float64]

SCR, RATIO = (1.2, 2.0, 5.0, 20.0), (0.2, 0.3, 1.0, 3.0, 12.0)
P_AXIS, Q_AXIS = (-2000.0, 4500.0), (0.0, 1000.0, 1800.0)


@pytest.fixture(scope="module")
def study() -> Study:
    return case_study(PUBLISHED)


@pytest.fixture(scope="module", params=MODELS)
def a_map(request: pytest.FixtureRequest, study: Study) -> MarginMap:
    law = gain_law(study, study.controllers[0])
    return margin_map(study, law, SCR, RATIO, P_AXIS, Q_AXIS, request.param)


def columns(table: MarginTable) -> dict[str, Array]:
    """Every scalar column by name."""
    found = {name: getattr(table, name) for name in ("spectral_abscissa", "least_damping", "least_damped_rad_s")}
    for group in ("disk_output", "disk_input", "M_s", "loop_P", "loop_Q"):
        part = getattr(table, group)
        found |= {f"{group}.{name}": getattr(part, name) for name in part.__dataclass_fields__}
    return found


def test_every_cell_is_analysed_or_says_why_not(study: Study, a_map: MarginMap) -> None:
    """Reasons where the power flow has no root (its discriminant) or the schedule no gains; NaN just there."""
    assert a_map.shape == (4, 5, 6)
    assert len(a_map.faults) == 120
    c, V_g = study.converter, study.grid_source.V_g_rms
    faults = np.array(a_map.faults, dtype=object).reshape(a_map.shape)
    missing = {"no operating point": 0, "no gains": 0}
    for i, scr in enumerate(SCR):
        for j, ratio in enumerate(RATIO):
            for k, (P, Q) in enumerate((P, Q) for P in P_AXIS for Q in Q_AXIS):
                X = c.Z_base / scr
                Z = complex(X / ratio, X)

                def carries(P: float, Q: float, Z: complex = Z) -> bool:
                    b_0 = 2.0 * (Z.real * P + Z.imag * Q) / 3.0 + V_g**2
                    return b_0 * b_0 > 4.0 * abs(Z) ** 2 * (P * P + Q * Q) / 9.0

                fault = faults[i, j, k]
                if not carries(P, Q):
                    assert fault.startswith("no operating point"), fault
                    assert f"{P / 1e3:.4g} kW" in fault
                    missing["no operating point"] += 1
                elif not carries(study.target.P, study.target.Q):
                    assert "no gains" in fault
                    missing["no gains"] += 1
                elif fault is not None:
                    assert a_map.model == "full_order"
                    assert "limit" in fault or "steady state" in fault or "bridge" in fault, fault
    assert missing["no operating point"] >= 4, missing
    marked = np.array([fault is not None for fault in a_map.faults]).reshape(a_map.shape)
    np.testing.assert_array_equal(np.isnan(a_map.stable), marked)
    np.testing.assert_array_equal(np.isnan(a_map.field(a_map.table.spectral_abscissa)), marked)
    assert len(a_map.analysed) == np.sum(~marked) == len(a_map.table.stable)


def test_unstable_cells_have_modes_but_no_margins(a_map: MarginMap) -> None:
    stable = a_map.stable
    assert np.sum(stable == 1.0) > 20
    assert np.sum(stable == 0.0) > 5
    for name, values in columns(a_map.table).items():
        field = a_map.field(values)
        if "." in name:
            assert np.isnan(field[stable == 0.0]).all(), name
        else:
            assert np.isfinite(field[~np.isnan(stable)]).all(), name
    for group in ("disk_output", "disk_input", "M_s"):
        assert np.isfinite(a_map.field(getattr(a_map.table, group).value)[stable == 1.0]).all()
    assert np.all((a_map.field(a_map.table.spectral_abscissa) < 0.0)[stable == 1.0])


def test_fields_are_single_cells(study: Study, a_map: MarginMap) -> None:
    """Ten cells analysed alone, with gains made for their grid: every figure to 1e-6, its frequency to 1e-4."""
    rng = np.random.default_rng(1)
    fields = {name: a_map.field(values) for name, values in columns(a_map.table).items()}
    good = np.argwhere(~np.isnan(a_map.stable))
    for i, j, k in good[rng.choice(len(good), 10, replace=False)]:
        grid = Place(SCR[i], RATIO[j], study.scr_basis).grid(study.converter)
        P, Q = P_AXIS[k // len(Q_AXIS)], Q_AXIS[k % len(Q_AXIS)]
        cells = cell_set(study, grid.R_g, grid.L_g, P, Q, designed(study, grid))
        if a_map.model == "reduced":
            alone = reduced_margins(reduced_cells(study, cells))
        else:
            alone = full_order_margins(full_order_cells(study, cells))
        for name, values in columns(alone).items():
            where = name.endswith(("omega", "rad_s"))
            np.testing.assert_allclose(
                fields[name][i, j, k], values[0], rtol=1e-4 if where else 1e-6, err_msg=f"{name} at {i, j, k}"
            )


def test_axes_are_in_order(study: Study, a_map: MarginMap) -> None:
    """SCR, X/R, then (P, Q) with P slowest; the cells carry the grids that the axes say."""
    names = [name for name, _ in a_map.axes]
    assert names == ["SCR", "X/R", "P, Q"]
    np.testing.assert_array_equal(a_map.axes[0][1], SCR)
    np.testing.assert_array_equal(a_map.axes[1][1], RATIO)
    shape = a_map.shape
    X = study.converter.omega_n * a_map.cells.L_g.reshape(shape)
    np.testing.assert_allclose(study.converter.Z_base / X, np.broadcast_to(np.array(SCR)[:, None, None], shape))
    np.testing.assert_allclose(
        X / a_map.cells.R_g.reshape(shape), np.broadcast_to(np.array(RATIO)[None, :, None], shape)
    )
    np.testing.assert_array_equal(a_map.cells.P.reshape(shape)[0, 0], np.repeat(P_AXIS, 3))
    np.testing.assert_array_equal(a_map.cells.Q.reshape(shape)[0, 0], np.tile(Q_AXIS, 2))


@pytest.mark.parametrize("model", MODELS)
def test_the_diagonal_of_a_stale_schedule_is_the_map(study: Study, model: str) -> None:
    """And off it, one entry by hand: gains of one grid on another; rows are true grids."""
    law, scr = gain_law(study, study.controllers[0]), (2.0, 6.0, 20.0)
    stale = stale_schedule_matrix(study, law, scr, 1.0, 3000.0, 500.0, model)
    fresh = margin_map(study, law, scr, (1.0,), (3000.0,), (500.0,), model)
    for name, values in columns(stale.table).items():
        diagonal = np.diag(stale.field(values))
        rtol = 1e-4 if name.endswith(("omega", "rad_s")) else 1e-6
        np.testing.assert_allclose(diagonal, fresh.field(columns(fresh.table)[name])[:, 0, 0], rtol=rtol, err_msg=name)
    assert [name for name, _ in stale.axes] == ["true SCR", "SCR of the gains"]
    true, thought = (Place(x, 1.0, study.scr_basis).grid(study.converter) for x in (20.0, 2.0))
    cells = cell_set(study, true.R_g, true.L_g, 3000.0, 500.0, designed(study, thought))
    alone = (
        reduced_margins(reduced_cells(study, cells))
        if model == "reduced"
        else full_order_margins(full_order_cells(study, cells))
    )
    assert stale.field(stale.table.least_damping)[2, 0] == pytest.approx(alone.least_damping[0], rel=1e-8)
    assert stale.field(stale.table.least_damping)[0, 2] != pytest.approx(alone.least_damping[0], rel=1e-2)


@pytest.mark.parametrize("model", MODELS)
def test_no_estimate_error_is_the_map(study: Study, model: str) -> None:
    """At zero error; and one entry with errors by hand: e_R comes before e_L."""
    law, errors = gain_law(study, study.controllers[0]), (-0.2, 0.0, 0.3)
    scr, ratio = (3.0, 10.0), (0.6, 2.0)
    wrong = estimate_error_map(study, law, scr, ratio, errors, 3000.0, 500.0, model)
    assert wrong.shape == (2, 2, 3, 3)
    assert [name for name, _ in wrong.axes] == ["SCR", "X/R", "error of R_g", "error of L_g"]
    fresh = margin_map(study, law, scr, ratio, (3000.0,), (500.0,), model)
    for name, values in columns(wrong.table).items():
        rtol = 1e-4 if name.endswith(("omega", "rad_s")) else 1e-6
        centre = wrong.field(values)[:, :, 1, 1]
        np.testing.assert_allclose(centre, fresh.field(columns(fresh.table)[name])[:, :, 0], rtol=rtol, err_msg=name)
    true = Place(10.0, 0.6, study.scr_basis).grid(study.converter)
    gains = designed(study, Grid(true.R_g * 0.8, true.L_g * 1.3))
    cells = cell_set(study, true.R_g, true.L_g, 3000.0, 500.0, gains)
    assert wrong.cells.gains.K_ip.reshape(wrong.shape)[1, 0, 0, 2] == pytest.approx(gains.K_ip, rel=1e-12)
    if model == "reduced":
        alone = reduced_margins(reduced_cells(study, cells))
        assert wrong.field(wrong.table.M_s.value)[1, 0, 0, 2] == pytest.approx(alone.M_s.value[0], rel=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_a_map_without_a_single_good_cell(study: Study, model: str) -> None:
    """Reasons everywhere and no crash."""
    law = gain_law(study, study.controllers[0])
    empty = margin_map(study, law, (0.1, 0.15), (1.0, 5.0), (4500.0,), (1000.0,), model)
    assert all(fault is not None for fault in empty.faults)
    assert np.isnan(empty.stable).all()
    assert empty.table.disk_output.value.shape == (0,)


def test_an_unknown_model_is_named(study: Study) -> None:
    with pytest.raises(ValueError, match='"sampled": must be one of reduced, full_order'):
        margin_map(study, gain_law(study, study.controllers[0]), (2.0,), (1.0,), (0.0,), (0.0,), "sampled")


@pytest.mark.parametrize(
    ("case", "scr", "ratio"),
    [
        (PUBLISHED, 2.0, 1.0),
        (PUBLISHED, 10.0, 0.5),
        (LABORATORY, 5.0, 1.0),
        (LABORATORY, 12.0, 3.0),
    ],
)
def test_both_models_agree_in_the_slow_modes(case: str, scr: float, ratio: float) -> None:
    """Power loops slow against inner loops and network: each reduced mode has a full-order one within 2 % of its size.

    A design for 8 s: 0.5 rad/s against inner loops and network of more than 50. The difference falls with the design's
    speed, which the second, twice as slow, design shows.
    """
    study = case_study(case)
    grid = Place(scr, ratio, study.scr_basis).grid(study.converter)
    # A double mode would part by the root of any difference.
    errors = []
    for settling in (8.0, 16.0):
        gains = designed(study, grid, settling, damping_ratio=0.7)
        P, Q = 0.3 * study.converter.S_rated, 0.05 * study.converter.S_rated
        cells = cell_set(study, grid.R_g, grid.L_g, P, Q, gains)
        slow = np.linalg.eigvals(reduced_cells(study, cells).A[0])
        full = full_order_cells(study, cells)
        modes = np.log(np.linalg.eigvals(full.A[0]).astype(complex)) / full.T_s
        errors.append(max(float(np.abs(modes - s).min() / abs(s)) for s in slow))
    print(f"{case}, SCR {scr}, X/R {ratio}: {errors[0]:.1e}, {errors[1]:.1e}")
    assert errors[0] < 0.02
    assert errors[1] < 0.6 * errors[0]


def test_full_order_cells_sit_where_they_were_asked_to(study: Study) -> None:
    """(P, Q) at the control point in spite of both droops and a grid off nominal."""
    off = replace(study, grid_source=replace(study.grid_source, omega_g=1.0004 * study.converter.omega_n))
    grid = Place(4.0, 1.5, off.scr_basis).grid(off.converter)
    gains = designed(off, grid)
    full = full_order_cells(off, cell_set(off, grid.R_g, grid.L_g, 2500.0, 700.0, gains))
    outputs = np.array(full.map.step(full.z[0], full.p[0])[1]).ravel()
    # The sampled steady state is a hair off the continuous one: sampling leaves 1e-4 of V.
    assert outputs[0] == pytest.approx(2500.0, abs=0.5)
    assert outputs[1] == pytest.approx(700.0, abs=2.0)
    own = situation(off, Cell(grid, PowerLoopGains(*gains), 2500.0, 700.0))
    assert np.array(own.model.map.step(own.model.z[0], own.model.p[0])[1]).ravel()[0] < 2400.0  # droop, uncompensated
