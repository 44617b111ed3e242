"""What a finished run leaves: promised keys, files and series, and the same again when run again."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.small_studies import SMALL, as_json, call, study_file
from vsgdesign.artifacts import read_npz

SERIES = [
    "t_s", "v_pcc_a", "v_pcc_b", "v_pcc_c", "i_pcc_a", "i_pcc_b", "i_pcc_c", "P_pcc", "Q_pcc",
    "omega", "V_rms", "delta", "R_g", "L_g", "K_ip", "D_p", "K_iq", "D_q",
]  # fmt: skip
GAINS = ["K_ip", "D_p", "K_iq", "D_q"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of one run of the small study."""
    parent = tmp_path_factory.mktemp("run")
    result = call("simulate", study_file(parent), "--out", parent / "out")
    assert result.exit_code == 0, result.output
    return parent / "out"


@pytest.fixture(scope="module")
def results(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


def test_files(folder: Path) -> None:
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["fixed.csv", "fixed.npz", "results.json", "scheduled.csv", "scheduled.npz"]


def test_study_and_timing(results: dict[str, Any]) -> None:
    assert results["schema"] == 1
    assert results["study"]["name"] == "small"
    assert re.fullmatch("[0-9a-f]{64}", results["study"]["hash"])
    assert "hoang" in results["study"]["source"].lower()
    assert results["provenance"]["numpy"] == np.__version__
    assert {"simulate", "write"} <= set(results["timing_s"])
    assert all(seconds > 0.0 for seconds in results["timing_s"].values())


def test_events(results: dict[str, Any]) -> None:
    assert list(results["controllers"]) == ["fixed", "scheduled"]
    for controller in results["controllers"].values():
        events = controller["events"]
        assert [(e["t_s"], e["signal"]) for e in events] == [
            (0.1, "P_pcc"),
            (0.1, "Q_pcc"),
            (0.2, "P_pcc"),
            (0.2, "Q_pcc"),
        ]
        for event in events:
            assert {"name", "kind", "overshoot_pct", "settling_time_s", "rise_time_s", "peak_current_pu"} <= set(event)
            assert {"overshoot_pct", "settling_time_s", "rise_time_s"} <= set(event["cycle_mean"])
        step, disturbance = events[0], events[2]
        assert (step["name"], step["kind"]) == ("P_ref 2.5 kW", "step")
        # 0.1 s is too short for a design of 1 s: no figure, and why.
        assert (step["overshoot_pct"], step["settling_time_s"], step["rise_time_s"]) == (None, None, None)
        assert (step["status"], step["final"]) == ("window too short", pytest.approx(2500.0, abs=1e-3))
        assert step["reason"].startswith("the window is too short: 0.1 s after the step, the slowest mode needs")
        assert step["needs_s"] > 0.5
        assert disturbance["kind"] == "disturbance"
        assert disturbance["overshoot_pct"] is None
        assert disturbance["rise_time_s"] is None


def test_gains(results: dict[str, Any]) -> None:
    fixed, scheduled = (results["controllers"][name]["gains"] for name in ("fixed", "scheduled"))
    assert [change["t_s"] for change in fixed] == [0.0]
    # A grid that changes at an update is seen by the next one, 20 ms later.
    assert [change["t_s"] for change in scheduled] == pytest.approx([0.0, 0.22])
    for change in fixed + scheduled:
        assert list(change) == ["t_s", *GAINS]
        assert all(change[name] > 0.0 for name in GAINS)
    assert scheduled[1]["D_p"] > 2.0 * scheduled[0]["D_p"]


def test_operating_points(results: dict[str, Any]) -> None:
    points = results["operating_points"]
    assert [(p["controller"], p["t_s"]) for p in points] == [
        (name, t_s) for name in ("fixed", "scheduled") for t_s in (0.0, 0.1, 0.2)
    ]
    assert [p["P"] for p in points] == pytest.approx([2e3, 2.5e3, 2.5e3] * 2)  # nominal frequency
    # SCR 2 and 8 on the reactance at X/R = 1: X_g = 3·110²/5000/SCR.
    assert [p["R_g"] for p in points] == pytest.approx([3.63, 3.63, 0.9075] * 2)
    assert [p["L_g"] * 100.0 * np.pi for p in points] == pytest.approx([3.63, 3.63, 0.9075] * 2)
    for point in points:
        assert {"R_g", "L_g", "V_rms", "delta", "A", "B", "C", "D"} <= set(point)
        # Q follows its droop with the gains at the end of each part.
        gains = [g for g in results["gains"] if g["controller"] == point["controller"]]
        D_q = gains[-1 if point["t_s"] == 0.2 else 0]["D_q"]
        assert point["Q"] == pytest.approx(1e3 + D_q * (110.0 - point["V_rms"]), rel=1e-6)


def test_series(folder: Path, results: dict[str, Any]) -> None:
    series = read_npz(folder / "scheduled.npz")
    assert list(series) == SERIES
    t_s = series["t_s"]
    np.testing.assert_allclose(t_s, np.arange(1500) * 2e-4, atol=1e-12)
    assert series["P_pcc"][0] == pytest.approx(2000.0, abs=1e-3)
    # P = v·i summed over the phases, as a power meter would.
    P = sum(series[f"v_pcc_{phase}"] * series[f"i_pcc_{phase}"] for phase in "abc")
    np.testing.assert_allclose(P, series["P_pcc"], atol=5e-3)  # single precision of some 1e4 W
    np.testing.assert_allclose(series["R_g"], np.where(t_s < 0.2 - 1e-9, 3.63, 0.9075), rtol=1e-6)
    first, second = results["controllers"]["scheduled"]["gains"]
    for name in GAINS:
        np.testing.assert_allclose(series[name], np.where(t_s < 0.22 - 1e-9, first[name], second[name]), rtol=1e-6)


def test_csv_is_the_thinned_npz(folder: Path) -> None:
    series = read_npz(folder / "fixed.npz")
    with (folder / "fixed.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [name.split(" [")[0] for name in rows[0]] == SERIES
    assert len(rows) == 150  # 0.3 s every 2 ms
    column = [float(row["P_pcc [W]"]) for row in rows]
    np.testing.assert_allclose(column, series["P_pcc"][::10], rtol=1e-6)


def test_json_on_standard_output_is_the_file(tmp_path: Path) -> None:
    printed = as_json("simulate", study_file(tmp_path), "--out", tmp_path / "out")
    assert printed == json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))


def test_again_gives_the_same_and_replaces(folder: Path, results: dict[str, Any], tmp_path: Path) -> None:
    study, out = study_file(tmp_path), tmp_path / "out"
    as_json("simulate", study, "--out", out)
    again = as_json("simulate", study, "--out", out)
    assert again == json.loads((out / "results.json").read_text())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "small.toml"]
    assert again["study"] == results["study"]
    assert again["operating_points"] == results["operating_points"]
    for name, controller in again["controllers"].items():
        assert controller["events"] == results["controllers"][name]["events"]
        assert (out / f"{name}.csv").read_bytes() == (folder / f"{name}.csv").read_bytes()


