"""A small voltage at one frequency beside the fundamental: the paper's comparator."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vsgdesign.estimator.baselines.record import ComplexArray, Estimates, Record
from vsgdesign.simulation import Probe


@dataclass(frozen=True)
class Injection:
    """A positive-sequence voltage of ``frequency_hz`` and ``amplitude`` (of rated), measured over ``windows`` windows
    by a Fourier sum (:eq:`injection`).

    Two cycles are the shortest that hold whole periods of 50 and 75 Hz, so two windows of whole cycles do; a window's
    answer is from those that end with it.
    """

    amplitude: float = 0.005
    frequency_hz: float = 75.0
    nominal_hz: float = 50.0
    window_cycles: int = 1
    """Cycles of ``nominal_hz`` in a window."""
    windows: int = 2
    hold: float = 1e-3
    name: str = "75 Hz injection"
    signals: str = "injection"

    @property
    def probe(self) -> Probe:
        """The injected voltage in the converter's frame, where it turns at the difference of the two frequencies."""
        steps = round(self.windows * self.window_cycles / self.nominal_hz / self.hold)
        turn = 2.0 * math.pi * (self.frequency_hz - self.nominal_hz) * self.hold
        values = self.amplitude * np.exp(1j * turn * np.arange(steps))
        return Probe(values.astype(complex), self.hold)

    def slip(self) -> float:
        """The injected frequency in the rotating frame, rad/s."""
        return 2.0 * math.pi * (self.frequency_hz - self.nominal_hz)

    def phasors(self, x: ComplexArray, windows: int, sample_interval: float) -> ComplexArray:
        """(B, W) phasors of rotating (B, N) at the injected frequency; NaN before there are enough windows."""
        turned = x * np.exp(-1j * self.slip() * sample_interval * np.arange(x.shape[1]))
        sums = turned.reshape(len(x), windows, -1).mean(axis=2)
        found = np.full(sums.shape, np.nan, dtype=complex)
        for last in range(self.windows - 1, windows):
            found[:, last] = sums[:, last - self.windows + 1 : last + 1].mean(axis=1)
        return found

    def estimate(self, record: Record) -> Estimates:
        """V/I at the injected frequency."""
        v, i = (self.phasors(x, record.windows, record.sample_interval) for x in record.rotating())
        with np.errstate(invalid="ignore"):  # before there are enough windows
            Z = v / i
        return Estimates(Z.real, Z.imag / (record.omega[:, None] + self.slip()))
