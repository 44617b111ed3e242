"""The journal of a bench: finished blocks, on the disk before they count. A kill loses what was under way."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vsgdesign.verification.journal import append_line, journal_folder, journals, kept_lines

WORK = "compliance"


class SuiteJournal:
    """Finished blocks of one job: a line each in a file, and their traces in a folder beside it."""

    def __init__(self, path: Path) -> None:
        """Reads what is there. What a kill left of a last line is cut off."""
        self.path, self.traces = path, path.with_suffix("")
        self.blocks: dict[int, dict[str, Any]] = {found["block"]: found for found in kept_lines(path, _read)}

    def add(self, done: dict[str, Any]) -> None:
        """Keep a block, whose traces are there: when this returns, it is on the disk."""
        append_line(self.path, json.dumps(done, allow_nan=False, ensure_ascii=False, separators=(",", ":")) + "\n")
        self.blocks[done["block"]] = done

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The rows of all finished blocks in the order of the matrix."""
        return [row for number in sorted(self.blocks) for row in self.blocks[number]["rows"]]

    def all_of(self, name: str) -> list[Any]:
        """What blocks have under a name besides their rows, in the order of the blocks."""
        return [self.blocks[number][name] for number in sorted(self.blocks) if name in self.blocks[number]]

    def forget(self) -> None:
        """Remove what is kept."""
        self.path.unlink(missing_ok=True)
        shutil.rmtree(self.traces, ignore_errors=True)
        self.blocks = {}


def _read(found: Any) -> dict[str, Any]:
    return {**found, "block": int(found["block"]), "rows": list(found["rows"])}


@contextmanager
def suite_journal(out: str | Path, key: str, fresh: bool = False) -> Iterator[SuiteJournal]:
    """The journal of a job beside ``out``, of this process alone within the block. It is removed where the block ends
    well. ``fresh`` forgets what is there of this job. Raises the errors of
    :func:`vsgdesign.verification.journal.journals`.
    """
    with journals(out, WORK) as folder:
        path = folder / f"{key[:24]}.jsonl"
        for traces in folder.iterdir():  # without their journal they are of no use: it was cut off while it went
            if traces.is_dir() and not traces.with_suffix(".jsonl").exists():
                shutil.rmtree(traces, ignore_errors=True)
        journal = SuiteJournal(path)
        if fresh:
            journal.forget()
        yield journal
        journal.forget()


def kept_rows(out: str | Path) -> int:
    """How many finished rows an interrupted bench has left beside its output."""
    files = sorted(journal_folder(out, WORK).glob("*.jsonl"), key=lambda path: path.stat().st_mtime)
    return len(SuiteJournal(files[-1]).rows) if files else 0
