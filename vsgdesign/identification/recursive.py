"""Recursive methods: least squares with variable forgetting, and an extended Kalman filter.

Both fit the R–L equation between the means of successive blocks of samples.
"""

from __future__ import annotations

import cmath
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from vsgdesign.identification.classical import (
    advanced,
    followed_frequency,
    sample_count,
    space_vector_variance,
    turned,
)
from vsgdesign.identification.interface import (
    Array,
    Estimate,
    Installation,
    Needs,
    Samples,
    SpoiltBy,
    no_estimate,
    with_belief,
)

MODEL_VARIANCE = 1e-6
"""Variance of the equation itself, per unit. Sampled ripple changes the voltage by some thousandths, whatever the
sensors are."""


class Equation(NamedTuple):
    """v = R i + X s + g (:eq:`rl-blocks`), per unit: R and X = ω_n L of the base impedance, g the grid's phasor."""

    v: complex
    i: complex
    slope: complex

    @property
    def rows(self) -> tuple[Array, Array]:
        """The factors (2, 2) of (R, X) and the voltage (2,). The rows are the real part and the imaginary part."""
        return (
            np.array([[self.i.real, self.slope.real], [self.i.imag, self.slope.imag]]),
            np.array([self.v.real, self.v.imag]),
        )


class BlockState(NamedTuple):
    """The rotating frame and the last block."""

    angle: float = 0.0
    """Angle of the frame at the next sample, rad."""
    omega: float = float("nan")
    """Frequency of the frame, rad/s; NaN before the first window."""
    v: complex = complex("nan")
    """Mean of the last block, V; NaN if there is none."""
    i: complex = complex("nan")
    """A."""


def blocks_per_window(samples: int) -> int:
    """Number of blocks in a window: two, or one where the number of samples is odd.

    The 5th and 7th harmonics turn at six times the grid's frequency in this frame, so their mean over half a cycle is
    zero.
    """
    return 1 if samples % 2 else 2


def skipped_window(state: BlockState, samples: Samples, interval: float) -> BlockState:
    """The state after samples that cannot be used. The frame turns on, and no equation may span these samples."""
    length = interval * sample_count(samples)
    return BlockState(advanced(state.angle, state.omega, length), state.omega)


