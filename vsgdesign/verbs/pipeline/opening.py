"""From a study file to a study that is ready to use: inner loops that it leaves open are designed once and kept."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from vsgdesign.artifacts.inner_loops_file import (
    InnerLoopsRecord,
    KeptPromise,
    differing_fields,
    read_inner_loops_file,
    request_document,
    write_inner_loops,
)
from vsgdesign.artifacts.network_weights import read_network_weights
from vsgdesign.artifacts.ready import Ready, read_named_table, read_tables
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.errors import ArtifactError, Fault, StudyError
from vsgdesign.execution.executors import Progress
from vsgdesign.identification.interface import needs_network
from vsgdesign.metrics.met import score_met
from vsgdesign.report.drawing.quantities import plain
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.loading import base_files
from vsgdesign.study.parameters.study import InnerLoopRequest, Study

Say = Callable[[str], None]
"""Takes one sentence for the user."""


def inner_loops_file(study_file: str | Path) -> Path:
    """The file, beside a study file, in which its designed inner loops are kept."""
    path = Path(study_file)
    return path.with_name(f"{path.stem}.inner.json")


def kept_records(files: Iterable[str | Path]) -> Iterator[tuple[Path, InnerLoopsRecord]]:
    """Designed inner loops that lie beside study files, in their order. Raises ArtifactError for a damaged one."""
    for path in map(inner_loops_file, files):
        if path.exists():
            yield path, read_inner_loops_file(path)


def kept_record(request: InnerLoopRequest, files: Iterable[str | Path]) -> InnerLoopsRecord | None:
    """The record of a request that lies beside one of the files, or None."""
    wanted = request_document(request)
    return next((record for _, record in kept_records(files) if record.request == wanted), None)


@dataclass
class KeptInnerLoops:
    """Designed inner loops of one study file. They are read if they were kept, otherwise designed and kept.

    A file beside a base (or beside a packaged case) is used, too, if it was made for the same request. After a call
    ``record`` holds the record that was used, and ``file`` its path, or None if it could not be kept.
    """

    study_file: Path
    design: bool = True
    """Whether gains that were not kept are designed. Otherwise they are NaN, which is enough to check a study."""
    keep: bool = True
    """Whether gains that were designed are kept beside the study."""
    progress: Progress | None = None
    say: Say | None = None
    record: InnerLoopsRecord | None = None
    file: Path | None = None

    def __call__(self, request: InnerLoopRequest) -> tuple[InnerLoopGains, float]:
        """The gains and ω_t of a request. Raises ArtifactError if the kept file is damaged or has another origin."""
        wanted = request_document(request)
        own = inner_loops_file(self.study_file)
        stale = None
        for path, record in kept_records((self.study_file, *base_files(self.study_file))):
            if record.request == wanted:
                self.record, self.file = record, path
                return record.gains, record.omega_t
            stale = stale or (record if path == own else None)
        if not self.design:
            return InnerLoopGains(*[math.nan] * len(InnerLoopGains._fields)), math.nan
        if stale is not None:
            changes = ", ".join(differing_fields(stale.request, wanted))
            self._tell(f"The inner loops in {own} were designed for other data and are designed again: {changes}.")
        self.record = design_record(request, self.progress)
        if self.keep:
            self._keep(own)
        return self.record.gains, self.record.omega_t

    def _keep(self, path: Path) -> None:
        record = self.record
        if record is None:
            return
        try:
            write_inner_loops(record, path)
        except ArtifactError as error:
            self._tell(f"The designed inner loops could not be kept and will be designed again next time: {error}")
            return
        self.file = path
        self._tell(f"The inner loops were designed and are kept in {path} (score {plain(record.score, 3)}).")
        if not score_met(record.score):
            inner = f"vsgdesign inner {shlex.quote(str(self.study_file))}"
            self._tell(
                "The score is below 1: not every requirement of the inner loops is kept. "
                f"{inner} shows which, what limits them, and what would help."
            )

    def _tell(self, sentence: str) -> None:
        if self.say is not None:
            self.say(sentence)


def open_study(path: str | Path, *, progress: Progress | None = None, say: Say | None = None) -> Study:
    """The study of a file, with designed inner loops where it gives no gains (:func:`inner_loops_file`).

    The first opening designs them, which takes seconds; every later one reads the same gains. ``say`` takes one
    sentence about what was designed and where it is kept. Raises StudyError with every fault of the study, and
    ArtifactError where the kept file is damaged.
    """
    return load_study(path, KeptInnerLoops(Path(path), progress=progress, say=say))


def check_study(path: str | Path) -> tuple[Study, str]:
    """The study of a file without designing anything, and one sentence on its inner loops ("" where it gives gains).

    The study is not fit for a run, because gains that are not kept yet are NaN. Raises StudyError and ArtifactError.
    """
    kept = KeptInnerLoops(Path(path), design=False)
    study = load_study(path, kept)
    if study.inner_request is None:
        return study, ""
    if kept.record is None:
        return study, "The inner loops are not designed yet; the first command that needs them designs them."
    return study, f"The designed inner loops are kept in {kept.file} (score {plain(kept.record.score, 3)})."


def design_record(request: InnerLoopRequest, progress: Progress | None = None) -> InnerLoopsRecord:
    """Design inner loops for a request; about five seconds on one core, and of the units of a plant half a minute."""
    from vsgdesign.design.inner import GridBox, design_inner_loops

    design = design_inner_loops(
        request.converter,
        request.filter,
        GridBox(request.scr, request.x_over_r, request.scr_basis),
        settling_time=request.settling_time,
        seed=request.seed,
        progress=progress,
        decay_apart=request.decay_apart,
    )
    return InnerLoopsRecord(
        request=request_document(request),
        gains=design.gains,
        omega_t=design.omega_t,
        score=design.t,
        limiting=design.limiting.name,
        promises=tuple(
            KeptPromise(one.name, *(_known(v) for v in (one.value, one.target, one.scr, one.x_over_r)))
            for one in design.promises
        ),
    )


def _known(value: float) -> float | None:
    """A number as JSON has it: None where it is none (a margin of an unstable loop)."""
    return float(value) if math.isfinite(value) else None


def check_possible(study: Study) -> None:
    """Raises InfeasibleStudyError where the grid cannot carry what the study asks for, as every verb that simulates
    does before any other work (:func:`vsgdesign.simulation.scenario.checking.refuse_impossible`)."""
    from vsgdesign.simulation.scenario.checking import refuse_impossible
    from vsgdesign.simulation.timeline import build_timeline

    for one in _converters(study):
        refuse_impossible(one, build_timeline(one), Ready(tables=read_tables(one)))


def _converters(study: Study) -> tuple[Study, ...]:
    """The units of a plant, each as one converter on the grid that it sees, of equal ones the first; else the study."""
    from vsgdesign.simulation.units.timeline import plant_timeline

    plant = study.plant
    if plant is None:
        return (study,)
    units = plant_timeline(study).units
    return units[:1] if plant.equal and all(one.element is None for one in study.events) else units


def check_named_files(study: Study, source: str) -> None:
    """Opens gain tables, network weights and the recipe of a study and checks whether they fit it.

    Raises StudyError for ``source`` with every fault: a file that cannot be read or has the wrong kind, a table for
    another converter, and weights or a recipe that do not fit the windows of a controller.
    """
    faults: list[Fault] = []
    tabled = [spec for spec in study.controllers if spec.table_file is not None]
    for one in _converters(study) if tabled else ():
        for k, spec in enumerate(one.controllers):
            try:
                read_named_table(one, spec)
            except ArtifactError as error:
                faults.append(_fault(f"controllers[{k}].table", str(spec.table_file), error))
    faults += _estimator_faults(study)
    if faults:
        raise StudyError(source, faults)


def _estimator_faults(study: Study) -> list[Fault]:
    spec = study.estimator
    if spec is None:
        return []
    if spec.weights_file is None:
        return _recipe_faults(study, spec.recipe)
    field = "estimator.weights"
    try:
        weights = read_network_weights(spec.weights_file)
    except ArtifactError as error:
        return [_fault(field, spec.weights_file, error)]
    from vsgdesign.simulation.estimated import installed_weights

    faults = []
    for controller in study.controllers:
        if not needs_network(controller.estimate):
            continue
        try:
            installed_weights(study, controller, weights)
        except ArtifactError as error:
            faults.append(_fault(field, spec.weights_file, error))
    return faults


def _recipe_faults(study: Study, recipe: str) -> list[Fault]:
    from vsgdesign.estimator.recipes import WINDOW_RECIPES
    from vsgdesign.verbs.pipeline.estimators import check_fit

    try:
        made_of = WINDOW_RECIPES.load(recipe)
    except StudyError as error:
        return [
            Fault(f"estimator.recipe: {fault.field}", fault.value, fault.problem, fault.advice)
            for fault in error.faults
        ]
    if study.estimator is not None and any(needs_network(spec.estimate) for spec in study.controllers):
        try:
            check_fit(study, study.estimator, made_of)
        except StudyError as error:
            return list(error.faults)
    return []


def _fault(field: str, file: str, error: ArtifactError) -> Fault:
    """The error's text as what is wrong with the file, on one line."""
    text = " ".join(line.strip().removeprefix("- ") for line in str(error).splitlines())
    return Fault(field, f'"{file}"', text.removeprefix(f"{file}: ").removesuffix("."))
