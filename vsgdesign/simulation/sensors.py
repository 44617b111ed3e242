"""Sensors in the loop: what the controller is given instead of the voltages and currents of the circuit.

Every phase of every quantity has a sensor of its own (:eq:`sensors`). :func:`vsgdesign.simulation.sample.sensed` is
what they do in a sample; :class:`SensorsOfRun` gives the numbers of a run.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import Measurement
from vsgdesign.frames import rms_to_peak
from vsgdesign.parameters.ranges import stream
from vsgdesign.parameters.sensors import CHANNELS, SensorSpec
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.sample import SensorChannel, Sensors

Array = NDArray[np.float64]

BLOCK = 4096
"""Samples for which noise is drawn at once."""


def sensors_of(study: Study, x: Array, omega: float) -> SensorsOfRun | None:
    """The sensors of a study's run; None where they are ideal."""
    spec = study.sensors
    return SensorsOfRun(study, spec, x, omega) if spec is not None and spec.act else None


class SensorsOfRun:
    """The sensors of a run. ``x`` (2n): the circuit's state at its beginning; ``omega``: of the source there, rad/s."""

    def __init__(self, study: Study, spec: SensorSpec, x: Array, omega: float) -> None:
        c = study.converter
        self._seed = spec.seed
        rated = np.repeat([rms_to_peak(c.V_rated_rms), c.I_rated_pk, c.I_rated_pk], 3)
        self._noise = spec.noise * rated
        limit = (spec.range_pu if spec.range_pu > 0.0 else math.inf) * rated
        steps = 2.0 * limit / 2.0**spec.bits if spec.bits else np.zeros(len(CHANNELS))
        gains, offsets = 1.0 + np.array(spec.gain_errors), np.array(spec.offset_errors) * rated
        lag = spec.skew / (c.omega_n * c.T_s)
        # The vectors of the sample before the first, as if the run had always been as it begins.
        v = x[2:4] + study.filter.R_c * (x[0:2] - x[4:6])
        turned = np.exp(-1j * omega * c.T_s) * np.array([complex(*pair) for pair in (v, x[0:2], x[4:6])])
        self.before = Measurement(*turned.view(np.float64).tolist())
        """What was true one sample before the first."""
        channels = [SensorChannel(*values) for values in np.stack([gains, offsets, steps, limit], axis=1).tolist()]
        self.constants = Sensors(*channels, late_v=max(-lag, 0.0), late_i=max(lag, 0.0))
        self._block, self._drawn = -1, np.empty((0, len(CHANNELS)))

    def noise(self, first: int, count: int) -> Array:
        """What is added to each reading of samples first … first + count − 1: (count, 9), channels in the order of
        ``CHANNELS``."""
        parts, done = [], 0
        while done < count:
            block, at = divmod(first + done, BLOCK)
            if block != self._block:
                shape = (BLOCK, len(CHANNELS))
                normal = (
                    stream(self._seed, "noise", block).standard_normal(shape) if self._noise.any() else np.zeros(shape)
                )
                self._block, self._drawn = block, normal * self._noise
            parts.append(self._drawn[at : at + count - done])
            done += len(parts[-1])
        return parts[0] if len(parts) == 1 else np.concatenate(parts)
