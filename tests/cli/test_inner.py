"""Inner loops that a study leaves open: designed once, kept beside it, shown by the verb and used by every other."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import vsgdesign as vd
from tests.cli.small_studies import call, failure
from tests.gain_tables import table
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.artifacts.gain_table_file import write_table_file
from vsgdesign.artifacts.inner_loops_file import read_inner_loops_file
from vsgdesign.campaigns import phase_jumps
from vsgdesign.design.inner import designing, search
from vsgdesign.design.inner.search import Effort
from vsgdesign.errors import ArtifactError
from vsgdesign.report.page.blocks import Box, Words, plain_text
from vsgdesign.report.stability.inner import explanation, headline, inner_page
from vsgdesign.study.parameters import Study, load_study
from vsgdesign.verbs.pipeline import inner, open_study, opening
from vsgdesign.verbs.pipeline.opening import check_study, inner_loops_file

TEXT = """
base = "case:lab_12kva_lcl"
[inner_loops]
design = true
scr = [2, 10]
x_over_r = [0.5, 5]
[simulation]
duration = "0.05 s"
P_ref = "2 kW"
Q_ref = 0
[[controllers]]
name = "a"
kind = "scheduled"
"""
QUICK = Effort(heat=2, generations=3, joined=1, rounds=1)


def quickly(patch: pytest.MonkeyPatch) -> None:
    """Few generations, and starts that are the best of 64 points instead of 512."""
    patch.setattr(designing, "Effort", lambda: QUICK)
    patch.setattr(search, "SOBOL", 64)


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study without inner gains, and a search of a fraction of a second."""
    quickly(monkeypatch)
    defaults: Any = designing.what_would_help.__kwdefaults__
    monkeypatch.setitem(defaults, "effort", QUICK)
    path = tmp_path / "mine.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def designed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What :func:`open_study` keeps of this study, once for all tests that ask for gains that are there already."""
    path = tmp_path_factory.mktemp("designed") / "mine.toml"
    path.write_text(TEXT, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        quickly(patch)
        open_study(path)
    return inner_loops_file(path)


@pytest.fixture
def kept(study: Path, designed: Path) -> Path:
    """The study with its designed gains beside it."""
    shutil.copy(designed, inner_loops_file(study))
    return study


def test_designed_once_and_the_same_ever_after(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    first = open_study(study, say=said.append)
    assert "are kept in" in said[0]
    file = inner_loops_file(study)
    record = read_inner_loops_file(file)
    assert (record.gains, record.omega_t) == (first.inner_gains, first.omega_t)
    before = file.read_bytes()
    monkeypatch.setattr(designing, "search", None)  # a second design would fail
    again = open_study(study, say=said.append)
    assert again == first
    assert len(said) == 1
    assert file.read_bytes() == before


@pytest.mark.parametrize(("score", "sentences"), [(1.2, 1), (0.783, 2)])
def test_a_score_below_one_is_explained(
    study: Path, designed: Path, monkeypatch: pytest.MonkeyPatch, score: float, sentences: int
) -> None:
    """A score of 0.783 alone says nothing to whom it is new."""
    record = replace(read_inner_loops_file(designed), score=score)
    monkeypatch.setattr(opening, "design_record", lambda *_: record)
    said: list[str] = []
    open_study(study, say=said.append)
    assert len(said) == sentences
    if sentences == 2:
        assert said[1].startswith("The score is below 1: not every requirement of the inner loops is kept.")
        assert f"vsgdesign inner {study} shows which" in said[1]


def test_a_changed_datasheet_is_designed_again_and_said(kept: Path) -> None:
    kept.write_text(TEXT.replace("[0.5, 5]", "[0.5, 4]") + '[filter]\nL_1 = "2 mH"\n', encoding="utf-8")
    said: list[str] = []
    changed = open_study(kept, say=said.append)
    assert "filter.L_1 (0.003, now 0.002)" in said[0]
    assert "x_over_r" in said[0]
    assert read_inner_loops_file(inner_loops_file(kept)).gains == changed.inner_gains


def test_what_the_design_does_not_depend_on_changes_nothing(kept: Path) -> None:
    first = open_study(kept)
    kept.write_text(TEXT.replace('"2 kW"', '"3 kW"') + '[study]\ntitle = "another"\n', encoding="utf-8")
    said: list[str] = []
    assert open_study(kept, say=said.append).inner_gains == first.inner_gains
    assert said == []


def test_a_base_brings_its_designed_gains(kept: Path) -> None:
    first = open_study(kept)
    above = kept.with_name("above.toml")
    above.write_text('base = "mine.toml"\n[grid]\nscr = 5\n', encoding="utf-8")
    assert open_study(above).inner_gains == first.inner_gains
    assert not inner_loops_file(above).exists()


def test_a_file_that_somebody_changed_is_refused_and_left(kept: Path) -> None:
    file = inner_loops_file(kept)
    text = file.read_text().replace('"K_ff": ', '"K_ff": 1')
    file.write_text(text)
    with pytest.raises(ArtifactError, match="sha256"):
        open_study(kept)
    assert file.read_text() == text
    assert "sha256" in failure(2, "simulate", kept)


def test_somebody_elses_file_of_that_name_is_left(study: Path) -> None:
    file = inner_loops_file(study)
    file.write_text('{"notes": "mine"}\n')
    assert "not a file of designed inner loops" in failure(2, "inner", study)
    assert file.read_text() == '{"notes": "mine"}\n'


def test_a_folder_that_may_not_be_written_to_is_no_hindrance(
    study: Path, designed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = read_inner_loops_file(designed)
    monkeypatch.setattr(opening, "design_record", lambda *_: record)

    def refuse(*_: object) -> None:
        raise ArtifactError("cannot write: no room")

    monkeypatch.setattr("vsgdesign.verbs.pipeline.opening.write_inner_loops", refuse)
    said: list[str] = []
    assert open_study(study, say=said.append).inner_gains == record.gains
    assert "could not be kept" in said[0]


def test_validate_designs_nothing(study: Path, designed: Path) -> None:
    _, sentence = check_study(study)
    assert "not designed yet" in sentence
    assert "not designed yet" in call("validate", study).stdout
    assert not inner_loops_file(study).exists()
    shutil.copy(designed, inner_loops_file(study))
    assert "mine.inner.json" in call("validate", study).stdout


def test_a_table_is_not_refused_for_loops_that_are_not_designed_yet(study: Path, designed: Path) -> None:
    record = read_inner_loops_file(designed)
    lags = {"R_t": record.gains.R_t, "X_t": record.gains.X_t, "omega_t": record.omega_t}
    assert record.gains.R_t > 0.0
    base = replace(base_of(check_study(study)[0]), **lags)
    write_table_file(table(base=base), study.with_name("own.json"))
    named = TEXT + 'schedule = "table"\ntable = "own.json"\n'
    study.write_text(named, encoding="utf-8")
    assert "not designed yet" in call("validate", study).stdout
    shutil.copy(designed, inner_loops_file(study))
    assert "mine.inner.json" in call("validate", study).stdout
    study.with_name("own.json").unlink()
    write_table_file(table(base=replace(base, R_t=1.01 * base.R_t)), study.with_name("own.json"))
    assert "base.R_t is" in failure(2, "validate", study)


def test_the_verb_says_what_the_file_says(study: Path, tmp_path: Path) -> None:
    result = call("inner", study, "--out", tmp_path / "page")
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "page" / "results.json").read_text())
    record = read_inner_loops_file(inner_loops_file(study))
    assert document["gains"] == record.gains._asdict() | {"omega_t": record.omega_t}
    assert document["score"] == pytest.approx(record.score, rel=1e-12)
    assert document["limiting"]["name"] == record.limiting
    for shown, kept in zip(document["promises"], record.promises, strict=True):
        assert (shown["name"], shown["scr"], shown["x_over_r"]) == (kept.name, kept.scr, kept.x_over_r)
        assert shown["value"] == pytest.approx(kept.value, rel=1e-9)
    assert [one["name"] for one in document["alternatives"]]
    page = (tmp_path / "page" / "report.html").read_text()
    for text in ("Score over the grids", "inner loops", "asked"):
        assert text in page
    assert result.stdout.startswith("mine: ")


def test_given_gains_are_judged_alike(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The published current loop of the laboratory case, on the same grids."""
    found, assess = [], inner.assess_inner_loops
    monkeypatch.setattr(
        inner, "assess_inner_loops", lambda *args, **more: found.append(assess(*args, **more)) or found[0]
    )
    own = "[inner_loops]\ndesign = true\nscr = [2, 10]\nx_over_r = [0.5, 5]\n"
    study.write_text(TEXT.replace(own, ""), encoding="utf-8")
    document = json.loads(call("inner", study, "--no-what-if", "--json").stdout)
    assert document["designed"] is False
    assert document["request"]["scr"] == [1.2, 20.0]
    assert document["gains"]["K_pc"] == load_study(study).inner_gains.K_pc
    assert document["alternatives"] is None
    assert not inner_loops_file(study).exists()
    ours = vd.InnerLoops(found[0])  # what vd.inner returns
    assert json.loads(json.dumps(ours.to_dict())) == document
    page = inner_page(document)
    assert isinstance(page.blocks[0], Box)
    said = " ".join(
        plain_text(line) for block in page.blocks[0].blocks if isinstance(block, Words) for line in block.lines
    )
    assert [sentence for sentence in ours.sentences() if sentence not in said] == []
    assert ours.pictures[0] == "inner_score"


def test_faults_are_told_before_anything_is_designed(study: Path) -> None:
    study.write_text(TEXT.replace('"2 kW"', '"2 kV"').replace("[0.5, 5]", "[5, 0.5]"), encoding="utf-8")
    text = failure(2, "inner", study)
    assert "simulation.P_ref" in text
    assert "inner_loops.x_over_r" in text
    assert not inner_loops_file(study).exists()


def test_a_run_says_the_same_of_them(kept: Path, tmp_path: Path) -> None:
    """Scenario and verb: one document, one text."""
    alone = json.loads(call("inner", kept, "--no-what-if", "--json").stdout)
    result = call("run", kept, "--no-explorer", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    in_run = json.loads((tmp_path / "out" / "results.json").read_text())["inner_loops"]
    del alone["phase_jumps"]  # of the whole run
    assert in_run == alone
    page = (tmp_path / "out" / "report.html").read_text()
    assert headline(alone).split(":")[0] in page


def test_remedies_are_designed_fully_where_it_is_asked_for(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def told(_study: Study, **given: Any) -> None:
        asked.append(given["remedies"])

    monkeypatch.setattr(phase_jumps, "phase_jumps", told)
    for more in ((), ("--remedies",)):
        assert call("inner", kept, "--no-what-if", *more).exit_code == 0
    assert asked == [False, True]


def test_the_answer_names_the_worst_first(kept: Path) -> None:
    """Unstable grids, then cells unstable with power loops, then a filter that is off, then a missed promise."""
    good = json.loads(call("inner", kept, "--no-what-if", "--json").stdout)
    of, analysed = good["grids"]["of"], good["full_order"]["analysed"]
    worse = good | {"kept": False, "score": 0.5, "full_order": good["full_order"] | {"stable": analysed}}
    worse["grids"] = {"stable": of, "of": of}
    assert "not every requirement is kept: the score is 0.5 of 1 asked" in headline(worse)
    worse["score"] = -0.1
    assert "off by 20 %" in headline(worse)
    worse["full_order"] = worse["full_order"] | {"stable": analysed - 2}
    assert f"unstable in 2 of {analysed} cells" in headline(worse)
    whole = good | {"full_order": good["full_order"] | {"cells": analysed}}
    assert "no operating point" not in explanation(whole)[1]
    whole["full_order"]["cells"] += 1
    assert "(1 further cell has no operating point)" in explanation(whole)[1]
    worse["grids"] = {"stable": of - 3, "of": of}
    assert headline(worse) == f"The inner loops are unstable on 3 of {of} grids."
