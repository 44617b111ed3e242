"""From a study to a verification: random cases in EMT, counted with an exact bound, the worst of them as studies."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts import provenance, room_for, staged_folder, write_record, write_table_file
from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import Fault, StudyError
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.study.parameters.study import ControllerSpec, Study

if TYPE_CHECKING:  # the simulation is loaded by who verifies
    from concurrent.futures import Executor

    from vsgdesign.campaigns.verification.blocks import Shard, VerificationJob
    from vsgdesign.campaigns.verification.summary import Summary
    from vsgdesign.report.explore.page_starts import PageCase

VERB = "vsgdesign verify"
SHARD = "vsgdesign verify --shard"

SEARCH_SHARE, MOST_SEARCHED = 0.05, 50_000
"""Where nothing is said, the search makes this share of the runs in addition, and at most so many."""

WORK = "verification"
"""Names the folder beside the output that keeps finished blocks and gain tables."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What is asked of a verification. None: as the study's [verification] says."""

    controller: str | None = None
    """Name of the controller; None: the last one of the study."""
    runs: int | None = None
    seed: int | None = None
    confidence: float | None = None
    bridge: str = "averaged"
    strict: bool = False
    """Whether the loop rounds as Python does, on any instruction set."""
    search: int | None = None
    """Evaluations of the search for the worst; None: 5 % of the runs."""
    explorer: bool = True
    """Whether the page simulates in the browser, too."""


