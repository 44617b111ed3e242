"""The gain table's file: exact round trip, equal bytes for equal tables, and everything it must refuse."""

from __future__ import annotations

import copy
import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.examples import examples
from tests.gain_tables import table
from vsgdesign.artifacts import GainTable, read_table_file, write_table_file
from vsgdesign.artifacts.gain_table import (
    COLUMNS,
    fill_outside,
    from_dimensionless,
    table_document,
    to_dimensionless,
)
from vsgdesign.artifacts.gain_table_file import TABLE_FILE
from vsgdesign.errors import ArtifactError


def random_table(seed: int, structure: str = "angle_damped", law: str = "poles") -> GainTable:
    """Every number random, so that a field that is lost or swapped shows."""
    rng = np.random.default_rng(seed)
    shape = (3, 2)
    parameters = {name: rng.uniform(0.3, 9.0, shape) for name in COLUMNS[law]}
    return table(
        structure,
        law,
        np.sort(rng.uniform(1.5, 20.0, 3)),
        np.sort(rng.uniform(0.3, 9.0, 2)),
        parameters,
        D_p=0.01 if structure == "angle_damped" else 0.0,  # so little that no damping makes 1 − k_P D_p small
        margins={"overshoot_P_pct": rng.uniform(0.0, 2.0, shape), "disk_margin": rng.uniform(1.0, 2.0, shape)},
        active=np.array([["settling", ""], ["Größe", "[1, 2]"], ["a,\n b", '"']]),
        specification={"settling_time": 1.5, "box": {"P": (-4500.0, 4500), "n": 3}, "named": None},
        certificate={"decay": rng.uniform(), "P": rng.uniform(size=(3, 3)), "holds": np.bool_(True)},
        provenance={"vsgdesign": "0.1.0"},
        inputs={"study": "ab"},
    )


def test_a_file_from_before_there_was_an_error_of_Z_is_read_as_none(tmp_path: Path) -> None:
    """Its bytes and its hash are those of today; with such an error, the file says so."""
    made = random_table(7)
    document = table_document(made)
    assert "error_Z" not in document["validity"]
    write_table_file(made, tmp_path / "old.json")
    assert read_table_file(tmp_path / "old.json").validity.error_Z == 0.0
    wider = replace(made, validity=replace(made.validity, error_Z=0.06))
    write_table_file(wider, tmp_path / "new.json")
    again = read_table_file(tmp_path / "new.json")
    assert (again.validity.error, again.validity.error_Z) == (0.2, 0.06)
    assert again.sha256 == wider.sha256 != made.sha256
    with pytest.raises(ArtifactError, match=r"validity.error_Z: -0.1 must be at least 0"):
        write_table_file(replace(made, validity=replace(made.validity, error_Z=-0.1)), tmp_path / "wrong.json")


@pytest.mark.parametrize(
    ("structure", "law"), [("published", "poles"), ("decoupled", "poles"), ("angle_damped", "inertia")]
)
def test_every_number_comes_back_to_the_last_bit(tmp_path: Path, structure: str, law: str) -> None:
    written = random_table(1, structure, law)
    write_table_file(written, tmp_path / "t.json")
    read = read_table_file(tmp_path / "t.json")
    for name, values in vars(written).items():
        found = getattr(read, name)
        if isinstance(values, dict):
            assert found.keys() == values.keys()
            assert all(np.array_equal(found[key], values[key]) for key in values)
        elif name == "gains":
            assert all(np.array_equal(a, b) for a, b in zip(found, values, strict=True))
        else:
            assert np.array_equal(found, values)
    assert read.sha256 == written.sha256


def test_equal_tables_give_equal_bytes_in_another_process_too(tmp_path: Path) -> None:
    write_table_file(random_table(2), tmp_path / "a.json")
    code = (
        "from tests.artifacts.test_gain_table_file import *;"
        f"write_table_file(random_table(2), {str(tmp_path / 'b.json')!r})"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60, cwd=Path(__file__).parents[2])
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    write_table_file(random_table(3), tmp_path / "c.json")
    assert (tmp_path / "a.json").read_bytes() != (tmp_path / "c.json").read_bytes()


