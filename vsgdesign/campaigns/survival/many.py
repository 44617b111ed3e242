"""Many cases on many cores: progress, resumption, and the same verdicts whatever the number of workers."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.provenance import package_hash
from vsgdesign.campaigns.survival.together import share_a_loop, verdicts_of
from vsgdesign.execution.executors import executor_of, worker_count
from vsgdesign.execution.jobs import Job
from vsgdesign.execution.journal import begins_again, journal_at, run_job
from vsgdesign.execution.progress import Progress
from vsgdesign.metrics.survival import Survival
from vsgdesign.simulation.survival.cases import SurvivalCase
from vsgdesign.simulation.survival.running import CaseResult, Subject

CHUNK, CHUNK_OF_LANES = 20, 400
"""Cases that a worker takes at a time, a second or two of work: run one after the other, and side by side."""


def run_many(
    subjects: Mapping[str, Subject],
    cases: Sequence[SurvivalCase],
    kept: str | Path | None = None,
    *,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> dict[str, tuple[CaseResult, ...]]:
    """Every subject through every case: results by subject, in the order of the cases.

    ``kept`` is a file to which finished runs are added at once, and from which the same call continues after an
    interruption. A run is found again only if the package's source, the subject and the case are the same to the
    letter; ``say`` takes a sentence where none is. ``workers`` and ``cluster`` are those of
    :func:`vsgdesign.execution.executors.executor_of`. Raises ArtifactError if another process uses the file,
    WorkerError if a process is lost.
    """
    stamps = {name: _stamp(subject) for name, subject in subjects.items()}
    keys = {name: tuple(_key(stamp, case) for case in cases) for name, stamp in stamps.items()}
    job = SurvivalJob(subjects=dict(subjects), cases=tuple(cases), keys=keys)
    with journal_at(job, kept) as journal:
        left = job.left(journal.whole)
        if say is not None and journal.whole and left == job.blocks:
            say(begins_again(kept or ""))
        with executor_of(min(worker_count(workers), max(len(left), 1)), cluster) as executor:
            found = run_job(job, journal, executor=executor, progress=progress)
    return {
        name: tuple(_result(case, found[key]) for case, key in zip(cases, keys[name], strict=True)) for name in subjects
    }


@dataclass(frozen=True, kw_only=True)
class SurvivalJob(Job[tuple[str, tuple[int, ...]], dict[str, Any]]):
    """Subjects through cases. A block is a subject with the numbers of some cases; a finished run has a key."""

    subjects: dict[str, Subject]
    cases: tuple[SurvivalCase, ...]
    keys: dict[str, tuple[str, ...]]
    """Of each subject's run of each case: hashes of everything that it depends on."""

    what = "disturbances"

    @property
    def key(self) -> str:
        """Hash of the keys of all runs."""
        return hashlib.sha256(repr(self.keys).encode()).hexdigest()

    @property
    def blocks(self) -> list[tuple[str, tuple[int, ...]]]:
        """All runs in blocks."""
        return self.left({})

    def left(self, whole: dict[str, Any]) -> list[tuple[str, tuple[int, ...]]]:
        """The runs that are not finished yet, in new blocks."""
        found = []
        for name, keys in self.keys.items():
            missing = tuple(k for k, key in enumerate(keys) if key not in whole)
            chunk = CHUNK_OF_LANES if share_a_loop(self.subjects[name]) else CHUNK
            found += [(name, missing[i : i + chunk]) for i in range(0, len(missing), chunk)]
        return found

    def size(self, block: tuple[str, tuple[int, ...]]) -> int:
        """The runs of a block."""
        return len(block[1])

    def run(self, block: tuple[str, tuple[int, ...]]) -> dict[str, Any]:
        """Verdict and seconds of each run of a block, by its key."""
        return self.call(block)()

    def call(self, block: tuple[str, tuple[int, ...]]) -> Callable[[], dict[str, Any]]:
        """The run of a block as it goes to another process: with its subject and its cases alone."""
        name, numbers = block
        return partial(_run_cases, self.subjects[name], {self.keys[name][k]: self.cases[k] for k in numbers})

    def part_of(self, document: Any) -> dict[str, Any]:
        """Finished runs by key. Raises ValueError, KeyError or TypeError where a document is none."""
        return {str(key): {"verdict": dict(one["verdict"]), "seconds": one["seconds"]} for key, one in document.items()}


def _run_cases(subject: Subject, cases: Mapping[str, SurvivalCase]) -> dict[str, Any]:
    begin = time.perf_counter()
    verdicts = verdicts_of(subject, list(cases.values()))
    seconds = (time.perf_counter() - begin) / max(len(cases), 1)
    return {key: {"verdict": asdict(one), "seconds": seconds} for key, one in zip(cases, verdicts, strict=True)}


def _result(case: SurvivalCase, document: Mapping[str, Any]) -> CaseResult:
    return CaseResult(case=case, verdict=Survival(**document["verdict"]), seconds=float(document["seconds"]))


def _key(stamp: str, case: SurvivalCase) -> str:
    return hashlib.sha256(f"{stamp} {case!r}".encode()).hexdigest()[:32]


def _stamp(subject: Subject) -> str:
    """Everything that a verdict depends on besides the case."""
    study = replace(subject.study, files=(), name="", title="", source="", hash="")
    parts = (package_hash(), study, subject.spec, dict(subject.ready.tables), subject.limit_pu, subject.bridge)
    parts += (subject.room_pu,)
    return hashlib.sha256(repr(parts).encode()).hexdigest()
