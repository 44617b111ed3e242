"""``vsgdesign estimator train`` with the recipe ``field``: few short runs, weights, report, and wrong recipes."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import pytest

from tests.cli.small_studies import as_json, call, failure
from vsgdesign.artifacts.field_weights import read_field_weights
from vsgdesign.equations.field import FieldFeatures
from vsgdesign.estimator import specification
from vsgdesign.estimator.data_set import FieldCycles, read_rows
from vsgdesign.identification.field import field_network
from vsgdesign.study.parameters import load_study

STUDY = """
base = "case:utility_1mva_60hz"
[simulation]
duration = "1 s"
P_ref = "300 kW"
Q_ref = "0 var"
[[controllers]]
name = "scheduled"
kind = "scheduled"
"""
RECIPE = """
base = "field"
runs = 8
changes = 1
first = "0.5 s"
between = "0.3 s"
learn = "0.2 s"
scr = { log_uniform = [2, 6] }
x_over_r = { log_uniform = [2, 5] }
bridge = "averaged"
hidden = 4
epochs = 3
"""


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a study and a recipe."""
    folder = tmp_path_factory.mktemp("field")
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    (folder / "few.toml").write_text(RECIPE, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def folder(asked: Path) -> Path:
    """The same folder with the weights of the recipe, its runs and its report as well."""
    folder = asked
    arguments = (folder / "study.toml", "--recipe", folder / "few.toml", "--seed", "2", "--report", folder / "report")
    files = ("--workers", "1", "--out", folder / "w.json", "--windows", folder / "runs.npz")
    result = call("estimator", "train", *arguments, *files)
    assert result.exit_code == 0, result.output
    assert "w.json: recipe few, 8 runs in" in result.stdout
    return folder


def test_weights_say_what_they_are(folder: Path) -> None:
    weights = read_field_weights(folder / "w.json")
    assert weights.features == FieldFeatures._fields
    assert (weights.seed, weights.recipe["name"], weights.recipe["runs"]) == (2, "few", 8)
    (converter,) = weights.converters
    assert (converter["S_rated"], converter["f_n"]) == (1e6, pytest.approx(60.0))
    assert field_network(weights, FieldFeatures._fields).W_1.shape == (4, len(FieldFeatures._fields))
    cycles = read_rows(folder / "runs.npz", FieldCycles)
    assert weights.data_hash == cycles.hash
    # 0.6 s of 60 Hz in each run, less what falls on the edges.
    assert len(cycles) == pytest.approx(8 * 36, abs=16)
    assert not cycles.broken.any()


def test_the_report_has_the_three_ways(folder: Path) -> None:
    document = json.loads((folder / "report" / "results.json").read_text(encoding="utf-8"))
    assert set(document["scores"]) == {"physics", "gated", "ungated"}
    assert document["runs"] == {"training": 6, "validation": 1, "test": 1}
    assert document["weights_sha256"] == read_field_weights(folder / "w.json").hash
    page = (folder / "report" / "report.html").read_text(encoding="utf-8")
    assert "Network behind its gate" in page
    assert {path.stem for path in (folder / "report" / "figures").iterdir()} == {"after_a_change", "training_loss"}


def test_interrupted_and_continued_gives_the_same_weights(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One block is made, the second is interrupted; the next call makes the second one alone. What a block is made of
    goes through what another process would get."""
    monkeypatch.setattr(specification, "FIELD_NETWORK", replace(specification.FIELD_NETWORK, block=4))
    original, calls = specification.make_block, []

    def interrupted(*arguments: object) -> object:
        calls.append(arguments[-1])
        if len(calls) == 2:
            raise KeyboardInterrupt
        return original(*pickle.loads(pickle.dumps(arguments)))  # noqa: S301

    monkeypatch.setattr(specification, "make_block", interrupted)
    arguments = ("estimator", "train", folder / "study.toml", "--recipe", folder / "few.toml", "--seed", "2")
    files = ("--workers", "1", "--out", folder / "again.json", "--windows", folder / "again.npz")
    stopped = call(*arguments, *files)
    assert stopped.exit_code == 130
    assert "finished runs are kept" in stopped.output
    assert not (folder / "again.json").exists()
    document = as_json(*arguments, *files)
    assert calls == [range(0, 4), range(4, 8), range(4, 8)]
    assert document["weights_sha256"] == read_field_weights(folder / "w.json").hash


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ("jump_share = 0.9", "jump_share = 1.5: is the sum of the four shares, above 1"),
        ('learn = "2 s"', "learn = 2 s: must be below first"),
        ("first_cycle = 1", "first_cycle = 1: must be from first_cycle_refuted = 2"),
        ('background = "noisy"', 'background = "noisy": must be one of "clean", "measured", "dirty"'),
        ("P_pu = { uniform = [3, 4] }", "P_pu.uniform[0] = 3: outside -2 to 2"),
        ('converters = ["case:nobody"]', 'converters = "case:nobody": case:nobody: 1 fault'),
        ("converters = 3", "converters = 3: must be a list of texts"),
        ("scenarios = 4", "scenarios: unknown field"),
        ("scr = nan", "scr = "),
    ],
)
def test_faults_are_named_and_nothing_is_written(asked: Path, tmp_path: Path, lines: str, says: str) -> None:
    (tmp_path / "r.toml").write_text(f'base = "field"\n{lines}\n', encoding="utf-8")
    recipe = ("--recipe", tmp_path / "r.toml")
    message = failure(2, "estimator", "train", asked / "study.toml", *recipe, "--out", tmp_path / "w.json")
    assert says in message
    assert not (tmp_path / "w.json").exists()


def test_a_packaged_case_may_be_a_further_converter(asked: Path) -> None:
    """Its name was refused, because it had the prefix."""
    _, further = specification.studies_of(load_study(asked / "study.toml"), ("case:hoang2025_5kva",))
    assert (further.name, further.converter.S_rated) == ("hoang2025_5kva", 5e3)


def test_what_does_not_fit_is_refused(asked: Path, tmp_path: Path) -> None:
    train = ("estimator", "train", asked / "study.toml", "--out", tmp_path / "w.json")
    assert "components = 3: the network of the field estimator has none" in failure(
        2, *train, "--recipe", "field", "--components", "3"
    )
    assert "only the recipe field has one" in call(*train, "--recipe", "wide", "--report", tmp_path / "r").output
    (tmp_path / "w.json").write_text("mine\n", encoding="utf-8")
    assert "left untouched" in failure(2, *train, "--recipe", "field")
    assert (tmp_path / "w.json").read_text(encoding="utf-8") == "mine\n"


def test_a_converter_that_cannot_run_the_draws_says_why(asked: Path, tmp_path: Path) -> None:
    (tmp_path / "r.toml").write_text('base = "field"\nruns = 6\nP_pu = 1.9\n', encoding="utf-8")
    recipe = ("--recipe", tmp_path / "r.toml")
    message = failure(1, "estimator", "train", asked / "study.toml", *recipe, "--out", tmp_path / "w.json")
    assert "none of 200 draws of run 0 can be run (" in message
    assert "ask for less P_pu" in message
