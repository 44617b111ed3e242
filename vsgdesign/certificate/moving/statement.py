"""What is proved of the sampled full-order loop whose gains change, and what was looked at by points.

The points are a lattice of grids and powers: at each place one function for all gains, and how long grids have to last
between two jumps.
"""

from __future__ import annotations

import functools
import hashlib
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.certificate_record import CertificateCell
from vsgdesign.artifacts.files import package_hash, plain
from vsgdesign.artifacts.proof_file import ProofFile
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.certificate.asked import check_known, within_scheduler
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order.cells import Arcs
from vsgdesign.certificate.full_order.points import decays_at, least_decay
from vsgdesign.certificate.full_order.record import LeftPart, left_parts
from vsgdesign.certificate.full_order.search import Problem, Waiting
from vsgdesign.certificate.full_order.statement import (
    FullOrderJob,
    half_of,
    inner_hash,
    until_done,
)
from vsgdesign.certificate.moving.levels import StepsAtPlaces, common_function, dwell_time, shortfall, steps_at
from vsgdesign.certificate.moving.looking import MovingProblem, MovingPrograms, with_middle
from vsgdesign.certificate.moving.places import ball_of, estimates, loops_at, middle_error, with_estimates
from vsgdesign.certificate.region import Region, nodes, random_points
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.executors import Progress
from vsgdesign.execution.journal import Journal
from vsgdesign.runtime.table import TableSchedule
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

_STEPS, _CHECKED = 5, 9
"""Estimates along each error for which a function is looked for, and among which it is checked."""


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """What was found on the lattice. Times are in s: how long grids have to last where two of them take turns."""

    places: int
    """Of the lattice, within the static limits and looked at."""
    without: tuple[CertificateCell, ...]
    """Those for which no function was found; ``decay`` is the least one of the estimates there, 1/s."""
    decay: tuple[float, float]
    """Least and largest decay of the functions, 1/s."""
    ratio: float
    """Of the SCR of neighbours."""
    near: tuple[float, float]
    """Between neighbours in SCR: the median and the largest time."""
    far: tuple[float, float]
    """Between any two SCR of one X/R, P and Q, alike."""
    lines: tuple[int, int]
    """Lines of constant X/R, P and Q that were looked at, and how many there are."""


class LatticeJob(FullOrderJob):
    """The lattice in lines of constant X/R, P and Q. A part has, by the number of its line, what was found there; the
    lines of units against each other follow those of the loop on the grids."""

    what = "places"

    @property
    def key(self) -> str:
        """Hash of everything that a part depends on."""
        return hashlib.sha256(f"lattice {super().key} {package_hash()}".encode()).hexdigest()

    @functools.cached_property
    def lattice(self) -> Array:
        """Places (lines, SCR, 4)."""
        return lattice_of(self.region)

    @property
    def blocks(self) -> range:
        """Numbers of all lines."""
        return range(len(self.lattice) * len(self.problems))

    def size(self, block: int, /) -> int:  # noqa: ARG002 - all lines have as many places
        """One."""
        return 1

    def run(self, block: int) -> dict[str, Any]:
        """The functions along a line."""
        if self.until is not None and time.time() > self.until:
            return {}
        mode, place_of_line = divmod(block, len(self.lattice))
        system, study = self.problems[mode].system, self.study.with_limit_of(self.spec)
        line = self.lattice[place_of_line]
        line = line[system.within_limits(np.hstack([line, np.zeros((len(line), 2))]))]
        places, functions = [], []
        for place in line:
            errors = [
                np.vstack([np.full((1, 2), middle_error(self.region)), estimates(self.region, float(place[1]), steps)])
                for steps in (_STEPS, _CHECKED)
            ]
            some, every = (loops_at(study, system, with_estimates(place[None], one)) for one in errors)
            if not np.isfinite(every.A).all():
                continue
            T_s = study.converter.T_s
            decay = float(-np.log(np.abs(np.linalg.eigvals(every.A)).max()) / T_s)
            rho = float(np.exp(-half_of(decay) * T_s))
            P = common_function(some.A, rho) if decay > 0.0 else None
            if decay > 0.0 and (P is None or shortfall(every.A, P, rho) >= 0.0):
                P = common_function(every.A, rho)
            held = P is not None
            places.append([*place.tolist(), decay, held])
            if held and P is not None:
                functions.append((float(place[0]), P, half_of(decay)))
        near, far = [], []
        for i, (first, P, decay) in enumerate(functions):
            for j, (other, Q, least) in enumerate(functions[:i]):
                dwell = dwell_time(P, Q, min(decay, least))
                far.append(dwell)
                if j == i - 1 and abs(np.log(first / other)) < 1.01 * np.log(ratio_of(self.lattice)):
                    near.append(dwell)
        return {str(block): {"places": places, "near": near, "far": far}}


