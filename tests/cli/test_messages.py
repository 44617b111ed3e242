"""Input that nobody thought of: one error that says what is wrong and what to do, never a traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.artifacts.networks import random_weights
from tests.cli.small_studies import SMALL, call, failure, study_file
from tests.gain_tables import table
from vsgdesign.artifacts import write_table_file
from vsgdesign.artifacts.network_weights import write_network_weights
from vsgdesign.errors import counted
from vsgdesign.study.parameters import load_study


def test_one_is_not_many(tmp_path: Path) -> None:
    assert [counted(n, "fault") for n in (0, 1, 2)] == ["0 faults", "1 fault", "2 faults"]
    path = tmp_path / "t.json"
    made = table(scr=[2.0], x_over_r=[1.0])
    write_table_file(replace(made, margins={"disk_margin": [[1e-3]]}), path)
    shown = call("table", "check", path)
    assert shown.exit_code == 1
    assert shown.stdout.startswith(f"{path}: 1 fault\n  - ")


@pytest.mark.parametrize("verb", ["validate", "design", "simulate"])
def test_standard_input_pipes_and_devices_are_no_study_files(verb: str, tmp_path: Path) -> None:
    """Bases, tables and designed inner loops lie beside a study file; beside a pipe lies nothing. It does not wait."""
    os.mkfifo(tmp_path / "pipe")
    for path in ("-", "/dev/stdin", "/dev/null", tmp_path / "pipe"):
        message = failure(2, verb, path)
        assert "is a pipe or a device, not a study file. Save it as a file: bases, tables and designed" in message
    with study_file(tmp_path).open() as stream:
        command = [sys.executable, "-m", "vsgdesign.verbs.cli.program", verb, "/dev/stdin"]
        done = subprocess.run(command, stdin=stream, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "is a pipe or a device" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pipe", "small.toml"]


def test_a_datasheet_and_a_converter_of_the_package_are_no_studies(tmp_path: Path) -> None:
    """And a study is no datasheet: each says what to type."""
    sheet = tmp_path / "sheet.toml"
    sheet.write_text('schema = 1\nrating = "20 kVA"\nscr = [2, 10]\n', encoding="utf-8")
    said = failure(2, "validate", sheet)
    assert said.count("\n") == 2, "one fault, and not one for every row"
    assert f"write its study with vsgdesign new --from {sheet}." in said
    assert "Write its study with vsgdesign new --from case:lab_12kva_lcl." in failure(2, "run", "case:lab_12kva_lcl")
    study = study_file(tmp_path)
    said = failure(2, "new", "--from", study, "--out", tmp_path / "new.toml")
    assert said.count("\n") == 2
    assert f"is a study, not a datasheet. Run it: vsgdesign run {study}." in said


def test_every_missing_section_at_once(tmp_path: Path) -> None:
    """And other faults beside them: none hides another."""
    message = failure(2, "validate", study_file(tmp_path, 'colour = "red"\n[power_loops]\ntau_P = "1 m"\n'))
    for said in (
        "converter: missing table",
        "filter: missing table",
        "grid: missing table",
        "simulation: missing table",
        "controllers: none given",
        "colour: unknown field",
        'power_loops.tau_P = "1 m"',
    ):
        assert said in message, said


@pytest.mark.parametrize(
    ("second", "said"),
    [
        ("Fixed", '"fixed" is the same file name on many disks. Give names that differ in more than their case.'),
        ("fixed.estimates", 'files of "fixed" have the same names. Give another name.'),
        ("n" * 300, "has 300 bytes, more than 100. It becomes a part of file names. Give a shorter one."),
        ("ä" * 60, "has 120 bytes, more than 100"),
    ],
)
def test_names_that_cannot_be_files_side_by_side(second: str, said: str, tmp_path: Path) -> None:
    text = SMALL.replace('name = "scheduled"', f'name = "{second}"')
    message = failure(2, "validate", study_file(tmp_path, text))
    assert said in message
    assert len(message) < 300


def test_names_up_to_the_limit_are_fine(tmp_path: Path) -> None:
    text = SMALL.replace('name = "scheduled"', f'name = "{"n" * 100}"')
    assert len(load_study(study_file(tmp_path, text)).controllers) == 2
    result = call("simulate", tmp_path / "small.toml", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    "text",
    [
        ".".join("a" * 5000) + " = 1\n",
        "[" + ".".join("a" * 5000) + "]\n",
        "a = " + "[" * 60 + "]" * 60 + "\n",
        "a = " + "{a = " * 60 + "1" + "}" * 60 + "\n",
    ],
)
def test_deeply_nested_toml(text: str, tmp_path: Path) -> None:
    message = failure(2, "validate", study_file(tmp_path, text))
    assert "nested more than 50 levels deep. No field lies deeper than four; look for dots in keys." in message
    assert len(message) < 300


def test_weights_that_need_the_grids_phase_name_the_option(tmp_path: Path) -> None:
    write_table_file(table(), tmp_path / "t.json")
    write_network_weights(random_weights(synchronised=True), tmp_path / "w.json")
    message = failure(2, "export", "c", tmp_path / "t.json", "--weights", tmp_path / "w.json", "--out", tmp_path / "c")
    assert "the option --grid-phase, or with grid_phase = true under [estimator] in a study" in message
    assert "True" not in message
