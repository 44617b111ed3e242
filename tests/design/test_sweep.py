"""Sweeps: equal digits on any executor, cells that survive a kill at any moment, files that are half there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.design.robust_studies import ROOT, controller, robust_study, specification, textbook
from vsgdesign.artifacts.files import plain
from vsgdesign.design import record as sweeping
from vsgdesign.design.cell import CellDesign
from vsgdesign.design.evaluation import Figures
from vsgdesign.design.record import CellRecord, CellTask, SweepJob, cells_file, record_document, record_of, sweep
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.errors import ArtifactError, WorkerError
from vsgdesign.execution import executors
from vsgdesign.execution.executors import executor_of
from vsgdesign.execution.journal import Journal

STUDY = robust_study()
SPEC = specification(STUDY)
CENTRE = tuple(float(value) for value in textbook(STUDY))


def task(scr: float, x_over_r: float, seed: int = 0) -> CellTask:
    return CellTask(
        study=STUDY, target=controller(STUDY).target, spec=SPEC, scr=scr, x_over_r=x_over_r, centre=CENTRE, seed=seed
    )


TASKS = [task(6.0, 3.0), task(6.0, 1.0)]

any_float = st.floats(allow_nan=False, allow_infinity=False)
upper = any_float | st.just(float("inf"))
lower = any_float | st.just(float("-inf"))
LEAST = ("disk_margin", "damping_ratio")  # of all others the largest is the worst
figures = st.builds(Figures, **{f.name: lower if f.name in LEAST else upper for f in fields(Figures)})
designs = st.builds(
    CellDesign,
    normalised=st.builds(NormalisedGains, *[any_float] * 6),
    figures=figures,
    inertia=any_float,
    active=st.sampled_from(["", "overshoot"]),
    price=any_float,
    shortfalls=st.dictionaries(st.sampled_from(["overshoot", "settling_time"]), upper),
    scenarios=st.integers(0, 99),
    iterations=st.integers(0, 99),
)
records = st.builds(CellRecord, any_float, any_float, st.none() | designs, st.none() | figures, st.none() | any_float)


@given(records)
def test_records_come_back(record: CellRecord) -> None:
    assert record_of(json.loads(json.dumps(plain(record_document(record)), allow_nan=False))) == record


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[CellRecord]]:
    folder = tmp_path_factory.mktemp("alone")
    return folder, sweep(TASKS, folder)


def lines(folder: Path) -> list[bytes]:
    """The kept cells, whatever their order: that in which they were finished."""
    return sorted(cells_file(folder).read_bytes().splitlines(keepends=True))


def test_finished_cells_are_not_done_again(
    alone: tuple[Path, list[CellRecord]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweeping, "run_task", lambda _: pytest.fail("designed again"))
    told: list[float] = []
    assert sweep(TASKS, alone[0], progress=lambda _, share: told.append(share)) == alone[1]
    assert told == [1.0]


@pytest.mark.parametrize("damage", [b"", b"{", b"[]\n", b"null", b'{"key": 3}\n', b"\xff\xfe"])
def test_a_damaged_cell_is_designed_again(
    alone: tuple[Path, list[CellRecord]], tmp_path: Path, damage: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = cells_file(alone[0]).read_bytes().splitlines(keepends=True)
    path = cells_file(tmp_path)
    path.write_bytes(first + damage)
    again: list[CellTask] = []

    def redo(one: CellTask) -> CellRecord:
        again.append(one)
        return alone[1][1]

    monkeypatch.setattr(sweeping, "run_task", redo)
    assert sweep(TASKS, tmp_path) == alone[1]
    assert again == [TASKS[1]]
    assert path.read_bytes() == first + second


def test_a_cell_of_which_one_digit_was_changed_is_designed_again(
    alone: tuple[Path, list[CellRecord]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = cells_file(alone[0]).read_bytes().splitlines(keepends=True)
    cells_file(tmp_path).write_bytes(first + second.replace(b'"scr":6.0', b'"scr":6.5'))
    monkeypatch.setattr(sweeping, "run_task", lambda _: alone[1][1])
    assert sweep(TASKS, tmp_path) == alone[1]
    assert lines(tmp_path) == lines(alone[0])


def test_a_cell_of_another_question_is_not_taken(alone: tuple[Path, list[CellRecord]], tmp_path: Path) -> None:
    other = replace(TASKS[0], seed=1)
    keys = {
        TASKS[0].key,
        other.key,
        replace(TASKS[0], scr=6.1).key,
        replace(TASKS[0], centre=CENTRE[::-1]).key,
        replace(TASKS[0], spec=replace(SPEC, overshoot=0.1)).key,
        replace(TASKS[0], target=replace(TASKS[0].target, Q_droop=0.1)).key,
    }
    assert len(keys) == 6
    assert replace(TASKS[0], spec=replace(SPEC, scr=(3.0, 4.0, 6.0))).key == TASKS[0].key
    (tmp_path / cells_file(alone[0]).name).write_bytes(cells_file(alone[0]).read_bytes())
    job = SweepJob({other.key: other})
    assert job.left(Journal(job, cells_file(tmp_path)).whole) == [other.key]


def test_a_dask_cluster_gives_the_same_bytes(alone: tuple[Path, list[CellRecord]], tmp_path: Path) -> None:
    with executor_of(1, "local") as executor:
        assert executor is not None
        assert sweep(TASKS, tmp_path, executor) == alone[1]
    assert lines(tmp_path) == lines(alone[0])


class OneWorks(ThreadPoolExecutor):
    """The first call is done, the second has the fault."""

    def __init__(self, done: dict[str, Any], fault: BaseException) -> None:
        super().__init__(1)
        self._made: list[Any] = [done, fault]

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:  # noqa: ARG002
        future: Future[Any] = Future()
        made = self._made.pop(0)
        future.set_exception(made) if isinstance(made, BaseException) else future.set_result(made)
        return future


@pytest.mark.parametrize(
    ("fault", "raised", "says"),
    [
        (BrokenExecutor("a process was lost"), WorkerError, r"was lost.*run the same command"),
        (KeyboardInterrupt("now"), KeyboardInterrupt, "now"),
        (ValueError("wrong"), ValueError, "wrong"),
    ],
)
def test_what_is_finished_beside_a_fault_is_kept(
    alone: tuple[Path, list[CellRecord]], tmp_path: Path, fault: BaseException, raised: type[BaseException], says: str
) -> None:
    done = {TASKS[0].key: plain(record_document(alone[1][0]))}
    with pytest.raises(raised, match=says), OneWorks(done, fault) as executor:
        sweep(TASKS, tmp_path, executor)
    assert lines(tmp_path) == [one for one in lines(alone[0]) if TASKS[0].key.encode() in one]


def test_a_folder_that_cannot_be_is_named(tmp_path: Path, alone: tuple[Path, list[CellRecord]]) -> None:
    (tmp_path / "file").write_text("")
    job = SweepJob(dict(zip([task.key for task in TASKS], TASKS, strict=True)))
    with pytest.raises(ArtifactError, match=r"cannot write .*file"):
        Journal(job, tmp_path / "file" / "cells.jsonl").add({TASKS[0].key: plain(record_document(alone[1][0]))})


@pytest.mark.parametrize("address", ["nonsense://x", "127.0.0.1:1"])
def test_a_cluster_that_does_not_answer(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "_CONNECT_S", 0.3)
    with pytest.raises(WorkerError, match="no scheduler answers"), executor_of(cluster=address):
        pytest.fail("there is none")


def test_a_cluster_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(WorkerError, match=r"pip install \"vsgdesign\[cluster\]\""), executor_of(cluster="local"):
        pytest.fail("there is none")


def test_one_worker_is_no_other_process() -> None:
    with executor_of(1) as executor:
        assert executor is None


WAITS = """
import os, sys, time
from vsgdesign.execution.executors import worker_processes
if __name__ == "__main__":
    with worker_processes(2) as pool:
        print(*{pool.submit(os.getpid).result() for _ in range(9)}, flush=True)
        held = [pool.submit(time.sleep, 60.0) for _ in range(5)]
        if sys.argv[1] == "kill":
            os.kill(os.getpid(), 9)
        raise KeyboardInterrupt
"""


def runs(pid: int) -> bool:
    """Whether a process is there and is no zombie that waits for its parent."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize(("how", "code"), [("kill", -9), ("interrupt", 1)])
def test_processes_end_with_the_one_they_work_for(tmp_path: Path, how: str, code: int) -> None:
    """60 s of work is not waited for."""
    script = tmp_path / "script.py"
    script.write_text(WAITS, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-P", str(script), how],
        capture_output=True,
        text=True,
        timeout=50.0,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert done.returncode in (code, -2)  # an interruption nobody takes ends with the signal
    deadline = time.monotonic() + 10.0
    for pid in map(int, done.stdout.split()):
        while runs(pid):
            assert time.monotonic() < deadline
            time.sleep(0.02)
    assert done.stderr.count("Traceback") == (0 if how == "kill" else 1)


def test_executors_are_what_concurrent_futures_says() -> None:
    with executor_of(2) as executor:
        assert isinstance(executor, Executor)
        assert len({executor.submit(os.getpid).result() for _ in range(4)} - {os.getpid()}) >= 1