_SCR, _X_OVER_R, _WIDEST = 15, 10, 1.05
"""Values of SCR, of X/R at most, and the ratio of those of X/R up to which one is enough."""


def lattice_of(region: Region) -> Array:
    """Places (lines, SCR, 4): SCR and X/R spaced by their logarithm, P and Q at their limits and in the middle."""
    low, high = region.x_over_r
    count = min(_X_OVER_R, 1 + int(np.ceil(np.log(high / low) / np.log(_WIDEST) - 1e-9)))
    axes = (
        np.arctan(np.unique(np.geomspace(low, high, count))),
        *(np.unique(np.linspace(*limits, 3)) for limits in (region.P, region.Q)),
        1.0 / np.unique(np.geomspace(*region.scr, _SCR))[::-1],
    )
    angle, P, Q, first = np.meshgrid(*axes, indexing="ij")
    return np.stack([first, angle, P, Q], axis=-1).reshape(-1, len(axes[3]), 4)


def ratio_of(lattice: Array) -> float:
    """Of neighbours' SCR; 1 where there is one alone."""
    first = lattice[0, :, 0]
    return float(first[1] / first[0]) if len(first) > 1 else 1.0


def sampled(job: LatticeJob, parts: Mapping[str, Any], mode: int = 0) -> Sampled:
    """The parts of a lattice as one; ``mode`` 1: of units against each other."""
    parts = {name: part for name, part in parts.items() if int(name) // len(job.lattice) == mode}
    rows = [row for name in sorted(parts, key=int) for row in parts[name]["places"]]
    without = [
        CertificateCell(
            scr=1.0 / row[0], x_over_r=float(np.tan(row[1])), P=row[2], Q=row[3], error_R=0.0, error_L=0.0, decay=row[4]
        )
        for row in rows
        if not row[5]
    ]
    held = [half_of(row[4]) for row in rows if row[5]] or [float("nan")]
    near, far = ([value for part in parts.values() for value in part[name]] for name in ("near", "far"))

    def middle_and_most(values: list[float]) -> tuple[float, float]:
        return (float(np.median(values)), max(values)) if values else (float("nan"), float("nan"))

    return Sampled(
        places=len(rows),
        without=tuple(without),
        decay=(min(held), max(held)),
        ratio=ratio_of(job.lattice),
        near=middle_and_most(near),
        far=middle_and_most(far),
        lines=(len(parts), len(job.lattice)),
    )


AnyJob = TypeVar("AnyJob", bound=FullOrderJob)

_DRAWN = 300
"""Random points of a cell of grids among which its least decay is looked for, beside its corners."""

_STEP_PLACES = 8
"""Places of the lattice, evenly apart, at which steps are sized."""

OF_ALL_UNITS = "those above are steps that all units take, and a step of one unit moves all of them"

MODEL = "moving"
"""The model of its proof's file."""

TABLE = "the gains are those of a table: its places are looked at by points alone"


@dataclass(frozen=True, kw_only=True)
class MovingProof:
    """On the share ``proved`` of the region there is, for every grid with its P and Q, one function that falls under
    all gains of the estimates within their errors, whenever they change (:eq:`moving-function`).

    ``decay``: the least and the largest rate of the cells of grids, 1/s. ``why_not``: why nothing was tried to be
    proved, None where something was. ``sampled``: the lattice.
    """

    controller: str
    region: Region
    proved: float
    left: tuple[LeftPart, ...]
    decay: tuple[float, float] | None
    cells: int
    boxes: int
    values: int
    why_not: str | None
    sampled: Sampled
    steps: StepsAtPlaces | str
    """Steps after which no limit acts, at places of the lattice; else why none are known."""
    slowest: CertificateCell
    """The point with the least decay of gains that are held, of a search."""
    blocks: tuple[dict[str, str], ...] = ()
    """The trees of boxes and the arcs, as in a :class:`~vsgdesign.certificate.FullOrderProof`; a block for each of
    ``balls``."""
    balls: tuple[dict[str, Any], ...] = ()
    """The rate of each block, 1/s, and the weights L and R of :eq:`moving-ball`: ``decay``, ``L``, ``R``."""
    differential: MovingProof | None = None
    """The same of equal units against each other, all with the gains of one estimate (:eq:`plant-split`); None: one
    converter."""

    @property
    def complete(self) -> bool:
        """Whether the whole region is proved, of units against each other as well."""
        own = self.why_not is None and not self.left
        return own and (self.differential is None or self.differential.complete)

    def as_document(self) -> dict[str, Any]:
        """JSON's types."""
        document = asdict(replace(self, differential=None, blocks=(), balls=()))
        for name in ("controller", "region", "differential", "slowest", "blocks", "balls"):
            del document[name]
        document |= {"certified": self.why_not is None and not self.left, "region": self.region.as_document()}
        other = self.differential
        return plain(document | ({} if other is None else {"differential": other.as_document()}))


class MovingJob(FullOrderJob):
    """The proof in blocks of cells of grids, each with a rate and weights of its own."""

    what = "changing gains"

    @property
    def key(self) -> str:
        """Hash of everything that a part depends on."""
        return hashlib.sha256(f"moving {super().key} {package_hash()}".encode()).hexdigest()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in super().__getstate__().items() if name not in ("moving", "_beginning")}

    @functools.cached_property
    def moving(self) -> MovingPrograms:
        """The programs of all cells."""
        return MovingPrograms.of(self.problems[0].system, self.region)

    def _cells(self, block: int) -> list[Waiting]:
        cells = super()._cells(block)
        return [replace(one, boxes=with_middle(one.boxes, middle_error(self.region))) for one in cells]

    def problem_of(self, block: int) -> Problem:
        """With half of the least decay of points in its cell, and weights for it."""
        (one,) = self._cells(block)
        system, study = super().problem_of(block).system, self.study.with_limit_of(self.spec)
        rng = np.random.default_rng(block)
        ratio = float(np.tan(one.low[1])), float(np.tan(one.high[1]))
        cell = replace(self.region, scr=(1.0 / one.high[0], 1.0 / one.low[0]), x_over_r=ratio)
        points, decays = np.empty((0, 6)), np.empty(0)
        for region in (cell, self.region):  # a cell without a point within the static limits proves nothing
            points = np.concatenate([nodes(region, 2), random_points(region, _DRAWN, rng)])
            points = points[system.within_limits(points)]
            decays = decays_at(study, system, points)
            points, decays = points[np.isfinite(decays)], decays[np.isfinite(decays)]
            if len(points):
                break
        alpha = half_of(max(float(decays.min()), 2e-3))
        places = np.unique(points[:, :4], axis=0)
        ball = ball_of(study, system, self.region, rng.permutation(places), alpha)
        return MovingProblem.about(Problem.of(study, system, self.region, alpha), self.moving, ball)

    def more_of(self, problem: Problem) -> dict[str, Any]:
        """The weights of its ball."""
        ball = problem.ball if isinstance(problem, MovingProblem) else None
        return {} if ball is None else {"L": ball.left.tolist(), "R": ball.right.tolist()}


