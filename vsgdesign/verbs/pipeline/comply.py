"""From a study to a clause matrix: every test of some suites for every controller, with its evidence."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts import provenance, room_for, staged_folder, write_record, write_table_file
from vsgdesign.artifacts.files import package_hash, plain, write_text
from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import Fault, StudyError, WorkerError
from vsgdesign.execution.executors import Progress
from vsgdesign.study.parameters.study import ControllerSpec, Study
from vsgdesign.verbs.pipeline.one_unit import written_as_unit

if TYPE_CHECKING:  # the simulation is loaded by who measures
    from vsgdesign.campaigns.compliance.job import SuiteJob
    from vsgdesign.campaigns.compliance.suite import Suite
    from vsgdesign.execution.journal import Journal

VERB = "vsgdesign comply"

ALL = "all"
"""The word for every packaged suite."""

FAILING, NONE = "failing", "none"
CASES = (FAILING, ALL, NONE)
"""Of which rows study files are written."""

WORK = "compliance"
"""Names the folder beside the output that keeps finished tests."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What is asked of a bench."""

    suites: tuple[str, ...] = (ALL,)
    """Names of packaged suites, paths of files, or :data:`ALL`."""
    controllers: tuple[str, ...] = ()
    """Names of controllers; none: all of the study."""
    maps: bool = True
    """Whether survival maps of every controller are drawn, too."""
    cases: str = FAILING
    """A name of :data:`CASES`."""
    comtrade: str | None = None
    """Of :data:`vsgdesign.artifacts.time_series.FORMS`, if the series of every run are written in it, too."""
    file: str | None = None
    """The study's file as the user gave it, for the commands on the page."""


