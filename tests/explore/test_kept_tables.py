"""Gain tables that earlier commands have left are taken if they are of the same design; missing ones are made once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.gain_tables import table
from vsgdesign.artifacts import write_table_file
from vsgdesign.artifacts.design_inputs import design_inputs
from vsgdesign.artifacts.gain_table import GainTable, base_of
from vsgdesign.artifacts.ready import read_tables
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import ControllerSpec, Study
from vsgdesign.verbs.pipeline import study_tables as module
from vsgdesign.verbs.pipeline.study_tables import kept_tables, with_left_tables


@pytest.fixture(scope="module")
def study() -> Study:
    return load_study("studies/table/study.toml")


@pytest.fixture(scope="module")
def made(study: Study) -> GainTable:
    spec = study.controllers[-1]
    inputs = design_inputs(study, spec.target)
    bare = table(name=spec.name, base=base_of(study, "impedance"))
    return replace(bare, study=study.name, design_inputs=inputs, safe_place=(3.0, 3.0))


@pytest.fixture
def design(monkeypatch: pytest.MonkeyPatch, made: GainTable) -> list[str]:
    """Names of controllers whose table is designed, which takes no time here."""
    asked: list[str] = []

    def designed(_study: Study, spec: ControllerSpec, *_: object) -> GainTable:
        asked.append(spec.name)
        return made

    monkeypatch.setattr(module, "_designed", designed)
    return asked


@pytest.mark.parametrize(
    "place", ["table.table.json", "table/table.table.json", "table-table.json", "table-explore/table.table.json"]
)
def test_a_table_of_the_same_design_is_taken(
    study: Study, made: GainTable, design: list[str], tmp_path: Path, place: str
) -> None:
    path = tmp_path / place
    path.parent.mkdir(exist_ok=True)
    write_table_file(made, path)
    said: list[str] = []
    found = kept_tables(study, tmp_path, say=said.append)
    assert design == []
    assert found.tables["table"].sha256 == made.sha256
    assert found.files == {"table": path}
    assert found.words == said == [f"The gain table of table is that of {path}."]


@pytest.mark.parametrize(
    "place", ["table.table.json", "out/table.table.json", "out/table/table.table.json", "out/table-table.json"]
)
def test_a_table_beside_the_file_of_the_study_is_taken(
    study: Study, made: GainTable, design: list[str], tmp_path: Path, place: str
) -> None:
    """Whoever starts a verb in another folder than the study's had the same table designed again."""
    assert study.origin is not None
    there = replace(study, origin=replace(study.origin, folder=str(tmp_path / "mine")))
    path = tmp_path / "mine" / place
    path.parent.mkdir(parents=True)
    write_table_file(made, path)
    found = kept_tables(there, tmp_path / "out")
    assert (design, found.files) == ([], {"table": path})
    named = with_left_tables(there, tmp_path / "out")
    assert [one.table_file for one in named.controllers if one.schedule == "table"] == [str(path)]
    kept_tables(there.with_changes(specification={"settling_time": "2 s"}), tmp_path / "out")
    assert design == ["table"]
    assert (tmp_path / "out" / "table-explore" / "table.table.json").is_file()


def test_a_missing_table_is_designed_once_and_kept(study: Study, design: list[str], tmp_path: Path) -> None:
    said: list[str] = []
    first = kept_tables(study, tmp_path, say=said.append)
    assert design == ["table"]
    assert "gain table of table is designed now" in said[0]
    assert first.files["table"].is_file()
    second = kept_tables(study, tmp_path)
    assert design == ["table"]
    assert second.files == first.files


def test_a_table_of_another_design_is_not_taken(
    study: Study, made: GainTable, design: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "table-table.json"
    write_table_file(made, path)
    before = path.read_bytes()
    other, said = study.with_changes(specification={"settling_time": "2 s"}), []
    kept_tables(other, tmp_path, say=said.append)
    assert design == ["table"]
    assert f"{path} is not taken: specification.settling_time was 1.3 in its design, the study has 2" in said[0]
    assert path.read_bytes() == before


def test_a_table_without_a_safe_place_is_not_taken(
    study: Study, made: GainTable, design: list[str], tmp_path: Path
) -> None:
    write_table_file(replace(made, safe_place=None), tmp_path / "table-table.json")
    said: list[str] = []
    kept_tables(study, tmp_path, say=said.append)
    assert design == ["table"]
    assert "an earlier version of vsgdesign designed it, without a safe place" in said[0]


def test_a_damaged_table_is_neither_taken_nor_replaced(study: Study, design: list[str], tmp_path: Path) -> None:
    path = tmp_path / "table-explore" / "table.table.json"
    path.parent.mkdir()
    path.write_text("{", encoding="utf-8")
    found = kept_tables(study, tmp_path)
    assert design == ["table"]
    assert path.read_text(encoding="utf-8") == "{"
    assert "could not be kept" in found.words[-1]
    assert (list(found.tables), found.files) == (["table"], {})


def test_a_study_without_tables_needs_nothing(design: list[str], tmp_path: Path) -> None:
    found = kept_tables(load_study("studies/structures/study.toml"), tmp_path)
    assert (found.tables, found.words, design) == ({}, [], [])


def test_verbs_that_read_name_the_table_that_was_left(study: Study, made: GainTable, tmp_path: Path) -> None:
    """After `run`, every other verb took minutes to design the same table again."""
    path = tmp_path / "table" / "table.table.json"
    path.parent.mkdir()
    write_table_file(made, path)
    said: list[str] = []
    found = with_left_tables(study, tmp_path, say=said.append)
    assert {spec.name: spec.table_file for spec in found.controllers if spec.schedule == "table"} == {
        "table": str(path)
    }
    assert read_tables(found)["table"].sha256 == made.sha256
    assert said == [f"The gain table of table is that of {path}."]
    assert found.hash == study.hash
    other = study.with_changes(specification={"settling_time": "2 s"})
    assert with_left_tables(other, tmp_path) == other
    assert with_left_tables(study, tmp_path / "elsewhere") == study
