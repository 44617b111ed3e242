"""The file of a data set, and its splits."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from vsgdesign.errors import ArtifactError, StudyError
from vsgdesign.estimator.data_set import REASONS, DataSet, read_data_set, write_data_set

HEADER = {
    "recipe": {"channels": "phase_a", "samples": 3, "sample_interval": 2e-4},
    "seed": 1,
    "synchronised": True,
}


def data_set(scenarios: int = 10, each: int = 4) -> DataSet:
    rng, count = np.random.default_rng(0), scenarios * each
    return DataSet(
        windows=rng.normal(size=(count, 6)),
        scenario=np.repeat(np.arange(scenarios), each),
        after_change=np.arange(count) % 2 == 1,
        **{
            name: rng.uniform(1.0, 2.0, count)
            for name in ("R_g", "L_g", "P", "Q", "V_rms", "V_g_rms", "omega_g", "source_phase", "t_s")
        },
        redrawn=np.repeat(rng.integers(0, 2, (scenarios, len(REASONS))), each, axis=0),
        header=HEADER,
    )


def test_there_and_back(tmp_path: Path) -> None:
    data = data_set()
    write_data_set(tmp_path / "new" / "w.npz", data)
    back = read_data_set(tmp_path / "new" / "w.npz")
    assert back.hash == data.hash
    np.testing.assert_array_equal(back.windows, data.windows)
    assert back.header == HEADER
    assert (back.channels, back.samples, back.sample_interval, back.synchronised) == ("phase_a", 3, 2e-4, True)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["w.npz"]


def rewritten(path: Path, member: str, change: bytes) -> None:
    """The archive with one member's last bytes replaced: a valid npz with other content."""
    with zipfile.ZipFile(path) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    content[member] = content[member][: -len(change)] + change
    with zipfile.ZipFile(path, "w") as archive:
        for name, raw in content.items():
            archive.writestr(name, raw)


@pytest.mark.parametrize("member", ["windows.npy", "R_g.npy", "scenario.npy"])
def test_changed_content_is_refused(tmp_path: Path, member: str) -> None:
    path = tmp_path / "w.npz"
    write_data_set(path, data_set())
    rewritten(path, member, b"\x01\x02")
    with pytest.raises(ArtifactError, match="was changed since it was written"):
        read_data_set(path)


def test_a_changed_header_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "w.npz"
    write_data_set(path, data_set())
    with zipfile.ZipFile(path) as archive:
        text = archive.read("header.npy")
    rewritten(path, "header.npy", text[-200:].replace(b'"seed":1', b'"seed":2'))
    with pytest.raises(ArtifactError, match="was changed"):
        read_data_set(path)


def test_what_is_no_data_set_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "w.npz"
    with pytest.raises(ArtifactError, match="not a readable data set"):
        read_data_set(path)
    path.write_bytes(b"no archive")
    with pytest.raises(ArtifactError, match="not a readable data set"):
        read_data_set(path)
    np.savez(path, windows=np.zeros(3))
    with pytest.raises(ArtifactError, match="not a readable data set"):
        read_data_set(path)
    np.savez(path, windows=np.array([object()]), header=np.zeros(1, np.uint8))
    with pytest.raises(ArtifactError, match="not a readable data set"):  # pickled content is never unpacked
        read_data_set(path)
    with pytest.raises(ArtifactError, match="is not a data set of windows as it was written, and is left untouched"):
        write_data_set(path, data_set())
    path.unlink()
    write_data_set(path, replace(data_set(), windows=np.zeros((3, 6))))
    with pytest.raises(ArtifactError, match="is not a data set of windows: array shapes"):
        read_data_set(path)


def test_a_file_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ArtifactError, match="cannot write"):
        write_data_set(tmp_path / "file" / "w.npz", data_set())


@examples(25)
@given(st.integers(7, 40), st.integers(1, 6), st.integers(0, 5))
def test_no_scenario_is_in_two_parts(scenarios: int, each: int, seed: int) -> None:
    data = data_set(scenarios, each)
    split = data.split(seed=seed)
    parts = (split.training, split.validation, split.test)
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), np.arange(len(data)))
    named = [set(data.scenario[part]) for part in parts]
    assert sum(len(part) for part in named) == scenarios
    assert [len(part) / len(data) for part in parts] == pytest.approx([0.7, 0.15, 0.15], abs=1.0 / scenarios)
    again = data.split(seed=seed)
    np.testing.assert_array_equal(split.test, again.test)


def test_the_published_split_goes_by_window() -> None:
    data = data_set(scenarios=20, each=50)
    split = data.split("published_split", seed=3)
    assert (len(split.training), len(split.validation), len(split.test)) == (700, 150, 150)
    # Near-duplicates of almost every training scenario are in the test.
    assert len(set(data.scenario[split.training]) & set(data.scenario[split.test])) > 15
    assert not np.array_equal(split.test, data.split("published_split", seed=4).test)


def test_splits_that_cannot_be_made_are_refused() -> None:
    with pytest.raises(StudyError, match="scenarios = 2: too few"):
        data_set(scenarios=2).split()
    with pytest.raises(StudyError, match='split = "random": must be one of by_scenario, published_split'):
        data_set().split("random")
