"""Every verb in Python: a function for each, with the words and figures of its page, its JSON and its terminal."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import pytest

import vsgdesign as vd
from tests import compliance_documents, verification_documents
from tests.cli.small_studies import call, study_file
from tests.cli.test_compare import TEXT as COMPARED
from tests.cli.test_survive import TEXT as SURVIVING
from tests.datasheet.sheets import write_all
from tests.gain_tables import table as gain_table
from vsgdesign.artifacts import write_table_file
from vsgdesign.errors import StudyError
from vsgdesign.report.page.html import print_html
from vsgdesign.report.verification.page import verification_page
from vsgdesign.simulation import survival
from vsgdesign.simulation.survival import GridState, SurvivalCase
from vsgdesign.study.parameters.event import Event
from vsgdesign.verbs.cli.program import main

NAMED = {
    "run": "write_report",
    "design": "design_study",
    "grid": "grid_of_network",
    "report": "write_report",
    "table build": "design_table",
    "table show": "open_table",
    "table check": "check_table",
    "table compare": "compare_tables",
    "table report": "write_report",
    "estimator train": "train",
    "estimator compare": "compare_estimators",
    "estimator stress": "stress_estimators",
    "export onnx": "",
    "estimator windows": "",
}
"""Verbs whose function has another name. Empty: there is none. ``export onnx`` takes a file of weights and no study;
``vd.train`` makes what ``estimator windows`` makes, and keeps it with ``windows``."""


def verbs() -> list[str]:
    found = []
    for name, command in main.commands.items():
        inside = list(command.commands) if isinstance(command, click.Group) else [""]
        found += [f"{name} {one}".strip() for one in inside]
    return found


def test_every_verb_has_a_function() -> None:
    names = {verb: NAMED.get(verb, verb.replace(" ", "_").replace("-", "_")) for verb in verbs()}
    assert set(NAMED) <= set(names)
    assert [verb for verb, name in names.items() if name and not callable(getattr(vd, name, None))] == []


class _Recorded(Exception):
    """What a function of the pipeline was asked for."""


@dataclass(frozen=True)
class Same:
    """A call of the command line and one of Python that ask the pipeline for the same."""

    pipeline: str
    options: str
    function: Callable[..., Any]
    arguments: Mapping[str, Any]


SAME = {
    "verify": Same(
        "verify.verify_study",
        "--controller scheduled --runs 6 --seed 3 --confidence 0.9 --bridge pwm --strict --search 2",
        vd.verify,
        {
            **{"controller": "scheduled", "runs": 6, "seed": 3, "confidence": 0.9, "bridge": "pwm"},
            **{"strict": True, "search": 2},
        },
    ),
    "survive": Same(
        "survival.report_survival",
        "--controller fixed --limiter none --limiter circular --bridge pwm --no-explorer",
        vd.survive,
        {"controllers": ("fixed",), "limiters": ("none", "circular"), "bridge": "pwm", "explorer": False},
    ),
    "comply": Same(
        "comply.comply_study",
        "--suite aemo --controller fixed --no-maps --cases all",
        vd.comply,
        {"suites": ["aemo"], "controllers": ["fixed"], "maps": False, "cases": "all"},
    ),
    "compare": Same("comparison.report_comparison", "--no-emt --seed 4", vd.compare, {"emt": False, "seed": 4}),
    "inner": Same(
        "inner.report_inner_loops",
        "--no-what-if --remedies",
        vd.inner,
        {"what_if": False, "remedies": True},
    ),
    "design": Same("margins.report_design", "", vd.design_study, {}),
    "estimator train": Same(
        "estimators.train_weights_file",
        "--recipe wide --seed 5 --hidden 7 --components 9 --windows w.npz",
        vd.train,
        {"recipe": "wide", "seed": 5, "hidden": 7, "components": 9, "windows": "w.npz"},
    ),
    "estimator compare": Same(
        "estimators.report_comparison",
        "--weights w.json --recipe wide --seed 5",
        vd.compare_estimators,
        {"weights": ["w.json"], "recipes": ["wide"], "seed": 5},
    ),
    "estimator stress": Same("estimators.report_stress", "", vd.stress_estimators, {}),
}


@pytest.mark.parametrize("verb", SAME)
def test_a_function_asks_for_what_its_verb_asks(verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With every option, and without any."""

    def record(study: vd.Study, *args: Any, **kwargs: Any) -> None:
        asked = {name: value for name, value in kwargs.items() if name not in ("progress", "say", "done") and value}
        raise _Recorded(study.hash, tuple(map(str, args)), asked)

    same, study, out = SAME[verb], study_file(tmp_path), tmp_path / "out"
    monkeypatch.setattr(f"vsgdesign.verbs.pipeline.{same.pipeline}", record)
    monkeypatch.chdir(tmp_path)
    how = {"workers": 2} if verb not in ("inner", "design") else {}
    for options, arguments in ((same.options.split(), same.arguments), ([], {})):
        more = ("--workers", "2") if how else ()
        ours = call(*verb.split(), study, *options, *more, "--out", out).exception
        assert isinstance(ours, _Recorded), ours
        with pytest.raises(_Recorded) as theirs:
            same.function(study, out, **arguments, **how)
        assert ours.args == theirs.value.args


def bare(text: str) -> str:
    """Without tags, line breaks and marks of subscripts."""
    return " ".join(html.unescape(re.sub(r"<[^>]*>", "", text)).replace("_", "").split())


def of_verify(folder: Path) -> tuple[Any, str]:
    document = verification_documents.document()
    return vd.Verification(document, folder), print_html(verification_page(document), folder / "page.html").read_text()


