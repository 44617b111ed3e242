"""A recorded voltage as the source of a run: its vectors at the controller's samples, and the phase of its fundamental.

Between two samples of the controller the voltage is a straight line (:eq:`replay`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vsgdesign.parameters.replay import ReplaySpec

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

BLOCK = 8192
"""Samples that are interpolated at once."""

_KEPT = 3
"""Blocks in memory."""


class Replay:
    """The record of a study in a run. ``T_s``: the sampling period, s."""

    def __init__(self, spec: ReplaySpec, T_s: float) -> None:
        self.spec, self.T_s = spec, T_s
        self._half = math.pi / spec.omega_g
        self._reach = math.ceil(self._half / T_s) + 1
        self._blocks: dict[int, tuple[Complex, Array]] = {}

    def vectors(self, first: int, count: int) -> Complex:
        """The source's space vector at samples first … first + count − 1, V peak."""
        parts, done = [], 0
        while done < count:
            block, at = divmod(first + done, BLOCK)
            parts.append(self._block(block)[0][at : at + count - done])
            done += len(parts[-1])
        return np.concatenate(parts)

    def angle_at(self, samples: NDArray[np.int64]) -> Array:
        """By how much the fundamental is ahead of the one that begins the record (rad), at samples in increasing order:
        the phase of its mean over the cycle around the sample."""
        found = np.empty(len(samples))
        for block in np.unique(samples // BLOCK).tolist():
            begin, end = np.searchsorted(samples, [block * BLOCK, (block + 1) * BLOCK])
            found[begin:end] = self._block(block)[1][samples[begin:end] - block * BLOCK]
        return found

    def _block(self, index: int) -> tuple[Complex, Array]:
        if index not in self._blocks:
            T_s, reach = self.T_s, self._reach
            t_s: Array = (index * BLOCK + np.arange(-reach, BLOCK + reach + 1, dtype=np.float64)) * T_s
            t_s = t_s[t_s <= self.spec.usable]
            v = self.spec.vector(t_s)
            still = v * np.exp(-1j * (self.spec.omega_g * t_s + self.spec.phase))
            area = np.concatenate([[0.0], np.cumsum(0.5 * T_s * (still[1:] + still[:-1]))])
            inner = slice(reach, min(reach + BLOCK, len(t_s) - reach))
            ends = [np.interp(t_s[inner] + side * self._half, t_s, area) for side in (1.0, -1.0)]
            self._blocks[index] = v[inner], np.angle(ends[0] - ends[1])
            while len(self._blocks) > _KEPT:
                del self._blocks[next(iter(self._blocks))]
        return self._blocks[index]
