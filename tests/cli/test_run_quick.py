"""run --quick makes nothing that is not there, and run --sheet writes one page that is never replaced."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.cli.small_studies import SMALL, call, failure, study_file
from tests.cli.test_run_beside import TABLED
from tests.gain_tables import table
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.artifacts.gain_table_file import write_table_file
from vsgdesign.report.page.pdf import sheets_of
from vsgdesign.report.scenario.page import sheet_page, write_sheet
from vsgdesign.simulation.scenario import run_scenario
from vsgdesign.study.parameters import load_study, study_from_text
from vsgdesign.verbs.pipeline import making, study_tables


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study of which a table and a network are missing; neither may be made."""

    def never(*_: object, **__: object) -> None:
        raise AssertionError("a quick run makes nothing")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(study_tables, "_designed", never)
    monkeypatch.setattr(making, "verified_table", never)
    monkeypatch.setattr("vsgdesign.estimator.specification.train", never)
    (tmp_path / "few.toml").write_text('base = "continuous"\nscenarios = 20\nbridge = "averaged"\n', encoding="utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(SMALL.replace('name = "small"', 'name = "mine"') + TABLED, encoding="utf-8")
    return path


def test_a_quick_run_leaves_out_what_would_have_to_be_made(study: Path) -> None:
    result = call("run", study, "--quick", "--no-explorer", "--sheet", "sheet.pdf")
    assert result.exit_code == 0, result.output
    left_out = [line for line in result.stderr.splitlines() if "left out" in line]
    assert [line.split()[0] for line in left_out] == ["tabled", "network"]
    document = json.loads(Path("out/mine-quick/results.json").read_text(encoding="utf-8"))
    assert list(document["controllers"]) == ["fixed", "scheduled"]
    assert document["left_out"] == left_out
    page = Path("out/mine-quick/report.html").read_text(encoding="utf-8")
    assert all(sentence in page for sentence in left_out)
    assert not Path("out/mine").exists()
    assert Path("sheet.pdf").read_bytes().startswith(b"%PDF")


def test_a_quick_run_takes_a_table_that_is_there(study: Path) -> None:
    text = study.read_text(encoding="utf-8").replace(
        'schedule = "table"', 'schedule = "table"\ntable = "mine.table.json"'
    )
    study.write_text(text + "[verification]\nwith_run = 1000\n", encoding="utf-8")
    write_table_file(table(base=base_of(load_study(study), "impedance")), study.with_name("mine.table.json"))
    found = call("run", study, "--quick", "--no-explorer", "--json")
    document = json.loads(found.stdout)
    assert list(document["controllers"]) == ["fixed", "scheduled", "tabled"]
    assert document["controllers"]["tabled"]["table"]["verification"] is None


def test_a_quick_run_of_nothing_and_of_a_switched_bridge_is_refused(study: Path) -> None:
    assert "leave --bridge pwm out" in failure(2, "run", study, "--quick", "--bridge", "pwm")
    text = study.read_text(encoding="utf-8")
    for name in ("fixed", "scheduled"):
        text = text.replace(f'[[controllers]]\nname = "{name}"\nkind = "{name}"\n', "")
    study.write_text(text, encoding="utf-8")
    assert "there is nothing to run. tabled is left out" in failure(1, "run", study, "--quick")


def test_a_sheet_is_never_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be signed. It is refused before the work begins."""
    monkeypatch.setattr("vsgdesign.verbs.pipeline.run_study", lambda *_, **__: pytest.fail("the work began"))
    signed = tmp_path / "signed.pdf"
    signed.write_bytes(b"signed")
    assert "was left untouched" in failure(2, "run", study_file(tmp_path), "--sheet", signed)
    assert signed.read_bytes() == b"signed"
    assert "ends in .pdf" in failure(2, "run", study_file(tmp_path), "--sheet", tmp_path / "sheet.txt")


def test_a_sheet_is_one_page_whatever_the_run_has(tmp_path: Path) -> None:
    """Twelve events and five controllers."""
    events = "".join(f'[[events]]\ntime = "{0.02 * k + 0.02} s"\nP_ref = "{2 + 0.1 * (k % 3)} kW"\n' for k in range(12))
    more = "".join(
        f'[[controllers]]\nname = "c{k}"\nkind = "scheduled"\nsettling_time = "{k + 1} s"\n' for k in range(3)
    )
    text = SMALL.partition("[[events]]")[0] + more + events
    result = run_scenario(study_from_text(text))
    document = {"study": {"hash": "a" * 64}, "sha256": "b" * 64, "files": {"c.table.json": "c" * 64, "x.csv": "d" * 64}}
    assert sheets_of(sheet_page(result, document)) > 1
    write_sheet(result, document, tmp_path / "sheet.pdf")
    assert re.findall(rb"/Type /Page\b", (tmp_path / "sheet.pdf").read_bytes()) == [b"/Type /Page"]