def test_out_defaults_to_the_studys_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = call("simulate", study_file(tmp_path))
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "small-simulation" / "results.json").is_file()
    assert "results: out/small-simulation/results.json" in result.stdout.replace("\\", "/")


def test_the_table_shows_the_steps(tmp_path: Path) -> None:
    result = call("simulate", study_file(tmp_path), "--out", tmp_path / "out")
    for shown in ("controller", "overshoot", "settles 2 %", "peak current", "fixed", "scheduled", "P_ref 2.5 kW"):
        assert shown in result.stdout
    assert "too short" in result.stdout  # 0.1 s is, for a design of 1 s
    assert re.search(r"fixed, 0.1 s, P_pcc.*: the window is too short: 0.1 s after the step, .* needs", result.stdout)


UNSTABLE = """
base = "case:hoang2025_5kva"
[grid]
scr = 20
x_over_r = 20
[simulation]
duration = "0.3 s"
P_ref = "2 kW"
Q_ref = "1 kvar"
[[controllers]]
name = "fixed"
kind = "fixed"
[[events]]
time = "0.1 s"
P_ref = "2.1 kW"
"""


@pytest.mark.parametrize("verb", ["simulate", "run"])
def test_an_unstable_controller_is_said_and_simulated(tmp_path: Path, verb: str) -> None:
    """It was "674 %, not settled" and nothing else. What was asked for is done: exit code 0."""
    more = ["--no-explorer"] if verb == "run" else []
    result = call(verb, study_file(tmp_path, UNSTABLE), "--out", tmp_path / "out", *more)
    assert result.exit_code == 0
    assert "warning: controller fixed is unstable from the start to 0.3 s, on SCR 20, X/R 20: a mode" in result.stderr
    assert "vsgdesign margins" in result.stderr
    assert "unstable" in result.stdout
    document = json.loads((tmp_path / "out" / "results.json").read_text())
    (warning,) = document["warnings"]
    assert (warning["controller"], warning["t_s"], warning["grid"]["scr"]) == ("fixed", 0.0, pytest.approx(20.0))
    mode = warning["mode"]
    assert mode["real"] > 0.0 > mode["damping_ratio"]
    assert mode["frequency_hz"] == pytest.approx(abs(mode["imag"]) / (2.0 * np.pi))
    assert next(iter(mode["participation"])) == "grid current"
    step = next(e for e in document["controllers"]["fixed"]["events"] if e["signal"] == "P_pcc")
    assert (step["status"], step["overshoot_pct"], step["settling_time_s"]) == ("unstable", None, None)
    if verb == "run":
        page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
        assert page.index("Unstable.") < page.index("<h2>")
        assert "controller fixed is unstable" in page
        assert "fixed does not meet its settling time" in page


