"""The 95 % band of an estimated impedance, in magnitude and angle, from the covariance of its R and X."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.answers import Answers

Array = NDArray[np.float64]

WIDTH = 1.959963984540054
"""Half the width of the central 95 % of a normal distribution, in standard deviations."""


class PolarBand(NamedTuple):
    """Magnitude (Ω) and angle (rad) of an impedance, and half the width of the 95 % band of each; NaN where there is
    no estimate."""

    size: Array
    size_half: Array
    angle: Array
    angle_half: Array


def polar_band(answers: Answers) -> PolarBand:
    """The answers in polar form, each with half the width of its 95 % band, all (n,).

    Of a small error e, the part along Z changes |Z| and the part across it turns Z by this part over |Z|. Their
    variances are those of the covariance in these two directions.
    """
    Z, P = answers.Z_hat, answers.covariance
    size = np.abs(Z)
    with np.errstate(invalid="ignore", divide="ignore"):
        along, across = Z / size, 1j * Z / size
        variances = [
            P[:, 0, 0] * u.real**2 + 2.0 * P[:, 0, 1] * u.real * u.imag + P[:, 1, 1] * u.imag**2
            for u in (along, across)
        ]
        halves = [WIDTH * np.sqrt(np.maximum(variance, 0.0)) for variance in variances]
        return PolarBand(size, halves[0], np.angle(Z), halves[1] / size)
