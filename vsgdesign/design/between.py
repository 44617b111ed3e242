"""Checks of a table between its nodes, where the true grid is elsewhere than the estimate that is looked up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.design.box import joined, scenarios_of_truths
from vsgdesign.design.evaluation import Evaluation, LawOfStudy, evaluate_pairs
from vsgdesign.design.figures import Figures, shortfalls, worst
from vsgdesign.execution.executors import Each
from vsgdesign.parameters.specification import Specification
from vsgdesign.parameters.study import Study
from vsgdesign.runtime.table import TableSchedule, table_schedule

Array = NDArray[np.float64]

POINTS = 2000
"""Random grids of the final check."""

_CHUNK = 250
"""Grids that one worker looks at in one go."""


@dataclass(frozen=True)
class PointCheck:
    """One grid between nodes, with its worst figures and the requirements that are violated there."""

    scr: float
    x_over_r: float
    figures: Figures
    missed: dict[str, float]
    promised: bool
    """Whether all nodes around it keep every requirement, including those that a wrong estimate leads to."""


@dataclass(frozen=True)
class BetweenCheck:
    """The check at random grids. ``outside``: grids without a scenario within the static limits."""

    points: tuple[PointCheck, ...]
    outside: int
    seed: int

    @property
    def promised(self) -> int:
        """Number of grids at which the table promises something."""
        return sum(point.promised for point in self.points)

    @property
    def broken(self) -> tuple[PointCheck, ...]:
        """The grids at which it does not keep its promise."""
        return tuple(point for point in self.points if point.promised and point.missed)


def between_document(checked: BetweenCheck) -> dict[str, Any]:
    """The last check between the nodes, as a table contains it, in JSON's types."""
    return {
        "points": len(checked.points) + checked.outside,
        "seed": checked.seed,
        "outside": checked.outside,
        "promised": checked.promised,
        "broken": [{"scr": p.scr, "x_over_r": p.x_over_r, "reached": p.missed} for p in checked.broken],
    }


def check_between(
    study: Study,
    law: LawOfStudy,
    spec: Specification,
    table: GainTable,
    *,
    count: int = POINTS,
    seed: int = 0,
    each: Each = map,
) -> BetweenCheck:
    """Checks the table at ``count`` random grids, uniform in ln SCR and ln X/R, in all scenarios of the box."""
    rng = np.random.default_rng(seed)
    low = np.log([table.scr[0], table.x_over_r[0]])
    high = np.log([table.scr[-1], table.x_over_r[-1]])
    points = check_points(study, law, spec, table, np.exp(rng.uniform(low, high, (count, 2))), each)
    return BetweenCheck(points, count - len(points), seed)


def check_points(
    study: Study, law: LawOfStudy, spec: Specification, table: GainTable, grids: Array, each: Each = map
) -> tuple[PointCheck, ...]:
    """Checks the table at given grids (N, 2), rows of SCR and X/R. Grids without any scenario are left out."""
    parts = [grids[k : k + _CHUNK] for k in range(0, len(grids), _CHUNK)]
    found = each(partial(_check, study, law, spec, table), parts)
    return tuple(point for part in found for point in part)


def _check(
    study: Study, law: LawOfStudy, spec: Specification, table: GainTable, grids: Array
) -> tuple[PointCheck, ...]:
    schedule = table_schedule(table)
    boxes = scenarios_of_truths(study, spec, grids.tolist(), table.P_design, table.Q_design)
    kept = [k for k, box in enumerate(boxes) if len(box)]
    if not kept:
        return ()
    whole = joined([boxes[k] for k in kept])
    R_hat, L_hat = whole.R_hat - schedule.R_2, whole.X_hat / schedule.omega - schedule.L_2
    found = evaluate_pairs(law, schedule.normalised(R_hat, L_hat), whole, spec.settling_time)
    certain = _promising(schedule, table, R_hat, L_hat)
    points, start = [], 0
    for k in kept:
        stop = start + len(boxes[k])
        part = Evaluation(
            {name: values[None, start:stop] for name, values in found.figures.items()},
            found.damping_ratio[None, start:stop],
            found.abscissa[None, start:stop],
        )
        figures = worst(part)
        missed = shortfalls(spec, figures, np.inf if spec.settles else float(spec.H or 0.0))
        missed.pop("H_max", None)
        promised = bool(certain[start:stop].all())
        points.append(PointCheck(float(grids[k, 0]), float(grids[k, 1]), figures, missed, promised))
        start = stop
    return tuple(points)


def probe(
    study: Study,
    law: LawOfStudy,
    spec: Specification,
    table: GainTable,
    *,
    count: int = POINTS,
    seed: int = 0,
    each: Each = map,
) -> tuple[PointCheck, ...]:
    """The grids at which a promise is broken, among the nodes, the middles of all edges and rectangles, and random
    grids."""
    scr, ratio = np.log(table.scr), np.log(table.x_over_r)
    halves = [np.sort(np.concatenate([axis, 0.5 * (axis[1:] + axis[:-1])])) for axis in (scr, ratio)]
    probes = np.stack([axis.ravel() for axis in np.meshgrid(*halves, indexing="ij")], axis=1)
    rng = np.random.default_rng(seed)
    probes = np.vstack([probes, rng.uniform([scr[0], ratio[0]], [scr[-1], ratio[-1]], (count, 2))])
    points = check_points(study, law, spec, table, np.exp(probes), each)
    return tuple(point for point in points if point.promised and point.missed)


def failing_intervals(table: GainTable, broken: Sequence[PointCheck]) -> list[tuple[str, float]]:
    """Nodes to add, (axis, value): the middles of intervals in which a promise is broken between nodes.

    The rectangle around a broken promise is divided in the middle of its longer side.
    """
    scr, ratio = np.log(table.scr), np.log(table.x_over_r)
    cuts: set[tuple[str, float]] = set()
    for point in broken:
        i, j = (
            int(np.clip(np.searchsorted(axis, np.log(value)) - 1, 0, len(axis) - 2))
            for axis, value in ((scr, point.scr), (ratio, point.x_over_r))
        )
        axis, k, name = (scr, i, "scr") if scr[i + 1] - scr[i] >= ratio[j + 1] - ratio[j] else (ratio, j, "x_over_r")
        cuts.add((name, float(f"{np.exp(0.5 * (axis[k] + axis[k + 1])):.6g}")))
    return sorted(cuts)


def _promising(schedule: TableSchedule, table: GainTable, R_hat: Array, L_hat: Array) -> NDArray[np.bool_]:
    """Where every node that has a say in a lookup keeps its promises."""
    kept = replace(schedule, valid=(table.status == "met")[:, ::-1])
    return np.asarray(kept.place(R_hat, L_hat).designed)
