"""The sensors of many runs: each run has its own errors and its own noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import aligned_zeros
from vsgdesign.codegen.records import numbers_of
from vsgdesign.simulation.added_source import SensorsOfRun
from vsgdesign.simulation.batch import Batch
from vsgdesign.study.parameters.sensors import CHANNELS, SensorSpec

Array = NDArray[np.float64]
Samples = NDArray[np.int64]

FED_SAMPLES = 512
"""Samples for which noise is drawn at once where all lanes are at the same one."""


class LaneSensors:
    """The sensors of the runs of a batch, which they are put into."""

    def __init__(self, batch: Batch, specs: Sequence[SensorSpec], x: Array, omega: Array) -> None:
        """``x`` (2n, N): the circuits' states at the beginning; ``omega`` (N,): of the sources there, rad/s."""
        groups, _, width = batch.rows.shape
        of_run = zip(specs, x.T, omega.tolist(), strict=True)
        self._runs = [SensorsOfRun(batch.study, *one) for one in of_run]
        for number, run in enumerate(self._runs):
            batch.set("sensors", numbers_of(run.constants), number)
            batch.set("before", run.before, number)
        rms = np.zeros((groups * width, len(CHANNELS)))
        rms[: len(self._runs)] = [run.rms for run in self._runs]
        self._rms = rms.reshape(groups, width, -1).transpose(0, 2, 1)
        self._normal, self._room = np.zeros((width, 0, len(CHANNELS))), np.zeros((0, 0, len(CHANNELS), width))

    def noise(self, begin: Samples, counts: Samples, first: int, groups: int) -> Array:
        """What is added to the readings of ``groups`` groups from ``first`` on, (groups, most, 9, L), each run from its
        own sample ``begin`` (N,) on for ``counts`` (N,) samples. It is valid until the next call."""
        width, most = len(self._normal), int(counts.max())
        if self._normal.shape[1] < most:
            self._normal = np.zeros((width, most, len(CHANNELS)))
        if self._room.shape[0] < groups or self._room.shape[1] < most:
            self._room = aligned_zeros((groups, self._normal.shape[1], len(CHANNELS), width))
        found, normal = self._room[:groups, :most], self._normal[:, :most]
        for group in range(first, first + groups):
            for lane, run in enumerate(range(group * width, min((group + 1) * width, len(self._runs)))):
                self._runs[run].draw(int(begin[run]), self._normal[lane, : counts[run]])
            np.multiply(normal.transpose(1, 2, 0), self._rms[group], out=found[group - first])
        return found
