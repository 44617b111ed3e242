"""table show, check and compare: what they print, as JSON too, exit codes, and wrong files."""

from __future__ import annotations

import html
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.small_studies import as_json, call, study_file
from tests.gain_tables import table
from vsgdesign.artifacts import GainTable, read_table_file, write_table_file
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.linear.stability.gain_table import nominal_margins
from vsgdesign.report.gain_table import page as table_page
from vsgdesign.study.parameters import load_study

AXES: dict[str, Any] = {"scr": (2.0, 8.0), "x_over_r": (0.5, 3.0)}


def whole(**changes: Any) -> GainTable:
    made = table(**AXES, **changes)
    return replace(made, margins=nominal_margins(made) | {"worst_settling_P_s": np.full((2, 2), 1.25)})


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tables") / "mine.json"
    active = [["settling", ""], ["", "overshoot"]]
    write_table_file(whole(active=active, certificate={"decay": 2.1, "proof": "gridded", "P": [[1.0]]}), path)
    return path


def test_show(written: Path) -> None:
    result = call("table", "show", written)
    assert result.exit_code == 0
    for part in (
        "angle_damped, law poles",
        "2 SCR (impedance basis) × 2 X/R: 4 met, 0 relaxed, 0 outside",
        "5 kVA, 110 V",
        "the same in every cell: k_1 = 15.8 1/s², d_1 = 6.6 1/s, k_2 = 4 1/s, q = 0, share_P = 1, share_Q = 1",
        "R and X known to ±20 %",
        "2 % settling of P and Q ≤ 1.5 s",
        "Certified on a grid only, not gap-free",
        "decays at 2.1 1/s or faster",
        "Overshoot of P [%]",
        "2 % settling of P, worst of the box [s]",
        "met: overshoot",
        read_table_file(written).sha256,
    ):
        assert part in result.stdout, part


def test_show_prints_columns_that_vary(tmp_path: Path) -> None:
    write_table_file(table(**AXES, parameters={"k_1": np.array([[10.0, 11.0], [12.0, 13.5]])}), tmp_path / "t.json")
    shown = call("table", "show", tmp_path / "t.json").stdout
    assert "k_1 [1/s²]" in shown
    assert "13.5" in shown
    assert "There is no certificate" in shown


def test_show_as_json_is_the_file(written: Path) -> None:
    assert as_json("table", "show", written) == json.loads(written.read_text(encoding="utf-8"))


def test_check(written: Path) -> None:
    result = call("table", "check", written)
    assert result.exit_code == 0
    assert "no fault was found in what can be checked. closed form, 4 cells analysed anew: 4 met" in result.stdout
    carried = "worst_settling_P_s, active, certificate (it does not state its region)"
    assert f"carried, not checked: {carried}" in result.stdout
    document = as_json("table", "check", written)
    assert (document["good"], document["faults"]) == (False, [])
    assert document["largest"]["disk_margin_output"] < 1e-9


def test_check_finds_and_says_so(tmp_path: Path) -> None:
    made = whole()
    write_table_file(
        replace(made, margins=made.margins | {"disk_margin_output": np.full((2, 2), 1.9)}), tmp_path / "t.json"
    )
    result = call("table", "check", tmp_path / "t.json")
    assert result.exit_code == 1
    fault = "margins.disk_margin_output is 1.9 at SCR 2, X/R 0.5 and 3 more cells, the reduced model gives 1.3"
    assert fault in result.stdout
    result = call("table", "check", tmp_path / "t.json", "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["good"] is False


def test_what_was_computed_again_as_a_whole_is_good(tmp_path: Path) -> None:
    made = table(**AXES)
    write_table_file(replace(made, margins=nominal_margins(made)), tmp_path / "t.json")
    assert "good. closed form, 4 cells analysed anew" in call("table", "check", tmp_path / "t.json").stdout
    assert as_json("table", "check", tmp_path / "t.json")["good"] is True


def test_check_against_a_study(tmp_path: Path) -> None:
    study = load_study(study_file(tmp_path))
    made = table(**AXES, base=base_of(study, "impedance"), study_hash=study.hash)
    write_table_file(made, tmp_path / "t.json")
    assert call("table", "check", tmp_path / "t.json", "--study", tmp_path / "small.toml").exit_code == 0
    # A table that was made by hand keeps no inputs: the document's hash alone can speak for it.
    write_table_file(replace(made, study_hash="e" * 64), tmp_path / "t.json")
    result = call("table", "check", tmp_path / "t.json", "--study", tmp_path / "small.toml")
    assert result.exit_code == 1
    assert "the table was made for eeeeeeeeeeee" in result.stdout


def test_compare(written: Path, tmp_path: Path) -> None:
    write_table_file(table("published", **AXES, name="published"), tmp_path / "p.json")
    result = call("table", "compare", written, tmp_path / "p.json")
    assert result.exit_code == 0
    assert "worst over the 4 grids" in result.stdout
    assert "largest differences" in result.stdout
    document = as_json("table", "compare", written, tmp_path / "p.json")
    first, second = document["tables"]
    assert first["differences"] == []
    assert second["worst"]["overshoot_P_pct"] > 40.0
    by_name = {row["figure"]: row for row in second["differences"]}
    assert by_name["overshoot_P_pct"]["x_over_r"] == 0.5
    assert by_name["K_ip"]["difference"] != 0.0


def test_wrong_files_are_wrong_input(written: Path, tmp_path: Path) -> None:
    changed = tmp_path / "changed.json"
    changed.write_bytes(written.read_bytes().replace(b'"D_p": 318.3', b'"D_p": 318.4'))
    other = tmp_path / "other.json"
    write_table_file(table(base=replace(whole().base, L_2=1e-3), name="other"), other)
    for arguments, problem in (
        (("show", changed), "does not match its sha256"),
        (("check", tmp_path / "no.json"), "No such file"),
        (("compare", written), "at least two tables"),
        (("compare", written, other), "different systems"),
        (("check", written, "--study", tmp_path / "no.toml"), "no.toml"),
    ):
        result = call("table", *arguments)
        assert result.exit_code == 2, arguments
        assert problem in result.stderr
        assert "Traceback" not in result.stderr


def test_report(written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = call("table", "report", written, "--out", tmp_path / "out")
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert lines[-1] == f"report: {tmp_path / 'out' / 'report.html'}"
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f">{html.escape(lines[0], quote=False)}<" in page[page.index('id="answer"') :]
    assert "4 of 4 met" in result.stdout
    assert (tmp_path / "out" / "table.json").read_bytes() == written.read_bytes()
    assert len(list((tmp_path / "out" / "figures").iterdir())) > 10
    for drawn_before in ("margin_figures", "gain_surfaces", "constraint_figures", "stale_figures"):
        monkeypatch.setattr(table_page, drawn_before, lambda _: ())
    again = as_json("table", "report", written, "--out", tmp_path / "out")
    assert again["cells"] == {"met": 4, "relaxed": 0, "outside": 0}
