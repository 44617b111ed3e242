"""The field estimator's recursions: one text in plain Python, compiled and in C."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests.codegen.compiled import Compiled
from tests.codegen.machine import Machine
from tests.compilers import require_compiler
from tests.equations.test_three_ways import flat
from vsgdesign.codegen import c_functions
from vsgdesign.codegen.records import record_like
from vsgdesign.equations.field import (
    FieldTrack,
    LockIn,
    conclude,
    features,
    first_lock_in,
    first_track,
    listen,
    probe_value,
)
from vsgdesign.identification.field import field_settings

OMEGA = 2.0 * math.pi * 50.0
V_BASE, Z_BASE, T_S = 155.6, 7.26, 100e-6


def floats(record: Any) -> Any:
    """The record with Python's floats alone, as compiled code takes it."""
    return type(record)(*(floats(value) if isinstance(value, tuple) else float(value) for value in record))


SETTINGS = floats(field_settings(T_s=T_S, omega_n=OMEGA, V_base=V_BASE, Z_base=Z_BASE))


class Line:
    """A grid of R and X (pu) behind which a source turns; the converter's voltage is 1 pu and the probe."""

    def __init__(self, R: float, X: float, hz: float = 50.2, noise: float = 0.0, seed: int = 1) -> None:
        self.omega, self.R, self.X = 2.0 * math.pi * hz, R, X
        self.draws = np.random.default_rng(seed)
        self.noise, self.theta, self.i = noise, 0.3, 0j
        self.v = np.exp(1j * (self.theta + 0.1))
        self.sent = 0j

    def measured(self) -> tuple[float, float, float, float, float, float]:
        """v, i (SI) and the sent probe at this sample."""
        v, i = (x + self.noise * complex(*self.draws.normal(size=2)) for x in (self.v, self.i))
        v, i = v * V_BASE, i * V_BASE / Z_BASE
        return v.real, v.imag, i.real, i.imag, self.sent.real, self.sent.imag

    def moved(self, u: complex) -> None:
        """One sample on, with the trapezoidal rule."""
        before = self.v - np.exp(1j * self.theta)
        self.theta += self.omega * T_S
        self.sent = u * np.exp(1j * (self.theta + 0.1))
        self.v = np.exp(1j * (self.theta + 0.1)) + self.sent
        L = self.X / OMEGA / T_S
        driving = 0.5 * (before + self.v - np.exp(1j * self.theta))
        self.i = ((L - 0.5 * self.R) * self.i + driving) / (L + 0.5 * self.R)


def run(line: Line, cycles: int, functions: Any = (probe_value, listen, conclude), settings: Any = SETTINGS) -> Any:
    """(lock, track, answers) after so many cycles."""
    probe, take, end = functions
    lock, track = floats(first_lock_in(settings, OMEGA)), floats(first_track(settings))
    answers = []
    while len(answers) < cycles:
        lock = take(lock, *line.measured(), 0.0, settings)
        if lock.closed > 0.5:
            lock, track, answer = end(lock, track, settings)
            answers.append(answer)
        line.moved(complex(*probe(lock, 1.0, settings)))
    return lock, track, answers


def test_it_recovers_a_grid() -> None:
    """Without noise only the trapezoidal rule of the oracle is left: 1e-4 at this sampling period."""
    for R, X in ((0.1, 0.3), (0.04, 0.03), (0.2, 0.6)):
        answer = run(Line(R, X), 30)[2][-1]
        assert answer.valid == 1.0
        found = complex(answer.R_g, OMEGA * answer.L_g) / Z_BASE
        assert abs(found - complex(R, X)) < 1e-3 * abs(complex(R, X))


def test_python_and_the_compiled_sample_agree() -> None:
    """What runs with every sample. The compiled cycle is compared where the simulation uses it."""
    probe, take = Machine(probe_value), Machine(listen)

    def probing(*given: Any) -> Any:
        return probe(flat(given))

    def listening(lock: LockIn, *given: Any) -> LockIn:
        return record_like(lock, iter(take(flat((lock, *given)))))

    _, _, one = run(Line(0.1, 0.2, noise=1e-3), 12)
    _, _, two = run(Line(0.1, 0.2, noise=1e-3), 12, (probing, listening, conclude))
    np.testing.assert_allclose(
        np.array([flat(a) for a in one]), np.array([flat(a) for a in two]), rtol=1e-8, atol=1e-12
    )


@pytest.fixture(scope="module")
def in_c(tmp_path_factory: pytest.TempPathFactory) -> Compiled:
    require_compiler()
    text = c_functions([probe_value, listen, conclude, features])
    return Compiled(text, tmp_path_factory.mktemp("field"), "gcc", double=True, optimised=False)


def compare(compiled: Compiled, name: str, call: Any, given: Any) -> None:
    found = compiled(name, np.array([flat(given)]))[0]
    np.testing.assert_allclose(found, flat(call(*given)), rtol=1e-12, atol=1e-15)


