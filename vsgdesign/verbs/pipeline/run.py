"""The whole path from a study to a folder of results."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts import (
    room_for,
    staged_folder,
    write_csv,
    write_npz,
    write_record,
    write_table_file,
)
from vsgdesign.artifacts.network_weights import write_network_weights
from vsgdesign.artifacts.proof_file import PROOF_FILE, ProofFile, proof_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.identification.interface import needs_network, samples_itself, why_no_c
from vsgdesign.simulation.estimated import EstimateLog
from vsgdesign.simulation.lanes.beforehand import told_beforehand
from vsgdesign.simulation.scenario import ScenarioResult, run_scenario
from vsgdesign.study.parameters import Study
from vsgdesign.verbs.pipeline.estimators import network_document, training_document, trains
from vsgdesign.verbs.pipeline.inner import assess_inner_loops, inner_document
from vsgdesign.verbs.pipeline.making import Made, made, nothing_to_make
from vsgdesign.verbs.pipeline.opening import check_possible
from vsgdesign.verbs.pipeline.results import results_document

if TYPE_CHECKING:
    from vsgdesign.report.drawing.figures import WrittenFigure
    from vsgdesign.report.page.live import StaticPage

    Live = Callable[[], StaticPage] | None


class Shown(NamedTuple):
    """What a run writes for a reader."""

    report: bool
    explorer: bool
    """Whether the report has a live part."""
    workers: int | None
    comtrade: str | None = None
    """Of :data:`vsgdesign.artifacts.time_series.FORMS`, if the time series are written in it, too."""


class Told(NamedTuple):
    """What a run is told beside its study."""

    left_out: Sequence[str] = ()
    """A sentence on each controller that the study has without these (:func:`what_is_there`)."""
    comtrade: str | None = None
    """As in :class:`Shown`."""
    full_order_s: float = 0.0
    """Seconds for the full-order proof of each table that is designed."""


def run_study(
    study: Study,
    out: str | Path,
    *,
    bridge: str | None = None,
    report: bool | Literal["still"] = True,
    workers: int | None = None,
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
    say: Callable[[str], None] | None = None,
    done: Callable[[ScenarioResult, dict[str, Any]], None] | None = None,
    told: Told | None = None,
) -> dict[str, Any]:
    """Simulates every controller and writes time series, results, figures and a report to ``out``.

    Gain tables that the study asks for are designed first, on ``workers`` processes (None means one per core), and its
    network is trained beside them (:func:`vsgdesign.verbs.pipeline.making.made`). With ``report`` tables are verified
    if the study's [verification] says ``with_run``; a "still" one does not simulate in the browser. All is written to
    the same folder.
    ``warn`` is called before a controller is simulated that is unstable by the full-order model, since its run
    shows no meaningful response. A design that ``out`` has already, made from the same inputs by the same program,
    is taken from there, and ``say`` is told; the files are the same. ``done`` is given the result and the content of
    results.json when the folder is in its place. Returns the content of results.json. The folder appears when
    everything is done; after an error or an interruption the old folder is unchanged. Raises the errors of
    :func:`vsgdesign.simulation.scenario.run_scenario` and ArtifactError.
    """
    tell, told = progress or silent, told or Told()
    verb = "vsgdesign run" if report else "vsgdesign simulate"
    with (
        room_for(out, verb, inputs=study.input_files),
        nullcontext(check_possible(study)),  # after the folder, before any work
        # What it keeps goes after the folder is in its place: an interruption in between loses no finished work.
        made(
            study,
            out,
            bridge=bridge,
            verify=bool(report),
            workers=workers,
            full_order_s=told.full_order_s,
            progress=progress,
            say=say,
        ) as have,
        staged_folder(out, verb, inputs=study.input_files) as folder,
        ExitStack() as held,
    ):
        shown = Shown(bool(report), report is True, workers, told.comtrade)
        live: list[Live] = []

        def complete(ready: Ready) -> Ready:
            """The live part is made beside what is simulated from now on."""
            live.append(held.enter_context(_live(study, ready, have, shown)))
            return ready

        begin, late = time.perf_counter(), have.late
        if warn is not None:
            for text in told_beforehand(study, have.ready, run=False):
                warn(text)
        result = run_scenario(
            study,
            have.ready if late else complete(have.ready),
            bridge=bridge,
            warn=warn,
            progress=lambda name, t_s: tell(f"simulate {name}", t_s / study.simulation.duration),
            late=late and (lambda: complete(late())),
        )
        have.timing_s["simulate"] = time.perf_counter() - begin
        result = replace(result, left_out=tuple(told.left_out))
        result, document = _write(result, folder, verb, have, shown, live[0], tell=tell, warn=warn)
    if done is not None:
        done(result, document)
    return document


def what_is_there(study: Study) -> tuple[Study, list[str]]:
    """The study with an averaged bridge and without the controllers whose gain table or network would have to be made,
    with a sentence on each of these. No table is verified. Raises InfeasibleStudyError if no controller is left."""
    untrained = trains(study)
    kept, left_out = [], []
    for spec in study.controllers:
        table = spec.schedule == "table" and spec.table_file is None
        if not table and not (untrained and needs_network(spec.estimate)):
            kept.append(spec)
            continue
        what = "gain table is not built" if table else "network is not trained"
        left_out.append(f"{spec.name} is left out: its {what} yet. A run without --quick does it.")
    if not kept:
        raise InfeasibleStudyError(f"there is nothing to run. {' '.join(left_out)}")
    averaged = replace(study.simulation, bridge="averaged")
    return replace(study, controllers=tuple(kept), simulation=averaged, verification=None), left_out


def write_run(
    result: ScenarioResult, out: str | Path, *, explorer: bool = True, progress: Progress | None = None
) -> dict[str, Any]:
    """Writes the folder of :func:`run_study` for a scenario that was simulated before. Raises ArtifactError."""
    verb = "vsgdesign run"
    with staged_folder(out, verb, inputs=result.study.input_files) as folder:
        have, shown = nothing_to_make(result.ready), Shown(True, explorer, None)
        with _live(result.study, result.ready, have, shown) as live:
            return _write(result, folder, verb, have, shown, live, tell=progress or silent)[1]


def _write_made(ready: Ready, folder: Path, proofs: Mapping[str, ProofFile] = MappingProxyType({})) -> None:
    for name, table in ready.tables.items():
        place = folder / f"{name}.table.json"
        write_table_file(table, place)
        if name in proofs:
            PROOF_FILE.write(proofs[name], proof_of(place))
    if ready.network is not None:
        write_network_weights(ready.network, folder / "estimator.weights.json")


def write_series(
    study: Study,
    folder: Path,
    name: str,
    series: Mapping[str, NDArray[np.float64]],
    estimates: EstimateLog | None = None,
    comtrade: str | None = None,
) -> None:
    """The time series of a controller as NAME.npz and NAME.csv, what its estimator answered as NAME.estimates.csv and,
    in the form ``comtrade`` if one is given, all series as COMTRADE: the record is about the first event."""
    write_npz(folder / f"{name}.npz", series)
    write_csv(folder / f"{name}.csv", series, study.simulation.csv_interval)
    if estimates is not None:
        write_csv(folder / f"{name}.estimates.csv", estimates.series(), 0.0)
    if comtrade is not None:
        from vsgdesign.artifacts.time_series import write_comtrade

        first = min((event.t_s for event in study.events), default=0.0)
        f_n = study.converter.omega_n / (2.0 * math.pi)
        write_comtrade(folder / name, series, comtrade, f_n=f_n, station=study.name, trigger_s=first)


def _write(
    result: ScenarioResult,
    folder: Path,
    verb: str,
    have: Made,
    shown: Shown,
    live: Live,
    *,
    tell: Progress,
    warn: Callable[[str], None] | None = None,
) -> tuple[ScenarioResult, dict[str, Any]]:
    """Time series, figures, tables with their C, page and record of a simulated scenario.

    The first two are written while the tables are verified. ``live`` waits for the live part. Returns the scenario with
    these, and the record.
    """
    study, network, trained, timing = result.study, result.ready.network, have.trained, have.timing_s
    begin = time.perf_counter()
    for done, controller in enumerate(result.controllers):
        tell("write time series", done / len(result.controllers))
        name, series = controller.spec.name, controller.series
        write_series(study, folder, name, series, controller.estimates, shown.comtrade)
    tell("write time series", 1.0)
    timing["write"] = time.perf_counter() - begin
    inner, jumps = _inner_loops(study), None
    drawn: Callable[[], list[WrittenFigure]] | None = None
    if shown.report:
        from vsgdesign.report.scenario.figures import begin_all

        begin = time.perf_counter()
        tell("draw figures", 0.0)
        drawn = begin_all(result, folder / "figures", trained, have.executor)
        jumps = _phase_jumps(study)
        timing["report"] = time.perf_counter() - begin
    result = replace(result, ready=have.verified())
    _write_made(result.ready, folder, have.proofs)
    exports = _exports(study, result.ready, folder, have.executor, warn)
    if drawn is not None:
        from vsgdesign.report.page.html import print_html
        from vsgdesign.report.scenario.page import scenario_page
        from vsgdesign.verbs.pipeline.live_part import waited_for

        begin = time.perf_counter()
        figures = drawn()
        tell("draw figures", 1.0)
        page = None if live is None else waited_for(live, tell)
        print_html(scenario_page(result, figures, trained, inner, jumps, page), folder / "report.html")
        timing["report"] += time.perf_counter() - begin
    for wait in exports:
        wait()
    document = results_document(result, timing)
    for name, sha256 in have.made_from.items():
        if sha256:
            document["controllers"][name]["table"]["made_from"] = sha256
    if jumps is not None:
        document["phase_jumps"] = jumps
    if inner is not None:
        document["inner_loops"] = inner
    if network is not None:
        document["estimator"] = network_document(network)
        if trained is not None:
            document["estimator"]["training"] = training_document(trained)
    return result, write_record(folder, document, verb)


def _live(study: Study, ready: Ready, have: Made, shown: Shown) -> AbstractContextManager[Live]:
    """Begins to make the live part of the report, where one is asked for."""
    if not (shown.report and shown.explorer):
        return nullcontext()
    from vsgdesign.verbs.pipeline.live_part import live_begun

    return live_begun(study, ready, shown.workers, executor=have.executor)


def export_tables(study: Study, ready: Ready, folder: Path, *, warn: Callable[[str], None] | None = None) -> None:
    """Writes the gain tables and the network of a study to a folder, with their C, as a run does. Raises
    ArtifactError."""
    _write_made(ready, folder)
    for wait in _exports(study, ready, folder, warn=warn):
        wait()


def _inner_loops(study: Study) -> dict[str, Any] | None:
    """What designed inner loops keep."""
    if study.inner_request is None:
        return None
    document = inner_document(assess_inner_loops(study, what_if=False, jumps=False))
    return {name: value for name, value in document.items() if name != "phase_jumps"}


def _phase_jumps(study: Study) -> dict[str, Any] | None:
    from vsgdesign.campaigns.phase_jumps import phase_jumps

    found = phase_jumps(study)
    return None if found is None else found.document()


def _exports(
    study: Study,
    ready: Ready,
    folder: Path,
    executor: Executor | None = None,
    warn: Callable[[str], None] | None = None,
) -> list[Callable[[], Any]]:
    """Begins the C of every gain table, with the network where the study has one: ready to compile, beside what it was
    made of. Returns what waits for each.

    An estimator that has no C is left out, and said: its scheduler is exported without one.
    """
    if not ready.tables:
        return []
    from vsgdesign.execution.jobs import begun
    from vsgdesign.export import export_c_files

    estimator, begin = study.estimator, []
    for spec in study.controllers:
        if spec.name not in ready.tables:
            continue
        network = estimator if needs_network(spec.estimate) else None
        missing = why_no_c(spec.name, spec.estimate)
        if missing and warn is not None:
            warn(missing)
        own, by_sample = study.with_limit_of(spec), samples_itself(spec.estimate)
        call = begun(
            executor,
            export_c_files,
            folder / f"{spec.name}.table.json",
            folder / f"{spec.name}.c",
            weights=None if network is None else folder / "estimator.weights.json",
            grid_phase=network is not None and network.grid_phase,
            limiter=own.current_limiter,
            study=own if by_sample else None,
            estimator=spec.estimate if by_sample else "none",
        )
        begin.append(call)
    return begin
