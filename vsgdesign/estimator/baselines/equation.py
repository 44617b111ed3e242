"""The R–L equation on measured samples, as the recursive methods use it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsgdesign.estimator.baselines.record import Array, ComplexArray, Record
from vsgdesign.estimator.bound import space_vector_variance
from vsgdesign.parameters.study import Grid

_MODEL_VARIANCE = 1e-6
"""Of the equation itself, per unit: sampled ripple moves the voltage by some thousandths, whatever the sensors."""


@dataclass(frozen=True, eq=False)
class BlockEquation:
    """v = R i + L(di/dt + jωi) + g between the means of successive blocks (:eq:`rl-blocks`), per unit.

    Block means rather than samples: the difference of two samples is mostly noise, and noise in a regressor pulls
    L to zero (from noise of 0.1 % and 200 µs by more than half).
    """

    v: ComplexArray
    """(B, K) of the rated peak voltage."""
    i: ComplexArray
    slope: ComplexArray
    """(B, K): what R_g/Z_base and ω_n L_g/Z_base multiply."""
    variance: Array
    """(B,): of one component of the equation's error, from the sensors."""
    interval: float
    """Between two equations, s."""
    per_window: int

    def window_of(self, k: int) -> int | None:
        """The window that ends with equation k, if one does."""
        whole, rest = divmod(k + 2, self.per_window)
        return whole - 1 if rest == 0 else None


def block_equation(record: Record, guess: Grid) -> BlockEquation:
    """The equations of a record; ``guess`` is for the weight of the current's noise alone.

    Over half a cycle the 5th and 7th harmonics, which turn at six times the grid's frequency here, are zero on average:
    a block is half a window, or a whole one where its number of samples is odd.
    """
    per_window = 1 if record.samples % 2 else 2
    size = record.samples // per_window
    v, i = (x.reshape(len(x), -1, size).mean(axis=2) for x in record.rotating())
    T = size * record.sample_interval
    mean_i = 0.5 * (i[:, 1:] + i[:, :-1])
    slope = np.diff(i, axis=1) / T + 1j * record.omega[:, None] * mean_i
    scale = record.Z_base / record.V_base
    variance = []
    for noise in record.noise:
        Z_sq = guess.R_g**2 + (record.omega_n * guess.L_g) ** 2
        block_v, block_i = (space_vector_variance(s) / size for s in (noise.v, noise.i))
        error = 0.5 * (block_v + Z_sq * block_i) + 2.0 * (guess.L_g / T) ** 2 * block_i
        variance.append(0.5 * error / record.V_base**2)  # of one of two components
    return BlockEquation(
        0.5 * (v[:, 1:] + v[:, :-1]) / record.V_base,
        mean_i * scale,
        slope * scale / record.omega_n,
        np.array(variance) + _MODEL_VARIANCE,
        T,
        per_window,
    )
