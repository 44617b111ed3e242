"""Each method on signals made from phasors, where the answer is known to the last digit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.identification.signals import (
    AT,
    GUESS,
    L_TRUE,
    OMEGA,
    R_TRUE,
    H,
    N,
    V,
    W,
    answers,
    error,
    power_step,
    windows_of,
    z,
)
from vsgdesign.identification import Estimate, Estimator
from vsgdesign.identification.classical import ConstantGuess, Injection, TwoWindows
from vsgdesign.identification.interface import ComplexArray
from vsgdesign.identification.pseudo_random import PseudoRandomSequence, binary_sequence
from vsgdesign.identification.recursive import ExtendedKalmanFilter, RecursiveLeastSquares, turn_grid


def test_a_constant_stays() -> None:
    assert {one[:2] for one in answers(ConstantGuess(AT), power_step())} == {GUESS}


def test_two_windows_are_exact_on_a_step_and_keep_the_answer_after() -> None:
    i = np.where(np.arange(W * N) < 20 * N, 12.0 + 0.0j, 15.0 - 1.0j)
    found = answers(TwoWindows(AT), windows_of(i, V + z(OMEGA) * i))
    assert {one.status for one in found[:20]} == {"waiting"}
    assert {one.status for one in found[20:30]} == {"ok"}
    assert {one.status for one in found[30:]} == {"held"}
    assert max(map(error, found[20:])) < 1e-9


def test_two_windows_give_minus_the_converter_where_the_grid_moves() -> None:
    """A converter that is a voltage behind Z_c, and a grid voltage that steps: ΔV/ΔI = −Z_c."""
    Z_c, E = 0.4 + 1.1j, 170.0
    V_g = np.where(np.arange(W * N) < 20 * N, V, 0.95 * V)
    i = ((E - V_g) / (Z_c + z(OMEGA))).astype(np.complex128)
    last = answers(TwoWindows(AT), windows_of(i, E - Z_c * i))[-1]
    assert last.R_g == pytest.approx(-0.4, rel=1e-6)
    assert OMEGA * last.L_g == pytest.approx(-1.1, rel=1e-6)


@pytest.mark.parametrize("method", [RecursiveLeastSquares(AT), ExtendedKalmanFilter(AT, drift=0.002)])
def test_recursive_methods_find_the_grid_on_a_power_step(method: Estimator) -> None:
    last = answers(method, power_step())[-1]
    assert error(last) < 0.03
    assert last.status == "ok"


@pytest.mark.parametrize("method", [RecursiveLeastSquares(AT), ExtendedKalmanFilter(AT)])
def test_nothing_is_learnt_at_rest_and_nothing_is_claimed(method: Estimator) -> None:
    """A steady window fits the guess as well as the truth: what is not seen stays, and is not to be followed."""
    i = np.full(W * N, 12.0 + 1.0j)
    last = answers(method, windows_of(i, V + z(OMEGA) * i))[-1]
    assert last.R_g == pytest.approx(GUESS[0], rel=1e-3)
    assert last.L_g == pytest.approx(GUESS[1], rel=1e-3)
    assert last.status == "uncertain"
    assert last.covariance is not None


def test_injection_is_exact_between_whole_periods() -> None:
    method = Injection(AT)
    turn: ComplexArray = np.exp(1j * method.slip * H * np.arange(W * N))
    line = 0.3 * turn
    i = 12.0 + line
    found = answers(method, windows_of(i, V + z(OMEGA) * 12.0 + z(OMEGA + method.slip) * line))
    assert found[0].status == "waiting"
    assert max(map(error, found[1:])) < 1e-9


def test_the_sequence_is_exact_and_blind_to_harmonics() -> None:
    method = PseudoRandomSequence(AT)
    t = H * np.arange(W * N, dtype=np.float64)
    i, v = np.full(W * N, 12.0, dtype=np.complex128), V + z(OMEGA) * np.full(W * N, 12.0)
    rng = np.random.default_rng(0)
    for line in (*method.used_lines, *(-line for line in method.used_lines)):
        slip = 2.0 * np.pi * 50.0 / 3.0 * line
        wave = 0.05 * np.exp(1j * (slip * t + rng.uniform(0.0, 6.0)))
        i, v = i + wave, v + z(OMEGA + slip) * wave
    v = v + 5.0 * np.exp(-6j * OMEGA * t) + 3.0 * np.exp(6j * OMEGA * t)
    found = answers(method, windows_of(i, v))
    assert {one.status for one in found[:5]} == {"waiting"}
    assert max(map(error, found[5:])) < 1e-9


def test_without_a_probe_nothing_answers_and_nothing_is_raised() -> None:
    """The current of a steady window has no line beside the fundamental: 0/0, or what rounding makes of it."""
    i = np.zeros(W * N, dtype=np.complex128)
    for method in (Injection(AT), PseudoRandomSequence(AT)):
        assert {one.status for one in answers(method, windows_of(i, V + i))} == {"waiting"}


def test_the_sequence_is_binary_with_power_on_every_line() -> None:
    lines = PseudoRandomSequence(AT).used_lines
    x = binary_sequence(60, lines)
    assert set(np.unique(x)) == {-1.0, 1.0}
    amplitude = np.abs(np.fft.fft(x))[list(lines)]
    assert amplitude.min() > 0.5 * np.sqrt(60.0)  # a white sequence has √60 on average


def test_the_published_probes() -> None:
    """50 Hz, windows of one cycle: 75 Hz over two cycles and a sequence of three, each value held for 1 ms."""
    injection, sequence = Injection(AT), PseudoRandomSequence(AT)
    assert (injection.title, injection.frequency_hz) == ("75 Hz injection", pytest.approx(75.0))
    assert (len(injection.line.values), len(sequence.sequence.values)) == (40, 60)
    assert injection.hold == sequence.hold == pytest.approx(1e-3)
    assert sequence.cycles == 3


def test_the_filter_turns_the_grid_as_its_jacobian_says() -> None:
    x, h, step = np.array([0.2, 0.1, 0.9, -0.3, 2.0]), 0.01, 1e-6
    _, F = turn_grid(x, h)
    for column in range(5):
        moved = x.copy()
        moved[column] += step
        difference = (turn_grid(moved, h)[0] - turn_grid(x, h)[0]) / step
        assert F[:, column] == pytest.approx(difference, abs=1e-6)


def _noisy(seed: int, method: Injection | PseudoRandomSequence, windows: int) -> Estimate:
    """Fed with the method's own lines and white noise on both space vectors; the last answer."""
    rng = np.random.default_rng(seed)
    count = windows * N
    t = H * np.arange(count, dtype=np.float64)
    if isinstance(method, Injection):
        slips = [method.slip]
    else:
        spacing = 2.0 * np.pi * 50.0 / 3.0
        slips = [sign * line * spacing for line in method.used_lines for sign in (1, -1)]
    i, v = np.full(count, 12.0, dtype=np.complex128), V + z(OMEGA) * np.full(count, 12.0, dtype=np.complex128)
    for k, slip in enumerate(slips):
        wave = 0.1 * np.exp(1j * (slip * t + k * k))
        i, v = i + wave, v + z(OMEGA + slip) * wave
    for x, sigma in ((v, method.at.noise[0]), (i, method.at.noise[1])):  # α and β have ⅔ σ² each
        x += sigma * np.sqrt(2.0 / 3.0) * (rng.normal(size=count) + 1j * rng.normal(size=count))
    return answers(method, windows_of(i, v))[-1]


@pytest.mark.parametrize(("kind", "windows"), [(Injection, 2), (PseudoRandomSequence, 6)])
def test_the_covariance_is_that_of_many_draws(kind: type, windows: int) -> None:
    """200 draws: a standard deviation is known within 5 % (1/√400), two of them are the tolerance and some."""
    method = kind(replace(AT, noise=(0.05, 0.01)), believed=10.0)
    found = [_noisy(seed, method, windows) for seed in range(200)]
    drawn = np.cov(np.array([one[:2] for one in found]).T)
    said = np.mean(np.array([one.covariance for one in found]), axis=0)
    for k, scale in enumerate((R_TRUE, L_TRUE)):
        assert np.sqrt(said[k, k]) == pytest.approx(np.sqrt(drawn[k, k]), rel=0.13), scale
