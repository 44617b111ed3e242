"""Injection of a pseudo-random binary sequence, with weighted least squares over the lines of its spectrum."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from vsgdesign.identification.classical import advanced, followed_frequency, sample_count, space_vector_variance, turned
from vsgdesign.identification.feeding import near_a_millisecond
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

_ROUNDS = 50


def binary_sequence(length: int, lines: Sequence[int], seed: int = 0) -> Array:
    """A sequence (length,) of ±1 whose power lies as evenly as possible on the given lines of its spectrum.

    Each step gives the wanted spectrum the phases of the last sequence and takes the signs of the result as the next
    sequence (van den Bos and Krol, 1979).
    """
    wanted = np.zeros(length)
    wanted[list(lines)] = wanted[[-line for line in lines]] = 1.0
    x = np.random.default_rng(seed).choice([-1.0, 1.0], length)
    best, most = x, 0.0
    for _ in range(_ROUNDS):
        spectrum = np.fft.fft(x)
        least = float(np.min(np.abs(spectrum[list(lines)])))
        best, most = (x, least) if least > most else (best, most)
        x = np.where(np.fft.ifft(wanted * np.exp(1j * np.angle(spectrum))).real < 0.0, -1.0, 1.0)
    return best


class SequenceState(NamedTuple):
    """State of the method."""

    angle: float
    omega: float
    v: ComplexArray
    """The last two periods (≤ 2n,) in the rotating frame, V."""
    i: ComplexArray
    """A."""


@dataclass(frozen=True)
class PseudoRandomSequence:
    """Injection of a binary voltage on both axes of the converter's frame (:eq:`pseudo-random`).

    Its ``amplitude`` is relative to the rated voltage. The answer of each window comes from the last whole period,
    without the drift from the period before. A period is three cycles of the fundamental, or the whole windows that
    hold at least three. Lines at harmonics are not used, because the grid and the sampled ripple of the bridge put
    voltages there that are no response to the probe.
    """

    at: Installation
    amplitude: float = 0.005
    least_cycles: int = 3
    highest_hz: float = 250.0
    """Highest frequency of a line that is used, in the rotating frame. The inner loops attenuate higher ones."""
    believed: float = 0.3
    """An estimate is followed up to this standard deviation, relative to |Z|."""
    title: str = "PRBS, least squares"
    signals: str = "pseudo_random"

    @property
    def period_windows(self) -> int:
        """Number of windows in a period."""
        return -(-self.least_cycles // self.at.cycles)

    @property
    def cycles(self) -> int:
        """Number of cycles in a period."""
        return self.period_windows * self.at.cycles

    @cached_property
    def hold(self) -> float:
        """Time for which each value is held, s. It is about a millisecond."""
        return near_a_millisecond(self.period_windows * round(self.at.window / self.at.T_s), self.at.T_s)

    @property
    def needs(self) -> Needs:
        """It needs windows of α and β, and the probe."""
        return Needs(self.at.samples, self.at.sample_interval, probe_hold=self.hold)

    @cached_property
    def used_lines(self) -> tuple[int, ...]:
        """Multiples of the sequence's frequency that are used, with both signs."""
        highest = int(self.highest_hz / self.at.nominal_hz * self.cycles)
        return tuple(line for line in range(1, highest + 1) if line % self.cycles)

    @cached_property
    def sequence(self) -> Probe:
        """The sequence as a probe along 45° in the converter's frame."""
        length = round(self.period_windows * self.at.window / self.hold)
        values = self.amplitude * cmath.exp(0.25j * math.pi) * binary_sequence(length, self.used_lines)
        return Probe(values.astype(complex), self.hold)

    def probe(self, state: SequenceState) -> Probe:  # noqa: ARG002
        """The probe, which is always the same sequence."""
        return self.sequence

    def first(self) -> SequenceState:
        """Nothing seen."""
        none = np.zeros(0, dtype=complex)
        return SequenceState(0.0, np.nan, none, none)

    def update(self, state: SequenceState, samples: Samples) -> tuple[SequenceState, Estimate]:
        """Solves weighted least squares. It is iterated, because the weights depend on the impedance."""
        at = self.at
        length = at.sample_interval * sample_count(samples)
        spoilt = SpoiltBy(at.v_limit, at.i_limit).status(samples)
        if spoilt is not None:
            angle = advanced(state.angle, state.omega, length)
            return self.first()._replace(angle=angle, omega=state.omega), no_estimate(spoilt)
        omega = followed_frequency(state.omega, samples.omega, length)
        v, i, angle = turned(samples, state.angle, omega, at.sample_interval)
        count = self.period_windows * at.samples
        kept_v, kept_i = (np.append(old, new)[-2 * count :] for old, new in ((state.v, v), (state.i, i)))
        state = SequenceState(angle, omega, kept_v, kept_i)
        if len(kept_v) < 2 * count:
            return state, no_estimate("waiting")
        V, slip = self._spectrum(kept_v)
        current, _ = self._spectrum(kept_i)
        s_v, s_i = (space_vector_variance(deviation) / count for deviation in at.noise)
        try:
            R_g, L_g, covariance = fit_lines(V, current, omega + slip, s_v, s_i)
        except np.linalg.LinAlgError:
            return state, no_estimate("waiting", "the current has no component at the lines of the probe: no estimate")
        return state, with_belief(R_g, L_g, None if max(at.noise) == 0.0 else covariance, omega, self.believed)

    def lines(self, i: ComplexArray, interval: float) -> tuple[ComplexArray, Array, int]:
        """The data of the error bound, from currents (n,) of the rotating frame.

        Returns the lines in these currents, their frequencies in that frame (rad/s) and the number of last samples over
        which they are taken.
        """
        count = round(self.period_windows * self.at.window / interval)
        found, slip = self._spectrum(i[-2 * count :])
        return found, slip, count

    def _spectrum(self, x: ComplexArray) -> tuple[ComplexArray, Array]:
        """Phasors (M,) beside the fundamental of two periods (2n,) in the rotating frame, and their frequencies (M,),
        rad/s."""
        used = [*self.used_lines, *(-line for line in self.used_lines)]
        still = without_drift(x)
        spacing = 2.0 * math.pi * self.at.nominal_hz / self.cycles
        return np.fft.fft(still)[used] / len(still), spacing * np.array(used, dtype=float)


