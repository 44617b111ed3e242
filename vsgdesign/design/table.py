"""From a specification to a gain table: design of the nodes, checks between them, more nodes where they are needed, and
why a node gives a promise up: what it would keep if one thing were out of the way.

For the latter, the node is designed anew without the sampling delay, with ideal inner loops, with an exact estimate and
with half of the powers, far from the static limits. The first of these that brings its promises back is the cause.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from concurrent.futures import Executor, Future, wait
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.artifacts.certificate_record import CertificateRecord
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.certificate import Certificate, Counterexample, NoFunctionError, Places, Region, refusal_record
from vsgdesign.design.between import POINTS, BetweenCheck, between_document
from vsgdesign.design.box import limit_uses, scenarios_of_estimate
from vsgdesign.design.cell import CellDesign
from vsgdesign.design.evaluation import Figures, law_of
from vsgdesign.design.record import CellRecord, CellTask, designs_of, run_task, with_full_order
from vsgdesign.design.table_nodes import (
    TableJob,
    TableNodes,
    Withdrawn,
    assemble,
    design_nodes,
    first_nodes,
    look_at_random,
    look_between,
    refine_nodes,
    smooth_nodes,
    withdraw_promises,
)
from vsgdesign.design.verification import range_of_link
from vsgdesign.errors import InfeasibleStudyError, StudyError
from vsgdesign.execution.executors import Each, Progress, one_thread, silent
from vsgdesign.execution.workers import WorkerPool
from vsgdesign.linear.operating_point.equilibrium import static_limits
from vsgdesign.linear.stability.safe_place import table_safe_place
from vsgdesign.runtime.table import table_schedule
from vsgdesign.study.parameters.dc_link import without_voltage_droop
from vsgdesign.study.parameters.study import ControllerSpec, Study

DELAY, INNER, ERROR, LIMIT = "delay", "inner loops", "estimate error", "static limit"
BOTH, NEIGHBOURS, BETWEEN, NONE = "inner loops and estimate error", "neighbours", "interpolation", "specification"

CAUSES = (DELAY, INNER, ERROR, BOTH, LIMIT, NEIGHBOURS, BETWEEN, NONE)

_POWER_SHARE = 0.5
"""Of the box of powers: what a grid at its static limit is asked for to be far from it."""


@dataclass(frozen=True, kw_only=True)
class Cause:
    """Why one node is relaxed. ``keeps``: figures of the node without the cause, None where nothing helped.

    ``limit``, ``limit_use``: the static limit that the node's scenarios come nearest to, and how much of it they use.
    """

    scr: float
    x_over_r: float
    cause: str
    missed: dict[str, float]
    """Promises not kept, with what would have to be allowed."""
    keeps: dict[str, float] | None
    limit: str
    limit_use: float

    def as_document(self) -> dict[str, Any]:
        """JSON's types; what is not finite is null."""
        return asdict(self)


def explain(task: CellTask, record: CellRecord) -> Cause:
    """The cause of a node that misses a promise; ``task`` is how it was designed."""
    with one_thread():
        return _explain(replace(task, pull=1.0), record)


def explain_pair(pair: tuple[CellTask, CellRecord]) -> Cause:
    """:func:`explain` of one argument: for workers."""
    return explain(*pair)


def explained_between(record: CellRecord, missed: dict[str, float]) -> Cause:
    """A node that keeps its promises itself, and is relaxed because what lies between it and another one does not."""
    return Cause(
        scr=record.scr,
        x_over_r=record.x_over_r,
        cause=BETWEEN,
        missed=missed,
        keeps=_kept(record),
        limit="",
        limit_use=float("nan"),
    )


