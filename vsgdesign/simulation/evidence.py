"""Small steps in EMT beside what the linear models predict: how far a margin can be believed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.model.full_order import PARAMETERS
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.steps import simulate_step
from vsgdesign.stability.assessment import FocusCell
from vsgdesign.stability.steps import full_order_step, reduced_step

Array = NDArray[np.float64]

STEP_PU = 0.002
"""Size of the steps in per unit of rating: small enough to be linear, large enough to be measured."""

_INTERVAL = 1e-3
"""Spacing at which responses are compared, s, to the nearest whole number of samples."""


@dataclass(frozen=True)
class StepEvidence:
    """One reference step of one cell. Responses are deviations in W or var over ``t_s`` from the step."""

    label: str
    signal: str
    """``P`` or ``Q``, at the control point."""
    step: float
    t_s: Array
    emt: Array
    full_order: Array
    reduced: Array

    def error(self, which: str) -> float:
        """Largest distance of a prediction from EMT over the size of the step."""
        return float(np.max(np.abs(getattr(self, which) - self.emt)) / abs(self.step))


def step_evidence(study: Study, cell: FocusCell, duration: float = 3.0) -> tuple[StepEvidence, StepEvidence]:
    """P and Q steps of a focus cell: averaged EMT from the exact steady state against both linear models."""
    model = cell.full_order
    p = dict(zip(PARAMETERS, model.p[0], strict=False))
    gains = PowerLoopGains(*(float(p[name]) for name in PowerLoopGains._fields))
    size = STEP_PU * study.converter.S_rated
    every = max(round(_INTERVAL / model.T_s), 1)
    found = []
    for signal in ("P", "Q"):
        t_s, emt = simulate_step(study, cell.grid, gains, cell.P, cell.Q, signal, size, duration, every)
        full = full_order_step(model, f"{signal}_ref", signal, duration, every)[1]
        _, reduced = reduced_step(cell.reduced, f"{signal}_ref", signal, duration, every * model.T_s)
        count = min(len(emt), full.shape[1], reduced.shape[1])
        predictions = (size * full[0, :count], size * reduced[0, :count])
        found.append(StepEvidence(cell.label, signal, size, t_s[:count], emt[:count], *predictions))
    return found[0], found[1]
