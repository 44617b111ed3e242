"""The pages of what was run and of what was measured say what their records say."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from bench import history
from bench.timing import environment
from website import compatibility

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_of_what_was_run_is_that_of_its_records() -> None:
    kept = compatibility.records()
    assert compatibility.PAGE.read_text(encoding="utf-8") == compatibility.rendered(kept)
    assert len({compatibility.system(one) for one in kept}) == len(kept) > 0
    for one in kept:
        for name, version in one["versions"].items():
            given, least = (
                [int(k) for k in re.findall(r"\d+", text)] for text in (version, compatibility.asked()[name])
            )
            assert given >= least, (name, version)


def test_every_library_that_the_package_asks_for_is_on_the_page() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8").partition("\ndependencies = [")[2].partition("]")[0]
    assert set(re.findall(r'"(\w+)', text)) <= set(compatibility.here("this test")["versions"])


def test_the_history_is_that_of_its_records() -> None:
    kept = history.records()
    assert kept
    assert history.PAGE.read_text(encoding="utf-8") == history.rendered(kept), "write it: python -m bench.history"
    drawn = history.FIGURE.read_text(encoding="utf-8")
    assert all(record["environment"]["commit"] in drawn for record in kept)


def test_a_run_becomes_a_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history, "RECORDS", tmp_path)
    told = environment() | {"committed": "2026-01-02T0304", "commit": "0123abcd", "load before": "1.01", "cores": "2"}
    figure = {"value": 2.0, "low": 1.0, "high": 4.0, "repeats": 7}
    rows = [{"group": "a", "what": name, "unit": unit, "figure": figure} for name, unit in (("x", "RT"), ("y", "s"))]
    (tmp_path / "out").write_text(json.dumps({"environment": told, "rows": rows}), encoding="utf-8")
    assert history.add(tmp_path / "out").name == "2026-01-02T0304-0123abcd.json"
    page = history.rendered(history.records())
    assert "| x | RT | 4 |" in page
    assert "| y | s | 1 |" in page
    assert "| contended | yes |" in page
