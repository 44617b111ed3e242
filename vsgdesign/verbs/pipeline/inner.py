"""Assessment of a study's inner loops over its grids, for designed and for given gains."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts import provenance, staged_folder, write_record
from vsgdesign.artifacts.time_series import write_table
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.metrics.met import score_met
from vsgdesign.study.parameters.specification import settled_decay
from vsgdesign.study.parameters.study import InnerLoopRequest, Study
from vsgdesign.verbs.pipeline.one_unit import as_unit

if TYPE_CHECKING:  # the compiled scores are loaded by who asks for them
    from vsgdesign.campaigns.phase_jumps import PhaseJumps
    from vsgdesign.design.inner import Alternative, FullOrderCheck, InnerScore, PassiveBand, PromiseReached

VERB = "vsgdesign inner"


@dataclass(frozen=True)
class InnerAssessment:
    """The inner loops of a study on a lattice over its grids."""

    study: Study
    request: InnerLoopRequest
    """The request for which they were designed, or for given gains the request for which they would be designed."""
    score: InnerScore
    full_order: FullOrderCheck
    resonance_hz: float
    """Highest resonance of filter and grid in the box."""
    passive: PassiveBand
    """Where the output admittance is passive."""
    alternatives: tuple[Alternative, ...] | None
    """The improvement by another sampling, delay or L_2. None if it was not asked for."""
    apart: tuple[PromiseReached, ...] = ()
    """What is kept between the units of a plant, of which the study is one."""
    jumps: PhaseJumps | None = None
    """The current after phase jumps; None where no controller limits it, or if it was not asked for."""

    @property
    def designed(self) -> bool:
        """Whether the gains were designed; else the study gives them."""
        return self.study.inner_request is not None

    @property
    def kept(self) -> bool:
        """Whether every promise is kept on every grid and the full order is stable wherever it was analysed."""
        return score_met(self.t) and self.full_order.passed

    @property
    def promises(self) -> tuple[PromiseReached, ...]:
        """All of them."""
        return (*self.score.promises, *self.apart)

    @property
    def t(self) -> float:
        """The worst score over promises and grids."""
        return min(self.score.t, *(one.score for one in self.apart), math.inf)

    @property
    def limiting(self) -> PromiseReached:
        """The promise that t is the score of."""
        return next((one for one in self.apart if one.score == self.t), self.score.limiting)


def assess_inner_loops(
    study: Study,
    *,
    what_if: bool = True,
    jumps: bool = True,
    remedies: bool = False,
    progress: Progress | None = None,
) -> InnerAssessment:
    """Scores the study's inner gains on the grids that they serve; with ``what_if`` also alternatives that may be
    better, with ``jumps`` also the current after phase jumps. ``remedies``: as in
    :func:`vsgdesign.campaigns.phase_jumps.phase_jumps`.

    The grids are those of the study's request. For given gains they are those of its specification, or SCR 1.2 to 20
    and X/R 0.3 to 20 without one. A plant of equal units is one of them, with its transformer in L_2 and R_2, and then
    its units against each other are judged, too. This takes about one second, and some seconds more for each
    alternative. Raises InfeasibleStudyError for any other plant.
    """
    from vsgdesign.campaigns.phase_jumps import phase_jumps
    from vsgdesign.design.inner import (
        GridBox,
        check_apart,
        check_full_order,
        passive_band,
        score_inner_loops,
        what_would_help,
    )
    from vsgdesign.design.inner.grids import asked_of, highest_resonance

    tell, several = progress or silent, study.plant is not None and len(study.plant.units) > 1
    study = as_unit(study, VERB)
    request = asked_of(study)
    converter, filter_, T = study.converter, study.filter, request.settling_time
    box = GridBox(request.scr, request.x_over_r, request.scr_basis)
    judged = converter, filter_, study.inner_gains, study.omega_t, box
    tell("score the inner loops", 0.0)
    score = score_inner_loops(*judged, settling_time=T)
    check = check_full_order(*judged, settling_time=T)
    passive = passive_band(*judged, settling_time=T)
    spec, apart = study.specification, ()
    decay = (0.0 if spec is None else spec.differential_decay) or several * settled_decay(T)
    if decay > 0.0:
        apart = check_apart(*judged, decay=decay)
    tell("score the inner loops", 1.0)
    found = phase_jumps(study, remedies=remedies, progress=progress) if jumps else None
    alternatives = None
    if what_if:
        alternatives = tuple(
            what_would_help(
                converter,
                filter_,
                box,
                study.inner_gains,
                study.omega_t,
                settling_time=T,
                seed=request.seed,
                progress=progress,
                decay_apart=decay,
            )
        )
    resonance_hz = highest_resonance(converter, filter_, box) / (2.0 * math.pi)
    return InnerAssessment(study, request, score, check, resonance_hz, passive, alternatives, apart, found)


def report_inner_loops(
    study: Study, out: str | Path, *, what_if: bool = True, remedies: bool = False, progress: Progress | None = None
) -> InnerAssessment:
    """Assesses the inner loops and writes results.json, inner.csv, figures and report.html to ``out``.

    The folder appears when everything is done. Raises ArtifactError.
    """
    from vsgdesign.report.drawing.figures import write_all
    from vsgdesign.report.page.html import print_html
    from vsgdesign.report.stability.inner import inner_figures, inner_page

    tell = progress or silent
    with staged_folder(out, VERB, inputs=study.input_files) as folder:
        found = assess_inner_loops(study, what_if=what_if, remedies=remedies, progress=progress)
        tell("draw figures", 0.0)
        figures = write_all(inner_figures(found.score), folder / "figures")
        tell("draw figures", 1.0)
        document = inner_document(found)
        print_html(inner_page(document, figures), folder / "report.html")
        write_table(folder / "inner.csv", *_rows(found))
        write_record(folder, document | {"provenance": provenance()}, VERB)
    return found


def inner_document(found: InnerAssessment) -> dict[str, Any]:
    """Everything that was found, in JSON's types."""
    study, score, check = found.study, found.score, found.full_order
    return {
        "study": {"name": study.name, "title": study.title, "hash": study.hash},
        "designed": found.designed,
        "request": {
            "scr": found.request.scr,
            "x_over_r": found.request.x_over_r,
            "scr_basis": found.request.scr_basis,
            "settling_time": found.request.settling_time,
            "seed": found.request.seed,
        },
        "gains": {**study.inner_gains._asdict(), "omega_t": study.omega_t},
        "kept": found.kept,
        "score": found.t,
        "limiting": asdict(found.limiting),
        "promises": [asdict(promise) for promise in found.promises],
        "grids": {"stable": int(score.stable.sum()), "of": int(score.stable.size)},
        "full_order": asdict(check),
        "sampling": {
            "rate_hz": 1.0 / study.converter.T_s,
            "highest_resonance_hz": found.resonance_hz,
            "ratio": 1.0 / (study.converter.T_s * found.resonance_hz),
        },
        "passivity": asdict(found.passive) | {"warns": found.passive.warns},
        "phase_jumps": None if found.jumps is None else found.jumps.document(),
        "map": {"scr": score.scr, "x_over_r": score.x_over_r, "score": score.t_map.tolist()},
        "alternatives": None
        if found.alternatives is None
        else [
            {
                "name": one.name,
                "change": one.change,
                "score": one.t,
                "kept": one.kept,
                "limiting": asdict(one.limiting),
                "sampling_ratio": one.sampling_ratio,
            }
            for one in found.alternatives
        ],
    }


def _rows(found: InnerAssessment) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
    score = found.score
    header = (
        "SCR",
        "X/R",
        "score",
        "damping_inner_loops",
        "decay [1/s]",
        "disk_margin_bridge",
        "all-sensor margin",
        "noise gain",
        "damping_inner_loops, L_1 and C off",
    )
    rows: list[tuple[object, ...]] = [
        (scr, x_over_r, float(score.t_map[i, j]), *(float(values[i, j]) for values in score.maps))
        for i, scr in enumerate(score.scr)
        for j, x_over_r in enumerate(score.x_over_r)
    ]
    return header, rows