def moving_proof_file(study: Study, spec: ControllerSpec, found: MovingProof) -> ProofFile | None:
    """The file of a proof with gains in closed form; None where nothing is proved between points."""
    if found.decay is None:
        return None
    own = study.with_limit_of(spec)
    system, _ = prepared(study, spec, found.region, NOTHING, None, None)

    def statement(one: MovingProof) -> dict[str, Any]:
        same = {
            "model": MODEL,
            "controller": one.controller,
            "certified": not one.left,
            "proved": one.proved,
            "decay": min((ball["decay"] for ball in one.balls), default=0.0),
            "region": one.region.as_document(),
            "static_limits": asdict(system.static),
            "slowest": {name: value for name, value in asdict(one.slowest).items() if value is not None},
            "inner_gains": own.inner_gains._asdict(),
            "inner_hash": inner_hash(own.inner_gains._asdict()),
            "delay_samples": own.converter.delay_samples,
            "parts": one.balls,
        }
        return plain(same if one.differential is None else same | {"differential": statement(one.differential)})

    return ProofFile(
        study=study.name,
        study_hash=study.hash,
        scr_basis=study.scr_basis,
        table="",
        statement=statement(found),
        coarse_arcs=tuple(Arcs.coarsest(own.converter.T_s).edges.tolist()),
        blocks=found.blocks,
        apart=() if found.differential is None else found.differential.blocks,
    )


