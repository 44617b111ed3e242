"""Recursive least squares with variable forgetting."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from vsgdesign.identification.blocks import (
    BlockState,
    Equation,
    block_length,
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


class RecursiveState(NamedTuple):
    """State of recursive least squares."""

    blocks: BlockState
    started: int
    """Whether there was an equation: 0 until the first one."""
    x: Array
    """Unknowns (4,): R and X relative to the base impedance, and the grid's phasor (2) in per unit."""
    P: Array
    """(4, 4)."""


@dataclass(frozen=True)
class RecursiveLeastSquares:
    """Recursive least squares for R_g, L_g and the grid's phasor (:eq:`rls`).

    The forgetting factor depends on the residual, so that the estimate keeps its information while the samples contain
    nothing new (Fortescue, Kershenbaum and Ydstie, 1981).
    """

    at: Installation
    memory: float = 1.0
    """Time for which information is kept while the residual is as large as the noise, s."""
    least_forgetting: float = 0.7
    believed: float = 0.3
    """An estimate is followed up to this standard deviation, relative to |Z|."""
    title: str = "Recursive least squares"
    signals: str = "windows"

    @property
    def needs(self) -> Needs:
        """It needs windows of α and β."""
        return Needs(self.at.samples, self.at.sample_interval)

    @cached_property
    def _variance(self) -> float:
        return equation_variance(self.at)

    def first(self) -> RecursiveState:
        """The first guess, with a large covariance."""
        R_g, L_g = self.at.guess
        x = np.array([R_g / self.at.Z_base, L_g * self.at.omega_n / self.at.Z_base, 0.0, 0.0])
        return RecursiveState(BlockState(), 0, x, np.diag([0.05] * 4))

    def probe(self, state: RecursiveState) -> None:
        """This method needs no probe."""

    def update(self, state: RecursiveState, samples: Samples) -> tuple[RecursiveState, Estimate]:
        """The estimate after a window."""
        spoilt = SpoiltBy(self.at.v_limit, self.at.i_limit).status(samples)
        if spoilt is not None:
            blocks = skipped_window(state.blocks, samples, self.at.sample_interval)
            return state._replace(blocks=blocks), no_estimate(spoilt)
        blocks, found = equations(self.at, state.blocks, samples)
        state = state._replace(blocks=blocks)
        for equation in found:
            if equation is not None:
                state = self._learnt(state, equation)
        if not state.started:
            return state, no_estimate("waiting")
        R, X = state.x[:2]
        R_g, L_g = R * self.at.Z_base, X * self.at.Z_base / self.at.omega_n
        covariance = in_ohm_and_henry(self.at, state.P[:2, :2])
        return state, with_belief(R_g, L_g, covariance, self.at.omega_n, self.believed)

    def _learnt(self, state: RecursiveState, equation: Equation) -> RecursiveState:
        x, P = state.x, state.P
        rows, wanted = equation.rows
        if not state.started:
            x = np.concatenate([x[:2], wanted - rows @ x[:2]])
        H = np.hstack([rows, np.eye(2)])
        PH = P @ H.T
        S = H @ PH + self._variance * np.eye(2)
        error = wanted - H @ x
        solved = np.linalg.solve(S, np.column_stack([error, PH.T]))
        x = x + PH @ solved[:, 0]
        P = P - PH @ solved[:, 1:]
        surprise = float(error @ solved[:, 0])
        kept = block_length(self.at) / self.memory
        forgetting = min(max(1.0 - 0.5 * kept * surprise, self.least_forgetting), 1.0)
        return state._replace(started=1, x=x, P=0.5 * (P + P.T) / forgetting)
