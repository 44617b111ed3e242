"""Where the linear certificate holds: the steps after which no limit of the controller acts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import StepRow, StepStatement, no_room
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.certificate.boxes import encloses
from vsgdesign.certificate.certifying import prepared, proved_between
from vsgdesign.certificate.lyapunov import Motion, largest_level_set, residual
from vsgdesign.certificate.proof import worst_points
from vsgdesign.certificate.region import MeasuredSchedule, Region, System, nodes, random_points
from vsgdesign.certificate.results import GAP_FREE, GRIDDED, Certificate, Counterexample, Places
from vsgdesign.certificate.step_proof import prove_steps
from vsgdesign.certificate.step_terms import ActingLimits, LevelShape, acting_limits, rest_current_pu, step_sizes
from vsgdesign.execution.executors import Each
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

_DECAY = 0.25
"""Share of the certificate's decay that the function for the steps has to have. With less it hardly reaches further."""

_ROOM = 1.15
"""How much faster the function decays at the points than it has to between them."""

_V_SHARES = (1.0, 0.5, 0.25, 0.125)
"""Largest ΔV² of the set, relative to the largest |Δv|², that are tried."""

_LOADS = (0.5, 0.75, 1.0)
"""Shares of the region's P and Q."""

_BANDS = 3
"""Into how many parts the SCR is cut, of equal ratio."""

_POINTS = 6_000
_ATTEMPTS = 6
_DECAY_BOXES = 3
"""Boxes for the decay of the function, for each box of a row."""

_DECAY_BUDGET = 400_000
_BUDGET = 15_000
"""Boxes for one row: some seconds. A table build and ``certify`` take the same, so that both give the same steps."""
_OF_PROOF = 100
"""Boxes of a certificate for each of them."""

_MARGIN = 0.8
"""Share of the least size at points that is claimed where nothing is proved between them."""


def certified_steps(
    study: Study,
    spec: ControllerSpec,
    certificate: Certificate | Places,
    *,
    ready: Ready = NOTHING,
    schedule: MeasuredSchedule | None = None,
    budget: int = _BUDGET,
    progress: Callable[[str, float], None] | None = None,
    each: Each = map,
    seed: int = 0,
) -> StepStatement:
    """The largest step of P_ref, Q_ref, phase, voltage and frequency of the grid, each alone, for which no limit acts
    in the linear model, over the region of a certificate (:eq:`step-conditions`).

    The grid's impedance does not change after the step; the estimate may, within its error. The steps depend on the
    loading and on the strength of the grid: there is one row for each part of the region. ``ready``, ``schedule``: as
    for :func:`~vsgdesign.certificate.certify`. ``budget``: boxes for one row; 0 leaves all rows at points. ``each``:
    what applies a function to the parts, here or in other processes.
    """
    region = replace(certificate.region, rate=np.inf)
    system, motion = prepared(study, spec, region, ready, schedule, None)
    system = replace(system, transient=False)
    limits = acting_limits(study.with_limit_of(spec))
    boxes = budget if encloses(system) else 0
    decay = _DECAY * certificate.decay
    rng = np.random.default_rng(seed)
    points, A = system.matrices(np.concatenate([nodes(region, 7), random_points(region, _POINTS, rng)]))
    shape, proof = _function(system, motion, limits, decay, points, A, min(_DECAY_BOXES * boxes, _DECAY_BUDGET), seed)
    statement = StepStatement(
        limiter=limits.limiter,
        current_pu=limits.current_pu,
        soft=limits.soft,
        V_low_pu=limits.V_low_pu,
        V_high_pu=limits.V_high_pu,
        clips_V=limits.clips_V,
    )
    if shape is None:
        reason = "no common quadratic function was found that decays on every grid of the region"
        return replace(statement, reason=reason)
    rows, parts = [], _parts(region)
    for row in each(partial(_row, system, shape, limits, boxes, seed), parts):
        if progress is not None:
            progress("steps", len(rows) / len(parts))
        rows.append(row)
    if progress is not None:
        progress("steps", 1.0)
    matrix = tuple(tuple(float(value) for value in row) for row in shape.P)
    return replace(statement, decay=decay, P=matrix, proof=proof, rows=tuple(rows))


def step_budget(boxes: int) -> int:
    """Boxes for one row beside a certificate that may take so many."""
    return boxes // _OF_PROOF


def with_steps(study: Study, spec: ControllerSpec, found: Certificate | Places | Counterexample, **options: Any) -> Any:
    """A certificate with its certified steps; a counterexample as it is. ``options``: of :func:`certified_steps`."""
    if isinstance(found, Counterexample):
        return found
    return replace(found, steps=certified_steps(study, spec, found, **options))


def _parts(region: Region) -> list[Region]:
    """Parts of the region by loading, and each by the SCR."""
    low, high = region.scr
    cuts = np.geomspace(low, high, _BANDS + 1) if high > low else np.array([low, high])
    cuts = [low, *(float(f"{cut:.3g}") for cut in cuts[1:-1]), high]
    return [
        replace(region, scr=(a, b), P=_scaled(region.P, load), Q=_scaled(region.Q, load))
        for load in _LOADS
        for a, b in pairwise(cuts)
    ]


