"""Files that are none, or too large: told at once, by everything that reads a file of the user."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from vsgdesign.artifacts import read_table_file
from vsgdesign.artifacts.field_weights import FIELD_WEIGHTS_FILE
from vsgdesign.artifacts.network_weights import WEIGHTS_FILE
from vsgdesign.artifacts.time_series import read_npz
from vsgdesign.campaigns.compliance.evidence import read_evidence
from vsgdesign.errors import ArtifactError, StudyError
from vsgdesign.estimator.data_set import read_arrays
from vsgdesign.study.datasheet import read_sheet
from vsgdesign.study.given_files import (
    MB,
    RECORD_BYTES,
    TABLE_BYTES,
    TOML_BYTES,
    WEIGHTS_BYTES,
    WINDOWS_BYTES,
    check_unpacked,
    open_given,
    read_given,
    read_toml,
)
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.record import read_record
from vsgdesign.study.parameters.record_columns import RecordError

READERS = {
    "table": (read_table_file, ArtifactError),
    "weights": (WEIGHTS_FILE.read, ArtifactError),
    "field weights": (FIELD_WEIGHTS_FILE.read, ArtifactError),
    "series": (read_npz, ArtifactError),
    "windows": (read_arrays, ArtifactError),
    "trace": (read_evidence, ArtifactError),
    "study": (load_study, StudyError),
    "suite": (lambda path: read_toml(path, "suite file"), StudyError),
    "datasheet": (read_sheet, StudyError),
    "record": (lambda path: read_record(str(path), None, None), RecordError),
}


@pytest.mark.parametrize("kind", READERS)
def test_a_pipe_or_a_device_is_refused_at_once(tmp_path: Path, kind: str) -> None:
    """/dev/zero was read until memory ended, and a pipe was waited for."""
    read, error = READERS[kind]
    suffix = {"record": "csv", "series": "npz", "windows": "npz"}.get(kind, "toml")
    os.mkfifo(tmp_path / f"pipe.{suffix}")
    (tmp_path / f"device.{suffix}").symlink_to("/dev/zero")
    for name in ("pipe", "device"):
        with pytest.raises(error, match=r"(is|it is) a pipe or a device"):
            read(tmp_path / f"{name}.{suffix}")
    (tmp_path / f"folder.{suffix}").mkdir()
    with pytest.raises(error, match="is a folder"):
        read(tmp_path / f"folder.{suffix}")


@pytest.mark.parametrize("kind", READERS)
def test_a_file_beyond_the_limit_of_its_kind_is_refused(tmp_path: Path, kind: str) -> None:
    """The files have holes: they take no room on the disk."""
    read, error = READERS[kind]
    path = tmp_path / ("large." + {"record": "wav", "series": "npz", "windows": "npz"}.get(kind, "toml"))
    with path.open("wb") as stream:
        stream.truncate(20_000_000_001)
    with pytest.raises(error, match=r"2e\+04 MB, and the limit of its kind is .* MB"):
        read(path)


def test_files_of_the_system_say_that_they_are_empty(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"it has more, and the limit of its kind is 0\.0001 MB"):
        read_given("/proc/self/maps", 100)
    assert read_given("/proc/self/comm", 100)
    with pytest.raises(OSError, match="a character that no name"):
        open_given("a\0b", 1)
    (tmp_path / "limit").write_bytes(b" " * TOML_BYTES)
    assert len(read_given(tmp_path / "limit", TOML_BYTES)) == TOML_BYTES


def test_an_archive_is_weighed_unpacked(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("v.npy", bytes(3_000_000))
    with open_given(tmp_path / "bomb.npz", 10_000) as stream, pytest.raises(OSError, match="3 MB unpacked"):
        check_unpacked(stream, 2_000_000)
    np.savez(tmp_path / "good.npz", v=np.zeros(3))
    with open_given(tmp_path / "good.npz", 10_000) as stream:
        check_unpacked(stream, 10_000)
        assert np.load(stream)["v"].shape == (3,)


@pytest.mark.parametrize(
    ("page", "limit"),
    [
        ("study-file.md", TOML_BYTES),
        ("how-to/own-converter.md", TOML_BYTES),
        ("gain-table-file.md", TABLE_BYTES),
        ("how-to/estimator.md", WEIGHTS_BYTES),
        ("how-to/recorded-grids.md", RECORD_BYTES),
        ("how-to/windows.md", WINDOWS_BYTES),
    ],
)
def test_each_page_states_the_limit_of_its_files(page: str, limit: int) -> None:
    text = (Path(__file__).parents[2] / "docs" / page).read_text(encoding="utf-8")
    assert f"at most {limit // MB} MB" in " ".join(text.split())
