"""Scenarios of a cell: what the estimate may hide, and the static limits on the border."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.design.robust_studies import controller, robust_study, specification, with_specification
from vsgdesign.design.box import (
    Scenarios,
    scenarios_around_estimate,
    scenarios_of_estimate,
    scenarios_of_truth,
    scenarios_of_truths,
    within_limits,
)
from vsgdesign.equations.power_flow import operating_point, power_flow
from vsgdesign.study.parameters import Study
from vsgdesign.study.parameters.grid import Place

WIDE = with_specification(scr=(1.2, 20.0), x_over_r=(0.3, 20.0))
TARGET = controller(WIDE).target
GRIDS = st.tuples(st.floats(1.2, 20.0), st.floats(0.3, 20.0))


def of_truth(study: Study, scr: float, x_over_r: float) -> Scenarios:
    return scenarios_of_truth(study, specification(study), scr, x_over_r, TARGET.P, TARGET.Q)


def of_estimate(study: Study, scr: float, x_over_r: float) -> Scenarios:
    return scenarios_of_estimate(study, specification(study), scr, x_over_r, TARGET.P, TARGET.Q)


@given(GRIDS)
def test_every_scenario_is_an_operating_point_within_the_limits(grid: tuple[float, float]) -> None:
    s = of_truth(WIDE, *grid)
    if len(s) == 0:
        return
    P, Q = power_flow(s.delta, s.V_rms, s.V_g_rms, s.R, s.X)
    np.testing.assert_allclose(P, s.P, atol=1e-6 * 5e3)
    np.testing.assert_allclose(Q, s.Q, atol=1e-6 * 5e3)
    low, high = WIDE.converter.V_limits_rms
    assert ((s.V_rms >= low) & (s.V_rms <= high)).all()
    assert (3.0 * s.V_rms**2 / np.hypot(s.R, s.X) >= 1.3 * np.hypot(s.P, s.Q) * (1.0 - 1e-12)).all()
    assert np.abs(s.P).max() <= 4500.0
    assert np.abs(s.Q).max() <= 2000.0


@given(GRIDS)
def test_a_power_beyond_the_limits_is_drawn_in_until_it_lies_on_them(grid: tuple[float, float]) -> None:
    """24 halvings of the share: a part in 1e6 more is outside."""
    s = of_truth(WIDE, *grid)
    apparent = np.hypot(s.P, s.Q)
    drawn_in = [k for k in range(len(s)) if apparent[k] > 1.0 and not np.isclose(np.abs([s.P[k]]), [0.0, 4500.0]).any()]
    for k in drawn_in:
        more = {"P": s.P[k : k + 1] * (1.0 + 1e-6), "Q": s.Q[k : k + 1] * (1.0 + 1e-6)}
        one = s.take(np.array([k]))
        with np.errstate(invalid="ignore"):
            V_rms, delta = operating_point(more["P"], more["Q"], one.V_g_rms, one.R, one.X)
        beyond = Scenarios(
            one.R, one.X, one.R_hat, one.X_hat, one.V_g_rms, one.omega_g, more["P"], more["Q"], V_rms, delta
        )
        assert not within_limits(WIDE, beyond)[0]


def test_the_design_point_comes_first_and_without_error() -> None:
    s = of_truth(WIDE, 5.0, 2.0)
    assert (s.P[0], s.Q[0]) == (TARGET.P, TARGET.Q)
    assert (s.R[0], s.X[0]) == (s.R_hat[0], s.X_hat[0])
    grid = Place(5.0, 2.0, "impedance").grid(WIDE.converter)
    assert s.R[0] == pytest.approx(grid.R_g)
    assert s.X[0] == pytest.approx(grid.L_g * WIDE.converter.omega_n)


@given(st.floats(3.0, 12.0), st.floats(0.7, 8.0), st.sampled_from([-0.2, 0.2]), st.sampled_from([-0.2, 0.2]))
def test_what_an_estimate_is_designed_for_covers_the_truths_behind_it(
    scr: float, x_over_r: float, e_R: float, e_X: float
) -> None:
    """A true grid inside the table is estimated with error (e_R, e_X): the cell at the estimate has that very pair."""
    truth = Place(scr, x_over_r, "impedance").grid(WIDE.converter)
    omega = WIDE.converter.omega_n
    estimate = type(truth)(truth.R_g * (1.0 + e_R), truth.L_g * (1.0 + e_X))
    s = of_estimate(WIDE, estimate.scr(WIDE.converter, "impedance"), estimate.x_over_r(omega))
    there = np.isclose(s.R, truth.R_g) & np.isclose(s.X, omega * truth.L_g)
    there &= np.isclose(s.R_hat, estimate.R_g) & np.isclose(s.X_hat, omega * estimate.L_g)
    by_truth = of_truth(WIDE, scr, x_over_r)
    same = np.isclose(by_truth.R_hat, estimate.R_g) & np.isclose(by_truth.X_hat, omega * estimate.L_g)
    assert there.sum() == same.sum() > 0
    for name in ("P", "Q", "V_rms", "omega_g"):
        np.testing.assert_allclose(np.sort(getattr(s, name)[there]), np.sort(getattr(by_truth, name)[same]), rtol=1e-6)


def test_at_the_edge_the_estimate_beyond_it_is_covered_too() -> None:
    """A truth on the edge whose estimate lies beyond: the lookup is on the edge, with the estimated Jacobian."""
    s = of_estimate(WIDE, 20.0, 2.0)
    grid = Place(20.0, 2.0, "impedance").grid(WIDE.converter)
    at = np.isclose(s.R, grid.R_g) & np.isclose(s.R_hat, 0.8 * grid.R_g) & np.isclose(s.X_hat / s.X, 0.8)
    assert at.any()


@pytest.mark.parametrize(("scr", "x_over_r", "corners"), [(6.0, 2.0, 4), (1.2, 2.0, 2), (6.0, 0.3, 3), (1.2, 0.3, 2)])
def test_a_node_takes_on_what_lies_around_it(scr: float, x_over_r: float, corners: int) -> None:
    """Its own scenarios come first. The others are true grids within the table, with an estimate that is looked up
    within reach: found again by clipping the estimate to the table, which is what the runtime does."""
    spec = specification(WIDE)
    reach = (max(scr / 1.1, 1.2), scr * 1.1, max(x_over_r / 1.2, 0.3), x_over_r * 1.2)
    own = of_estimate(WIDE, scr, x_over_r)
    s = scenarios_around_estimate(WIDE, spec, scr, x_over_r, reach, TARGET.P, TARGET.Q)
    for f in fields(Scenarios):
        assert np.array_equal(getattr(s, f.name)[: len(own)], getattr(own, f.name)), f.name
    more = s.take(np.arange(len(own), len(s)))
    places = {"truth": (more.R, more.X), "estimate": (more.R_hat, more.X_hat)}
    slack = 1.0 + 1e-9
    for name, (R, X) in places.items():
        ratio, strength = X / R, WIDE.converter.Z_base / np.hypot(R, X)
        if name == "truth":
            assert (strength >= 1.2 / slack).all()
            assert (ratio >= 0.3 / slack).all()
        ratio, strength = np.clip(ratio, 0.3, 20.0), np.clip(strength, 1.2, 20.0)
        if name == "estimate":
            assert (strength >= reach[0] / slack).all()
            assert (strength <= reach[1] * slack).all()
            assert (ratio >= reach[2] / slack).all()
            assert (ratio <= reach[3] * slack).all()
    # Every error is within the specified one, also where it is drawn in to keep the truth in the table. At the edge
    # some of its corners would need a truth that is weaker or more resistive than the table's.
    errors = np.stack([s.R_hat / s.R, s.X_hat / s.X]) - 1.0
    assert np.abs(errors).max() <= 0.2 * slack
    found = np.unique(np.sign(errors[:, np.isclose(np.abs(errors), 0.2).all(axis=0)]), axis=1)
    assert found.shape[1] == corners
    beyond = WIDE.converter.Z_base / np.hypot(more.R_hat, more.X_hat) < 1.2 / slack
    assert beyond.any() == (scr == 1.2)


ANY_WAY = with_specification(scr=(1.2, 20.0), x_over_r=(0.3, 20.0), error_Z=0.06)


@given(GRIDS)
def test_every_error_of_so_much_in_any_direction_lies_within_the_corners(grid: tuple[float, float]) -> None:
    """Estimates around a true grid inside the table: those of ε|Z| in any direction, and ±20 % of each."""
    scr, x_over_r = grid
    s = of_truth(ANY_WAY, *grid)
    if len(s) < 2:
        return
    truth = Place(scr, x_over_r, "impedance").grid(ANY_WAY.converter)
    R, X = truth.R_g, ANY_WAY.converter.omega_n * truth.L_g
    angles = np.linspace(0.0, 2.0 * np.pi, 73)
    R_hat, X_hat = R + 0.06 * np.hypot(R, X) * np.cos(angles), X + 0.06 * np.hypot(R, X) * np.sin(angles)
    Z_base = ANY_WAY.converter.Z_base
    strength, ratio = Z_base / np.hypot(R_hat, X_hat), R_hat / X_hat
    inside = (strength > 1.2) & (strength < 20.0) & (ratio > 0.05) & (ratio < 1.0 / 0.3)
    slack = 1e-9 * np.hypot(R, X)
    corners = np.hypot(s.R_hat - R, s.X_hat - X) > 0.0
    if inside.all():  # else the corners are drawn into the table, as the scheduler draws them in
        assert R_hat.min() >= s.R_hat[corners].min() - slack
        assert R_hat.max() <= s.R_hat[corners].max() + slack
        assert X_hat.min() >= s.X_hat[corners].min() - slack
        assert X_hat.max() <= s.X_hat[corners].max() + slack


@given(GRIDS)
def test_what_the_gains_are_made_of_is_what_the_scheduler_makes_of_an_estimate(grid: tuple[float, float]) -> None:
    """R̂ of a grid with a large X/R may be negative: the scheduler's place is within the table, and so are these."""
    s = of_truth(ANY_WAY, *grid)
    strength, ratio = ANY_WAY.converter.Z_base / np.hypot(s.R_hat, s.X_hat), s.R_hat / s.X_hat
    slack = 1.0 + 1e-9
    assert ((strength >= 1.2 / slack) & (strength <= 20.0 * slack)).all()
    assert ((ratio >= 0.05 / slack) & (ratio <= slack / 0.3)).all()