def test_order_and_kind_of_number_do_not_count(tmp_path: Path) -> None:
    one = table(margins={"a": np.ones((4, 4)), "b": np.ones((4, 4))}, specification={"x": 1, "y": 2}, D_p=300.0)
    other = table(
        margins={"b": np.ones((4, 4)), "a": np.ones((4, 4), int)}, specification={"y": np.int64(2), "x": 1}, D_p=300
    )
    for name, value in (("1", one), ("2", other)):
        write_table_file(value, tmp_path / name)
    assert (tmp_path / "1").read_bytes() == (tmp_path / "2").read_bytes()


def test_rows_take_a_line_each(tmp_path: Path) -> None:
    write_table_file(table(), tmp_path / "t.json")
    assert ' "scr": [1.5, 2.0, 5.0, 20.0],\n' in (tmp_path / "t.json").read_text()


WHOLE = json.dumps(table_document(random_table(4)))


@examples(50)
@given(st.data())
def test_any_changed_byte_is_refused(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    path = tmp_path_factory.getbasetemp() / "changed.json"
    path.unlink(missing_ok=True)  # a changed one is not overwritten
    write_table_file(random_table(4), path)
    content = bytearray(path.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= data.draw(st.integers(1, 255))
    path.write_bytes(bytes(content))
    with pytest.raises(ArtifactError):
        read_table_file(path)


@examples(30)
@given(st.data())
def test_a_file_cut_short_says_so(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    path = tmp_path_factory.getbasetemp() / "cut.json"
    path.unlink(missing_ok=True)
    write_table_file(table(), path)
    content = path.read_bytes()
    path.write_bytes(content[: data.draw(st.integers(1, len(content) - 3))])
    with pytest.raises(ArtifactError, match="cut short"):
        read_table_file(path)


def test_a_copy_is_equal_to_its_table() -> None:
    made = random_table(5)
    for copied in (pickle.loads(pickle.dumps(made)), copy.deepcopy(made), random_table(5)):  # noqa: S301  our own bytes
        assert copied == made
        assert hash(copied) == hash(made)
    assert made != random_table(6)
    assert made != "a table"


def refusal(path: Path, change: Callable[[dict[str, Any]], Any], sign: bool = True) -> str:
    """What the loader says of a document that was changed; ``sign``: and given the hash and layout that fit."""
    document = json.loads(WHOLE)
    change(document)
    text = TABLE_FILE.render(document) if sign else json.dumps(document | {"sha256": "0" * 64})
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ArtifactError) as refused:
        read_table_file(path)
    assert str(path) in str(refused.value)
    return str(refused.value)


def setter(*keys: Any, to: Any) -> Callable[[dict[str, Any]], None]:
    def change(document: dict[str, Any]) -> None:
        *path, last = keys
        for key in path:
            document = document[key]
        document[last] = to

    return change


CAUSE = {
    "scr": 2.0,
    "x_over_r": 1.0,
    "cause": "delay",
    "missed": {"disk_margin": 0.9},
    "keeps": None,
    "limit": "",
    "limit_use": None,
}
"""A sound entry of causes."""

BETWEEN = {"points": 10, "seed": 0, "outside": 0, "promised": 10, "broken": []}
"""A sound look between the nodes."""


def test_sound_causes_are_read(tmp_path: Path) -> None:
    document = json.loads(WHOLE) | {"causes": [CAUSE], "between": BETWEEN}
    (tmp_path / "t.json").write_text(TABLE_FILE.render(document), encoding="utf-8")
    assert read_table_file(tmp_path / "t.json").causes == [CAUSE]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (setter("kind", to="other"), "not a gain table"),
        (setter("schema", to=4), "update vsgdesign"),
        (setter("schema", to=True), "not a schema number"),
        (setter("structure", to="droop"), "structure: 'droop' is unknown"),
        (setter("law", to="lead"), "law: 'lead' is unknown"),
        (setter("base", "scr_basis", to="resistance"), "base.scr_basis"),
        (setter("base", "S_rated", to=None), "base.S_rated: must be a number"),
        (setter("base", "S_rated", to=0.0), "must be positive"),
        (setter("base", "colour", to=1.0), "colour"),
        (setter("D_p", to=-1.0), "at least 0"),
        (setter("D_p", to="1.0"), "must be a number"),
        (setter("D_p", to=1), "an integer where a number must be"),
        (setter("scr", 1, to=0.5), "scr: must increase strictly"),
        (setter("x_over_r", 0, to=None), "x_over_r: must be a list of positive numbers"),
        (setter("scr", to=[]), "scr: must be a list"),
        (setter("columns", "k_1", 0, 1, to=None), "columns.k_1: not a number"),
        (setter("columns", "k_1", 0, 1, to=-1.0), "columns.k_1: must be positive"),
        (setter("columns", "k_1", 0, 1, to="15.8"), "text"),
        (setter("columns", "k_1", 0, to=[1.0]), "not a complete gain table"),
        (setter("columns", "k_1", to=[[1.0, 2.0]]), "shape (1, 2), the axes have (3, 2)"),
        (setter("columns", "k_9", to=[[1.0, 2.0]]), "law poles has"),
        (setter("gains", "K_ip", 0, 0, to=None), "gains.K_ip: not a number"),
        (setter("margins", "disk_margin", 0, 0, to="1"), "text"),
        (setter("status", 0, 0, to="good"), "status: good"),
        (setter("status", to=[["outside"] * 2] * 3), "every cell is outside"),
        (setter("validity", "P", to=[1.0, -1.0]), "validity.P: must be two numbers"),
        (setter("validity", "P", to=[1.0]), "validity.P"),
        (setter("certificate", to=[1.0]), "certificate"),
        (setter("causes", to={}), "causes: must be a list of tables"),
        (setter("causes", to=[1.0]), "causes[0]: must be a table"),
        *(
            (
                setter("causes", to=[{key: value for key, value in CAUSE.items() if key != name}]),
                f"causes[0].{name}: miss",
            )
            for name in CAUSE
        ),
        *((setter("causes", to=[CAUSE | {name: True}]), f"causes[0].{name}: must be") for name in CAUSE),
        (setter("between", to=BETWEEN | {"points": 1.0}), "between: must have points"),
        (
            setter("between", to=BETWEEN | {"link": {"charges": [0.5], "v_dc": [700.0]}}),
            "between.link: must have charges",
        ),
        (setter("between", to=BETWEEN | {"link": None}), "between.link: must have charges"),
        (setter("between", to=BETWEEN | {"broken": [{"scr": 2.0}]}), "between.broken[0].x_over_r: missing"),
        (setter("between", to=BETWEEN | {"broken": None}), "between.broken: must be a list"),
        (setter("name", to=3.0), "name: must be text"),
        (setter("note", to="x"), "unknown: note"),
        (lambda document: document.pop("price"), "price is missing"),
        (lambda document: document["gains"].pop("k_Q"), "gains.k_Q"),
    ],
)
def test_what_is_no_table_is_refused_though_its_hash_fits(
    tmp_path: Path, change: Callable[[dict[str, Any]], Any], says: str
) -> None:
    assert says in refusal(tmp_path / "t.json", change)