def _scaled(limits: tuple[float, float], share: float) -> tuple[float, float]:
    """A share of an interval, towards what of it is nearest to zero."""
    centre = min(max(0.0, limits[0]), limits[1])
    return centre + share * (limits[0] - centre), centre + share * (limits[1] - centre)


def _function(
    system: System,
    motion: Motion,
    limits: ActingLimits,
    decay: float,
    points: Array,
    A: Array,
    budget: int,
    seed: int,
) -> tuple[LevelShape | None, str]:
    """The function of largest sublevel set that decays over the region, and how that is proved."""
    V_limits = system.study.converter.V_min_pu, system.study.converter.V_max_pu
    shape, share = _best_shape(system, limits, _ROOM * decay, points, A, V_limits)
    for _ in range(_ATTEMPTS):
        if shape is None:
            return None, GRIDDED
        if not budget:
            P = shape.P
            worst, worth = worst_points(
                system,
                motion.region,
                lambda at, a, P=P: residual(a, motion.family(at), P[None], decay),
                points,
                A,
                np.random.default_rng(seed),
            )
            if worth[0] < 0.0:
                return shape, GRIDDED
            broken = worst[worth >= 0.0]
        else:
            outcome = proved_between(system, motion, shape.P[None], [decay], motion.region, budget, None, seed)
            if len(outcome.broken) == 0:
                return shape, GAP_FREE if len(outcome.left) == 0 else GRIDDED
            broken = outcome.broken
        points, A = system.matrices(np.concatenate([points, broken]))
        P, _ = largest_level_set(A, _ROOM * decay, V_limits, share)
        shape = None if P is None else LevelShape.of(P, *V_limits)
    return None, GRIDDED


def _best_shape(
    system: System, limits: ActingLimits, decay: float, points: Array, A: Array, V_limits: tuple[float, float]
) -> tuple[LevelShape | None, float]:
    """Of some shares of V in the set, the one with the largest product of sizes at the points of middle loading."""
    c = system.study.converter
    best, chosen, most = None, _V_SHARES[0], -np.inf
    start: tuple[int, ...] = ()
    at = np.flatnonzero(np.hypot(points[:, 2], points[:, 3]) <= 0.6 * c.S_rated)
    cells = system.cells(points[at] if len(at) else points)
    for share in _V_SHARES:
        P, start = largest_level_set(A, decay, V_limits, share, start)
        if P is None:
            continue
        shape = LevelShape.of(P, *V_limits)
        worth = float(np.log(np.maximum(step_sizes(system, cells, shape, limits).min(axis=1), 1e-9)).sum())
        if worth > most:
            best, chosen, most = shape, share, worth
    return best, chosen


def _row(system: System, shape: LevelShape, limits: ActingLimits, budget: int, seed: int, part: Region) -> StepRow:
    rng = np.random.default_rng(seed)
    found = system.cells(np.concatenate([nodes(part, 5), random_points(part, _POINTS // 3, rng)]))
    typical = rest_current_pu(system, found)
    if len(found.points) == 0:
        return _impossible(part, None, GRIDDED)
    sampled, largest = step_sizes(system, found, shape, limits).min(axis=1), float(typical.max())
    if not sampled.all() or no_room(largest, limits.current_pu):
        return _impossible(part, largest, GRIDDED)
    if budget:
        outcome = prove_steps(system, part, shape, limits, sampled, largest, budget, seed)
        largest = outcome.current_pu
        if not outcome.sampled.all() or no_room(largest, limits.current_pu):
            return _impossible(part, largest, GRIDDED)
        if outcome.whole:
            return _with_sizes(system, part, largest, GAP_FREE, outcome.sizes)
        sampled = outcome.sampled
    else:
        A = system.matrices(found.points)[1]
        worst, _ = worst_points(
            system,
            part,
            lambda at, _: -(step_sizes(system, system.cells(at), shape, limits) / sampled[:, None]).min(axis=0),
            found.points,
            A,
            rng,
        )
        sampled = np.minimum(sampled, step_sizes(system, system.cells(worst), shape, limits).min(axis=1))
        if not sampled.all():
            return _impossible(part, largest, GRIDDED)
    return _with_sizes(system, part, largest, GRIDDED, _MARGIN * sampled)


def _impossible(part: Region, current: float | None, proof: str) -> StepRow:
    return StepRow(scr=part.scr, P=part.P, Q=part.Q, rest_current_pu=current, proof=proof)


def _with_sizes(system: System, part: Region, current: float, proof: str, sizes: Array) -> StepRow:
    S, V_g = system.study.converter.S_rated, system.study.grid_source.V_g_rms
    P_ref, Q_ref, phase, voltage, omega_g = (float(size) for size in sizes)
    row = _impossible(part, current, proof)
    return replace(row, P_ref=P_ref * S, Q_ref=Q_ref * S, phase=phase, V_g=voltage * V_g, omega_g=omega_g)
