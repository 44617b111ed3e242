"""What is proved of the sampled full-order loop in a region: the search in blocks that are kept, and its statement."""

from __future__ import annotations

import functools
import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import CertificateCell, StaticLimits
from vsgdesign.artifacts.files import package_hash, plain
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.proof_file import ProofFile, packed, proved_table
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.certificate.asked import check_known, within_scheduler
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order.cells import Arcs
from vsgdesign.certificate.full_order.points import least_decay
from vsgdesign.certificate.full_order.record import LeftPart, arrays_of, left_parts, left_row
from vsgdesign.certificate.full_order.rows import inner_rows
from vsgdesign.certificate.full_order.search import Found, Problem, Waiting, beginning, search
from vsgdesign.certificate.region import Region, System
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.executors import Progress, executor_of, worker_count
from vsgdesign.execution.jobs import Job
from vsgdesign.execution.journal import Journal, journal_at, run_job
from vsgdesign.runtime.guards import settings_of
from vsgdesign.study.parameters.dc_link import without_voltage_droop
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

_BLOCK = 1
"""Cells of the beginning that are a block of the work."""

_MOST_LOOKS = 1_000_000
"""Boxes that a block looks at before the rest of it is not decided."""

_SEARCHED, _DRAWN = 3, 500
"""Parts that are left in which a search looks for the least decay, the largest first; and its random points."""

_STEP = 2_000
"""Boxes between two looks at the clock."""

_SHARE = 0.5
"""Of the least decay that is found, what is proved where no decay is asked for."""


@dataclass(frozen=True, kw_only=True)
class FullOrderProof:
    """All eigenvalues of the sampled full-order loop lie inside \\|z\\| = exp(−``decay``·T_s) on the share ``proved``
    of the region; of all of it where ``left`` is empty.

    ``slowest``: the point of least decay that a search found. ``cells`` and ``boxes``: how many the proof has.
    """

    controller: str
    region: Region
    limits: StaticLimits
    decay: float
    slowest: CertificateCell
    proved: float
    left: tuple[LeftPart, ...]
    cells: int
    boxes: int
    values: int
    states: int
    inner_gains: dict[str, float]
    delay: int
    blocks: tuple[dict[str, str], ...] = ()
    """The tree of boxes and the arcs, as a proof's file keeps them (:mod:`vsgdesign.artifacts.proof_file`)."""
    differential: FullOrderProof | None = None
    """The same of equal units against each other, with the gains of these grids (:eq:`plant-split`); None: one
    converter."""

    @property
    def complete(self) -> bool:
        """Whether the whole region is proved, of units against each other as well."""
        return not self.left and (self.differential is None or self.differential.complete)

    @property
    def unstable(self) -> bool:
        """Whether the slowest point is a counterexample, or that of units against each other."""
        own = not (self.slowest.decay or 0.0) > 0.0
        return own or (self.differential is not None and self.differential.unstable)

    @property
    def inner_hash(self) -> str:
        """Of the inner gains that it holds for."""
        return inner_hash(self.inner_gains)

    def as_document(self) -> dict[str, Any]:
        """JSON's types."""
        return plain(
            {
                "model": "full",
                "certified": not self.left,
                "controller": self.controller,
                "region": self.region.as_document(),
                "static_limits": asdict(self.limits),
                "decay": self.decay,
                "slowest": {name: value for name, value in asdict(self.slowest).items() if value is not None},
                "proved": self.proved,
                "left": [asdict(part) for part in self.left],
                "cells": self.cells,
                "boxes": self.boxes,
                "values": self.values,
                "states": self.states,
                "inner_gains": self.inner_gains,
                "inner_hash": self.inner_hash,
                "delay_samples": self.delay,
            }
            | ({} if self.differential is None else {"differential": self.differential.as_document()})
        )


def inner_hash(gains: Mapping[str, float]) -> str:
    """What a statement calls some inner gains."""
    return hashlib.sha256(repr(sorted(gains.items())).encode()).hexdigest()[:16]


_DECIDING = (
    *("converter", "filter", "grid_source", "inner_gains", "scr_basis", "omega_t", "current_limiter", "limiter_given"),
    *("tau_P", "tau_Q", "power_filter", "notch_damping"),
)
"""Of a study, what a proof depends on beside its controller."""


