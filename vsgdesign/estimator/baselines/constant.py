"""The guess that never looks: what any method must be better than."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsgdesign.estimator.baselines.record import Estimates, Record
from vsgdesign.parameters.study import Grid


@dataclass(frozen=True)
class ConstantGuess:
    """Always the same grid."""

    grid: Grid
    name: str = "Constant guess"
    probe: None = None
    signals: str = "none"

    def estimate(self, record: Record) -> Estimates:
        """The guess, for every window."""
        return Estimates(np.full_like(record.R_g, self.grid.R_g), np.full_like(record.L_g, self.grid.L_g))
