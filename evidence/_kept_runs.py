"""Many runs in worker processes whose results are kept in a file, so that an interrupted measurement goes on."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from vsgdesign.artifacts.files import package_hash
from vsgdesign.execution.executors import Progress, worker_processes
from vsgdesign.execution.jobs import Job
from vsgdesign.execution.journal import journal_at, run_job

EVIDENCE_SEED = 100_000
"""The first seed of runs that were never looked at while the estimator was tuned."""


def share() -> float:
    """The share of the runs that the environment asks for."""
    return float(os.environ.get("VSGDESIGN_FIELD_SHARE", "1"))


def first_seed() -> int:
    """The first seed of the draws: by default one that was never used to tune an estimator."""
    return int(os.environ.get("VSGDESIGN_FIELD_SEED", str(EVIDENCE_SEED)))


@dataclass(frozen=True)
class Runs(Job[str, dict[str, Any]]):
    """Tasks by their keys, each a block."""

    what: ClassVar[str] = "runs"
    function: Callable[[Any], dict[str, Any]]
    tasks: dict[str, Any]

    @property
    def key(self) -> str:
        """None of its own: those of the tasks say everything."""
        return ""

    @property
    def blocks(self) -> Sequence[str]:
        """The keys of the tasks."""
        return list(self.tasks)

    def run(self, block: str, /) -> dict[str, Any]:
        """The result of a task by its key."""
        return _run(self.function, block, self.tasks[block])

    def call(self, block: str, /) -> Callable[[], dict[str, Any]]:
        """One task alone goes to another process."""
        return partial(_run, self.function, block, self.tasks[block])


def _run(function: Callable[[Any], dict[str, Any]], key: str, task: Any) -> dict[str, Any]:
    return {key: function(task)}


def kept_runs(
    run: Callable[[Any], dict[str, Any]], tasks: Sequence[Any], path: Path, name: str, workers: int | None = None
) -> list[dict[str, Any]]:
    """``run(task)`` for every task, in the order of the tasks. Finished ones are found again in the file at ``path``.

    A result is found again only if the sources of the package and of the evidence, and the task, are the same. ``run``
    is a function of a module, and a task is told from others by its ``repr``. Progress goes to stderr under ``name``.
    """
    workers = workers or int(os.environ.get("VSGDESIGN_FIELD_WORKERS", "0")) or os.cpu_count() or 1
    stamp = f"{package_hash()} {_evidence_hash()}"
    keys = [hashlib.sha256(f"{stamp} {task!r}".encode()).hexdigest()[:32] for task in tasks]
    job = Runs(run, dict(zip(keys, tasks, strict=True)))
    pool = nullcontext() if workers == 1 else worker_processes(workers)
    with journal_at(job, path) as journal, pool as executor:
        found = run_job(job, journal, executor=executor, progress=progress(name))
    return [found[key] for key in keys]


def progress(name: str) -> Progress:
    """Shows on stderr each twentieth that is done."""
    shown = [-1]

    def show(what: str, done: float) -> None:
        if (twentieth := int(20.0 * done)) != shown[0]:
            shown[0] = twentieth
            print(f"{name}: {what} {5 * twentieth} %", file=sys.stderr, flush=True)

    return show


def _evidence_hash() -> str:
    """SHA-256 over the sources that draw, run and judge."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("_*.py")):
        if path.name.startswith(("_field", "_grid_code", "_kept")) and "summary" not in path.name:
            digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()
