"""The cells of a table: the task of one, what a finished one is, and the design of many on any executor.

A kill at any moment loses no finished cell, and the digits are the same for any number of workers.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.artifacts.design_inputs import resolved_inputs
from vsgdesign.artifacts.files import package_hash, plain, provenance
from vsgdesign.design.box import (
    Reach,
    Scenarios,
    joined,
    measured_at_limits,
    scenarios_around_estimate,
    scenarios_of_estimate,
    scenarios_of_truth,
    scenarios_on_edge,
)
from vsgdesign.design.cell import CellDesign, design_cell
from vsgdesign.design.evaluation import Figures, LawOfStudy, evaluate, exact_worst, law_of, shortfalls, worse
from vsgdesign.design.search import variables, with_hard
from vsgdesign.design.verification import full_order_figures
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.execution.executors import Progress
from vsgdesign.execution.jobs import Job
from vsgdesign.execution.journal import Journal, run_job
from vsgdesign.study.parameters.specification import Specification
from vsgdesign.study.parameters.study import ClosedFormTarget, Study

_SLOWER = (0.75, 0.55)
"""Shares of the first design's bandwidth that are tried where the inner loops take its promises away."""

_SLOWEST = (0.4, 0.3)
"""The same where units would grow against each other with all of these."""

LEAST_APART = 0.5
"""Decay of equal units against each other, 1/s, that comes before every other promise where not all can be kept."""


@dataclass(frozen=True, kw_only=True)
class CellTask:
    """One cell to design, complete in itself: it goes to another process or machine."""

    study: Study
    target: ClosedFormTarget
    spec: Specification
    scr: float
    x_over_r: float
    centre: tuple[float, ...]
    """The common design that the cell stays near."""
    seed: int
    pull: float = 1.0
    """How much more than usual being near it counts."""
    reach: Reach | None = None
    """Least and largest SCR, least and largest X/R of lookups in which this node has most say; None: its own alone."""

    beside: tuple[tuple[float, float], ...] = ()
    """True grids (SCR, X/R) around the node at which a table broke a promise: the design has to keep it there too."""
    refuted: tuple[tuple[float, float], ...] = ()
    """Those of them at which it was the full-order model alone that refuted it: designs are judged by it there too."""

    @property
    def key(self) -> str:
        """Hash of everything that decides the result."""
        study = replace(self.study, specification=None)
        spec = replace(self.spec, scr=(), x_over_r=())  # of the other nodes only the region's limits have a say
        parts = {
            "study": resolved_inputs(study, self.target),
            "specification": asdict(spec),
            "region": [self.spec.scr[0], self.spec.scr[-1], self.spec.x_over_r[0], self.spec.x_over_r[-1]],
            "node": [self.scr, self.x_over_r],
            "centre": self.centre,
            "seed": self.seed,
            "pull": self.pull,
            "reach": self.reach,
            "beside": self.beside,
            "refuted": self.refuted,
            "versions": provenance(),
            "code": package_hash(),
        } | ({} if study.dc is None else {"dc": asdict(study.dc)})
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class CellRecord:
    """A designed cell. ``design`` None: outside, no scenario lies within the static limits. ``full_order``: the worst
    figures with inner loops, filters and delay; ``inner_rad_s``: |s| of the unstable mode, where there is one."""

    scr: float
    x_over_r: float
    design: CellDesign | None
    full_order: Figures | None
    inner_rad_s: float | None
    ideal: bool = True
    """Whether the best design with ideal inner loops keeps every promise."""

    @property
    def missed(self) -> dict[str, float]:
        """Requirements that one of the two models does not keep, each with the value that would have to be allowed."""
        if self.design is None or self.full_order is None:
            return {}
        return self.design.shortfalls


def run_task(task: CellTask) -> CellRecord:
    """Designs one cell and evaluates it with the full-order model.

    The optimiser's model has ideal inner loops. If the real ones violate a requirement, the cell is designed again with
    less bandwidth, and the best of these designs by the full-order figures is kept.
    """
    study, spec = task.study, task.spec
    law = law_of(study, task.target, spec.aim)
    s = scenarios_of_estimate(study, spec, task.scr, task.x_over_r, task.target.P, task.target.Q)
    if len(s) == 0:
        return CellRecord(task.scr, task.x_over_r, None, None, None)
    record = _best(task, law, s)
    edge = scenarios_on_edge(study, spec, task.scr, task.x_over_r, task.target.P, task.target.Q)
    if len(edge) == 0 or record.design is None:
        return record
    # A design that keeps its promises on the rest of the table's edge as well is not made again for it.
    whole = joined([s, edge])
    judged = _judged(task, law, whole, edge, record)
    if set(judged.missed) <= set(record.missed):
        return judged
    again = _best(task, law, whole)
    return replace(min(judged, again, key=lambda one: _distance(spec, one.missed)), ideal=again.ideal)


