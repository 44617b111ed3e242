"""Each method on signals made from phasors, where the answer is known to the last digit."""

from __future__ import annotations

import numpy as np
import pytest

from vsgdesign.estimator.baselines import (
    ConstantGuess,
    Estimates,
    ExtendedKalmanFilter,
    Injection,
    PseudoRandomSequence,
    Record,
    RecursiveLeastSquares,
    TwoWindows,
)
from vsgdesign.estimator.baselines.kalman import turn_grid
from vsgdesign.estimator.baselines.pseudo_random import binary_sequence
from vsgdesign.estimator.bound import SensorNoise
from vsgdesign.parameters.study import Grid

OMEGA = 100.0 * np.pi
H, N, W = 200e-6, 100, 40
V = 155.0
TRUE = Grid(0.9, 0.0029)
GUESS = Grid(1.2, 0.0037)


def record(i: np.ndarray, v: np.ndarray) -> Record:
    """Rotating (W·N,) signals as a record of one run."""
    turn = np.exp(1j * OMEGA * H * np.arange(W * N))
    truth = [np.full((1, W), value) for value in (TRUE.R_g, TRUE.L_g)]
    return Record(
        (v * turn)[None],
        (i * turn)[None],
        np.zeros((1, W, 2 * N)),
        np.array([OMEGA]),
        truth[0],
        truth[1],
        (SensorNoise(0.0, 0.0),),
        H,
        N,
        V,
        7.26,
        OMEGA,
    )


def z(omega: float | np.ndarray) -> np.ndarray:
    return np.asarray(TRUE.R_g + 1j * omega * TRUE.L_g)


def power_step() -> Record:
    """The current moves slowly from one value to another, the grid stands still; L di/dt included."""
    t = H * np.arange(W * N)
    share = 0.5 * (1.0 + np.tanh((t - 0.4) / 0.05))
    i = 12.0 + (3.0 - 1.0j) * share
    slope = (3.0 - 1.0j) * 0.5 / np.cosh((t - 0.4) / 0.05) ** 2 / 0.05
    return record(i, V + z(OMEGA) * i + TRUE.L_g * slope)


def close(found: Estimates, tolerance: float) -> None:
    R, L = found.R_g[0, -1], found.L_g[0, -1]
    assert abs(R + 1j * OMEGA * L - z(OMEGA)) < tolerance * abs(z(OMEGA))


def test_a_constant_stays() -> None:
    found = ConstantGuess(GUESS).estimate(power_step())
    assert np.all(found.R_g == GUESS.R_g)
    assert np.all(found.L_g == GUESS.L_g)


def test_two_windows_are_exact_on_a_step_and_keep_the_answer_after() -> None:
    i = np.where(np.arange(W * N) < 20 * N, 12.0, 15.0 - 1.0j)
    found = TwoWindows().estimate(record(i, V + z(OMEGA) * i))
    assert np.isnan(found.R_g[0, :20]).all()
    assert np.isfinite(found.R_g[0, 20:]).all()
    close(found, 1e-9)


def test_two_windows_give_minus_the_converter_where_the_grid_moves() -> None:
    """A converter that is a voltage behind Z_c, and a grid voltage that steps: ΔV/ΔI = −Z_c."""
    Z_c, E = 0.4 + 1.1j, 170.0
    V_g = np.where(np.arange(W * N) < 20 * N, V, 0.95 * V)
    i = (E - V_g) / (Z_c + z(OMEGA))
    found = TwoWindows().estimate(record(i, E - Z_c * i))
    assert found.R_g[0, -1] == pytest.approx(-0.4, rel=1e-6)
    assert OMEGA * found.L_g[0, -1] == pytest.approx(-1.1, rel=1e-6)


@pytest.mark.parametrize("method", [RecursiveLeastSquares(GUESS), ExtendedKalmanFilter(GUESS, drift=0.002)])
def test_recursive_methods_find_the_grid_on_a_power_step(method: RecursiveLeastSquares | ExtendedKalmanFilter) -> None:
    close(method.estimate(power_step()), 0.03)


def test_nothing_is_learnt_at_rest() -> None:
    """A steady window fits the guess as well as the truth: what is not seen stays."""
    i = np.full(W * N, 12.0 + 1.0j)
    found = RecursiveLeastSquares(GUESS).estimate(record(i, V + z(OMEGA) * i))
    assert found.R_g[0, -1] == pytest.approx(GUESS.R_g, rel=1e-3)
    assert found.L_g[0, -1] == pytest.approx(GUESS.L_g, rel=1e-3)


def test_injection_is_exact_between_whole_periods() -> None:
    method = Injection()
    line = 0.3 * np.exp(1j * method.slip() * H * np.arange(W * N))
    i = 12.0 + line
    found = method.estimate(record(i, V + z(OMEGA) * 12.0 + z(OMEGA + method.slip()) * line))
    assert np.isnan(found.R_g[0, 0])
    close(found, 1e-9)


def test_the_sequence_is_exact_and_blind_to_harmonics() -> None:
    method = PseudoRandomSequence()
    t = H * np.arange(W * N)
    i, v = np.full(W * N, 12.0 + 0j), V + z(OMEGA) * np.full(W * N, 12.0)
    rng = np.random.default_rng(0)
    for line in (*method.used_lines, *(-line for line in method.used_lines)):
        slip = 2.0 * np.pi * 50.0 / 3.0 * line
        wave = 0.05 * np.exp(1j * (slip * t + rng.uniform(0.0, 6.0)))
        i, v = i + wave, v + z(OMEGA + slip) * wave
    v = v + 5.0 * np.exp(-6j * OMEGA * t) + 3.0 * np.exp(6j * OMEGA * t)
    close(method.estimate(record(i, v)), 1e-9)


def test_the_sequence_is_binary_with_power_on_every_line() -> None:
    lines = PseudoRandomSequence().used_lines
    x = binary_sequence(60, lines)
    assert set(np.unique(x)) == {-1.0, 1.0}
    amplitude = np.abs(np.fft.fft(x))[list(lines)]
    assert amplitude.min() > 0.5 * np.sqrt(60.0)  # a white sequence has √60 on average


def test_the_filter_turns_the_grid_as_its_jacobian_says() -> None:
    x, h, step = np.array([[0.2, 0.1, 0.9, -0.3, 2.0]]), 0.01, 1e-6
    _, F = turn_grid(x, h)
    for column in range(5):
        moved = x.copy()
        moved[0, column] += step
        difference = (turn_grid(moved, h)[0] - turn_grid(x, h)[0])[0] / step
        assert F[0, :, column] == pytest.approx(difference, abs=1e-6)
