"""Where results go: what --out may replace and what it never does, for every verb that has it."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest

from tests.artifacts.networks import random_weights
from tests.cli.small_studies import SMALL, as_json, call, failure, study_file
from tests.gain_tables import table
from vsgdesign.artifacts import write_table_file
from vsgdesign.artifacts.network_weights import write_network_weights
from vsgdesign.verbs.pipeline import run as running

FOLDER_VERBS = (
    ("run", "small.toml"),
    ("simulate", "small.toml"),
    ("report", "small.toml"),
    ("compare", "small.toml"),
    ("survive", "small.toml"),
    ("estimator", "compare", "small.toml"),
    ("estimator", "stress", "small.toml"),
    ("table", "report", "t.json"),
    ("export", "c", "t.json"),
)
FILE_VERBS = (
    ("table", "build", "small.toml"),
    ("estimator", "train", "small.toml"),
    ("estimator", "windows", "small.toml"),
    ("export", "onnx", "w.json"),
)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to be in, with a study, a table and a network."""
    specification = "\n[specification]\nscr = [2, 8]\nx_over_r = [1, 3]\n"
    study_file(tmp_path, SMALL + specification)
    write_table_file(table(), tmp_path / "t.json")
    write_network_weights(random_weights(samples=4), tmp_path / "w.json")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def everything(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.parametrize("verb", FOLDER_VERBS, ids=" ".join)
def test_a_folder_with_anything_else_in_it_is_left_alone(verb: tuple[str, ...], here: Path) -> None:
    """Before: any folder with a file of the name results.json in it was replaced, exit code 0."""
    (here / "thesis").mkdir()
    (here / "thesis" / "results.json").write_text('{\n "schema": 1\n}\n')
    (here / "thesis" / "chapter.tex").write_text("years of work")
    (here / "file").write_text("a file")
    (here / "linked").symlink_to("thesis")
    before = everything(here)
    for out, said in (
        ("thesis", "is left untouched. Give a new or an empty folder, or remove this one."),
        ("linked", "is left untouched. Give a new or an empty folder, or remove this one."),
        ("thesis/../thesis", "is left untouched."),
        ("file", "is a file; give a folder"),
        (".", "the folder that you are in"),
        ("..", "the folder that you are in"),
        ("/", "the folder that you are in"),
        ("/dev/full", "is a file; give a folder"),
        ("file/below", "is not a folder"),
        ("n" * 256, "File name too long. Give a shorter name."),
    ):
        message = failure(2, *verb, "--out", out)
        assert said in message, out
        assert message.count("\n") == 1
        assert everything(here) == before, out
    assert sorted(path.name for path in here.iterdir()) == [
        "file",
        "linked",
        "small.toml",
        "t.json",
        "thesis",
        "w.json",
    ]


@pytest.mark.parametrize("verb", FILE_VERBS, ids=" ".join)
def test_a_file_that_is_not_ours_is_left_alone(verb: tuple[str, ...], here: Path) -> None:
    (here / "notes").write_text("years of work")
    (here / "linked").symlink_to("notes")
    before = everything(here)
    for out, said in (
        ("notes", "is left untouched. Give another file"),
        ("linked", "is left untouched. Give another file"),
        ("small.toml", "is left untouched. Give another file"),
        (".", "it is a folder. Give a file"),
        ("/", "it is a folder. Give a file"),
        ("/dev/full", "it is a device or a pipe. Give a file"),
        ("notes/below", "is not a folder"),
        ("n" * 256, "File name too long. Give a shorter name."),
    ):
        message = failure(2, *verb, "--out", out)
        assert said in message, out
        assert message.count("\n") == 1
        assert everything(here) == before, out
    assert sorted(path.name for path in here.iterdir()) == ["linked", "notes", "small.toml", "t.json", "w.json"]


def test_the_study_is_not_deleted_by_a_second_call(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first call with --out . left results.json beside the study, the second took both away."""
    study = study_file(tmp_path)
    for _ in range(2):
        assert 'small.toml", which is read here. Give' in failure(2, "simulate", study, "--out", tmp_path)
        with monkeypatch.context() as there:
            there.chdir(tmp_path)
            assert "the folder that you are in" in failure(2, "simulate", "small.toml", "--out", ".")
    assert [path.name for path in tmp_path.iterdir()] == ["small.toml"]


def test_inputs_of_every_kind_are_kept(tmp_path: Path) -> None:
    """A base, a table, weights and a recipe in an unchanged result of the very verb: it is not replaced."""
    out = tmp_path / "out"
    as_json("simulate", study_file(tmp_path), "--out", out)
    inside = out / "fixed.csv"  # listed, unchanged
    text = SMALL.replace('base = "case:hoang2025_5kva"', f'base = "{inside}"')
    assert "it is a table of values" in failure(2, "simulate", study_file(tmp_path, text), "--out", out)
    scheduled = f'kind = "scheduled"\nschedule = "table"\ntable = "{inside}"'
    for addition in (
        SMALL.replace('kind = "scheduled"', scheduled),
        SMALL + f'\n[estimator]\nweights = "{inside}"\n',
        SMALL + f'\n[estimator]\nrecipe = "{out}/mine.toml"\n',
    ):
        assert "which is read here" in failure(2, "simulate", study_file(tmp_path, addition), "--out", out)
    assert inside.is_file()


def test_another_verbs_series_are_kept(tmp_path: Path) -> None:
    study, out = study_file(tmp_path), tmp_path / "out"
    as_json("simulate", study, "--out", out)
    before = everything(out)
    for verb in ("run", "report"):
        assert f'holds the results of "vsgdesign simulate", not of "vsgdesign {verb}"' in failure(
            2, verb, study, "--out", out
        )
    assert everything(out) == before


def test_results_list_what_was_written(tmp_path: Path) -> None:
    out = tmp_path / "Übung 3" / "out"
    document = as_json("simulate", study_file(tmp_path), "--out", out)
    assert document == json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert document["kind"] == "vsgdesign simulate"
    assert set(document["files"]) == set(everything(out)) - {"results.json"}
    (out / "fixed.csv").write_text("t\n")
    assert "holds fixed.csv, which was changed since" in failure(2, "simulate", tmp_path / "small.toml", "--out", out)


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(running, "write_npz", full)
    message = failure(2, "simulate", study_file(tmp_path), "--out", tmp_path / "a" / "out")
    assert message == (
        f'error: cannot write "{tmp_path}/a/out": No space left on device. '
        "Free some space, or give a place on another disk.\n"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["small.toml"]


def test_simulate_then_run_without_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each verb has a folder of its own: neither refuses the other's."""
    monkeypatch.chdir(tmp_path)
    study = study_file(tmp_path)
    for verb in ("simulate", "run", "simulate"):
        result = call(verb, study, *(["--no-explorer"] if verb == "run" else []))
        assert result.exit_code == 0, result.output
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["small", "small-simulation"]
