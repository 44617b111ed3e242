"""``vsgdesign estimator windows``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.cli.small_studies import as_json, call, failure, study_file
from vsgdesign.estimator import specification
from vsgdesign.estimator.data_set import read_data_set

RECIPE = 'base = "continuous"\nscenarios = 4\nbefore = 1\nafter = 1\nbridge = "averaged"\n'
VERB = ("estimator", "windows")


def recipe_file(folder: Path, text: str = RECIPE) -> Path:
    path = folder / "few.toml"
    path.write_text(text, encoding="utf-8")
    return path


def interrupt_after(finished: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows are made in blocks of two scenarios, and Ctrl-C comes after so many of them."""
    make, made = specification.make_block, []

    def interrupted(*arguments: Any) -> Any:
        made.append(arguments)
        if len(made) > finished:
            raise KeyboardInterrupt
        return make(*arguments)

    monkeypatch.setattr(specification, "WINDOW_NETWORK", replace(specification.WINDOW_NETWORK, block=2))
    monkeypatch.setattr(specification, "make_block", interrupted)


def test_windows_and_their_file(tmp_path: Path) -> None:
    arguments = (study_file(tmp_path), "--recipe", recipe_file(tmp_path), "--seed", "3", "--out", tmp_path / "w.npz")
    result = call(*VERB, *arguments)
    assert result.exit_code == 0
    assert "w.npz: 8 windows of 200 values from 4 scenarios, sha256 " in result.stdout
    assert "synchronised with the grid's phase" in result.stdout
    document = as_json(*VERB, *arguments)
    data = read_data_set(tmp_path / "w.npz")
    assert document["sha256"] == data.hash
    assert document["header"]["recipe"]["name"] == "few"
    assert document["header"]["seed"] == 3
    assert data.hash[:12] in result.stdout


@pytest.mark.parametrize(
    ("recipe", "problem"),
    [
        ("publishd", 'recipe = "publishd": unknown. Did you mean published?'),
        (
            RECIPE + "scr = { uniform = [20, 2] }",
            "scr.uniform = [20, 2]: the range is reversed. Give the lower end first.",
        ),
        (RECIPE + 'P_pu = "2 kW"', 'P_pu = "2 kW": expected'),
        (RECIPE + "noise_v = nan", "noise_v = nan: "),
    ],
)
def test_a_faulty_recipe_is_wrong_input(tmp_path: Path, recipe: str, problem: str) -> None:
    given = recipe if "=" not in recipe else recipe_file(tmp_path, recipe)
    out = tmp_path / "w.npz"
    assert problem in failure(2, *VERB, study_file(tmp_path), "--recipe", given, "--out", out)
    assert not out.exists()


@pytest.mark.parametrize("finished", [0, 1])
def test_an_interruption_says_whether_there_is_something_to_go_on_from(
    finished: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a finished block, it was said that finished blocks are kept."""
    interrupt_after(finished, monkeypatch)
    arguments = study_file(tmp_path), "--recipe", recipe_file(tmp_path), "--workers", "1"
    result = call(*VERB, *arguments, "--out", tmp_path / "w.npz")
    said = ["nothing was written", "finished blocks are kept, the same command continues from them"][finished]
    assert (result.exit_code, result.stderr) == (130, f"interrupted: {said}\n")
