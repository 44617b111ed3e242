"""Many cells on any executor: progress, resumption, and the same digits whatever the number of workers."""

from __future__ import annotations

import importlib
import logging
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, as_completed
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from vsgdesign.design.evaluation import Each
from vsgdesign.design.record import CellRecord, CellTask, one_thread, read_record, run_task, write_record
from vsgdesign.equations.structures import STRUCTURES, Structure
from vsgdesign.errors import WorkerError
from vsgdesign.execution.processes import worker_processes
from vsgdesign.execution.progress import Progress, silent

_CONNECT_S = 10.0
"""How long a scheduler may take to answer."""

_LOST = (
    "a process that designed cells was lost (out of memory?). Finished cells are kept: run the same command again, "
    "with fewer workers if it happens once more."
)


def sweep(
    tasks: Sequence[CellTask], folder: Path, executor: Executor | None = None, progress: Progress | None = None
) -> list[CellRecord]:
    """Records of all tasks, in order. Cells that ``folder`` has are not done again; new ones are kept there at once.

    ``executor``: any of the concurrent.futures kind; None does the work here. An interruption cancels what has not
    begun and leaves what is finished. Raises WorkerError where a process is lost, ArtifactError where cells cannot
    be kept.
    """
    tell = progress or silent
    keys = [task.key for task in tasks]
    found = {key: record for key in keys if (record := read_record(folder, key)) is not None}
    missing = [(key, task) for key, task in zip(keys, tasks, strict=True) if key not in found]
    done = len(tasks) - len(missing)
    tell("design cells", done / max(len(tasks), 1))
    for key, record in _results(missing, executor):
        write_record(folder, key, record)
        # What is used is what was written: a resumed table is then the undisturbed one to the last digit.
        kept = read_record(folder, key)
        found[key] = record if kept is None else kept
        done += 1
        tell("design cells", done / len(tasks))
    return [found[key] for key in keys]


def _results(tasks: Sequence[tuple[str, CellTask]], executor: Executor | None) -> Iterator[tuple[str, CellRecord]]:
    if executor is None:
        for key, task in tasks:
            yield key, run_task(task)
        return
    futures = {executor.submit(_with_structures, STRUCTURES.added, run_task, task): key for key, task in tasks}
    waiting = set(futures)
    try:
        for future in as_completed(futures):
            record = future.result()
            waiting.discard(future)
            yield futures[future], record
    except (Exception, KeyboardInterrupt) as error:
        for future in waiting:  # what else is finished is not lost with the one that failed
            if future.done() and not future.cancelled() and future.exception() is None:
                yield futures[future], future.result()
        if isinstance(error, BrokenExecutor | CancelledError):
            raise WorkerError(f"workers: {_LOST}") from error
        raise
    finally:
        for future in futures:
            future.cancel()


def each_of(executor: Executor | None) -> Each:
    """``map`` on an executor's workers, each with one thread; without one it is ``map`` itself.

    Functions and arguments go to other processes. Raises WorkerError where one is lost.
    """
    if executor is None:
        return map

    def each(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        futures = [executor.submit(_with_structures, STRUCTURES.added, _alone, function, item) for item in items]
        try:
            for future in futures:
                yield future.result()
        except (BrokenExecutor, CancelledError) as error:
            raise WorkerError(f"workers: {_LOST}") from error
        finally:
            for future in futures:
                future.cancel()

    return each


def _with_structures(structures: Iterable[Structure], function: Callable[..., Any], *arguments: Any) -> Any:
    """A fresh process knows the project's own structures alone."""
    for structure in structures:
        STRUCTURES.register(structure)
    return function(*arguments)


def _alone(function: Callable[[Any], Any], item: Any) -> Any:
    with one_thread():
        return function(item)


@contextmanager
def executor_of(workers: int | None = None, cluster: str | None = None) -> Iterator[Executor | None]:
    """Local processes (None: one per core; 1: no other process), or a Dask cluster.

    ``cluster``: ``local`` starts one here, anything else is the address of a scheduler. It needs the extra
    ``cluster``. Raises WorkerError where that is not installed or cannot be reached.
    """
    if cluster is not None:
        with _dask(cluster, workers) as executor:
            yield executor
        return
    count = (os.cpu_count() or 1) if workers is None else workers
    if count == 1:
        yield None
        return
    with worker_processes(count) as pool:
        yield pool


@contextmanager
def _dask(cluster: str, workers: int | None) -> Iterator[Executor]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise WorkerError(
            'cluster: the package distributed is missing. Install it with: pip install "vsgdesign[cluster]"'
        ) from error
    with ExitStack() as stack:
        address: Any = cluster
        if cluster == "local":
            count = (os.cpu_count() or 1) if workers is None else workers
            address = distributed.LocalCluster(
                n_workers=count, threads_per_worker=1, dashboard_address=None, silence_logs=logging.CRITICAL
            )
            stack.enter_context(address)
        try:
            client = stack.enter_context(distributed.Client(address, timeout=_CONNECT_S))
        except (OSError, ValueError) as error:
            raise WorkerError(
                f'cluster = "{cluster}": no scheduler answers. Give "local" or an address such as tcp://host:8786.'
            ) from error
        try:
            yield client.get_executor(pure=False)
        except (distributed.KilledWorker, distributed.CommClosedError) as error:
            raise WorkerError(f'cluster = "{cluster}": {_LOST}') from error
