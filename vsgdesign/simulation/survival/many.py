"""Many cases on many cores: progress, resumption, and the same verdicts whatever the number of workers."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, as_completed
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

from vsgdesign.artifacts.gain_table import GainTable
from vsgdesign.artifacts.locks import LockedError, locked
from vsgdesign.artifacts.provenance import package_hash
from vsgdesign.artifacts.ready import Ready
from vsgdesign.errors import ArtifactError, WorkerError
from vsgdesign.execution.processes import worker_processes
from vsgdesign.execution.progress import Progress, silent
from vsgdesign.execution.threads import one_thread
from vsgdesign.metrics.survival import Survival
from vsgdesign.parameters.study import ControllerSpec, Study
from vsgdesign.simulation.survival.cases import SurvivalCase
from vsgdesign.simulation.survival.running import CaseResult, Subject, run_case

CHUNK = 20
"""Cases that a worker takes at a time: about a second of work."""


def run_many(
    subjects: Mapping[str, Subject],
    cases: Sequence[SurvivalCase],
    kept: str | Path | None = None,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> dict[str, tuple[CaseResult, ...]]:
    """Every subject through every case: results by subject, in the order of the cases.

    ``kept`` is a file to which finished runs are added at once, and from which the same call continues after an
    interruption. A run is found again only if the package's source, the subject and the case are the same to the
    letter. ``workers``: number of processes; None: as many as there are cores; 1: in this process.
    Raises ArtifactError if another process uses the file, WorkerError if a process is lost.
    """
    tell = progress or silent
    workers = workers or os.cpu_count() or 1
    stamps = {name: _stamp(subject) for name, subject in subjects.items()}
    keys = {name: [_key(stamp, case) for case in cases] for name, stamp in stamps.items()}
    with ExitStack() as held:
        if kept is not None:
            path = Path(kept)
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                held.enter_context(locked(path.with_name(path.name + ".lock")))
            except LockedError:
                raise ArtifactError(f'"{path}" is in use by another process. Wait for it, or name another.') from None
        found = {} if kept is None else _read(Path(kept))
        missing = [(name, k) for name in subjects for k, key in enumerate(keys[name]) if key not in found]
        total, done = len(cases) * len(subjects), len(cases) * len(subjects) - len(missing)
        tell("disturbances", done / max(total, 1))
        file = None if kept is None else held.enter_context(Path(kept).open("a", encoding="utf-8"))
        for name, indices, results in _results(subjects, cases, missing, workers):
            for k, result in zip(indices, results, strict=True):
                found[keys[name][k]] = result
                if file is not None:
                    file.write(json.dumps({"key": keys[name][k], **result}) + "\n")
            if file is not None:
                file.flush()
            done += len(indices)
            tell("disturbances", done / total)
    return {
        name: tuple(_result(case, found[key]) for case, key in zip(cases, keys[name], strict=True)) for name in subjects
    }


def _result(case: SurvivalCase, document: Mapping[str, Any]) -> CaseResult:
    return CaseResult(case=case, verdict=Survival(**document["verdict"]), seconds=float(document["seconds"]))


def _results(
    subjects: Mapping[str, Subject], cases: Sequence[SurvivalCase], missing: Sequence[tuple[str, int]], workers: int
) -> Iterator[tuple[str, list[int], list[dict[str, Any]]]]:
    chunks: list[tuple[str, list[int]]] = []
    for name in subjects:
        of_this = [k for other, k in missing if other == name]
        chunks += [(name, of_this[i : i + CHUNK]) for i in range(0, len(of_this), CHUNK)]
    if workers == 1 or len(chunks) <= 1:
        for name, indices in chunks:
            yield name, indices, _run_chunk(_parts(subjects[name]), [cases[k] for k in indices])
        return
    with worker_processes(min(workers, len(chunks))) as pool:
        futures = {
            pool.submit(_run_chunk, _parts(subjects[name]), [cases[k] for k in indices]): (name, indices)
            for name, indices in chunks
        }
        try:
            for future in as_completed(futures):
                yield *futures[future], future.result()
        except BrokenExecutor as error:
            raise WorkerError(
                "workers: a process that simulated disturbances was lost (out of memory?). Finished runs are kept: "
                "run the same command again, with fewer workers if it happens once more."
            ) from error


class _Parts(NamedTuple):
    """A subject in parts that can be sent to another process: a Ready cannot."""

    study: Study
    spec: ControllerSpec
    tables: dict[str, GainTable]
    limit_pu: float
    bridge: str
    room_pu: float | None


def _parts(subject: Subject) -> _Parts:
    study = replace(subject.study, origin=None)
    return _Parts(study, subject.spec, dict(subject.ready.tables), subject.limit_pu, subject.bridge, subject.room_pu)


def _run_chunk(parts: _Parts, cases: Sequence[SurvivalCase]) -> list[dict[str, Any]]:
    subject = Subject(
        study=parts.study,
        spec=parts.spec,
        ready=Ready(tables=parts.tables),
        limit_pu=parts.limit_pu,
        bridge=parts.bridge,
        room_pu=parts.room_pu,
    )
    with one_thread():
        results = [run_case(subject, case) for case in cases]
    return [{"verdict": asdict(result.verdict), "seconds": result.seconds} for result in results]


def _read(path: Path) -> dict[str, dict[str, Any]]:
    """Finished runs by key. What a kill left of a line is not one."""
    found = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                document = json.loads(line)
                found[document["key"]] = {"verdict": dict(document["verdict"]), "seconds": document["seconds"]}
            except (ValueError, KeyError, TypeError):
                continue
        if found and not path.read_text(encoding="utf-8").endswith("\n"):
            with path.open("a", encoding="utf-8") as file:
                file.write("\n")
    return found


def _key(stamp: str, case: SurvivalCase) -> str:
    return hashlib.sha256(f"{stamp} {case!r}".encode()).hexdigest()[:32]


def _stamp(subject: Subject) -> str:
    """Everything that a verdict depends on besides the case."""
    study = replace(subject.study, files=(), name="", title="", source="", hash="")
    parts = (package_hash(), study, subject.spec, dict(subject.ready.tables), subject.limit_pu, subject.bridge)
    parts += (subject.room_pu,)
    return hashlib.sha256(repr(parts).encode()).hexdigest()
