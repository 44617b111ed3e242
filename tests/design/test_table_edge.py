"""Error sets at a table's edge: what is seen of a grid, and every grid behind what is seen, lies within corners."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.design.robust_studies import specification, with_specification
from tests.examples import examples
from vsgdesign.certificate.error_bounds import truth_behind
from vsgdesign.design.table_edge import TableEdge, table_edge
from vsgdesign.equations.grid import SCR_BASES, error_half_widths

SIGNS = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)]).T
TABLES = st.builds(
    lambda basis, counted, ratio, error, error_Z: TableEdge(SCR_BASES[basis], counted, ratio, (error, error, error_Z)),
    st.sampled_from(["impedance", "reactance"]),
    st.sampled_from([(0.05, 0.8), (0.1, 0.25)]),
    st.sampled_from([(0.05, 3.0), (0.3, 1.5)]),
    st.sampled_from([0.05, 0.2]),
    st.sampled_from([0.0, 0.06, 0.15]),
)


def clipped(table: TableEdge, R: Any, X: Any) -> tuple[Any, Any]:
    """As the scheduler does: SCR and R/X each to their limits."""
    scr = np.clip(table.basis.scr(R, X, 1.0, 1.0), 1.0 / table.counted[1], 1.0 / table.counted[0])
    return table.basis.grid(scr, 1.0 / np.clip(R / X, *table.r_over_x), 1.0, 1.0)


def extent(table: TableEdge, R: Any, X: Any) -> np.ndarray:
    """R, X, SCR and R/X of grids, (4, ...), in the logarithm."""
    return np.log(np.array([R, X, table.basis.scr(R, X, 1.0, 1.0), R / X]))


def truths(table: TableEdge, rng: np.random.Generator, count: int) -> tuple[Any, Any]:
    """True grids of a table, every second on its edge."""
    limits = np.log([table.counted, table.r_over_x])
    at = rng.uniform(limits[:, 0], limits[:, 1], (count, 2))
    for k in range(0, count, 2):
        axis = rng.integers(2)
        at[k, axis] = limits[axis, rng.integers(2)]
    size, ratio = np.exp(at).T
    return table.basis.grid(1.0 / size, 1.0 / ratio, 1.0, 1.0)


def drawn_in(table: TableEdge, R_hat: Any, X_hat: Any) -> tuple[Any, Any]:
    """Behind places, with the errors of each corner as far as they leave the grid in the table, (K, 4) each."""
    low, high = np.zeros((len(R_hat), 4)), np.ones((len(R_hat), 4))
    low[in_table(table, *behind(table, R_hat, X_hat, high))] = 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        inside = in_table(table, *behind(table, R_hat, X_hat, middle))
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return behind(table, R_hat, X_hat, low)


def behind(table: TableEdge, R_hat: Any, X_hat: Any, share: Any) -> tuple[Any, Any]:
    """The grids behind places with a share of the errors of each corner, (K, 4)."""
    shares = [share * error for error in table.errors]
    return truth_behind(R_hat[:, None], X_hat[:, None], *SIGNS, *shares)


def in_table(table: TableEdge, R: Any, X: Any) -> Any:
    size, ratio = table.basis.counted(R, X), R / X
    within = (ratio >= table.r_over_x[0] * (1.0 - 1e-9)) & (ratio <= table.r_over_x[1] * (1.0 + 1e-9))
    return within & (size >= table.counted[0] * (1.0 - 1e-9)) & (size <= table.counted[1] * (1.0 + 1e-9))


@examples(20)
@given(TABLES, st.integers(0, 1000))
def test_all_that_is_seen_of_a_grid_lies_within_the_corners(table: TableEdge, seed: int) -> None:
    """In R, X, SCR and R/X, of estimates anywhere in the error set, most of them on its sides."""
    rng = np.random.default_rng(seed)
    for R, X in zip(*truths(table, rng, 6), strict=True):
        w_R, w_X = error_half_widths(R, X, *table.errors)
        share_R, share_X = np.clip(rng.uniform(-1.5, 1.5, (2, 300)), -1.0, 1.0)
        seen = extent(table, *clipped(table, R + share_R * w_R, X + share_X * w_X))
        corners = np.array([R, X])[:, None] + SIGNS * np.array([w_R, w_X])[:, None]
        points = np.hstack([corners, np.array(table.seen_beside_corners(R, X)).reshape(-1, 2).T])
        held = extent(table, *clipped(table, *points))
        assert (seen >= held.min(axis=1, keepdims=True) - 1e-9).all()
        assert (seen <= held.max(axis=1, keepdims=True) + 1e-9).all()


def test_a_corner_that_is_clipped_leaves_a_crossing_on_each_side() -> None:
    """SCR 16, X/R 9, ±20 % or 6 % of |Z|: both corners with the least R̂ are beyond the table (SCR 20, X/R 20), and
    clipped they have a larger R̂. The least R̂ itself lies between them."""
    study = with_specification(scr=(1.2, 20.0), x_over_r=(0.3, 20.0), error_Z=0.06)
    table, c = table_edge(study, specification(study)), study.converter
    R, X = (float(value) for value in SCR_BASES["impedance"].grid(16.0, 9.0, c.Z_base, 1.0))
    least, _ = R - 0.06 * np.hypot(R, X), X
    corners = clipped(table, np.array([least, least]), np.array([0.8 * X, 1.2 * X]))[0]
    assert (corners > 1.003 * least).all()
    seen = clipped(table, *np.array(table.seen_beside_corners(R, X)).T)[0]
    assert seen.min() == pytest.approx(least, rel=1e-12)


@examples(10)
@given(TABLES, st.integers(0, 1000))
def test_every_grid_lies_within_those_that_its_estimate_is_designed_for(table: TableEdge, seed: int) -> None:
    """Grids and errors are drawn, and the estimates are clipped: the place where each is looked up knows of it."""
    rng = np.random.default_rng(seed)
    R, X = truths(table, rng, 40)
    w_R, w_X = error_half_widths(R, X, *table.errors)
    share_R, share_X = np.clip(rng.uniform(-1.5, 1.5, (2, 40)), -1.0, 1.0)
    R_hat, X_hat = clipped(table, R + share_R * w_R, X + share_X * w_X)
    assert table.may_be_seen_at(R, X, R_hat, X_hat).all()
    known = drawn_in(table, R_hat, X_hat)
    for k, points in enumerate(table.truths_seen_at(R_hat, X_hat, *known)):
        corners = np.hstack([np.array(known)[:, k], np.array(points).reshape(-1, 2).T])
        held, there = extent(table, *corners), extent(table, R[k], X[k])
        # Beyond the largest X/R, the border is an arc of which five points are taken.
        slack = 1e-8 if R_hat[k] / X_hat[k] > table.r_over_x[0] * (1.0 + 1e-9) else 2e-4
        assert (there >= held.min(axis=1) - slack).all()
        assert (there <= held.max(axis=1) + slack).all()


@examples(5)
@given(TABLES, st.integers(0, 1000))
def test_every_grid_on_the_edge_that_is_designed_for_may_be_seen_there(table: TableEdge, seed: int) -> None:
    """An estimate on a fine net over its error set is clipped to the place, as nearly as the net allows."""
    rng = np.random.default_rng(seed)
    R_hat, X_hat = truths(table, rng, 4)
    net = np.linspace(-1.0, 1.0, 321)
    for k, points in enumerate(table.truths_seen_at(R_hat, X_hat, *drawn_in(table, R_hat, X_hat))):
        for R, X in points:
            w_R, w_X = (float(width) for width in error_half_widths(R, X, *table.errors))
            seen = clipped(table, *np.meshgrid(R + net * w_R, X + net * w_X))
            far = np.hypot(seen[0] - R_hat[k], seen[1] - X_hat[k]).min()
            assert far <= 0.01 * np.hypot(w_R, w_X)
