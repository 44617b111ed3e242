"""A search for the worst cases. It finds rare failures; its cases are no sample, and no share may be taken of them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.campaigns.verification.blocks import VerificationJob
from vsgdesign.campaigns.verification.counting import LEFT_OUT, figures_of, judged_values
from vsgdesign.campaigns.verification.summary import CaseFigures
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.execution.jobs import begun
from vsgdesign.simulation.lanes.results import STATUSES

Array = NDArray[np.float64]

POPULATION, LEAST = 128, 16
"""Cases of a generation, whole numbers of lanes on any machine: most, and least where few evaluations are asked for."""

FOUND = 5
"""Cases that a search gives for each family."""

APART = 0.05
"""Two found cases differ by at least this in one of their coordinates, of which each goes from 0 to 1."""

_SAME = 1e-9
"""Cases whose coordinates all differ by less are one."""

_CEILING = 10.0
"""A figure that does not exist counts as this many times its limit."""


_BEYOND = 0.15
"""The search may step beyond the cube by this, and is put back on its face: the worst cases are often at a corner."""


@dataclass(frozen=True, kw_only=True)
class FoundCase:
    """A case that a search has found."""

    family: str
    promise: str
    """The promise that it keeps least, or breaks most."""
    broken: tuple[str, ...]
    """Promises that it breaks."""
    coordinates: tuple[float, ...]
    """What the case is made of (:func:`vsgdesign.campaigns.verification.draws.cases_of`)."""
    case: CaseFigures
    """Its ``number`` is that of the evaluation."""


@dataclass
class _Watch:
    """The objective of the search, and everything that it has met."""

    job: VerificationJob
    family: int
    known: Array
    """Coordinates of the cases that are known already, a row each. They are no finding."""
    evaluations: int = 0
    broken: int = 0
    best: list[FoundCase] = field(default_factory=list)

    def severities(self, coordinates: Array) -> Array:
        """The largest figure over what is allowed, of each case (rows of ``coordinates``); zero where none is asked."""
        job, name = self.job, self.job.families[self.family]
        inside = np.clip(coordinates, 0.0, np.nextafter(1.0, 0.0))
        cases = job.cases_of(inside, self.family)
        results = job.results_of(cases)
        status, figures = np.asarray(results.status), figures_of(results)
        held = [promise for promise in job.promises if name in promise.families]
        asked = ~np.isin(status, LEFT_OUT)
        uses = np.stack(
            [judged_values(p, status, figures) / p.most_of(cases.signal, results.noise) for p in held], axis=1
        )
        worst = np.where(asked, uses.max(axis=1), 0.0)
        for k in np.argsort(-worst, kind="stable")[: self._kept].tolist():
            if asked[k]:
                self._keep(
                    FoundCase(
                        family=name,
                        promise=held[int(uses[k].argmax())].name,
                        broken=tuple(p.name for j, p in enumerate(held) if not uses[k, j] <= 1.0),
                        coordinates=tuple(inside[k].tolist()),
                        case=CaseFigures(
                            self.evaluations + k, float(worst[k]), STATUSES[status[k]], tuple(figures[k].tolist())
                        ),
                    )
                )
        self.evaluations += len(coordinates)
        self.broken += int((worst > 1.0).sum())
        return np.minimum(worst, _CEILING)

    def _keep(self, found: FoundCase) -> None:
        """Among those that it is near to, the worst is kept."""
        near = [one for one in self.best if np.abs(np.subtract(one.coordinates, found.coordinates)).max() < APART]
        if any(_order(one) <= _order(found) for one in near):
            return
        kept = [one for one in self.best if one not in near]
        self.best = sorted([*kept, found], key=_order)[: self._kept]

    @property
    def _kept(self) -> int:
        return FOUND + len(self.known)

    def found(self) -> tuple[FoundCase, ...]:
        """The worst of what is new. A case near a known one is new if it is worse."""
        # SciPy scales the coordinates from which it begins, and back, which changes their last digits.
        new = [one for one in self.best if not (np.abs(self.known - one.coordinates) < _SAME).all(axis=1).any()]
        return tuple(new[:FOUND])


@dataclass(frozen=True, kw_only=True)
class Searched:
    """What a search has found."""

    evaluations: int
    broken: int
    """Evaluations that break a promise; many of them may be one case and its neighbours."""
    found: tuple[FoundCase, ...]
    """The worst of each family first."""


def search(
    job: VerificationJob,
    evaluations: int,
    starts: Mapping[str, Array],
    *,
    edges: Sequence[int] = (),
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Searched:
    """Looks for the worst case of every family by differential evolution over the coordinates of its cases.

    ``evaluations``: most runs in all, shared equally among the families; none where they are too few for two small
    generations of each. ``starts``: rows of coordinates of known cases to begin from, by family; the search improves
    them and does not list them again. The rest of the first generation covers the cube evenly; two of three of its
    cases are at a corner in the coordinates ``edges``, where a linear design is at its worst. The same seed finds the
    same. Raises WorkerError where a worker is lost.
    """
    return begun_search(job, evaluations, starts, edges=edges, executor=executor)(progress or silent)


def begun_search(
    job: VerificationJob,
    evaluations: int,
    starts: Mapping[str, Array],
    *,
    edges: Sequence[int] = (),
    executor: Executor | None = None,
) -> Callable[[Progress], Searched]:
    """Hands a search to the executor's workers. What is returned waits for it; without an executor it does the work.

    See :func:`search` for the arguments.
    """
    verification = job.study.verification
    seed = 0 if verification is None else verification.seed
    each = evaluations // max(len(starts), 1)
    chosen = starts if each >= 2 * LEAST else {}
    tasks = [(job, job.families.index(name), each, rows, tuple(edges), seed) for name, rows in chosen.items()]
    calls = [begun(executor, _search_family, *task) for task in tasks]

    def finish(tell: Progress) -> Searched:
        parts: list[Searched] = []
        for k, call in enumerate(calls):
            tell("search for the worst", k / len(calls))
            parts.append(call())
        tell("search for the worst", 1.0)
        return Searched(
            evaluations=sum(part.evaluations for part in parts),
            broken=sum(part.broken for part in parts),
            found=tuple(sorted((one for part in parts for one in part.found), key=_order)),
        )

    return finish


def _search_family(
    job: VerificationJob, family: int, evaluations: int, starts: Array, edges: tuple[int, ...], seed: int
) -> Searched:
    from scipy.optimize import differential_evolution
    from scipy.stats import qmc

    watch = _Watch(job, family, starts)
    dimensions = starts.shape[1]
    generator = np.random.default_rng([seed, family])
    size = min(POPULATION, evaluations // (2 * LEAST) * LEAST)
    begin = qmc.LatinHypercube(dimensions, rng=generator).random(size)
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=len(edges))))
    cornered = np.flatnonzero(np.arange(size) % 3 > 0)
    for column, edge in enumerate(edges):
        begin[cornered, edge] = np.resize(corners[:, column], len(cornered))
    # Half of the generation at most: from the same places alone it would not get away.
    begin[: size // 2][: len(starts)] = starts[: size // 2]
    first: Any = begin  # the type that SciPy states is that of its names alone
    differential_evolution(
        lambda x: -watch.severities(np.ascontiguousarray(x.T)),
        [(-_BEYOND, 1.0 + _BEYOND)] * dimensions,
        init=first,
        maxiter=evaluations // size - 1,
        tol=0.0,
        mutation=(0.4, 0.9),
        polish=False,
        updating="deferred",
        vectorized=True,
        rng=generator,
    )
    return Searched(evaluations=watch.evaluations, broken=watch.broken, found=watch.found())


def _order(found: FoundCase) -> tuple[float, str, int]:
    return -found.case.severity, found.family, found.case.number


def starts_of(coordinates: Sequence[Sequence[float]], dimensions: int) -> Array:
    """Rows to begin from as an array (n, dimensions); n may be zero."""
    return np.array(coordinates, dtype=float).reshape(len(coordinates), dimensions)
