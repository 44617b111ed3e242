"""Processes that answer questions and make calls: answers, errors, and their end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest

from vsgdesign.errors import Fault, StudyError, WorkerError
from vsgdesign.execution.executors import worker_processes
from vsgdesign.execution.jobs import begun
from vsgdesign.execution.workers import AnsweringProcess

ROOT = Path(__file__).parents[2]


def _call_out(words: str) -> None:
    """Ends the process with a last line on standard error."""
    sys.stderr.write(f"Traceback\n{words}\n")
    sys.stderr.flush()
    os._exit(1)


def test_it_answers_until_it_is_closed() -> None:
    process = AnsweringProcess(attrgetter, "imag", "real")
    try:
        assert process.ask(3.0 + 4.0j) == (4.0, 3.0)
        assert process.ask("no number") is None
        assert process.ask(1.0) == (0.0, 1.0)
        assert process.alive
    finally:
        process.close()
    assert not process.alive
    assert process.ask(1.0) is None
    process.close()


def test_a_call_is_sent_as_it_was_when_it_was_submitted() -> None:
    held = [1, 2]
    with worker_processes(1) as pool:
        pool.submit(time.sleep, 0.05)  # the only worker is busy
        waiting = pool.submit(len, held)
        held.clear()
        assert waiting.result() == 2


def test_a_pool_gives_results_and_errors_as_they_were(capfd: pytest.CaptureFixture[str]) -> None:
    with worker_processes(2) as pool:
        assert list(pool.map(abs, range(-9, 0))) == list(range(9, 0, -1))
        with pytest.raises(StudyError, match="1 fault") as caught:
            pool.submit(_refuse).result()
        assert caught.value.faults == (Fault("a", "1", "wrong"),)
        assert "In another process:" in caught.value.__notes__[0]
        with pytest.raises(AttributeError, match="<lambda>"):  # cannot be sent
            pool.submit(lambda: 1).result()
        pool.submit(os.write, 2, b"a warning\n").result()
        pool.submit(print, "to nobody").result()
    assert sorted(capfd.readouterr().err.splitlines()) == ["a warning", "to nobody"]


def test_a_pool_has_no_more_processes_than_calls() -> None:
    """On a machine of 64 cores, two blocks of work started 64 processes. A free one is used again."""
    with worker_processes(64) as pool:
        assert pool.submit(os.getpid).result() == pool.submit(os.getpid).result()
    with pytest.raises(RuntimeError):
        pool.submit(os.getpid)


def _refuse() -> None:
    raise StudyError("s", [Fault("a", "1", "wrong")])


@pytest.mark.parametrize(
    ("function", "argument", "says"),
    [
        (os._exit, 3, r"workers: a process ended with exit code 3\. What is finished is kept"),
        (signal.raise_signal, 9, "ended by SIGKILL, which mostly means: out of memory"),
        (signal.raise_signal, 11, r"ended by SIGSEGV\."),
        (_call_out, "no room left", r"exit code 1 \(no room left\)"),
    ],
)
def test_a_worker_that_dies_is_reported_with_its_own_end(function: Any, argument: Any, says: str) -> None:
    with worker_processes(1) as pool, pytest.raises(WorkerError, match=says):
        begun(pool, function, argument)()


SCRIPT = """
print("the script runs", __name__)
from vsgdesign.execution.executors import executor_of
from vsgdesign.equations.structures import STRUCTURES
from dataclasses import replace
import math
with executor_of(2) as executor:
    print(executor.submit(math.sqrt, 4.0).result())
def own(*arguments):
    return arguments
STRUCTURES.register(replace(STRUCTURES["published"], name="own", gains=own))
with executor_of(2) as executor:
    print(executor)
with executor_of(2, reproducible=True) as executor:
    pass
"""


def test_a_plain_script_is_not_run_again_by_workers(tmp_path: Path) -> None:
    """Without a guard of its main part each worker ran it, and memory was blamed."""
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, tmp_path / "script.py"],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert done.stdout == "the script runs __main__\n2.0\nNone\n"
    assert done.stderr.endswith(
        "WorkerError: structure own: another process has to import it, and it is part of the script that runs. "
        "Move it to a module of its own.\n"
    )
