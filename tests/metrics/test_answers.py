"""Figures of an estimator's answers, on hand-made rows of 20 ms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vsgdesign.metrics.answers import (
    Answers,
    answers_of,
    coverage,
    inside_ellipse,
    share_valid,
    time_to_stay,
    valid_and_wrong,
)

T = 0.02 * np.arange(1, 101)
CHANGE = 1.01
"""Within the cycle that ends at 1.02 s: the answer of row 50 is the first one after it."""


def made(
    error: np.ndarray | float = 0.0, valid: np.ndarray | bool = True, changed: np.ndarray | bool = False
) -> Answers:
    Z = np.where(T < CHANGE, 2.0 + 2.0j, 1.0 + 1.0j)
    n = len(T)
    return Answers(
        t_s=np.asarray(T, dtype=np.float64),
        Z=Z,
        Z_hat=np.asarray(Z * (1.0 + np.broadcast_to(error, n)), dtype=np.complex128),
        covariance=np.tile(np.eye(2), (n, 1, 1)),
        valid=np.broadcast_to(valid, n).copy(),
        changed=np.broadcast_to(changed, n).copy(),
        end_s=2.01,
    )


def test_found_for_good() -> None:
    error, valid = np.zeros(100), np.ones(100, dtype=bool)
    error[50:54] = 1.0  # 1.02 to 1.08 s
    error[56] = 0.11  # 1.14 s: lost again
    assert time_to_stay(made(error), CHANGE, 2.0) == pytest.approx(1.16 - CHANGE)
    valid[56] = False  # not valid: it does not lose the grid
    assert time_to_stay(made(error, valid), CHANGE, 2.0) == pytest.approx(1.10 - CHANGE)
    valid[54:58] = False  # and does not find it
    assert time_to_stay(made(error, valid), CHANGE, 2.0) == pytest.approx(1.18 - CHANGE)
    error[98] = 0.5
    assert time_to_stay(made(error), CHANGE, 1.99) == math.inf
    assert time_to_stay(made(error), CHANGE, 1.98) < 0.2
    assert time_to_stay(made(valid=False), CHANGE, 2.0) == math.inf


def test_no_number_finds_nothing() -> None:
    error = np.full(100, np.nan)
    error[60:] = 0.0
    assert time_to_stay(made(error), CHANGE, 2.0) == pytest.approx(T[60] - CHANGE)


def test_error_is_of_the_vector() -> None:
    answers = made()
    turned = Answers(**{**vars(answers), "Z_hat": answers.Z * 1j})
    assert turned.error == pytest.approx(math.sqrt(2.0))


def test_coverage_of_gaussian_errors_is_the_level() -> None:
    """Errors drawn from the covariance that is stated; and a covariance that is half of it."""
    rng, n = np.random.default_rng(1), 20_000
    P = np.array([[2.0, -1.2], [-1.2, 1.5]])
    off = rng.multivariate_normal([0.0, 0.0], P, n)
    made_of = {
        "t_s": np.arange(1.0, n + 1.0), "Z": np.full(n, 5.0 + 5.0j), "Z_hat": 5.0 + off[:, 0] + 1j * (5.0 + off[:, 1]),
        "valid": np.ones(n, dtype=bool), "changed": np.zeros(n, dtype=bool), "end_s": n + 1.0,
    }  # fmt: skip
    everything = np.ones(n, dtype=bool)
    right = Answers(**made_of, covariance=np.tile(P, (n, 1, 1)))
    # Three standard deviations of a share of 20,000.
    assert coverage(right, everything) == pytest.approx(0.95, abs=0.0047)
    assert coverage(right, everything, 0.5) == pytest.approx(0.5, abs=0.011)
    # 1 − exp(−χ²/4) with χ² = −2 ln 0.05.
    half = Answers(**made_of, covariance=np.tile(0.5 * P, (n, 1, 1)))
    assert coverage(half, everything) == pytest.approx(1.0 - 0.05**0.5, abs=0.009)
    assert not inside_ellipse(Answers(**made_of, covariance=np.full((n, 2, 2), np.nan))).any()
    assert math.isnan(coverage(right, ~everything))


def test_valid_and_wrong_in_time() -> None:
    error, valid = np.zeros(100), np.ones(100, dtype=bool)
    error[50:55], error[70] = 0.5, 0.25  # in force 1.02 to 1.12 s, and 1.42 to 1.44 s
    one = valid_and_wrong(made(error), 0.0, 2.0, [CHANGE])
    assert one.seconds == pytest.approx(1.12 - (CHANGE + 0.04) + 0.02)
    assert one.worst == pytest.approx(0.5)
    valid[51:55] = False  # what remains lies within the grace
    two = valid_and_wrong(made(error, valid), 0.0, 2.0, [CHANGE])
    assert (two.seconds, two.worst) == (pytest.approx(0.02), pytest.approx(0.25))
    # Two graces that overlap, and one that begins before the range.
    three = valid_and_wrong(made(error), 1.04, 2.0, [1.01, 1.03, 1.05])
    assert three.seconds == pytest.approx(1.12 - 1.09 + 0.02)
    assert valid_and_wrong(made(error), 0.0, 2.0, [], above=0.6).seconds == 0.0


def test_an_answer_across_an_event_counts_up_to_it() -> None:
    error = np.zeros(100)
    error[49] = 0.5  # in force 1.00 to 1.02 s; the event at 1.01 s
    assert valid_and_wrong(made(error), 0.0, 2.0, [CHANGE]).seconds == pytest.approx(0.01)


def test_the_share_of_time_with_a_valid_answer() -> None:
    valid = np.ones(100, dtype=bool)
    valid[50:55] = False
    valid[60] = False
    answers = made(valid=valid)
    assert share_valid(answers, 0.0, 2.0) == pytest.approx(1.0 - (0.02 + 0.12) / 2.0)  # no answer before 0.02 s
    with pytest.raises(ValueError, match=r"until_s = 1 s.*begin_s = 1 s"):
        share_valid(answers, 1.0, 1.0)


def test_series_of_inductances() -> None:
    omega = 2.0 * np.pi * 60.0
    ones = np.ones(3)
    answers = answers_of(
        [0.1, 0.2, 0.3], (ones, 1e-3 * ones), ([1.0, 1.0, np.nan], 2e-3 * ones), (4.0 * ones, 1e-3 * ones, 1e-6 * ones),
        [1.0, 0.0, 1.0], [0.0, 0.0, 1.0], omega_n=omega, end_s=0.4,
    )  # fmt: skip
    assert answers.error[0] == pytest.approx(omega * 1e-3 / math.hypot(1.0, omega * 1e-3))
    assert answers.covariance[0] == pytest.approx(np.array([[4.0, omega * 1e-3], [omega * 1e-3, omega**2 * 1e-6]]))
    assert answers.valid.tolist() == [True, False, False]  # a valid answer is a number
    assert answers.changed.tolist() == [False, False, True]


def test_bad_answers_are_refused_with_all_faults() -> None:
    good = vars(made())
    with pytest.raises(ValueError, match=r"Z has the shape \(99,\).*valid has the shape \(98,\)"):
        Answers(**{**good, "Z": good["Z"][:-1], "valid": good["valid"][:-2]})
    with pytest.raises(ValueError, match="ascend"):
        Answers(**{**good, "t_s": T[::-1]})
    with pytest.raises(ValueError, match=r"end_s = 1 s is before the last answer, 2 s"):
        Answers(**{**good, "end_s": 1.0})
