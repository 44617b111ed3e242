"""The weights file: it comes back to the last bit, and refuses everything else."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evidence._table_mutations import FIELD, WINDOWS, Mutation
from evidence.table_mutations import Outcome, outcomes, read
from tests.artifacts.networks import random_weights
from vsgdesign.artifacts.field_weights import FIELD_WEIGHTS_FILE, PACKAGED
from vsgdesign.artifacts.guarded_file import GuardedFile, content_hash
from vsgdesign.artifacts.network_weights import (
    WEIGHTS_FILE,
    NetworkWeights,
    fit_scaling,
    read_network_weights,
    weights_document,
    write_network_weights,
)
from vsgdesign.errors import ArtifactError


@pytest.fixture
def file(tmp_path: Path) -> Path:
    write_network_weights(random_weights(samples=4), tmp_path / "weights.json")
    return tmp_path / "weights.json"


@pytest.mark.parametrize("channels", ["phase_a", "alpha_beta", "dq"])
def test_round_trip(tmp_path: Path, channels: str) -> None:
    weights = random_weights(3, channels)
    path = tmp_path / "weights.json"
    write_network_weights(weights, path)
    back = read_network_weights(path)
    assert back.hash == weights.hash
    assert weights_document(back) == weights_document(weights)
    assert back.trained_on == weights.trained_on
    assert np.array_equal(back.network.W_1, weights.network.W_1)
    assert not back.network.W_1.flags.writeable
    first = path.read_bytes()
    write_network_weights(back, path)
    assert path.read_bytes() == first


@given(st.data())
def test_a_changed_byte_is_refused(data: st.DataObject) -> None:
    text = TEXT
    at = data.draw(st.integers(0, len(text) - 1))
    byte = data.draw(st.integers(0, 255).filter(lambda value: value != text[at]))
    SCRATCH.write_bytes(text[:at] + bytes([byte]) + text[at + 1 :])
    with pytest.raises(ArtifactError):
        read_network_weights(SCRATCH)


@given(st.integers(0, 10**6))
def test_a_file_cut_short_is_refused(at: int) -> None:
    SCRATCH.write_bytes(TEXT[: at % len(TEXT)])
    with pytest.raises(ArtifactError):
        read_network_weights(SCRATCH)


TEXT = b""
SCRATCH = Path()


@pytest.fixture(scope="module", autouse=True)
def scratch(tmp_path_factory: pytest.TempPathFactory) -> None:
    """One good file's bytes, and where its variants are written."""
    global TEXT, SCRATCH
    SCRATCH = tmp_path_factory.mktemp("weights") / "weights.json"
    write_network_weights(random_weights(samples=2), SCRATCH)
    TEXT = SCRATCH.read_bytes()


def rewritten(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """The file with another content and the right hash for it, as a foreign or faulty writer would make it."""
    document = json.loads(path.read_text(encoding="utf-8"))
    del document["sha256"]
    change(document)
    document["sha256"] = content_hash(document)
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.update(schema=2), "schema 2.*update vsgdesign"),
        (lambda d: d.update(schema=True), "not a schema number"),
        (lambda d: d.update(kind="vsgdesign gain table"), "not a trained network"),
        (lambda d: d.update(outputs=["L_g", "R_g"]), "outputs"),
        (lambda d: d.pop("window"), "window"),
        (lambda d: d["network"].pop("b_2"), "b_2"),
        (lambda d: d["network"]["b_1"].pop(), "W_1: has shape"),
        (lambda d: d["network"]["W_1"][0].pop(), "not a complete trained network"),
        (lambda d: d["network"]["b_2"].__setitem__(0, None), "b_2: holds what is not a number"),
        (lambda d: d["network"]["inputs"]["deviation"].__setitem__(0, 0.0), "deviation: must be positive"),
        (lambda d: d["network"]["outputs"]["low"].__setitem__(0, 99.0), "below high"),
        (lambda d: d["window"].update(samples=5), "5 samples of phase_a are 10 inputs, but W_1 has 8"),
        (lambda d: d["window"].update(channels="abc"), "channels"),
        (lambda d: d["window"].update(sample_interval=-1.0), "sample_interval"),
        (lambda d: d["window"].update(synchronised=None), "synchronised"),
        (lambda d: d["trained_on"].pop("R_g"), "trained_on.R_g: is missing"),
        (lambda d: d["trained_on"].update(P=[2.0, 1.0]), "trained_on.P"),
    ],
)
def test_refusals(file: Path, change: Callable[[dict[str, Any]], object], says: str) -> None:
    rewritten(file, change)
    with pytest.raises(ArtifactError, match=f"(?s){says}"):
        read_network_weights(file)


@pytest.mark.parametrize("content", [b"", b"[]", b"\xff", b"{", b"[" * 100_000, b'{"kind": NaN}'])
def test_what_is_no_such_file_is_refused(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    with pytest.raises(ArtifactError):
        read_network_weights(file)


def test_nan_is_neither_written_nor_read(file: Path, tmp_path: Path) -> None:
    weights = random_weights(samples=4)
    b_1 = weights.network.b_1.copy()
    b_1[2] = np.nan
    with pytest.raises(ArtifactError, match="b_1: holds what is not a number"):
        write_network_weights(replace(weights, network=replace(weights.network, b_1=b_1)), tmp_path / "new.json")
    assert not (tmp_path / "new.json").exists()
    file.write_text(file.read_text(encoding="utf-8").replace('"samples": 4', '"samples": NaN'), encoding="utf-8")
    with pytest.raises(ArtifactError, match="holds NaN"):
        read_network_weights(file)


def test_missing_files_and_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="cannot read"):
        read_network_weights(tmp_path / "none.json")
    with pytest.raises(ArtifactError, match="it is a device or a pipe"):
        write_network_weights(random_weights(samples=4), Path("/dev/full"))


def test_scaling_and_its_inverse() -> None:
    x = np.random.default_rng(1).normal(5.0, 3.0, (80, 3))
    x[:, 1] = 0.1
    scaling = fit_scaling(x)
    u = scaling.apply(x)
    np.testing.assert_allclose(u[:, [0, 2]].min(axis=0), -1.0, atol=1e-14)
    np.testing.assert_allclose(u[:, [0, 2]].max(axis=0), 1.0, atol=1e-14)
    np.testing.assert_allclose(u[:, 1], 0.0, atol=1e-14)
    np.testing.assert_allclose(scaling.restore(u), x, rtol=1e-14)
    gain, offset = scaling.gain_and_offset()
    np.testing.assert_allclose(gain * x + offset, u, atol=1e-13)


def test_a_hash_is_of_the_content() -> None:
    weights: NetworkWeights = random_weights(samples=4)
    assert weights.hash == random_weights(samples=4).hash
    assert weights.hash != replace(weights, seed=1).hash


def test_changed_weights_with_right_hashes_are_refused(tmp_path: Path) -> None:
    """Sizes, missing numbers, scaling, window and trained range, and those of the field estimator's network."""
    for document, kinds, form in (
        (weights_document(random_weights()), WINDOWS, WEIGHTS_FILE),
        (json.loads(PACKAGED.read_text(encoding="utf-8")), FIELD, FIELD_WEIGHTS_FILE),
    ):

        def judge(text: str, kind: Mutation, field: str, form: GuardedFile[Any] = form) -> Outcome:
            return read(tmp_path / "changed.json", text, kind, field, form)

        found = outcomes(document, kinds, 2 * len(kinds), 5, form, judge)
        assert [(one.kind, one.field, one.says) for one in found if not one.right] == []
