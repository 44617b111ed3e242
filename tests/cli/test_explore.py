"""The verb explore: what it refuses, what it serves, and how it ends."""

from __future__ import annotations

import json
import select
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.cli.small_studies import call, study_file

COMMAND = [sys.executable, "-m", "vsgdesign.verbs.cli.program", "explore"]


def _line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    assert select.select([process.stdout], [], [], 60.0)[0]
    return process.stdout.readline()


@contextmanager
def _explorer(folder: Path, *arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A running explorer and its address."""
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [*COMMAND, *arguments, "--no-browser"], cwd=folder, stdout=pipe, stderr=pipe, text=True
    ) as one:
        try:
            line = _line(one)
            assert line.startswith("explorer: http://127.0.0.1:"), one.stderr and one.stderr.read()
            yield one, line.split()[1]
        finally:
            if one.poll() is None:
                one.kill()


def _get(address: str) -> bytes:
    with urllib.request.urlopen(address, timeout=60.0) as response:
        return response.read()


def _refused(*arguments: str | Path) -> str:
    """What the verb says where its input is wrong. The address is printed before the input is read."""
    shown = call("explore", *arguments, "--no-browser")
    assert shown.exit_code == 2, shown.output
    assert isinstance(shown.exception, SystemExit), shown.exception
    assert shown.stdout.startswith("explorer: http://127.0.0.1:")
    assert shown.stdout.count("\n") == 1
    return shown.stderr


def test_it_serves_a_study_until_ctrl_c(tmp_path: Path) -> None:
    study_file(tmp_path)
    with _explorer(tmp_path, "small.toml", "--state", '{"scr": 4}') as (process, link):
        address, hash_, part = link.partition("#")
        assert (hash_, part) == ("#", "%7B%22scr%22%3A%204%7D")
        assert b"<html" in _get(address)
        end = time.monotonic() + 60.0
        while not (info := json.loads(_get(address + "study")))["ready"]:
            assert time.monotonic() < end
        assert info["study"]["name"] == "small"
        with pytest.raises(urllib.error.HTTPError, match="404"):
            _get(address.rpartition("/")[0][:-1] + "x/study")
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=60)
    assert process.returncode == 0
    assert out == ""
    assert errors.splitlines()[-1] == "The explorer has ended."
    assert "Traceback" not in errors
    assert [path.name for path in tmp_path.iterdir()] == ["small.toml"]


def test_a_study_with_faults_ends_it_and_says_them_all(tmp_path: Path) -> None:
    study_file(tmp_path, 'colour = "red"\n[power_loops]\ntau_P = "1 V"\n')
    message = _refused(tmp_path / "small.toml")
    assert "colour: unknown field" in message
    assert "power_loops.tau_P" in message


def test_a_file_that_is_missing_is_said_before_anything_is_served(tmp_path: Path) -> None:
    shown = call("explore", tmp_path / "none.toml", "--no-browser")
    assert shown.exit_code == 2
    assert "explorer:" not in shown.output
    assert "no such file" in shown.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("table.json",), "--study names the study"),
        (("small.toml", "--controller", "x"), "--controller says whose gain table"),
        (("small.toml", "--bridge", "pwm"), "--page names its file"),
        (("small.toml", "--bridge", "square", "--page", "page.html"), "'averaged', 'pwm'"),
        (("small.toml", "--port", "0"), "--port"),
        (("small.toml", "--port", "70000"), "--port"),
    ],
)
def test_options_that_make_no_sense(tmp_path: Path, arguments: tuple[str, ...], words: str) -> None:
    study_file(tmp_path)
    (tmp_path / "table.json").write_text("{}", encoding="utf-8")
    first, *rest = arguments
    shown = call("explore", tmp_path / first, *rest, "--no-browser")
    assert shown.exit_code == 2
    assert words in shown.output


def test_a_port_that_is_taken_is_said(tmp_path: Path) -> None:
    path = study_file(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        shown = call("explore", path, "--no-browser", "--port", taken.getsockname()[1])
    assert shown.exit_code == 2
    assert "cannot be used" in shown.output


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ("nonsense", "nonsense is not the state of a link"),
        ('{"scr": -1, "x_over_r": "a"}', "SCR must be"),
        ('{"typo": 1}', "typo"),
    ],
)
def test_a_wrong_state_is_said(tmp_path: Path, state: str, words: str) -> None:
    path = study_file(tmp_path)
    message = _refused(path, "--state", state)
    assert words in message


def test_a_table_of_another_converter_is_refused(tmp_path: Path) -> None:
    path = study_file(tmp_path)
    (tmp_path / "table.json").write_text("{}", encoding="utf-8")
    message = _refused(tmp_path / "table.json", "--study", path)
    assert "no controller of the study has a gain table" in message
