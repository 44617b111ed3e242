"""JSON that every reader takes, written whole; and what a result was made with."""

from __future__ import annotations

import json
import math
import platform
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from vsgdesign import __version__
from vsgdesign.artifacts import files as files_module
from vsgdesign.artifacts import provenance


def write_json(path: Path, document: object) -> None:
    """As results.json is written."""
    files_module.write_text(path, files_module.json_text(files_module.plain(document)))


def refuse(constant: str) -> float:
    raise AssertionError(f"{constant} is no JSON")


def round_trip(path: Path, document: object) -> object:
    write_json(path, document)
    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def test_what_is_not_finite_becomes_null(tmp_path: Path) -> None:
    document = {"a": math.nan, "b": [math.inf, -math.inf, 1.5], "c": {"d": (np.float64("nan"), 2)}, "e": None}
    assert round_trip(tmp_path / "x.json", document) == {
        "a": None,
        "b": [None, None, 1.5],
        "c": {"d": [None, 2]},
        "e": None,
    }


def test_types_survive(tmp_path: Path) -> None:
    document = {
        "i": 3,
        "f": 0.1,
        "t": True,
        "n": None,
        "s": "Ω · °",
        5: "key",
        "np": np.float32(0.5),
        "i64": np.int64(7),
    }
    back = round_trip(tmp_path / "x.json", document)
    assert back == {"i": 3, "f": 0.1, "t": True, "n": None, "s": "Ω · °", "5": "key", "np": 0.5, "i64": 7}
    assert isinstance(back, dict)
    assert back["t"] is True


@dataclass(frozen=True)
class Inner:
    y: float
    x: tuple[float, ...] = ()


@dataclass(frozen=True)
class Outer:
    one: Inner
    many: dict[str, Inner]


def test_a_dataclass_is_a_table_of_its_fields(tmp_path: Path) -> None:
    outer = Outer(Inner(math.nan), {"b": Inner(1.0, (2.0, math.inf))})
    assert round_trip(tmp_path / "x.json", [outer]) == [
        {"one": {"y": None, "x": []}, "many": {"b": {"y": 1.0, "x": [2.0, None]}}}
    ]


def test_floats_come_back_to_the_last_bit(tmp_path: Path) -> None:
    values = np.random.default_rng(3).standard_normal(200).tolist()
    assert round_trip(tmp_path / "x.json", values) == values


def test_the_order_is_the_documents(tmp_path: Path) -> None:
    write_json(tmp_path / "x.json", {"schema": 1, "a": 2})
    assert list(json.loads((tmp_path / "x.json").read_text())) == ["schema", "a"]


@pytest.mark.parametrize("stop", [OSError, KeyboardInterrupt])
def test_a_failure_leaves_the_old_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop: type[BaseException]
) -> None:
    write_json(tmp_path / "x.json", {"old": True})

    def failing(_source: object, _target: object) -> None:
        raise stop

    monkeypatch.setattr(files_module.os, "replace", failing)
    with pytest.raises(stop):
        write_json(tmp_path / "x.json", {"old": False})
    monkeypatch.undo()
    assert json.loads((tmp_path / "x.json").read_text()) == {"old": True}
    assert [path.name for path in tmp_path.iterdir()] == ["x.json"]


def test_what_cannot_be_written_spoils_nothing(tmp_path: Path) -> None:
    write_json(tmp_path / "x.json", {"old": True})
    with pytest.raises(TypeError):
        write_json(tmp_path / "x.json", {"new": object()})
    assert json.loads((tmp_path / "x.json").read_text()) == {"old": True}
    assert [path.name for path in tmp_path.iterdir()] == ["x.json"]


def test_provenance_names_versions() -> None:
    versions = provenance()
    assert versions["vsgdesign"] == __version__ == metadata.version("vsgdesign")
    assert versions["python"] == platform.python_version()
    for library in ("casadi", "clarabel", "cmaes", "control", "cvxpy", "llvmlite", "numba", "numpy", "scipy"):
        assert versions[library] == metadata.version(library)


def test_provenance_names_no_machine_and_no_user() -> None:
    text = " ".join(provenance().values())
    assert platform.node() not in text
    assert str(Path.home()) not in text