def of_survive(folder: Path) -> tuple[Any, str]:
    start = GridState(scr=5.0, x_over_r=3.0, P_pu=0.4, Q_pu=0.0)
    events = (("phase", Event.of_pu(0.0, phase_deg=3.0)), ("overload", Event.of_pu(0.0, phase_deg=170.0)))
    cases = tuple(SurvivalCase(group=group, start=start, changes=(one,), cleared_s=0.0) for group, one in events)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(survival, "fixed_set", lambda: cases)
        study = study_file(folder, SURVIVING, random="0")
        found = vd.survive(
            study, folder / "out", controllers=["scheduled"], limiters=["circular"], explorer=False, workers=1
        )
    assert json.loads((found.folder / "results.json").read_text(encoding="utf-8")) == found.to_dict()
    assert not found  # the overload is lost
    return found, found.page.read_text(encoding="utf-8")


def of_comply(folder: Path) -> tuple[Any, str]:
    from vsgdesign.report.compliance.page import write_page

    document = compliance_documents.document()
    page = next(path for path in write_page(folder, document, {}) if path.suffix == ".html")
    return vd.Compliance(document, folder), page.read_text(encoding="utf-8")


def of_design(folder: Path) -> tuple[Any, str]:
    found = vd.design_study(study_file(folder), folder / "out")
    kept = json.loads((folder / "out" / "results.json").read_text(encoding="utf-8"))
    assert found.to_dict()["designs"] == kept["designs"]
    return found, (folder / "out" / "report.html").read_text(encoding="utf-8")


def printed(found: Any, *verb: str | Path) -> tuple[Any, str]:
    assert json.loads(call(*verb, "--json").stdout) == json.loads(json.dumps(found.to_dict()))
    return found, call(*verb).stdout


def of_new(folder: Path) -> tuple[Any, str]:
    sheet, file = write_all(folder)["medium_voltage"], folder / "study.toml"
    found = vd.new(sheet, file)
    with pytest.raises(vd.VsgDesignError, match="exists"):
        vd.new(sheet, file)
    assert vd.validate(file) == [
        "The inner loops are not designed yet; the first command that needs them designs them."
    ]
    file.unlink()
    return found, call("new", "--from", sheet, "--out", file).stdout


def of_diff(folder: Path) -> tuple[Any, str]:
    for name, P_ref in (("a", '"2 kW"'), ("b", '"1 kW"')):
        vd.design_study(study_file(folder, P_ref=P_ref), folder / name)
    return printed(vd.diff(folder / "a", folder / "b"), "diff", folder / "a", folder / "b")


def of_table_check(folder: Path) -> tuple[Any, str]:
    file = folder / "table.json"
    write_table_file(gain_table(), file)
    return printed(vd.check_table(str(file)), "table", "check", file)


def of_table_compare(folder: Path) -> tuple[Any, str]:
    files = str(folder / "a.json"), str(folder / "b.json")
    write_table_file(gain_table(), files[0])
    write_table_file(gain_table(parameters={"k_1": 14.0}), files[1])
    return printed(vd.compare_tables(*files), "table", "compare", *files)


MAKERS = [of_verify, of_survive, of_comply, of_design, of_new, of_diff, of_table_check, of_table_compare]


@pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__.removeprefix("of_"))
def test_a_result_says_and_shows_what_its_verb_does(make: Callable[[Path], tuple[Any, str]], tmp_path: Path) -> None:
    result, text = make(tmp_path)
    said = bare(text)
    assert result.sentences()
    for sentence in result.sentences():
        if make is of_table_compare:  # its terminal has the same figures in tables
            assert set(re.findall(r"\d+\.\d+", sentence)) <= set(re.findall(r"\d+\.\d+", said))
        else:
            assert bare(sentence) in said
    assert str(result).startswith(result.title)
    if result.pictures:
        result.plot(file=tmp_path / "first.png")
        assert "<svg" in result._repr_html_()
    else:
        with pytest.raises(KeyError, match="no picture"):
            result.plot()


def test_what_cannot_be_asked_is_told(tmp_path: Path) -> None:
    study = study_file(tmp_path, COMPARED)
    unknown: Any = "some"
    with pytest.raises(StudyError) as caught:
        vd.verify(study, tmp_path / "out", runs=0, confidence=2.0)
    assert {"verification.runs", "verification.confidence"} <= {fault.field for fault in caught.value.faults}
    for call_it, match in (
        (lambda: vd.verify(study, search=-1), "search = -1"),
        (lambda: vd.survive(study, bridge=unknown), "averaged, pwm"),
        (lambda: vd.simulate(study, bridge=unknown), "averaged, pwm"),
        (lambda: vd.verify(study, runs=8, workers=0), "workers = 0: must be 1 or more"),
        (lambda: vd.explore(study, "page.html", bridge=unknown), "averaged, pwm"),
        (lambda: vd.comply(study, cases=unknown), "failing, all, none"),
    ):
        with pytest.raises(ValueError, match=match):
            call_it()
    for ask in (lambda: vd.survive(study, controllers="nope"), lambda: vd.comply(study, suites="nope")):
        with pytest.raises(StudyError) as caught:
            ask()
        assert [fault.value for fault in caught.value.faults if fault.value] == [
            '"nope"'
        ]  # one name, and not four letters
    for function in (vd.verify, vd.survive, vd.comply, vd.compare, vd.inner, vd.design_study):
        with pytest.raises(TypeError, match=rf"{function.__name__} takes a study"):
            function(3)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="at least two"):
        vd.compare_tables(gain_table())
