"""Checks of a table between its nodes, where the true grid is elsewhere than the estimate that is looked up, and the
nodes that are rough beside their neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.certificate import Region
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order.points import least_decay
from vsgdesign.design.box import Reach, joined, scenarios_of_truths
from vsgdesign.design.evaluation import Evaluation, Figures, LawOfStudy, evaluate_pairs, shortfalls, worst
from vsgdesign.design.record import CellRecord
from vsgdesign.design.search import Variables
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.executors import Each
from vsgdesign.runtime.table import TableSchedule, table_schedule
from vsgdesign.study.parameters.specification import Specification, settled_decay
from vsgdesign.study.parameters.study import ControllerSpec, Study

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


PULL = 30.0
"""How much more than usual the surface counts for a node that is designed again."""

_BANDWIDTH = 0.35
"""Least standard deviation of the surface's weights, in the logarithms of SCR and X/R."""

_DOUBTFUL = 0.1
"""Weight of a node that does not keep its promises."""

_RIDGE = 0.3
"""On the surface's slopes, in weights: a node alone has none."""


def surface(v: Variables, table: GainTable, records: Sequence[CellRecord], scr: Array, x_over_r: Array) -> Array:
    """y (N, k) at N grids: local linear regression through the table's designs over ln SCR and ln X/R."""
    rows = [(r, s, x) for r, (s, x) in zip(records, _nodes(table), strict=True) if r.design is not None]
    y = np.array([v.of(r.design.normalised) for r, _, _ in rows if r.design is not None])
    at = np.log([(s, x) for _, s, x in rows])
    weight = np.array([_DOUBTFUL if r.missed else 1.0 for r, _, _ in rows])
    found = np.empty((len(scr), y.shape[1]))
    for k, place in enumerate(np.log(np.stack([scr, x_over_r], axis=1))):
        axes = zip((table.scr, table.x_over_r), place, strict=True)
        widths = [max(_BANDWIDTH, _spacing(np.log(axis), value)) for axis, value in axes]
        away = (at - place) / widths
        w = weight * np.exp(-0.5 * np.sum(away**2, axis=1))
        basis = np.column_stack([np.ones(len(at)), away])
        normal = basis.T @ (w[:, None] * basis) + np.diag([0.0, _RIDGE, _RIDGE])
        found[k] = np.linalg.solve(normal, basis.T @ (w[:, None] * y))[0]
    return np.clip(found, v.low, v.high)


def rough_nodes(
    table: GainTable, records: Sequence[CellRecord], broken: Sequence[PointCheck], missed: bool
) -> list[int]:
    """Nodes to design again, by number: those around a grid at which a promise is broken, those that miss one by
    themselves (``missed``), and their neighbours. What no power loop cures is left alone."""
    n, m = table.shape
    marked = np.zeros((n, m), dtype=bool)
    for k, record in enumerate(records):
        if missed and record.missed and record.inner_rad_s is None:
            marked[k // m, k % m] = True
    for point in broken:
        marked.ravel()[around(table, point)] = True
    wide = marked.copy()
    for i, j in np.argwhere(marked):
        wide[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2] = True
    curable = [record.design is not None and record.inner_rad_s is None for record in records]
    return np.flatnonzero(wide.ravel() & np.array(curable)).tolist()


def broken_beside(
    table: GainTable, broken: Sequence[PointCheck], node: tuple[float, float]
) -> tuple[tuple[float, float], ...]:
    """SCR and X/R of the grids next to a node at which a promise is broken."""
    nodes = _nodes(table)
    return tuple((p.scr, p.x_over_r) for p in broken if node in (nodes[k] for k in around(table, p)))


def around(table: GainTable, point: PointCheck) -> list[int]:
    """The four nodes around a grid, by number: row by row over SCR × X/R."""
    n, m = table.shape
    i = int(np.clip(np.searchsorted(table.scr, point.scr) - 1, 0, n - 2))
    j = int(np.clip(np.searchsorted(table.x_over_r, point.x_over_r) - 1, 0, m - 2))
    return [i * m + j, i * m + j + 1, (i + 1) * m + j, (i + 1) * m + j + 1]


def reach(scr: Sequence[float], x_over_r: Sequence[float], s: float, x: float) -> Reach:
    """How far a node's say is the largest: half way to its neighbours, in logarithms."""
    return (*_half(scr, s), *_half(x_over_r, x))


def _half(axis: Sequence[float], value: float) -> tuple[float, float]:
    below = max((a for a in axis if a < value), default=value)
    above = min((a for a in axis if a > value), default=value)
    return float(np.sqrt(below * value)), float(np.sqrt(value * above))


def _spacing(axis: Array, value: float) -> float:
    """Length of the interval that holds a value."""
    k = int(np.clip(np.searchsorted(axis, value) - 1, 0, len(axis) - 2))
    return float(axis[k + 1] - axis[k])


def _nodes(table: GainTable) -> list[tuple[float, float]]:
    return [(float(s), float(x)) for s in table.scr for x in table.x_over_r]


_SLOW = 0.25
"""Of the decay that the settling time stands for, below which a mode counts as too slow: a mode that hardly takes part
in a step may be slower than that."""


def refuted_between(
    study: Study, controller: ControllerSpec, law: LawOfStudy, spec: Specification, table: GainTable, seed: int
) -> tuple[PointCheck, ...]:
    """The grid at which a search over the table's whole box finds the slowest mode of the full-order model, where that
    grows or is far too slow; of equal units the same of their modes against each other. Empty where the table promises
    nothing there.

    ``missed`` has the settling time that would have to be allowed, infinite where the mode grows, or the decay between
    units.
    """
    box = table.validity
    region = Region(box.scr, box.x_over_r, box.P, box.Q, box.error, error_Z=box.error_Z)
    own = replace(study.with_limit_of(controller), scr_basis=spec.scr_basis)
    system, _ = prepared(own, controller, region, NOTHING, table_schedule(table), None)
    settles = settled_decay(spec.settling_time) if spec.settles else 0.0
    found: list[PointCheck] = []
    for apart, asked in ((False, settles), (True, spec.differential_decay)):
        if apart and asked == 0.0:
            continue
        try:
            slowest = least_decay(own, replace(system, apart=apart), region, seed)
        except InfeasibleStudyError:  # no point within the static limits
            continue
        decay = slowest.decay or 0.0
        if decay > _SLOW * asked:
            continue
        missed = (
            {"differential_decay": decay}
            if apart
            else {"settling_time": spec.settling_time * settles / decay if decay > 0.0 else np.inf}
        )
        grid = np.array([[slowest.scr, slowest.x_over_r]])
        found += [replace(at, missed=missed) for at in check_points(study, law, spec, table, grid) if at.promised]
    return tuple(found)
