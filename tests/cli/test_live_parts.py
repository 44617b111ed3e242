"""The part of a report that simulates: which study and which controllers it gets, and who leaves it out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.cli.small_studies import SMALL, call
from tests.gain_tables import table
from vsgdesign.artifacts import write_table_file
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.report.page.live import CASES, StaticPage
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.verbs.pipeline import live_part

TABLED = '[[controllers]]\nname = "tabled"\nkind = "scheduled"\nschedule = "table"\ntable = "mine.json"\n'
Asked = list[tuple[Study, Ready, dict[str, Any]]]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Asked:
    """What the page is made of, in place of the page, and of the figures, which take longer."""
    found: Asked = []

    def page(study: Study, ready: Ready, _lattice: tuple[int, int], **named: Any) -> StaticPage:
        found.append((study, ready, named))
        return StaticPage("the page", cases=tuple(case.label for case in named["cases"]))

    monkeypatch.setattr(live_part, "live_page", page)
    monkeypatch.setattr(live_part, "worker_count", lambda _: 1)
    monkeypatch.setattr("vsgdesign.report.gain_table.page.table_figures", lambda *_: [])
    monkeypatch.setattr("vsgdesign.report.verification.page.verification_figures", lambda _: iter(()))
    return found


@pytest.mark.parametrize("left_out", [(), ("--no-explorer",), None])
def test_a_table_simulates_with_the_converter_of_a_study(
    left_out: tuple[str, ...] | None, asked: Asked, tmp_path: Path
) -> None:
    """None: the table alone, which has no filter and no inner loops."""
    text = SMALL.partition("[[events]]")[0]
    made = replace(table(base=base_of(study_from_text(text), "impedance")), name="</script><hr>")
    write_table_file(made, tmp_path / "mine.json")
    (tmp_path / "small.toml").write_text(text + TABLED, encoding="utf-8")
    study = () if left_out is None else ("--study", str(tmp_path / "small.toml"), *left_out)
    result = call("table", "report", str(tmp_path / "mine.json"), *study, "--out", str(tmp_path / "out"))
    assert result.exit_code == 0, result.output
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    there = left_out == ()
    assert "<hr>" not in page
    assert page.count("</script>") == int(left_out == ())
    assert ('<h2 id="try-it">' in page, 'class="live"' in page, len(asked)) == (there, there, int(there))
    if asked:
        shown, ready, named = asked[0]
        assert [spec.name for spec in shown.controllers] == list(ready.tables) == named["controllers"] == ["tabled"]
        assert CASES not in page


def test_a_verification_brings_its_worst_cases(asked: Asked, tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL, encoding="utf-8")
    arguments = ("--controller", "fixed", "--runs", "8", "--search", "0", "--workers", "1")
    result = call("verify", str(tmp_path / "small.toml"), *arguments, "--out", str(tmp_path / "out"))
    assert result.exit_code == 0, result.output
    ((shown, _, named),) = asked
    assert [spec.name for spec in shown.controllers] == named["controllers"] == ["fixed"]
    assert named["cases"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert CASES in page
    for case in named["cases"]:
        assert case.words.startswith(case.label)
        assert case.study.events
        assert all(event.over == 0.0 for event in case.study.events)
