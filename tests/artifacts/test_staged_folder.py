"""A folder of results appears whole or not at all, and never at the cost of something else."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from vsgdesign.artifacts import files, guarded_file, staged_folder, write_record
from vsgdesign.errors import ArtifactError

VERB = "vsgdesign test"


def tree(folder: Path) -> dict[str, str]:
    """Every file below a folder with its text, hidden ones included."""
    return {str(path.relative_to(folder)): path.read_text() for path in sorted(folder.rglob("*")) if path.is_file()}


def write_run(target: Path, text: str, verb: str = VERB, inputs: tuple[Path, ...] = ()) -> None:
    with staged_folder(target, verb, inputs=inputs) as folder:
        (folder / "figures").mkdir()
        (folder / "figures" / "one.svg").write_text(text)
        write_record(folder, {"text": text}, verb)


def text_of(target: Path) -> str:
    return json.loads((target / "results.json").read_text())["text"]


def refusal(target: Path, match: str, verb: str = VERB, inputs: tuple[Path, ...] = ()) -> str:
    """The sentence of a refusal, which must come before the block runs and change nothing."""
    before = tree(target)
    with pytest.raises(ArtifactError, match=match) as raised, staged_folder(target, verb, inputs=inputs):
        pytest.fail("the block must not run")
    assert tree(target) == before
    message = str(raised.value)
    assert "\n" not in message
    return message


def test_a_new_folder_lists_what_was_written(tmp_path: Path) -> None:
    write_run(tmp_path / "out", "1")
    record = json.loads((tmp_path / "out" / "results.json").read_text())
    assert set(tree(tmp_path)) == {"out/figures/one.svg", "out/results.json"}
    assert record["kind"] == VERB
    # sha256 of "1", as sha256sum prints it
    assert record["files"] == {"figures/one.svg": "6b86b273ff34fce19d6b804eff5a3f5747ada4eaa22f1d49c01e52ddb7875b4b"}


def test_what_is_not_finite_is_null_in_the_file_alone(tmp_path: Path) -> None:
    """The terminal's tables still tell ∞ from nothing."""
    with staged_folder(tmp_path / "out", VERB) as folder:
        whole = write_record(folder, {"settles": float("inf")}, VERB)
    assert whole["settles"] == float("inf")
    record = json.loads((tmp_path / "out" / "results.json").read_text())
    assert record == whole | {"settles": None}
    with staged_folder(tmp_path / "out", VERB) as folder:  # and it is still an unchanged one
        write_record(folder, {}, VERB)


def test_it_is_not_there_before_the_end(tmp_path: Path) -> None:
    with staged_folder(tmp_path / "out", VERB) as folder:
        write_record(folder, {}, VERB)
        assert not (tmp_path / "out").exists()
        assert folder.stat().st_dev == tmp_path.stat().st_dev  # a rename within one file system
    assert (tmp_path / "out").is_dir()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_missing_parents_are_made_and_taken_away_after_an_error(tmp_path: Path) -> None:
    write_run(tmp_path / "a" / "b" / "out", "1")
    assert text_of(tmp_path / "a" / "b" / "out") == "1"
    with pytest.raises(RuntimeError), staged_folder(tmp_path / "c" / "d" / "out", VERB):
        raise RuntimeError
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    write_run(tmp_path / "out", "1")
    assert text_of(tmp_path / "out") == "1"


def test_an_unchanged_earlier_result_is_replaced_whole(tmp_path: Path) -> None:
    with staged_folder(tmp_path / "out", VERB) as folder:
        (folder / "stale.csv").write_text("from the run before")
        write_record(folder, {}, VERB)
    write_run(tmp_path / "out", "2")
    assert set(tree(tmp_path)) == {"out/figures/one.svg", "out/results.json"}
    (tmp_path / "out" / "figures" / "one.svg").unlink()  # what the user removed is no loss
    write_run(tmp_path / "out", "3")
    assert text_of(tmp_path / "out") == "3"


def test_others_may_read_it(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        write_run(tmp_path / "out", "1")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "out").stat().st_mode) == 0o755


def test_a_relative_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_run(Path("out/run"), "1")
    assert text_of(tmp_path / "out" / "run") == "1"


def test_spaces_and_letters_of_other_languages(tmp_path: Path) -> None:
    out = tmp_path / "Übergabe 3 – [final]*" / "Прогон 1"
    write_run(out, "1")
    write_run(out, "2")
    assert text_of(out) == "2"
    assert [path.name for path in out.parent.iterdir()] == [out.name]


@pytest.mark.parametrize("name", ["notes.txt", "figures/mine.svg", "deep/er/still.txt", ".hidden"])
def test_one_more_file_and_the_folder_is_left_alone(name: str, tmp_path: Path) -> None:
    write_run(tmp_path / "out", "1")
    path = tmp_path / "out" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("years of work")
    message = refusal(tmp_path / "out", f'holds {re.escape(name)}, which "{VERB}" did not write')
    assert message.endswith("is left untouched. Give a new or an empty folder, or remove this one.")


