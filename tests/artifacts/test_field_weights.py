"""The file of the field estimator's network: it comes back to the last bit, and refuses everything else."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.artifacts.field_networks import random_field_weights
from tests.artifacts.networks import random_weights
from vsgdesign.artifacts.field_weights import FIELD_WEIGHTS_FILE, read_field_weights, weights_document
from vsgdesign.artifacts.guarded_file import content_hash
from vsgdesign.artifacts.network_weights import read_network_weights, write_network_weights
from vsgdesign.equations.field import FieldFeatures
from vsgdesign.errors import ArtifactError
from vsgdesign.identification.field import field_network


@pytest.fixture
def file(tmp_path: Path) -> Path:
    FIELD_WEIGHTS_FILE.write(random_field_weights(), tmp_path / "field.json")
    return tmp_path / "field.json"


def test_round_trip(file: Path) -> None:
    weights, back = random_field_weights(), read_field_weights(file)
    assert back.hash == weights.hash
    assert weights_document(back) == weights_document(weights)
    assert np.array_equal(back.layers.W_2, weights.layers.W_2)
    assert not back.layers.W_2.flags.writeable
    first = file.read_bytes()
    FIELD_WEIGHTS_FILE.write(back, file)
    assert file.read_bytes() == first


def test_every_changed_byte_and_every_cut_is_refused(file: Path) -> None:
    text, rng = file.read_bytes(), np.random.default_rng(0)
    for at in rng.integers(0, len(text) - 1, 60):
        file.write_bytes(text[:at] + bytes([text[at] ^ int(rng.integers(1, 256))]) + text[at + 1 :])
        with pytest.raises(ArtifactError):
            read_field_weights(file)
        file.write_bytes(text[:at])
        with pytest.raises(ArtifactError):
            read_field_weights(file)


def rewritten(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """The file with another content and the right hash for it, as a faulty writer would make it."""
    document = json.loads(path.read_text(encoding="utf-8"))
    del document["sha256"]
    change(document)
    document["sha256"] = content_hash(document)
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.update(schema=2), "schema 2.*update vsgdesign"),
        (lambda d: d.pop("gate"), "gate is missing"),
        (lambda d: d["layers"]["b_2"].pop(), "W_2: has shape"),
        (lambda d: d["layers"]["b_3"].__setitem__(0, None), "b_3: holds what is not a number"),
        (lambda d: d["layers"]["deviation"].__setitem__(0, 0.0), "deviation: must be positive"),
        (lambda d: d["features"].pop(), "mean: has shape"),
        (lambda d: d["features"].__setitem__(0, "angle"), "must be different names"),
        (lambda d: d["radius_squared"].update(doubt=-1.0), "radius_squared.doubt: -1.0 must be"),
        (lambda d: d["gate"].update(first=30.0), "first_refuted ≤ first ≤ last"),
        (lambda d: d["gate"].update(confident=None), "gate.confident: None must be"),
        (lambda d: d["converters"][0].update(f_n=0.0), r"converters\[0\].f_n: 0.0 must be"),
        (lambda d: d["converters"].clear(), "converters: names none"),
    ],
)
def test_refusals(file: Path, change: Callable[[dict[str, Any]], object], says: str) -> None:
    rewritten(file, change)
    with pytest.raises(ArtifactError, match=f"(?s){says}"):
        read_field_weights(file)


def test_all_faults_at_once(file: Path) -> None:
    def spoil(document: dict[str, Any]) -> None:
        document["layers"]["b_3"].append(0.0)
        document["radius_squared"]["learning"] = 0.0
        document["gate"]["last"] = 1.0

    rewritten(file, spoil)
    with pytest.raises(ArtifactError, match=r"(?s)layers\.b_3.*radius_squared\.learning.*gate: needs"):
        read_field_weights(file)


def test_the_two_kinds_of_weights_are_not_mistaken(tmp_path: Path, file: Path) -> None:
    write_network_weights(random_weights(samples=2), tmp_path / "windows.json")
    with pytest.raises(ArtifactError, match="not a trained network of the field estimator"):
        read_field_weights(tmp_path / "windows.json")
    with pytest.raises(ArtifactError, match="not a trained network"):
        read_network_weights(file)
    with pytest.raises(ArtifactError, match="left untouched"):
        FIELD_WEIGHTS_FILE.write(random_field_weights(), tmp_path / "windows.json")


def test_packaged_weights_fit_the_recursions() -> None:
    weights = read_field_weights()
    assert weights.features == FieldFeatures._fields
    assert {round(one["f_n"]) for one in weights.converters} == {50, 60}
    network = field_network(weights, FieldFeatures._fields)
    assert all(np.isfinite(values).all() for values in (network.W_1, network.W_2, network.W_3))