def equations(at: Installation, state: BlockState, samples: Samples) -> tuple[BlockState, list[Equation | None]]:
    """One equation for each block together with the block before it; None for a block without one before it.

    The equations use means of blocks and not single samples. The difference of two samples is mostly noise, and noise
    in a regressor makes the estimate of L too small (with 0.1 % noise and 200 µs between samples, by more than half).
    """
    omega = followed_frequency(state.omega, samples.omega, at.sample_interval * sample_count(samples))
    v, i, angle = turned(samples, state.angle, omega, at.sample_interval)
    count = blocks_per_window(len(v))
    T = at.sample_interval * (len(v) // count)
    scale = at.Z_base / at.V_base
    found: list[Equation | None] = []
    v_before, i_before = state.v, state.i
    for v_k, i_k in zip(v.reshape(count, -1).mean(axis=1), i.reshape(count, -1).mean(axis=1), strict=True):
        if np.isfinite(v_before):
            mean_i = 0.5 * (i_k + i_before)
            slope = (i_k - i_before) / T + 1j * omega * mean_i
            found.append(
                Equation(0.5 * (v_k + v_before) / at.V_base, mean_i * scale, slope * scale / at.omega_n),
            )
        else:
            found.append(None)
        v_before, i_before = complex(v_k), complex(i_k)
    return BlockState(angle, omega, v_before, i_before), found


def block_length(at: Installation) -> float:
    """Time between two equations, s."""
    return at.window / blocks_per_window(at.samples)


def equation_variance(at: Installation) -> float:
    """Variance of one component of an equation's error, per unit, from the noise of the sensors.

    The first guess of the grid weighs the noise of the current.
    """
    size = at.samples // blocks_per_window(at.samples)
    R_g, L_g = at.guess
    Z_sq = R_g**2 + (at.omega_n * L_g) ** 2
    block_v, block_i = (space_vector_variance(s) / size for s in at.noise)
    error = 0.5 * (block_v + Z_sq * block_i) + 2.0 * (L_g / block_length(at)) ** 2 * block_i
    return 0.5 * error / at.V_base**2 + MODEL_VARIANCE  # half of it belongs to each of the two components


def in_ohm_and_henry(at: Installation, covariance: Array) -> Array:
    """The covariance (2, 2) of (R_g, L_g) from that of (R, X) in per unit."""
    scale = np.array([at.Z_base, at.Z_base / at.omega_n])
    return covariance * np.outer(scale, scale)


class RecursiveState(NamedTuple):
    """State of a recursive method with n unknowns."""

    blocks: BlockState
    started: int
    """Whether there was an equation: 0 until the first one."""
    x: Array
    """Unknowns (n,): R and X relative to the base impedance, the grid's phasor (2) in per unit, the method's own."""
    P: Array
    """Their covariance (n, n)."""


@dataclass(frozen=True)
class RecursiveMethod(ABC):
    """A method that corrects its unknowns with each equation between two blocks."""

    at: Installation
    believed: float = 0.3
    """An estimate is followed up to this standard deviation, relative to |Z|."""
    signals: str = "windows"

    @property
    def needs(self) -> Needs:
        """It needs windows of α and β."""
        return Needs(self.at.samples, self.at.sample_interval)

    def probe(self, state: RecursiveState) -> None:
        """This method needs no probe."""
        del state

    def update(self, state: RecursiveState, samples: Samples) -> tuple[RecursiveState, Estimate]:
        """The estimate after a window."""
        spoilt = SpoiltBy(self.at.v_limit, self.at.i_limit).status(samples)
        if spoilt is not None:
            state = state._replace(blocks=skipped_window(state.blocks, samples, self.at.sample_interval))
            for _ in range(blocks_per_window(self.at.samples)):
                state = self.later(state)
            return state, no_estimate(spoilt)
        blocks, found = equations(self.at, state.blocks, samples)
        state = state._replace(blocks=blocks)
        for equation in found:
            state = self.later(state)
            if equation is not None:
                state = self.corrected(state, equation)
        if not state.started:
            return state, no_estimate("waiting")
        R, X = state.x[:2]
        R_g, L_g = R * self.at.Z_base, X * self.at.Z_base / self.at.omega_n
        covariance = in_ohm_and_henry(self.at, state.P[:2, :2])
        return state, with_belief(R_g, L_g, covariance, self.at.omega_n, self.believed)

    @abstractmethod
    def first(self) -> RecursiveState:
        """The first guess, with a large covariance."""

    def later(self, state: RecursiveState) -> RecursiveState:
        """The prediction for the next block."""
        return state

    @abstractmethod
    def corrected(self, state: RecursiveState, equation: Equation) -> RecursiveState:
        """The state with what an equation says."""

    def guessed(self, others: Array, P: Array) -> RecursiveState:
        """The state with the first guess of R and X, and with other unknowns behind them."""
        R_g, L_g = self.at.guess
        guess = np.array([R_g / self.at.Z_base, L_g * self.at.omega_n / self.at.Z_base])
        return RecursiveState(BlockState(), 0, np.concatenate([guess, others]), P)

    def solved(self, x: Array, P: Array, H: Array, wanted: Array) -> tuple[Array, Array, float]:
        """Corrects unknowns with the equation H x = wanted. Returns x, P before it is made symmetric, and the square of
        the error over its variance."""
        PH = P @ H.T
        S = H @ PH + self._variance * np.eye(2)
        error = wanted - H @ x
        solved = np.linalg.solve(S, np.column_stack([error, PH.T]))
        return x + PH @ solved[:, 0], P - PH @ solved[:, 1:], float(error @ solved[:, 0])

    @cached_property
    def _variance(self) -> float:
        return equation_variance(self.at)


@dataclass(frozen=True)
class RecursiveLeastSquares(RecursiveMethod):
    """Recursive least squares for R_g, L_g and the grid's phasor (:eq:`rls`).

    The forgetting factor depends on the residual, so that the estimate keeps its information while the samples contain
    nothing new (Fortescue, Kershenbaum and Ydstie, 1981).
    """

    memory: float = 1.0
    """Time for which information is kept while the residual is as large as the noise, s."""
    least_forgetting: float = 0.7
    title: str = "Recursive least squares"

    def first(self) -> RecursiveState:
        return self.guessed(np.zeros(2), np.diag([0.05] * 4))

    def corrected(self, state: RecursiveState, equation: Equation) -> RecursiveState:
        x = state.x
        rows, wanted = equation.rows
        if not state.started:
            x = np.concatenate([x[:2], wanted - rows @ x[:2]])
        x, P, surprise = self.solved(x, state.P, np.hstack([rows, np.eye(2)]), wanted)
        kept = block_length(self.at) / self.memory
        forgetting = min(max(1.0 - 0.5 * kept * surprise, self.least_forgetting), 1.0)
        return state._replace(started=1, x=x, P=0.5 * (P + P.T) / forgetting)


@dataclass(frozen=True)
class ExtendedKalmanFilter(RecursiveMethod):
    """Kalman filter with five states: R_g, L_g, the grid's phasor (2) and the error of its frequency in rad/s
    (:eq:`kalman`).

    The states follow random walks. ``drift`` is that of R_g and L_g (relative to the base impedance, per √s),
    ``g_drift`` that of the phasor (per unit per √s) and ``omega_drift`` that of its frequency (rad/s per √s).
    """

    drift: float = 0.01
    g_drift: float = 1e-4
    omega_drift: float = 1e-3
    title: str = "Extended Kalman filter"

    def first(self) -> RecursiveState:
        return self.guessed(np.zeros(3), np.diag([0.05, 0.05, 0.05, 0.05, 1e-5]))

    def later(self, state: RecursiveState) -> RecursiveState:
        """The prediction for the next block. Before the first equation the state does not change."""
        if not state.started:
            return state
        h = block_length(self.at)
        x, F = turn_grid(state.x, h)
        walk = np.array([self.drift, self.drift, self.g_drift, self.g_drift, self.omega_drift])
        return state._replace(x=x, P=F @ state.P @ F.T + np.diag(walk**2) * h)

    def corrected(self, state: RecursiveState, equation: Equation) -> RecursiveState:
        x = state.x
        rows, wanted = equation.rows
        if not state.started:
            x = np.concatenate([x[:2], wanted - rows @ x[:2], x[4:]])
        H = np.hstack([rows, np.eye(2), np.zeros((2, 1))])
        x, P, _ = self.solved(x, state.P, H, wanted)
        return state._replace(started=1, x=x, P=0.5 * (P + P.T))


def turn_grid(x: Array, h: float) -> tuple[Array, Array]:
    """The states (5,) after h s, in which the grid's phasor turns with the deviation of its frequency, and their
    Jacobian."""
    turn = cmath.exp(1j * h * x[4])
    g = complex(x[2], x[3]) * turn
    by_omega = 1j * h * g
    F = np.eye(5)
    F[2, 2] = F[3, 3] = turn.real
    F[2, 3], F[3, 2] = -turn.imag, turn.imag
    F[2, 4], F[3, 4] = by_omega.real, by_omega.imag
    return np.array([x[0], x[1], g.real, g.imag, x[4]]), F
