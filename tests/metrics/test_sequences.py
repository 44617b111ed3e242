"""Sequences of space vectors that are made of known ones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vsgdesign.equations.frames import clarke, clarke_inverse
from vsgdesign.metrics.sequences import frame_angle, last_sequences, positive_sequence, sequences


@pytest.mark.parametrize(("hz", "step_s"), [(50.0, 5e-4), (60.0, 5e-4), (60.0, 1e-4), (16.7, 1e-3)])
def test_both_sequences_and_a_dc_component_are_told_apart(hz: float, step_s: float) -> None:
    """Cycles of 33⅓ rows, too: the fit is exact for what it contains."""
    t = step_s * np.arange(400, dtype=np.float64)
    angle = 2.0 * math.pi * hz * t
    X1, X2, dc = 0.8 * np.exp(0.3j), 0.25 * np.exp(-1.1j), 0.4 - 0.2j
    z = X1 * np.exp(1j * angle) + np.conj(X2 * np.exp(1j * angle)) + dc
    found = sequences(z.real, z.imag, angle, step_s, hz)
    rows = math.ceil(1.0 / (hz * step_s) - 1e-6)
    assert np.isnan(found.positive[: rows - 1]).all()
    assert found.positive[rows - 1 :] == pytest.approx(np.full(400 - rows + 1, X1), abs=1e-12)
    assert found.negative[rows - 1 :] == pytest.approx(np.full(400 - rows + 1, X2), abs=1e-12)
    alone = positive_sequence(z.real, z.imag, angle, step_s, hz)
    assert alone[rows - 1 :] == pytest.approx(found.positive[rows - 1 :], abs=1e-12)
    last = last_sequences(z.real, z.imag, angle, step_s, hz)
    assert last is not None
    assert last.positive == pytest.approx(X1)


def test_the_largest_phase_is_that_of_the_phases() -> None:
    t = 1e-4 * np.arange(1000, dtype=np.float64)
    angle = 2.0 * math.pi * 50.0 * t
    a = np.exp(2j * math.pi / 3.0)
    X1, X2 = 0.7 * np.exp(0.2j), 0.4 * np.exp(2.0j)
    # Fortescue: a = X1 + X2, b = a² X1 + a X2, c = a X1 + a² X2.
    phasors = [X1 + X2, a * a * X1 + a * X2, a * X1 + a * a * X2]
    alpha, beta = clarke(*[np.real(p * np.exp(1j * angle)) for p in phasors])
    found = last_sequences(alpha, beta, angle, 1e-4, 50.0)
    assert found is not None
    assert found.positive == pytest.approx(X1)
    assert found.negative == pytest.approx(X2)
    assert float(found.largest_phase) == pytest.approx(max(abs(p) for p in phasors))
    assert np.max(np.abs(clarke_inverse(alpha, beta))) == pytest.approx(max(abs(p) for p in phasors), rel=1e-3)


def test_a_frame_that_is_not_at_the_nominal_frequency() -> None:
    """In the frame of its own angle, a positive sequence at 51 Hz is exact; no negative sequence is seen."""
    t = 5e-4 * np.arange(400, dtype=np.float64)
    angle = frame_angle(np.full(400, 51.0), 5e-4)
    assert angle[-1] == pytest.approx(2.0 * math.pi * 51.0 * t[-1])
    found = last_sequences(np.cos(angle), np.sin(angle), angle, 5e-4, 50.0)
    assert found is not None
    assert found.positive == pytest.approx(1.0)
    assert abs(found.negative) < 1e-12


def test_less_than_a_cycle_has_no_sequences() -> None:
    assert last_sequences(np.ones(39), np.ones(39), np.zeros(39), 5e-4, 50.0) is None
    assert np.isnan(sequences(np.ones(39), np.ones(39), np.zeros(39), 5e-4, 50.0).positive).all()
