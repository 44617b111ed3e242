"""What moves the source of a run besides its events: a background, or a recorded voltage in place of the source.

A background is the difference between the source's fundamental and that of the events, sample by sample.
From one sample to the next the difference is a constant factor g e^{jψ} on the fundamental's phasor (:eq:`wander`).
Random numbers come in blocks of samples, each with a seed of its own, so that a run may be cut into any stretches and
only a few blocks are kept in memory. Between two samples of the controller a recorded voltage is a straight line
(:eq:`replay`).
"""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.flat import flat_block
from vsgdesign.codegen.llvm import LoopSpec, compiled_loop
from vsgdesign.codegen.normals import NormalStream
from vsgdesign.equations.grid import WanderDrive, WanderPace, WanderPath, wandered
from vsgdesign.study.parameters.background import BackgroundSpec
from vsgdesign.study.parameters.ranges import stream
from vsgdesign.study.parameters.replay import ReplaySpec

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

BLOCK = 8192
"""Samples of a block, which are drawn or interpolated at once."""

_STREAMS = WanderDrive("frequency", "phase walk", "voltage walk", "voltage", "phase_noise", "voltage_noise")
"""The names of their random numbers."""

_KEPT = 2
"""Blocks in memory."""

FORGOTTEN_S = 60.0
"""Time constant with which steps and walk of the magnitude decay, s, as under the voltage control of a grid."""

NOISE_TIME = 0.05
"""Correlation time of the noise, in nominal cycles: white up to some hundred hertz."""


