"""Injection of a small voltage at one frequency beside the fundamental. The paper compares its network with it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from vsgdesign.identification.frame import advanced, followed_frequency, sample_count, space_vector_variance, turned
from vsgdesign.identification.interface import (
    Array,
    ComplexArray,
    Estimate,
    Installation,
    Needs,
    Probe,
    Samples,
    SpoiltBy,
    no_estimate,
    with_belief,
)
from vsgdesign.identification.sampling import near_a_millisecond


class InjectionState(NamedTuple):
    """State of the method."""

    angle: float
    """Angle of the frame that turns with the grid, rad."""
    omega: float
    line_angle: float
    """Angle of the injected line in that frame, rad."""
    v: ComplexArray
    """The line in the last windows (windows − 1,), the oldest first, V; NaN where there is none."""
    i: ComplexArray
    """A."""


@dataclass(frozen=True)
class Injection:
    """Injection of a positive-sequence voltage at 1.5 times the nominal frequency (:eq:`injection`).

    Its ``amplitude`` is relative to the rated voltage. A Fourier sum over ``windows`` windows measures it. Two cycles
    are the shortest time with whole periods of 50 Hz and 75 Hz, so two windows of whole cycles are enough. The answer
    of a window comes from the windows that end with it.
    """

    at: Installation
    amplitude: float = 0.005
    windows: int = 2
    believed: float = 0.3
    """An estimate is followed up to this standard deviation, relative to |Z|."""
    signals: str = "injection"

    @property
    def title(self) -> str:
        """The name with the injected frequency."""
        return f"{self.frequency_hz:.3g} Hz injection"

    @property
    def frequency_hz(self) -> float:
        """The injected frequency in the stationary frame, Hz."""
        return 1.5 * self.at.nominal_hz

    @property
    def slip(self) -> float:
        """The injected frequency in the frame of the fundamental, rad/s."""
        return 2.0 * math.pi * (self.frequency_hz - self.at.nominal_hz)

    @cached_property
    def hold(self) -> float:
        """Time for which each value of the probe is held, s. It is about a millisecond."""
        return near_a_millisecond(self.windows * round(self.at.window / self.at.T_s), self.at.T_s)

    @property
    def needs(self) -> Needs:
        """It needs windows of α and β, and the probe."""
        return Needs(self.at.samples, self.at.sample_interval, probe_hold=self.hold)

    @cached_property
    def line(self) -> Probe:
        """The injected voltage in the converter's frame, in which it turns at the difference of the two frequencies."""
        steps = round(self.windows * self.at.window / self.hold)
        values = self.amplitude * np.exp(1j * self.slip * self.hold * np.arange(steps))
        return Probe(values.astype(complex), self.hold)

    def probe(self, state: InjectionState) -> Probe:  # noqa: ARG002
        """The probe, which is always the same line."""
        return self.line

    def first(self) -> InjectionState:
        """Nothing seen."""
        none = np.full(self.windows - 1, np.nan, dtype=complex)
        return InjectionState(0.0, np.nan, 0.0, none, none)

    def update(self, state: InjectionState, samples: Samples) -> tuple[InjectionState, Estimate]:
        """Computes the estimate from V/I at the injected frequency."""
        at, count = self.at, sample_count(samples)
        length = at.sample_interval * count
        line_angle = advanced(state.line_angle, self.slip, length)
        spoilt = SpoiltBy(at.v_limit, at.i_limit).status(samples)
        if spoilt is not None:
            passed = self.first()._replace(angle=advanced(state.angle, state.omega, length), omega=state.omega)
            return passed._replace(line_angle=line_angle), no_estimate(spoilt)
        omega = followed_frequency(state.omega, samples.omega, length)
        v, i, angle = turned(samples, state.angle, omega, at.sample_interval)
        back = np.exp(-1j * (state.line_angle + self.slip * at.sample_interval * np.arange(count)))
        vs, is_ = (np.append(before, (x * back).mean()) for before, x in ((state.v, v), (state.i, i)))
        state = InjectionState(angle, omega, line_angle, vs[1:], is_[1:])
        V, current = complex(vs.mean()), complex(is_.mean())
        if not np.isfinite(V):
            return state, no_estimate("waiting")
        if current == 0.0:
            return state, no_estimate("waiting", "the current has no component at the injected frequency: no estimate")
        Z = V / current
        covariance = self._covariance(Z, current, omega, count)
        return state, with_belief(Z.real, Z.imag / (omega + self.slip), covariance, omega, self.believed)

    def lines(self, i: ComplexArray, interval: float) -> tuple[ComplexArray, Array, int]:
        """The data of the error bound, from currents (n,) of the rotating frame.

        Returns the line in these currents, its frequency in that frame (rad/s) and the number of last samples over
        which it is taken.
        """
        count = self.windows * round(self.at.window / interval)
        back = np.exp(-1j * self.slip * interval * np.arange(len(i)))
        return np.array([(i * back)[-count:].mean()]), np.array([self.slip]), count

    def _covariance(self, Z: complex, current: complex, omega: float, count: int) -> Array | None:
        """Covariance of (R_g, L_g) from the noise of the sensors (:eq:`bound-probe`); None if this is not known."""
        if max(self.at.noise) == 0.0:
            return None
        s_v, s_i = (space_vector_variance(deviation) / (count * self.windows) for deviation in self.at.noise)
        each = 0.5 * (s_v + abs(Z) ** 2 * s_i) / abs(current) ** 2
        return np.diag([each, each / (omega + self.slip) ** 2])
