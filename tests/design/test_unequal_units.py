"""What a spread of the units takes from a proof for equal ones (:eq:`plant-unequal`): against the eigenvalues of whole
plants, by their own equations in phasors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import fsolve

Array = NDArray[np.float64]

OWN, GRID, V_N, POWER = 0.157 + 1.326j, 0.837 + 4.184j, 230.9, 6.25e3
"""Of one unit of studies/plant: its transformer with the filter, and the grid at SCR 3 times the units on line, Ω."""

LAG, CORNER = 3.84j, 34.56
"""Transient impedance, Ω, and its corner, rad/s."""

GAINS = np.array([3.42e-4, -1.32e-5, 1.007e-3, -3.9e-5, -1.29e-4, 3.388e-3])
"""k_P, k_Q, K_ip, K_pq, K_qp, K_iq of its table there."""

DROOPS = np.array([795.8, 1082.5])


class Spread(NamedTuple):
    """Factors of rating and reactance (N,) and of gains (6, N)."""

    rating: Array
    path: Array
    gains: Array


def equal(count: int) -> Spread:
    return Spread(np.ones(count), np.ones(count), np.ones((6, count)))


def drawn(count: int, size: float, rng: np.random.Generator) -> Spread:
    return Spread(*(1.0 + size * rng.choice([-1.0, 1.0], shape) for shape in (count, count, (6, count))))


def matrix(units: Spread) -> Array:
    """The power loops of a plant about its rest, by central differences, (5N, 5N) over scaled states."""
    r, count = units.rating, len(units.rating)
    own, lag = OWN * units.path / r, LAG / r
    grid = np.full((count, count), GRID / count)
    k_P, k_Q, K_ip, K_pq, K_qp, K_iq = GAINS[:, None] * units.gains / r
    D_p, D_q = DROOPS[:, None] * r

    def powers(y: Array) -> Array:
        v = y[count:] * np.exp(1j * y[:count])
        S = 3.0 * v * np.conj(np.linalg.solve(np.diag(own) + grid, v - V_N))
        return np.concatenate([S.real / r - POWER, S.imag / r]) / POWER

    def rates(x: Array) -> Array:
        delta, omega_i, V, i_d, i_q = x.reshape(count, 5).T
        turn, i_f = np.exp(1j * delta), i_d + 1j * i_q
        behind = (V + lag * i_f) * turn
        i = np.linalg.solve(np.diag(own + lag) + grid, behind - V_N)
        S, change = 3.0 * (behind - lag * i) * np.conj(i), CORNER * (i / turn - i_f)
        omega = omega_i - k_P * S.real - k_Q * (S.imag + D_q * V)
        e_P, e_Q = -S.real - D_p * omega, -S.imag - D_q * V
        rows = omega, K_ip * e_P + K_pq * e_Q, K_qp * e_P + K_iq * e_Q, change.real, change.imag
        return np.stack(rows, axis=1).ravel()

    found = fsolve(powers, np.concatenate([np.full(count, 0.3), np.full(count, V_N)]), xtol=1e-13)
    delta, V = found[:count], found[count:]
    i = np.linalg.solve(np.diag(own) + grid, V * np.exp(1j * delta) - V_N) * np.exp(-1j * delta)
    rest = np.stack([delta, np.zeros(count), V, i.real, i.imag], axis=1).ravel()
    size = np.tile([1.0, 4.0, V_N, 18.0, 18.0], count)
    steps = 1e-5 * np.diag(size)
    columns = [(rates(rest + h) - rates(rest - h)) / 2e-5 for h in steps]
    return np.stack(columns, axis=1) / size[:, None]


def decay_of(A: Array) -> float:
    return -float(np.linalg.eigvals(A).real.max())


@pytest.mark.parametrize("count", [2, 4, 8])
def test_a_spread_takes_no_more_than_its_bound(count: int) -> None:
    """Of 10 plants each. The bound grows in proportion to the spread, leaves a decay at 2 %, and no plant is slower."""
    A = matrix(equal(count))
    blocks = A.reshape(count, 5, count, 5)
    apart = blocks[0, :, 0] - blocks[0, :, 1]
    common = blocks[0, :, 0] + (count - 1) * blocks[0, :, 1]
    alpha = min(decay_of(common), decay_of(apart))
    assert alpha == pytest.approx(decay_of(A), rel=1e-4)
    claimed, mean = 0.9 * alpha, np.full((count, count), 1.0 / count)
    P_c, P_d = (solve_continuous_lyapunov((one + claimed * np.eye(5)).T, -np.eye(5)) for one in (common, apart))
    root = np.linalg.cholesky(np.kron(mean, P_c) + np.kron(np.eye(count) - mean, P_d)).T
    back = np.linalg.inv(root)

    def most(matrix: Array) -> float:
        turned = root @ matrix @ back
        return float(np.linalg.eigvalsh(0.5 * (turned + turned.T))[-1])

    assert most(A) <= -claimed + 1e-4  # V decays as claimed under equal units
    rng, taken = np.random.default_rng(count), {}
    for size in (0.01, 0.02, 0.1):
        plants = [matrix(drawn(count, size, rng)) for _ in range(10)]
        lost = [most(plant - A) for plant in plants]
        assert all(decay_of(plant) >= claimed - one for plant, one in zip(plants, lost, strict=True))
        assert all(most(plant) <= one - claimed + 1e-4 for plant, one in zip(plants, lost, strict=True))
        taken[size] = max(lost)
    assert claimed > taken[0.02] > taken[0.01] > 0.0
    assert taken[0.1] == pytest.approx(10.0 * taken[0.01], rel=0.5)