def verify_study(
    study: Study,
    out: str | Path,
    asked: Asked = Asked(),
    *,
    workers: int | None = None,
    cluster: str | None = None,
    shard: Shard | None = None,
    fresh: bool = False,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Verifies one controller of a study in random cases and writes a folder: results.json, counts.json, report.html
    and the worst cases as study files. Returns the content of results.json.

    Finished blocks are kept beside ``out`` until the folder is complete, so the same call continues after an
    interruption and writes the same counts.json; ``fresh`` starts anew. With ``shard``, the folder has the counts of
    one part alone, for :func:`merge_shards`. ``workers`` and ``cluster`` are those of
    :func:`vsgdesign.execution.executors.executor_of`. ``say`` takes a sentence where what is kept is of other work.
    Raises StudyError, ArtifactError and WorkerError.
    """
    from vsgdesign.campaigns.verification.blocks import Shard, write_counts
    from vsgdesign.execution.executors import executor_of, worker_count
    from vsgdesign.execution.journal import journal_of, run_job

    begin = time.perf_counter()
    check_verifiable(study, asked, needs_table_file=shard is not None)
    with ExitStack() as held:
        kind = VERB if shard is None else SHARD
        held.enter_context(room_for(out, kind, inputs=study.input_files))
        job, confidence = prepared_job(study, asked, out, workers=workers, progress=progress)
        ready_s = time.perf_counter() - begin
        numbers = (shard or Shard()).blocks(job)
        # The journal goes after the folder is in its place: an interruption in between loses no finished block.
        name = "" if shard is None else f"{shard.number}-{shard.of}-{job.key}"
        journal = held.enter_context(journal_of(job, out, WORK, name=name, fresh=fresh, say=say))
        folder = held.enter_context(staged_folder(out, kind, inputs=study.input_files))
        with executor_of(workers if len(numbers) > 1 else 1, cluster, reproducible=job.strict) as executor:
            summary = run_job(job, journal, blocks=numbers, executor=executor, progress=progress)
            timing = {"prepare": ready_s, "runs": time.perf_counter() - begin - ready_s}
            write_counts(folder / "counts.json", job, summary)
            about = _about(job, confidence, summary, worker_count(workers) if cluster is None else cluster)
            if shard is not None:
                about |= {"shard": str(shard), "runs": summary.drawn, "judged": summary.judged}
                return write_record(folder, about | {"timing_s": timing, "provenance": provenance()}, SHARD)
            return _concluded(folder, out, job, summary, about, confidence, asked, executor, timing, progress)


def merge_shards(
    study: Study,
    places: Iterable[str | Path],
    out: str | Path,
    asked: Asked = Asked(),
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Merges the folders that shards wrote into one verification, as if there had been no shards, and writes it.

    ``places``: folders of shards, or folders with such folders in them. Runs, seed, controller and precision are those
    of the shards. Raises ArtifactError where shards overlap, are missing, or are of another study.
    """
    from vsgdesign.campaigns.verification.blocks import (
        check_same,
        counts_files,
        merged_counts,
        read_counts,
        write_counts,
    )
    from vsgdesign.execution.executors import executor_of, worker_count

    begin = time.perf_counter()
    files = counts_files(places)
    documents = [read_counts(path) for path in files]
    check_same(files, documents)
    first = documents[0]
    asked = replace(
        asked,
        controller=first["controller"],
        runs=first["runs"],
        seed=first["seed"],
        bridge=first["bridge"],
        strict=first["strict"],
    )
    check_verifiable(study, asked, needs_table_file=True)
    with staged_folder(out, VERB, inputs=(*study.input_files, *files)) as folder:
        job, confidence = prepared_job(study, asked, out, workers=workers, progress=progress)
        summary = merged_counts(files, documents, job)
        write_counts(folder / "counts.json", job, summary)
        about = _about(job, confidence, summary, worker_count(workers)) | {"shards": len(files)}
        timing = {"prepare": time.perf_counter() - begin, "runs": 0.0}
        with executor_of(workers, reproducible=job.strict) as executor:
            return _concluded(folder, out, job, summary, about, confidence, asked, executor, timing, progress)


def with_table(study: Study, table_file: str | Path, controller: str | None = None) -> tuple[Study, str]:
    """The study with another gain table, and the name of its controller: the one of this name, or the last one that
    has a table. Raises StudyError where there is no such controller.
    """
    scheduled = [spec.name for spec in study.controllers if spec.schedule == "table"]
    name = controller or (scheduled[-1] if scheduled else None)
    if name not in scheduled:
        value = "" if name is None else f'"{name}"'
        problem = "no controller of the study has a gain table" if name is None else "has no gain table"
        advice = 'Give a study with a controller that has schedule = "table".'
        raise StudyError(study.name, [Fault("controller", value, problem, advice)])
    document = {} if study.origin is None else study.origin.document
    controllers = [
        {**table, "table": str(Path(table_file).resolve())} if table.get("name") == name else table
        for table in document.get("controllers", ())
    ]
    return study.with_changes(controllers=controllers), name


def check_verifiable(study: Study, asked: Asked, needs_table_file: bool = False) -> ControllerSpec:
    """The controller that is asked for. Raises StudyError with everything that stands against a verification."""
    wanted = study.controllers[-1].name if asked.controller is None else asked.controller
    faults = study.unknown_controllers(wanted)
    spec = None if faults else study.controller_named(wanted)
    if spec is not None and needs_table_file and spec.schedule == "table" and spec.table_file is None:
        advice = 'Build it once with vsgdesign table build, and name it: table = "FILE.json".'
        faults.append(Fault(f"controllers.{spec.name}.table", "", "every shard would design the table again", advice))
    faults += _faults_around(study, spec)
    if not study.network.plain:
        advice = "Verify a study without [network]; vsgdesign simulate runs with it."
        faults.append(Fault("network", "", "random cases have nothing but the grid at the PCC", advice))
    faults += _faults_of_plant(study, spec, asked)
    if study.grid_source.components:
        advice = "Verify a study without them."
        faults.append(Fault("grid.components", "", "random cases have a source without harmonics", advice))
    if faults or spec is None:
        raise StudyError(study.name, faults)
    return spec


def _faults_of_plant(study: Study, spec: ControllerSpec | None, asked: Asked) -> list[Fault]:
    """What random cases of a plant cannot have; of one converter, what is asked of a plant alone."""
    from vsgdesign.identification.interface import samples_itself
    from vsgdesign.verbs.pipeline.one_unit import as_unit

    faults, plant, given = [], study.plant, study.verification
    if plant is None:
        for name in ("units_apart", "more_reactance"):
            if given is not None and name in given.given:
                faults.append(Fault(f"verification.{name}", "", "the study has no plant", "Leave it out."))
        return faults
    as_unit(study, "vsgdesign verify")
    if asked.bridge == "pwm" and any(unit.dc is not None for unit in plant.units):
        problem = "a dc link that moves has an averaged bridge in a plant"
        faults.append(Fault("bridge", "pwm", problem, "Take [dc] out, or leave --bridge pwm out."))
    if spec is not None and spec.kind == "scheduled" and samples_itself(spec.estimate):
        advice = 'Give estimate = "truth" with [controllers.knowledge]; vsgdesign simulate runs it as it is.'
        problem = "random cases of a plant are told their grid, late and with errors"
        faults.append(Fault(f"controllers.{spec.name}.estimate", spec.estimate, problem, advice))
    if study.protection is not None:
        advice = "Take it out; vsgdesign simulate judges it in a plant."
        faults.append(Fault("survival.protection", "", "random cases of a plant have no protection", advice))
    if study.background is not None or study.sensors is not None:
        advice = "Take [background] and [sensors] out; vsgdesign simulate runs with them."
        faults.append(Fault("background", "", "random cases of a plant have a clean grid and exact sensors", advice))
    if given is not None and given.families["ramp"].weight:
        advice = "Leave it out; the source of a plant has no ramps."
        faults.append(Fault("verification.ramp.weight", "", "a plant has no frequency ramps", advice))
    return faults


def _faults_around(study: Study, spec: ControllerSpec | None) -> list[Fault]:
    """What around the converter leaves no rest by which a case could be judged. Steps of P_ref and Q_ref need none."""
    from vsgdesign.simulation.twin import restless

    faults, background = [], study.background
    steps_alone = spec is not None and _draws_steps_alone(study, spec)
    if study.replay is not None:
        advice = "Verify a study without [replay]; vsgdesign simulate plays it."
        faults.append(Fault("replay", "", "random cases have the grid source that they draw", advice))
    if background is not None and background.restless and not steps_alone:
        problem = "its voltage wanders or has a line of its own, so that no power is at rest after a disturbance"
        advice = f"{_STEPS_ALONE}, or set what wanders, steps and jumps to 0; vsgdesign survive measures with it."
        faults.append(Fault("background", background.level, problem, advice))
    sensors = study.sensors
    distorted = background is not None and background.distorts
    if sensors is not None and sensors.act and not distorted and not (steps_alone and restless(sensors, None, None)):
        problem = "with them a case rests beside the model, by which it is judged in an undistorted grid"
        advice = 'Verify without [sensors], or give [background], for example level = "measured" without what wanders.'
        faults.append(Fault("sensors", sensors.level, problem, advice))
    return faults


_STEPS_ALONE = "Draw steps alone ([verification.grid] weight = 0, and so for each other family)"


def _draws_steps_alone(study: Study, spec: ControllerSpec) -> bool:
    """Whether nothing but steps of P_ref and Q_ref is drawn, which are judged beside their twins."""
    from vsgdesign.campaigns.verification.draws import rests_at_limit

    if study.verification is None:
        return False
    weights = study.verification.weights(rests_at_limit(study.with_limit_of(spec)))
    return not any(weight for name, weight in weights.items() if name != "step")


def prepared_job(
    study: Study, asked: Asked, out: str | Path, *, workers: int | None = None, progress: Progress | None = None
) -> tuple[VerificationJob, float]:
    """The job of a study and the confidence of its bounds. A gain table without a file is designed first and kept
    beside ``out`` until the verification is complete."""
    from vsgdesign.execution.journal import kept_folder
    from vsgdesign.verbs.pipeline.one_unit import as_unit
    from vsgdesign.verbs.pipeline.survival import survival_tables

    name, own = check_verifiable(study, asked).name, as_unit(study, "vsgdesign verify")
    study = replace(study, controllers=own.controllers)  # whose fixed gains stay, whatever grid a case has
    spec = study.controller_named(name)
    ready = survival_tables(
        replace(own, controllers=(spec,)), kept_folder(out, WORK), workers=workers, progress=progress
    )
    return job_of(study, spec, ready, asked)


def job_of(study: Study, spec: ControllerSpec, ready: Ready, asked: Asked) -> tuple[VerificationJob, float]:
    """The job of a controller whose gain table is there, and the confidence of its bounds."""
    from vsgdesign.campaigns.verification.blocks import VerificationJob
    from vsgdesign.campaigns.verification.counting import MapAxes, verified_promises
    from vsgdesign.campaigns.verification.draws import families, verification_of
    from vsgdesign.campaigns.verification.emt import EMT
    from vsgdesign.campaigns.verification.plants import PLANTS
    from vsgdesign.simulation.lanes.telling import told_controller

    spec = told_controller(spec)
    changed = {name: value for name in ("runs", "seed", "confidence") if (value := getattr(asked, name)) is not None}
    drawn = replace(verification_of(study, spec, ready), **changed)
    study = replace(study, verification=drawn)
    steps = {name: name == "step" for name in families()}
    table = ready.table(spec)
    job = VerificationJob(
        study=study,
        spec=spec,
        tables={} if table is None else {spec.name: table},
        families=tuple(steps),
        promises=verified_promises(study, spec, ready, steps),
        axes=MapAxes(scr=drawn.scr, x_over_r=drawn.x_over_r, scr_basis=drawn.scr_basis),
        runs=drawn.runs,
        bridge=asked.bridge,
        strict=asked.strict or study.plant is not None,
        batch=EMT if study.plant is None else PLANTS,
    )
    return job, drawn.confidence


def verified_table(
    study: Study,
    spec: ControllerSpec,
    table: GainTable,
    runs: int,
    kept: Path,
    *,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> GainTable:
    """A gain table with the counts and bounds of ``runs`` random cases of its controller.

    Finished blocks are kept in the folder ``kept`` until all are done. Raises StudyError and WorkerError.
    """
    from vsgdesign.artifacts.gain_table_file import verification_record
    from vsgdesign.campaigns.verification.document import counts_document
    from vsgdesign.execution.journal import Journal, run_job

    if faults := _faults_around(study, spec):
        raise StudyError(study.name, faults)
    # A table may be built for a controller of the study that does not follow one.
    spec = replace(spec, kind="scheduled", schedule="table", gains=None, design_grid=None)
    job, confidence = job_of(study, spec, Ready(tables={spec.name: table}), Asked(runs=runs))
    journal = Journal(job, kept / f"{job.key[:24]}.jsonl")
    summary = run_job(job, journal, executor=executor, progress=progress)
    journal.forget()
    document = _about(job, confidence, summary, 1) | counts_document(job, summary, confidence)
    return replace(table, verification=verification_record(plain(document)))


def _about(job: VerificationJob, confidence: float, summary: Summary, workers: int | str) -> dict[str, Any]:
    """The head of results.json."""
    from vsgdesign.campaigns.verification.document import distributions

    verification = job.study.verification
    return {
        "study": job.study.name,
        "title": job.study.title,
        "study_hash": job.study.hash,
        "controller": job.spec.name,
        "tables": {name: table.sha256 for name, table in job.tables.items()},
        "seed": None if verification is None else verification.seed,
        "confidence": confidence,
        "distributions": distributions(job.study, job.spec, job.bridge),
        "bridge": job.bridge,
        "strict": job.strict,
        "instruction_set": ", ".join(summary.instruction_sets),
        "workers": workers,
    }


_REPLAYED = 12
"""Cases of the lists that the page replays."""


def _replayed(document: Mapping[str, Any], folder: Path, job: VerificationJob) -> list[PageCase]:
    """The first of the worst cases and of those that were found, as the page shows them."""
    from vsgdesign.report.explore.live import NOTHING
    from vsgdesign.report.explore.page_starts import PageCase, can_be_replayed
    from vsgdesign.report.verification.page import case_label
    from vsgdesign.study.parameters import load_study

    found = []
    for case in (*document["worst"], *document["search"]["found"]) if job.bridge == "averaged" else ():
        study = load_study(folder / case["study"])
        if len(found) < _REPLAYED and can_be_replayed(study):
            label, figures = case_label(case, document), case["figures"]
            words = f"{label}. {case['why']}" if case.get("why") else f"{label}."
            found.append(
                PageCase(
                    label=label,
                    study=study,
                    status=str(case["status"]),
                    words=words,
                    figures={name: figures[name] for name in NOTHING if name in figures},
                )
            )
    return found


def _concluded(
    folder: Path,
    out: str | Path,
    job: VerificationJob,
    summary: Summary,
    about: Mapping[str, Any],
    confidence: float,
    asked: Asked,
    executor: Executor | None,
    timing: dict[str, float],
    progress: Progress | None,
) -> dict[str, Any]:
    """The counts, the worst cases and the search as one folder."""
    from vsgdesign.campaigns.verification.document import counts_document
    from vsgdesign.campaigns.verification.emt import TABLE
    from vsgdesign.campaigns.verification.worst import CaseFolder, search_from_worst, write_found, write_worst
    from vsgdesign.report.verification.page import write_verification_page

    begin, evaluations = time.perf_counter(), asked.search
    if evaluations is None:
        evaluations = min(math.ceil(SEARCH_SHARE * job.runs), MOST_SEARCHED)
    for table in job.tables.values():
        write_table_file(table, folder / TABLE)
    place = Path(os.path.realpath(out))
    searching = search_from_worst(job, summary, evaluations, executor)  # other processes search in the meantime
    worst = write_worst(CaseFolder(folder / "worst", place / "worst"), job, summary, progress=progress)
    timing["worst"], begin = time.perf_counter() - begin, time.perf_counter()
    searched = write_found(CaseFolder(folder / "search", place / "search"), job, searching(progress or silent))
    if searched["evaluations"]:
        timing["search"] = time.perf_counter() - begin
    document = {
        **about,
        **counts_document(job, summary, confidence),
        "worst": worst,
        "search": searched,
        "timing_s": timing,
        "provenance": provenance(),
    }
    document = plain(document)
    own = replace(job.study, controllers=tuple(one for one in job.study.controllers if one.name == job.spec.name))
    from vsgdesign.verbs.pipeline.live_part import live_begun, waited_for  # here alone: simulate reads this module, too

    begun = nullcontext()
    if asked.explorer and job.study.plant is None:
        begun = live_begun(own, job.ready, 1, executor=executor, cases=_replayed(document, folder, job))
    with begun as live:
        write_verification_page(document, folder, None if live is None else waited_for(live, progress or silent))
    return write_record(folder, document, VERB)
