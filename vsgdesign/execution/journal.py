"""The journal of a job: finished parts, on the disk before they count. A kill loses what was under way."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Generic

from vsgdesign.artifacts.files import LockedError, cannot_write, locked, parents_made, write_text
from vsgdesign.errors import ArtifactError
from vsgdesign.execution.executors import Progress, silent
from vsgdesign.execution.jobs import Block, Job, Part, parts_done

_LOCK, _LINES = "lock", ".jsonl"
_OF_JOBS = ("*.table.json", ".*.table.json.*", f"*{_LINES}.lock")
"""What jobs leave in a folder besides journals: gain tables that were designed for them, and locks."""
_OF_VERSIONS_BEFORE = ("*.json", ".*.json.*")
"""Finished cells of a table, each in a file of its own, as versions before this one kept them."""


class Journal(Generic[Part]):
    """Finished parts of one job in one file: a line for each part, or one line for many.

    A line is the first half of its SHA-256, how many finished things it has, and its JSON. Files that belong to the
    parts are kept in the folder :attr:`files`.
    """

    def __init__(self, job: Job[Any, Part], path: Path | None) -> None:
        """Reads what is there. What a kill left of a last line is cut off. Without a path nothing is kept."""
        self._job, self.path = job, path
        self.files = None if path is None else path.with_suffix("")
        self.whole: Part = job.nothing
        self._lines = 0
        if path is None:
            return
        for document in _documents(path):
            with suppress(ValueError, KeyError, TypeError):  # a line of a version before: it is run again
                self.whole = job.merged(self.whole, job.part_of(document))
            self._lines += 1

    def add(self, part: Part) -> None:
        """Keep one more part, whose files are there: when this returns, it is on the disk."""
        self.whole = self._job.merged(self.whole, part)
        if self.path is None:
            return
        most = self._job.most_lines
        try:
            if most is not None and self._lines >= most:
                write_text(self.path, self._line(self.whole))
                self._lines = 1
                return
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a", encoding="utf-8") as file:
                file.write(self._line(part))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise cannot_write(self.path, error) from error
        self._lines += 1

    def _line(self, part: Part) -> str:
        text = json.dumps(self._job.document(part), ensure_ascii=False, separators=(",", ":"))
        return f"{_sum(text.encode())} {self._job.count(part)} {text}\n"

    def forget(self) -> None:
        """Remove what is kept."""
        if self.path is not None and self.files is not None:
            self.path.unlink(missing_ok=True)
            shutil.rmtree(self.files, ignore_errors=True)
        self.whole, self._lines = self._job.nothing, 0


def run_job(
    job: Job[Block, Part],
    journal: Journal[Part],
    *,
    blocks: Collection[Block] | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Part:
    """The whole of a job. Blocks that the journal has are not run again, and new ones are kept there.

    ``blocks``: those of a share of the work; None: all. Without an executor the work is done in this process. Raises
    WorkerError where a worker is lost, and ArtifactError where a part cannot be kept.
    """
    tell = progress or silent
    left = [block for block in job.left(journal.whole) if blocks is None or block in blocks]
    total = max(sum(map(job.size, job.blocks if blocks is None else blocks)), 1)
    waiting = sum(map(job.size, left))
    tell(job.what, 1.0 - waiting / total)
    for block, part in parts_done(job, left, executor):
        journal.add(part)
        waiting -= job.size(block)
        tell(job.what, 1.0 - waiting / total)
    return journal.whole


def _sum(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()[:32]


def _lines(path: Path) -> Iterator[tuple[int, int, bytes]]:
    """Where each whole line of a journal ends, its count, and its JSON; up to the first that is none."""
    end = 0
    if not path.exists():
        return
    with path.open("rb") as file:
        for line in file:
            written, _, rest = line.partition(b" ")
            count, _, text = rest.removesuffix(b"\n").partition(b" ")
            if not line.endswith(b"\n") or written.decode("latin-1") != _sum(text) or not count.isdigit():
                return
            end += len(line)
            yield end, int(count), text


def _documents(path: Path) -> Iterator[Any]:
    end = 0
    for after, _, text in _lines(path):
        end = after
        yield json.loads(text)
    if path.exists() and path.stat().st_size > end:
        os.truncate(path, end)


def kept_folder(out: str | Path, work: str) -> Path:
    """The folder that keeps finished parts until the output is complete. Links are followed."""
    out = Path(os.path.realpath(out))
    return out.with_name(f".{out.name}.{work}")


def kept_count(out: str | Path, work: str) -> int:
    """How many finished things interrupted work has left beside its output, in its newest journal."""
    files = sorted(kept_folder(out, work).glob(f"*{_LINES}"), key=lambda path: path.stat().st_mtime)
    return sum(count for _, count, _ in _lines(files[-1])) if files else 0


@contextmanager
def journal_of(
    job: Job[Any, Part],
    out: str | Path,
    work: str,
    *,
    name: str = "",
    fresh: bool = False,
    say: Callable[[str], None] | None = None,
) -> Iterator[Journal[Part]]:
    """The journal of a job, of this process alone within the block. It is removed where the block ends well.

    Each job has a file of its own beside ``out``, called ``name`` or else after its key, so that another one does not
    disturb it. ``fresh`` forgets what is there of this job. ``say`` takes a sentence where what is kept belongs to
    another job. Raises the errors of :func:`work_folder`.
    """
    with work_folder(out, work) as folder:
        path = folder / f"{(name or job.key)[:24]}{_LINES}"
        if say is not None and kept_elsewhere(folder, path):
            say(begins_again(out))
        for files in folder.iterdir():  # without their journal they are of no use: it was cut off while it went
            if files.is_dir() and not files.with_suffix(_LINES).exists():
                shutil.rmtree(files, ignore_errors=True)
        journal = Journal(job, path)
        if fresh:
            journal.forget()
        yield journal
        journal.forget()


def kept_elsewhere(folder: Path, path: Path) -> bool:
    """Whether a folder keeps finished work, and none of it is in the journal at a path."""
    return not path.exists() and any(next(folder.glob(one), None) for one in (f"*{_LINES}", "[!.]*[!e].json"))


def begins_again(out: str | Path) -> str:
    """What is said where kept work belongs to another job."""
    return (
        f'The finished work that is kept beside "{out}" is of another study, of other options or of another version of '
        "vsgdesign: this work begins from its start."
    )


@contextmanager
def journal_at(job: Job[Any, Part], path: str | Path | None) -> Iterator[Journal[Part]]:
    """The journal of a job in a file that stays, of this process alone within the block; without a path none is kept.

    Raises ArtifactError where another process uses the file.
    """
    if path is None:
        yield Journal(job, None)
        return
    path = Path(path)
    with ExitStack() as held:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            held.enter_context(locked(path.with_name(path.name + ".lock")))
        except LockedError:
            raise ArtifactError(f'"{path}" is in use by another process. Wait for it, or name another.') from None
        except OSError as error:
            raise cannot_write(path, error) from error
        yield Journal(job, path)


@contextmanager
def work_folder(
    out: str | Path, work: str, *, what: str = "", own: bool = False, fresh: bool = False
) -> Iterator[Path]:
    """The folder of journals beside ``out``, of this process alone within the block; it is removed where it is empty.

    Gain tables that were designed for the output go where the block ends well, and with ``own`` everything does:
    nobody else keeps work there. ``fresh`` then begins with nothing. Raises ArtifactError where another process is at
    work on the same output, which is ``what`` ("the table of …"), or where nothing can be written.
    """
    folder = kept_folder(out, work)
    with ExitStack() as held:
        try:
            held.enter_context(parents_made(folder.parent))
            folder.mkdir(exist_ok=True)
            held.enter_context(locked(folder / _LOCK, partial(_remove_finished, folder)))
        except (LockedError, FileNotFoundError):
            what = what or f'"{out}"'
            raise ArtifactError(
                f'{what} is being made by another process, which keeps its finished work in "{folder}". Wait until it '
                "is done, or give another place."
            ) from None
        except OSError as error:
            raise cannot_write(folder, error) from error
        everything = (f"*{_LINES}", f".*{_LINES}.*", *_OF_JOBS, *_OF_VERSIONS_BEFORE)
        if fresh and own:
            _remove(folder, everything)
        yield folder
        _remove(folder, everything if own else _OF_JOBS)


def _remove_finished(folder: Path) -> None:
    """The lock goes with its folder, and while it is held: whoever comes next sees that it was another's."""
    if next(folder.glob(f"*{_LINES}"), None) is None:
        with suppress(OSError):  # something of somebody else's is in it, or, on Windows, another has the lock
            (folder / _LOCK).unlink(missing_ok=True)
            folder.rmdir()


def _remove(folder: Path, patterns: tuple[str, ...]) -> None:
    for pattern in patterns:
        for path in list(folder.glob(pattern)):
            path.unlink(missing_ok=True)
