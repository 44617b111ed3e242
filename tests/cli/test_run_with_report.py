"""``vsgdesign run``: everything that ``simulate`` leaves, and figures and a page beside it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.small_studies import SMALL, call, study_file
from tests.report.test_answer import rows_on


def test_run(tmp_path: Path) -> None:
    result = call("run", study_file(tmp_path), "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    out = tmp_path / "out"
    assert str(out / "report.html") in result.stdout
    assert {path.name for path in out.iterdir()} == {
        "fixed.csv",
        "fixed.npz",
        "scheduled.csv",
        "scheduled.npz",
        "results.json",
        "report.html",
        "figures",
    }
    figures = {path.name for path in (out / "figures").iterdir()}
    assert {"active_power.svg", "active_power.png", "reactive_power.svg", "gains.svg", "bode_P.svg"} <= figures
    assert all(path.stat().st_size > 1000 for path in (out / "figures").iterdir())
    page = (out / "report.html").read_text(encoding="utf-8")
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    for shown in ("fixed", "scheduled", "2.5 kW", results["study"]["hash"][:8]):
        assert shown in page
    assert {"simulate", "write", "report"} == set(results["timing_s"])
    # One file that can be sent: nothing is fetched from elsewhere, and no path of this machine is in it.
    assert 'src="http' not in page
    assert str(tmp_path) not in page


def test_page_terminal_and_results_show_the_same_numbers(tmp_path: Path) -> None:
    """The small pictures' figures and the peak currents on top of the page, the terminal's rows, and results.json, of a
    switched bridge whose ripple leaves every band."""
    text = SMALL.replace('duration = "0.3 s"', 'duration = "5 s"\nlog_interval = "1 ms"').partition(
        '[[events]]\ntime = "0.2'
    )[0]
    result = call("run", study_file(tmp_path, text), "--bridge", "pwm", "--no-explorer", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    results = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    said = "No controller meets its settling time and overshoot on every reference step."
    assert result.stdout.startswith(f"{said}\n")
    assert re.search(f"<p[^>]*>{re.escape(said)}</p>", page)
    top = rows_on(tmp_path / "out" / "report.html")
    terminal = [re.split(r"  +", line.strip()) for line in result.stdout.splitlines()]
    for name, controller in results["controllers"].items():
        step = next(event for event in controller["events"] if event["kind"] == "step")
        verdicts, picture = [row for row in top if row[0] == name]
        settled, overshoot, peak = step["settling_time_s"], step["overshoot_pct"], step["peak_current_pu"]
        shown = re.fullmatch(r"[✓✗] \w+ ([\d.]+) s, ([\d.]+) %", picture[1])
        assert shown is not None, picture
        assert float(shown[1]) == pytest.approx(settled, rel=5e-3)
        assert float(shown[2]) == pytest.approx(overshoot, abs=0.05)
        assert f" {shown[1]} s, asked" in verdicts[1]
        assert f" {shown[2]} %, asked" in verdicts[2]
        assert float(verdicts[-1].partition(" ")[0]) == pytest.approx(peak, rel=5e-3)
        row = next(row for row in terminal if row[0] == name and "P_pcc" in row)
        assert row[4:6] == [f"{shown[2]} %", f"{shown[1]} s"]
        assert verdicts[-1].startswith(f"{row[-1]} ")
