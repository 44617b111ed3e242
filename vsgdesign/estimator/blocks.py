"""Arrays that are made in blocks, by one or several processes, and kept so that an interrupted call continues."""

from __future__ import annotations

import base64
import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from vsgdesign.estimator.data_set import Arrays
from vsgdesign.execution.executors import How, executor_of, worker_count
from vsgdesign.execution.jobs import Job
from vsgdesign.execution.journal import Journal, journal_of, kept_count, run_job
from vsgdesign.execution.progress import Progress
from vsgdesign.simulation.source_stamp import source_stamp

WORK = "blocks"
"""Names the folder beside a file that keeps finished blocks."""


@dataclass(frozen=True, kw_only=True)
class ArraysJob(Job[int, dict[str, Arrays]]):
    """Arrays of many blocks: ``make(*arguments[k])`` gives those of block k."""

    what: str  # type: ignore[misc]
    """The word of the progress."""
    header: dict[str, Any]
    """Recipe, seed and converter in JSON's types: all that the arrays depend on besides the package's source."""
    make: Callable[..., Arrays]
    """A function of a module, because it goes to other processes."""
    arguments: Sequence[tuple[Any, ...]]

    @property
    def key(self) -> str:
        """Hash of the header and of the sources that make the arrays."""
        text = json.dumps(self.header | {"source_stamp": source_stamp()}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def blocks(self) -> range:
        """Numbers of all blocks."""
        return range(len(self.arguments))

    def run(self, block: int) -> dict[str, Arrays]:
        """The arrays of a block, by its number."""
        return self.call(block)()

    def call(self, block: int) -> Callable[[], dict[str, Arrays]]:
        """A block as it goes to another process: with its own arguments alone."""
        return partial(_made, str(block), self.make, self.arguments[block])

    def document(self, part: dict[str, Arrays]) -> dict[str, Any]:
        """Arrays as type, shape and bytes."""
        return {k: {name: _written(values) for name, values in arrays.items()} for k, arrays in part.items()}

    def part_of(self, document: Any) -> dict[str, Arrays]:
        """The arrays of a document. Raises ValueError, KeyError or TypeError where it has none."""
        return {k: {name: _read(values) for name, values in arrays.items()} for k, arrays in document.items()}

    def joined(self, whole: dict[str, Arrays]) -> Arrays:
        """The blocks one after another in one array each."""
        return {name: np.concatenate([whole[str(k)][name] for k in self.blocks]) for name in whole["0"]}


def _made(name: str, make: Callable[..., Arrays], arguments: tuple[Any, ...]) -> dict[str, Arrays]:
    return {name: make(*arguments)}


def _written(values: NDArray[Any]) -> list[Any]:
    return [values.dtype.str, list(values.shape), base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()]


def _read(written: Any) -> NDArray[Any]:
    kind, shape, text = written
    return np.frombuffer(base64.b64decode(text), dtype=kind).reshape(shape)


@contextmanager
def made_arrays(
    job: ArraysJob,
    out: str | Path | None,
    *,
    executor: Executor | None = None,
    progress: Progress,
    before: Callable[[], None] = lambda: None,
    **how: Unpack[How],
) -> Iterator[Arrays]:
    """The arrays of a job. Finished blocks are kept beside ``out``, and removed where the block of ``with`` ends well.

    ``executor`` replaces the workers that ``how`` asks for: one process where it does not say. ``before`` is called if
    any block is missing. Raises ArtifactError and WorkerError.
    """
    with ExitStack() as held:
        journal: Journal[dict[str, Arrays]] = Journal(job, None)
        if out is not None:
            _forget_versions_before(Path(out))
            journal = held.enter_context(journal_of(job, out, WORK, fresh=how.get("fresh", False), say=how.get("say")))
        left = len(job.left(journal.whole))
        if left:
            before()
        with ExitStack() as working:
            if executor is None and left:
                count = min(worker_count(how.get("workers", 1)), left)
                executor = working.enter_context(executor_of(count, how.get("cluster")))
            whole = run_job(job, journal, executor=executor, progress=progress)
        yield job.joined(whole)


def kept_blocks(out: str | Path) -> bool:
    """Whether finished blocks wait beside the file that is to be made of them."""
    return kept_count(out, WORK) > 0


def _forget_versions_before(out: Path) -> None:
    """Remove the folders in which versions before this one kept finished blocks."""
    for folder in out.parent.iterdir() if out.parent.is_dir() else ():
        if folder.name.startswith(f".{out.name}.") and folder.suffix == ".parts":
            shutil.rmtree(folder, ignore_errors=True)
