"""A run that designs a table and trains a network does both at once, and writes what it writes one after the other."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.cli.small_studies import SMALL
from tests.gain_tables import table
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.artifacts.gain_table_file import read_table_file, write_table_file
from vsgdesign.certificate import Region, refusal_record
from vsgdesign.errors import ArtifactError, WorkerError
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.verbs.pipeline import making, run, run_study, study_tables

TABLED = """
[[controllers]]
name = "tabled"
kind = "scheduled"
structure = "angle_damped"
schedule = "table"

[[controllers]]
name = "network"
kind = "scheduled"
estimate = "neural"

[specification]
settling_time = "1.3 s"
P = ["0 W", "4 kW"]
Q = ["0 var", "2 kvar"]
scr = [5, 20]
x_over_r = [1, 10]

[estimator]
grid_phase = true
recipe = "few.toml"
"""
ALONE = {"name": "tabled", "kind": "scheduled", "structure": "angle_damped", "schedule": "table"}
COUNTS = {"runs": 7, "judged": 7, "confidence": 0.9, "families": {}}
REGION = Region((5.0, 20.0), (1.0, 10.0), (0.0, 1e3), (0.0, 1e3), 0.1)
RECORD = refusal_record("no such function", REGION, None)
LATER = refusal_record("no such function, with steps", REGION, None)


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Study:
    """Its table takes no time to design, and its certificate says that there is none."""
    (tmp_path / "few.toml").write_text('base = "continuous"\nscenarios = 20\nbridge = "averaged"\n', encoding="utf-8")
    (tmp_path / "mine.toml").write_text(SMALL + TABLED, encoding="utf-8")
    found = load_study(tmp_path / "mine.toml")
    designed = table(base=base_of(found, "impedance"))
    monkeypatch.setattr(study_tables, "_designed", lambda *_: designed)
    monkeypatch.setattr(making, "_proved", lambda *_: (RECORD, 0.1))
    return found


@contextmanager
def threads(count: int | None = None) -> Iterator[Executor]:
    with ThreadPoolExecutor(count) as executor:
        yield executor


def contents(folder: Path) -> dict[str, Any]:
    """Every file; of results.json what is not a time."""
    found: dict[str, Any] = {
        str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }
    document = json.loads(found.pop("results.json"))
    for name in ("timing_s", "sha256"):
        document.pop(name, None)
    if "estimator" in document:
        document["estimator"]["training"].pop("timing_s")
    for controller in document["controllers"].values():
        controller.pop("loop_s")
        controller.pop("real_time_factor")
    return found | document


def test_the_files_are_those_of_a_run_of_one_process(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_study(study, tmp_path / "one", report=False, workers=1)
    monkeypatch.setattr(making, "executor_of", threads)
    monkeypatch.setattr("vsgdesign.design.table.compiled_ahead", lambda: None)
    run_study(study, tmp_path / "many", report=False, workers=2)
    one, many = contents(tmp_path / "one"), contents(tmp_path / "many")
    assert one == many
    assert "tabled.c/vsg.c" in one["files"]
    assert read_table_file(tmp_path / "many" / "tabled.table.json").certificate == RECORD


def test_a_controller_without_a_table_does_not_wait_for_a_certificate(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulated, order = threading.Event(), []

    def slow(*_: Any) -> tuple[Any, float]:
        assert simulated.wait(60.0)
        order.append("certificate")
        return RECORD, 0.1

    def tell(what: str, share: float) -> None:
        if what.startswith("simulate") and share == 1.0:
            order.append(what)
        if what == "simulate network":
            simulated.set()

    monkeypatch.setattr(making, "executor_of", threads)
    monkeypatch.setattr(making, "_proved", slow)
    monkeypatch.setattr("vsgdesign.design.table.compiled_ahead", lambda: None)
    run_study(study, tmp_path / "out", report=False, workers=2, progress=tell)
    assert order[-1] == "simulate tabled"
    assert order.index("certificate") > order.index("simulate scheduled")


def test_files_are_written_while_tables_are_verified(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The verification takes the table with its certificate; that of the files also has its steps and its counts."""
    written, given = threading.Event(), []

    def verify(_study: Study, tables: Any, *_: Any, **__: Any) -> Any:
        assert written.wait(60.0)
        given.append(tables["tabled"])
        return {"tabled": replace(tables["tabled"], verification=COUNTS)}

    def tell(what: str, share: float) -> None:
        if what == "write time series" and share == 1.0:
            written.set()

    monkeypatch.setattr(making, "executor_of", threads)
    monkeypatch.setattr(making, "verified_tables", verify)
    monkeypatch.setattr(making, "_stepped", lambda *_: (LATER, 0.1))
    monkeypatch.setattr("vsgdesign.design.table.compiled_ahead", lambda: None)
    monkeypatch.setattr(run, "_exports", lambda *_: [])
    run_study(study, tmp_path / "out", report="still", workers=2, progress=tell)
    assert given[0].certificate == RECORD
    document = json.loads((tmp_path / "out" / "tabled.table.json").read_text(encoding="utf-8"))
    assert document["verification"] == COUNTS
    assert document["certificate"]["reason"] == LATER.reason
    times = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))["timing_s"]
    assert times["certificates"] == pytest.approx(0.2)


