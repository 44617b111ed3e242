"""One runner for all work in blocks: what is kept, what is run again, and what is said of work of others."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import pytest

from vsgdesign.errors import ArtifactError
from vsgdesign.execution.executors import executor_of
from vsgdesign.execution.jobs import Job
from vsgdesign.execution.journal import Journal, journal_at, journal_of, kept_count, kept_folder, run_job, work_folder
from vsgdesign.verbs.cli.program import main

WORK = "numbers"


@dataclass(frozen=True)
class Numbers(Job[int, dict[str, Any]]):
    """Numbers until one that is interrupted."""

    stop: int
    version: str = "this"

    what = "numbers"

    @property
    def key(self) -> str:
        return self.version

    @property
    def blocks(self) -> range:
        return range(6)

    def run(self, block: int) -> dict[str, Any]:
        if block == self.stop:
            raise KeyboardInterrupt
        return {str(block): 0.1 * block}


def interrupted(out: Path, job: Numbers, **options: Any) -> list[str]:
    """What a job says that is interrupted."""
    said: list[str] = []
    with suppress(KeyboardInterrupt), journal_of(job, out, WORK, say=said.append, **options) as journal:
        run_job(job, journal)
    return said


@pytest.mark.parametrize("workers", [1, 2])
def test_a_whole_is_the_same_whatever_happened(tmp_path: Path, workers: int) -> None:
    out, told = tmp_path / "out", list[float]()
    assert interrupted(out, Numbers(stop=3)) == []
    assert kept_count(out, WORK) == 3
    job = Numbers(stop=-1)
    with executor_of(workers) as executor, journal_of(job, out, WORK) as journal:
        whole = run_job(job, journal, executor=executor, progress=lambda _what, share: told.append(share))
    assert whole == run_job(job, Journal(job, None))
    assert (told[0], told[-1], told) == (0.5, 1.0, sorted(told))
    assert not list(tmp_path.iterdir())


def test_work_of_another_version_begins_again_with_one_sentence(tmp_path: Path) -> None:
    out = tmp_path / "out"
    interrupted(out, Numbers(stop=3, version="before"))
    (said,) = interrupted(out, Numbers(stop=1))
    assert "another version of vsgdesign: this work begins from its start" in said
    assert interrupted(out, Numbers(stop=2)) == []  # that of this version is there now
    assert interrupted(out, Numbers(stop=0), fresh=True) == []
    assert [path.name for path in kept_folder(out, WORK).glob("*.jsonl")] == ["before.jsonl"]


def test_lines_of_a_version_before_are_run_again(tmp_path: Path) -> None:
    job, path = Numbers(stop=-1), tmp_path / "this.jsonl"
    path.write_text('{"key": "0", "verdict": {}}\n', encoding="utf-8")
    journal = Journal(job, path)
    assert (journal.whole, path.read_bytes()) == ({}, b"")
    assert run_job(job, journal) == {str(k): 0.1 * k for k in range(6)}
    assert Journal(job, path).whole == journal.whole


def test_a_folder_of_ones_own_goes_with_what_versions_before_kept(tmp_path: Path) -> None:
    out, left = tmp_path / "table.json", ("cell.json", ".half.json.x", "a.jsonl", "s.c.table.json", "a.jsonl.lock")
    folder = kept_folder(out, "cells")
    folder.mkdir()
    for name in left:
        (folder / name).write_text("{}", encoding="utf-8")
    with work_folder(out, "cells", own=True):
        assert {path.name for path in folder.iterdir()} == {*left, "lock"}
    assert not folder.exists()
    folder.mkdir()
    (folder / "letter.txt").write_text("dear", encoding="utf-8")
    with work_folder(out, "cells", own=True, fresh=True):
        pass
    assert [path.name for path in folder.iterdir()] == ["letter.txt"]


def test_one_process_at_a_time(tmp_path: Path) -> None:
    job, path = Numbers(stop=-1), tmp_path / "runs.jsonl"
    with journal_at(job, path), pytest.raises(ArtifactError, match="in use by another process"), journal_at(job, path):
        pytest.fail("both at work")
    first, second = work_folder(path, WORK), work_folder(path, WORK, what="the table of one")
    with first, pytest.raises(ArtifactError, match="the table of one is being made by another process"), second:
        pytest.fail("both at work")


SHARED = ("--workers", "--cluster", "--resume")
VERBS = ("verify", "comply", "survive", "table build", "estimator windows", "estimator train")


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_that_works_in_blocks_has_the_same_options(verb: str) -> None:
    def options(verb: str) -> dict[str, Any]:
        command: Any = main
        for name in verb.split():
            command = command.commands[name]
        found = {one.opts[0]: one for one in command.params if isinstance(one, click.Option)}
        return {name: (found[name].secondary_opts, found[name].help, found[name].default) for name in SHARED}

    assert options(verb) == options(VERBS[0])
