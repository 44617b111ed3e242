"""From a specification to a gain table: design the nodes, look between them, add nodes where a promise breaks."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import CertificateRecord
from vsgdesign.artifacts.design_inputs import design_inputs
from vsgdesign.artifacts.gain_table import COLUMNS, GainTable, ValidityBox, base_of, fill_outside, to_dimensionless
from vsgdesign.artifacts.provenance import provenance
from vsgdesign.certificate import NoFunctionError, Region, certify, refusal_record
from vsgdesign.certificate.box_check import compile_ahead
from vsgdesign.design.between import POINTS, BetweenCheck, between_document, check_between, failing_intervals, probe
from vsgdesign.design.box import Scenarios, scenarios_of_estimate
from vsgdesign.design.causes import Cause, explain_pair, explained_between
from vsgdesign.design.cell import common_design
from vsgdesign.design.evaluation import Each, LawOfStudy, law_of
from vsgdesign.design.record import CellRecord, CellTask, better, one_thread
from vsgdesign.design.smoothing import PULL, around, broken_beside, reach, rough_nodes, surface
from vsgdesign.design.sweep import each_of, sweep
from vsgdesign.design.variables import variables
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.errors import InfeasibleStudyError, StudyError
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.parameters.specification import Specification
from vsgdesign.parameters.study import ControllerSpec, Study
from vsgdesign.runtime.table import table_grids, table_schedule, with_node_gains
from vsgdesign.stability.gain_table import margins_of

Array = NDArray[np.float64]

_LARGE = {
    "overshoot_P_pct": ("overshoot_P", 100.0),
    "settling_P_s": ("settling_P", 1.0),
    "overshoot_Q_pct": ("overshoot_Q", 100.0),
    "settling_Q_s": ("settling_Q", 1.0),
    "cross_peak": ("cross_peak", 1.0),
}
"""Figures of which the largest is the worst: name in the table, name in Figures, scale."""

Node = tuple[float, float]

SMOOTHINGS = 2
"""How often rough nodes are designed again before nodes are added."""

REFINEMENTS = 2
"""How often nodes are added."""

CELLS_LIMIT = 1.5
"""A table grows to at most so many times its first number of cells."""

_COMMON_CELLS = 30
_EXPLAINED = 40
"""Relaxed cells of which the cause is looked for: one costs about what designing it did, one to three seconds."""

_LOOKS = 3
"""How often nodes lose their promise, each time after a look at new random grids."""

_CERTIFICATES = ((np.inf, 1_500_000), (0.05, 150_000))
"""Relative change of SCR and X/R per second that a certificate is asked for, the second where no common function
exists; and boxes that it may take: some ten seconds on two cores."""


@dataclass(frozen=True)
class BuiltTable:
    """A table and how it came about."""

    table: GainTable
    records: tuple[CellRecord, ...]
    added: tuple[tuple[str, float], ...]
    """Nodes added between those of the specification: axis and value."""
    between: BetweenCheck
    causes: tuple[Cause, ...] = ()
    """Why cells are relaxed."""


def build_table(
    study: Study,
    controller: ControllerSpec,
    folder: Path,
    *,
    executor: Executor | None = None,
    seed: int = 0,
    refinements: int = REFINEMENTS,
    points: int = POINTS,
    certificate: bool = True,
    progress: Progress | None = None,
) -> BuiltTable:
    """The gain table of a controller under the study's specification.

    ``folder`` keeps finished cells: a build that was killed goes on from them and gives the same bytes.
    ``points``: random grids of each look between the nodes. ``certificate``: whether the table gets one
    (:func:`table_certificate`), which can take as long as the rest. Raises InfeasibleStudyError where the study has
    no specification, or where no cell has an operating point.
    """
    spec = study.specification
    if spec is None:
        raise InfeasibleStudyError("the study has no [specification]: say what the table has to keep, and over what.")
    with one_thread():
        if certificate and executor is not None:
            # One worker compiles this while the others compile what designs need, instead of all of them the same.
            executor.submit(compile_ahead)
        built = _build(study, controller, spec, folder, executor, seed, refinements, points, progress)
        if not certificate:
            return built
        tell = progress or silent
        tell("certify", 0.0)
        table = replace(built.table, certificate=table_certificate(study, controller, built.table))
        tell("certify", 1.0)
        return replace(built, table=table)


def _build(
    study: Study,
    controller: ControllerSpec,
    spec: Specification,
    folder: Path,
    executor: Executor | None,
    seed: int,
    refinements: int,
    points: int,
    progress: Progress | None,
) -> BuiltTable:
    tell, each = progress or silent, each_of(executor)
    law = law_of(study, controller.target, spec.aim)
    v = variables(law.structure, spec)
    scr, ratio = list(spec.scr), list(spec.x_over_r)
    added: list[tuple[str, float]] = []
    P, Q = controller.target.P, controller.target.Q
    boxes = [scenarios_of_estimate(study, spec, s, x, P, Q) for s in scr for x in ratio]
    tell("look for a common design", 0.0)
    centre = common_design(law, spec, _some([box for box in boxes if len(box)]), each)
    tell("look for a common design", 1.0)
    tasks: dict[Node, CellTask] = {}
    best: dict[Node, CellRecord] = {}

    def ask(node: Node, middle: Array, pull: float, beside: tuple[Node, ...] = ()) -> None:
        around, more = reach(scr, ratio, *node), ()
        if node in tasks:
            around, more = tasks[node].reach, tasks[node].beside
        near = tuple(float(value) for value in middle)
        tasks[node] = CellTask(study, controller.target, spec, *node, near, seed, pull, around, more + beside)

    for node in itertools.product(scr, ratio):
        ask(node, centre, 1.0)
    looks, smoothed, refined = 0, 0, 0
    while True:
        nodes = list(itertools.product(scr, ratio))
        for node, record in zip(nodes, sweep([tasks[node] for node in nodes], folder, executor, tell), strict=True):
            best[node] = better(best.get(node), record)
        records = [best[node] for node in nodes]
        if all(record.design is None for record in records):
            raise InfeasibleStudyError(
                "specification: no cell of the table has an operating point within the converter's limits. "
                "Ask for less power (P, Q), stronger grids (scr), or wider voltage limits (V_min_pu, V_max_pu)."
            )
        table = assemble(study, controller, spec, law, np.array(scr), np.array(ratio), records)
        looks += 1
        tell("look between nodes", 0.0)
        broken, checked = probe(study, law, spec, table, count=points, seed=seed + looks, each=each), None
        again = rough_nodes(table, records, broken, smoothed == 0)
        if not broken and (not again or smoothed == SMOOTHINGS):
            looks += 1
            checked = check_between(study, law, spec, table, count=points, seed=seed + looks, each=each)
            broken = checked.broken
            again = rough_nodes(table, records, broken, False)
        tell("look between nodes", 1.0)
        if again and smoothed < SMOOTHINGS:
            smoothed += 1
            some = np.array([nodes[k] for k in again])
            for k, middle in zip(again, surface(v, table, records, *some.T), strict=True):
                ask(nodes[k], middle, PULL, broken_beside(table, broken, nodes[k]))
            continue
        if not broken or refined == refinements:
            break
        refined += 1
        before = len(added)
        for axis, value in failing_intervals(table, broken):
            target, other = (scr, ratio) if axis == "scr" else (ratio, scr)
            limit = CELLS_LIMIT * len(spec.scr) * len(spec.x_over_r)
            if (len(target) + 1) * len(other) <= limit and value not in target:
                target.append(value)
                target.sort()
                added.append((axis, value))
        if len(added) == before:
            break
        new = [node for node in itertools.product(scr, ratio) if node not in tasks]
        for node, middle in zip(new, surface(v, table, records, *np.array(new).T), strict=True):
            ask(node, middle, PULL)
    if checked is None:
        looks += 1
        checked = check_between(study, law, spec, table, count=points, seed=seed + looks, each=each)
    lost: dict[int, dict[str, float]] = {}
    for _ in range(_LOOKS):
        if not checked.broken:
            break
        for point in checked.broken:
            lost = dict.fromkeys(around(table, point), point.missed) | lost
        table = demote(table, checked)
        looks += 1
        checked = check_between(study, law, spec, table, count=points, seed=seed + looks, each=each)
    causes = _causes(table, [tasks[node] for node in itertools.product(scr, ratio)], records, lost, each, tell)
    table = replace(table, between=between_document(checked), causes=[cause.as_document() for cause in causes])
    return BuiltTable(table, tuple(records), tuple(added), checked, causes)


def _causes(
    table: GainTable,
    tasks: Sequence[CellTask],
    records: Sequence[CellRecord],
    lost: dict[int, dict[str, float]],
    each: Each,
    tell: Progress,
) -> tuple[Cause, ...]:
    """Why cells are relaxed, in the table's order: of those that miss a promise themselves at most _EXPLAINED."""
    missing = [k for k, record in enumerate(records) if record.missed]
    some = missing[:: max(-(-len(missing) // _EXPLAINED), 1)]
    found = {
        k: explained_between(records[k], lost[k])
        for k in sorted(lost)
        if not records[k].missed and records[k].design is not None
    }
    tell("find causes", 0.0)
    for done, (k, cause) in enumerate(
        zip(some, each(explain_pair, [(tasks[k], records[k]) for k in some]), strict=True)
    ):
        found[k] = cause
        tell("find causes", (done + 1) / len(some))
    tell("find causes", 1.0)
    return tuple(found[k] for k in sorted(found) if table.status.flat[k] == "relaxed")


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


def table_certificate(study: Study, controller: ControllerSpec, table: GainTable) -> CertificateRecord | None:
    """What a common Lyapunov function proves over the table's whole box with its interpolated gains, or why not.

    Any speed of change; where no common function exists, a slow grid (_CERTIFICATES). Without gaps where the
    boxes suffice.
    """
    spec = study.specification
    box, error = table.validity, table.validity.error
    study = study if spec is None else replace(study, scr_basis=spec.scr_basis)
    refused = None
    for rate, boxes in _CERTIFICATES:
        region = Region(box.scr, box.x_over_r, box.P, box.Q, error, rate)
        try:
            found = certify(study, controller, region, schedule=table_schedule(table), budget=boxes)
        except (InfeasibleStudyError, StudyError) as fault:  # no such function, or a box that is not asked for
            slowest = fault.slowest if isinstance(fault, NoFunctionError) else None
            refused = refusal_record(str(fault), region, slowest)
            continue
        return found.as_record()
    return refused


def _some(boxes: list[Scenarios]) -> list[Scenarios]:
    """At most _COMMON_CELLS of the cells, evenly: enough to choose what they have in common."""
    return boxes[:: max(-(-len(boxes) // _COMMON_CELLS), 1)]


def assemble(
    study: Study,
    controller: ControllerSpec,
    spec: Specification,
    law: LawOfStudy,
    scr: Array,
    x_over_r: Array,
    records: Sequence[CellRecord],
) -> GainTable:
    """The table of designed cells, row by row over scr × x_over_r."""
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
        "worst_disk_margin": cells(lambda d, r: min(d.figures.disk_margin, r.full_order.disk_margin)),
        "worst_least_damping": cells(lambda d, _: d.figures.damping_ratio),
        "full_order_decay_1_s": cells(lambda _, r: -r.full_order.abscissa),
        "scenarios": cells(lambda d, _: d.scenarios),
    }
    margins = {name: np.where(np.isfinite(values), values, np.nan) for name, values in margins.items()}
    status = np.array(["outside" if d is None else "met" if d.met else "relaxed" for d in designs]).reshape(shape)
    active = np.array(["" if d is None else _active(d.active, d.shortfalls) for d in designs]).reshape(shape)
    base = base_of(study, spec.scr_basis)
    box = spec.box
    validity = ValidityBox(
        (float(scr[0]), float(scr[-1])),
        (float(x_over_r[0]), float(x_over_r[-1])),
        (min(box.P), max(box.P)),
        (min(box.Q), max(box.Q)),
        study.converter.V_limits_rms,
        max(box.error_R, box.error_X),
    )
    table = GainTable(
        name=controller.name, structure=law.structure, law=law.law, study=study.name, study_hash=study.hash,
        base=base, D_p=law.D_p, D_q=law.D_q, P_design=controller.target.P, Q_design=controller.target.Q,
        time_scale=spec.settling_time if spec.settles else 1.0, scr=scr, x_over_r=x_over_r,
        columns=to_dimensionless(normalised, spec.settling_time if spec.settles else 1.0),
        gains=PowerLoopGains(**dict.fromkeys(PowerLoopGains._fields, np.full(shape, np.nan))),
        status=status, active=active,
        price=cells(lambda d, _: d.price), margins=margins, specification=asdict(spec), validity=validity,
        provenance=provenance(), design_inputs=design_inputs(study, controller.target),
    )  # fmt: skip
    table = with_node_gains(table)
    R_g, L_g = table_grids(table)
    return replace(table, margins=margins | margins_of(base, R_g, L_g, table.P_design, table.Q_design, table.gains))


def _active(active: str, missed: dict[str, float]) -> str:
    """The active promise, or what would have to be allowed for the cell to be feasible."""
    if not missed:
        return active
    return "; ".join(f"{name} → {value:.4g}" for name, value in missed.items())
