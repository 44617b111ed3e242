"""``vsgdesign estimator train``, and a study whose schedule is driven by what it trains."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.small_studies import SMALL, as_json, call, failure, study_file
from tests.cli.test_estimator_windows import interrupt_after, recipe_file
from vsgdesign.artifacts.network_weights import read_network_weights
from vsgdesign.estimator import specification, trained

RECIPE = 'base = "continuous"\nscenarios = 40\nbridge = "averaged"\n'
NETWORK = """
[[controllers]]
name = "network"
kind = "scheduled"
estimate = "neural"
[estimator]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a recipe and the weights of it."""
    folder = tmp_path_factory.mktemp("network")
    (folder / "few.toml").write_text(RECIPE, encoding="utf-8")
    arguments = (study_file(folder), "--recipe", folder / "few.toml", "--seed", "2", "--hidden", "5", "--workers", "1")
    result = call("estimator", "train", *arguments, "--out", folder / "w.json", "--windows", folder / "w.npz")
    assert result.exit_code == 0, result.output
    assert "w.json: recipe few" in result.stdout
    assert "no converter in the field can measure it" in result.stdout
    return folder


def with_network(folder: Path, **lines: object) -> Path:
    text = "".join(
        f"{name} = {json.dumps(str(value) if isinstance(value, Path) else value)}\n" for name, value in lines.items()
    )
    return study_file(folder, SMALL + NETWORK + text)


def test_weights_say_what_they_are(folder: Path) -> None:
    weights = read_network_weights(folder / "w.json")
    assert (weights.seed, weights.recipe["name"], len(weights.network.b_1)) == (2, "few", 5)
    assert weights.window.synchronised
    assert weights.training["converter"] == {"S_rated": 5000.0, "V_rated_rms": 110.0, "f_n": 50.0}
    arguments = (folder / "small.toml", "--recipe", folder / "few.toml", "--seed", "2", "--hidden", "5")
    arguments += ("--workers", "1")  # that more of them make the same windows, tests/estimator sees
    study_file(folder)
    document = as_json("estimator", "train", *arguments, "--out", folder / "again.json")
    assert document["weights_sha256"] == weights.hash
    assert set(document["parts"]) == {"training", "validation", "test"}


def test_a_run_trains_reports_and_leaves_its_weights(folder: Path, tmp_path: Path) -> None:
    study = with_network(tmp_path, recipe=folder / "few.toml", grid_phase=True)
    result = call("run", study, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    out = tmp_path / "out"
    assert {"network.estimates.csv", "estimator.weights.json"} <= {path.name for path in out.iterdir()}
    figures = {path.stem for path in (out / "figures").iterdir()}
    assert {
        "estimate_resistance",
        "estimate_inductance",
        "estimate_error",
        "error_histogram",
        "regression",
        "training_progress",
    } <= figures
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert results["controllers"]["fixed"]["estimate"] is None
    estimate = results["controllers"]["network"]["estimate"]
    assert (estimate["windows"], estimate["with_the_truth"]) == (15, "scheduled")
    assert [step["t_s"] for step in estimate["steps"]] == [0.1]
    # Two events and the end: no more rows than that and the first.
    assert len(results["controllers"]["network"]["gains"]) <= 4
    assert results["controllers"]["network"]["gain_changes"] >= len(results["controllers"]["network"]["gains"])
    assert results["estimator"]["weights_sha256"] == read_network_weights(out / "estimator.weights.json").hash
    assert results["estimator"]["bridge"] == "averaged"
    with (out / "network.estimates.csv").open(encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    assert rows[0] == ["t_s [s]", "R_g [ohm]", "L_g [H]", "R_g_hat [ohm]", "L_g_hat [H]", "status [1]"]
    assert len(rows) == 16
    page = (out / "report.html").read_text(encoding="utf-8")
    for shown in ("The estimated grid", "The network on its windows", "network beside scheduled", "at its best"):
        assert shown in page


def test_a_run_with_weights_from_a_file_trains_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(specification, "train", None)
    study = with_network(tmp_path, weights=folder / "w.json", grid_phase=True)
    result = call("run", study, "--out", tmp_path / "out", "--bridge", "pwm")
    assert result.exit_code == 0, result.output
    figures = {path.stem for path in (tmp_path / "out" / "figures").iterdir()}
    assert "estimate_error" in figures
    assert "regression" not in figures
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "trained with an averaged bridge" in page
    assert "The network on its windows" not in page


def test_windows_to_train_on_are_those_of_the_runs_bridge(folder: Path, tmp_path: Path) -> None:
    study = with_network(tmp_path, recipe=folder / "few.toml", grid_phase=True)
    results = as_json("simulate", study, "--out", tmp_path / "out", "--bridge", "pwm")
    assert results["estimator"]["bridge"] == "pwm"


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        ({"recipe": "few"}, 'estimator.recipe = "few": unknown. Known: published, continuous'),
        ({"weights": "w.json", "seed": 3}, "estimator.seed = 3: weights are given too"),
        ({"grid_phase": "yes"}, 'estimator.grid_phase = "yes": must be true or false'),
        ({"recipe": "published"}, "estimator.grid_phase = false: recipe published trains on windows synchronised"),
        ({"weights": "missing.json"}, 'missing.json": No such file'),
        ({"recipe": "missing.toml", "grid_phase": True}, "there is no such file"),
    ],
)
def test_what_does_not_fit_is_wrong_input(tmp_path: Path, lines: dict[str, object], problem: str) -> None:
    assert problem in failure(2, "simulate", with_network(tmp_path, **lines), "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_weights_that_need_the_grids_phase_are_refused_without(folder: Path, tmp_path: Path) -> None:
    study = with_network(tmp_path, weights=folder / "w.json")
    text = failure(2, "simulate", study, "--out", tmp_path / "out")
    assert "controller network, [estimator]: these weights do not fit" in text
    assert "grid_phase = false" in text


def test_windows_of_another_length_are_refused_before_the_training(tmp_path: Path) -> None:
    text = (SMALL + NETWORK).replace('estimate = "neural"', 'estimate = "neural"\nupdate_period = "10 ms"')
    study = study_file(tmp_path, text + "grid_phase = true\n")
    text = failure(2, "simulate", study, "--out", tmp_path / "out")
    assert "controller network.update_period = 0.01 s: recipe published has windows of 100 samples every 200 µs" in text
    assert "Leave update_period out" in text


def test_an_estimate_needs_an_estimator(tmp_path: Path) -> None:
    study = study_file(tmp_path, (SMALL + NETWORK).replace("[estimator]\n", ""))
    assert "there is no network to estimate with. Add an [estimator] section." in failure(2, "validate", study)


def test_without_pytorch_one_sentence_names_the_extra(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trained.importlib.util, "find_spec", lambda _: None)
    text = failure(1, "estimator", "train", study_file(tmp_path), "--out", tmp_path / "w.json")
    assert text.count("\n") == 1
    assert 'pip install "vsgdesign[train]"' in text
    # Weights from a file need none.
    study = with_network(tmp_path, weights=folder / "w.json", grid_phase=True)
    assert call("simulate", study, "--out", tmp_path / "out").exit_code == 0


def test_an_interruption_that_keeps_windows_says_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = recipe_file(tmp_path, RECIPE)
    arguments = ("estimator", "train", study_file(tmp_path), "--recipe", recipe, "--workers", "1")
    arguments += ("--out", tmp_path / "w.json")
    interrupt_after(1, monkeypatch)
    kept = call(*arguments, "--windows", tmp_path / "w.npz")
    assert (kept.exit_code, "the same command continues" in kept.stderr) == (130, True)
    interrupt_after(1, monkeypatch)
    lost = call(*arguments)
    assert (lost.exit_code, "the same command continues" in lost.stderr) == (130, False)


def test_results_that_would_take_each_others_place(tmp_path: Path) -> None:
    """After the training, the file for the weights was one of windows, and the weights were lost."""
    arguments = ("estimator", "train", study_file(tmp_path), "--recipe", recipe_file(tmp_path))
    said = failure(2, *arguments, "--out", tmp_path / "w.json", "--windows", tmp_path / "." / "w.json")
    assert f'windows = "{tmp_path / "w.json"}": is the file of out as well. Give another file.' in said
    field = ("--recipe", "field", "--report", tmp_path / "report")
    said = failure(2, *arguments[:3], *field, "--out", tmp_path / "report" / "w.json", "--windows", tmp_path / "w.npz")
    assert f'report = "{tmp_path / "report"}": would replace out, which is in it. Give a folder of its own.' in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["few.toml", "small.toml"]


@pytest.mark.parametrize(
    ("recipe", "says"),
    [
        (RECIPE.replace("40", "5"), "scenarios = 5: too few to be split 70/15/15 for training"),
        (SMALL, "is a study, not a recipe. Give a packaged recipe (published, continuous, wide, field)"),
        ('base = "field"\nruns = 5', "runs = 5: too few to be split 70/15/15 for training, validation and test"),
    ],
)
def test_a_recipe_that_nothing_can_be_trained_on(recipe: str, says: str, tmp_path: Path) -> None:
    """It was said after the simulations, and of a study field by field."""
    file = recipe_file(tmp_path, recipe)
    said = failure(2, "estimator", "train", study_file(tmp_path), "--recipe", file, "--out", tmp_path / "w.json")
    assert (says in said, said.count("\n  - ")) == (True, 1)


def test_so_few_scenarios_can_just_be_split() -> None:
    from vsgdesign.estimator.data_set import check_enough, parts_of

    check_enough(6, "scenarios")
    assert [len(part) for part in parts_of(np.arange(6), "scenarios")] == [4, 1, 1]


@pytest.mark.parametrize("verb", ["compare", "stress"])
def test_weights_of_another_converter_are_not_compared(verb: str, folder: Path, tmp_path: Path) -> None:
    """Where the windows happened to fit, the page showed a network that was scaled for other volts and amperes."""
    other = study_file(tmp_path, SMALL + '[converter]\nS_rated = "6 kVA"\n')
    said = failure(2, "estimator", verb, other, "--weights", folder / "w.json", "--out", tmp_path / "out")
    assert "these weights do not fit the converter of the study:\n" in said
    assert f"  - {folder / 'w.json'}: S_rated = 6000 VA: the weights' scaling is of a converter with 5000 VA." in said
    assert not (tmp_path / "out").exists()


SIXTY = """
base = "case:utility_1mva_60hz"
simulation = { duration = "0.1 s", P_ref = "400 kW", Q_ref = 0 }
controllers = [
    { name = "truth", kind = "scheduled" },
    { name = "network", kind = "scheduled", estimate = "neural" },
]
[estimator]
grid_phase = true
"""


def test_a_60_hz_converter_trains_and_runs_without_a_word_about_windows(folder: Path, tmp_path: Path) -> None:
    study = study_file(tmp_path, SIXTY + f'recipe = "{folder / "few.toml"}"\n')
    results = as_json("simulate", study, "--out", tmp_path / "out")
    estimate, network = results["controllers"]["network"]["estimate"], results["estimator"]
    assert network["window"] == {
        "samples": 100,
        "sample_interval_s": pytest.approx(1 / 6000),
        "period_s": pytest.approx(1 / 60),
        "cycles": 1,
    }
    # Six cycles of 60 Hz in 0.1 s, each with its answer; its twin is told every 20 ms.
    assert (estimate["windows"], estimate["with_the_truth"]) == (6, "truth")
    draws = network["training"]["draws"]
    assert draws["draws"] == 40 + sum(draws["thrown_away"].values())
    assert draws["thrown_away"]["bridge voltage"] > 0
    median, most = network["training"]["parts"]["test"]["errors"]["rest"]["Z"]
    assert 0.0 < median < most < 0.2
    # What was trained at 60 Hz is refused at 50 Hz, whatever else fits.
    at_50 = SIXTY.replace("[estimator]", '[converter]\nf_n = "50 Hz"\n[estimator]')
    weights = tmp_path / "out" / "estimator.weights.json"
    text = failure(2, "simulate", study_file(tmp_path, at_50 + f'weights = "{weights}"\n'), "--out", tmp_path / "no")
    assert "f_n = 50 Hz: the weights' scaling is of a converter with 60 Hz" in text
    # Another period than the window's is refused, with what to do.
    other = SIXTY.replace('"neural"', '"neural", update_period = "20 ms"')
    text = failure(2, "simulate", study_file(tmp_path, other + f'weights = "{weights}"\n'), "--out", tmp_path / "no")
    assert "update_period = 20 ms: the weights take windows of 100 × 166.667 µs = 16.6667 ms. Leave update" in text
