"""A place: SCR, X/R and what the ratio is taken on, to R_g and L_g on a converter's base and back."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.design.robust_studies import robust_study
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.errors import UnknownNameError
from vsgdesign.study.parameters.grid import Grid, Place

CONVERTER = robust_study().converter
RNG = np.random.default_rng(3)


@pytest.mark.parametrize("basis", SCR_BASES)
def test_there_and_back(basis: str) -> None:
    for scr, ratio in RNG.uniform((0.5, 0.1), (30.0, 20.0), (20, 2)):
        there = Place(float(scr), float(ratio), basis)
        back = there.grid(CONVERTER).place(CONVERTER, basis)
        assert (back.scr, back.x_over_r) == pytest.approx((scr, ratio), rel=1e-13)
        assert back.basis == basis


def test_the_definition_of_each_basis() -> None:
    """SCR is V_ll²/(S·|Z_g|) or V_ll²/(S·X_g), by complex numbers."""
    c = CONVERTER
    for basis, count in (("impedance", abs), ("reactance", lambda Z: Z.imag)):
        grid = Place(4.0, 2.5, basis).grid(c)
        Z = complex(grid.R_g, c.omega_n * grid.L_g)
        V_ll = math.sqrt(3.0) * c.V_rated_rms
        assert V_ll**2 / (c.S_rated * count(Z)) == pytest.approx(4.0, rel=1e-12)
        assert Z.imag / Z.real == pytest.approx(2.5, rel=1e-12)


@pytest.mark.parametrize("basis", SCR_BASES.values(), ids=lambda basis: basis.name)
def test_one_meaning_in_every_form(basis) -> None:
    """What is counted of (R, X), its inverse by the angle, and SCR agree."""
    for R, X in RNG.uniform(0.1, 3.0, (20, 2)):
        counted = basis.counted(R, X)
        assert basis.magnitude(counted, X / math.hypot(R, X)) == pytest.approx(math.hypot(R, X), rel=1e-14)
        assert basis.scr(R, X / 314.0, 7.0, 314.0) == pytest.approx(7.0 / counted, rel=1e-14)
        assert basis.counts_resistance == (counted != X)


@pytest.mark.parametrize("basis", SCR_BASES)
def test_a_grid_without_resistance(basis: str) -> None:
    grid = Place(5.0, math.inf, basis).grid(CONVERTER)
    assert grid.R_g == 0.0
    assert grid.place(CONVERTER, basis) == Place(pytest.approx(5.0), math.inf, basis)  # type: ignore[arg-type]


def test_an_unknown_basis_is_refused_by_name() -> None:
    with pytest.raises(UnknownNameError, match=r"admittance.*impedance, reactance"):
        Place(5.0, 2.0, "admittance")
    with pytest.raises(UnknownNameError, match="SCR basis"):
        Grid(1.0, 1e-3).scr(CONVERTER, "admittance")
