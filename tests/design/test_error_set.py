"""The error set of an estimate: its half-widths, and the true grids behind an estimate."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsgdesign.certificate.error_bounds import truth_behind
from vsgdesign.equations.grid import MOST_ERROR_Z, error_half_widths
from vsgdesign.runtime.schedule import on_floats

ANGLES = st.floats(0.05, 1.52)
ERRORS = st.tuples(st.floats(0.0, 0.5), st.floats(0.0, 0.5), st.floats(0.0, MOST_ERROR_Z))


def test_the_larger_of_both_kinds_counts() -> None:
    """At X/R 10 ±20 % of R is 2 % of |Z|; at X/R 1 both are 14 %."""
    R, X = np.array([1.0, 1.0]), np.array([10.0, 1.0])
    w_R, w_X = error_half_widths(R, X, 0.2, 0.2, 0.06)
    np.testing.assert_allclose(w_R, [0.06 * np.sqrt(101.0), 0.2])
    np.testing.assert_allclose(w_X, [2.0, 0.2])
    assert on_floats(error_half_widths)(1.0, 10.0, 0.2, 0.2, 0.06) == (w_R[0], w_X[0])


@given(ANGLES, ERRORS, st.floats(0.0, 2.0 * np.pi))
def test_the_box_holds_every_error_of_so_much_in_any_direction(
    angle: float, errors: tuple[float, float, float], direction: float
) -> None:
    R, X = 3.0 * np.cos(angle), 3.0 * np.sin(angle)
    w_R, w_X = error_half_widths(R, X, *errors)
    assert abs(errors[2] * 3.0 * np.cos(direction)) <= w_R * (1.0 + 1e-12)
    assert abs(errors[2] * 3.0 * np.sin(direction)) <= w_X * (1.0 + 1e-12)
    assert w_R >= errors[0] * R
    assert w_X >= errors[1] * X


@given(ANGLES, ERRORS)
def test_what_is_behind_an_estimate_has_that_estimate(angle: float, errors: tuple[float, float, float]) -> None:
    """The estimate of the truth that is found is the one it was found from, where its R and X are positive."""
    R_hat, X_hat = 2.0 * np.cos(angle), 2.0 * np.sin(angle)
    for sign_R in (-1.0, 0.0, 1.0):
        for sign_X in (-1.0, 0.0, 1.0):
            R, X = truth_behind(R_hat, X_hat, sign_R, sign_X, *errors)
            if R <= 0.0 or X <= 0.0:
                continue
            w_R, w_X = error_half_widths(R, X, *errors)
            assert R + sign_R * w_R == pytest.approx(R_hat, rel=1e-12)
            assert X + sign_X * w_X == pytest.approx(X_hat, rel=1e-12)


@given(st.tuples(st.floats(1.2, 20.0), ANGLES), st.floats(0.0, 0.3), st.floats(0.0, 1.0), st.floats(0.0, 2.0 * np.pi))
def test_clipping_to_a_box_keeps_an_error_of_Z(
    grid: tuple[float, float], error_Z: float, share: float, direction: float
) -> None:
    """The scheduler clips SCR (of |Z|) and X/R; the true grid lies in the box, at its edge or within."""
    size, angle = 1.0 / grid[0], grid[1]
    truth = size * np.exp(1j * angle)
    estimate = truth + share * error_Z * size * np.exp(1j * direction)
    if estimate.imag <= 0.0:
        return
    for low, high in ((size, 1.0), (1.0 / 20.0, size), (1.0 / 20.0, 1.0)):
        for least, most in ((angle, 1.52), (0.05, angle), (0.05, 1.52)):
            clipped = np.clip(abs(estimate), low, high) * np.exp(1j * np.clip(np.angle(estimate), least, most))
            assert abs(clipped - truth) <= share * error_Z * size * (1.0 + error_Z**2 / 8.0) + 1e-12


@given(ANGLES, ERRORS, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_every_truth_of_an_estimate_lies_between_the_four_that_are_off_most(
    angle: float, errors: tuple[float, float, float], share_R: float, share_X: float
) -> None:
    R, X = np.cos(angle), np.sin(angle)
    w_R, w_X = error_half_widths(R, X, *errors)
    R_hat, X_hat = R + share_R * w_R, X + share_X * w_X
    if X_hat <= 0.0:
        return
    corners = [truth_behind(R_hat, X_hat, a, b, *errors) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
    for value, found in ((R, [c[0] for c in corners]), (X, [c[1] for c in corners])):
        assert min(found) - 1e-12 <= value <= max(found) + 1e-12
