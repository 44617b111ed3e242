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


def one_sensor(value: Any, row: Any, channel: Any, sensors: SensorRows) -> Any:
    """What a sensor makes of a value: gain, offset, noise, saturation, quantisation."""
    reading = value * sensors.gains[channel] + sensors.offsets[channel] + sensors.noise[row, channel]
    limit, step = sensors.limits[channel], sensors.steps[channel]
    reading = min(max(reading, -limit), limit)
    if step > 0.0:
        reading = min(math.floor(reading / step + 0.5) * step, limit - step)
    return reading


def three_sensors(alpha: Any, beta: Any, row: Any, channel: Any, sensors: SensorRows) -> Any:
    """(α, β) of what the sensors of three phases say."""
    a, b, c = clarke_inverse(alpha, beta)
    return clarke(
        one_sensor(a, row, channel, sensors),
        one_sensor(b, row, channel + 1, sensors),
        one_sensor(c, row, channel + 2, sensors),
    )


def sensed(true: Measurement, row: Any, sensors: SensorRows) -> Measurement:
    """What the sensors say at a sample of the stretch (:eq:`sensors`). The sample before is kept in ``sensors``."""
    before, late_v, late_i = sensors.before, sensors.lag[0], sensors.lag[1]
    v_alpha = true.v_alpha + late_v * (before[0] - true.v_alpha)
    v_beta = true.v_beta + late_v * (before[1] - true.v_beta)
    i_s_alpha = true.i_s_alpha + late_i * (before[2] - true.i_s_alpha)
    i_s_beta = true.i_s_beta + late_i * (before[3] - true.i_s_beta)
    i_g_alpha = true.i_g_alpha + late_i * (before[4] - true.i_g_alpha)
    i_g_beta = true.i_g_beta + late_i * (before[5] - true.i_g_beta)
    before[0], before[1] = true.v_alpha, true.v_beta
    before[2], before[3] = true.i_s_alpha, true.i_s_beta
    before[4], before[5] = true.i_g_alpha, true.i_g_beta
    v_alpha, v_beta = three_sensors(v_alpha, v_beta, row, 0, sensors)
    i_s_alpha, i_s_beta = three_sensors(i_s_alpha, i_s_beta, row, 3, sensors)
    i_g_alpha, i_g_beta = three_sensors(i_g_alpha, i_g_beta, row, 6, sensors)
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
