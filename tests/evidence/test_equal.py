"""Two versions compared: every kind of difference is found, and what one version offers is listed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evidence.equal import DONE, compare, largest
from evidence.inventory import inventory


def written(folder: Path, document: dict[str, Any], values: list[float], text: str) -> Path:
    """A folder with one finished job and one that was interrupted."""
    job, other = folder / "job", folder / "interrupted"
    job.mkdir(parents=True)
    other.mkdir()
    (job / DONE).write_text("[0]")
    (job / "results.json").write_text(json.dumps(document))
    np.savez(job / "run.npz", t_s=np.array(values), header=np.frombuffer(b'{"a": 1}', np.uint8))
    (job / "table.c").write_text(f"/* sha256 {text[:3]}, vsgdesign 0.{len(text)} */\n{text}\n")
    (job / "page.html").write_text(text)
    (other / "results.json").write_text(text)
    return folder


DOCUMENT = {"P": [1.0, {"Q": None}], "sha256": "1", "provenance": {"numpy": "1"}, "data_sha256": "2", "ok": True}


@pytest.fixture
def before(tmp_path: Path) -> Path:
    return written(tmp_path / "a", DOCUMENT, [0.0, 1.0], "abc")


def test_equal_folders_have_no_difference(before: Path, tmp_path: Path) -> None:
    other = DOCUMENT | {"sha256": "3", "provenance": {}, "data_sha256": "4"}
    after = written(tmp_path / "b", other, [0.0, 1.0], "abc")
    (after / "job" / "page.html").write_text("another page")
    assert not list(compare(before, after))


def test_each_difference_is_one_line(before: Path, tmp_path: Path) -> None:
    other = DOCUMENT | {"P": [1.5, {"Q": 2.0}], "ok": 1}
    after = written(tmp_path / "b", other, [-0.0, 1.25], "abd")
    (after / "job" / "page.html").unlink()
    found = list(compare(before, after))
    assert [str(one) for one in found] == [
        "job/page.html: the file: there | missing",
        "job/results.json: .P[0]: 1.0 | 1.5",
        "job/results.json: .P[1].Q: null | 2.0",
        "job/results.json: .ok: true | 1",
        "job/run.npz: t_s[0], 2 of 2 differ, at most 2.5e-01: 0.0 | -0.0",
        "job/table.c: line 2 and 0 more: abc | abd",
    ]
    assert list(largest(found))[1] == "job/results.json: 3.3e-01 at .P[0]; 1 other differences"
    assert {one.file for one in compare(before, after, "*.npz")} == {"job/run.npz"}


def test_the_inventory_has_every_kind_of_line() -> None:
    lines = list(inventory())
    for part in (
        "verb vsgdesign verify: --strict: BOOL",
        "field study-file `[simulation]`: `duration` | s",
        "data cases/lab_12kva_lcl.toml",
        "suite own: phase jump",
        "name vsgdesign.simulate(",
        "name vsgdesign.runtime.Scheduler.",
        "error StudyError: VsgDesignError",
        "page docs/verbs.md",
        "documented vsgdesign : there",
        "test test_the_inventory_has_every_kind_of_line: 1",
    ):
        assert any(line.startswith(part) for line in lines), part
    assert not [line for line in lines if line.startswith("documented") and line.endswith("missing")]
