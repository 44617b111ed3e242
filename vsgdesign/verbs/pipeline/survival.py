"""From a study to a survival measurement: every controller with every current limiter through many disturbances."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts import provenance, room_for, staged_folder, write_record
from vsgdesign.artifacts.ready import Ready
from vsgdesign.artifacts.time_series import write_table
from vsgdesign.equations.limiters import LIMITERS as KNOWN
from vsgdesign.errors import Fault, StudyError
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.identification import estimator_kind
from vsgdesign.study.parameters.event import BASIS
from vsgdesign.study.parameters.study import NO_LIMITER, ControllerSpec, Study
from vsgdesign.verbs.pipeline.live_part import live_begun, waited_for
from vsgdesign.verbs.pipeline.one_unit import as_unit

if TYPE_CHECKING:  # the simulation is loaded by who measures
    from vsgdesign.report.explore.page_starts import PageCase
    from vsgdesign.simulation.survival import CaseResult, Subject, SurvivalCase

VERB = "vsgdesign survive"
WORK = "survival"
"""Names the folder beside the output that keeps finished runs and gain tables."""

LIMITERS = (NO_LIMITER, "circular", "projection")
"""The current limiters with which each controller is measured."""

PLAIN_PHASE_DEG = 60.0
"""The current of the first 5 ms has a figure of its own for cases without larger jumps of the phase."""


def variant_name(controller: str, limiter: str | None) -> str:
    """What a controller with a limiter is called in results; None: with the limiter that the study gives it."""
    return controller if limiter is None else f"{controller}, {limiter}"


@dataclass(frozen=True)
class Asked:
    """What is asked of a measurement; ``controllers`` and ``limiters`` are those of :func:`subjects_of`."""

    controllers: Iterable[str] | None = None
    limiters: Sequence[str] | None = None
    bridge: str = "averaged"
    explorer: bool = True
    """Whether the page simulates in the browser, too."""


def report_survival(
    study: Study,
    out: str | Path,
    asked: Asked = Asked(),
    *,
    workers: int | None = None,
    cluster: str | None = None,
    fresh: bool = False,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Sends a study's controllers through all disturbances; writes report.html, results.json and cases.csv.

    Gain tables without a file are designed first.
    Finished runs and tables are kept beside ``out`` until everything is done, so the same call continues after an
    interruption; ``fresh`` starts anew. ``workers`` and ``cluster`` are those of
    :func:`vsgdesign.execution.executors.executor_of`. ``say`` takes a sentence where what is kept is of other work.
    Returns results.json. Raises StudyError, ArtifactError and WorkerError.
    """
    from vsgdesign.campaigns.survival import run_many
    from vsgdesign.execution.journal import work_folder
    from vsgdesign.report.page.html import print_html
    from vsgdesign.report.survival import survival_page

    controllers, limiters = asked.controllers, asked.limiters
    own = as_unit(study, VERB)
    study = replace(study, controllers=own.controllers)  # whose fixed gains stay, whatever grid a case has
    with (
        room_for(out, VERB, inputs=study.input_files),
        # What it keeps goes after the folder is in its place: an interruption in between loses no finished run.
        work_folder(out, WORK, own=True, fresh=fresh) as kept,
        staged_folder(out, VERB, inputs=study.input_files) as folder,
    ):
        # Its faults are said before anything is designed.
        subjects_of(study, Ready(), controllers=controllers, limiters=limiters, bridge=asked.bridge)
        names = None if controllers is None else set(controllers)
        part = replace(own, controllers=tuple(c for c in study.controllers if names is None or c.name in names))
        ready = survival_tables(part, kept, workers=workers, progress=progress)
        subjects = subjects_of(study, ready, controllers=controllers, limiters=limiters, bridge=asked.bridge)
        results = run_many(
            subjects,
            survival_cases(study),
            kept / "runs.jsonl",
            workers=workers,
            cluster=cluster,
            progress=progress,
            say=say,
        )
        write_cases(folder / "cases.csv", results)
        document = survival_document(study, subjects, results) | {"bridge": asked.bridge, "provenance": provenance()}
        cases = lost_cases(subjects, results) if study.plant is None else []
        shows = asked.explorer and study.plant is None
        with live_begun(part, ready, workers, cases=cases) if shows else nullcontext() as live:
            page = None if live is None else waited_for(live, progress or silent)
        print_html(survival_page(document, page), folder / "report.html")
        return write_record(folder, document, VERB)


_SHOWN = 12
"""Lost cases that the page replays."""


