"""The installed command as a real process: exit codes, and an interruption in the middle of a run."""

from __future__ import annotations

import json
import os
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.small_studies import SMALL, study_file
from vsgdesign import __version__

COMMAND = [sys.executable, "-m", "vsgdesign.verbs.cli.program"]


def run(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [*COMMAND, *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=120)


def test_version_and_usage(tmp_path: Path) -> None:
    result = run("--version", cwd=tmp_path)
    assert (result.returncode, result.stdout.strip()) == (0, f"vsgdesign, version {__version__}")
    assert run("nonsense", cwd=tmp_path).returncode == 2


def test_simulate(tmp_path: Path) -> None:
    study_file(tmp_path)
    result = run("simulate", "small.toml", "--json", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    assert json.loads(result.stdout)["study"]["name"] == "small"
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["small-simulation"]


@pytest.mark.parametrize(("encoding", "forms"), [("ascii", ([], ["--json"])), ("cp1252", ([],))])
def test_an_output_that_cannot_have_every_character(
    tmp_path: Path, encoding: str, forms: tuple[list[str], ...]
) -> None:
    """A redirected output of Windows, and the locale C: a verb ended with a traceback after its work."""
    study_file(tmp_path)
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    for more in forms:
        result = subprocess.run(
            [*COMMAND, "simulate", "small.toml", *more], cwd=tmp_path, env=environment, capture_output=True, timeout=120
        )
        assert (result.returncode, result.stderr) == (0, b"")
        text = result.stdout.decode(encoding)
        if more:
            assert json.loads(text)["study"]["name"] == "small"
        else:
            assert "P_pcc" in text
            assert ("?" in text) == (encoding == "ascii")  # an overshoot that is not known is a dash: cp1252 has it


def test_an_output_that_is_closed(tmp_path: Path) -> None:
    study_file(tmp_path)
    close = f"{sys.executable} -m vsgdesign.verbs.cli.program validate small.toml >&-"
    result = subprocess.run(close, shell=True, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert (result.returncode, result.stderr) == (0, "")


def test_wrong_input(tmp_path: Path) -> None:
    study_file(tmp_path, duration='"0.3 ohm"')
    result = run("simulate", "small.toml", cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("error: small.toml: 1 fault\n  - simulation.duration")


_AT_IMPORT = """
import os, signal, sys
module, number = sys.argv[1], int(sys.argv[2])
class Finder:
    def find_spec(self, name, *_):
        if name == module:
            os.kill(os.getpid(), number)
sys.meta_path.insert(0, Finder())
sys.argv = ["vsgdesign", "simulate", "missing.toml"]
from vsgdesign.verbs.cli.program import main
main()
"""


@pytest.mark.parametrize("module", ["click", "vsgdesign.verbs.cli.table", "vsgdesign.study.parameters", "numpy"])
@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
def test_a_signal_while_modules_are_loaded(module: str, number: int, code: int, word: str, tmp_path: Path) -> None:
    """In the first tenths of a second, before the verb and within it: one line, no traceback of an import."""
    command = [sys.executable, "-c", _AT_IMPORT, module, str(int(number))]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", f"{word}: nothing was written\n")


_AT_THE_END = """
import atexit, os, signal, sys, threading
def kill():
    os.kill(os.getpid(), signal.SIGINT)
if sys.argv[1] == "before the verb":
    import click
    click.Group.make_context = lambda *_, **__: kill()
elif sys.argv[1] == "after the verb":
    import click
    click.Context.close = lambda _: kill()
elif sys.argv[1] == "threads":
    threading._register_atexit(kill)
elif sys.argv[1] == "atexit":
    import vsgdesign.execution.signals as signals
    original = signals.signals_end_for_good
    def patched(end):
        original(end)
        atexit.register(kill)
    signals.signals_end_for_good = patched
elif sys.argv[1] == "last":
    class Last:
        def __del__(self, kill=kill):
            kill()
    last = Last()
sys.argv = ["vsgdesign", "validate", sys.argv[2]]
from vsgdesign.verbs.cli.program import main
main()
"""
_COMPLETE = "interrupted: the command was complete\n"


@pytest.mark.parametrize(
    ("moment", "code", "says"),
    [
        ("before the verb", 130, "interrupted: nothing was written\n"),
        ("after the verb", 130, _COMPLETE),
        ("threads", 130, _COMPLETE),
        ("atexit", 130, _COMPLETE),
        ("last", 0, ""),
    ],
)
def test_a_signal_before_and_after_the_verb(moment: str, code: int, says: str, tmp_path: Path) -> None:
    """It was a traceback of Python's own end, or the statement that nothing was written."""
    command = [sys.executable, "-c", _AT_THE_END, moment, str(study_file(tmp_path))]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (code, says)
    assert ("valid" in done.stdout) is (moment != "before the verb")


def test_a_full_standard_output(tmp_path: Path) -> None:
    study_file(tmp_path)
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        command = [*COMMAND, "validate", "small.toml"]
        done = subprocess.run(command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr == "error: cannot write: No space left on device. Choose a place with enough space.\n"


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs a POSIX terminal")
@pytest.mark.parametrize(
    ("number", "code", "word"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated"), (signal.SIGHUP, 129, "hung up")],
)
def test_interruption(number: int, code: int, word: str, tmp_path: Path) -> None:
    """A signal once the progress bar shows that the run is under way: its code, one line, nothing left behind."""
    text = SMALL.replace('duration = "0.3 s"', 'duration = "3000 s"\nlog_interval = "1 s"')
    study_file(tmp_path, text)
    (tmp_path / "parent").mkdir()
    ours, theirs = os.openpty()
    command = [*COMMAND, "simulate", "small.toml", "--out", "parent/out"]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=theirs, env=os.environ | {"TERM": "xterm"}
    )
    os.close(theirs)
    shown = ""
    try:
        end = time.monotonic() + 90.0
        while not re.search(r"simulate fixed", shown) and time.monotonic() < end:
            if select.select([ours], [], [], 0.2)[0]:
                shown += os.read(ours, 4096).decode(errors="replace")
        assert "simulate fixed" in shown
        assert process.poll() is None, "it finished before it could be interrupted"
        assert [path.name.startswith(".out.") for path in (tmp_path / "parent").iterdir()] == [True]
        process.send_signal(number)
        while select.select([ours], [], [], 0.2)[0] or process.poll() is None:
            try:
                shown += os.read(ours, 4096).decode(errors="replace")
            except OSError:  # the other end is closed
                break
        stdout, _ = process.communicate(timeout=90)
    finally:
        process.kill()
        process.wait()
        os.close(ours)
    assert process.returncode == code, shown
    assert f"{word}: nothing was written" in shown
    assert "Traceback" not in shown
    assert stdout == b""
    assert list((tmp_path / "parent").iterdir()) == []
