"""Extended Kalman filter of an R–L grid: R, L, the grid's phasor and its frequency as states."""

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
    """What the filter remembers."""

    blocks: BlockState
    started: int
    """0 until the first equation."""
    x: Array
    """(5,): R and X of the base impedance, the grid's phasor per unit, its frequency's deviation in rad/s."""
    P: Array
    """(5, 5)."""


@dataclass(frozen=True)
class ExtendedKalmanFilter:
    """Five states: R_g, L_g, the grid's phasor (2) and how far its frequency is off (:eq:`kalman`).

    R_g and L_g walk at random by ``drift`` (of the base impedance, per √s), the phasor by ``g_drift`` (per unit per
    √s), its frequency by ``omega_drift`` (rad/s per √s).
    """

    at: Installation
    drift: float = 0.01
    g_drift: float = 1e-4
    omega_drift: float = 1e-3
    believed: float = 0.3
    """Largest standard deviation, relative to |Z|, of an estimate that is followed."""
    title: str = "Extended Kalman filter"
    signals: str = "windows"

    @property
    def needs(self) -> Needs:
        """Windows of α and β."""
        return Needs(self.at.samples, self.at.sample_interval)

    @cached_property
    def _variance(self) -> float:
        return equation_variance(self.at)

    def first(self) -> KalmanState:
        """The guess, with a wide covariance."""
        R_g, L_g = self.at.guess
        x = np.array([R_g / self.at.Z_base, L_g * self.at.omega_n / self.at.Z_base, 0.0, 0.0, 0.0])
        return KalmanState(BlockState(), 0, x, np.diag([0.05, 0.05, 0.05, 0.05, 1e-5]))

    def probe(self, state: KalmanState) -> None:
        """It asks for none."""

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
        """The prediction for the next block; there is nothing to predict before the first equation."""
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
    """States (5,) after h s, in which the grid's phasor turns by its frequency's deviation, and their Jacobian."""
    turn = cmath.exp(1j * h * x[4])
    g = complex(x[2], x[3]) * turn
    by_omega = 1j * h * g
    F = np.eye(5)
    F[2, 2] = F[3, 3] = turn.real
    F[2, 3], F[3, 2] = -turn.imag, turn.imag
    F[2, 4], F[3, 4] = by_omega.real, by_omega.imag
    return np.array([x[0], x[1], g.real, g.imag, x[4]]), F
