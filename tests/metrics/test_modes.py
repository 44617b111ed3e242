"""Participation, damping and sensitivities against what they must be."""

from __future__ import annotations

import numpy as np
import pytest

from vsgdesign.metrics.modes import damping_ratio, eigenvalue_sensitivity, participation_factors, to_continuous


@pytest.mark.parametrize("n", [1, 2, 5, 12, 20])
def test_participation_of_every_mode_sums_to_one(n: int) -> None:
    rng = np.random.default_rng(n)
    A = rng.standard_normal((7, n, n))
    eigenvalues, shares = participation_factors(A)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-13)
    assert shares.min() >= 0.0
    for k in range(7):
        np.testing.assert_allclose(
            np.sort_complex(eigenvalues[k]), np.sort_complex(np.linalg.eigvals(A[k])), rtol=1e-10
        )


def test_participation_is_the_sensitivity_to_the_diagonal() -> None:
    """p_ki = ∂λ_i/∂a_kk: by central differences of the eigenvalues (measured 2e-9), normalised as the factors are."""
    rng = np.random.default_rng(1)
    A, h = rng.standard_normal((6, 6)), 1e-6
    eigenvalues, shares = participation_factors(A)
    raw = np.empty((6, 6))
    for k in range(6):
        moved = []
        for sign in (1.0, -1.0):
            B = A.copy()
            B[k, k] += sign * h
            found = np.linalg.eigvals(B)
            moved.append(np.array([found[np.argmin(np.abs(found - value))] for value in eigenvalues]))
        raw[k] = np.abs(moved[0] - moved[1]) / (2.0 * h)
    np.testing.assert_allclose(shares, raw / raw.sum(axis=0), atol=1e-7)


def test_participation_does_not_depend_on_units_or_order() -> None:
    """States in other units (T A T⁻¹, T diagonal) and in another order: the same shares, permuted."""
    rng = np.random.default_rng(2)
    A = rng.standard_normal((8, 8))
    T, order = np.diag(10.0 ** rng.uniform(-4.0, 4.0, 8)), rng.permutation(8)
    eigenvalues, shares = participation_factors(A)
    for B, rows in ((T @ A @ np.linalg.inv(T), np.arange(8)), (A[order[:, None], order], order)):
        others, shares_B = participation_factors(B)
        match = [int(np.argmin(np.abs(others - value))) for value in eigenvalues]
        assert sorted(match) == list(range(8))
        np.testing.assert_allclose(shares_B[:, match], shares[rows], atol=1e-9)


def test_participation_of_uncoupled_states_is_the_identity() -> None:
    eigenvalues, shares = participation_factors(np.diag([-1.0, -2.0, 5.0]))
    np.testing.assert_array_equal(eigenvalues, [-1.0, -2.0, 5.0])
    np.testing.assert_array_equal(shares, np.eye(3))


def test_sensitivity_against_central_differences() -> None:
    """Batched, along random directions (measured 4e-9 of the largest)."""
    rng = np.random.default_rng(3)
    A, dA, h = rng.standard_normal((5, 6, 6)), rng.standard_normal((5, 6, 6)), 1e-6
    eigenvalues, derivatives = eigenvalue_sensitivity(A, dA)
    for k in range(5):
        up, down = (np.linalg.eigvals(A[k] + sign * h * dA[k]) for sign in (1.0, -1.0))
        for value, got in zip(eigenvalues[k], derivatives[k], strict=True):
            expected = (up[np.argmin(np.abs(up - value))] - down[np.argmin(np.abs(down - value))]) / (2.0 * h)
            assert abs(got - expected) < 1e-7 * np.abs(derivatives[k]).max()


def test_damping_ratio() -> None:
    s = np.array([-3.0 + 4.0j, 3.0 - 4.0j, -2.0, 2.0, 0.0, 5.0j, complex(-np.inf, 0.0)])
    np.testing.assert_allclose(damping_ratio(s), [0.6, -0.6, 1.0, -1.0, 1.0, 0.0, 1.0], atol=1e-15)


def test_to_continuous_undoes_sampling() -> None:
    """e^{sT} of modes below the Nyquist frequency come back; z = 0 is gone at once."""
    rng = np.random.default_rng(4)
    T_s = 1e-4
    s = rng.uniform(-2e4, 500.0, 50) + 1j * rng.uniform(-0.99, 0.99, 50) * np.pi / T_s
    np.testing.assert_allclose(to_continuous(np.exp(s * T_s), T_s), s, rtol=1e-9, atol=1e-9 / T_s)
    assert to_continuous(np.array([0.0]), T_s)[0] == complex(-np.inf, 0.0)
    assert to_continuous(np.array([1.0]), T_s)[0] == 0.0
