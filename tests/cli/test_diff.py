"""vsgdesign diff: what changed between two results, and whether a verdict got worse."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.small_studies import call, failure, study_file
from vsgdesign.verbs.pipeline.given_results import SAME, changes_of


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("first")
    assert call("simulate", study_file(folder), "--out", folder / "out").exit_code == 0
    return folder / "out"


def edited(folder: Path, of: Path, edit: Callable[[dict[str, Any]], object]) -> Path:
    document = json.loads((of / "results.json").read_text(encoding="utf-8"))
    edit(document)
    (folder / "edited.json").write_text(json.dumps(document), encoding="utf-8")
    return folder / "edited.json"


def test_a_changed_input_and_the_figures_that_follow_it(first: Path, tmp_path: Path) -> None:
    text = (first.parent / "small.toml").read_text(encoding="utf-8").replace('P_ref = "2.5 kW"', 'P_ref = "2.6 kW"')
    (tmp_path / "small.toml").write_text(text, encoding="utf-8")
    assert call("simulate", tmp_path / "small.toml", "--out", tmp_path / "out").exit_code == 0
    result = call("diff", first, tmp_path / "out", "--json")
    found = json.loads(result.stdout)
    assert result.exit_code == 0
    assert found["worse"] == 0
    asked = {tuple(one["place"]): (one["a"], one["b"]) for one in found["inputs"]}
    assert asked[("study", "inputs", "events", "0.1 s", "P_ref")] == ("2.5 kW", "2.6 kW")
    assert all(place[0] == "study" for place in asked)
    shown = call("diff", first, tmp_path / "out").stdout
    assert "2.5 kW" in shown
    assert "2.6 kW" in shown
    assert "No verdict got worse" in shown
    final = [one for one in found["figures"] if one["place"][-1] == "final" and "P_pcc" in one["place"][3]]
    a, b = next((one["a"], one["b"]) for one in final if "fixed" in one["place"])
    assert 2.4e3 < a < 2.55e3 < b < 2.65e3
    # An event has its reference in its name, and is compared with the one at the same instant. Nothing stands twice.
    places = [one["place"] for one in found["figures"]]
    assert [one[3:] for one in places if one[-1] == "name" and "fixed" in one and one[3][0] == "P"] == [
        ["P_pcc, 0.1 s", "name"]
    ]
    assert not any({"cycle_mean", "one_cycle_mean", "study"} & set(place) for place in places)
    assert ["controllers", "fixed", "events", "P_pcc, 0.1 s", "final"] in places


def test_the_same_result_has_no_changes(first: Path) -> None:
    result = call("diff", first, first / "results.json")
    assert (result.exit_code, result.stdout) == (0, "Nothing changed.\n")


@pytest.mark.parametrize(
    ("edit", "code"),
    [
        (lambda d: d["controllers"]["fixed"]["outcome"].update(status="diverged"), 1),
        (lambda d: d["controllers"]["fixed"]["outcome"].update(status="settled"), 0),
        (lambda d: d["promises"][0].update(kept=not d["promises"][0]["kept"]), None),
        (lambda d: d["promises"][0].update(kept=None), None),
        (lambda d: d["warnings"].append({"controller": "fixed", "t_s": 0.1, "event": "x"}), 1),
        (lambda d: d.update(timing_s={}), 0),
    ],
)
def test_exit_code_of_a_verdict(
    first: Path, tmp_path: Path, edit: Callable[[dict[str, Any]], object], code: int | None
) -> None:
    """There and back: what got worse in one direction got better in the other."""
    other = edited(tmp_path, first, edit)
    there, back = (call("diff", *both).exit_code for both in ((first, other), (other, first)))
    if code is None:
        assert {there, back} == {0, 1}
    else:
        assert there == code
        assert back == 0 or code == 0


def test_quantities_that_say_the_same_are_no_change() -> None:
    def study(P_ref: object) -> dict[str, Any]:
        return {"study": {"inputs": {"simulation": {"P_ref": P_ref}}}}

    assert not list(changes_of(study("8 kW"), study(8000)))
    assert not list(changes_of({"x": 1.0}, {"x": 1.0 + 0.5 * SAME}))
    assert [one.place for one in changes_of({"x": 1.0}, {"x": 1.0 + 2.0 * SAME})] == [("x",)]
    assert [(one.a, one.b) for one in changes_of(study("8 kW"), study("8 kvar"))] == [("8 kW", "8 kvar")]


def test_what_is_no_result_is_refused(first: Path, tmp_path: Path) -> None:
    (tmp_path / "text.json").write_text("no JSON", encoding="utf-8")
    (tmp_path / "list.json").write_text("[]", encoding="utf-8")
    assert "it is no JSON" in failure(2, "diff", first, tmp_path / "text.json")
    assert "is no result" in failure(2, "diff", first, tmp_path / "list.json")
    assert "cannot be read" in failure(2, "diff", first, tmp_path / "missing")
    other = edited(tmp_path, first, lambda d: d.update(kind="vsgdesign report"))
    assert 'of "vsgdesign report"' in failure(2, "diff", first, other)
