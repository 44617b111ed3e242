"""Files that a study names: looked up beside the study, opened by validate, there for a run from Python."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.artifacts.networks import random_weights
from tests.cli.small_studies import SMALL, call, failure
from tests.gain_tables import table
from vsgdesign.artifacts import write_table_file
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.artifacts.network_weights import read_network_weights, write_network_weights
from vsgdesign.artifacts.ready import Ready, read_tables
from vsgdesign.artifacts.table_text import table_lines
from vsgdesign.certificate import beyond_table, region_of
from vsgdesign.design import certify
from vsgdesign.runtime.of_study import schedule_of
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import load_study
from vsgdesign.verbs.pipeline import make_ready

TABLE = """
[[controllers]]
name = "tabled"
kind = "scheduled"
structure = "angle_damped"
schedule = "table"
table = "tables/t.json"
"""
NETWORK = """
[[controllers]]
name = "network"
kind = "scheduled"
estimate = "neural"

[estimator]
grid_phase = true
"""


def with_table(folder: Path, **changes: Any) -> Path:
    """A study in a folder of its own, with its table in another one beside it."""
    (folder / "tables").mkdir(parents=True)
    study = folder / "mine.toml"
    study.write_text(SMALL + TABLE, encoding="utf-8")
    base = base_of(load_study(study), "impedance")
    made = table(base=base)
    if changes:
        made = table(base=replace(base, **changes))
    write_table_file(made, folder / "tables" / "t.json")
    return study


def test_a_loaded_studys_table_is_there(tmp_path: Path) -> None:
    """One call between loading and a run, a schedule or a certificate; the working folder does not matter."""
    study = load_study(with_table(tmp_path / "there"))
    spec = study.controllers[-1]
    assert spec.table_file == str(tmp_path / "there" / "tables" / "t.json")
    ready = make_ready(study)
    run = run_scenario(study, ready).controllers[-1]
    assert run.spec.name == "tabled"
    given = Ready(tables={"tabled": table(base=base_of(study, "impedance"))})
    other = run_scenario(replace(study, controllers=(spec,)), given).controllers[0]
    assert [change.gains for change in run.gain_changes] == [change.gains for change in other.gain_changes]
    assert schedule_of(study, spec, ready).structure == "angle_damped"
    _, region = region_of(study, None, (5.0, 20.0), (1.0, 10.0), (0.0, 0.5), (0.0, 0.2), 0.0, ready=ready)
    assert certify(study, spec, region, ready=ready, budget=0, nodes_per_axis=4, fresh=100).controller == "tabled"


def test_files_are_relative_to_what_names_them(tmp_path: Path) -> None:
    """A base's own file is beside the base; the content hash does not depend on where all of it lies."""
    hashes = []
    for place in ("a", "b/c"):
        home = tmp_path / place
        with_table(home / "lab")
        (home / "lab" / "base.toml").write_text(
            (home / "lab" / "mine.toml").read_text() + NETWORK + 'weights = "w.json"\n'
        )
        (home / "top.toml").write_text('base = "lab/base.toml"\nstudy = { name = "top" }\n')
        study = load_study(home / "top.toml")
        assert Path(str(study.controllers[2].table_file)).resolve() == (home / "lab" / "tables" / "t.json").resolve()
        assert study.estimator is not None
        assert study.estimator.weights_file == str(home / "lab" / "w.json")
        hashes.append(study.hash)
    assert hashes[0] == hashes[1]
    absolute = with_table(tmp_path / "d")
    absolute.write_text(absolute.read_text().replace("tables/t.json", str(tmp_path / "d" / "tables" / "t.json")))
    assert load_study(absolute).controllers[-1].table_file == str(tmp_path / "d" / "tables" / "t.json")
    named = tmp_path / "named.toml"
    named.write_text(SMALL + NETWORK + 'recipe = "continuous"\n')
    estimator = load_study(named).estimator
    assert estimator is not None
    assert estimator.recipe == "continuous"
    named.write_text(SMALL + NETWORK + 'recipe = "r.toml"\n')
    estimator = load_study(named).estimator
    assert estimator is not None
    assert estimator.recipe == str(tmp_path / "r.toml")


