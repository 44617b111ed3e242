"""Recursive least squares with variable forgetting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsgdesign.estimator.baselines.equation import block_equation
from vsgdesign.estimator.baselines.record import Array, ComplexArray, Estimates, Record
from vsgdesign.parameters.study import Grid


@dataclass(frozen=True)
class RecursiveLeastSquares:
    """Unknown: R_g, L_g and the grid's phasor (:eq:`rls`). The forgetting factor follows the surprise, so that what
    was learnt stays where nothing new is seen (Fortescue, Kershenbaum and Ydstie, 1981)."""

    guess: Grid
    memory: float = 1.0
    """How long information lasts where the residual is as large as the noise, s."""
    least_forgetting: float = 0.7
    name: str = "Recursive least squares"
    probe: None = None
    signals: str = "windows"

    def estimate(self, record: Record) -> Estimates:
        """All runs at once, block by block."""
        equation = block_equation(record, self.guess)
        B, count = equation.v.shape
        one = np.ones_like(equation.i)
        columns = np.stack([equation.i, equation.slope, one, 1j * one], axis=2)
        rows, wanted = _real(columns), _real(equation.v)
        x = np.zeros((B, 4))
        x[:, :2] = self.guess.R_g / record.Z_base, self.guess.L_g * record.omega_n / record.Z_base
        x[:, 2:] = wanted[:, 0] - (rows[:, 0, :, :2] @ x[:, :2, None])[:, :, 0]
        P = np.tile(np.diag([0.05, 0.05, 0.05, 0.05]), (B, 1, 1))
        kept = equation.interval / self.memory
        found = np.full((B, record.windows, 2), np.nan)
        for k in range(count):
            H = rows[:, k]
            PH = P @ H.transpose(0, 2, 1)
            S = H @ PH + equation.variance[:, None, None] * np.eye(2)
            error = wanted[:, k] - (H @ x[:, :, None])[:, :, 0]
            solved = np.linalg.solve(S, np.concatenate([error[:, :, None], PH.transpose(0, 2, 1)], axis=2))
            x = x + (PH @ solved[:, :, :1])[:, :, 0]
            P = P - PH @ solved[:, :, 1:]
            surprise = np.sum(error * solved[:, :, 0], axis=1)
            forgetting = np.clip(1.0 - 0.5 * kept * surprise, self.least_forgetting, 1.0)
            P = 0.5 * (P + P.transpose(0, 2, 1)) / forgetting[:, None, None]
            window = equation.window_of(k)
            if window is not None:
                found[:, window] = x[:, :2]
        return Estimates(found[:, :, 0] * record.Z_base, found[:, :, 1] * record.Z_base / record.omega_n)


def _real(x: ComplexArray) -> Array:
    """(B, K, …) complex as (B, K, 2, …) real."""
    return np.stack([x.real, x.imag], axis=2)