def _explain(task: CellTask, record: CellRecord) -> Cause:
    target, spec, study = task.target, task.spec, task.study
    law = law_of(study, target, spec.aim)
    s = scenarios_of_estimate(study, spec, task.scr, task.x_over_r, target.P, target.Q)
    uses = {name: float(np.nanmax(use)) for name, use in limit_uses(study, s).items()}
    nearest = max(uses, key=lambda name: uses[name])

    def found(cause: str, keeps: dict[str, float] | None) -> Cause:
        return Cause(
            scr=task.scr,
            x_over_r=task.x_over_r,
            cause=cause,
            missed=record.missed,
            keeps=keeps,
            limit=nearest,
            limit_use=uses[nearest],
        )

    ideal: CellDesign | None = None
    undelayed = _without_delay(task)
    # Where ideal inner loops are no cure, less bandwidth and no delay are none.
    for design in designs_of(task, law, s) if record.ideal else ():
        if ideal is None and not (own := with_full_order(task, law, s, design)).missed:
            return found(NEIGHBOURS, _kept(own))
        ideal = ideal or design
        if undelayed is not None and not (seen := with_full_order(undelayed, law, s, design)).missed:
            return found(DELAY, _kept(seen))
    if ideal is not None and not ideal.shortfalls:
        return found(INNER, _figures(ideal.figures, ideal.inertia))
    exact = replace(task, spec=replace(spec, box=spec.box.exact()))
    if any(spec.box.errors):
        if not (seen := run_task(exact)).missed and seen.design is not None:
            return found(ERROR, _kept(seen))
        truth = scenarios_of_estimate(study, exact.spec, task.scr, task.x_over_r, target.P, target.Q)
        first = next(designs_of(exact, law, truth))
        if not first.shortfalls:
            return found(BOTH, _figures(first.figures, first.inertia))
    if not (seen := run_task(_with_less_power(task))).missed and seen.design is not None:
        return found(LIMIT, _kept(seen))
    return found(NONE, None)


def _without_delay(task: CellTask) -> CellTask | None:
    """The same converter, answering in the sample that it measures in; None where it does."""
    c = task.study.converter
    if c.delay_samples == 0:
        return None
    gains = task.study.inner_gains._replace(kappa=0.0)  # nothing to predict over
    return replace(task, study=replace(task.study, converter=replace(c, delay_samples=0), inner_gains=gains))


def _with_less_power(task: CellTask) -> CellTask:
    box, target = task.spec.box, task.target
    less = replace(box, P=tuple(_POWER_SHARE * p for p in box.P), Q=tuple(_POWER_SHARE * q for q in box.Q))
    return replace(
        task,
        spec=replace(task.spec, box=less),
        target=replace(target, P=_POWER_SHARE * target.P, Q=_POWER_SHARE * target.Q),
    )


def _kept(record: CellRecord) -> dict[str, float] | None:
    """The worst of both models."""
    design, full = record.design, record.full_order
    if design is None or full is None:
        return None
    ours = design.figures
    worse = replace(
        ours,
        overshoot_P=max(ours.overshoot_P, full.overshoot_P),
        overshoot_Q=max(ours.overshoot_Q, full.overshoot_Q),
        settling_P=max(ours.settling_P, full.settling_P),
        settling_Q=max(ours.settling_Q, full.settling_Q),
        disk_margin=min(ours.disk_margin, full.disk_margin),
    )
    return _figures(worse, design.inertia)


def _figures(f: Figures, inertia: float) -> dict[str, float]:
    return {
        "settling_time": f.settling_time,
        "overshoot": f.overshoot,
        "disk_margin": f.disk_margin,
        "damping_ratio": f.damping_ratio,
        "H": inertia,
    }


SMOOTHINGS = 2
"""How often rough nodes are designed again before nodes are added."""

REFINEMENTS = 2
"""How often nodes are added."""

_EXPLAINED = 40
"""Relaxed cells of which the cause is looked for: one costs about what designing it did, one to three seconds."""

_CERTIFICATES = ((np.inf, 1_500_000), (0.05, 150_000))
"""Relative change of SCR and X/R per second that a certificate is asked for, the second where no common function
exists; and boxes that it may take, 70 microseconds of a core each."""

Proved = Certificate | Places | Counterexample | CertificateRecord | None
"""A certificate, a counterexample, or the record of why there is neither."""


