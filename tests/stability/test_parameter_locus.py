"""Loci over any parameter: against cells solved afresh, and their slope against the sensitivities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from vsgdesign.linear.model.full_order import PARAMETERS
from vsgdesign.linear.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.linear.stability.loci import mode_sensitivities, parameter_locus
from vsgdesign.runtime import closed_form_schedule
from vsgdesign.study.parameters import Grid, load_study

STUDY = load_study("studies/laboratory/study.toml")
GAINS = closed_form_schedule(STUDY, STUDY.target).gains(STUDY.grid.R_g, STUDY.grid.L_g)
CELL = Cell(STUDY.grid, GAINS, 4e3, 0.0)


@pytest.fixture(scope="module")
def model():
    return linearise_full_order(STUDY, [CELL])


def slow(eigenvalues: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """The modes below 1000 rad/s, in a fixed order: the fast ones have nothing to do with what is moved here."""
    kept = eigenvalues[np.abs(eigenvalues) < 1e3]
    return kept[np.lexsort((kept.imag, kept.real.round(3)))]


@pytest.mark.parametrize("parameter", ["L_g", "R_g", "K_ip", "D_q", "P_ref"])
def test_every_point_is_that_of_a_cell_solved_afresh(model, parameter: str) -> None:
    own = float(model.p[0, PARAMETERS.index(parameter)])
    values = own * np.array([0.5, 0.8, 1.0, 1.3, 2.0])
    loci = parameter_locus(model, 0, parameter, values)
    assert np.isfinite(loci.real).any(axis=1).all()
    for value, found in zip(values, loci, strict=True):
        cell = CELL
        if parameter in ("L_g", "R_g"):
            cell = replace(CELL, grid=Grid(**{"R_g": STUDY.grid.R_g, "L_g": STUDY.grid.L_g, parameter: value}))
        elif parameter == "P_ref":
            cell = replace(CELL, P_ref=value)
        else:
            cell = replace(CELL, gains=GAINS._replace(**{parameter: value}))
        fresh = linearise_full_order(STUDY, [cell])
        expected = np.log(np.linalg.eigvals(fresh.A[0]).astype(complex)) / fresh.T_s
        # Two solvers of the same fixed point; eigenvalues of a 15 × 15 matrix over a sampling period of 50 µs.
        np.testing.assert_allclose(slow(found), slow(expected), atol=1e-5)


def test_its_slope_is_the_sensitivity(model) -> None:
    value = float(model.p[0, PARAMETERS.index("K_pv")])
    h = 1e-4 * value
    loci = parameter_locus(model, 0, "K_pv", [value - h, value, value + h])
    k = int(np.argmin(np.abs(loci[1])))
    slope = (loci[2, k] - loci[0, k]) / (2.0 * h)
    (expected,) = mode_sensitivities(model, 0, complex(loci[1, k]), ["K_pv"])
    assert slope == pytest.approx(expected.ds_dp, rel=1e-4)


def test_it_ends_where_no_steady_state_is_left(model) -> None:
    """No grid carries 4 kW through hundreds of ohms."""
    loci = parameter_locus(model, 0, "L_g", [STUDY.grid.L_g, 1000.0 * STUDY.grid.L_g])
    assert np.isfinite(loci[0].real).any()
    assert np.isnan(loci[1].real).all()


def test_an_unknown_parameter_is_named(model) -> None:
    with pytest.raises(ValueError, match="must be one of L_1"):
        parameter_locus(model, 0, "gain", [1.0])