def test_a_link_in_it_is_one_more_file(tmp_path: Path) -> None:
    write_run(tmp_path / "out", "1")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out" / "data").symlink_to(tmp_path / "elsewhere")
    refusal(tmp_path / "out", "holds data, which")
    (tmp_path / "out" / "data").unlink()
    svg = tmp_path / "out" / "figures" / "one.svg"
    (tmp_path / "one.svg").write_text("1")
    svg.unlink()
    svg.symlink_to(tmp_path / "one.svg")  # the same bytes, but somebody made the link
    refusal(tmp_path / "out", "holds figures/one.svg, which was changed since")


@pytest.mark.parametrize("name", ["figures/one.svg", "results.json"])
def test_one_changed_byte_and_the_folder_is_left_alone(name: str, tmp_path: Path) -> None:
    write_run(tmp_path / "out", "1")
    path = tmp_path / "out" / name
    path.write_text(path.read_text().replace("1", "2", 1))
    refusal(tmp_path / "out", f"holds .*{name}.*changed")


def test_a_re_formatted_record_is_a_changed_one(tmp_path: Path) -> None:
    write_run(tmp_path / "out", "1")
    path = tmp_path / "out" / "results.json"
    path.write_text(path.read_text() + "\n")
    refusal(tmp_path / "out", "results.json that was changed, or that an earlier version wrote")


def test_another_verbs_result_is_left_alone(tmp_path: Path) -> None:
    write_run(tmp_path / "out", "1", "vsgdesign simulate")
    refusal(
        tmp_path / "out", 'holds the results of "vsgdesign simulate", not of "vsgdesign report"', "vsgdesign report"
    )


def test_an_earlier_versions_result_is_left_alone(tmp_path: Path) -> None:
    """It does not say what was written, so nobody knows what else is in it."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "results.json").write_text('{\n "schema": 1\n}\n')
    (tmp_path / "out" / "chapter.tex").write_text("years of work")
    refusal(tmp_path / "out", "an earlier version wrote without a list")


def test_a_folder_with_other_files_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    refusal(tmp_path / "thesis", "thesis.*holds chapter.tex, and no results.json.*left untouched. Give a new")


def test_a_folder_with_the_input_in_it_is_refused(tmp_path: Path) -> None:
    """Also where the input is itself a file of an unchanged result, and where a link hides the place."""
    write_run(tmp_path / "out", "1")
    given = tmp_path / "out" / "figures" / "one.svg"
    (tmp_path / "link").symlink_to(tmp_path / "out")
    for path in (given, tmp_path / "link" / "figures" / "one.svg"):
        refusal(tmp_path / "out", "which is read here", inputs=(path,))
        refusal(tmp_path / "link", "which is read here", inputs=(path,))
    write_run(tmp_path / "out", "2", inputs=(tmp_path / "elsewhere.toml",))


@pytest.mark.parametrize("where", [".", "..", "/", "figures/.."])
def test_the_folder_that_one_is_in_is_refused(where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_run(tmp_path / "out", "1")
    monkeypatch.chdir(tmp_path / "out")
    with pytest.raises(ArtifactError, match="the folder that you are in"), staged_folder(where, VERB):
        pytest.fail("the block must not run")


def test_a_folder_that_becomes_foreign_meanwhile_is_refused_too(tmp_path: Path) -> None:
    def run() -> None:
        with staged_folder(tmp_path / "out", VERB) as folder:
            write_record(folder, {}, VERB)
            (tmp_path / "out").mkdir()
            (tmp_path / "out" / "chapter.tex").write_text("years of work")

    with pytest.raises(ArtifactError, match=r"holds chapter\.tex"):
        run()
    assert tree(tmp_path) == {"out/chapter.tex": "years of work"}


def test_a_folder_of_that_name_that_only_looks_like_ours(tmp_path: Path) -> None:
    """results.json as a folder, or as a link to a good one, lists nothing."""
    (tmp_path / "out" / "results.json").mkdir(parents=True)
    refusal(tmp_path / "out", "was changed")
    write_run(tmp_path / "good", "1")
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "results.json").symlink_to(tmp_path / "good" / "results.json")
    refusal(tmp_path / "bad", "was changed")


def test_a_linked_folder_stays_linked(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    for text in "12":
        write_run(tmp_path / "out", text)
    assert (tmp_path / "out").is_symlink()
    assert text_of(tmp_path / "disk") == "2"
    (tmp_path / "new").symlink_to(tmp_path / "not yet" / "there")
    write_run(tmp_path / "new", "3")
    assert (tmp_path / "new").is_symlink()
    assert text_of(tmp_path / "not yet" / "there") == "3"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["disk", "new", "not yet", "out"]


def test_a_file_and_a_circle_of_links_are_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(ArtifactError, match="is a file; give a folder"), staged_folder(tmp_path / "out", VERB):
        pytest.fail("the block must not run")
    assert tree(tmp_path) == {"out": "a file"}
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    with pytest.raises(ArtifactError), staged_folder(tmp_path / "a", VERB):
        pytest.fail("the block must not run")
    assert (tmp_path / "a").is_symlink()


def test_a_folder_that_may_not_be_written_to_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Said by os.access, as the tests may run as root, who may write everywhere."""
    (tmp_path / "out").mkdir()
    monkeypatch.setattr(guarded_file.os, "access", lambda path, _: Path(path) != tmp_path / "out")
    with pytest.raises(ArtifactError, match="may be written to"), staged_folder(tmp_path / "out", VERB):
        pytest.fail("the block must not run")
    monkeypatch.setattr(guarded_file.os, "access", lambda path, _: Path(path) != tmp_path)
    with pytest.raises(ArtifactError, match="Permission denied in"), staged_folder(tmp_path / "a" / "b", VERB):
        pytest.fail("the block must not run")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_parent_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("a file")
    target = tmp_path / "notes.txt" / "out"
    with pytest.raises(ArtifactError, match="is not a folder"), staged_folder(target, VERB):
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
        with staged_folder(tmp_path / "out", VERB) as folder:
            (folder / "results.json").write_text("half")
            raise stop

    with pytest.raises(stop):
        run()
    assert tree(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == (["out"] if earlier else [])


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.ENOSPC, "No space left on device. Free some space"),
        (errno.EDQUOT, "quota exceeded. Remove what"),
        (errno.EIO, "Give a place"),
    ],
)
def test_a_full_disk_is_one_line_and_leaves_nothing(number: int, said: str, tmp_path: Path) -> None:
    def run() -> None:
        with staged_folder(tmp_path / "a" / "out", VERB) as folder:
            (folder / "series.npz").write_text("half")
            raise OSError(number, os.strerror(number))

    with pytest.raises(ArtifactError, match=f'^cannot write "{tmp_path}/a/out": .*{said}[^\n]*$'):
        run()
    assert list(tmp_path.iterdir()) == []