def test_it_is_c(in_c: Compiled) -> None:
    lock, track, _ = run(Line(0.1, 0.2, noise=1e-3), 12)
    sample = (120.0, -40.0, 10.0, 3.0, 1e-3, 2e-3, 0.0)
    compare(in_c, "probe_value", probe_value, (lock, 1.0, SETTINGS))
    compare(in_c, "listen", listen, (lock, *sample, SETTINGS))
    compare(in_c, "conclude", conclude, (lock, track, SETTINGS))


def test_features_are_finite_and_c(in_c: Compiled) -> None:
    lock, track, answers = run(Line(0.1, 0.2, noise=1e-3), 12)
    for k in (lock, track, answers[-1]), (lock, floats(first_track(SETTINGS)), answers[0]):
        expected = flat(features(*k, SETTINGS))
        assert np.all(np.abs(expected) < 12.0)
        np.testing.assert_allclose(
            in_c("features", np.array([flat((*k, SETTINGS))]))[0], expected, rtol=1e-12, atol=1e-12
        )


def test_a_sample_that_is_no_number_is_told_and_forgotten() -> None:
    line = Line(0.1, 0.2, noise=1e-3)
    lock, track, _ = run(line, 20)
    lock = listen(lock, math.nan, 1.0, math.inf, 1.0, 0.0, 0.0, 0.0, SETTINGS)
    assert np.all(np.isfinite(flat(lock)))
    assert lock.spoilt == 1.0
    while lock.closed < 0.5:
        lock = listen(lock, math.nan, math.nan, math.nan, math.nan, 0.0, 0.0, 0.0, SETTINGS)
    lock, track, answer = conclude(lock, track, SETTINGS)
    assert answer.spoilt == 1.0
    assert np.all(np.isfinite(flat((lock, track, answer))))
    answers = go_on(line, lock, track, 30)
    assert answers[0].spoilt == 0.0
    assert answers[-1].valid == 1.0
    found = complex(answers[-1].R_g, OMEGA * answers[-1].L_g) / Z_BASE
    assert abs(found - complex(0.1, 0.2)) < 0.05 * abs(complex(0.1, 0.2))


def test_a_memory_that_is_no_number_begins_anew() -> None:
    line = Line(0.1, 0.2, noise=1e-3)
    lock, track, _ = run(line, 10)
    answers = go_on(line, lock, track._replace(answer=track.answer._replace(R=math.nan)), 30)
    assert np.all(np.isfinite(flat(tuple(answers))))
    assert answers[1].valid == 0.0
    assert answers[-1].valid == 1.0


def test_without_a_probe_the_answer_ages_and_nothing_is_learnt() -> None:
    line = Line(0.1, 0.2, noise=1e-3)
    lock, track, before = run(line, 40)
    answers = go_on(line, lock, track, 60, allowed=0.0)
    assert answers[-1].R_g == answers[10].R_g
    assert answers[-1].sigma > 1.2 * answers[10].sigma
    assert answers[10].sigma < 2.0 * before[-1].sigma


def go_on(line: Line, lock: Any, track: Any, cycles: int, allowed: float = 1.0) -> list[Any]:
    """The answers of so many more cycles."""
    answers: list[Any] = []
    while len(answers) < cycles:
        lock = listen(lock, *line.measured(), 0.0, SETTINGS)
        if lock.closed > 0.5:
            lock, track, answer = conclude(lock, track, SETTINGS)
            answers.append(answer)
        line.moved(complex(*probe_value(lock, allowed, SETTINGS)))
    return answers


def test_the_covariance_is_that_of_many_runs() -> None:
    """White noise on v and i: the mean squared distance of 6 answers of 20 cycles from the truth, over the covariance.

    It would be 2 for exact Gaussian answers, and the mean of six has a deviation of 0.82: the upper limit is three of
    them above. The covariance also holds the sensors' gains, which are exact here, so the lower limit means little.
    """
    omega = np.diag([1.0, OMEGA])
    squares = []
    for seed in range(6):
        answer = run(Line(0.1, 0.2, noise=2e-3, seed=seed), 20)[2][-1]
        off = omega @ np.array([answer.R_g - 0.1 * Z_BASE, answer.L_g - 0.2 * Z_BASE / OMEGA])
        covariance = omega @ np.array([[answer.var_R, answer.cov_RL], [answer.cov_RL, answer.var_L]]) @ omega
        squares.append(float(off @ np.linalg.solve(covariance, off)))
    assert 0.2 < np.mean(squares) < 4.4


def test_the_state_is_small() -> None:
    count = len(flat(first_lock_in(SETTINGS, OMEGA))) + len(flat(first_track(SETTINGS)))
    assert count <= 500, f"{count} numbers are more than 2 kB in single precision"
    assert LockIn._fields
    assert FieldTrack._fields