def test_a_change_without_the_hash_is_refused(tmp_path: Path) -> None:
    assert "does not match its sha256" in refusal(tmp_path / "t.json", setter("D_p", to=1.0), sign=False)


def test_reformatted_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    write_table_file(table(), path)
    path.write_text(json.dumps(json.loads(path.read_text())))
    with pytest.raises(ArtifactError, match="re-formatted"):
        read_table_file(path)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "not JSON"),
        (b"\x89PNG\r\n", "not text"),
        (b"[1, 2]\n", "not a gain table"),
        (b"{}\n", "not a gain table"),
        (b'{"kind": NaN}\n', "holds NaN"),
        (b'{"kind": -Infinity}\n', "holds -Infinity"),
        (b"study = 1\n", "not JSON"),
        (b'{"kind": 1e999}\n', "holds 1e999"),
        (b'{"kind": ' + b"1" * 5000 + b"}\n", "not JSON"),
        (b'{"kind": "vsgdesign gain table", "schema": 1, "name": "\\ud800"}\n', "does not match its sha256"),
        (b"[" * 100_000, "nested too deeply"),
    ],
)
def test_foreign_files(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "t.json"
    path.write_bytes(content)
    with pytest.raises(ArtifactError, match=says):
        read_table_file(path)


def test_a_missing_file_and_a_folder_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError, match="No such file"):
        read_table_file(tmp_path / "t.json")
    (tmp_path / "no").write_text("a file")
    with pytest.raises(ArtifactError, match="is not a folder"):
        write_table_file(table(), tmp_path / "no" / "t.json")
    write_table_file(table(), tmp_path / "new" / "t.json")
    assert read_table_file(tmp_path / "new" / "t.json").sha256 == table().sha256