@given(st.floats(2.0, 12.0), st.floats(0.6, 15.0), st.sampled_from([-1.0, 1.0]), st.sampled_from([-1.0, 1.0]))
def test_a_cell_covers_the_truths_whose_estimate_is_off_in_any_direction(
    scr: float, x_over_r: float, sign_R: float, sign_X: float
) -> None:
    """As above with ±20 %: the cell at the estimate has that very pair, unless the truth is not in the table."""
    truth = Place(scr, x_over_r, "impedance").grid(ANY_WAY.converter)
    omega = ANY_WAY.converter.omega_n
    R, X = truth.R_g, omega * truth.L_g
    widths = max(0.2 * R, 0.06 * np.hypot(R, X)), max(0.2 * X, 0.06 * np.hypot(R, X))
    estimate = type(truth)(R + sign_R * widths[0], (X + sign_X * widths[1]) / omega)
    ratio = estimate.x_over_r(omega)
    if not 0.3 < ratio < 20.0:
        return
    s = of_estimate(ANY_WAY, estimate.scr(ANY_WAY.converter, "impedance"), ratio)
    at = np.isclose(s.R, R, rtol=1e-6) & np.isclose(s.X, X, rtol=1e-6)
    at &= np.isclose(s.R_hat, estimate.R_g, rtol=1e-6) & np.isclose(s.X_hat, omega * estimate.L_g, rtol=1e-6)
    assert at.any()


