"""A pseudo-random binary sequence, and weighted least squares over the lines of its spectrum."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.estimator.baselines.record import ComplexArray, Estimates, Record
from vsgdesign.estimator.bound import space_vector_variance
from vsgdesign.simulation import Probe

Array = NDArray[np.float64]

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


@dataclass(frozen=True)
class PseudoRandomSequence:
    """A binary voltage of ``amplitude`` (of rated) on both axes of the converter's frame; every window's answer is
    from the last whole period, less what drifts from the period before to it (:eq:`pseudo-random`).

    A period is ``cycles`` of the fundamental and the lines that are harmonics are left out: whatever the grid or the
    sampled ripple of the bridge puts there is no answer to the probe.
    """

    amplitude: float = 0.005
    cycles: int = 3
    nominal_hz: float = 50.0
    hold: float = 1e-3
    highest_hz: float = 250.0
    """Lines up to here, in the rotating frame, are used: beyond, the inner loops let little through."""
    name: str = "PRBS, least squares"
    signals: str = "pseudo_random"

    @property
    def used_lines(self) -> tuple[int, ...]:
        """Multiples of the sequence's frequency that are used, of both signs."""
        highest = int(self.highest_hz / self.nominal_hz * self.cycles)
        return tuple(line for line in range(1, highest + 1) if line % self.cycles)

    @property
    def probe(self) -> Probe:
        """The sequence, along 45° of the converter's frame."""
        length = round(self.cycles / self.nominal_hz / self.hold)
        return Probe(self.amplitude * np.exp(0.25j * math.pi) * binary_sequence(length, self.used_lines), self.hold)

    def period(self, sample_interval: float) -> int:
        """Samples of one period."""
        return round(self.cycles / self.nominal_hz / sample_interval)

    def lines(self, x: ComplexArray) -> tuple[ComplexArray, Array]:
        """(B, M) phasors of two periods (B, 2n), rotating, beside the fundamental; their frequencies (M,), rad/s."""
        used = [*self.used_lines, *(-line for line in self.used_lines)]
        still = _without_drift(x)
        return np.fft.fft(still, axis=1)[:, used] / still.shape[1], 2.0 * math.pi * self.nominal_hz / self.cycles * (
            np.array(used, dtype=float)
        )

    def estimate(self, record: Record) -> Estimates:
        """Weighted least squares, in two rounds: the weights need the impedance."""
        v, i = record.rotating()
        count = self.period(record.sample_interval)
        v_variance, i_variance = (
            np.array([space_vector_variance(getattr(noise, name)) for noise in record.noise]) / count
            for name in ("v", "i")
        )
        R, L = (np.full((len(v), record.windows), np.nan) for _ in range(2))
        for window in range(record.windows):
            end = (window + 1) * record.samples
            if end < 2 * count:
                continue
            V, slip = self.lines(v[:, end - 2 * count : end])
            current, _ = self.lines(i[:, end - 2 * count : end])
            omega = record.omega[:, None] + slip[None, :]
            R[:, window], L[:, window] = fit_lines(V, current, omega, v_variance, i_variance)
        return Estimates(R, L)


def _without_drift(x: ComplexArray) -> ComplexArray:
    """The second of two periods without the ramp that runs through both: its lines would drown the probe's."""
    before, after = np.split(x, 2, axis=1)
    rise = (after - before).mean(axis=1, keepdims=True)
    return after - rise * (np.arange(after.shape[1]) / after.shape[1] - 0.5)


def fit_lines(
    V: ComplexArray, i: ComplexArray, omega: Array, v_variance: Array, i_variance: Array
) -> tuple[Array, Array]:
    """R (B,) and L (B,) of V = (R + jωL)·i over M lines (B, M) with noise E|n|² (B,) on both (:eq:`fit-lines`).

    The noise of i would make the answer small; its known share is taken out of the normal matrix.
    """
    columns = np.stack([i, 1j * omega * i], axis=2)
    pure = np.stack([np.ones_like(omega, dtype=complex), 1j * omega], axis=2)
    Z_sq = np.zeros(omega.shape)
    x = np.zeros((len(V), 2))
    for _ in range(3):
        weight = 1.0 / (v_variance[:, None] + Z_sq * i_variance[:, None] + 1e-300)
        normal = np.einsum("bma,bm,bmc->bac", columns.conj(), weight, columns).real
        spent = np.einsum("bma,bm,bmc->bac", pure.conj(), weight, pure).real * i_variance[:, None, None]
        right = np.einsum("bma,bm,bm->ba", columns.conj(), weight, V).real
        x = np.linalg.solve(normal - spent, right[:, :, None])[:, :, 0]
        Z_sq = x[:, :1] ** 2 + (omega * x[:, 1:]) ** 2
    return x[:, 0], x[:, 1]
