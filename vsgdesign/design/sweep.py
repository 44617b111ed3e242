"""Many cells on any executor: progress, resumption, and the same digits whatever the number of workers."""

from __future__ import annotations

import importlib
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.progress import Progress, silent
from vsgdesign.design.record import CellRecord, CellTask, read_record, run_task, write_record
from vsgdesign.errors import InfeasibleStudyError


def sweep(
    tasks: Sequence[CellTask], folder: Path, executor: Executor | None = None, progress: Progress | None = None
) -> list[CellRecord]:
    """Records of all tasks, in order. Cells that ``folder`` has are not done again; new ones are kept there at once.

    ``executor``: any of the concurrent.futures kind; None does the work here. An interruption cancels what has not
    begun and leaves what is finished.
    """
    tell = progress or silent
    folder.mkdir(parents=True, exist_ok=True)
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
    futures = {executor.submit(run_task, task): key for key, task in tasks}
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BaseException:
        for future in futures:
            future.cancel()
        raise


@contextmanager
def executor_of(workers: int | None = None, cluster: str | None = None) -> Iterator[Executor | None]:
    """Local processes (None: one per core; 1: no other process), or a Dask cluster.

    ``cluster``: ``local`` starts one here, anything else is the address of a scheduler. It needs the extra
    ``cluster``. Raises InfeasibleStudyError where that is not installed or cannot be reached.
    """
    if cluster is not None:
        with _dask(cluster, workers) as executor:
            yield executor
        return
    count = (os.cpu_count() or 1) if workers is None else workers
    if count == 1:
        yield None
        return
    # Fresh processes: a forked copy of one with threads (a progress bar, BLAS) can hang.
    with ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


@contextmanager
def _dask(cluster: str, workers: int | None) -> Iterator[Executor]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise InfeasibleStudyError(
            'cluster: the package distributed is missing. Install it with: pip install "vsgdesign[cluster]"'
        ) from error
    local = None
    try:
        if cluster == "local":
            local = distributed.LocalCluster(
                n_workers=workers or os.cpu_count() or 1, threads_per_worker=1, dashboard_address=None
            )
        client = distributed.Client(local or cluster, timeout="10s")
    except OSError as error:
        raise InfeasibleStudyError(f'cluster = "{cluster}": no scheduler answers there. Check the address.') from error
    try:
        yield client.get_executor(pure=False)
    finally:
        client.close()
        if local is not None:
            local.close()