class _InBlocks(ABC):
    """What comes in blocks of samples, of which the last ones are kept: something, and an angle (rad), of each."""

    def __init__(self) -> None:
        self._blocks: dict[int, tuple[Any, Array]] = {}

    def angle_at(self, samples: NDArray[np.int64]) -> Array:
        """The angle at samples in increasing order, rad: of a recorded voltage by how much its fundamental is ahead of
        the one that begins the record, as the phase of its mean over the cycle around the sample."""
        found = np.empty(len(samples))
        for block in np.unique(samples // BLOCK).tolist():
            begin, end = np.searchsorted(samples, [block * BLOCK, (block + 1) * BLOCK])
            found[begin:end] = self._block(block)[1][samples[begin:end] - block * BLOCK]
        return found

    def _between(self, first: int, count: int) -> tuple[Any, Array]:
        parts, done = list[list[Array]](), 0
        while done < count or not parts:
            block, at = divmod(first + done, BLOCK)
            parts.append([whole[at : at + count - done] for whole in self._block(block)])
            done += len(parts[-1][0])
        one, angle = (np.concatenate(part) for part in zip(*parts, strict=True))
        return one, angle

    def _block(self, index: int) -> tuple[Any, Array]:
        if index not in self._blocks:
            self._blocks[index] = self._made(index)
            while len(self._blocks) > _KEPT:
                del self._blocks[next(iter(self._blocks))]
        return self._blocks[index]

    @abstractmethod
    def _made(self, index: int) -> tuple[Any, Array]:
        """What a block has of each of its samples: something, and an angle (rad)."""


class Wander(_InBlocks):
    """The factor g e^{jψ} of a background over time (:eq:`wander`). Without noise and modulation it is 1 at t = 0."""

    def __init__(self, spec: BackgroundSpec, T_s: float, omega_n: float) -> None:
        """``T_s``: the sampling period, s. ``omega_n``: nominal angular frequency, rad/s."""
        self.spec, self.T_s = spec, T_s
        self._cycle = 2.0 * math.pi / omega_n
        first = WanderPath(phase_noise=self._first("phase_noise"), voltage_noise=self._first("voltage_noise"))
        self._starts, self._pace = [first], np.array(self._paces())
        self._scales = self._scales_of(WanderPace(*self._pace.tolist()))
        super().__init__()

    def factors(self, first: int, count: int) -> tuple[Array, Array]:
        """Gain g and angle ψ (rad) at samples first … first + count − 1."""
        return self._between(first, count)

    def _made(self, index: int) -> tuple[Array, Array]:
        for before in range(len(self._starts) - 1, index):
            self._path(before)
        return self._path(index)

    def _path(self, index: int) -> tuple[Array, Array]:
        """Generate a block, and keep where the next one begins."""
        spec, loop = self.spec, compiled_loop(path_spec())
        fed, log = np.zeros((1, BLOCK, len(_STREAMS), 1)), np.empty((1, BLOCK, 2, 1))
        for k, (name, scale) in enumerate(zip(_STREAMS, self._scales, strict=True)):
            if scale > 0.0:
                normal_stream(spec.seed, name, index).put(fed[0, :, k], np.array([scale]))
        drive = WanderDrive(*fed[0, :, :, 0].T)
        self._add_steps(drive.turned, index, "phase jumps", spec.phase_jumps_per_minute, spec.phase_jump)
        self._add_steps(drive.slow, index, "voltage steps", spec.voltage_steps_per_minute, spec.voltage_step)
        path = np.array(self._starts[index])[None, :, None]
        loop(0, BLOCK, path, self._pace, fed=fed, log=log, every=1)
        if len(self._starts) == index + 1:
            self._starts.append(WanderPath(*path[0, :, 0].tolist()))
        gain = np.exp(log[0, :, 0, 0])
        if spec.modulation > 0.0:
            turns = spec.modulation_frequency * (index * BLOCK + np.arange(BLOCK, dtype=np.float64)) * self.T_s
            gain *= 1.0 + spec.modulation * np.cos(2.0 * math.pi * (turns % 1.0) + spec.modulation_phase)
        return gain, log[0, :, 1, 0].copy()

    def _paces(self) -> WanderPace:
        spec, h = self.spec, self.T_s
        pulled = (
            math.exp(-0.5 * h * (wander / deviation) ** 2) if wander > 0.0 else 1.0
            for wander, deviation in (
                (spec.frequency_wander, spec.frequency_deviation),
                (spec.voltage_wander, spec.voltage_deviation),
            )
        )
        frequency, magnitude = pulled
        noise = math.exp(-h / (NOISE_TIME * self._cycle))
        return WanderPace(frequency, math.exp(-h / FORGOTTEN_S), magnitude, noise, 2.0 * math.pi * h)

    def _scales_of(self, pace: WanderPace) -> WanderDrive:
        """Of the normal numbers. What is pulled back to zero keeps its rms value so."""
        spec = self.spec
        step = spec.phasor_walk * math.sqrt(0.5 * self.T_s / self._cycle)
        left = math.sqrt(1.0 - pace.noise * pace.noise)
        return WanderDrive(
            frequency=spec.frequency_deviation * math.sqrt(1.0 - pace.frequency * pace.frequency),
            turned=step,
            slow=step,
            magnitude=spec.voltage_deviation * math.sqrt(1.0 - pace.magnitude * pace.magnitude),
            phase_noise=self._rms("phase_noise") * left,
            voltage_noise=self._rms("voltage_noise") * left,
        )

    def _first(self, name: str) -> float:
        return self._rms(name) * float(stream(self.spec.seed, name, "first").standard_normal())

    def _rms(self, name: str) -> float:
        """Rms value of noise whose mean over the n samples of a cycle has the one that is asked for."""
        n = self._cycle / self.T_s
        kept = math.exp(-1.0 / (n * NOISE_TIME))
        share = (1.0 + kept) / (1.0 - kept) / n - 2.0 * kept * (1.0 - kept**n) / ((1.0 - kept) * n) ** 2
        return getattr(self.spec, name) / math.sqrt(share)

    def _add_steps(self, found: Array, index: int, name: str, per_minute: float, sizes: tuple[float, float]) -> None:
        """Steps of either sign at random instants, each at the sample that follows."""
        if per_minute > 0.0:
            rng = stream(self.spec.seed, name, index)
            count = int(rng.poisson(per_minute / 60.0 * BLOCK * self.T_s))
            places, signs = rng.integers(0, BLOCK, count), rng.choice([-1.0, 1.0], count)
            np.add.at(found, places, signs * rng.uniform(*sizes, count))


@functools.cache
def path_spec() -> LoopSpec:
    """The loop of a source's path, a sample after the other."""
    block = flat_block(wandered)
    return LoopSpec(
        bodies=(block,),
        state=tuple((f"path.{name}", f"following.{name}") for name in WanderPath._fields),
        uniform=tuple(f"pace.{name}" for name in WanderPace._fields),
        fed=tuple(f"drive.{name}" for name in WanderDrive._fields),
        logged=("exponent", "angle"),
        strict=True,
    )


def normal_stream(seed: int, *names: str | int) -> NormalStream:
    """The normal numbers of one purpose, which ``names`` tell from all others of the same seed."""
    return NormalStream(stream(seed, *names).bit_generator)


class Replay(_InBlocks):
    """The record of a study in a run. ``T_s``: the sampling period, s."""

    def __init__(self, spec: ReplaySpec, T_s: float) -> None:
        self.spec, self.T_s = spec, T_s
        self._half = math.pi / spec.omega_g
        self._reach = math.ceil(self._half / T_s) + 1
        super().__init__()

    def vectors(self, first: int, count: int) -> Complex:
        """The source's space vector at samples first … first + count − 1, V peak."""
        return self._between(first, count)[0]

    def _made(self, index: int) -> tuple[Complex, Array]:
        T_s, reach = self.T_s, self._reach
        t_s: Array = (index * BLOCK + np.arange(-reach, BLOCK + reach + 1, dtype=np.float64)) * T_s
        t_s = t_s[t_s <= self.spec.usable]
        v = self.spec.vector(t_s)
        still = v * np.exp(-1j * (self.spec.omega_g * t_s + self.spec.phase))
        area = np.concatenate([[0.0], np.cumsum(0.5 * T_s * (still[1:] + still[:-1]))])
        inner = slice(reach, min(reach + BLOCK, len(t_s) - reach))
        ends = [np.interp(t_s[inner] + side * self._half, t_s, area) for side in (1.0, -1.0)]
        return v[inner], np.angle(ends[0] - ends[1])
