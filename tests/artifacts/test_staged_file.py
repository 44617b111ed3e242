"""A single file appears whole or not at all, and replaces nothing but an unchanged one of its kind."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from tests.artifacts.networks import random_weights
from tests.gain_tables import table
from vsgdesign.artifacts import read_table_file, write_table_file
from vsgdesign.artifacts.files import staged_file
from vsgdesign.artifacts.network_weights import write_network_weights
from vsgdesign.errors import ArtifactError


def ours(path: Path) -> bool:
    return path.read_text(encoding="utf-8").startswith("ours")


def write(target: Path, text: str) -> None:
    with staged_file(target, "a text of ours", ours) as path:
        path.write_text(text)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_new_replaced_and_empty(tmp_path: Path) -> None:
    target = tmp_path / "a" / "t.txt"
    for text in ("ours 1", "ours 2"):
        write(target, text)
        assert target.read_text() == text
    target.write_text("")  # as mktemp leaves it: nothing is lost
    write(target, "ours 3")
    assert target.read_text() == "ours 3"
    assert names(target.parent) == ["t.txt"]


def test_what_is_not_ours_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "t.txt").write_text("years of work")
    with pytest.raises(ArtifactError, match=r'^".*t\.txt" is not a text of ours as it was written, and is left'):
        write(tmp_path / "t.txt", "ours")
    assert (tmp_path / "t.txt").read_text() == "years of work"
    assert names(tmp_path) == ["t.txt"]


def test_what_becomes_foreign_meanwhile_is_left_alone(tmp_path: Path) -> None:
    def run() -> None:
        with staged_file(tmp_path / "t.txt", "a text of ours", ours) as path:
            path.write_text("ours")
            (tmp_path / "t.txt").write_text("years of work")

    with pytest.raises(ArtifactError, match="left untouched"):
        run()
    assert (tmp_path / "t.txt").read_text() == "years of work"


def test_a_linked_file_stays_linked(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "t.txt").symlink_to(tmp_path / "disk" / "real.txt")
    for text in ("ours 1", "ours 2"):
        write(tmp_path / "t.txt", text)
        assert (tmp_path / "t.txt").is_symlink()
        assert (tmp_path / "disk" / "real.txt").read_text() == text


def test_devices_pipes_and_folders_are_refused(tmp_path: Path) -> None:
    """A rename would put a file in the device's place, for everybody."""
    os.mkfifo(tmp_path / "pipe")
    for target in (Path("/dev/full"), Path("/dev/null"), tmp_path / "pipe"):
        with pytest.raises(ArtifactError, match=r"it is a device or a pipe\. Give a file"):
            write(target, "ours")
        assert not target.is_file()
    with pytest.raises(ArtifactError, match=r"it is a folder\. Give a file"):
        write(tmp_path, "ours")


def test_a_full_disk_and_a_name_too_long(tmp_path: Path) -> None:
    def run() -> None:
        with staged_file(tmp_path / "t.txt", "a text of ours", ours):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(ArtifactError, match=r"No space left on device\. Free some space"):
        run()
    with pytest.raises(ArtifactError, match=r"File name too long\. Give a shorter name"):
        write(tmp_path / ("n" * 256), "ours")
    write(tmp_path / ("n" * 255), "ours")
    assert names(tmp_path) == ["n" * 255]


def test_tables_and_networks_replace_their_own_kind_alone(tmp_path: Path) -> None:
    path, weights = tmp_path / "t.json", tmp_path / "w.json"
    write_table_file(table(), path)
    write_table_file(table(name="second"), path)
    assert read_table_file(path).name == "second"
    write_network_weights(random_weights(samples=4), weights)
    before = path.read_bytes(), weights.read_bytes()
    with pytest.raises(ArtifactError, match="is not a trained network as it was written"):
        write_network_weights(random_weights(samples=4), path)
    with pytest.raises(ArtifactError, match="is not a gain table as it was written"):
        write_table_file(table(), weights)
    assert (path.read_bytes(), weights.read_bytes()) == before
    changed = before[0].replace(b"second", b"tuned!")
    path.write_bytes(changed)
    with pytest.raises(ArtifactError, match="is not a gain table as it was written"):
        write_table_file(table(), path)
    assert path.read_bytes() == changed
