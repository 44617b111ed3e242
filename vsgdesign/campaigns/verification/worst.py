"""The worst cases: each as a study file, simulated again as a single run, with the reasons that are known, in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.campaigns.verification.blocks import VerificationJob
from vsgdesign.campaigns.verification.counting import FIGURES, last_grids
from vsgdesign.campaigns.verification.document import figures_document
from vsgdesign.campaigns.verification.draws import COORDINATES, UNIFORMS, uniforms_of
from vsgdesign.campaigns.verification.search import Searched, begun_search, starts_of
from vsgdesign.campaigns.verification.summary import WORST, CaseFigures, Summary
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import Study

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
        coordinates = uniforms_of(_seed(job), case.number, 1, job.batch.more)[0]
        name = f"{k + 1:02d}-case-{case.number}"
        row = {"rank": k + 1, "case": case.number} | _row(folder, name, job, cases, family, promise, case, coordinates)
        rows.append(row)
    tell("worst cases", 1.0)
    return rows


def search_from_worst(
    job: VerificationJob, summary: Summary, evaluations: int, executor: Executor | None = None
) -> Callable[[Progress], Searched]:
    """Begins to search for cases that are worse than the worst that were drawn
    (:func:`vsgdesign.campaigns.verification.search.begun_search`)."""
    starts = {}
    for name, family in summary.families.items():
        if family.judged:
            numbers = {case.number for one in family.promises.values() for case in one.worst[:8]}
            rows = [uniforms_of(_seed(job), number, 1, job.batch.more)[0].tolist() for number in sorted(numbers)]
            starts[name] = starts_of(rows, UNIFORMS + job.batch.more)
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
    share = job.batch.seen(cases)
    R_g = float(share * cases.R_g[0] * (1.0 + cases.error_R[0]))
    L_g = float(share * cases.L_g[0] * (1.0 + cases.error_X[0]))
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
    by_name = dict(zip(COORDINATES, coordinates[:UNIFORMS].tolist(), strict=True))
    return {said: by_name[name] for name, (said, (low, high)) in ranges.items() if low < high}


_EDGE = 0.02
"""A case is at the edge of what is drawn where a coordinate is this near to 0 or 1."""

_NOTICED_S = 1e-3
"""A limiter that acted for less is not named."""

_SLOW = 0.7
"""A slowest mode is named where it alone takes this share of the limit."""

_LOST = {
    "diverged": "The run diverges.",
    "slipped": "The angle slips by a turn.",
    "latched": "The controller stays in its current limit.",
    "not at rest": "It is not at rest in time.",
    "tripped": "Its protection trips.",
    "blocked": "Its bridge blocks, because the dc link leaves its limits.",
}
"""What became of a case that was not survived, by its status."""

SETTLED = math.log(1.0 / 0.02)
"""Time constants until an exponential is within 2 %."""


def start_of(study: Study, cases: LaneCases, k: int, powers: tuple[float, float] | None = None) -> dict[str, float]:
    """Where case ``k`` begins, per unit. ``powers``: P and Q at rest, W and var; without them the references."""
    c = study.converter
    P, Q = powers or (float(cases.P_ref[k]), float(cases.Q_ref[k]))
    basis = _basis(study)
    place = Grid(float(cases.R_g[k]), float(cases.L_g[k])).place(c, basis)
    return {
        "scr": place.scr,
        "x_over_r": place.x_over_r,
        "P_pu": P / c.S_rated,
        "Q_pu": Q / c.S_rated,
        "V_g_pu": float(cases.V_g_rms[k]) / c.V_rated_rms,
        "f_hz": float(cases.omega_g[k]) / (2.0 * math.pi),
        "error_R": float(cases.error_R[k]),
        "error_X": float(cases.error_X[k]),
    }


def end_of(study: Study, cases: LaneCases, k: int) -> dict[str, float]:
    """The grid on which case ``k`` comes to rest."""
    R_g, L_g = last_grids(cases.take(np.array([k])))
    place = Grid(float(R_g[0]), float(L_g[0])).place(study.converter, _basis(study))
    return {"scr": place.scr, "x_over_r": place.x_over_r}


def _basis(study: Study) -> str:
    if study.verification is not None:
        return study.verification.scr_basis
    return study.scr_basis


def what_of(study: Study, cases: LaneCases, k: int) -> str:
    """What happens in case ``k``, in words."""
    c, parts = study.converter, []
    place = Grid(float(cases.R_g[k]), float(cases.L_g[k])).place(c, _basis(study))
    references = {"P_ref": float(cases.P_ref[k]), "Q_ref": float(cases.Q_ref[k])}
    first, also = cases.besides(k)
    for event in cases.events.events(k):
        changes, values = [], {kind: kind.value(event) for kind in event.changed}
        for kind, value in values.items():
            if kind.quantity in references and value is not None:
                changes.append(f"{kind.name} changes by {(value - references[kind.quantity]) / c.S_rated:+.3g} pu")
                references[kind.quantity] = value
        if event.grid is not None:
            old, place = place, event.grid.place(c, _basis(study))
            changes.append(f"SCR changes from {old.scr:.3g} to {place.scr:.3g} (X/R {place.x_over_r:.3g})")
        if event.V_g_rms is not None:
            changes.append(f"the voltage goes to {event.V_g_rms / c.V_rated_rms:.3g} pu")
        if event.omega_g is not None:
            over = f" in {event.over:.3g} s" if event.over > 0.0 else ""
            changes.append(f"the frequency goes to {event.omega_g / (2.0 * math.pi):.5g} Hz{over}")
        if event.phase_jump != 0.0:
            changes.append(f"the phase jumps by {math.degrees(event.phase_jump):+.3g}°")
        others = (kind for kind in values if kind.of_dc or (kind.of_controller and kind.quantity not in references))
        changes += [f"{kind.words(value, c)} is set" for kind in others if (value := values[kind]) is not None]
        changes += [also] if also and not parts else []
        parts.append(f"at {event.t_s:.4g} s {_listed(changes)}")
    said = "; ".join([first, *parts] if first else parts)
    if cases.silent_s[k] > 0.0:
        said += f"; the schedule is told {cases.silent_s[k]:.3g} s later"
    return said[:1].upper() + said[1:]


def _listed(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def why_of(
    figures: tuple[float, ...],
    promise: str,
    coordinates: dict[str, float],
    *,
    status: str = "",
    limited: bool = True,
    relaxed: bool = False,
    decay: float = math.nan,
    limit: float = math.nan,
) -> str | None:
    """Why a case is bad, in a sentence for each reason that is known; None where none is.

    ``status``: of the case, where it was not survived; ``limited``: whether the controller limits its current.
    ``coordinates``: those of the case that are drawn, 0 to 1, by name. ``relaxed``: whether the gain table gives up a
    requirement there (:func:`beside_relaxed`). ``decay``: rate of the slowest mode of the linear full-order model at
    the last rest, 1/s. ``limit``: that of the promise.
    """
    by_name = dict(zip(FIGURES, figures, strict=True))
    said = []
    if status in _LOST:
        said.append(_LOST[status])
        if not limited:
            said.append(f"The controller has no current limit, and the current reaches {by_name['peak_pu']:.3g} pu.")
    if relaxed:
        said.append("A node of the table beside the estimated grid is relaxed: it gives up a requirement.")
    if by_name["limited_s"] > _NOTICED_S:
        said.append(f"The current limiter acts for {_duration(by_name['limited_s'])}.")
    if promise == "settling" and decay <= 0.0:
        said.append("The linear model is unstable at the new rest.")
    elif promise == "settling" and SETTLED / decay > _SLOW * limit:
        mode = f"The slowest mode of the linear model decays with {decay:.3g} 1/s"
        said.append(f"{mode}, for which 2 % take {SETTLED / decay:.3g} s.")
    edges = [name for name, u in coordinates.items() if min(u, 1.0 - u) < _EDGE]
    if edges:
        said.append(f"It lies at the edge of what is drawn in {_listed(edges)}.")
    return " ".join(said) or None


def _duration(seconds: float) -> str:
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{1e3 * seconds:.3g} ms"


def beside_relaxed(table: GainTable | None, study: Study, R_g: float, L_g: float) -> bool:
    """Whether a gain table gives up a requirement at one of the nodes around a grid (Ω, H)."""
    if table is None:
        return False
    place = Grid(R_g, L_g).place(study.converter, table.base.scr_basis)
    rows, columns = table.around(place.scr, place.x_over_r)
    return bool((table.status[np.ix_(rows, columns)] == "relaxed").any())