def lost_cases(subjects: Mapping[str, Subject], results: Mapping[str, Sequence[CaseResult]]) -> list[PageCase]:
    """The first lost cases that the page can replay, as it shows them."""
    from vsgdesign.report.explore.page_starts import PageCase, can_be_replayed
    from vsgdesign.report.survival import lost_label
    from vsgdesign.simulation.survival.running import study_of_case

    found = []
    for name, result in ((name, one) for name, several in results.items() for one in several):
        subject, case, verdict = subjects[name], result.case, result.verdict
        if not verdict.judged or verdict.survived or subject.bridge != "averaged" or len(found) == _SHOWN:
            continue
        study, told = study_of_case(subject, case)
        study = replace(study, controllers=(replace(subject.spec, estimate="truth"),))
        if subject.learns or not can_be_replayed(study):
            continue
        figures = {key: getattr(verdict, key) for key in ("recovery_s", "peak_pu", "first_peak_pu", "limited_s")}
        figures["swing_deg"] = None if verdict.swing_rad is None else math.degrees(verdict.swing_rad)
        found.append(
            PageCase(
                label=lost_label(name, case.group, case.name),
                study=study,
                status=verdict.status,
                words=f"{verdict.status}: {verdict.reason}",
                figures=figures,
                told=told,
                safe=subject.safe,
            )
        )
    return found


def survival_tables(
    study: Study, folder: str | Path, *, workers: int | None = None, progress: Progress | None = None
) -> Ready:
    """The gain tables of a study's controllers, as :class:`vsgdesign.artifacts.ready.Ready`.

    A table that ``folder`` has is read if it was designed from this study and has a safe place. Any other is designed
    and kept there, without its certificate, which no run needs. Raises the errors of
    :func:`vsgdesign.verbs.pipeline.study_tables.study_tables`.
    """
    from vsgdesign.verbs.pipeline.study_tables import kept_beside, study_tables

    left = kept_beside(folder)
    return study_tables(study, folder, left=left, workers=workers, certificates=False, progress=progress).ready


def subjects_of(
    study: Study,
    ready: Ready,
    *,
    controllers: Iterable[str] | None = None,
    limiters: Iterable[str] | None = LIMITERS,
    bridge: str = "averaged",
) -> dict[str, Subject]:
    """Every named controller (None: all) with every limiter (None: with its own), by :func:`variant_name`.

    Raises StudyError with every fault: no current limit, a recorded source, no controller or limiter of a name.
    """
    from vsgdesign.simulation.survival import Subject
    from vsgdesign.simulation.survival.cases import ROOM

    limit_pu = study.converter.current_limit_pu
    known = {spec.name: spec for spec in study.controllers}
    wanted = list(known if controllers is None else controllers)
    faults = _faults_of_study(study)
    if study.plant is not None:
        faults += _faults_of_plant(study, [known[name] for name in wanted if name in known], bridge)
    faults += study.unknown_controllers(*wanted)
    for limiter in limiters or ():
        if limiter != NO_LIMITER and limiter not in KNOWN:
            advice = f"There are {', '.join((NO_LIMITER, *KNOWN))}."
            faults.append(Fault("limiter", f'"{limiter}"', "unknown", advice))
    if faults or limit_pu is None:
        raise StudyError(study.name, faults)
    found = {}
    room_pu = None if study.background is None else ROOM * limit_pu
    for name in wanted:
        for limiter in (None,) if limiters is None else limiters:
            spec = known[name]
            if limiter is not None:  # that of the study has the parameters that the study gives it
                spec = replace(spec, current_limiter=None if limiter == study.current_limiter else limiter)
            found[variant_name(name, limiter)] = Subject(
                study=study, spec=spec, ready=ready, limit_pu=limit_pu, bridge=bridge, room_pu=room_pu
            )
    return found


def _faults_of_study(study: Study) -> list[Fault]:
    """What no disturbance can be measured with."""
    faults = []
    if study.converter.current_limit_pu is None:
        advice = "Set it, for example to 1.2: it decides which states of rest are asked for."
        faults.append(Fault("converter.current_limit_pu", "", "is missing", advice))
    if study.replay is not None:
        advice = "Take [replay] away; [background] makes a restless grid."
        faults.append(Fault("replay", "", "a recorded source cannot sag or jump as the disturbances ask", advice))
    if study.network.fault is not None or not study.network.connected:
        advice = "Take it away; vsgdesign simulate and comply have events for it."
        faults.append(Fault("network", "", "every disturbance begins at rest, without a fault and on the grid", advice))
    return faults