def test_an_interrupted_run_ends_while_tables_are_verified(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What waits for other processes ends with them."""
    begun = threading.Event()

    @contextmanager
    def processes(count: int | None = None) -> Iterator[Executor]:
        with threads(count) as executor:
            try:
                yield executor
            finally:
                ended.set()

    def verify(*_: Any, **__: Any) -> Any:
        begun.set()
        assert ended.wait(60.0)
        raise WorkerError("the workers are gone")

    def stop(what: str, _share: float) -> None:
        if what == "simulate tabled" and begun.wait(60.0):
            raise KeyboardInterrupt

    ended = threading.Event()
    monkeypatch.setattr(making, "executor_of", processes)
    monkeypatch.setattr(making, "verified_tables", verify)
    monkeypatch.setattr("vsgdesign.design.table.compiled_ahead", lambda: None)
    with pytest.raises(KeyboardInterrupt):
        run_study(study, tmp_path / "out", report="still", workers=2, progress=stop)
    assert not (tmp_path / "out").exists()


def test_finished_cells_are_kept_until_the_run_is_complete(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that is interrupted while it simulates does not design its table again."""
    seen: list[list[str]] = []
    designed = table(base=base_of(study, "impedance"))

    def build(_study: Study, _spec: Any, folder: Path, *_: Any) -> Any:
        seen.append(sorted(path.name for path in folder.glob("*.jsonl")))
        (folder / "cell.jsonl").write_text("{}", encoding="utf-8")
        return designed

    monkeypatch.setattr(study_tables, "_designed", build)

    def stop(what: str, _share: float) -> None:
        if what.startswith("simulate"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(study, tmp_path / "out", report=False, workers=1, progress=stop)
    run_study(study, tmp_path / "out", report=False, workers=1)
    assert seen == [[], ["cell.jsonl"]]
    assert not list(tmp_path.glob(".out*"))


def again(study: Study, out: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[dict[str, Any], list[str], int]:
    """What a run leaves in a folder that may have an earlier one's, what it says, and how many tables it designed."""
    said, designed = [], []
    original = study_tables._designed

    def counted(own: Study, *rest: Any) -> Any:
        designed.append(own)
        return replace(original(own, *rest), study=own.name, study_hash=own.hash)

    with monkeypatch.context() as patch:
        patch.setattr(study_tables, "_designed", counted)
        run_study(study, out, report=False, workers=1, say=said.append)
    return contents(out), said, len(designed)


def test_the_same_run_again_designs_nothing_and_writes_the_same(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It designed again what lay in the folder that it replaces. A new event asks for no new design either."""
    study = study.with_controllers(ALONE)
    first, said, designed = again(study, tmp_path / "out", monkeypatch)
    assert (said, designed) == ([], 1)
    second, said, designed = again(study, tmp_path / "out", monkeypatch)
    path = tmp_path / "out" / "tabled.table.json"
    words = "which an earlier run designed from the same inputs with the same program."
    assert (said, designed) == ([f"The gain table of tabled is that of {path}, {words}"], 0)
    assert second == first
    other = study.with_changes(events=[{"time": "0.05 s", "P_ref": "1 kW"}])
    third, _, designed = again(other, tmp_path / "out", monkeypatch)
    assert designed == 0
    fresh, _, designed = again(other, tmp_path / "fresh", monkeypatch)
    assert designed == 1
    assert third == fresh
    assert first["tabled.table.json"] != third["tabled.table.json"]


@pytest.mark.parametrize("case", ["study", "program", "damaged", "another"])
def test_another_design_is_made(case: str, study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = study.with_controllers(ALONE)
    again(study, tmp_path / "out", monkeypatch)
    path = tmp_path / "out" / "tabled.table.json"
    if case == "study":
        study = study.with_changes(specification={"settling_time": "1.4 s"})
    elif case == "program":
        monkeypatch.setattr(study_tables, "package_hash", lambda: "of other sources")
    elif case == "damaged":
        path.write_text(path.read_text(encoding="utf-8")[:-100], encoding="utf-8")
    else:
        write_table_file(replace(read_table_file(path), name="tabled by hand"), path)
    with nullcontext() if case in ("study", "program") else pytest.raises(ArtifactError, match="left untouched"):
        assert again(study, tmp_path / "out", monkeypatch)[1:] == ([], 1)
    left, _, _ = study_tables._left(study_tables.left_by_run(tmp_path / "out"), study, study.controllers[0])
    assert (left is not None) == (case in ("study", "program"))
