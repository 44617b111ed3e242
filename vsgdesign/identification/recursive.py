"""Recursive methods: least squares with variable forgetting, and an extended Kalman filter."""

from __future__ import annotations

import cmath
from dataclasses import dataclass

import numpy as np

from vsgdesign.identification.blocks import Equation, RecursiveMethod, RecursiveState, block_length
from vsgdesign.identification.interface import Array


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
