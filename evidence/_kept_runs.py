"""Many runs in worker processes whose results are kept in a file, so that an interrupted measurement goes on."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

from vsgdesign.artifacts.locks import locked
from vsgdesign.artifacts.provenance import package_hash
from vsgdesign.execution.processes import worker_processes
from vsgdesign.execution.threads import one_thread

EVIDENCE_SEED = 100_000
"""The first seed of runs that were never looked at while the estimator was tuned."""

CHUNK = 6
"""Runs that a worker takes at a time."""


def share() -> float:
    """The share of the runs that the environment asks for."""
    return float(os.environ.get("VSGDESIGN_FIELD_SHARE", "1"))


def first_seed() -> int:
    """The first seed of the draws: by default one that was never used to tune an estimator."""
    return int(os.environ.get("VSGDESIGN_FIELD_SEED", str(EVIDENCE_SEED)))


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
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path.with_name(path.name + ".lock")):
        found = _read(path, set(keys))
        missing = [k for k, key in enumerate(keys) if key not in found]
        chunks = [missing[i : i + CHUNK] for i in range(0, len(missing), CHUNK)]
        done, told = len(tasks) - len(missing), -1
        with path.open("a", encoding="utf-8") as file:
            for chunk, results in _results(run, tasks, chunks, workers):
                for k, result in zip(chunk, results, strict=True):
                    found[keys[k]] = result
                    file.write(json.dumps({"key": keys[k], "result": result}) + "\n")
                file.flush()
                done += len(chunk)
                if (twentieth := 20 * done // max(len(tasks), 1)) != told:
                    told = twentieth
                    print(f"{name}: {5 * twentieth} % of {len(tasks)} runs", file=sys.stderr, flush=True)
    return [found[key] for key in keys]


def _results(
    run: Callable[[Any], dict[str, Any]], tasks: Sequence[Any], chunks: list[list[int]], workers: int
) -> Iterator[tuple[list[int], list[dict[str, Any]]]]:
    if workers == 1 or len(chunks) <= 1:
        for chunk in chunks:
            yield chunk, _chunk(run, [tasks[k] for k in chunk])
        return
    with worker_processes(min(workers, len(chunks))) as pool:
        futures = {pool.submit(_chunk, run, [tasks[k] for k in chunk]): chunk for chunk in chunks}
        for future in as_completed(futures):
            yield futures[future], future.result()


def _chunk(run: Callable[[Any], dict[str, Any]], tasks: list[Any]) -> list[dict[str, Any]]:
    with one_thread():
        return [run(task) for task in tasks]


def _read(path: Path, wanted: set[str]) -> dict[str, dict[str, Any]]:
    """Finished runs by key. What a kill left of a line is not one."""
    if not path.exists():
        return {}
    text, found = path.read_text(encoding="utf-8"), {}
    for line in text.splitlines():
        try:
            document = json.loads(line)
            if document["key"] in wanted:
                found[document["key"]] = dict(document["result"])
        except (ValueError, KeyError, TypeError):
            continue
    if text and not text.endswith("\n"):
        with path.open("a", encoding="utf-8") as file:
            file.write("\n")
    return found


@functools.cache
def _evidence_hash() -> str:
    """SHA-256 over the sources that draw, run and judge."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("_*.py")):
        if path.name.startswith(("_field", "_grid_code", "_kept")) and "summary" not in path.name:
            digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()
