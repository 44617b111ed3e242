"""The nodes of a table in the making: which there are, what is asked of each, what was found, and which to ask again.

Each step takes the nodes as they are and returns them as they will be; nothing is changed in place.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.design.between import BetweenCheck, PointCheck, check_between, failing_intervals, probe
from vsgdesign.design.box import scenarios_of_estimate
from vsgdesign.design.cell import common_design
from vsgdesign.design.evaluation import LawOfStudy
from vsgdesign.design.record import CellRecord, CellTask, better
from vsgdesign.design.smoothing import PULL, broken_beside, reach, rough_nodes, surface
from vsgdesign.design.sweep import sweep
from vsgdesign.design.variables import Variables, variables
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.executors import Each
from vsgdesign.execution.jobs import each_of
from vsgdesign.execution.progress import Progress
from vsgdesign.parameters.specification import Specification
from vsgdesign.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]
Node = tuple[float, float]
"""SCR and X/R."""
Pairs = tuple[tuple[float, float], ...]

CELLS_LIMIT = 1.5
"""A table grows to at most so many times its first number of cells."""

_COMMON_CELLS = 30


@dataclass(frozen=True, kw_only=True)
class TableJob:
    """What a table is made of and with: the same in every step of its build."""

    study: Study
    controller: ControllerSpec
    spec: Specification
    law: LawOfStudy
    folder: Path
    """Keeps finished cells."""
    executor: Executor | None
    seed: int
    points: int
    """Random grids of each look between the nodes."""
    tell: Progress

    @property
    def each(self) -> Each:
        """``map`` on the executor's workers."""
        return each_of(self.executor)

    @property
    def variables(self) -> Variables:
        """What the optimizer chooses in a cell."""
        return variables(self.law.structure, self.spec)

    @property
    def most_cells(self) -> float:
        """How many cells the table may grow to."""
        return CELLS_LIMIT * len(self.spec.scr) * len(self.spec.x_over_r)


@dataclass(frozen=True, kw_only=True)
class TableNodes:
    """The axes, what is asked of every node, and the best that was found for it so far."""

    scr: tuple[float, ...]
    x_over_r: tuple[float, ...]
    tasks: Mapping[Node, CellTask]
    best: Mapping[Node, CellRecord] = field(default_factory=dict)
    added: tuple[tuple[str, float], ...] = ()
    """Nodes added between those of the specification: axis and value."""

    @property
    def in_order(self) -> list[Node]:
        """Row by row over SCR × X/R."""
        return list(itertools.product(self.scr, self.x_over_r))

    @property
    def records(self) -> list[CellRecord]:
        """The best of every node, in order."""
        return [self.best[node] for node in self.in_order]

    @property
    def tasks_in_order(self) -> list[CellTask]:
        """What is asked of every node, in order."""
        return [self.tasks[node] for node in self.in_order]


@dataclass(frozen=True)
class Look:
    """What a look at a table between its nodes says."""

    broken: tuple[PointCheck, ...]
    """Grids at which a promise is broken."""
    rough: tuple[int, ...]
    """Nodes to design again, by number."""
    checked: BetweenCheck | None
    """The look at random grids; None where there was enough to mend without it."""


