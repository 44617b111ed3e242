"""The rotating frame of the classical methods. It turns at the grid's frequency as the converter knows it."""

from __future__ import annotations

import math

import numpy as np

from vsgdesign.equations.frames import clarke
from vsgdesign.identification.interface import ComplexArray, Samples

FREQUENCY_MEMORY = 1.0
"""Time over which the converter's own frequency is averaged, s. In the steady state it is the grid's frequency."""


def followed_frequency(known: float, measured: float, length: float) -> float:
    """The average of the converter's frequency after a window of ``length`` s; ``known`` is NaN before the first."""
    if not math.isfinite(measured):
        return known
    if not math.isfinite(known):
        return measured
    return known - math.expm1(-length / FREQUENCY_MEMORY) * (measured - known)


def turned(samples: Samples, angle: float, omega: float, interval: float) -> tuple[ComplexArray, ComplexArray, float]:
    """The αβ samples v and i (n,) in the rotating frame, in which the phasor of the grid is constant.

    The frame is at ``angle`` (rad) at the first sample. The third result is its angle at the sample after the last.
    """
    v, i = (np.reshape(x, (2, -1)) for x in (samples.v, samples.i))
    count = v.shape[1]
    turn = np.exp(-1j * (angle + omega * interval * np.arange(count)))
    return (v[0] + 1j * v[1]) * turn, (i[0] + 1j * i[1]) * turn, advanced(angle, omega, interval * count)


def advanced(angle: float, omega: float, length: float) -> float:
    """An angle (rad) after ``length`` s at ω. It does not change while the frequency is not known."""
    return math.remainder(angle + omega * length, 2.0 * math.pi) if math.isfinite(omega) else angle


def sample_count(samples: Samples) -> int:
    """The number of αβ samples."""
    return samples.v.size // 2


def space_vector_variance(deviation: float) -> float:
    """E|n|² of a sample of the space vector α + jβ from the noise of three phases (:eq:`phasor-noise`)."""
    alpha, beta = zip(*(clarke(*phase) for phase in np.eye(3)), strict=True)
    return deviation**2 * float(np.sum(np.square(alpha)) + np.sum(np.square(beta)))