def test_a_name_as_long_as_names_may_be_and_one_longer(tmp_path: Path) -> None:
    for text in "12":
        write_run(tmp_path / ("n" * 255), text)
    assert text_of(tmp_path / ("n" * 255)) == "2"
    with pytest.raises(ArtifactError, match=r"File name too long\. Give a shorter name"):
        write_run(tmp_path / ("n" * 256), "1")
    assert len(list(tmp_path.iterdir())) == 1


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
        calls += Path(source).is_dir()
        if calls == at:
            calls += 1
            raise stop
        replace(source, target)

    monkeypatch.setattr(files.os, "replace", failing)
    raised = ArtifactError if stop is OSError else stop
    with pytest.raises(raised):
        write_run(tmp_path / "out", "2")
    assert calls > at
    assert tree(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_two_at_a_time_do_not_meet(tmp_path: Path) -> None:
    with staged_folder(tmp_path / "out", VERB) as first, staged_folder(tmp_path / "out", VERB) as second:
        assert first != second
        write_record(first, {"text": "1"}, VERB)
        write_record(second, {"text": "2"}, VERB)
    assert text_of(tmp_path / "out") == "1"  # the last to finish
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


_KILLED = """
import os, signal, sys
from vsgdesign.artifacts import files, staged_folder, write_record
with staged_folder(sys.argv[1], "vsgdesign test") as folder:
    (folder / "half.csv").write_text("half")
    if sys.argv[2] == "between":
        replace, moved = os.replace, []
        def once(source, target):
            if moved:
                os.kill(os.getpid(), signal.SIGKILL)
            moved.append(replace(source, target))
        write_record(folder, {}, "vsgdesign test")
        files.os.replace = once
    else:
        os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("moment", ["writing", "between"])
def test_what_a_kill_left_is_swept_and_the_old_result_put_back(tmp_path: Path, moment: str) -> None:
    """kill -9 while writing, and between the two renames, when the old result lies in the hidden folder."""
    out = tmp_path / "out"
    write_run(out, "1")
    killed = subprocess.run([sys.executable, "-c", _KILLED, str(out), moment], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert out.is_dir() == (moment == "writing")
    assert len(list(tmp_path.glob(".out.*"))) == 1
    with pytest.raises(RuntimeError), staged_folder(out, VERB):
        raise RuntimeError  # even one that comes to nothing finds the old result in its place
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert text_of(out) == "1"


def test_what_a_living_process_writes_is_not_swept(tmp_path: Path) -> None:
    with staged_folder(tmp_path / "out", VERB) as folder:
        write_run(tmp_path / "out", "2")
        assert folder.is_dir()
        write_record(folder, {"text": "1"}, VERB)
    assert text_of(tmp_path / "out") == "1"


@pytest.mark.parametrize("windows", [False, True])
def test_a_lock_goes_with_its_folder(windows: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While it is held, so that nobody takes it in between; but Windows removes no file that is open."""
    monkeypatch.setattr(files, "WINDOWS", windows)
    open_then: list[bool] = []

    def tidy() -> None:
        with files.locked_by_the_dead(tmp_path / "lock") as dead:
            open_then.append(not dead)

    with files.locked(tmp_path / "lock", tidy), pytest.raises(files.LockedError), files.locked(tmp_path / "lock"):
        pytest.fail("it is held")
    assert open_then == [not windows]
    write_run(tmp_path / "out", "1")
    write_run(tmp_path / "out", "2")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lock", "out"]
