"""The worst cases: each as a study file, simulated again as a single run, with the reasons that are known."""

from __future__ import annotations

import math
from collections.abc import Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np

from vsgdesign.execution.progress import Progress, silent
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.verification.blocks import Job
from vsgdesign.verification.document import figures_document
from vsgdesign.verification.draws import COORDINATES, UNIFORMS, uniforms_of
from vsgdesign.verification.promises import FIGURES
from vsgdesign.verification.search import FoundCase, search, starts_of
from vsgdesign.verification.summary import WORST, CaseFigures, Summary
from vsgdesign.verification.words import beside_relaxed, end_of, start_of, what_of, why_of

AGREEMENT = 1e-6
"""Largest difference between a case in the batch and the same case as a single run: of a figure, relative to its size
or to one unit of it, whichever is larger."""


def worst_cases(summary: Summary, count: int = WORST) -> list[tuple[str, str, CaseFigures]]:
    """The worst judged cases with their family and the promise of which they leave the least, each case once."""
    found: dict[int, tuple[str, str, CaseFigures]] = {}
    for family, counts in summary.families.items():
        for promise, one in counts.promises.items():
            for case in one.worst:
                kept = found.get(case.index)
                if kept is None or case.severity > kept[2].severity:
                    found[case.index] = family, promise, case
    return sorted(found.values(), key=lambda row: (-row[2].severity, row[2].index))[:count]


def write_worst(folder: Path, job: Job, summary: Summary, progress: Progress | None = None) -> list[dict[str, Any]]:
    """Writes the worst drawn cases as studies to a new ``folder`` and simulates each again. Returns their rows."""
    tell, rows = progress or silent, []
    worst = worst_cases(summary)
    folder.mkdir()
    for k, (family, promise, case) in enumerate(worst):
        tell("worst cases", k / len(worst))
        cases, _ = job.batch.draw(job.study, job.spec, case.index, 1, job.ready)
        coordinates = uniforms_of(_seed(job), case.index, 1)[0]
        name = f"{k + 1:02d}-case-{case.index}"
        row = {"rank": k + 1, "case": case.index} | _row(folder, name, job, cases, family, promise, case, coordinates)
        rows.append(row)
    tell("worst cases", 1.0)
    return rows


def write_found(
    folder: Path,
    job: Job,
    summary: Summary,
    evaluations: int,
    *,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Searches for worse cases, beginning from the worst that were drawn, and writes those that it finds as studies to
    a new ``folder``. Returns the numbers of evaluations and the rows. None of it enters a share."""
    starts = {name: starts_of([], UNIFORMS) for name, family in summary.families.items() if family.judged}
    for name in starts:
        indices = {case.index for one in summary.families[name].promises.values() for case in one.worst[:8]}
        rows = [uniforms_of(_seed(job), index, 1)[0].tolist() for index in sorted(indices)]
        starts[name] = starts_of(rows, UNIFORMS)
    searched = search(job, evaluations, starts, executor=executor, progress=progress)
    found = []
    if searched.found:
        folder.mkdir()
    for k, one in enumerate(searched.found):
        cases, _ = _cases_of(job, one)
        name = f"{k + 1:02d}-{one.family}"
        row = _row(folder, name, job, cases, one.family, one.promise, one.case, np.array(one.coordinates))
        found.append({"rank": k + 1, "case": None} | row | {"broken": list(one.broken)})
    return {"evaluations": searched.evaluations, "broken": searched.broken, "found": found}


def _seed(job: Job) -> int:
    return 0 if job.study.verification is None else job.study.verification.seed


def _cases_of(job: Job, one: FoundCase) -> tuple[LaneCases, Any]:
    rows = np.array([one.coordinates])
    return job.batch.cases_of(job.study, job.spec, rows, job.families.index(one.family), job.ready)


def _row(
    folder: Path,
    name: str,
    job: Job,
    cases: LaneCases,
    family: str,
    promise: str,
    case: CaseFigures,
    coordinates: np.ndarray,
) -> dict[str, Any]:
    """One case for results.json; its study is written as ``name``.toml."""
    path = folder / f"{name}.toml"
    path.write_text(job.batch.written(job.study, job.spec, cases, 0, path), encoding="utf-8", newline="\n")
    again = job.batch.simulated(path, job.ready)
    figures = figures_document(case.figures)
    return {
        "family": family,
        "promise": promise,
        "status": case.status,
        "figures": figures,
        "start": start_of(job.study, cases, 0),
        "end": end_of(job.study, cases, 0),
        "what": what_of(job.study, cases, 0),
        "why": _why(job, cases, promise, case, coordinates),
        "study": f"{folder.name}/{path.name}",
        "simulated": again,
        "difference": (difference := largest_difference(figures, again)),
        "agrees": difference is None or difference <= AGREEMENT,
    }


def largest_difference(figures: Mapping[str, float], again: Mapping[str, float]) -> float | None:
    """The largest difference of the figures that both have, relative to their size or to one, whichever is larger.

    Infinite where one of them has a number and the other has none; None where they have no figure in common.
    """
    differences = []
    for name in FIGURES:
        if name not in again:
            continue
        one, other = figures[name], again[name]
        if math.isfinite(one) and math.isfinite(other):
            differences.append(abs(one - other) / max(abs(one), abs(other), 1.0))
        else:
            differences.append(0.0 if math.isfinite(one) == math.isfinite(other) else math.inf)
    return max(differences, default=None)


def _why(job: Job, cases: LaneCases, promise: str, case: CaseFigures, coordinates: np.ndarray) -> str | None:
    table = job.ready.table(job.spec)
    R_g = float(cases.R_g[0] * (1.0 + cases.error_R[0]))
    L_g = float(cases.L_g[0] * (1.0 + cases.error_X[0]))
    held = next(one for one in job.promises if one.name == promise)
    return why_of(
        case.figures,
        promise,
        {name: float(u) for name, u in zip(COORDINATES, coordinates, strict=True) if name in _SAID},
        relaxed=promise in ("overshoot", "settling") and beside_relaxed(table, job.study, R_g, L_g),
        decay=job.batch.decay(job.study, job.spec, job.ready, cases, 0),
        limit=held.limit,
    )


_SAID = ("SCR", "X/R")