def prove_moving(
    study: Study,
    spec: ControllerSpec,
    region: Region,
    *,
    ready: Ready = NOTHING,
    pair: bool = False,
    kept: Callable[[FullOrderJob], AbstractContextManager[Journal[Any]]] | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
    seconds: float = 300.0,
) -> MovingProof:
    """The statement over a region: the lattice first, then steps, then the proof, each in at most ``seconds``.

    Gains in closed form are proved; of a table the lattice is looked at. ``pair``: it is one unit of several with one
    estimate, and the units against each other are proved as well. Errors are those of
    :func:`~vsgdesign.certificate.full_order.statement.prove_full_order`.
    """
    study, region = within_scheduler(study, region, ready.tables.get(spec.name))
    check_known(study, spec, region, ready)
    system, _ = prepared(study, spec, region, ready, None, None)
    own = study.with_limit_of(spec)
    modes = [system, replace(system, apart=True)] if pair else [system]
    slowest = [least_decay(own, one, region) for one in modes]
    least = [found.decay or 0.0 for found in slowest]
    if min(least) <= 0.0:
        raise InfeasibleStudyError(
            f"controller {spec.name}: a point of the region is unstable with gains that are held; what changing gains "
            "do is not asked then. Shrink the region or the error."
        )
    tables = {spec.name: table} if (table := ready.tables.get(spec.name)) is not None else {}

    def all_of(kind: type[AnyJob]) -> tuple[AnyJob, Mapping[str, Any]]:
        apart = half_of(least[1]) if pair else None
        job = kind(study=study, spec=spec, tables=tables, region=region, decay=half_of(least[0]), apart=apart,
                   until=time.time() + seconds)  # fmt: skip
        return job, until_done(job, kept, workers, cluster, progress)

    lattice_job, lattice_parts = all_of(LatticeJob)
    lattice = lattice_of(region).reshape(-1, 4)
    lattice = lattice[system.within_limits(np.hstack([lattice, np.zeros((len(lattice), 2))]))]
    steps = steps_at(own, system, region, lattice, _STEP_PLACES, time.time() + seconds)
    why_not: str | None = TABLE if isinstance(system.schedule, TableSchedule) else None
    if why_not is None:
        try:
            MovingPrograms.of(system, region)
        except InfeasibleStudyError as error:
            why_not = str(error)
    job, parts = (None, {}) if why_not is not None else all_of(MovingJob)
    found = []
    for mode in range(len(modes)):
        every, rest = ([], []) if job is None else job.of_mode(mode, parts)
        proved = sum(part["proved"] for part in every)
        rest = [row for part in every for row in part["left"]] + rest
        total, left = left_parts(proved, rest)
        rates = [part["decay"] for part in every if part["proved"] > 0.0]
        found.append(
            MovingProof(
                controller=spec.name,
                region=region,
                proved=proved / total,
                left=tuple(left),
                decay=(min(rates), max(rates)) if rates else None,
                cells=sum(part["cells"] for part in every),
                boxes=sum(part["boxes"] for part in every),
                values=sum(part["values"] for part in every),
                why_not=why_not,
                sampled=sampled(lattice_job, lattice_parts, mode),
                steps=steps if mode == 0 else OF_ALL_UNITS,
                slowest=slowest[mode],
                blocks=tuple(part["record"] for part in every),
                balls=tuple({name: part[name] for name in ("decay", "L", "R")} for part in every),
            )
        )
    return replace(found[0], differential=found[1] if pair else None)
