"""Operating points under the Q–V droop against a scan over all voltages."""

from __future__ import annotations

import numpy as np
from scipy.optimize import root_scalar

from tests.operating_point.test_equilibrium import random_grid
from vsgdesign.equations.power_flow import power_flow
from vsgdesign.linear.operating_point.equilibrium import points_with_droop


def scanned_voltage(P: float, Q_ref: float, D_q: float, V_n: float, V_g: float, R: float, X: float) -> float:
    """The highest V at which grid and droop agree, NaN if none: the angle that delivers P on the stable side is known
    for each V, and the last change of sign over 400 voltages is closed in."""
    Z = np.hypot(R, X)

    def angle(V: np.ndarray) -> np.ndarray:
        ratio = (P * Z * Z / 3.0 - R * V * V) / (Z * V * V_g)
        inside = np.abs(ratio) <= 1.0 + 1e-12
        return np.where(inside, np.arctan2(R, X) + np.arcsin(np.clip(ratio, -1.0, 1.0)), np.nan)

    def surplus(V: np.ndarray) -> np.ndarray:
        return Q_ref + D_q * (V_n - V) - power_flow(angle(V), V, V_g, R, X)[1]

    reach = V_g + np.sqrt(max(V_g * V_g + 4.0 * R * P / 3.0, 0.0))
    low = max(2.0 * Z * abs(P) / 3.0 / reach, 1e-3 * V_g)
    high = min(0.5 * Z * reach / R if R > 0.0 else np.inf, 4.0 * max(V_g, V_n))
    grid = low + (high - low) * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 400)))
    values = surplus(grid)
    signs = np.isfinite(values[:-1]) & np.isfinite(values[1:]) & (values[:-1] * values[1:] <= 0.0)
    if not signs.any():
        return np.nan
    k = int(np.flatnonzero(signs)[-1])
    return float(root_scalar(surplus, bracket=(grid[k], grid[k + 1]), xtol=1e-13 * V_n, rtol=1e-15).root)


def test_the_highest_voltage_is_that_of_a_scan() -> None:
    """Weak and strong, resistive and lossless grids; droops from none to 100 times the rating per rated voltage."""
    rng, rows = np.random.default_rng(5), []
    for k in range(400):
        V_g, S, R, X = random_grid(rng, (0.01, 100.0))
        P, Q, droop = rng.uniform(-0.6, 0.9) * S, rng.uniform(-0.4, 0.5) * S, 10.0 ** rng.uniform(-6.0, 2.0) * S / V_g
        rows.append((P, Q, droop, V_g * rng.uniform(0.9, 1.1), V_g, 0.0 if k % 10 == 0 else R, X))
    expected = np.array([scanned_voltage(*row) for row in rows])
    lanes = np.array(rows).T
    V, delta = points_with_droop(*lanes)
    assert 15 < np.isnan(expected).sum() < 100
    np.testing.assert_array_equal(np.isnan(V), np.isnan(expected))
    # Both know V to some 1e-14; over 4,000 draws the worst difference is 3e-14.
    np.testing.assert_allclose(V, expected, rtol=1e-12)
    good = ~np.isnan(V)
    P_is, Q_is = power_flow(delta, V, lanes[4], lanes[5], lanes[6])
    size = 3.0 * lanes[4] ** 2 / np.hypot(lanes[5], lanes[6])
    wanted = lanes[1] + lanes[2] * (lanes[3] - V)
    np.testing.assert_allclose((P_is / size)[good], (lanes[0] / size)[good], rtol=0.0, atol=1e-12)
    error = np.abs(Q_is - wanted)[good] / (size + lanes[2] * lanes[3])[good]
    assert np.max(error) < 1e-13


def test_lanes_with_and_without_droop_and_without_sense() -> None:
    ones = np.ones(5)
    D_q = np.array([0.0, 5.0, 5.0, np.nan, 5.0])
    V_g = np.array([110.0, 110.0, 0.0, 110.0, np.inf])
    V, delta = points_with_droop(2000.0 * ones, 0.0 * ones, D_q, 110.0, V_g, 0.5 * ones, 2.0 * ones)
    assert np.isfinite(V[:2]).all()
    assert np.isfinite(delta[:2]).all()
    assert np.isnan(V[2:]).all()
    assert np.isnan(delta[2:]).all()
