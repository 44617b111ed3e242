"""The worst cases: each as a study file, simulated again as a single run, with the reasons that are known."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.execution.progress import Progress, silent
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.verification.blocks import VerificationJob
from vsgdesign.verification.document import figures_document
from vsgdesign.verification.draws import COORDINATES, UNIFORMS, uniforms_of
from vsgdesign.verification.promises import FIGURES
from vsgdesign.verification.search import Searched, begun_search, starts_of
from vsgdesign.verification.summary import WORST, CaseFigures, Summary
from vsgdesign.verification.words import beside_relaxed, end_of, start_of, what_of, why_of

AGREEMENT = 1e-6
"""Largest difference between a case in the batch and the same case as a single run: of a figure, relative to its size
or to one unit of it, whichever is larger."""


_EDGES = tuple(COORDINATES.index(name) for name in ("scr", "x_over_r", "error_R", "error_X"))
"""Coordinates at whose corners the search also begins."""


class CaseFolder(NamedTuple):
    """A folder of studies: where it is written, and where it will be in the end."""

    written: Path
    final: Path


def worst_cases(summary: Summary, count: int = WORST) -> list[tuple[str, str, CaseFigures]]:
    """The worst judged cases with their family and the promise of which they leave the least, each case once."""
    found: dict[int, tuple[str, str, CaseFigures]] = {}
    for family, counts in summary.families.items():
        for promise, one in counts.promises.items():
            for case in one.worst:
                kept = found.get(case.number)
                if kept is None or case.severity > kept[2].severity:
                    found[case.number] = family, promise, case
    return sorted(found.values(), key=lambda row: (-row[2].severity, row[2].number))[:count]


def write_worst(
    folder: CaseFolder, job: VerificationJob, summary: Summary, progress: Progress | None = None
) -> list[dict[str, Any]]:
    """Writes the worst drawn cases as studies to a new ``folder`` and simulates each again. Returns their rows."""
    tell, rows = progress or silent, []
    worst = worst_cases(summary)
    folder.written.mkdir()
    for k, (family, promise, case) in enumerate(worst):
        tell("worst cases", k / len(worst))
        cases, _ = job.drawn(case.number, 1)
        coordinates = uniforms_of(_seed(job), case.number, 1)[0]
        name = f"{k + 1:02d}-case-{case.number}"
        row = {"rank": k + 1, "case": case.number} | _row(folder, name, job, cases, family, promise, case, coordinates)
        rows.append(row)
    tell("worst cases", 1.0)
    return rows


def search_from_worst(
    job: VerificationJob, summary: Summary, evaluations: int, executor: Executor | None = None
) -> Callable[[Progress], Searched]:
    """Begins to search for cases that are worse than the worst that were drawn
    (:func:`vsgdesign.verification.search.begun_search`)."""
    starts = {}
    for name, family in summary.families.items():
        if family.judged:
            numbers = {case.number for one in family.promises.values() for case in one.worst[:8]}
            rows = [uniforms_of(_seed(job), number, 1)[0].tolist() for number in sorted(numbers)]
            starts[name] = starts_of(rows, UNIFORMS)
    return begun_search(job, evaluations, starts, edges=_EDGES, executor=executor)


def write_found(folder: CaseFolder, job: VerificationJob, searched: Searched) -> dict[str, Any]:
    """Writes the cases that a search has found as studies to a new ``folder`` and simulates each again. Returns the
    numbers of evaluations and the rows. None of it enters a share."""
    found = []
    if searched.found:
        folder.written.mkdir()
    for k, one in enumerate(searched.found):
        cases = job.cases_of(np.array([one.coordinates]), job.families.index(one.family))
        name = f"{k + 1:02d}-{one.family}"
        row = _row(folder, name, job, cases, one.family, one.promise, one.case, np.array(one.coordinates))
        found.append({"rank": k + 1, "case": None} | row | {"broken": list(one.broken)})
    return {"evaluations": searched.evaluations, "broken": searched.broken, "found": found}


def _seed(job: VerificationJob) -> int:
    return 0 if job.study.verification is None else job.study.verification.seed


def _row(
    folder: CaseFolder,
    name: str,
    job: VerificationJob,
    cases: LaneCases,
    family: str,
    promise: str,
    case: CaseFigures,
    coordinates: np.ndarray,
) -> dict[str, Any]:
    """One case for results.json; its study is written as ``name``.toml."""
    path = folder.written / f"{name}.toml"
    text = job.batch.written(job.study, job.spec, job.ready, cases, 0, folder.final / path.name, job.bridge)
    path.write_text(text, encoding="utf-8", newline="\n")
    again = job.batch.simulated(path, job.ready)
    figures = figures_document(case.figures)
    return {
        "family": family,
        "promise": promise,
        "status": case.status,
        "figures": figures,
        "start": start_of(job.study, cases, 0, (again.P, again.Q)),
        "end": end_of(job.study, cases, 0),
        "what": what_of(job.study, cases, 0),
        "why": _why(job, cases, promise, case, coordinates, again.decay),
        "study": f"{folder.final.name}/{path.name}",
        "simulated": dict(again.figures),
        "difference": (difference := largest_difference(figures, again.figures)),
        "agrees": None if difference is None else difference <= AGREEMENT,
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


def _why(
    job: VerificationJob, cases: LaneCases, promise: str, case: CaseFigures, coordinates: np.ndarray, decay: float
) -> str | None:
    table = job.ready.table(job.spec)
    R_g = float(cases.R_g[0] * (1.0 + cases.error_R[0]))
    L_g = float(cases.L_g[0] * (1.0 + cases.error_X[0]))
    held = next(one for one in job.promises if one.name == promise)
    return why_of(
        case.figures,
        promise,
        _drawn_over_a_range(job, coordinates),
        status=case.status,
        limited=job.study.with_limit_of(job.spec).converter.current_limit_pu is not None,
        relaxed=promise in ("overshoot", "settling") and beside_relaxed(table, job.study, R_g, L_g),
        decay=decay,
        limit=held.limit,
    )


def _drawn_over_a_range(job: VerificationJob, coordinates: np.ndarray) -> dict[str, float]:
    """The coordinates of a case, 0 to 1, whose quantity is drawn and has an edge that means something, by its name."""
    asked = job.study.verification
    if asked is None:
        return {}
    box = asked.box
    told = job.spec.kind == "scheduled" and job.spec.estimate == "truth"
    error_R, error_X, error_Z = box.errors
    ranges = {
        "scr": ("SCR", box.scr),
        "x_over_r": ("X/R", box.x_over_r),
        "P": ("P", box.P),
        "Q": ("Q", box.Q),
        "V_g": ("the voltage", box.V_g_rms),
        "f_g": ("the frequency", box.omega_g),
        "error_R": ("the error of R_g", (0.0, told * max(error_R, error_Z))),
        "error_X": ("the error of L_g", (0.0, told * max(error_X, error_Z))),
    }
    by_name = dict(zip(COORDINATES, coordinates.tolist(), strict=True))
    return {said: by_name[name] for name, (said, (low, high)) in ranges.items() if low < high}
