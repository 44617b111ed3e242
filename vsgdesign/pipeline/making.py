"""What a run needs before and beside its simulation: gain tables with their certificates, and the network.

They take longer than the simulation, and each keeps one core busy for a part of its time only. While the tables are
designed, the network is trained. While certificates are searched for, the controllers that can do without are
simulated. While the tables are verified, the others are simulated, and files are written. What is made does not depend
on what it is made beside.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.ready import Ready
from vsgdesign.execution.executors import executor_of
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.parameters.study import Study
from vsgdesign.pipeline.table import make_tables
from vsgdesign.pipeline.training import make_network, recipe_of, trains
from vsgdesign.pipeline.verify import verified_tables

if TYPE_CHECKING:
    from vsgdesign.artifacts.certificate_record import CertificateRecord
    from vsgdesign.estimator.trained import TrainedEstimator


@dataclass(frozen=True, kw_only=True)
class Made:
    """What is made so far, and how to wait for the rest."""

    ready: Ready
    """The network, and the tables that are complete."""
    trained: TrainedEstimator | None
    """How the network was trained, if it was trained."""
    late: Callable[[], Ready] | None
    """Waits for the certificates and returns ``ready`` with every table. None: no table is missing."""
    verified: Callable[[], Ready]
    """Waits for the verification and returns all that is made. To be called after ``late``."""
    executor: Executor | None
    """Worker processes that are there anyway."""
    timing_s: dict[str, float]
    """Wall time of ``tables``, ``estimator`` and, once they are there, ``certificates`` and ``verification``. They may
    overlap."""


@contextmanager
def made(
    study: Study,
    out: str | Path,
    *,
    bridge: str | None = None,
    verify: bool = False,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Iterator[Made]:
    """Makes or reads what the study's controllers need. Finished cells of tables are kept beside ``out`` until the
    block ends well. ``verify`` asks for tables that are verified as the study's [verification] says.

    ``workers`` processes design tables (None means one per core; 1 makes everything here, one after another). They
    are there until the block ends. Raises the errors of :func:`vsgdesign.pipeline.table.make_tables` and of
    :func:`vsgdesign.pipeline.training.make_network`.
    """
    tell, timing = progress or silent, {}
    specs = [spec for spec in study.controllers if spec.schedule == "table" and spec.table_file is None]
    with ExitStack() as held:
        aside = held.enter_context(ThreadPoolExecutor(1))  # ends after the processes for which it waits
        executor = held.enter_context(executor_of(workers)) if specs else None
        network = _training(study, bridge, executor, progress=progress)
        certify: list[Callable[[], tuple[CertificateRecord | None, float]]] = []
        begin = time.perf_counter()
        if executor is not None:
            from vsgdesign.certificate.box_check import compile_ahead
            from vsgdesign.design.sweep import begun

            # One worker compiles this while the other compiles what designs need, instead of both the same.
            begun(executor, compile_ahead)
        tables = make_tables(study, out, executor=executor, workers=1, certificates=False, keep=held, progress=progress)
        if tables:
            timing["tables"] = time.perf_counter() - begin
        if specs:
            from vsgdesign.design.sweep import begun

            certify = [
                begun(executor, _certified, study.with_limit_of(spec), spec, tables[spec.name]) for spec in specs
            ]
        begin = time.perf_counter()
        weights, trained = network()
        if weights is not None:
            timing["estimator"] = time.perf_counter() - begin if trained is None else sum(trained.timing_s.values())
        names = {spec.name for spec in specs}
        ready = Ready(tables={name: one for name, one in tables.items() if name not in names}, network=weights)

        verifying: list[Callable[[], Ready]] = []

        def verify_all(ready: Ready) -> Ready:
            """Begins to verify the tables, beside what comes next if other processes can do it."""

            def verified() -> Ready:
                begin = time.perf_counter()
                found = verified_tables(study, ready.tables, out, executor=executor, workers=workers, progress=progress)
                if any(found[name] is not table for name, table in ready.tables.items()):
                    timing["verification"] = time.perf_counter() - begin
                return replace(ready, tables=found)

            if not verify:
                verifying.append(lambda: ready)
            else:
                verifying.append(verified if executor is None else aside.submit(verified).result)
            return ready

        def late() -> Ready:
            tell("certify", 0.0)
            found = [wait() for wait in certify]
            tell("certify", 1.0)
            timing["certificates"] = sum(seconds for _, seconds in found)
            done = {
                spec.name: replace(tables[spec.name], certificate=record)
                for spec, (record, _) in zip(specs, found, strict=True)
            }
            return verify_all(replace(ready, tables={name: done.get(name, tables[name]) for name in tables}))

        yield Made(
            ready=ready if specs else verify_all(ready),
            trained=trained,
            late=late if specs else None,
            verified=lambda: verifying[-1](),
            executor=executor,
            timing_s=timing,
        )


def _training(
    study: Study, bridge: str | None, executor: Executor | None, *, progress: Progress | None
) -> Callable[[], tuple[Any, Any]]:
    """Begins to train the network on one of the workers, if there are any; else when it is asked for. Returns what
    waits for the network."""
    tell = progress or silent
    if study.estimator is None or executor is None or not trains(study):
        return lambda: make_network(study, bridge=bridge, progress=progress)
    recipe_of(study, study.estimator, bridge)  # its faults are said before the work begins
    from vsgdesign.design.sweep import begun

    waits = begun(executor, make_network, study, bridge=bridge)

    def network() -> tuple[Any, Any]:
        tell("train the network", 0.0)
        found = waits()
        tell("train the network", 1.0)
        return found

    return network


def _certified(study: Study, spec: Any, table: GainTable) -> tuple[CertificateRecord | None, float]:
    """The certificate of a table, and the seconds that it took."""
    from vsgdesign.design.table import table_certificate

    begin = time.perf_counter()
    record = table_certificate(study, spec, table)
    return record, time.perf_counter() - begin
