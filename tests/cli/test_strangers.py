"""What a file from a stranger can do, as SECURITY.md says it."""

from __future__ import annotations

import ast
import io
import json
import pickle
import re
import socket
import tomllib
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from tests.cli.small_studies import SMALL, call, failure, study_file
from vsgdesign.artifacts.time_series import read_npz
from vsgdesign.errors import ArtifactError, StudyError
from vsgdesign.estimator.data_set import read_arrays
from vsgdesign.study.given_files import MOST_LEVELS, parse_toml
from vsgdesign.study.parameters.record import read_record
from vsgdesign.study.parameters.record_columns import RecordError

PACKAGE = Path(__file__).resolve().parents[2] / "vsgdesign"
SECRET = 'SECRET-4711 line\n= "SECRET-4711"\n'
NAMED = {
    "base": "base = 'secret.txt'",
    "table": f"{SMALL}\n[[controllers]]\nname = 't'\nkind = 'scheduled'\nschedule = 'table'\ntable = 'secret.txt'",
    "weights": f"{SMALL}\n[[controllers]]\nname = 't'\nkind = 'scheduled'\nestimate = 'neural'\n"
    "[estimator]\nweights = 'secret.txt'",
    "recipe": f"{SMALL}\n[[controllers]]\nname = 't'\nkind = 'scheduled'\nestimate = 'neural'\n"
    "[estimator]\nrecipe = '../secret.toml'",
    "record": f"{SMALL}\n[replay]\nfile = '../secret.txt'\nscale = '1 V'\nsampling_rate = '10 kHz'",
}


class Payload:
    """Writes a file when it is unpickled."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.write_text, (self.place, "executed")


@pytest.mark.parametrize(
    ("read", "error"),
    [
        (read_npz, ArtifactError),
        (read_arrays, ArtifactError),
        (lambda path: read_record(str(path), None, None), RecordError),
    ],
)
def test_a_pickle_in_an_archive_is_not_executed(read: Any, error: type[Exception], tmp_path: Path) -> None:
    np.savez(tmp_path / "payload.npz", allow_pickle=True, v=np.array([Payload(tmp_path / "executed")], dtype=object))
    with pytest.raises(error):
        read(tmp_path / "payload.npz")
    assert not (tmp_path / "executed").exists()
    pickle.loads(pickle.dumps(Payload(tmp_path / "executed")))  # noqa: S301 - that it would have been
    assert (tmp_path / "executed").exists()


def test_nothing_of_a_file_is_executed() -> None:
    """No module evaluates a text, and pickles come from the processes that the program has started."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if re.search(r"eval\(|exec\(|__import__|pickle|marshal|shelve|os\.system|popen|shell=|yaml|allow_pickle", text):
            calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
            names = {ast.unparse(node.func) for node in calls}
            given = {f"{one.arg}={ast.unparse(one.value)}" for node in calls for one in node.keywords}
            bad = names & {"eval", "exec", "__import__", "os.system", "os.popen", "pickle.load", "pickle.loads"}
            found |= {(path.stem, one) for one in bad | (given & {"shell=True", "allow_pickle=True"})}
    assert found == {("workers", "pickle.loads")}


@pytest.mark.parametrize("kind", NAMED)
def test_an_error_does_not_show_what_is_in_a_file_that_a_study_names(kind: str, tmp_path: Path) -> None:
    folder = tmp_path / "study"
    folder.mkdir()
    for name in ("secret.txt", "secret.toml", "study/secret.txt"):
        (tmp_path / name).write_text(SECRET, encoding="utf-8")
    (folder / "study.toml").write_text(NAMED[kind], encoding="utf-8")
    said = failure(2, "validate", folder / "study.toml")
    assert "fault" in said
    assert "SECRET" not in said


def test_a_study_opens_no_connection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> NoReturn:
        raise AssertionError("a connection")

    monkeypatch.setattr(socket.socket, "connect", refused)
    monkeypatch.setattr(socket.socket, "bind", refused)
    assert call("simulate", study_file(tmp_path), "--out", tmp_path / "out").exit_code == 0


def test_a_terminal_obeys_no_title(tmp_path: Path) -> None:
    title = 'title = "\\u001b]0;mine\\u0007\\u009b31m"\n'
    path = study_file(tmp_path, SMALL.replace("[study]\n", f"[study]\n{title}"))
    done = call("simulate", path, "--out", tmp_path / "out")
    assert "\ufffd]0;mine\ufffd\ufffd31m" in done.stdout
    assert not set(done.stdout) & set("\x1b\x07\x9b")
    (tmp_path / "out.toml").write_text('[study]\n"\\u001b[31m" = 1\n', encoding="utf-8")
    assert "study.\ufffd[31m: unknown field" in failure(2, "validate", tmp_path / "out.toml")


def test_a_key_of_many_parts_is_refused_before_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """A megabyte of dots took minutes: the time goes with its square."""
    deep = ".".join(["a", '"b.c"'] * MOST_LEVELS) + " = 1"
    fine = f'a = "{"One. " * 2 * MOST_LEVELS}"\nb = [{"1.5, " * 2 * MOST_LEVELS}]\n'
    assert set(parse_toml(fine, "fine")) == {"a", "b"}
    monkeypatch.setattr(tomllib, "loads", lambda _: pytest.fail("it was read"))
    with pytest.raises(StudyError, match=f"more than {MOST_LEVELS} levels"):
        parse_toml(f"{fine}{deep}", "deep")


def test_what_would_never_end_is_refused(tmp_path: Path) -> None:
    """A map over two lists of 18,000 values took memory until it was ended."""
    axis = [round(2.0 + k / 1e3, 3) for k in range(1001)]
    path = study_file(tmp_path, f"{SMALL}\n[stability]\nscr = {axis}\n", duration='"36001 s"')
    said = failure(2, "validate", path)
    assert "stability.scr: has 1001 values, more than 1000" in said
    assert "outside 1 ms to 36 ks" in said


def test_json_is_as_it_was_given(tmp_path: Path) -> None:
    """What a program reads keeps every letter, escaped."""
    path = study_file(tmp_path, SMALL.replace("[study]\n", '[study]\ntitle = "\\u001b"\n'))
    text = call("simulate", path, "--out", tmp_path / "out", "--json").stdout
    assert "\x1b" not in text
    assert json.load(io.StringIO(text))["study"]["title"] == "\x1b"
