"""The data of a stability report, and the names of its files. A part of it are small steps in EMT compared with the
predictions of the linear models, as evidence for the margins."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.model.coupled import INPUTS, OUTPUTS, CoupledModel
from vsgdesign.linear.model.full_order import INPUTS as FULL_INPUTS
from vsgdesign.linear.model.full_order import OUTPUTS as FULL_OUTPUTS
from vsgdesign.linear.model.full_order import PARAMETERS
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.stability.assessment import ControllerAssessment, FocusCell
from vsgdesign.linear.stability.maps import MarginMap
from vsgdesign.linear.stability.modes_of_units import DifferentialWorst
from vsgdesign.linear.stability.step_responses import full_order_step, reduced_step
from vsgdesign.linear.stability.verdict import Verdict
from vsgdesign.simulation.steps import simulate_step
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

STEP_PU = 0.002
"""Size of the steps in per unit of rating: small enough to be linear, large enough to be measured."""

_SOURCES: tuple[str, ...] = ("emt", "full_order", "reduced")

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
    final: dict[str, float]
    """Final values of ``emt``, ``full_order`` and ``reduced``, W or var. They are the steady states of the two models;
    that of EMT is that of the full-order model."""
    decay: dict[str, float]
    """Decay rate of the slowest mode of each, 1/s. It is not positive if the mode does not decay."""

    def error(self, which: str) -> float:
        """Largest distance of a prediction from EMT over the size of the step."""
        return float(np.max(np.abs(getattr(self, which) - self.emt)) / abs(self.step))


def step_evidence(study: Study, cell: FocusCell, duration: float = 3.0) -> tuple[StepEvidence, StepEvidence]:
    """P and Q steps of one cell: EMT with an averaged bridge from the exact steady state, and both linear models."""
    model = cell.full_order
    p = dict(zip(PARAMETERS, model.p[0], strict=False))
    gains = PowerLoopGains(*(float(p[name]) for name in PowerLoopGains._fields))
    size = STEP_PU * study.converter.S_rated
    slowest = -cell.modes[0].s.real, -float(np.linalg.eigvals(cell.reduced.A[0]).real.max())
    decay = dict(zip(_SOURCES, (slowest[0], *slowest), strict=True))
    every = max(round(_INTERVAL / model.T_s), 1)
    found = []
    for signal in ("P", "Q"):
        t_s, emt = simulate_step(study, cell.grid, gains, cell.P, cell.Q, signal, size, duration, every)
        full = full_order_step(model, f"{signal}_ref", signal, duration, every)[1]
        _, reduced = reduced_step(cell.reduced, f"{signal}_ref", signal, duration, every * model.T_s)
        count = min(len(emt), full.shape[1], reduced.shape[1])
        predictions = (size * full[0, :count], size * reduced[0, :count])
        ends = _gain_at_rest(model, signal), _reduced_gain_at_rest(cell.reduced, signal)
        final = dict(zip(_SOURCES, (size * ends[0], size * ends[0], size * ends[1]), strict=True))
        found.append(StepEvidence(cell.label, signal, size, t_s[:count], emt[:count], *predictions, final, decay))
    return found[0], found[1]


def _gain_at_rest(model: FullOrderModel, signal: str) -> float:
    """C (I − A)⁻¹ B + D of one reference to its own power."""
    k, row = FULL_INPUTS.index(f"{signal}_ref"), FULL_OUTPUTS.index(signal)
    A, B, C, D = model.A[0], model.B[0], model.C[0], model.D[0]
    return float(C[row] @ np.linalg.solve(np.eye(len(A)) - A, B[:, k]) + D[row, k])


def _reduced_gain_at_rest(model: CoupledModel, signal: str) -> float:
    k, row = INPUTS.index(f"{signal}_ref"), OUTPUTS.index(signal)
    return float(model.D[0, row, k] - model.C[0, row] @ np.linalg.solve(model.A[0], model.B[0, :, k]))


MAP_KINDS = ("reduced", "full_order", "stale", "estimate_error")
"""Maps of one controller, as their files name them."""


@dataclass(frozen=True)
class StabilityResult:
    """The data of a stability report. The keys of ``evidence`` are (controller, label of the cell)."""

    study: Study
    assessments: tuple[ControllerAssessment, ...]
    evidence: dict[tuple[str, str], tuple[StepEvidence, StepEvidence]]
    verdicts: tuple[Verdict, ...]
    timing_s: dict[str, float]
    ready: Ready = NOTHING
    """The gain tables that the controllers were assessed with."""
    differential: tuple[DifferentialWorst, ...] = ()
    """Of each controller, where the study is one of several equal units."""
    whole: Study | None = None
    """The study with their plant."""


def slug(label: str) -> str:
    """A label as part of a file name."""
    return re.sub(r"[^A-Za-z0-9.]+", "_", label).strip("_")


def maps_of(a: ControllerAssessment) -> dict[str, MarginMap]:
    """The maps that a controller has, by kind."""
    fields = dict(zip(MAP_KINDS, (a.reduced, a.full_order, a.stale, a.estimate_error), strict=True))
    return {kind: field for kind, field in fields.items() if field is not None}


def map_file(controller: str, kind: str) -> str:
    """File of one map."""
    return f"map_{controller}_{kind}.csv"


def frequency_file(controller: str, label: str) -> str:
    """File of one cell over frequency."""
    return f"frequency_{controller}_{slug(label)}.csv"


def step_file(controller: str, label: str, signal: str) -> str:
    """File of one small step."""
    return f"step_{signal}_{controller}_{slug(label)}.csv"
