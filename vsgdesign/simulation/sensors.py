"""Sensors in the loop: what the controller is given instead of the voltages and currents of the circuit.

Every phase of every quantity has a sensor of its own (:eq:`sensors`). :func:`sensed` is plain Python that
the compiled loop calls at every sample; :class:`Sensors` makes its arrays for a run.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import Measurement
from vsgdesign.frames import clarke, clarke_inverse, rms_to_peak
from vsgdesign.parameters.ranges import stream
from vsgdesign.parameters.sensors import CHANNELS, SensorSpec
from vsgdesign.parameters.study import Study

Array = NDArray[np.float64]

BLOCK = 4096
"""Samples for which noise is drawn at once."""


class SensorRows(NamedTuple):
    """Sensors for a stretch. SI and peak; channels in the order of ``CHANNELS``."""

    noise: Any
    """(samples, 9): what is added to each."""
    gains: Any
    offsets: Any
    """(9)."""
    steps: Any
    """(9): quantisation step; 0: none."""
    limits: Any
    """(9): where they saturate."""
    lag: Any
    """(2): by how many sampling periods the voltages and the currents are late, 0 to 1."""
    before: Any
    """(6): v, i_s and i_g, each as (α, β), of the sample before; updated in place."""
    phases: Any
    """(9): what is being read."""


def read_sensors(phases: Any, row: Any, sensors: SensorRows) -> None:
    """Puts in the place of nine true values what the sensors make of them: gain, offset, noise, saturation, steps."""
    for k in range(phases.shape[0]):
        reading = phases[k] * sensors.gains[k] + sensors.offsets[k] + sensors.noise[row, k]
        limit, step = sensors.limits[k], sensors.steps[k]
        reading = min(max(reading, -limit), limit)
        if step > 0.0:
            reading = min(math.floor(reading / step + 0.5) * step, limit - step)
        phases[k] = reading


def sensed(true: Measurement, row: Any, sensors: SensorRows) -> Measurement:
    """What the sensors say at a sample of the stretch (:eq:`sensors`). The sample before is kept in ``sensors``."""
    phases, before = sensors.phases, sensors.before
    for k in range(3):
        late = sensors.lag[0] if k == 0 else sensors.lag[1]
        alpha, beta = true[2 * k], true[2 * k + 1]
        phases[3 * k], phases[3 * k + 1], phases[3 * k + 2] = clarke_inverse(
            alpha + late * (before[2 * k] - alpha), beta + late * (before[2 * k + 1] - beta)
        )
        before[2 * k], before[2 * k + 1] = alpha, beta
    read_sensors(phases, row, sensors)
    v_alpha, v_beta = clarke(phases[0], phases[1], phases[2])
    i_s_alpha, i_s_beta = clarke(phases[3], phases[4], phases[5])
    i_g_alpha, i_g_beta = clarke(phases[6], phases[7], phases[8])
    return Measurement(v_alpha, v_beta, i_s_alpha, i_s_beta, i_g_alpha, i_g_beta)


def sensors_of(study: Study, x: Array, omega: float) -> Sensors | None:
    """The sensors of a study's run; None where they are ideal."""
    spec = study.sensors
    return Sensors(study, spec, x, omega) if spec is not None and spec.act else None


class Sensors:
    """The sensors of a run. ``x`` (2n): the circuit's state at its beginning; ``omega``: of the source there, rad/s."""

    def __init__(self, study: Study, spec: SensorSpec, x: Array, omega: float) -> None:
        c = study.converter
        self._seed = spec.seed
        rated = np.repeat([rms_to_peak(c.V_rated_rms), c.I_rated_pk, c.I_rated_pk], 3)
        self._noise = spec.noise * rated
        limit = (spec.range_pu if spec.range_pu > 0.0 else math.inf) * rated
        lag = spec.skew / (c.omega_n * c.T_s)
        # The vectors of the sample before the first, as if the run had always been as it begins.
        v = x[2:4] + study.filter.R_c * (x[0:2] - x[4:6])
        turned = np.exp(-1j * omega * c.T_s) * np.array([complex(*pair) for pair in (v, x[0:2], x[4:6])])
        self._rows = SensorRows(
            noise=np.empty((0, len(CHANNELS))),
            gains=1.0 + np.array(spec.gain_errors),
            offsets=np.array(spec.offset_errors) * rated,
            steps=2.0 * limit / 2.0**spec.bits if spec.bits else np.zeros(len(CHANNELS)),
            limits=limit,
            lag=np.array([max(-lag, 0.0), max(lag, 0.0)]),
            before=turned.view(np.float64).copy(),
            phases=np.zeros(len(CHANNELS)),
        )
        self._block, self._drawn = -1, np.empty((0, len(CHANNELS)))

    def rows(self, first: int, count: int) -> SensorRows:
        """For samples first … first + count − 1."""
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
        return self._rows._replace(noise=parts[0] if len(parts) == 1 else np.concatenate(parts))
