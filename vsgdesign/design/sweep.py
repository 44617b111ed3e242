"""Design of many cells on any executor, with progress, resumption, and the same digits for any number of workers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, as_completed
from functools import partial
from pathlib import Path
from typing import Any

from vsgdesign.design.record import CellRecord, CellTask, one_thread, read_record, run_task, write_record
from vsgdesign.equations.structures import STRUCTURES, Structure
from vsgdesign.errors import WorkerError
from vsgdesign.execution.executors import LOST, Each
from vsgdesign.execution.progress import Progress, silent


def sweep(
    tasks: Sequence[CellTask], folder: Path, executor: Executor | None = None, progress: Progress | None = None
) -> list[CellRecord]:
    """The records of all tasks, in order. Cells that are in ``folder`` are not designed again, and new ones are saved
    there.

    ``executor`` is one of concurrent.futures; with None the work is done in this process. An interruption cancels tasks
    that have not begun and keeps finished cells. Raises WorkerError if a process is lost, and ArtifactError if a cell
    cannot be saved.
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
            raise WorkerError(f"workers: {LOST}") from error
        raise
    finally:
        for future in futures:
            future.cancel()


def each_of(executor: Executor | None) -> Each:
    """A ``map`` on an executor's workers, each with one thread. Without an executor it is ``map`` itself.

    Functions and arguments are sent to other processes. The ``map`` raises WorkerError if a process is lost.
    """
    if executor is None:
        return map

    def each(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        futures = [executor.submit(_with_structures, STRUCTURES.added, _alone, function, item) for item in items]
        try:
            for future in futures:
                yield future.result()
        except (BrokenExecutor, CancelledError) as error:
            raise WorkerError(f"workers: {LOST}") from error
        finally:
            for future in futures:
                future.cancel()

    return each


def begun(executor: Executor | None, function: Callable[..., Any], *arguments: Any, **named: Any) -> Callable[[], Any]:
    """Begins a call on one of an executor's workers, with one thread, and returns what waits for its result.

    The function, what it is given and what it returns go to another process and back. Without an executor the call is
    made here, when its result is asked for. What waits raises the errors of the call, and WorkerError where the worker
    is lost.
    """
    call = partial(function, *arguments, **named)
    if executor is None:
        return partial(_made_alone, call)
    future = executor.submit(_with_structures, STRUCTURES.added, _made_alone, call)

    def result() -> Any:
        try:
            return future.result()
        except (BrokenExecutor, CancelledError) as error:
            raise WorkerError(f"workers: {LOST}") from error

    return result


def _made_alone(call: Callable[[], Any]) -> Any:
    with one_thread():
        return call()


def _with_structures(structures: Iterable[Structure], function: Callable[..., Any], *arguments: Any) -> Any:
    """A fresh process knows the project's own structures alone."""
    for structure in structures:
        STRUCTURES.register(structure)
    return function(*arguments)


def _alone(function: Callable[[Any], Any], item: Any) -> Any:
    with one_thread():
        return function(item)
