"""Positive and negative sequence of a space vector, by a one-cycle fit."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]


class Sequences(NamedTuple):
    """Peak phasors in the frame of the given angle, z = X₁ e^{jθ} + conj(X₂) e^{−jθ} (:eq:`sequences`).

    Of a series they are arrays (n,), NaN before the first whole cycle; of one window they are numbers.
    """

    positive: Any
    negative: Any

    @property
    def largest_phase(self) -> Any:
        """The largest of the three phases' amplitudes."""
        turns = np.exp(2j * math.pi * np.array([0.0, -1.0, 1.0]) / 3.0)
        phases = np.abs(np.expand_dims(self.positive, -1) + np.expand_dims(self.negative, -1) * turns)
        return phases.max(axis=-1)


def sequences(alpha: Array, beta: Array, angle: Array, step_s: float, hz: float) -> Sequences:
    """Both sequences over the cycle that ends at each row, arrays (n,).

    ``angle`` (n,): the angle θ of the frame, rad, which turns at about ``hz``. In every window of one cycle a
    constant (positive sequence), a decaying dc component taken as constant, and a negative sequence are fitted
    together, so that a cycle need not be a whole number of rows.
    """
    weights = _weights(step_s, hz)
    count = weights.shape[1]
    dq = (np.asarray(alpha) + 1j * np.asarray(beta)) * np.exp(-1j * angle)
    positive, negative = (np.full(dq.shape, complex(math.nan, math.nan)) for _ in range(2))
    if dq.size >= count:
        positive[count - 1 :] = np.convolve(dq, weights[0, ::-1], mode="valid")
        found = np.convolve(dq, weights[1, ::-1], mode="valid")
        negative[count - 1 :] = np.conj(found * np.exp(2j * angle[count - 1 :]))
    return Sequences(positive, negative)


def positive_sequence(alpha: Array, beta: Array, angle: Array, step_s: float, hz: float) -> Complex:
    """The positive sequence alone of :func:`sequences`, (n,), in half the time."""
    weights = _weights(step_s, hz)[0]
    found = np.full(len(angle), complex(math.nan, math.nan))
    if found.size >= weights.size:
        dq = (np.asarray(alpha) + 1j * np.asarray(beta)) * np.exp(-1j * angle)
        found[weights.size - 1 :] = np.convolve(dq, weights[::-1], mode="valid")
    return found


def last_sequences(alpha: Array, beta: Array, angle: Array, step_s: float, hz: float) -> Sequences | None:
    """Both sequences over the last cycle of a series; None if it has no whole cycle."""
    count = _weights(step_s, hz).shape[1]
    if len(alpha) < count:
        return None
    found = sequences(alpha[-count:], beta[-count:], angle[-count:], step_s, hz)
    return Sequences(complex(found.positive[-1]), complex(found.negative[-1]))


def frame_angle(f_hz: Array, step_s: float) -> Array:
    """∫ 2πf dt (n,) in rad, zero at the first row."""
    means = 0.5 * (f_hz[1:] + f_hz[:-1])
    return np.concatenate(([0.0], np.cumsum(means))) * (2.0 * math.pi * step_s)


def _weights(step_s: float, hz: float) -> Complex:
    """Rows of a window (2, m) that give the constant and the part that turns at −2·hz, at the window's end."""
    count = max(math.ceil(1.0 / (hz * step_s) - 1e-6), 4)
    back = 2.0 * math.pi * hz * step_s * np.arange(1 - count, 1)
    basis = np.exp(-1j * np.outer(back, [0.0, 2.0, 1.0]))
    return np.asarray(np.linalg.pinv(basis)[:2], dtype=complex)
