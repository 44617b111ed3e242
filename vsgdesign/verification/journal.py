"""The journal of a verification: finished blocks, on the disk before they count. A kill loses what was under way."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from vsgdesign.artifacts.files import write_text
from vsgdesign.artifacts.locks import LockedError, locked
from vsgdesign.artifacts.staging import cannot_write, parents_made
from vsgdesign.errors import ArtifactError
from vsgdesign.verification.summary import Summary, summary_document, summary_of

T = TypeVar("T")

_LOCK = "lock"
_LINES = 64
"""After so many lines the journal is written anew as one, so that it stays small."""


def journal_folder(out: str | Path, work: str = "verification") -> Path:
    """The folder that keeps finished blocks until the output is complete. Links are followed."""
    out = Path(os.path.realpath(out))
    return out.with_name(f".{out.name}.{work}")


def kept_runs(out: str | Path) -> int:
    """How many finished runs an interrupted verification has left beside its output."""
    files = sorted(journal_folder(out).glob("*.jsonl"), key=lambda path: path.stat().st_mtime)
    return Journal(files[-1]).summary.drawn if files else 0


class Journal:
    """Finished blocks of one job in one file: a line each, or one line for many."""

    def __init__(self, path: Path) -> None:
        """Reads what is there. What a kill left of a last line is cut off."""
        self.path = path
        self.summary = Summary()
        self._lines = 0
        for found in kept_lines(path, summary_of):
            self.summary = self.summary.merged(found)
            self._lines += 1

    def add(self, summary: Summary) -> None:
        """Keep the summary of some more blocks: when this returns, it is on the disk."""
        self.summary = self.summary.merged(summary)
        try:
            if self._lines >= _LINES:
                write_text(self.path, _line(self.summary))
                self._lines = 1
                return
        except OSError as error:
            raise cannot_write(self.path, error) from error
        append_line(self.path, _line(summary))
        self._lines += 1


def _line(summary: Summary) -> str:
    return json.dumps(summary_document(summary), allow_nan=False, separators=(",", ":")) + "\n"


def kept_lines(path: Path, parse: Callable[[Any], T]) -> list[T]:
    """What ``parse`` makes of the JSON of each line of a journal; nothing if there is no such file.

    A kill may leave half a line. From the first line on that has no end, or of which ``parse`` makes a ValueError, a
    KeyError or a TypeError, the file is cut off.
    """
    found: list[T] = []
    if not path.exists():
        return found
    good = 0
    with path.open("rb") as file:
        for line in file:
            if not line.endswith(b"\n"):
                break
            try:
                found.append(parse(json.loads(line)))
            except (ValueError, KeyError, TypeError):
                break
            good += len(line)
    if path.stat().st_size > good:
        os.truncate(path, good)
    return found


def append_line(path: Path, line: str) -> None:
    """Add a line to a journal: when this returns, it is on the disk. Raises ArtifactError if it cannot be written."""
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise cannot_write(path, error) from error


@contextmanager
def journal_of(out: str | Path, key: str, fresh: bool = False) -> Iterator[Journal]:
    """The journal of a job, of this process alone within the block. It is removed where the block ends well.

    Each job (study, table, package, seed, runs) has a file of its own beside ``out``, so that another one does not
    disturb it. ``fresh`` forgets what is there of this job. Raises the errors of :func:`journals`.
    """
    with journals(out) as folder:
        path = folder / f"{key[:24]}.jsonl"
        if fresh:
            path.unlink(missing_ok=True)
        yield Journal(path)
        path.unlink(missing_ok=True)


@contextmanager
def journals(out: str | Path, work: str = "verification") -> Iterator[Path]:
    """The folder of journals beside ``out``, of this process alone within the block; it is removed where it is empty.

    Raises ArtifactError where another process is at work on the same output, or where nothing can be written.
    """
    folder = journal_folder(out, work)
    with ExitStack() as held:
        try:
            held.enter_context(parents_made(folder.parent))
            folder.mkdir(exist_ok=True)
            held.enter_context(locked(folder / _LOCK))
        except (LockedError, FileNotFoundError):
            raise ArtifactError(
                f'"{out}" is being made by another process, which keeps its finished blocks in "{folder}". Wait until '
                "it is done, or give another place."
            ) from None
        except OSError as error:
            raise cannot_write(folder, error) from error
        try:
            yield folder
            for path in list(folder.glob("*.table.json")):  # gain tables that were designed for this output
                path.unlink(missing_ok=True)
        finally:
            # The lock goes with its folder, and while it is held: whoever comes next sees that it was another's.
            if next(folder.glob("*.jsonl"), None) is None:
                (folder / _LOCK).unlink(missing_ok=True)
                with suppress(OSError):
                    folder.rmdir()