def test_what_cannot_be_read_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ArtifactError) as refused:
        write_table_file(table(parameters={"k_1": np.nan, "d_1": -1.0}), tmp_path / "t.json")
    # Both faults at once, and no file.
    assert "t.json" in str(refused.value)
    assert "columns.k_1: not a number" in str(refused.value)
    assert "columns.d_1: must be positive" in str(refused.value)
    assert list(tmp_path.iterdir()) == []


def test_outside_cells_may_lack_gains_but_not_columns(tmp_path: Path) -> None:
    weak = table(scr=(0.3, 2.0, 8.0))  # at SCR 0.3 an inductive grid cannot carry 4.5 kW
    assert weak.valid[:, -1].tolist() == [False, True, True]
    write_table_file(weak, tmp_path / "t.json")
    read = read_table_file(tmp_path / "t.json")
    assert np.array_equal(np.isnan(read.gains.K_ip), ~read.valid)
    assert np.isfinite(read.columns["k_1"]).all()


def test_arrays_cannot_be_written_into() -> None:
    with pytest.raises(ValueError, match="read-only"):
        table().columns["k_1"][0, 0] = 1.0


def test_filling_takes_the_nearest_and_prefers_the_stronger_grid() -> None:
    values = np.array([[1.0, np.nan, 3.0], [np.nan, np.nan, 6.0]])
    # (0, 1): 1.0 and 3.0 are one step away at the same SCR: larger X/R. (1, 0): 1.0 is nearest.
    expected = [[1.0, 3.0, 3.0], [1.0, 6.0, 6.0]]
    assert fill_outside(values, np.isfinite(values)).tolist() == expected
    with pytest.raises(ValueError, match="no cell is valid"):
        fill_outside(values, np.zeros((2, 3)))


def test_dimensionless_columns_are_those_of_a_design_without_a_clock() -> None:
    """The same poles in units of T: a design for half the time has the same columns."""
    in_2_s: dict[str, Any] = {"k_1": 4.0, "d_1": 3.0, "k_2": 2.0, "zeta": 0.7}
    in_1_s: dict[str, Any] = {"k_1": 16.0, "d_1": 6.0, "k_2": 4.0, "zeta": 0.7}
    slow, fast = to_dimensionless(in_2_s, 2.0), to_dimensionless(in_1_s, 1.0)
    assert slow == fast
    assert from_dimensionless(slow, 2.0) == {"k_1": 4.0, "d_1": 3.0, "k_2": 2.0, "zeta": 0.7}