def _best(task: CellTask, law: LawOfStudy, s: Scenarios) -> CellRecord:
    """The best design of a cell for its scenarios ``s``, by the full-order figures."""
    records = []
    for design in designs_of(task, law, s, (*_SLOWER, *_SLOWEST)):
        records.append(with_full_order(task, law, s, design))
        kept = design.shortfalls or not records[-1].missed
        if (kept or len(records) > len(_SLOWER)) and not _grows(task.spec, records[-1].missed):
            break  # kept by both models, or not even by the optimizer's: less bandwidth is no cure
    best = min(records, key=lambda record: _distance(task.spec, record.missed))
    return replace(best, ideal=records[0].ideal)


def _judged(task: CellTask, law: LawOfStudy, whole: Scenarios, more: Scenarios, record: CellRecord) -> CellRecord:
    """A record with what its design is worth in ``more`` scenarios as well, which are among the ``whole``."""
    spec, design = task.spec, record.design
    if design is None:
        return record
    one = NormalisedGains(*(np.array([value]) for value in design.normalised))
    seen = exact_worst(
        evaluate(law, one, more, spec.settling_time),
        0,
        law.gains(design.normalised, more),
        more,
        law.lags,
    )
    figures = worse(design.figures, seen)
    missed = shortfalls(spec, figures, design.inertia)
    ideal = replace(design, figures=figures, shortfalls=missed, scenarios=design.scenarios + len(more))
    return replace(with_full_order(task, law, whole, ideal), ideal=record.ideal)


def designs_of(
    task: CellTask, law: LawOfStudy, s: Scenarios, shares: Sequence[float] = _SLOWER
) -> Iterator[CellDesign]:
    """The designs of a cell with ideal inner loops, over its scenarios ``s`` and those of its surroundings.

    The first is the best design, and the others have these shares of its bandwidth.
    """
    study, spec = task.study, task.spec
    v = variables(law.structure, spec)
    centre = np.array(task.centre)
    wide = s
    if task.reach is not None:
        more = scenarios_around_estimate(study, spec, task.scr, task.x_over_r, task.reach, task.target.P, task.target.Q)
        wide = with_hard(law, spec, more, centre, len(s))
    P, Q = task.target.P, task.target.Q
    wide = joined([wide, *(scenarios_of_truth(study, spec, *grid, P, Q) for grid in task.beside)])
    measured = measured_at_limits(study, spec, task.scr, task.x_over_r)
    first = design_cell(law, spec, wide, centre, task.seed, None, task.pull, measured)
    yield first
    for slower in shares:
        ceiling = v.slower(first.normalised, slower)
        yield design_cell(law, spec, wide, centre, task.seed, ceiling, task.pull, measured)


def better(before: CellRecord | None, new: CellRecord) -> CellRecord:
    """The new one of two designs of a node, unless it violates a requirement and the one before does not.

    The active requirement and its price stay those of the first design, because the new one is held near its
    neighbours.
    """
    if before is None or before.design is None or new.design is None:
        return new
    if new.missed and not before.missed:
        return before
    if new.missed or before.missed:
        return new
    return replace(new, design=replace(new.design, active=before.design.active, price=before.design.price))


def _distance(spec: Specification, missed: dict[str, float]) -> float:
    """How far a design is from its promises: the sum of what is missed, each over its limit; instability is far, of
    units against each other too."""
    limits = {name: getattr(spec, name) for name in missed if name != "inner_loops"}
    parts = [abs(missed[name] - limit) / max(limit, 1e-9) for name, limit in limits.items()]
    apart = 50.0 - missed["differential_decay"] if _grows(spec, missed) else 0.0
    return float(sum(min(part, 10.0) for part in parts)) + (100.0 if "inner_loops" in missed else apart)


def _grows(spec: Specification, missed: dict[str, float]) -> bool:
    """Whether the units against each other do not even have the least decay, where one is asked for."""
    return missed.get("differential_decay", np.inf) < min(LEAST_APART, spec.differential_decay)