def without_drift(x: ComplexArray) -> ComplexArray:
    """The second of two periods without the ramp through both, whose lines would hide those of the probe."""
    before, after = np.split(x, 2)
    rise = (after - before).mean()
    return after - rise * (np.arange(len(after)) / len(after) - 0.5)


def fit_lines(
    V: ComplexArray, i: ComplexArray, omega: Array, v_variance: float, i_variance: float
) -> tuple[float, float, Array]:
    """Fits V = (R + jωL)·i over M lines (M,) with noise E|n|² on both (:eq:`fit-lines`).

    Returns R (Ω), L (H) and their covariance (2, 2). The noise of i would make the result too small, so its known share
    is subtracted from the normal matrix. Raises LinAlgError if the lines do not determine R and L.
    """
    columns = np.stack([i, 1j * omega * i], axis=1)
    pure = np.stack([np.ones_like(omega, dtype=complex), 1j * omega], axis=1)
    Z_sq = np.zeros(omega.shape)
    x, left = np.zeros(2), np.eye(2)
    for _ in range(3):
        weight = 1.0 / (v_variance + Z_sq * i_variance + 1e-300)
        normal = (columns.conj().T @ (weight[:, None] * columns)).real
        spent = (pure.conj().T @ (weight[:, None] * pure)).real * i_variance
        right = (columns.conj().T @ (weight * V)).real
        left = normal - spent
        x = np.linalg.solve(left, right)
        Z_sq = x[0] ** 2 + (omega * x[1]) ** 2
    # The weights are 1/E|n|² of a complex error. Each of its two components has half of this variance.
    return float(x[0]), float(x[1]), np.asarray(0.5 * np.linalg.inv(left), dtype=np.float64)
