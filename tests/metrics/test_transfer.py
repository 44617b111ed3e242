"""Transfer matrices of many cells against SciPy, against inverses, and where modes lie decades apart."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from vsgdesign.linear.stability.loops import TransferMatrix

Array = NDArray[np.float64]


def random_systems(rng: np.random.Generator, n: int, count: int) -> tuple[Array, Array, Array]:
    """Systems with modes over three decades: random diagonal blocks behind a random change of basis."""
    A = np.zeros((count, n, n))
    for k in range(count):
        j = 0
        while j < n:
            size = 10.0 ** rng.uniform(-0.5, 2.5)
            if j + 1 < n and rng.random() < 0.5:
                zeta = rng.uniform(-0.3, 1.0)
                A[k, j : j + 2, j : j + 2] = size * np.array([[-zeta, 1.0], [-(1.0 - zeta**2) - 0.01, -zeta]])
                j += 2
            else:
                A[k, j, j] = -size if rng.random() < 0.8 else 0.0
                j += 1
        T = np.eye(n) + 0.3 * rng.standard_normal((n, n))
        A[k] = T @ A[k] @ np.linalg.inv(T)
    return A, rng.standard_normal((count, n, 2)), rng.standard_normal((count, 2, n))


@pytest.mark.parametrize("n", range(1, 7))
def test_values_against_inverses(n: int) -> None:
    """Both ways of evaluation, 70 systems (more than one chunk), 60 frequencies over six decades.

    1e-12 of the sum of the moduli of what C (sI − A)⁻¹ B adds up (measured 1e-14).
    """
    rng = np.random.default_rng(n)
    A, B, C = random_systems(rng, n, 70)
    C[:, 0, 0] = 0.0  # a column that is left out in one row only
    omega = np.geomspace(1e-2, 1e4, 60)
    system = TransferMatrix(A, B, C)
    together = system.on(1j * omega)
    assert together.shape == (70, 60, 2, 2)
    worst = 0.0
    for k in range(70):
        inverse = np.linalg.inv(1j * omega[:, None, None] * np.eye(n) - A[k])
        expected, scale = C[k] @ inverse @ B[k], np.abs(C[k]) @ np.abs(inverse) @ np.abs(B[k])
        worst = max(worst, float(np.max(np.abs(together[k] - expected)[scale > 0] / scale[scale > 0])))
        alone = system.at(np.full(len(omega), k), 1j * omega)
        np.testing.assert_allclose(alone, together[k], rtol=1e-12, atol=1e-12 * np.abs(together[k]).max())
    print(f"n = {n}: {worst:.1e}")
    assert worst < 1e-12


@pytest.mark.parametrize("n", range(1, 7))
def test_values_against_scipy(n: int) -> None:
    """signal.freqresp of every input and output, from state space by way of polynomials: 1e-6 of the largest value."""
    rng = np.random.default_rng(20 + n)
    A, B, C = random_systems(rng, n, 6)
    omega = np.geomspace(1e-1, 1e3, 40)
    values = TransferMatrix(A, B, C).on(1j * omega)
    for k in range(6):
        for column in range(2):
            num, den = signal.ss2tf(A[k], B[k], C[k], np.zeros((2, 2)), input=column)
            for row in range(2):
                _, expected = signal.freqresp((num[row, 1:], den), omega)
                got = values[k, :, row, column]
                np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_modes_decades_apart_cost_nothing() -> None:
    """Power loops of 1 rad/s behind two filters of 0.1 ms: to 1e-12 of the product of lags.

    Polynomials in s by the Faddeev–LeVerrier recursion are wrong by 100 % here.
    """
    tau, d, q, k_p, k_q = 1e-4, 0.4, 0.01, 0.002, 0.06
    A = np.zeros((1, 5, 5))
    A[0, 0, 1], A[0, 1, 1], A[0, 1, 3] = 1.0, -d, -k_p
    A[0, 2, 2], A[0, 2, 4] = -q, -k_q
    A[0, 3, 3] = A[0, 4, 4] = -1.0 / tau
    B, C = np.zeros((1, 5, 2)), np.zeros((1, 2, 5))
    B[0, 3, 0] = B[0, 4, 1] = 1.0 / tau
    C[0, 0, 0] = C[0, 1, 2] = 1.0
    omega = np.geomspace(1e-3, 1e4, 50)
    K = TransferMatrix(A, B, C).on(1j * omega)[0]
    s = 1j * omega
    lag = 1.0 / (1.0 + tau * s)
    np.testing.assert_allclose(K[:, 0, 0], -k_p / (s * (s + d)) * lag, rtol=1e-12)
    np.testing.assert_allclose(K[:, 1, 1], -k_q / (s + q) * lag, rtol=1e-12)
    assert np.all(K[:, 0, 1] == 0.0)
    assert np.all(K[:, 1, 0] == 0.0)


def test_integrators() -> None:
    """A = 0: C B/s."""
    system = TransferMatrix(np.zeros((1, 2, 2)), np.eye(2)[None], np.array([[[1.0, 2.0], [3.0, 4.0]]]))
    np.testing.assert_allclose(system.on(np.array([2.0j]))[0, 0], np.array([[1.0, 2.0], [3.0, 4.0]]) / 2.0j)