def with_full_order(task: CellTask, law: LawOfStudy, s: Scenarios, design: CellDesign) -> CellRecord:
    """The record of a design, with its figures in the full-order model, also at grids that were refuted before."""
    study, spec = task.study, task.spec
    P, Q = task.target.P, task.target.Q
    s = joined([s, *(scenarios_of_truth(study, spec, *grid, P, Q) for grid in task.refuted)])
    figures = full_order_figures(study, law.gains(design.normalised, s), s, spec.settling_time, law.apart)
    worst = figures.worst()
    # The network's and the filter's modes are damped by the grid and the inner loops: no promise of the power loops.
    seen = replace(worst, damping_ratio=max(worst.damping_ratio, design.figures.damping_ratio))
    missed = design.shortfalls | shortfalls(spec, seen, design.inertia)
    inner = None
    if not worst.abscissa < 0.0:
        inner = float(figures.fastest_rad_s[int(figures.abscissa.argmax())])
        missed = {"inner_loops": inner}
    active = design.active if not missed else next(iter(missed))
    whole = replace(design, shortfalls=missed, active=active)
    return CellRecord(task.scr, task.x_over_r, whole, worst, inner, design.met)


def record_document(record: CellRecord) -> dict[str, Any]:
    """A record in JSON's types. Infinite figures become null and come back infinite."""
    document: dict[str, Any] = asdict(record)
    if record.design is not None:
        document["design"]["normalised"] = record.design.normalised._asdict()
    return document


def record_of(document: dict[str, Any]) -> CellRecord:
    """The record of a document."""
    design = document["design"]
    if design is not None:
        fields = dict(design)
        fields["normalised"] = NormalisedGains(**fields["normalised"])
        fields["figures"] = _figures(fields["figures"])
        fields["shortfalls"] = {k: float("inf") if v is None else v for k, v in fields["shortfalls"].items()}
        design = CellDesign(**fields)
    full = document["full_order"]
    return CellRecord(
        document["scr"],
        document["x_over_r"],
        design,
        None if full is None else _figures(full),
        document["inner_rad_s"],
        document["ideal"],
    )


def _figures(document: dict[str, Any]) -> Figures:
    """Figures whose missing numbers were infinite: bad is large, except for margins and damping."""
    low = ("disk_margin", "damping_ratio")  # a differential mode that nobody asks for has an infinite decay
    infinite = {name: float("-inf") if name in low else float("inf") for name in document}
    return Figures(**{name: infinite[name] if value is None else value for name, value in document.items()})


@dataclass(frozen=True)
class SweepJob(Job[str, dict[str, Any]]):
    """The design of some cells. A block is the key of a cell, and so is what it gives known by."""

    tasks: dict[str, CellTask]

    what = "design cells"

    @property
    def key(self) -> str:
        """Of this version of the package: a cell has a key of its own, and one journal keeps the cells of many
        sweeps."""
        return package_hash()

    @property
    def blocks(self) -> list[str]:
        """The keys of all cells."""
        return list(self.tasks)

    def run(self, block: str) -> dict[str, Any]:
        """A designed cell."""
        return self.call(block)()

    def call(self, block: str) -> Callable[[], dict[str, Any]]:
        """The design of a cell as it goes to another process: with its own task alone."""
        return partial(_designed, block, self.tasks[block])

    def part_of(self, document: Any) -> dict[str, Any]:
        """Cells by key. Raises ValueError, KeyError or TypeError where a document has none."""
        for one in document.values():
            record_of(one)
        return document


def _designed(key: str, task: CellTask) -> dict[str, Any]:
    return {key: plain(record_document(run_task(task)))}


def cells_file(folder: Path) -> Path:
    """The journal of finished cells in a folder."""
    return folder / f"{package_hash()[:24]}.jsonl"


def sweep(
    tasks: Sequence[CellTask], folder: Path, executor: Executor | None = None, progress: Progress | None = None
) -> list[CellRecord]:
    """The records of all tasks, in order. Cells that are kept in ``folder`` are not designed again, and new ones are
    kept there.

    ``executor`` is one of concurrent.futures; with None the work is done in this process. An interruption cancels tasks
    that have not begun and keeps finished cells. Raises WorkerError if a process is lost, and ArtifactError if a cell
    cannot be kept.
    """
    keys = [task.key for task in tasks]
    job = SweepJob(dict(zip(keys, tasks, strict=True)))
    whole = run_job(job, Journal(job, cells_file(folder)), executor=executor, progress=progress)
    return [record_of(whole[key]) for key in keys]
