"""A small voltage at one frequency beside the fundamental: the paper's comparator."""

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
    """What the method remembers."""

    angle: float
    """Of the frame that turns with the grid, rad."""
    omega: float
    line_angle: float
    """Of the injected line in that frame, rad."""
    v: ComplexArray
    """(windows − 1,): the line in the last windows, the oldest first, V; NaN where there is none."""
    i: ComplexArray
    """A."""


@dataclass(frozen=True)
class Injection:
    """A positive-sequence voltage of 1.5 times the nominal frequency and ``amplitude`` (of rated), measured over
    ``windows`` windows by a Fourier sum (:eq:`injection`).

    Two cycles are the shortest that hold whole periods of 50 and 75 Hz, so two windows of whole cycles do; a window's
    answer is from those that end with it.
    """

    at: Installation
    amplitude: float = 0.005
    windows: int = 2
    believed: float = 0.3
    """Largest standard deviation, relative to |Z|, of an estimate that is followed."""
    signals: str = "injection"

    @property
    def title(self) -> str:
        """With its frequency."""
        return f"{self.frequency_hz:.3g} Hz injection"

    @property
    def frequency_hz(self) -> float:
        """What is injected, in the stationary frame, Hz."""
        return 1.5 * self.at.nominal_hz

    @property
    def slip(self) -> float:
        """The injected frequency in the frame of the fundamental, rad/s."""
        return 2.0 * math.pi * (self.frequency_hz - self.at.nominal_hz)

    @cached_property
    def hold(self) -> float:
        """For how long each value of the probe is held, s: about a millisecond."""
        return near_a_millisecond(self.windows * round(self.at.window / self.at.T_s), self.at.T_s)

    @property
    def needs(self) -> Needs:
        """Windows of α and β, and the probe."""
        return Needs(self.at.samples, self.at.sample_interval, probe_hold=self.hold)

    @cached_property
    def line(self) -> Probe:
        """The injected voltage in the converter's frame, where it turns at the difference of the two frequencies."""
        steps = round(self.windows * self.at.window / self.hold)
        values = self.amplitude * np.exp(1j * self.slip * self.hold * np.arange(steps))
        return Probe(values.astype(complex), self.hold)

    def probe(self, state: InjectionState) -> Probe:  # noqa: ARG002
        """Always the same line."""
        return self.line

    def first(self) -> InjectionState:
        """Nothing seen."""
        none = np.full(self.windows - 1, np.nan, dtype=complex)
        return InjectionState(0.0, np.nan, 0.0, none, none)

    def update(self, state: InjectionState, samples: Samples) -> tuple[InjectionState, Estimate]:
        """V/I at the injected frequency."""
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
            return state, no_estimate("waiting", "no current answers at the injected frequency: no estimate")
        Z = V / current
        covariance = self._covariance(Z, current, omega, count)
        return state, with_belief(Z.real, Z.imag / (omega + self.slip), covariance, omega, self.believed)

    def lines(self, i: ComplexArray, interval: float) -> tuple[ComplexArray, Array, int]:
        """What a bound is about: the line in currents (n,) of the rotating frame, its frequency in that frame (rad/s)
        and over how many of their last samples it is taken."""
        count = self.windows * round(self.at.window / interval)
        back = np.exp(-1j * self.slip * interval * np.arange(len(i)))
        return np.array([(i * back)[-count:].mean()]), np.array([self.slip]), count

    def _covariance(self, Z: complex, current: complex, omega: float, count: int) -> Array | None:
        """Of (R_g, L_g) from the sensors (:eq:`bound-probe`); None where their noise is not known."""
        if max(self.at.noise) == 0.0:
            return None
        s_v, s_i = (space_vector_variance(deviation) / (count * self.windows) for deviation in self.at.noise)
        each = 0.5 * (s_v + abs(Z) ** 2 * s_i) / abs(current) ** 2
        return np.diag([each, each / (omega + self.slip) ** 2])
