"""margins and report: exit codes, documents, files, and what they refuse."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import pytest

from tests.cli.small_studies import SMALL, as_json, call, failure, study_file
from tests.report.pdf_texts import texts_of
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.execution.executors import silent
from vsgdesign.report.explore.page_file import StaticPage, is_page, live_page
from vsgdesign.report.explore.page_starts import PageCase
from vsgdesign.study.parameters import Study, study_from_text
from vsgdesign.verbs.pipeline import assess_study, live_part, margins

AXES = "\n[stability]\nscr = [2, 8]\nx_over_r = [1]\nerrors = [-0.1, 0, 0.1]\n"
ONE = SMALL.replace('[[controllers]]\nname = "scheduled"\nkind = "scheduled"\n', "")
ONE = ONE[: ONE.index("[[events]]")]
KEYS = {
    "schema",
    "study",
    "provenance",
    "gates",
    "axes",
    "scr_basis",
    "verdicts",
    "controllers",
    "timing_s",
}


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict:
    return as_json("margins", study_file(tmp_path_factory.mktemp("margins"), SMALL + AXES))


def test_margins_as_json(document: dict) -> None:
    assert set(document) >= KEYS
    assert document["axes"] == {
        "scr": [2.0, 8.0],
        "x_over_r": [1.0],
        "P": document["axes"]["P"],
        "Q": document["axes"]["Q"],
        "errors": [-0.1, 0.0, 0.1],
    }
    assert set(document["controllers"]) == {"fixed", "scheduled"}
    for controller in document["controllers"].values():
        assert {"kind", "worst", "between_nodes", "x_over_r_limit", "cells"} <= set(controller)
        assert set(controller["worst"]) == {"reduced", "full_order"}
        for cell in controller["cells"]:
            assert {"label", "margins", "modes", "sensitivities", "linear_against_emt"} <= set(cell)
            assert cell["linear_against_emt"] is None
    assert {row["verdict"] for row in document["verdicts"]} <= {"pass", "fail", "informational", "not assessed"}


def test_gates_do_not_change_the_exit_code(document: dict) -> None:
    """A failed gate is a result, not an error: as_json has seen exit code 0."""
    assert "fail" in {row["verdict"] for row in document["verdicts"]}


def test_margins_in_words_with_evidence(tmp_path: Path) -> None:
    result = call("margins", study_file(tmp_path, ONE + AXES), "--evidence")
    assert result.exit_code == 0, result.output
    for said in ("worst cells over the maps", "SCR on the reactance basis", "gates (ours, no grid code):"):
        assert said in result.stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.toml"]


def small_page(study: Study, ready: Ready, *_: object, **__: object) -> StaticPage:
    return live_page(study, ready, (2, 1))


def no_page(study: Study, *_: object, **__: object) -> StaticPage:
    return StaticPage(None, f"{study.name} has no explorer in this test.")


def end_process(*_: object, **__: object) -> StaticPage:
    os._exit(1)


def test_report_writes_a_folder_whose_links_lead_somewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_part, "worker_count", lambda _: 2)
    monkeypatch.setattr(live_part, "live_page", small_page)
    out = tmp_path / "out"
    result = call("report", study_file(tmp_path, ONE + AXES), "--out", out)
    assert result.exit_code == 0, result.output
    assert result.stdout.rstrip().endswith(f"report: {out / 'report.html'}")
    # Not a terminal: no progress bar.
    assert result.stderr == ""
    text = (out / "report.html").read_text(encoding="utf-8")
    links = {unquote(link) for link in re.findall(r'<a href="([^#"]+)"', text)}
    assert links == {"explorer.html", *(path.name for path in out.glob("*.csv"))}
    assert {path.name for path in out.iterdir() if path.suffix != ".csv"} == {
        "explorer.html",
        "figures",
        "report.html",
        "results.json",
    }
    assert {path.suffix for path in (out / "figures").iterdir()} == {".svg", ".png"}
    assert is_page(out / "explorer.html")
    assert '<iframe src="explorer.html"' in text
    assert "explorer.html" in json.loads((out / "results.json").read_text(encoding="utf-8"))["files"]


def test_a_part_shows_what_differs_in_more_than_its_estimate() -> None:
    """At most four: those of its cases, the last and the first."""
    one = '[[controllers]]\nname = "{}"\nkind = "scheduled"\n{}\n'
    given = [("a", ""), ("a-window", 'estimate = "rls"'), ("b", 'settling_time = "2 s"')]
    given += [(name, f'settling_time = "{k} s"') for k, name in enumerate("cde", start=3)]
    study = study_from_text(ONE + "".join(one.format(*row) for row in given))
    assert live_part.shown_in_part(study, NOTHING) == ["fixed", "a", "b", "e"]
    own = replace(study, controllers=study.controllers[-2:-1])
    case = PageCase(label="", study=own, status="", words="", figures={})
    assert live_part.shown_in_part(study, NOTHING, [case]) == ["fixed", "a", "d", "e"]


@pytest.mark.parametrize(
    ("make", "said"), [(no_page, "small has no explorer in this test."), (end_process, "ended with exit code")]
)
def test_a_report_without_explorer_says_why(
    make: Callable[..., StaticPage], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_part, "worker_count", lambda _: 2)
    monkeypatch.setattr(live_part, "live_page", make)
    result = assess_study(study_from_text(ONE + AXES), evidence=False)
    with live_part.live_begun(result.study, result.ready) as explored:
        found = margins._written(live_part.waited_for(explored, silent), tmp_path)
    assert found.name == ""
    assert said in found.why
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("scrs = [2]", "stability.scrs: unknown field. Did you mean scr?"),
        ("scr = [8, 2]", "stability.scr = [8, 2]: must increase from each value to the next"),
        ("scr = [2, 2]", "must increase from each value to the next"),
        ("scr = [nan]", "stability.scr[0] = nan: must be a finite number"),
        ("scr = []", "must be a list of at least one value"),
        ("scr = 2", "must be a list of at least one value"),
        ("scr = [-2]", "stability.scr[0] = -2"),
        ('x_over_r = ["1 ohm"]', "stability.x_over_r[0]"),
        ("errors = [-1]", "stability.errors[0] = -1"),
        ('P = ["3 var"]', 'stability.P[0] = "3 var": expected a number in W'),
        ("[stability.gates]\ndamping = 0.3", "stability.gates.damping: unknown field. Did you mean damping_ratio?"),
        ("[stability.gates]\nM_s = 0.5", "stability.gates.M_s = 0.5"),
    ],
)
def test_a_wrong_section_is_named(lines: str, said: str, tmp_path: Path) -> None:
    study = study_file(tmp_path, SMALL + "\n[stability]\n" + lines + "\n")
    message = failure(2, "margins", study)
    assert said in message


def test_out_on_a_foreign_folder(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    message = failure(2, "report", study_file(tmp_path, ONE + AXES), "--out", tmp_path / "thesis")
    assert "holds chapter.tex, and no results.json" in message
    assert [path.name for path in (tmp_path / "thesis").iterdir()] == ["chapter.tex"]


@pytest.mark.parametrize("verb", ["margins", "report"])
def test_no_such_file(verb: str, tmp_path: Path) -> None:
    assert "there is no such file" in failure(2, verb, tmp_path / "missing.toml")


def test_a_fixed_design_that_does_not_exist(tmp_path: Path) -> None:
    text = ONE.replace('kind = "fixed"', 'kind = "fixed"\ndesign_grid = { scr = 0.2, x_over_r = 3 }')
    message = failure(1, "report", study_file(tmp_path, text + AXES), "--out", tmp_path / "out")
    assert "%" in message
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small.toml"]


def test_a_pdf(tmp_path: Path) -> None:
    """With the same page beside it: all of its headings, tables and figures."""
    result = call("report", study_file(tmp_path, ONE + AXES), "--out", tmp_path / "out", "--pdf", "--no-explorer")
    assert result.exit_code == 0, result.output
    content = (tmp_path / "out" / "report.pdf").read_bytes()
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    shown = " ".join(texts_of(content))
    headings = re.findall(r'<h2 id="part-\d">(.*?)</h2>', page)
    assert len(headings) == 8
    for heading in headings:
        assert heading in shown
    for row in ("Against the gates", "Worst cells of", "Version of numpy", "Limits of validity"):
        assert row in shown
    pictures = content.count(b"/Subtype /Image")
    assert pictures == page.count('<figure class="drawing"')


def test_help() -> None:
    for verb in ("margins", "report"):
        result = call(verb, "--help")
        assert result.exit_code == 0
        assert "STUDY.toml" in result.stdout
        assert "--json" in result.stdout
    assert "--pdf" in call("report", "--help").stdout


def test_no_progress_in_a_pipe(tmp_path: Path) -> None:
    study = study_file(tmp_path, ONE + AXES)
    command = [sys.executable, "-m", "vsgdesign.verbs.cli.program", "margins", str(study)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    assert run.stderr == ""
    assert "\x1b" not in run.stdout