@dataclass(frozen=True)
class BuiltTable:
    """A table with the records of its cells and the check between its nodes."""

    table: GainTable
    records: tuple[CellRecord, ...]
    added: tuple[tuple[str, float], ...]
    """Nodes added between those of the specification: axis and value."""
    between: BetweenCheck
    causes: tuple[Cause, ...] = ()
    """The reasons why cells are relaxed."""


def build_table(
    study: Study,
    controller: ControllerSpec,
    folder: Path,
    *,
    executor: Executor | None = None,
    seed: int = 0,
    smoothings: int = SMOOTHINGS,
    refinements: int = REFINEMENTS,
    points: int = POINTS,
    certificate: bool = True,
    progress: Progress | None = None,
) -> BuiltTable:
    """The gain table of a controller under the study's specification.

    Finished cells are saved in ``folder``. A build that was interrupted continues from them and gives the same bytes.
    ``smoothings`` and ``refinements`` say how often rough nodes are designed again and how often nodes are added.
    ``points`` is the number of random grids in each check between the nodes. ``certificate``: whether the table gets a
    certificate (:func:`table_certificate`), which can take as long as the rest. Raises InfeasibleStudyError if the
    study has no specification or no cell has an operating point, WorkerError if a process is lost, and ArtifactError if
    finished cells cannot be saved.
    """
    without_voltage_droop(study, "a gain table")
    spec = study.specification
    if spec is None:
        raise InfeasibleStudyError(
            "the study has no [specification]. Add one: it gives the requirements and their box."
        )
    with one_thread():
        ahead: list[Future[None]] = []
        if certificate and executor is not None:
            # One worker compiles this while the others compile what designs need, instead of all of them the same.
            ahead = [executor.submit(compiled_ahead)]
        job = TableJob(
            study=study,
            controller=controller,
            spec=spec,
            law=law_of(study, controller.target, spec.aim),
            folder=folder,
            executor=executor,
            seed=seed,
            points=points,
            tell=progress or silent,
        )
        built = _build(job, smoothings, refinements)
        if not certificate:
            return built
        job.tell("certify", 0.0)
        if isinstance(executor, WorkerPool):
            wait(ahead)  # or this process would compile it as well
        table = replace(built.table, certificate=table_certificate(study, controller, built.table, job.each))
        job.tell("certify", 1.0)
        return replace(built, table=table)


def _build(job: TableJob, smoothings: int, refinements: int) -> BuiltTable:
    seeds = itertools.count(job.seed + 1)  # of every look between the nodes
    nodes, table, checked = _designed(job, smoothings, refinements, seeds)
    if checked is None:
        checked = look_at_random(job, table, seeds)
    withdrawn = withdraw_promises(job, table, checked, seeds)
    causes = _causes(job, nodes, withdrawn)
    between = between_document(withdrawn.checked)
    link = range_of_link(job.study, (*job.spec.box.P, 0.0))
    between |= {} if link is None else {"link": link}
    table = replace(withdrawn.table, between=between, causes=[cause.as_document() for cause in causes])
    table = replace(table, safe_place=table_safe_place(job.study, table))
    return BuiltTable(table, tuple(nodes.records), nodes.added, withdrawn.checked, causes)


def _designed(
    job: TableJob, smoothings: int, refinements: int, seeds: Iterator[int]
) -> tuple[TableNodes, GainTable, BetweenCheck | None]:
    """Design the nodes, look between them, and design rough ones again or add nodes, until the table keeps its promises
    or nothing is left to try. Also returns the last look, where it was one at random grids."""
    nodes, smoothed, refined = first_nodes(job), 0, 0
    while True:
        nodes = design_nodes(job, nodes)
        table = assemble(job, nodes)
        look = look_between(job, nodes, table, seeds, first=smoothed == 0, last=smoothed == smoothings)
        if look.rough and smoothed < smoothings:
            smoothed += 1
            nodes = smooth_nodes(job, nodes, table, look)
            continue
        finer = nodes if refined == refinements or not look.broken else refine_nodes(job, nodes, table, look.broken)
        if finer is nodes:
            return nodes, table, look.checked
        refined, nodes = refined + 1, finer