@pytest.mark.parametrize(("scr", "x_over_r"), [(1.2, 5.0), (20.0, 5.0), (4.0, 20.0), (20.0, 20.0), (1.2, 0.3)])
def test_a_node_on_the_edge_has_the_estimates_that_are_drawn_to_it(scr: float, x_over_r: float) -> None:
    """Of true grids on the edge, more than the four corners about the node itself."""
    s = of_estimate(ANY_WAY, scr, x_over_r)
    place = Place(scr, x_over_r, "impedance").grid(ANY_WAY.converter)
    assert np.allclose(s.R_hat, place.R_g)
    omega = ANY_WAY.converter.omega_n
    assert np.allclose(s.X_hat, omega * place.L_g)
    off = np.abs([s.R_hat - s.R, s.X_hat - s.X]) / np.hypot(s.R, s.X)
    assert off.max() > 0.05


def test_without_error_there_is_one_pair() -> None:
    exact = with_specification(error_R=0.0, error_X=0.0)
    s = of_estimate(exact, 4.0, 2.0)
    np.testing.assert_allclose(s.R, s.R_hat, rtol=1e-12)
    np.testing.assert_allclose(s.X, s.X_hat, rtol=1e-12)
    # The design point, and P × Q of the limits with zero between: 1 + 9.
    assert len(s) <= 10


def test_no_scenario_where_the_source_alone_is_beyond_the_voltage_limits() -> None:
    """At no load V is the source's: 110 V · 1.5 is above 1.25 pu whatever the power."""
    sagging = with_specification(V_g_rms=(165.0,))
    s = of_truth(sagging, 10.0, 2.0)
    assert np.isclose(s.V_g_rms, 110.0).sum() <= 1
    assert len(s) <= 1


def test_take_keeps_every_column_in_order() -> None:
    s = of_truth(robust_study(), 4.0, 2.0)
    part = s.take(np.array([3, 1]))
    for f in fields(Scenarios):
        assert getattr(part, f.name).tolist() == [getattr(s, f.name)[3], getattr(s, f.name)[1]]


def test_many_grids_at_once_are_the_same_as_one_by_one() -> None:
    rng = np.random.default_rng(3)
    grids = np.exp(rng.uniform(np.log([1.2, 0.3]), np.log([20.0, 20.0]), (20, 2))).tolist()
    together = scenarios_of_truths(WIDE, specification(WIDE), grids, TARGET.P, TARGET.Q)
    assert len(together) == len(grids)
    for grid, found in zip(grids, together, strict=True):
        alone = of_truth(WIDE, *grid)
        for field in fields(Scenarios):
            np.testing.assert_array_equal(getattr(found, field.name), getattr(alone, field.name))
