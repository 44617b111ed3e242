"""``vsgdesign run``: everything that ``simulate`` leaves, and figures and a page beside it."""

from __future__ import annotations

import json
from pathlib import Path

from tests.cli.small_studies import call, study_file


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