def _causes(job: TableJob, nodes: TableNodes, withdrawn: Withdrawn) -> tuple[Cause, ...]:
    """Why cells are relaxed, in the table's order: of those that miss a promise themselves at most _EXPLAINED."""
    tasks, records, lost = nodes.tasks_in_order, nodes.records, withdrawn.lost
    missing = [k for k, record in enumerate(records) if record.missed]
    some = missing[:: max(-(-len(missing) // _EXPLAINED), 1)]
    found = {
        k: explained_between(records[k], lost[k])
        for k in sorted(lost)
        if not records[k].missed and records[k].design is not None
    }
    job.tell("find causes", 0.0)
    for done, (k, cause) in enumerate(
        zip(some, job.each(explain_pair, [(tasks[k], records[k]) for k in some]), strict=True)
    ):
        found[k] = cause
        job.tell("find causes", (done + 1) / len(some))
    job.tell("find causes", 1.0)
    return tuple(found[k] for k in sorted(found) if withdrawn.table.status.flat[k] == "relaxed")


def table_certificate(
    study: Study, controller: ControllerSpec, table: GainTable, each: Each = map
) -> CertificateRecord | None:
    """What a common Lyapunov function proves over the whole box of the table with its interpolated gains, or why not.

    The proof holds for any speed of change or, if no common function exists, for a grid that changes slowly
    (_CERTIFICATES). It has no gaps if the number of boxes is sufficient. ``each`` applies a function to the parts of
    the region for which certified steps are proved.
    """
    return stepped_record(study, controller, table, proved_over_box(study, controller, table), each)


def compiled_ahead() -> None:
    """Compiles or loads the functions that a certificate needs."""
    from vsgdesign.certificate.box_check import compile_ahead

    compile_ahead()


def proved_over_box(study: Study, controller: ControllerSpec, table: GainTable) -> Proved:
    """The proof of decay over the table's box without the certified steps, which a scheduler does not need. Of gains
    that are designed for a pair of impedances, it is one for both."""
    from vsgdesign.certificate import certify, of_a_pair

    box, asked = table.validity, study.specification
    prove = of_a_pair if asked is not None and asked.differential_decay > 0.0 else certify
    refused = None
    for rate, boxes in _CERTIFICATES:
        region = Region(box.scr, box.x_over_r, box.P, box.Q, box.error, rate, box.error_Z)
        try:
            return prove(_on_basis(study), controller, region, schedule=table_schedule(table), budget=boxes)
        except (InfeasibleStudyError, StudyError) as fault:  # no such function, or a box that is not asked for
            slowest = fault.slowest if isinstance(fault, NoFunctionError) else None
            refused = refusal_record(str(fault), region, slowest, static_limits(study))
    return refused


def stepped_record(
    study: Study, controller: ControllerSpec, table: GainTable, found: Proved, each: Each = map
) -> CertificateRecord | None:
    """The record of the proof. If there is a certificate, the record has certified steps too, whose proof takes
    longer."""
    if isinstance(found, Certificate | Places):
        from vsgdesign.certificate import with_steps

        # A box that steps cannot be asked for leaves the certificate without them.
        with suppress(InfeasibleStudyError, StudyError):
            schedule = table_schedule(table)
            found = with_steps(_on_basis(study), controller, found, schedule=schedule, each=each)
    return record_of(found)


def record_of(found: Proved) -> CertificateRecord | None:
    """The record of a proof, as a gain table contains it."""
    return found if found is None or isinstance(found, CertificateRecord) else found.as_record()


def _on_basis(study: Study) -> Study:
    """The study with the basis of SCR that its specification has."""
    spec = study.specification
    return study if spec is None else replace(study, scr_basis=spec.scr_basis)
