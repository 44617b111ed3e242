"""Extended Kalman filter of an R–L grid: R, L, the grid's phasor and its frequency as states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsgdesign.estimator.baselines.equation import block_equation
from vsgdesign.estimator.baselines.record import Array, ComplexArray, Estimates, Record
from vsgdesign.parameters.study import Grid


@dataclass(frozen=True)
class ExtendedKalmanFilter:
    """Five states: R_g, L_g, the grid's phasor (2) and how far its frequency is off (:eq:`kalman`).

    R_g and L_g walk at random by ``drift`` (of the base impedance, per √s), the phasor by ``g_drift`` (per unit per
    √s), its frequency by ``omega_drift`` (rad/s per √s).
    """

    guess: Grid
    drift: float = 0.01
    g_drift: float = 1e-4
    omega_drift: float = 1e-3
    name: str = "Extended Kalman filter"
    probe: None = None
    signals: str = "windows"

    def estimate(self, record: Record) -> Estimates:
        """All runs at once, block by block."""
        equation = block_equation(record, self.guess)
        B, count = equation.v.shape
        x = np.zeros((B, 5))
        x[:, :2] = self.guess.R_g / record.Z_base, self.guess.L_g * record.omega_n / record.Z_base
        g = equation.v[:, 0] - x[:, 0] * equation.i[:, 0] - x[:, 1] * equation.slope[:, 0]
        x[:, 2], x[:, 3] = g.real, g.imag
        P = np.tile(np.diag([0.05, 0.05, 0.05, 0.05, 1e-5]), (B, 1, 1))
        h = equation.interval
        walk = np.diag([self.drift**2, self.drift**2, self.g_drift**2, self.g_drift**2, self.omega_drift**2]) * h
        H = np.zeros((B, 2, 5))
        H[:, 0, 2] = H[:, 1, 3] = 1.0
        found = np.full((B, record.windows, 2), np.nan)
        for k in range(count):
            if k > 0:
                x, F = turn_grid(x, h)
                P = F @ P @ F.transpose(0, 2, 1) + walk
            for column, y in enumerate((equation.i[:, k], equation.slope[:, k])):
                H[:, 0, column], H[:, 1, column] = y.real, y.imag
            v = equation.v[:, k]
            error = np.stack([v.real, v.imag], axis=1) - (H @ x[:, :, None])[:, :, 0]
            PH = P @ H.transpose(0, 2, 1)
            S = H @ PH + equation.variance[:, None, None] * np.eye(2)
            solved = np.linalg.solve(S, np.concatenate([error[:, :, None], PH.transpose(0, 2, 1)], axis=2))
            x = x + (PH @ solved[:, :, :1])[:, :, 0]
            P = P - PH @ solved[:, :, 1:]
            P = 0.5 * (P + P.transpose(0, 2, 1))
            window = equation.window_of(k)
            if window is not None:
                found[:, window] = x[:, :2]
        return Estimates(found[:, :, 0] * record.Z_base, found[:, :, 1] * record.Z_base / record.omega_n)


def turn_grid(x: Array, h: float) -> tuple[Array, Array]:
    """States (B, 5) after h s, in which the grid's phasor turns by its frequency's deviation, and their Jacobian."""
    turn: ComplexArray = np.exp(1j * h * x[:, 4])
    g: ComplexArray = (x[:, 2] + 1j * x[:, 3]) * turn
    by_omega: ComplexArray = 1j * h * g
    moved = np.column_stack([x[:, :2], g.real, g.imag, x[:, 4]])
    F = np.tile(np.eye(5), (len(x), 1, 1))
    F[:, 2, 2] = F[:, 3, 3] = turn.real
    F[:, 2, 3], F[:, 3, 2] = -turn.imag, turn.imag
    F[:, 2, 4], F[:, 3, 4] = by_omega.real, by_omega.imag
    return moved, F
