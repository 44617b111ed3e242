"""Extended Kalman filter of an R–L grid. Its states are R, L, the phasor of the grid and its frequency."""

from __future__ import annotations

import cmath
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from vsgdesign.identification.blocks import (
    BlockState,
    Equation,
    block_length,
    blocks_per_window,
    equation_variance,
    equations,
    in_ohm_and_henry,
    skipped_window,
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


class KalmanState(NamedTuple):
    """State of the filter."""

    blocks: BlockState
    started: int
    """Whether there was an equation: 0 until the first one."""
    x: Array
    """States (5,): R and X relative to the base impedance, the grid's phasor (2) in per unit, and the deviation of its
    frequency in rad/s."""
    P: Array
    """(5, 5)."""


@dataclass(frozen=True)
class ExtendedKalmanFilter:
    """Kalman filter with five states: R_g, L_g, the grid's phasor (2) and the error of its frequency (:eq:`kalman`).

    The states follow random walks. ``drift`` is that of R_g and L_g (relative to the base impedance, per √s),
    ``g_drift`` that of the phasor (per unit per √s) and ``omega_drift`` that of its frequency (rad/s per √s).
    """

    at: Installation
    drift: float = 0.01
    g_drift: float = 1e-4
    omega_drift: float = 1e-3
    believed: float = 0.3
    """An estimate is followed up to this standard deviation, relative to |Z|."""
    title: str = "Extended Kalman filter"
    signals: str = "windows"

    @property
    def needs(self) -> Needs:
        """It needs windows of α and β."""
        return Needs(self.at.samples, self.at.sample_interval)

    @cached_property
    def _variance(self) -> float:
        return equation_variance(self.at)

    def first(self) -> KalmanState:
        """The first guess, with a large covariance."""
        R_g, L_g = self.at.guess
        x = np.array([R_g / self.at.Z_base, L_g * self.at.omega_n / self.at.Z_base, 0.0, 0.0, 0.0])
        return KalmanState(BlockState(), 0, x, np.diag([0.05, 0.05, 0.05, 0.05, 1e-5]))

    def probe(self, state: KalmanState) -> None:
        """This method needs no probe."""

    def update(self, state: KalmanState, samples: Samples) -> tuple[KalmanState, Estimate]:
        """The estimate after a window."""
        spoilt = SpoiltBy(self.at.v_limit, self.at.i_limit).status(samples)
        if spoilt is not None:
            state = state._replace(blocks=skipped_window(state.blocks, samples, self.at.sample_interval))
            for _ in range(blocks_per_window(self.at.samples)):
                state = self._later(state)
            return state, no_estimate(spoilt)
        blocks, found = equations(self.at, state.blocks, samples)
        state = state._replace(blocks=blocks)
        for equation in found:
            state = self._later(state)
            if equation is not None:
                state = self._corrected(state, equation)
        if not state.started:
            return state, no_estimate("waiting")
        R, X = state.x[:2]
        R_g, L_g = R * self.at.Z_base, X * self.at.Z_base / self.at.omega_n
        covariance = in_ohm_and_henry(self.at, state.P[:2, :2])
        return state, with_belief(R_g, L_g, covariance, self.at.omega_n, self.believed)

    def _later(self, state: KalmanState) -> KalmanState:
        """The prediction for the next block. Before the first equation the state does not change."""
        if not state.started:
            return state
        h = block_length(self.at)
        x, F = turn_grid(state.x, h)
        walk = np.array([self.drift, self.drift, self.g_drift, self.g_drift, self.omega_drift])
        return state._replace(x=x, P=F @ state.P @ F.T + np.diag(walk**2) * h)

    def _corrected(self, state: KalmanState, equation: Equation) -> KalmanState:
        x, P = state.x, state.P
        rows, wanted = equation.rows
        if not state.started:
            x = np.concatenate([x[:2], wanted - rows @ x[:2], x[4:]])
        H = np.hstack([rows, np.eye(2), np.zeros((2, 1))])
        PH = P @ H.T
        S = H @ PH + self._variance * np.eye(2)
        solved = np.linalg.solve(S, np.column_stack([wanted - H @ x, PH.T]))
        x = x + PH @ solved[:, 0]
        P = P - PH @ solved[:, 1:]
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