@dataclass(frozen=True, kw_only=True)
class FullOrderJob(Job[int, dict[str, Any]]):
    """The proof in blocks of cells. A part has, by the number of its block, what was found there. With ``apart`` the
    blocks of the loop on the grids are followed by as many of units against each other."""

    study: Study
    spec: ControllerSpec
    tables: Mapping[str, GainTable]
    region: Region
    decay: float
    apart: float | None = None
    """The decay of units against each other, 1/s; None: they are no part of the proof."""
    until: float | None = None
    """Seconds of :func:`time.time` after which no block is begun or ended."""

    what = "full-order proof"

    @property
    def key(self) -> str:
        """Hash of everything that a part depends on."""
        tables = {name: proved_table(table) for name, table in self.tables.items()}
        study = self.study.with_limit_of(self.spec)
        parts = {name: repr(getattr(study, name)) for name in _DECIDING}
        spec = replace(self.spec, table_file=None)
        asked = (parts, repr(spec), tables, repr(self.region), self.decay, self.apart)
        return hashlib.sha256(repr((asked, package_hash())).encode()).hexdigest()

    @functools.cached_property
    def problems(self) -> tuple[Problem, ...]:
        """What is to be proved, of each mode."""
        system, _ = prepared(self.study, self.spec, self.region, Ready(tables=dict(self.tables)), None, self.decay)
        table = self.tables.get(self.spec.name)
        box = None if table is None else settings_of(table)
        drawn_to = None if box is None else (box.scr, box.r_over_x)
        study = self.study.with_limit_of(self.spec)
        modes = [(system, self.decay)]
        if self.apart is not None:
            modes.append((replace(system, apart=True), self.apart))
        return tuple(Problem.of(study, one, self.region, decay, drawn_to) for one, decay in modes)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in ("problems", "_beginning", "_order")}

    @functools.cached_property
    def _beginning(self) -> list[Waiting]:
        return beginning(self.problems[0])  # of both modes: the pieces are those of the grids and the schedule

    @property
    def blocks(self) -> Sequence[int]:
        """Numbers of all blocks. Strong grids come first, as they take least time for their volume, and of one SCR the
        blocks of most volume: none that takes long is left for one worker at the end."""
        return self._order

    @functools.cached_property
    def _order(self) -> tuple[int, ...]:
        count = self._in_a_mode
        first = [float(self._cells(block)[0].low[0]) for block in range(count)]
        every = range(count * len(self.problems))
        return tuple(sorted(every, key=lambda block: (block // count, first[block % count], -self.size(block))))

    @property
    def _in_a_mode(self) -> int:
        return -(-len(self._beginning) // _BLOCK)

    def problem_of(self, block: int) -> Problem:
        """What is to be proved in a block."""
        return self.problems[block // self._in_a_mode]

    def _cells(self, block: int) -> list[Waiting]:
        k = _BLOCK * (block % self._in_a_mode)
        return self._beginning[k : k + _BLOCK]

    def of_mode(self, mode: int, parts: Mapping[str, Any]) -> tuple[list[Any], list[list[Any]]]:
        """What was found of a mode, and the cells of its blocks that are not finished, as what is left of a part."""
        count = self._in_a_mode
        own = range(count * mode, count * (mode + 1))
        cells = [one for block in self.left(dict(parts)) if block in own for one in self._cells(block)]
        found = [parts[str(block)] for block in own if str(block) in parts]
        return found, [left_row(self.problems[mode], one, "time") for one in cells]

    def size(self, block: int, /) -> int:
        """A millionth of the volume counts as one."""
        return 1 + round(1e6 * sum(float(one.boxes.share.sum()) for one in self._cells(block)))

    def run(self, block: int) -> dict[str, Any]:
        """What a search finds in some cells."""
        found, problem = Found(), self.problem_of(block)
        begin, coarse = self._cells(block), Arcs.coarsest(problem.loop.T_s)
        waiting, most = begin, _MOST_LOOKS if self.until is None else _STEP
        while waiting and found.looked < _MOST_LOOKS:
            if self.until is not None and time.time() > self.until:
                return {}
            waiting = search(problem, waiting, found, most_looks=min(found.looked + most, _MOST_LOOKS))
        left = [*found.left, *((one, "boxes") for one in waiting)]
        return {
            str(block): {
                "decay": problem.loop.alpha,
                "proved": found.proved,
                "empty": found.empty,
                "values": found.values,
                "cells": len(found.cells),
                "boxes": sum(map(len, found.boxes)),
                "left": [left_row(problem, one, why) for one, why in left],
                "record": packed(arrays_of(begin, problem.pieces, found, coarse.edges)),
                **self.more_of(problem),
            }
        }

    def more_of(self, problem: Problem) -> dict[str, Any]:  # noqa: ARG002 - what other statements add
        """What a part keeps of its problem beside its rate."""
        return {}


def prove_full_order(  # noqa: PLR0913 - those of certify
    study: Study,
    spec: ControllerSpec,
    region: Region,
    *,
    ready: Ready = NOTHING,
    decay: float | None = None,
    pair: bool = False,
    kept: Callable[[FullOrderJob], AbstractContextManager[Journal[Any]]] | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
    seconds: float | None = None,
) -> FullOrderProof:
    """The statement over a region.

    ``decay`` in 1/s; None: half of the least one that a search finds. ``pair``: it is one unit of several, and what is
    proved are all units together and, in ``differential``, the units against each other (:eq:`plant-pair`). ``kept``
    opens the journal in which finished blocks are kept. After ``seconds`` what is not looked at is left out of the
    statement, and the journal stays. Raises StudyError where the region or the decay is wrong, InfeasibleStudyError
    where the region is empty, where the loop has something that the proof does not know, or where a point decays more
    slowly than is asked.
    """
    without_voltage_droop(study, "a proof of the sampled loop")
    until = None if seconds is None else time.time() + seconds
    study, region = within_scheduler(study, region, ready.tables.get(spec.name))
    check_known(study, spec, region, ready)
    system, _ = prepared(study, spec, region, ready, None, decay)
    own = study.with_limit_of(spec)
    if pair and own.filter.L_2 == 0.0:
        raise InfeasibleStudyError("nothing lies between the units: there are no modes of units against each other.")
    modes = [system, replace(system, apart=True)] if pair else [system]
    slowest = [least_decay(own, one, region) for one in modes]
    every = [found.decay or 0.0 for found in slowest]
    if (least := min(every)) <= 0.0:
        found = [_statement(own, spec, region, one, 0.0, at, [], []) for one, at in zip(modes, slowest, strict=True)]
        return replace(found[0], differential=found[1] if pair else None)
    if decay is not None and decay >= least:
        raise InfeasibleStudyError(
            f"controller {spec.name}: decay = {decay:g} 1/s does not hold in the sampled full-order model; at most "
            f"{least:.3g} 1/s does. Ask for less, or shrink the region or the error."
        )
    tables = {spec.name: table} if (table := ready.tables.get(spec.name)) is not None else {}
    goals = [half_of(one) if decay is None else decay for one in every]
    apart = goals[1] if pair else None
    job = FullOrderJob(study=study, spec=spec, tables=tables, region=region, decay=goals[0], apart=apart, until=until)
    parts = until_done(job, kept, workers, cluster, progress)
    found = []
    for k, one in enumerate(modes):
        own_part = _statement(own, spec, region, one, goals[k], slowest[k], *job.of_mode(k, parts))
        left = own_part.left if until is not None else _searched(own, one, region, own_part.left)
        found.append(replace(own_part, left=left))
    return replace(found[0], differential=found[1] if pair else None)


def until_done(
    job: FullOrderJob,
    kept: Callable[[FullOrderJob], AbstractContextManager[Journal[Any]]] | None,
    workers: int | None,
    cluster: str | None,
    progress: Progress | None,
) -> Mapping[str, Any]:
    """The parts of a job, or those that its time was enough for: its journal then stays."""
    parts: Mapping[str, Any] = {}
    with suppress(_OutOfTimeError), journal_at(job, None) if kept is None else kept(job) as journal:
        left = len(job.left(journal.whole))
        with executor_of(min(worker_count(workers), max(left, 1)), cluster) as executor:
            parts = run_job(job, journal, executor=executor, progress=progress)
        if job.left(parts):
            raise _OutOfTimeError
    return parts


def half_of(decay: float) -> float:
    """What is proved where a decay was found, 1/s."""
    return _SHARE * decay


class _OutOfTimeError(Exception):
    """Leaves a journal as one leaves it after an interruption: with all that is finished."""


def _searched(study: Study, system: System, region: Region, left: tuple[LeftPart, ...]) -> Any:
    """The parts that are left, the largest with the least decay that is found there."""
    found = list(left)
    for k, part in enumerate(left[:_SEARCHED]):
        own = replace(region, scr=part.scr, x_over_r=part.x_over_r, P=part.P, Q=part.Q)
        with suppress(InfeasibleStudyError):  # no point keeps the limits
            found[k] = replace(part, least_decay=least_decay(study, system, own, 0, _DRAWN).decay)
    return tuple(found)


def _statement(
    study: Study,
    spec: ControllerSpec,
    region: Region,
    system: System,
    decay: float,
    slowest: CertificateCell,
    every: Sequence[Mapping[str, Any]],
    not_looked_at: Sequence[list[Any]],
) -> FullOrderProof:
    proved = sum(part["proved"] for part in every)
    rest = [row for part in every for row in part["left"]] + list(not_looked_at)
    total, left = left_parts(proved, rest)
    if not rest and not every:
        left = [LeftPart(scr=region.scr, x_over_r=region.x_over_r, P=region.P, Q=region.Q, share=1.0, reason="boxes")]
    filters = (study.tau_P > 0.0) + (study.tau_Q > 0.0) + 4 * study.has_notch
    return FullOrderProof(
        controller=spec.name,
        region=region,
        limits=system.static,
        decay=decay,
        slowest=slowest,
        proved=proved / total if every else 0.0,
        left=tuple(left),
        cells=sum(part["cells"] for part in every),
        boxes=sum(part["boxes"] for part in every),
        values=sum(part["values"] for part in every),
        states=2 * inner_rows(study).states + 3 + filters,
        inner_gains=study.inner_gains._asdict(),
        delay=study.converter.delay_samples,
        blocks=tuple(part["record"] for part in every),
    )


def proof_file(study: Study, proof: FullOrderProof, table: GainTable | None) -> ProofFile:
    """The file of a proof of a study's loops, with their gain table if they have one."""
    return ProofFile(
        study=study.name,
        study_hash=study.hash,
        scr_basis=study.scr_basis,
        table=proved_table(table),
        statement=proof.as_document(),
        coarse_arcs=tuple(Arcs.coarsest(study.converter.T_s).edges.tolist()),
        blocks=proof.blocks,
        apart=() if proof.differential is None else proof.differential.blocks,
    )
