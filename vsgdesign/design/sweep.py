"""Design of many cells on any executor, with progress, resumption, and the same digits for any number of workers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.files import plain
from vsgdesign.artifacts.provenance import package_hash
from vsgdesign.design.record import CellRecord, CellTask, record_document, record_of, run_task
from vsgdesign.execution.jobs import Job
from vsgdesign.execution.journal import Journal, run_job
from vsgdesign.execution.progress import Progress


@dataclass(frozen=True)
class SweepJob(Job[str, dict[str, Any]]):
    """The design of some cells. A block is the key of a cell, and so is what it gives known by."""

    tasks: dict[str, CellTask]

    what = "design cells"

    @property
    def key(self) -> str:
        """Of this version of the package: a cell has a key of its own, and one journal keeps the cells of many
        sweeps."""
        return package_hash()

    @property
    def blocks(self) -> list[str]:
        """The keys of all cells."""
        return list(self.tasks)

    def run(self, block: str) -> dict[str, Any]:
        """A designed cell."""
        return self.call(block)()

    def call(self, block: str) -> Callable[[], dict[str, Any]]:
        """The design of a cell as it goes to another process: with its own task alone."""
        return partial(_designed, block, self.tasks[block])

    def part_of(self, document: Any) -> dict[str, Any]:
        """Cells by key. Raises ValueError, KeyError or TypeError where a document has none."""
        for one in document.values():
            record_of(one)
        return document


def _designed(key: str, task: CellTask) -> dict[str, Any]:
    return {key: plain(record_document(run_task(task)))}


def cells_file(folder: Path) -> Path:
    """The journal of finished cells in a folder."""
    return folder / f"{package_hash()[:24]}.jsonl"


def sweep(
    tasks: Sequence[CellTask], folder: Path, executor: Executor | None = None, progress: Progress | None = None
) -> list[CellRecord]:
    """The records of all tasks, in order. Cells that are kept in ``folder`` are not designed again, and new ones are
    kept there.

    ``executor`` is one of concurrent.futures; with None the work is done in this process. An interruption cancels tasks
    that have not begun and keeps finished cells. Raises WorkerError if a process is lost, and ArtifactError if a cell
    cannot be kept.
    """
    keys = [task.key for task in tasks]
    job = SweepJob(dict(zip(keys, tasks, strict=True)))
    whole = run_job(job, Journal(job, cells_file(folder)), executor=executor, progress=progress)
    return [record_of(whole[key]) for key in keys]
