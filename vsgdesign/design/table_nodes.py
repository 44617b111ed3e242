"""The nodes of a table in the making: which there are, what is asked of each, what was found, and which to ask again.

Each step takes the nodes as they are and returns them as they will be; nothing is changed in place.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.design_inputs import design_inputs
from vsgdesign.artifacts.files import provenance
from vsgdesign.artifacts.gain_table import COLUMNS, GainTable, ValidityBox, base_of, fill_outside, to_dimensionless
from vsgdesign.design.between import (
    PULL,
    BetweenCheck,
    PointCheck,
    around,
    broken_beside,
    check_between,
    failing_intervals,
    probe,
    reach,
    refuted_between,
    rough_nodes,
    surface,
)
from vsgdesign.design.box import scenarios_of_estimate
from vsgdesign.design.cell import common_design
from vsgdesign.design.evaluation import LawOfStudy
from vsgdesign.design.record import CellRecord, CellTask, better, sweep
from vsgdesign.design.search import Variables, variables
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.executors import Each, Progress
from vsgdesign.execution.jobs import each_of
from vsgdesign.linear.stability.gain_table import margins_of
from vsgdesign.runtime.table import table_grids, with_node_gains
from vsgdesign.study.parameters.specification import Specification
from vsgdesign.study.parameters.study import ControllerSpec, Study

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
    refuted: tuple[PointCheck, ...] = ()
    """Those of the broken ones that the full-order model alone refutes."""


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
    """Look at the middles of edges and rectangles first, and at random grids where these find nothing; where these find
    nothing either, for the slowest mode of the full-order model.

    ``first``: nodes that miss a promise by themselves count as rough, too. ``last``: rough nodes are not designed
    again. Each look takes one of the ``seeds``.
    """
    job.tell("look between nodes", 0.0)
    options = {"count": job.points, "seed": next(seeds), "each": job.each}
    broken, checked = probe(job.study, job.law, job.spec, table, **options), None
    refuted: tuple[PointCheck, ...] = ()
    rough = rough_nodes(table, nodes.records, broken, first)
    if not broken and (not rough or last):
        checked = look_at_random(job, table, seeds)
        broken = checked.broken
        if not broken:
            refuted = refuted_between(job.study, job.controller, job.law, job.spec, table, job.seed)
            broken, checked = refuted, replace(checked, points=checked.points + refuted)
        rough = rough_nodes(table, nodes.records, broken, False)
    job.tell("look between nodes", 1.0)
    return Look(tuple(broken), tuple(rough), checked, refuted)


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
        node: _task(
            job,
            nodes,
            node,
            middle,
            PULL,
            broken_beside(table, look.broken, node),
            broken_beside(table, look.refuted, node),
        )
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


def _task(
    job: TableJob,
    nodes: TableNodes,
    node: Node,
    middle: Array,
    pull: float,
    beside: Pairs = (),
    refuted: Pairs = (),
) -> CellTask:
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
        refuted=refuted if before is None else before.refuted + refuted,
    )


_LARGE = {
    "overshoot_P_pct": ("overshoot_P", 100.0),
    "settling_P_s": ("settling_P", 1.0),
    "overshoot_Q_pct": ("overshoot_Q", 100.0),
    "settling_Q_s": ("settling_Q", 1.0),
    "cross_peak": ("cross_peak", 1.0),
}
"""Figures of which the largest is the worst: name in the table, name in Figures, scale."""

_LOOKS = 3
"""How often nodes lose their promise, each time after a look at new random grids."""


@dataclass(frozen=True)
class Withdrawn:
    """A table that promises no more than the last look found to hold."""

    table: GainTable
    checked: BetweenCheck
    lost: dict[int, dict[str, float]]
    """By the number of a node: what was missed at a grid beside it."""


def withdraw_promises(job: TableJob, table: GainTable, checked: BetweenCheck, seeds: Iterator[int]) -> Withdrawn:
    """Nodes around grids at which a promise is broken lose theirs, and new random grids are looked at, a few times."""
    lost: dict[int, dict[str, float]] = {}
    for _ in range(_LOOKS):
        if not checked.broken:
            break
        for point in checked.broken:
            lost = dict.fromkeys(around(table, point), point.missed) | lost
        table = demote(table, checked)
        checked = look_at_random(job, table, seeds)
    return Withdrawn(table, checked, lost)


def demote(table: GainTable, checked: BetweenCheck) -> GainTable:
    """The table without a promise where one was broken between nodes: the nodes around become ``relaxed``.

    What is not kept at a grid between them is said as their active constraint.
    """
    status, active = table.status.astype("<U8"), table.active.astype(object)
    for point in checked.broken:
        for k in around(table, point):
            at = divmod(k, len(table.x_over_r))
            if status[at] == "met":
                status[at], active[at] = "relaxed", "between nodes: " + _active("", point.missed)
    return replace(table, status=status, active=active.astype(str))


def assemble(job: TableJob, nodes: TableNodes) -> GainTable:
    """The table of designed cells."""
    study, spec, law, records = job.study, job.spec, job.law, nodes.records
    scr, x_over_r = np.array(nodes.scr), np.array(nodes.x_over_r)
    shape = (len(scr), len(x_over_r))
    designs = [record.design for record in records]
    valid = np.array([d is not None for d in designs]).reshape(shape)

    def cells(value: Any, outside: float = np.nan) -> Array:
        return np.array(
            [outside if d is None else value(d, r) for d, r in zip(designs, records, strict=True)], dtype=float
        ).reshape(shape)

    normalised = {
        name: fill_outside(cells(lambda d, _, k=k: float(d.normalised[k]), 0.0), valid)
        for k, name in enumerate(COLUMNS[law.law])
    }
    margins = {
        f"worst_{name}": cells(lambda d, r, f=field, k=scale: k * max(getattr(d.figures, f), getattr(r.full_order, f)))
        for name, (field, scale) in _LARGE.items()
    }
    margins |= {
        "worst_disk_margin_output": cells(lambda d, r: min(d.figures.disk_margin, r.full_order.disk_margin)),
        "worst_damping_power_loops": cells(lambda d, _: d.figures.damping_ratio),
        "full_order_decay_1_s": cells(lambda _, r: -r.full_order.abscissa),
        "scenarios": cells(lambda d, _: d.scenarios),
    }
    if law.apart is not None:
        margins["worst_differential_decay_1_s"] = cells(
            lambda d, r: min(d.figures.differential_decay, r.full_order.differential_decay)
        )
    margins = {name: np.where(np.isfinite(values), values, np.nan) for name, values in margins.items()}
    status = np.array(["outside" if d is None else "met" if d.met else "relaxed" for d in designs]).reshape(shape)
    active = np.array(["" if d is None else _active(d.active, d.shortfalls) for d in designs]).reshape(shape)
    base = base_of(study, spec.scr_basis)
    box = spec.box
    validity = ValidityBox(
        scr=(float(scr[0]), float(scr[-1])),
        x_over_r=(float(x_over_r[0]), float(x_over_r[-1])),
        P=(min(box.P), max(box.P)),
        Q=(min(box.Q), max(box.Q)),
        V_rms=study.converter.V_limits_rms,
        error=max(box.error_R, box.error_X),
        error_Z=box.error_Z,
    )
    table = GainTable(
        name=job.controller.name,
        structure=law.structure,
        law=law.law,
        study=study.name,
        study_hash=study.hash,
        base=base,
        D_p=law.D_p,
        D_q=law.D_q,
        P_design=job.controller.target.P,
        Q_design=job.controller.target.Q,
        time_scale=spec.settling_time if spec.settles else 1.0,
        scr=scr,
        x_over_r=x_over_r,
        columns=to_dimensionless(normalised, spec.settling_time if spec.settles else 1.0),
        gains=PowerLoopGains(**dict.fromkeys(PowerLoopGains._fields, np.full(shape, np.nan))),
        status=status,
        active=active,
        price=cells(lambda d, _: d.price),
        margins=margins,
        specification=_document(spec),
        validity=validity,
        provenance=provenance(),
        design_inputs=design_inputs(study, job.controller.target),
    )
    table = with_node_gains(table)
    R_g, L_g = table_grids(table)
    return replace(table, margins=margins | margins_of(base, R_g, L_g, table.P_design, table.Q_design, table.gains))


def _document(spec: Specification) -> dict[str, Any]:
    """A specification as a table keeps it. An error that is not asked for is left out, as in tables of before."""
    found = asdict(spec)
    if spec.box.error_Z == 0.0:
        del found["box"]["error_Z"]
    if spec.differential_decay == 0.0:
        del found["differential_decay"]
    return found


def _active(active: str, missed: dict[str, float]) -> str:
    """The active promise, or what would have to be allowed for the cell to be feasible."""
    if not missed:
        return active
    return "; ".join(f"{name} → {value:.4g}" for name, value in missed.items())
