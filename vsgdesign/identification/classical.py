"""The classical methods: a constant guess, ΔV/ΔI between two windows as in textbooks, and the injection of a small
voltage at one frequency beside the fundamental, with which the paper compares its network.

The guess ignores all measurements, so every useful method must be better than it. The frame of the others turns at the
grid's frequency as the converter knows it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from vsgdesign.equations.frames import clarke
from vsgdesign.identification.feeding import near_a_millisecond
from vsgdesign.identification.interface import (
    Array,
    ComplexArray,
    Estimate,
    Installation,
    Needs,
    NoMemory,
    Probe,
    Samples,
    SpoiltBy,
    no_estimate,
    with_belief,
)

FREQUENCY_MEMORY = 1.0
"""Time over which the converter's own frequency is averaged, s. In the steady state it is the grid's frequency."""


def followed_frequency(known: float, measured: float, length: float) -> float:
    """The average of the converter's frequency after a window of ``length`` s; ``known`` is NaN before the first."""
    if not math.isfinite(measured):
        return known
    if not math.isfinite(known):
        return measured
    return known - math.expm1(-length / FREQUENCY_MEMORY) * (measured - known)


def turned(samples: Samples, angle: float, omega: float, interval: float) -> tuple[ComplexArray, ComplexArray, float]:
    """The αβ samples v and i (n,) in the rotating frame, in which the phasor of the grid is constant.

    The frame is at ``angle`` (rad) at the first sample. The third result is its angle at the sample after the last.
    """
    v, i = (np.reshape(x, (2, -1)) for x in (samples.v, samples.i))
    count = v.shape[1]
    turn = np.exp(-1j * (angle + omega * interval * np.arange(count)))
    return (v[0] + 1j * v[1]) * turn, (i[0] + 1j * i[1]) * turn, advanced(angle, omega, interval * count)


def advanced(angle: float, omega: float, length: float) -> float:
    """An angle (rad) after ``length`` s at ω. It does not change while the frequency is not known."""
    return math.remainder(angle + omega * length, 2.0 * math.pi) if math.isfinite(omega) else angle


def sample_count(samples: Samples) -> int:
    """The number of αβ samples."""
    return samples.v.size // 2


def space_vector_variance(deviation: float) -> float:
    """E|n|² of a sample of the space vector α + jβ from the noise of three phases (:eq:`phasor-noise`)."""
    alpha, beta = zip(*(clarke(*phase) for phase in np.eye(3)), strict=True)
    return deviation**2 * float(np.sum(np.square(alpha)) + np.sum(np.square(beta)))


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


@dataclass(frozen=True)
class ConstantGuess:
    """An estimator that always answers with the same grid."""

    at: Installation
    title: str = "Constant guess"
    signals: str = "none"

    @property
    def needs(self) -> Needs:
        """It takes windows, so that it answers as often as the other methods."""
        return Needs(self.at.samples, self.at.sample_interval)

    def first(self) -> NoMemory:
        """Nothing."""
        return NoMemory()

    def probe(self, state: NoMemory) -> None:
        """This method needs no probe."""

    def update(self, state: NoMemory, samples: Samples) -> tuple[NoMemory, Estimate]:  # noqa: ARG002
        """Returns the guess, whatever was measured."""
        return state, Estimate(*self.at.guess, "ok")


class TwoWindowState(NamedTuple):
    """State of the method."""

    angle: float
    omega: float
    v: ComplexArray
    """Fundamental phasors (apart,) of the last windows, the oldest first, V; NaN where there is none."""
    i: ComplexArray
    """A."""
    largest: float
    """Largest current so far, A."""
    R_g: float
    """The last answer, Ω; NaN before the first one."""
    L_g: float


@dataclass(frozen=True)
class TwoWindows:
    """Z = ΔV/ΔI from the fundamental phasors of a window and of the one ``apart`` windows before it
    (:eq:`two-windows`).

    There is a new answer only if the current has changed by ``gate`` times the largest current so far. Otherwise the
    last answer is held.
    """

    at: Installation
    apart: int = 10
    gate: float = 0.05
    believed: float = 0.3
    """An estimate is followed up to this standard deviation, relative to |Z|."""
    title: str = "Two windows ΔV/ΔI"
    signals: str = "two_windows"

    @property
    def needs(self) -> Needs:
        """It needs windows of α and β."""
        return Needs(self.at.samples, self.at.sample_interval)

    def first(self) -> TwoWindowState:
        """Nothing seen."""
        none = np.full(self.apart, np.nan, dtype=complex)
        return TwoWindowState(0.0, np.nan, none, none, 0.0, np.nan, np.nan)

    def probe(self, state: TwoWindowState) -> None:
        """This method needs no probe."""

    def update(self, state: TwoWindowState, samples: Samples) -> tuple[TwoWindowState, Estimate]:
        """The quotient for this window, or the last answer again."""
        at, length = self.at, self.at.sample_interval * sample_count(samples)
        spoilt = SpoiltBy(at.v_limit, at.i_limit).status(samples)
        if spoilt is not None:
            after = self._after(state, complex("nan"), complex("nan"))
            return after._replace(angle=advanced(state.angle, state.omega, length)), no_estimate(spoilt)
        omega = followed_frequency(state.omega, samples.omega, length)
        v, i, angle = turned(samples, state.angle, omega, at.sample_interval)
        v_now, i_now = complex(v.mean()), complex(i.mean())
        dv, di = v_now - complex(state.v[0]), i_now - complex(state.i[0])
        state = self._after(state, v_now, i_now)._replace(
            angle=angle, omega=omega, largest=max(state.largest, abs(i_now))
        )
        if not abs(di) > self.gate * state.largest:  # it is NaN if there is no window to compare with
            if np.isnan(state.R_g):
                return state, no_estimate("waiting", "the current has not changed yet: no estimate")
            return state, Estimate(state.R_g, state.L_g, "held")
        Z = dv / di
        state = state._replace(R_g=Z.real, L_g=Z.imag / omega)
        return state, with_belief(state.R_g, state.L_g, self._covariance(Z, di, omega, len(v)), omega, self.believed)

    def _after(self, state: TwoWindowState, v: complex, i: complex) -> TwoWindowState:
        return state._replace(v=np.append(state.v[1:], v), i=np.append(state.i[1:], i))

    def _covariance(self, Z: complex, di: complex, omega: float, count: int) -> np.ndarray | None:
        """Covariance of (R_g, L_g) from the noise of the sensors (:eq:`bound-two-windows`); None if this is not
        known."""
        if max(self.at.noise) == 0.0:
            return None
        s_v, s_i = (space_vector_variance(deviation) / count for deviation in self.at.noise)
        each = (s_v + abs(Z) ** 2 * s_i) / abs(di) ** 2
        return np.diag([each, each / omega**2])