def first_nodes(job: TableJob) -> TableNodes:
    """The specification's own nodes, each asked to stay near a design that they have in common."""
    scr, x_over_r = tuple(job.spec.scr), tuple(job.spec.x_over_r)
    nodes = TableNodes(scr=scr, x_over_r=x_over_r, tasks={})
    target = job.controller.target
    boxes = [scenarios_of_estimate(job.study, job.spec, s, x, target.P, target.Q) for s, x in nodes.in_order]
    carried = [box for box in boxes if len(box)]
    # At most _COMMON_CELLS of the cells, evenly: enough to choose what they have in common.
    some = carried[:: max(-(-len(carried) // _COMMON_CELLS), 1)]
    job.tell("look for a common design", 0.0)
    centre = common_design(job.law, job.spec, some, job.each)
    job.tell("look for a common design", 1.0)
    return replace(nodes, tasks={node: _task(job, nodes, node, centre, 1.0) for node in nodes.in_order})


def design_nodes(job: TableJob, nodes: TableNodes) -> TableNodes:
    """The nodes with the best of what was found before and now. Raises InfeasibleStudyError where none has a design."""
    found = sweep(nodes.tasks_in_order, job.folder, job.executor, job.tell)
    best = {node: better(nodes.best.get(node), one) for node, one in zip(nodes.in_order, found, strict=True)}
    if all(record.design is None for record in best.values()):
        raise InfeasibleStudyError(
            "specification: no cell of the table has an operating point within the converter's limits. "
            "Ask for less power (P, Q), stronger grids (scr), or wider voltage limits (V_min_pu, V_max_pu)."
        )
    return replace(nodes, best=best)


def look_between(
    job: TableJob, nodes: TableNodes, table: GainTable, seeds: Iterator[int], *, first: bool, last: bool
) -> Look:
    """Look at the middles of edges and rectangles first, and at random grids where these find nothing.

    ``first``: nodes that miss a promise by themselves count as rough, too. ``last``: rough nodes are not designed
    again. Each look takes one of the ``seeds``.
    """
    job.tell("look between nodes", 0.0)
    options = {"count": job.points, "seed": next(seeds), "each": job.each}
    broken, checked = probe(job.study, job.law, job.spec, table, **options), None
    rough = rough_nodes(table, nodes.records, broken, first)
    if not broken and (not rough or last):
        checked = look_at_random(job, table, seeds)
        broken = checked.broken
        rough = rough_nodes(table, nodes.records, broken, False)
    job.tell("look between nodes", 1.0)
    return Look(tuple(broken), tuple(rough), checked)


def look_at_random(job: TableJob, table: GainTable, seeds: Iterator[int]) -> BetweenCheck:
    """The promises at random grids."""
    options = {"count": job.points, "seed": next(seeds), "each": job.each}
    return check_between(job.study, job.law, job.spec, table, **options)


def smooth_nodes(job: TableJob, nodes: TableNodes, table: GainTable, look: Look) -> TableNodes:
    """The rough nodes asked again: nearer to the surface through their neighbours, and with the grids beside them at
    which a promise was broken."""
    order = nodes.in_order
    rough = [order[k] for k in look.rough]
    middles = surface(job.variables, table, nodes.records, *np.array(rough).T)
    asked = {
        node: _task(job, nodes, node, middle, PULL, broken_beside(table, look.broken, node))
        for node, middle in zip(rough, middles, strict=True)
    }
    return replace(nodes, tasks={**nodes.tasks, **asked})


def refine_nodes(job: TableJob, nodes: TableNodes, table: GainTable, broken: tuple[PointCheck, ...]) -> TableNodes:
    """Nodes added where a promise is broken between them, as far as the table may grow; the same where it may not."""
    axes, added = {"scr": list(nodes.scr), "x_over_r": list(nodes.x_over_r)}, list(nodes.added)
    for name, value in failing_intervals(table, broken):
        axis, other = axes[name], axes["x_over_r" if name == "scr" else "scr"]
        if (len(axis) + 1) * len(other) <= job.most_cells and value not in axis:
            axis.append(value)
            axis.sort()
            added.append((name, value))
    if len(added) == len(nodes.added):
        return nodes
    finer = replace(nodes, scr=tuple(axes["scr"]), x_over_r=tuple(axes["x_over_r"]), added=tuple(added))
    new = [node for node in finer.in_order if node not in nodes.tasks]
    middles = surface(job.variables, table, nodes.records, *np.array(new).T)
    asked = {node: _task(job, finer, node, middle, PULL) for node, middle in zip(new, middles, strict=True)}
    return replace(finer, tasks={**nodes.tasks, **asked})


def _task(job: TableJob, nodes: TableNodes, node: Node, middle: Array, pull: float, beside: Pairs = ()) -> CellTask:
    """What is asked of a node: near ``middle``. A node that is asked again keeps its reach, and the grids beside it."""
    before = nodes.tasks.get(node)
    return CellTask(
        study=job.study,
        target=job.controller.target,
        spec=job.spec,
        scr=node[0],
        x_over_r=node[1],
        centre=tuple(float(value) for value in middle),
        seed=job.seed,
        pull=pull,
        reach=reach(nodes.scr, nodes.x_over_r, *node) if before is None else before.reach,
        beside=beside if before is None else before.beside + beside,
    )