def test_a_bolted_fault_runs(tmp_path: Path) -> None:
    text = UNSTABLE.replace("scr = 20\nx_over_r = 20", "scr = 4").replace('P_ref = "2.1 kW"', "V_g_pu = 0.0")
    text += '[[events]]\ntime = "0.15 s"\nV_g_pu = 1.0\n'
    study = study_file(tmp_path, text)
    for verb in ("simulate", "run --no-explorer"):
        name, *more = verb.split()
        result = call(name, study, "--out", tmp_path / name, *more)
        assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "run" / "results.json").read_text())
    (none,) = [point for point in document["operating_points"] if point["V_rms"] is None]
    assert (none["controller"], none["t_s"], none["P"]) == ("fixed", 0.1, None)
    assert "bolted fault" in none["reason"]
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert ">no rest<" in page
    assert "fixed, from 0.1 s on: no operating point" in page


def test_bridge_is_overridden(tmp_path: Path) -> None:
    study = study_file(tmp_path, duration='"0.25 s"')
    averaged = as_json("simulate", study, "--out", tmp_path / "averaged")
    switched = as_json("simulate", study, "--out", tmp_path / "pwm", "--bridge", "pwm")
    assert {c["bridge"] for c in averaged["controllers"].values()} == {"averaged"}
    assert {c["bridge"] for c in switched["controllers"].values()} == {"pwm"}
    assert switched["study"] == averaged["study"]
    one, other = (read_npz(tmp_path / name / "fixed.npz")["P_pcc"] for name in ("averaged", "pwm"))
    assert 0.1 < np.abs(one - other).max() < 500.0  # ripple, and the same run


def test_a_run_without_events(tmp_path: Path) -> None:
    results = as_json("simulate", study_file(tmp_path, SMALL[: SMALL.index("[[events]]")]), "--out", tmp_path / "out")
    for controller in results["controllers"].values():
        assert controller["events"] == []
    P = read_npz(tmp_path / "out" / "fixed.npz")["P_pcc"]
    np.testing.assert_allclose(P, 2000.0, atol=1e-3)


def test_a_run_with_one_sample(tmp_path: Path) -> None:
    study = study_file(tmp_path, SMALL[: SMALL.index("[[events]]")], duration='"0.1 s"\nlog_interval = "0.5 s"')
    as_json("simulate", study, "--out", tmp_path / "out")
    assert read_npz(tmp_path / "out" / "fixed.npz")["t_s"].tolist() == [0.0]
