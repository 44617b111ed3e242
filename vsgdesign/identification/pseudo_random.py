"""A pseudo-random binary sequence, and weighted least squares over the lines of its spectrum."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
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

_ROUNDS = 50


def binary_sequence(length: int, lines: Sequence[int], seed: int = 0) -> Array:
    """(length,) of ±1 with its power, as far as it can be had, evenly on some lines of its spectrum.

    Signs of the wanted spectrum, with the phases of the sequence before, over and over (van den Bos and Krol, 1979).
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
    """What the method remembers."""

    angle: float
    omega: float
    v: ComplexArray
    """(≤ 2n,): the last two periods in the rotating frame, V."""
    i: ComplexArray
    """A."""


@dataclass(frozen=True)
class PseudoRandomSequence:
    """A binary voltage of ``amplitude`` (of rated) on both axes of the converter's frame; every window's answer is
    from the last whole period, less what drifts from the period before to it (:eq:`pseudo-random`).

    A period is three cycles of the fundamental, or whole windows of at least as many, and the lines that are harmonics
    are left out: whatever the grid or the sampled ripple of the bridge puts there is no answer to the probe.
    """

    at: Installation
    amplitude: float = 0.005
    least_cycles: int = 3
    highest_hz: float = 250.0
    """Lines up to here, in the rotating frame, are used: beyond, the inner loops let little through."""
    believed: float = 0.3
    """Largest standard deviation, relative to |Z|, of an estimate that is followed."""
    title: str = "PRBS, least squares"
    signals: str = "pseudo_random"

    @property
    def period_windows(self) -> int:
        """Windows of a period."""
        return -(-self.least_cycles // self.at.cycles)

    @property
    def cycles(self) -> int:
        """Cycles of a period."""
        return self.period_windows * self.at.cycles

    @cached_property
    def hold(self) -> float:
        """For how long each value is held, s: about a millisecond."""
        return near_a_millisecond(self.period_windows * round(self.at.window / self.at.T_s), self.at.T_s)

    @property
    def needs(self) -> Needs:
        """Windows of α and β, and the probe."""
        return Needs(self.at.samples, self.at.sample_interval, probe_hold=self.hold)

    @cached_property
    def used_lines(self) -> tuple[int, ...]:
        """Multiples of the sequence's frequency that are used, of both signs."""
        highest = int(self.highest_hz / self.at.nominal_hz * self.cycles)
        return tuple(line for line in range(1, highest + 1) if line % self.cycles)

    @cached_property
    def sequence(self) -> Probe:
        """The sequence, along 45° of the converter's frame."""
        length = round(self.period_windows * self.at.window / self.hold)
        values = self.amplitude * cmath.exp(0.25j * math.pi) * binary_sequence(length, self.used_lines)
        return Probe(values.astype(complex), self.hold)

    def probe(self, state: SequenceState) -> Probe:  # noqa: ARG002
        """Always the same sequence."""
        return self.sequence

    def first(self) -> SequenceState:
        """Nothing seen."""
        none = np.zeros(0, dtype=complex)
        return SequenceState(0.0, np.nan, none, none)

    def update(self, state: SequenceState, samples: Samples) -> tuple[SequenceState, Estimate]:
        """Weighted least squares, in rounds: the weights need the impedance."""
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
            return state, no_estimate("waiting", "no current answers on the probe's lines: no estimate")
        return state, with_belief(R_g, L_g, None if max(at.noise) == 0.0 else covariance, omega, self.believed)

    def lines(self, i: ComplexArray, interval: float) -> tuple[ComplexArray, Array, int]:
        """What a bound is about: the lines in currents (n,) of the rotating frame, their frequencies in that frame
        (rad/s) and over how many of their last samples they are taken."""
        count = round(self.period_windows * self.at.window / interval)
        found, slip = self._spectrum(i[-2 * count :])
        return found, slip, count

    def _spectrum(self, x: ComplexArray) -> tuple[ComplexArray, Array]:
        """(M,) phasors of two periods (2n,), rotating, beside the fundamental; their frequencies (M,), rad/s."""
        used = [*self.used_lines, *(-line for line in self.used_lines)]
        still = without_drift(x)
        spacing = 2.0 * math.pi * self.at.nominal_hz / self.cycles
        return np.fft.fft(still)[used] / len(still), spacing * np.array(used, dtype=float)


def without_drift(x: ComplexArray) -> ComplexArray:
    """The second of two periods without the ramp that runs through both: its lines would drown the probe's."""
    before, after = np.split(x, 2)
    rise = (after - before).mean()
    return after - rise * (np.arange(len(after)) / len(after) - 0.5)


def fit_lines(
    V: ComplexArray, i: ComplexArray, omega: Array, v_variance: float, i_variance: float
) -> tuple[float, float, Array]:
    """R (Ω), L (H) and their covariance (2, 2) of V = (R + jωL)·i over M lines (M,) with noise E|n|² on both
    (:eq:`fit-lines`).

    The noise of i would make the answer small; its known share is taken out of the normal matrix. Raises LinAlgError
    where the lines say nothing.
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
    # The weights are 1/E|n|² of a complex error, of which each of the two components has half.
    return float(x[0]), float(x[1]), np.asarray(0.5 * np.linalg.inv(left), dtype=np.float64)
