"""What a run needs before and beside its simulation: gain tables with their certificates, and the network.

They take longer than the simulation, and each keeps one core busy for a part of its time only. While the tables are
designed, the network is trained. While certificates are searched for, the controllers that can do without are
simulated. While the tables are verified and steps are certified, the others are simulated, the live part of the report
is made, and files are written. What is made does not depend on what it is made beside.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.proof_file import ProofFile
from vsgdesign.artifacts.ready import Ready
from vsgdesign.execution.executors import Progress, executor_of, silent
from vsgdesign.execution.jobs import begun
from vsgdesign.execution.journal import work_folder
from vsgdesign.study.parameters.study import ControllerSpec, Study
from vsgdesign.verbs.pipeline.estimators import make_network, recipe_of, trains
from vsgdesign.verbs.pipeline.study_tables import left_by_run, made_from, study_tables
from vsgdesign.verbs.pipeline.verify import WORK, verified_table

if TYPE_CHECKING:
    from vsgdesign.artifacts.certificate_record import CertificateRecord
    from vsgdesign.design.table import Proved
    from vsgdesign.estimator.trained import TrainedEstimator


@dataclass(frozen=True, kw_only=True)
class Made:
    """What is made so far, and how to wait for the rest."""

    ready: Ready
    """The network, and the tables that are complete."""
    trained: TrainedEstimator | None
    """How the network was trained, if it was trained."""
    late: Callable[[], Ready] | None
    """Waits for the certificates and returns ``ready`` with every table, as a scheduler takes it: without certified
    steps. None: no table is missing."""
    verified: Callable[[], Ready]
    """Waits for certified steps and verification, and returns all that is made. To be called after ``late``."""
    executor: Executor | None
    """Worker processes that are there anyway."""
    made_from: dict[str, str]
    """What the designs of its own tables were made from (:func:`vsgdesign.verbs.pipeline.study_tables.made_from`)."""
    proofs: dict[str, ProofFile]
    """Full-order proofs of tables, by the name of the controller, once ``verified`` has returned."""
    timing_s: dict[str, float]
    """Wall time of ``tables``, ``estimator`` and, once they are there, ``certificates`` and ``verification``. They may
    overlap."""


def nothing_to_make(ready: Ready) -> Made:
    """What is there already."""
    none: dict[str, Any] = {"made_from": {}, "proofs": {}, "timing_s": {}}
    return Made(ready=ready, trained=None, late=None, verified=lambda: ready, executor=None, **none)


def make_ready(
    study: Study,
    out: str | Path | None = None,
    *,
    bridge: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Ready:
    """The gain tables and the network that a study's controllers ask for.

    Whatever the study names as a file is read. A table without a file is designed to the specification, and a network
    without a file is trained on windows with the ``bridge`` of the run (None means that of the study). ``out``,
    ``workers`` and errors are those of :func:`vsgdesign.verbs.pipeline.study_tables.study_tables` and
    :func:`vsgdesign.verbs.pipeline.estimators.make_network`.
    """
    tables = study_tables(study, out, workers=workers, progress=progress).tables
    return Ready(tables=tables, network=make_network(study, bridge=bridge, progress=progress)[0])


@contextmanager
def made(
    study: Study,
    out: str | Path,
    *,
    bridge: str | None = None,
    verify: bool = False,
    workers: int | None = None,
    full_order_s: float = 0.0,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> Iterator[Made]:
    """Makes or reads what the study's controllers need. Finished cells of tables are kept beside ``out`` until the
    block ends well. A design that ``out`` has from the same inputs is taken, and ``say`` is told. ``verify`` asks for
    tables that are verified as the study's [verification] says. ``full_order_s`` seconds are spent on the full-order
    proof of each designed table.

    ``workers`` processes design tables (None means one per core; 1 makes everything here, one after another). They
    are there until the block ends. Raises the errors of :func:`vsgdesign.verbs.pipeline.study_tables.study_tables` and
    of :func:`vsgdesign.verbs.pipeline.estimators.make_network`.
    """
    tell, timing = progress or silent, {}
    specs = [spec for spec in study.controllers if spec.schedule == "table" and spec.table_file is None]
    with ExitStack() as held:
        aside = held.enter_context(ThreadPoolExecutor(1))  # ends after the processes for which it waits
        executor = held.enter_context(executor_of(workers)) if specs else None
        network = _training(study, bridge, executor, progress=progress)
        begin = time.perf_counter()
        if executor is not None:
            from vsgdesign.design.table import compiled_ahead

            # One worker compiles this while the other compiles what designs need, instead of both the same.
            begun(executor, compiled_ahead)
        found = study_tables(
            study,
            out,
            left=left_by_run(out),
            executor=executor,
            workers=1,
            certificates=False,
            keep=held,
            progress=progress,
            say=say,
        )
        tables = dict(found.tables)
        for spec in specs:  # certificate and verification depend on more than the design
            own = {"study": study.name, "study_hash": study.hash}
            later = dict.fromkeys(("certificate", "verification", "full_order"))
            tables[spec.name] = replace(tables[spec.name], **own, **later)
        if tables:
            timing["tables"] = time.perf_counter() - begin
        certificates = _Certificates(study, specs, tables, executor, timing, tell, full_order_s)
        begin = time.perf_counter()
        weights, trained = network()
        if weights is not None:
            timing["estimator"] = time.perf_counter() - begin if trained is None else sum(trained.timing_s.values())
        first = {name: table for name, table in tables.items() if name not in certificates.names}
        ready = Ready(tables=first, network=weights)

        def verified(ready: Ready) -> Ready:
            if not verify:
                return ready
            begin = time.perf_counter()
            found = verified_tables(study, ready.tables, out, executor=executor, workers=workers, progress=progress)
            if any(found[name] is not table for name, table in ready.tables.items()):
                timing["verification"] = time.perf_counter() - begin
            return replace(ready, tables=found)

        # Beside this process, one begins as soon as the other is there.
        proved = _beside(aside if executor is not None else None, lambda: certificates.proved(ready))
        counted = _beside(aside if executor is not None else None, lambda: verified(proved()))
        yield Made(
            ready=ready,
            trained=trained,
            late=proved if specs else None,
            verified=lambda: certificates.stepped(counted()),
            executor=executor,
            made_from={spec.name: made_from(study, spec) for spec in specs},
            proofs=certificates.proofs,
            timing_s=timing,
        )


def _beside(thread: Executor | None, call: Callable[[], Ready]) -> Callable[[], Ready]:
    """Begins a call on a thread that waits for other processes, or makes it when it is first asked for. Returns what
    waits for its result."""
    return functools.cache(call) if thread is None else thread.submit(call).result


class _Certificates:
    """The certificates of tables that were just designed, and the certified steps that belong to them."""

    def __init__(
        self,
        study: Study,
        specs: Sequence[ControllerSpec],
        tables: dict[str, GainTable],
        executor: Executor | None,
        timing: dict[str, float],
        tell: Progress,
        full_order_s: float,
    ) -> None:
        """Begins with the certificates."""
        self.names = frozenset(spec.name for spec in specs)
        self._study, self._specs, self._tables = study, specs, tables
        self._executor, self._timing, self._tell = executor, timing, tell
        self._certificates = [self._begun(_proved, spec) for spec in specs]
        self._steps: dict[str, Callable[[], tuple[Any, float]]] = {}
        self._full_order_s = full_order_s
        self._full_order: dict[str, Callable[[], tuple[GainTable, ProofFile | None]]] = {}
        self.proofs: dict[str, ProofFile] = {}

    def proved(self, ready: Ready) -> Ready:
        """Waits for the certificates and begins with the steps. Returns ``ready`` with every table, as a scheduler
        takes it."""
        if not self._specs:
            return ready
        from vsgdesign.design.table import record_of

        self._tell("certify", 0.0)
        done = dict(self._tables)
        for spec, wait in zip(self._specs, self._certificates, strict=True):
            found = self._counted(wait)
            done[spec.name] = replace(self._tables[spec.name], certificate=record_of(found))
            self._steps[spec.name] = self._begun(_stepped, spec, found)
            if self._full_order_s > 0.0:
                own = self._study.with_limit_of(spec), spec, done[spec.name], self._full_order_s
                self._full_order[spec.name] = begun(self._executor, _full_ordered, *own)
        self._tell("certify", 0.5)
        return replace(ready, tables=done)

    def stepped(self, ready: Ready) -> Ready:
        """Waits for the steps and the full-order proofs. Returns ``ready`` with tables whose certificates have them."""
        whole = dict(ready.tables)
        for name, wait in self._steps.items():
            whole[name] = replace(whole[name], certificate=self._counted(wait))
            if name in self._full_order:
                found, proof = self._full_order[name]()
                whole[name] = replace(whole[name], full_order=found.full_order)
                if proof is not None:
                    self.proofs[name] = proof
            self._tell("certify", 1.0)
        return replace(ready, tables=whole)

    def _begun(self, function: Callable[..., Any], spec: ControllerSpec, *rest: Any) -> Callable[[], tuple[Any, float]]:

        study, table = self._study.with_limit_of(spec), self._tables[spec.name]
        return begun(self._executor, function, study, spec, table, *rest)

    def _counted(self, wait: Callable[[], tuple[Any, float]]) -> Any:
        found, seconds = wait()
        self._timing["certificates"] = self._timing.get("certificates", 0.0) + seconds
        return found


def verified_tables(
    study: Study,
    tables: Mapping[str, GainTable],
    out: str | Path,
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> dict[str, GainTable]:
    """The gain tables of a study's controllers, each verified in the ``with_run`` cases of its [verification].

    A table whose file says that it was verified in as many is taken as it is. Finished blocks are kept beside ``out``
    until all are done. An ``executor`` that is there is used instead of ``workers`` processes. Raises StudyError and
    WorkerError.
    """
    runs = 0 if study.verification is None else study.verification.with_run
    waiting = {
        spec.name: spec
        for spec in study.controllers
        if runs and spec.name in tables and (tables[spec.name].verification or {}).get("runs", 0) < runs
    }
    if not waiting:
        return dict(tables)
    with ExitStack() as held:
        folder = held.enter_context(work_folder(out, WORK))
        executor = executor or held.enter_context(executor_of(workers))
        return dict(tables) | {
            name: verified_table(study, spec, tables[name], runs, folder, executor=executor, progress=progress)
            for name, spec in waiting.items()
        }


def _training(
    study: Study, bridge: str | None, executor: Executor | None, *, progress: Progress | None
) -> Callable[[], tuple[Any, Any]]:
    """Begins to train the network on one of the workers, if there are any; else when it is asked for. Returns what
    waits for the network."""
    tell = progress or silent
    if study.estimator is None or executor is None or not trains(study):
        return lambda: make_network(study, bridge=bridge, progress=progress)
    recipe_of(study, study.estimator, bridge)  # its faults are said before the work begins

    waits = begun(executor, make_network, study, bridge=bridge)

    def network() -> tuple[Any, Any]:
        tell("train the network", 0.0)
        found = waits()
        tell("train the network", 1.0)
        return found

    return network


def _proved(study: Study, spec: ControllerSpec, table: GainTable) -> tuple[Proved, float]:
    """What is proved over the box of a table, and the seconds that it took."""
    from vsgdesign.design.table import proved_over_box

    begin = time.perf_counter()
    return proved_over_box(study, spec, table), time.perf_counter() - begin


def _stepped(
    study: Study, spec: ControllerSpec, table: GainTable, found: Proved
) -> tuple[CertificateRecord | None, float]:
    """The record of that with its certified steps, and the seconds that these took."""
    from vsgdesign.design.table import stepped_record

    begin = time.perf_counter()
    return stepped_record(study, spec, table, found), time.perf_counter() - begin


def _full_ordered(
    study: Study, spec: ControllerSpec, table: GainTable, seconds: float
) -> tuple[GainTable, ProofFile | None]:
    """A table with what so many seconds prove of its sampled full-order loop, and the proof."""
    from vsgdesign.verbs.pipeline.full_order import with_full_order

    return with_full_order(study, spec, table, seconds)
