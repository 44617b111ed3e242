"""Recursive least squares with variable forgetting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsgdesign.identification.blocks import Equation, RecursiveMethod, RecursiveState, block_length


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