def test_weights_of_a_loaded_study_are_there(tmp_path: Path) -> None:
    study_file = tmp_path / "n.toml"
    study_file.write_text(SMALL + NETWORK + 'weights = "w.json"\n')
    write_network_weights(random_weights(), tmp_path / "w.json")
    study = load_study(study_file)
    run = run_scenario(study, make_ready(study)).controllers[-1]
    assert run.estimates is not None
    assert len(run.estimates.t_s) == 15
    assert read_network_weights(tmp_path / "w.json").hash == random_weights().hash


def test_validate_opens_what_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = with_table(tmp_path / "good")
    monkeypatch.chdir(tmp_path)
    assert call("validate", study).exit_code == 0
    (tmp_path / "good" / "tables" / "t.json").unlink()
    text = failure(2, "validate", study)
    assert f'controllers[2].table = "{tmp_path / "good" / "tables" / "t.json"}": cannot read' in text
    assert "1 fault" in text
    other = with_table(tmp_path / "other", S_rated=6e3)
    assert "base.S_rated is 6000.0, the study has 5000.0" in failure(2, "validate", other)


def test_validate_finds_all_faults_at_once(tmp_path: Path) -> None:
    study = with_table(tmp_path / "bad")
    (tmp_path / "bad" / "tables" / "t.json").write_text("{}")
    for line, says in (
        ('weights = "w.json"', "estimator.weights"),
        ('recipe = "r.toml"', "estimator.recipe: recipe"),
    ):
        study.write_text(SMALL + TABLE + NETWORK + line + "\n")
        text = failure(2, "validate", study)
        assert "2 faults" in text
        assert "it is not a gain table" in text
        assert says in text
    (tmp_path / "bad" / "r.toml").write_text('nois = 1\nsamples = "x"\n')
    text = failure(2, "validate", study)
    assert "3 faults" in text
    assert "estimator.recipe: nois: unknown field. Did you mean noise_v?" in text
    write_network_weights(random_weights(samples=80), tmp_path / "bad" / "w.json")
    fixed = NETWORK.replace("[estimator]", 'update_period = "20 ms"\n[estimator]')
    study.write_text(SMALL + fixed + 'weights = "w.json"\n')
    text = failure(2, "validate", study)
    assert "these weights do not fit" in text
    assert "update_period = 20 ms" in text


def test_a_run_says_of_its_table_what_results_say(tmp_path: Path) -> None:
    """Page, terminal and results.json: one text."""
    study = with_table(tmp_path / "there")
    result = call("run", study, "--no-explorer", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "out" / "results.json").read_text())["controllers"]["tabled"]["table"]
    page = html.unescape(re.sub(r"<[^>]+>", "", (tmp_path / "out" / "report.html").read_text()))
    lines = list(table_lines("tabled", document))
    assert document["certificate"]["text"] in lines
    for line in lines:
        assert line in result.stdout
        assert line in page


def test_a_tables_region_is_its_own(tmp_path: Path) -> None:
    """What certify asks by default is what the table's certificate covers."""
    study = load_study(with_table(tmp_path / "there"))
    study = replace(study, scr_basis=table().base.scr_basis)
    ready = Ready(tables=read_tables(study))
    _, region = region_of(study, "tabled", None, None, ready=ready)
    box = ready.tables["tabled"].validity
    assert (region.scr, region.x_over_r, region.P, region.Q, region.error) == (
        box.scr,
        box.x_over_r,
        box.P,
        box.Q,
        box.error,
    )
    _, narrower = region_of(study, "tabled", (5.0, 6.0), None, None, (0.0, 0.1), ready=ready)
    assert (narrower.scr, narrower.x_over_r) == ((5.0, 6.0), box.x_over_r)
    assert (0.0, 0.1 * study.converter.S_rated) == narrower.Q
    made = ready.tables["tabled"]
    assert list(beyond_table(region, made)) == list(beyond_table(narrower, made)) == []
    _, beyond = region_of(study, "tabled", None, None, (1.8, 1.9), error=0.3, ready=ready)
    assert list(beyond_table(beyond, made)) == [
        "Beyond the table: P 9 to 9.5 kW is asked for, and the table was designed for -4.5 to 4.5 kW.",
        "Beyond the table: an error of 30 % of R_g and L_g is asked for, and the table was designed for 20 %.",
    ]