def _faults_of_plant(study: Study, specs: Sequence[ControllerSpec], bridge: str) -> list[Fault]:
    """What a measurement of a plant does not have."""
    found = []
    for name, there in (("background", study.background), ("sensors", study.sensors)):
        if there is not None:
            problem = "disturbances of a plant are measured on a clean grid, with ideal sensors"
            found.append(Fault(name, "", problem, "Take it away; vsgdesign simulate runs a plant with it."))
    for spec in specs:
        if spec.estimate != "truth":
            problem = "units of a plant are told the grid in every disturbance, late and wrong"
            found.append(Fault(f"controllers.{spec.name}.estimate", spec.estimate, problem, 'Give estimate = "truth".'))
    if bridge != "averaged":
        found.append(Fault("bridge", bridge, "disturbances of a plant have averaged bridges", "Leave --bridge out."))
    return found


def survival_cases(study: Study, *, random: bool = True) -> tuple[SurvivalCase, ...]:
    """The systematic disturbances, and the random ones that the study's [survival] asks for.

    Where a controller estimates its grid by itself, every case leaves it time to learn the grid, and has a background
    and sensors of its own if the study has any.
    """
    from vsgdesign.simulation.survival import dc_set, field_cases, fixed_set, plant_set, random_set

    drawn = random_set(study.survival.seed, study.survival.random) if random else ()
    cases = (*fixed_set(), *dc_set(study.dc), *drawn)
    if study.plant is not None:
        return tuple(plant_set(cases, len(study.plant.units)))
    learns = any(spec.estimate != "truth" and estimator_kind(spec.estimate).by_sample for spec in study.controllers)
    return tuple(field_cases(cases, study.survival.seed)) if learns else cases


def survival_document(
    study: Study, subjects: Mapping[str, Subject], results: Mapping[str, Sequence[CaseResult]]
) -> dict[str, Any]:
    """Figures of every variant, by group and over all, and every lost case with its reason, in JSON's types."""
    return {
        "study": study.name,
        "title": study.title,
        "limit_pu": study.converter.current_limit_pu,
        "seed": study.survival.seed,
        **({} if study.dc is None else {"dc_source": study.dc.source}),
        **({} if study.plant is None else {"units": len(study.plant.units)}),
        "variants": {name: _variant(subjects[name], results[name]) for name in results},
    }


def _variant(subject: Subject, results: Sequence[CaseResult]) -> dict[str, Any]:
    from vsgdesign.simulation.survival import by_group, figures_of

    def figures(chosen: Iterable[CaseResult]) -> dict[str, Any]:
        found = figures_of(chosen, T)
        return asdict(found) | {"share": found.share}

    T = subject.settling_time
    made_for = _made_for(subject)
    plain = [result for result in results if result.case.largest_phase_deg <= PLAIN_PHASE_DEG]
    return {
        "settling_time": T,
        "stale_to_1_s": figures(result for result in results if not result.case.for_ever),
        "for_ever": figures(result for result in results if result.case.for_ever),
        "phase_to_60": figures(result for result in plain if not result.case.for_ever),
        "groups": {group: figures(members) for group, members in by_group(results).items()},
        "lost": [
            {
                "group": result.case.group,
                "case": result.case.name,
                "status": result.verdict.status,
                "reason": result.verdict.reason,
                **({} if made_for is None else {"outside_table": not result.case.within(**made_for)}),
            }
            for result in results
            if result.verdict.judged and not result.verdict.survived
        ],
        **({} if made_for is None else {"table": made_for}),
        "beyond_hardware": [
            {"group": result.case.group, "case": result.case.name, "peak_pu": result.verdict.peak_pu}
            for result in sorted(results, key=lambda result: -(result.verdict.peak_pu or 0.0))
            if result.verdict.survived and result.verdict.beyond_hardware
        ],
    }


def _made_for(subject: Subject) -> dict[str, tuple[float, float]] | None:
    """SCR and X/R for which the gain table of a controller is valid; None where it has none, where the table counts SCR
    on another basis than the cases, and of a plant, whose cases count it on the rating of all units."""
    table = subject.ready.tables.get(subject.spec.name)
    if table is None or subject.study.plant is not None or table.base.scr_basis != BASIS:
        return None
    return {"scr": table.validity.scr, "x_over_r": table.validity.x_over_r}


CSV_HEADER = (
    "variant",
    "group",
    "case",
    "status",
    "recovery_s",
    "peak_pu",
    "first_5_ms_pu",
    "limited_s",
    "swing_rad",
    "reason",
)


def write_cases(path: str | Path, results: Mapping[str, Sequence[CaseResult]]) -> None:
    """Every verdict as a row of a CSV file."""

    def rows() -> Iterable[Sequence[object]]:
        for name, found in results.items():
            for result in found:
                v, case = result.verdict, result.case
                figures = (v.recovery_s, v.peak_pu, v.first_peak_pu, v.limited_s, v.swing_rad)
                yield name, case.group, case.name, v.status, *figures, v.reason

    write_table(path, CSV_HEADER, rows())
