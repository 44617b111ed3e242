"""Data that is made in blocks, by one or several processes, and kept so that an interrupted call continues."""

from __future__ import annotations

import glob
import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import ArtifactError
from vsgdesign.estimator.data_set import content_hash, read_arrays, write_arrays
from vsgdesign.execution.processes import worker_processes
from vsgdesign.execution.progress import Progress
from vsgdesign.simulation.source_stamp import source_stamp

Arrays = dict[str, NDArray[Any]]


def made_blocks(
    parts: Parts,
    arguments: Sequence[tuple[Any, ...]],
    make: Callable[..., Arrays],
    *,
    what: str,
    executor: Executor | None,
    workers: int,
    progress: Progress,
    before: Callable[[], None] = lambda: None,
) -> Arrays:
    """The blocks of ``make`` for each of some arguments, one after another in one array each.

    Finished ones are read from ``parts``. ``before`` is called if any is missing. ``what`` is the word of the progress.
    """
    count = len(arguments)
    done: dict[int, Arrays] = {k: found for k in range(count) if (found := parts.read(k)) is not None}
    progress(what, len(done) / count)
    missing = [k for k in range(count) if k not in done]
    if missing:
        before()
    with block_maker(make, executor, min(workers, len(missing))) as submit:
        waiting = [(k, submit(*arguments[k])) for k in missing]
        for k, result in waiting:
            done[k] = result()
            parts.write(k, done[k])
            progress(what, len(done) / count)
    return {name: np.concatenate([done[k][name] for k in range(count)]) for name in done[0]}


def kept_blocks(out: str | Path) -> bool:
    """Whether finished blocks wait beside the file that is to be made of them."""
    out = Path(out)
    return any(True for _ in out.parent.glob(f"{_parts_of(out, '*')}/*.npz"))


def _parts_of(out: Path, name: str) -> str:
    """The folder beside a file with its finished blocks, as a pattern."""
    return f".{glob.escape(out.name)}.{name}.parts"


class Parts:
    """Finished blocks in a folder beside the file, of this recipe, seed, converter and code only."""

    def __init__(self, out: str | Path | None, header: dict[str, Any]) -> None:
        self._header = header | {"source_stamp": source_stamp()}
        self._out = None if out is None else Path(out)
        self._folder = None
        if self._out is not None:
            name = content_hash(self._header, {})[:16]
            self._folder = self._out.with_name(f".{self._out.name}.{name}.parts")

    def read(self, k: int) -> Arrays | None:
        """The arrays of a finished block; None if it is not there or not whole."""
        if self._folder is None or not (self._folder / f"{k}.npz").is_file():
            return None
        try:
            header, arrays = read_arrays(self._folder / f"{k}.npz")
        except ArtifactError:
            return None  # half a block is no block
        return arrays if header == self._header else None

    def write(self, k: int, arrays: Arrays) -> None:
        """Keep a finished block."""
        if self._folder is not None:
            path = self._folder / f"{k}.npz"
            path.unlink(missing_ok=True)  # a damaged block, or it would have been read
            write_arrays(path, self._header, arrays)

    def remove(self) -> None:
        """These blocks, and those that an earlier recipe or version left beside the same file."""
        if self._out is not None:
            for folder in self._out.parent.glob(_parts_of(self._out, "*")):
                shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def block_maker(
    make: Callable[..., Arrays], executor: Executor | None, workers: int
) -> Iterator[Callable[..., Callable[[], Arrays]]]:
    """Yields a function that submits the arguments of ``make``, here or to other processes, and returns a call for its
    result."""
    if executor is None and workers <= 1:
        yield lambda *arguments: lambda: make(*arguments)
        return
    if executor is not None:
        yield lambda *arguments: executor.submit(make, *arguments).result
        return
    with worker_processes(workers) as own:
        yield lambda *arguments: own.submit(make, *arguments).result
