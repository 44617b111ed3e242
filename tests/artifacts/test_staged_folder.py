"""A folder of results appears whole or not at all, and never at the cost of something else."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from vsgdesign.artifacts import files as files_module
from vsgdesign.artifacts import staged_folder
from vsgdesign.errors import ArtifactError


def tree(folder: Path) -> dict[str, str]:
    """Every file below a folder with its text, hidden ones included."""
    return {str(path.relative_to(folder)): path.read_text() for path in sorted(folder.rglob("*")) if path.is_file()}


def write_run(target: Path, text: str) -> None:
    with staged_folder(target) as folder:
        (folder / "results.json").write_text(text)
        (folder / "figures").mkdir()
        (folder / "figures" / "one.svg").write_text(text)


def test_a_new_folder(tmp_path: Path) -> None:
    write_run(tmp_path / "out", "1")
    assert tree(tmp_path) == {"out/figures/one.svg": "1", "out/results.json": "1"}


def test_it_is_not_there_before_the_end(tmp_path: Path) -> None:
    with staged_folder(tmp_path / "out") as folder:
        (folder / "results.json").write_text("1")
        assert not (tmp_path / "out").exists()
        assert folder.parent == tmp_path  # beside the target: a rename within one file system
    assert (tmp_path / "out").is_dir()


def test_missing_parents_are_made(tmp_path: Path) -> None:
    write_run(tmp_path / "a" / "b" / "out", "1")
    assert (tmp_path / "a" / "b" / "out" / "results.json").read_text() == "1"


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    write_run(tmp_path / "out", "1")
    assert (tmp_path / "out" / "results.json").read_text() == "1"


def test_an_earlier_run_is_replaced_whole(tmp_path: Path) -> None:
    write_run(tmp_path / "out", "1")
    (tmp_path / "out" / "stale.csv").write_text("from the run before")
    write_run(tmp_path / "out", "2")
    assert tree(tmp_path) == {"out/figures/one.svg": "2", "out/results.json": "2"}


def test_others_may_read_it(tmp_path: Path) -> None:
    write_run(tmp_path / "out", "1")
    assert stat.S_IMODE((tmp_path / "out").stat().st_mode) == 0o755


def test_a_relative_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with staged_folder("out/run") as folder:
        (folder / "results.json").write_text("1")
    assert tree(tmp_path) == {"out/run/results.json": "1"}


def test_a_folder_with_other_files_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    message = "thesis.*holds other files.*left untouched; give a new"
    with pytest.raises(ArtifactError, match=message), staged_folder(tmp_path / "thesis"):
        pytest.fail("the block must not run")
    assert tree(tmp_path) == {"thesis/chapter.tex": "years of work"}


def test_a_folder_that_becomes_foreign_meanwhile_is_refused_too(tmp_path: Path) -> None:
    def run() -> None:
        with staged_folder(tmp_path / "out") as folder:
            (folder / "results.json").write_text("1")
            (tmp_path / "out").mkdir()
            (tmp_path / "out" / "chapter.tex").write_text("years of work")

    with pytest.raises(ArtifactError, match="holds other files"):
        run()
    assert tree(tmp_path) == {"out/chapter.tex": "years of work"}


def test_a_folder_of_that_name_that_only_looks_like_ours(tmp_path: Path) -> None:
    """results.json as a folder is no marker."""
    (tmp_path / "out" / "results.json").mkdir(parents=True)
    with pytest.raises(ArtifactError, match="holds other files"), staged_folder(tmp_path / "out"):
        pytest.fail("the block must not run")


def test_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(ArtifactError, match="is a file; give a folder"), staged_folder(tmp_path / "out"):
        pytest.fail("the block must not run")
    assert tree(tmp_path) == {"out": "a file"}


def test_a_folder_that_may_not_be_written_to_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Said by os.access, as the tests may run as root, who may write everywhere."""
    (tmp_path / "out").mkdir()
    monkeypatch.setattr(files_module.os, "access", lambda path, _: Path(path) != tmp_path / "out")
    with pytest.raises(ArtifactError, match="may be written to"), staged_folder(tmp_path / "out"):
        pytest.fail("the block must not run")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_parent_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("a file")
    with pytest.raises(ArtifactError, match="cannot write beside"), staged_folder(tmp_path / "notes.txt" / "out"):
        pytest.fail("the block must not run")
    assert tree(tmp_path) == {"notes.txt": "a file"}


@pytest.mark.parametrize("stop", [ValueError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("earlier", [True, False])
def test_an_error_or_interruption_leaves_what_was_there(
    tmp_path: Path, stop: type[BaseException], earlier: bool
) -> None:
    if earlier:
        write_run(tmp_path / "out", "1")
    before = tree(tmp_path)

    def run() -> None:
        with staged_folder(tmp_path / "out") as folder:
            (folder / "results.json").write_text("half")
            raise stop

    with pytest.raises(stop):
        run()
    assert tree(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == (["out"] if earlier else [])


@pytest.mark.parametrize("stop", [OSError, KeyboardInterrupt])
@pytest.mark.parametrize("at", [1, 2])
def test_an_interruption_while_the_folders_change_places(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop: type[BaseException], at: int
) -> None:
    """Between the renames the old results lie in a temporary folder: they must come back from it."""
    write_run(tmp_path / "out", "1")
    before = tree(tmp_path)
    calls = 0

    def failing(source: Path, target: Path, replace=os.replace) -> None:
        nonlocal calls
        calls += 1
        if calls == at:
            raise stop
        replace(source, target)

    monkeypatch.setattr(files_module.os, "replace", failing)
    raised = ArtifactError if stop is OSError else stop
    with pytest.raises(raised), staged_folder(tmp_path / "out") as folder:
        (folder / "results.json").write_text("2")
    assert calls >= at
    assert tree(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_two_at_a_time_do_not_meet(tmp_path: Path) -> None:
    with staged_folder(tmp_path / "out") as first, staged_folder(tmp_path / "out") as second:
        assert first != second
        (first / "results.json").write_text("1")
        (second / "results.json").write_text("2")
    assert tree(tmp_path) == {"out/results.json": "1"}  # the last to finish
