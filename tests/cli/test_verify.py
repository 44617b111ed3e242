"""The verify verb: the same numbers everywhere, cases that simulate repeats, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests import gain_tables
from tests.cli.small_studies import as_json, call, failure
from vsgdesign.artifacts import write_table_file
from vsgdesign.campaigns.verification import blocks

TEXT = """
base = "case:hoang2025_5kva"
[study]
name = "small"
[power_loops]
structure = "angle_damped"
settling_time = "0.4 s"
[simulation]
duration = "1 s"
P_ref = "2 kW"
Q_ref = "0 var"
[verification]
runs = 24
seed = 7
scr = [2, 10]
x_over_r = [0.5, 5]
scr_basis = "impedance"
[estimator]
recipe = "published"
[[controllers]]
name = "tabled"
kind = "scheduled"
schedule = "table"
estimate = "neural"
table = "missing.json"
[[controllers]]
name = "scheduled"
kind = "scheduled"
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("study") / "small.toml"
    path.write_text(TEXT)
    return path


@pytest.fixture(scope="module")
def verified(study: Path) -> tuple[Path, dict[str, Any]]:
    out = study.parent / "out"
    return out, as_json("verify", study, "--workers", "1", "--search", "0", "--no-explorer", "--out", out)


def test_what_is_printed_is_what_is_kept(verified: tuple[Path, dict[str, Any]]) -> None:
    out, printed = verified
    assert json.loads((out / "results.json").read_text()) == printed
    assert (printed["controller"], printed["seed"], printed["runs"]) == ("scheduled", 7, 24)
    families = printed["families"].values()
    assert printed["judged"] == sum(family["judged"] for family in families)
    assert sum(family["drawn"] for family in families) == 24
    page = (out / "report.html").read_text()
    settling = printed["families"]["step"]["promises"]["settling"]
    assert f"{settling['broken']} of {settling['judged']} steps above 0.4 s" in page
    assert printed["search"] == {"evaluations": 0, "broken": 0, "found": []}
    assert "search" not in printed["timing_s"]


def test_simulate_repeats_the_worst_case(verified: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    out, printed = verified
    assert all(row["agrees"] for row in printed["worst"])
    row = next(row for row in printed["worst"] if row["family"] == "step")
    again = as_json("simulate", out / row["study"], "--out", tmp_path / "again")
    events = again["controllers"]["scheduled"]["events"]
    step = next(event for event in events if event["kind"] == "step")
    assert step["settling_time_s"] == pytest.approx(row["figures"]["settling_s"], abs=1e-6)
    assert step["overshoot_pct"] / 100.0 == pytest.approx(row["figures"]["overshoot"], abs=1e-6)


def test_a_table_is_verified_with_the_errors_of_the_cases(study: Path, tmp_path: Path) -> None:
    """The estimator of its controller is not run: its case says what the controller is told instead."""
    write_table_file(gain_tables.table(), tmp_path / "table.json")
    out = tmp_path / "out"
    found = as_json(
        *("verify", tmp_path / "table.json", "--study", study, "--runs", "6", "--no-explorer"),
        *("--workers", "1", "--search", "0", "--no-explorer", "--out", out),
    )
    assert (found["controller"], found["runs"]) == ("tabled", 6)
    assert all(row["agrees"] for row in found["worst"])
    assert 'table = "../table.json"' in (out / found["worst"][0]["study"]).read_text()
    assert (out / "table.json").read_bytes() == (tmp_path / "table.json").read_bytes()


def test_an_interruption_says_what_is_kept(study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = blocks.VerificationJob.run

    def stopping(job: Any, number: int) -> Any:
        if number == 1:
            raise KeyboardInterrupt
        return run(job, number)

    monkeypatch.setattr(blocks.VerificationJob, "run", stopping)
    monkeypatch.setattr(blocks.VerificationJob, "span", lambda _, number: (8 * number, 8))
    monkeypatch.setattr(blocks.VerificationJob, "blocks", range(3))
    result = call("verify", study, "--workers", "1", "--no-explorer", "--out", tmp_path / "out")
    assert result.exit_code == 130
    assert result.stderr == "interrupted: 8 finished runs are kept; the same command continues there\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--shard", "3/2"), "the first of N is 1/N, the last is N/N"),
        (("--shard", "1/2", "--merge", "x"), "--merge puts parts together"),
        (("--merge", "x", "--runs", "5"), "are those of the shards"),
        (("--runs", "nan"), "--runs"),
        (("--confidence", "1"), "0.999999"),
        (("--confidence", "nan"), "nan is not in the range 0.5<=x<=0.999999"),
        (("--cluster", "tcp://x:1", "--workers", "2"), "has its own workers"),
        (("--controller", "nobody"), "The study has: tabled, scheduled."),
        (("--controller", "tabled"), "missing.json"),
        (("--merge", "nowhere"), "has no counts.json"),
    ],
)
def test_what_is_refused(study: Path, arguments: tuple[str, ...], said: str) -> None:
    assert said in failure(2, "verify", study, *arguments)


def test_no_number_of_seconds_is_refused_before_a_design(study: Path, tmp_path: Path) -> None:
    said = failure(2, "table", "build", study, "--out", tmp_path / "table.json", "--full-order", "nan")
    assert "'--full-order': nan is not in the range x>=0.0" in said


def test_a_table_alone_has_no_converter(tmp_path: Path) -> None:
    assert "--study names the study" in failure(2, "verify", tmp_path / "table.json")