def comply_study(
    study: Study,
    out: str | Path,
    asked: Asked = Asked(),
    *,
    ready: Ready | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    fresh: bool = False,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Runs the tests of suites with the controllers of a study and writes a folder: results.json, traces/*.csv,
    cases/*.toml and the report. Returns the content of results.json.

    ``ready``: gain tables that are there; None: they are read where earlier commands left them, or designed. Finished
    blocks are kept beside ``out`` until the folder is complete, so the same call continues after an interruption and
    writes the same files; ``fresh`` starts anew. ``workers`` and ``cluster`` are those of
    :func:`vsgdesign.execution.executors.executor_of`; the workers of a cluster write traces beside ``out``, and have to
    reach it. ``say`` takes a sentence on each gain table that the study does not name, and where what is kept is of
    other work. Raises StudyError with every fault of the study, the controllers and the suites, ArtifactError and
    WorkerError.
    """
    from vsgdesign.campaigns.compliance.job import BLOCK, SuiteJob, in_order
    from vsgdesign.campaigns.compliance.maps import KINDS
    from vsgdesign.execution.executors import executor_of, give_memory_back
    from vsgdesign.execution.jobs import begun
    from vsgdesign.execution.journal import journal_of, run_job

    begin = time.perf_counter()
    suites = suites_of(asked.suites)
    units = 1 if study.plant is None else len(study.plant.units)
    study = study_for_suites(written_as_unit(study, VERB), asked.controllers, units)
    given = [path for path in asked.suites if os.path.isfile(path)]
    with ExitStack() as held:
        inputs = *study.input_files, *given
        held.enter_context(room_for(out, VERB, inputs=inputs))
        tables = _tables(study, ready, workers, progress, say)
        maps = tuple(KINDS) if asked.maps else ()
        form = asked.comtrade
        job = SuiteJob(
            study=study, tables=tables, suites=suites, folder="", block=BLOCK, maps=maps, comtrade=form, units=units
        )
        # The journal goes after the folder is in its place: an interruption in between loses no finished test.
        journal = held.enter_context(journal_of(job, out, WORK, fresh=fresh, say=say))
        folder = held.enter_context(staged_folder(out, VERB, inputs=inputs))
        job = replace(job, folder=str(journal.files))
        ready_s = time.perf_counter() - begin
        with executor_of(workers if len(job.blocks) > 2 else 1, cluster) as executor:  # others take a second to begin
            held.callback(give_memory_back)
            known = begun(executor, _known_before, job)
            run_job(job, journal, executor=executor, progress=progress)
            run_s = time.perf_counter() - begin - ready_s
            document = _document(job, journal.whole, asked, known())
            _place_traces(document["rows"], journal, folder)
            document |= {"provenance": provenance()}
            chosen = _rows_with_case(document, asked.cases)
            here = None if cluster is not None else executor  # workers elsewhere do not reach the folder
            cases = partial(begun, here, _write_cases, job, chosen, folder, os.path.realpath(out))
            _write_report(folder, document, here, cases)
        hashes = {name: found for some in in_order(journal.whole, "hashes") for name, found in some.items()}
        timing = {"prepare": ready_s, "runs": run_s, "report": time.perf_counter() - begin - ready_s - run_s}
        return write_record(folder, plain(document | {"timing_s": timing}), VERB, known=hashes)


def suites_of(names: Iterable[str]) -> tuple[Suite, ...]:
    """The suites of these names and files, each once; :data:`ALL` stands for every packaged one.

    Raises StudyError with the faults of all of them.
    """
    from vsgdesign.campaigns.compliance.reading import SUITES, suite_named

    asked = list(dict.fromkeys(one for name in names for one in (SUITES if name == ALL else (name,))))
    found, faults, sources = [], [], []
    for name in asked:
        try:
            found.append(suite_named(name))
        except StudyError as error:
            faults += error.faults
            sources.append(error.source)
    twice = sorted({one.name for one in found if sum(other.name == one.name for other in found) > 1})
    if twice:
        faults.append(Fault("suite", ", ".join(twice), "two suites have this name", "Rename one of the files."))
        sources.append("suites")
    if faults:
        raise StudyError(", ".join(dict.fromkeys(sources)), faults)
    return tuple(found)


def study_for_suites(study: Study, controllers: Sequence[str] = (), units: int = 1) -> Study:
    """The study with these controllers, or with all, in its own order. ``units``: of its plant, of which it is one.
    Raises StudyError with every reason why it cannot go through a suite."""
    faults = study.unknown_controllers(*controllers)
    for name in ("background", "sensors", "replay"):
        if getattr(study, name) is not None:
            problem = "a suite has the source and the ideal sensors that its tests say"
            advice = f"Give a study without [{name}]; vsgdesign survive measures with it."
            faults.append(Fault(name, "", problem, advice))
    if study.grid_source.components:
        problem = "a suite has the source that its tests say"
        faults.append(Fault("grid.components", "", problem, "Give a study without them."))
    if not study.network.plain:
        problem = "a suite has the load, the faults and the breaker that its tests say"
        faults.append(Fault("network", "", problem, "Give a study without [network]."))
    shared = study.estimator is None or study.estimator.probe is None or not study.estimator.probe.neighbours
    for spec in study.controllers if units > 1 and not shared else ():
        if spec.estimate != "truth" and (not controllers or spec.name in controllers):
            problem = "units with probes of their own do not move alike, as those of a suite do"
            advice = 'Give estimate = "truth", or plant.estimators = "common".'
            faults.append(Fault(f"controllers.{spec.name}.estimate", spec.estimate, problem, advice))
    if study.origin is None:
        problem = "was built from its parts and not read from a document"
        faults.append(Fault("study", "", problem, "Use vd.load."))
    if faults:
        raise StudyError(study.name, faults)
    if not controllers:
        return study
    return replace(study, controllers=tuple(spec for spec in study.controllers if spec.name in controllers))


def _tables(
    study: Study,
    ready: Ready | None,
    workers: int | None,
    progress: Progress | None,
    say: Callable[[str], None] | None,
) -> dict[str, GainTable]:
    from vsgdesign.verbs.pipeline.study_tables import kept_tables

    if ready is not None:
        return {spec.name: table for spec in study.controllers if (table := ready.table(spec)) is not None}
    return kept_tables(study, workers=workers, progress=progress, say=say).tables


@dataclass(frozen=True, kw_only=True)
class _Known:
    """What is known before anything is run."""

    links: Mapping[tuple[str, str, str], str | None]
    """To the explorer, by suite, test and controller."""
    c_hashes: Mapping[str, str | None]
    """By controller, as :func:`c_hash`."""


def _known_before(job: SuiteJob) -> _Known:
    from vsgdesign.verbs.pipeline.live_part import explorer_link

    study = job.study
    links = {
        (suite.name, test.id, spec.name): explorer_link(study, job.tables, test, spec.name)
        for suite in job.suites
        for test in suite.tests
        for spec in study.controllers
    }
    return _Known(
        links=links, c_hashes={spec.name: c_hash(study, spec, job.tables.get(spec.name)) for spec in study.controllers}
    )


def _document(job: SuiteJob, whole: dict[str, Any], asked: Asked, known: _Known) -> dict[str, Any]:
    """results.json without what differs from one run to the next."""
    from vsgdesign.campaigns.compliance.evidence import figures_of
    from vsgdesign.campaigns.compliance.job import in_order
    from vsgdesign.campaigns.compliance.rows import identity_of, limits_of, summary_of
    from vsgdesign.report.drawing.style import COLOURS

    study, rows = job.study, job.rows(whole)
    figures = figures_of(rows)
    shown = []
    for row in rows:
        key = row["suite"], row["test"]
        shown.append(row | {"explore": known.links[*key, row["controller"]], "figure": figures.get(key)})
    return {
        "study": {"name": study.name, "title": study.title, "hash": study.hash, "file": asked.file},
        "converter": identity_of(replace(study, simulation=replace(study.simulation, bridge="averaged"))),
        "suites": [_of_suite(suite) for suite in job.suites],
        "hashes": {
            "study": study.hash,
            "tables": {name: table.sha256 for name, table in job.tables.items()},
            "package": package_hash(),
            "c": known.c_hashes,
        },
        "controllers": [
            {"name": spec.name, "colour": COLOURS[k % len(COLOURS)], "settling_time_s": job.subjects[k].settling_time}
            for k, spec in enumerate(study.controllers)
        ],
        "rows": shown,
        "summary": summary_of(rows),
        "limits": limits_of(rows),
        "maps": in_order(whole, "map"),
        "notes": [*_of_plant(job), *_replaced_estimators(study), *in_order(whole, "note")],
    }


def _of_plant(job: SuiteJob) -> list[str]:
    """What a run of a plant is."""
    if job.units == 1:
        return []
    return [
        f"The plant has {job.units} equal units, and every event is at their common node or of all of them, so all "
        f"move alike: each run is that of one unit, with its transformer in L_2 and R_2, on {job.units} times the "
        "impedance of the grid, which is exact. Powers, loads and SCR are per unit of the plant, and the PCC is the "
        "common node. The verdict is that of every unit, and each row also asks that the units against each other come "
        "to rest, which such a run does not show."
    ]


def _replaced_estimators(study: Study) -> list[str]:
    """A sentence on each controller whose estimator is not run."""
    from vsgdesign.simulation.lanes.telling import told_controller

    return [
        f'{spec.name}: its estimator (estimate = "{spec.estimate}") answers once in a window and is not run here. The '
        "controller is told the true grid, and each test says how long after a change."
        for spec in study.controllers
        if told_controller(spec) != spec
    ]


def _of_suite(suite: Suite) -> dict[str, Any]:
    return {
        "name": suite.name,
        "title": suite.title,
        "about": suite.about,
        "source": vars(suite.source).copy(),
        "tests": len(suite.tests),
        "groups": list(dict.fromkeys(test.group for test in suite.tests)),
    }


def c_hash(study: Study, spec: ControllerSpec, table: GainTable | None) -> str | None:
    """The ``sha256`` of the manifest.json that ``vsgdesign export c --study`` writes for a controller; None for one
    without a gain table, which has no C."""
    from vsgdesign.export import export_c_files

    if table is None:
        return None
    own = replace(study.with_limit_of(spec), controllers=(spec,))
    estimates = spec.estimate in ("field", "field_network")
    with TemporaryDirectory() as place:
        file = Path(place) / "table.json"
        write_table_file(table, file)
        made = export_c_files(file, Path(place) / "c", study=own if estimates else None, limiter=own.current_limiter)
    return str(made.manifest["sha256"])


def _place_traces(rows: Iterable[Mapping[str, Any]], journal: Journal[Any], folder: Path) -> None:
    """The traces beside the result. They stay with the journal too, until the folder is complete. Raises WorkerError
    where one is not there."""
    kept = Path() if journal.files is None else journal.files
    lost = next((row["csv"] for row in rows if row["csv"] and not (kept / row["csv"]).is_file()), None)
    if lost is not None:
        raise WorkerError(
            f'cluster: its workers have not written "{kept / lost}" to a disk that this machine reads. Give --out in a '
            "folder that all machines of the cluster share, and --fresh."
        )
    if (kept / "traces").is_dir():
        shutil.copytree(kept / "traces", folder / "traces", copy_function=_linked)


def _linked(source: str, target: str) -> str:
    """The same file under another name where the disk can, else a copy."""
    with suppress(OSError):
        os.link(source, target)
        return target
    return shutil.copyfile(source, target)


def _rows_with_case(document: dict[str, Any], which: str) -> list[dict[str, Any]]:
    """The rows that get a study file, whose path they then say."""
    from vsgdesign.campaigns.compliance.rows import FAIL

    chosen = [
        row
        for row in document["rows"]
        if row["csv"] and (which == ALL or (which == FAILING and row["verdict"] == FAIL))
    ]
    for row in chosen:
        row["study"] = f"cases/{_case_name(row)}.toml"
    return chosen


def _case_name(row: Mapping[str, Any]) -> str:
    from vsgdesign.campaigns.compliance.evidence import slug

    return slug(row["suite"], row["test"], row["controller"])


def _write_cases(job: SuiteJob, chosen: Sequence[Mapping[str, Any]], folder: Path, place: str) -> None:
    """Study files that repeat rows with ``vsgdesign simulate``, and the gain tables that they name, in ``folder``,
    which will be at ``place``."""
    from vsgdesign.campaigns.compliance.case import case_text
    from vsgdesign.campaigns.compliance.run import closed_test

    if not chosen:
        return
    tests = {(suite.name, test.id): test for suite in job.suites for test in suite.tests}
    places = {spec.name: k for k, spec in enumerate(job.study.controllers)}
    cases = folder / "cases"
    cases.mkdir()
    for name in dict.fromkeys(row["controller"] for row in chosen):
        if name in job.tables:
            write_table_file(job.tables[name], cases / f"{name}.table.json")
    for row in chosen:
        name = _case_name(row)
        table = f"{row['controller']}.table.json" if row["controller"] in job.tables else None
        subject = job.subjects[places[row["controller"]]]
        test = closed_test(subject, tests[row["suite"], row["test"]])
        text = case_text(subject, test, name=_study_name(name), folder=Path(place) / "cases", table=table)
        write_text(cases / f"{name}.toml", text)


def _study_name(name: str) -> str:
    return name.replace(".", "_").replace("-", "_")


def _write_report(
    folder: Path, document: dict[str, Any], executor: Executor | None, beside: Callable[[], Callable[[], object]]
) -> None:
    """The page, the PDF and the figures, and what may be done ``beside`` them."""
    from vsgdesign.campaigns.compliance.evidence import EvidenceFiles
    from vsgdesign.report.compliance.figures import DRAWN_ALWAYS
    from vsgdesign.report.compliance.page import write_page

    write_page(folder, document, EvidenceFiles(folder, document["rows"], DRAWN_ALWAYS), executor, beside)
