"""The comply verb: its answer, its files, the same bytes after an interruption, and what it refuses."""

from __future__ import annotations

import html
import itertools
import json
import re
import shutil
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import gain_tables
from tests.cli.small_studies import as_json, call, failure
from vsgdesign.artifacts import files, guarded_file, write_table_file
from vsgdesign.artifacts.time_series import read_npz
from vsgdesign.campaigns.compliance import job
from vsgdesign.campaigns.compliance import maps as survival_maps
from vsgdesign.campaigns.compliance.evidence import read_evidence
from vsgdesign.campaigns.compliance.rows import VERDICTS
from vsgdesign.errors import StudyError, WorkerError
from vsgdesign.execution.jobs import workers_needed
from vsgdesign.report.compliance import page
from vsgdesign.report.compliance.answer import headline
from vsgdesign.report.compliance.arranged import arrange
from vsgdesign.report.page import terminal
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.loading import study_from_text
from vsgdesign.verbs.pipeline import comply as pipeline

STUDY = """
base = "case:hoang2025_5kva"
[study]
name = "small"
[converter]
current_limit_pu = 1.2
current_limiter = "projection"
[power_loops]
structure = "angle_damped"
settling_time = "0.3 s"
tau_P = "5 ms"
tau_Q = "5 ms"
[simulation]
duration = "1 s"
bridge = "pwm"
P_ref = "2 kW"
Q_ref = "0 var"
[[controllers]]
name = "damped"
kind = "scheduled"
[[controllers]]
name = "published"
kind = "scheduled"
structure = "published"
"""
SUITE = """
title = "Three tests"
[[criteria]]
measure = "survived"
at_least = 1
[[criteria]]
measure = "recovery_s"
at_most = 0.5
[[tests]]
name = "phase jump"
scr = 5
x_over_r = 3
events = [{ phase_jump = "30 deg" }]
[[tests]]
name = "jump of the grid"
scr = 20
x_over_r = 3
events = [{ scr = 2, x_over_r = 3 }]
[[tests]]
name = "too much"
scr = 1.2
x_over_r = 10
P_pu = 1.4
events = [{ P_pu = 0.3 }]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    (folder / "small.toml").write_text(STUDY)
    (folder / "three.toml").write_text(SUITE)
    return folder


def comply(place: Path, out: str, *more: str) -> dict[str, Any]:
    suite = "--suite", place / "three.toml", "--no-maps"
    return as_json("comply", place / "small.toml", *suite, "--out", place / out, *more)


@pytest.fixture(scope="module")
def done(place: Path) -> dict[str, Any]:
    return comply(place, "out", "--workers", "1")


def verdicts(document: dict[str, Any]) -> dict[tuple[str, str], str]:
    return {(row["test"], row["controller"]): row["verdict"] for row in document["rows"]}


def test_each_test_of_each_controller_has_its_verdict(done: dict[str, Any]) -> None:
    assert verdicts(done) == {
        ("phase jump", "damped"): "pass",
        ("phase jump", "published"): "pass",
        ("jump of the grid", "damped"): "pass",
        ("jump of the grid", "published"): "fail",
        ("too much", "damped"): "impossible",
        ("too much", "published"): "impossible",
    }
    assert [(one["controller"], one["pass"], one["fail"], one["impossible"]) for one in done["summary"]] == [
        ("damped", 2, 0, 1),
        ("published", 1, 1, 1),
    ]


def test_what_is_printed_is_what_is_kept(place: Path, done: dict[str, Any]) -> None:
    assert json.loads((place / "out" / "results.json").read_text()) == done


def test_page_and_pdf_say_the_counts_of_the_document(place: Path, done: dict[str, Any]) -> None:
    page = (place / "out" / "report.html").read_text(encoding="utf-8")
    arranged = arrange(done)
    assert headline(arranged) in page
    for name, counts in zip(arranged.controllers, arranged.counts, strict=True):
        (said,) = (one for one in done["summary"] if one["controller"] == name)
        assert {verdict: said[verdict.replace(" ", "_")] for verdict in VERDICTS} == dict(counts.of)
        assert counts.words() in page  # what is read out in place of the strip
    for version in done["provenance"].values():
        assert f">{version}<" in page
    assert (place / "out" / "report.pdf").read_bytes().startswith(b"%PDF")
    figures = {row["figure"] for row in done["rows"] if row["figure"]}
    assert figures == {name for name in done["files"] if name.startswith("figures/")}


def test_a_failing_row_says_why(done: dict[str, Any]) -> None:
    row = next(row for row in done["rows"] if row["verdict"] == "fail")
    assert "recovery time" in row["why"]
    assert "0.5" in row["why"]
    assert row["study"]
    assert row["csv"]
    assert row["explore"]


def test_the_trace_begins_before_the_test(place: Path, done: dict[str, Any]) -> None:
    trace = read_evidence(place / "out" / done["rows"][0]["csv"]).trace
    assert trace.t_s[0] == pytest.approx(-0.1)
    assert trace.P_pu[0] == pytest.approx(0.5, abs=1e-4)
    assert np.max(trace.i_phase_pu) <= done["rows"][0]["checks"][0]["value"] * 1.3


def test_a_case_repeats_its_row(place: Path, done: dict[str, Any], tmp_path: Path) -> None:
    row = next(row for row in done["rows"] if row["verdict"] == "fail")
    out = tmp_path / "run"
    again = as_json("simulate", place / "out" / row["study"], "--out", out)
    survival = again["controllers"]["published"]["survival"]
    assert survival["status"] == row["status"]
    recovery = next(check["value"] for check in row["checks"] if check["measure"] == "recovery_s")
    assert survival["recovery_s"] == pytest.approx(recovery, abs=1e-12)
    series = read_npz(next(out.glob("*.npz")))
    trace = read_evidence(place / "out" / row["csv"]).trace
    at = np.searchsorted(series["t_s"], trace.t_s + 0.1 - 1e-6)
    assert np.max(np.abs(series["omega"][at] / (2.0 * np.pi) - trace.f_hz)) < 5e-6  # single precision at 50 Hz
    assert np.max(np.abs(series["V_rms"][at] / 110.0 - trace.V_pu)) < 1e-6


def test_every_key_is_documented(done: dict[str, Any]) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "comply.md").read_text(encoding="utf-8")
    table = page.partition("### results.json\n")[2].partition("\n## ")[0].strip()
    named = " ".join(line.split("|")[1] for line in table.splitlines())
    assert set(re.findall(r"`(\w+)`", named)) == set(done)


def test_it_says_what_was_run(done: dict[str, Any]) -> None:
    """The study asks for a switched bridge; a suite runs with the averaged one."""
    assert done["converter"]["bridge"] == "averaged"
    # SCR 20 of a test is taken on |Z|, also where the study takes its own on the reactance.
    assert (done["converter"]["scr_basis"], done["converter"]["scr_basis_of_study"]) == ("impedance", "reactance")
    assert done["hashes"]["study"] == done["study"]["hash"]
    assert done["hashes"]["c"] == {"damped": None, "published": None}


def test_the_hash_of_the_c_is_that_of_the_export(place: Path) -> None:
    table, study = gain_tables.table(), load_study(place / "small.toml")
    write_table_file(table, place / "table.json")
    spec = replace(study.controllers[0], schedule="table", current_limiter="circular")
    assert call("export", "c", place / "table.json", "--out", place / "c").exit_code == 0
    manifest = json.loads((place / "c" / "manifest.json").read_text())
    assert pipeline.c_hash(study, spec, table) == manifest["sha256"]


def test_two_workers_write_the_same_bytes(place: Path, done: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """They also draw the figures and set the PDF."""
    monkeypatch.setattr(job, "BLOCK", 2)
    assert_same(place, done, comply(place, "two", "--workers", "2"), "two")


def test_every_controller_has_its_maps(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On two values of each axis."""
    few = {"DEPTHS": (0.0, 0.5), "LENGTHS_OF_SAGS_S": (0.02, 1.0), "PHASES_DEG": (-60.0, 60.0)}
    for name, values in (few | {"SCR": (1.5, 8.0), "X_OVER_R": (1.0, 5.0)}).items():
        monkeypatch.setattr(survival_maps, name, values)
    arguments = "--suite", place / "three.toml", "--out", place / "maps", "--workers", "1"
    document = as_json("comply", place / "small.toml", *arguments)
    names = [controller["name"] for controller in document["controllers"]]
    assert len(names) > 1
    found = [(one["key"], one["controller"]) for one in document["maps"]]
    assert sorted(found) == sorted((kind, name) for name in names for kind in survival_maps.KINDS)
    page = html.unescape((place / "maps" / "report.html").read_text(encoding="utf-8"))
    for one in document["maps"]:
        assert one["title"] in page


def test_an_interrupted_run_continues_to_the_same_bytes(
    place: Path, done: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    real, ran = job.SuiteJob.call, []

    def one_alone(one: job.SuiteJob, number: int) -> Any:
        if ran:
            raise KeyboardInterrupt
        ran.append(number)
        return real(one, number)

    monkeypatch.setattr(job, "BLOCK", 2)
    monkeypatch.setattr(job.SuiteJob, "call", one_alone)
    suite = "--suite", place / "three.toml", "--no-maps"
    stopped = call("comply", place / "small.toml", *suite, "--out", place / "cut", "--workers", "1")
    assert stopped.exit_code == 130
    assert "2 finished tests are kept" in stopped.stderr
    assert not (place / "cut").exists()
    monkeypatch.setattr(job.SuiteJob, "call", real)
    assert_same(place, done, comply(place, "cut", "--workers", "1"), "cut")
    assert not (place / ".cut.compliance").exists()


LAST = [
    (pipeline, "_document", 1),
    (pipeline, "_linked", 2),
    (pipeline, "write_text", 1),
    (page, "_write_figures", 1),
    (page, "compliance_page", 1),
    (page, "print_html", 1),
    (page, "print_pdf", 1),
    (pipeline, "write_record", 1),
    (guarded_file, "write_text", 1),
    (files, "_replace", 1),
]
"""What is called after the last test, in its order, and at which of its calls it is interrupted."""


def test_an_interruption_after_the_last_test_loses_none(
    place: Path, done: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = "comply", place / "small.toml", "--suite", place / "three.toml", "--no-maps", "--workers", "1"
    for module, name, at in LAST:
        with monkeypatch.context() as patch:
            patch.setattr(module, name, interrupted_at(at, getattr(module, name)))
            stopped = call(*arguments, "--out", place / "late")
        assert stopped.exit_code == 130, name
        assert stopped.stderr == "interrupted: 6 finished tests are kept; the same command continues there\n", name
        assert not (place / "late").exists(), name
        assert [path.name for path in place.glob(".late.*")] == [".late.compliance"], name
    monkeypatch.setattr(job.SuiteJob, "call", interrupted_at(1, job.SuiteJob.call))  # nothing is left to run
    assert_same(place, done, comply(place, "late", "--workers", "1"), "late")


def test_an_interruption_after_the_results_says_that_they_are_there(
    place: Path, done: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = "comply", place / "small.toml", "--suite", place / "three.toml", "--no-maps", "--workers", "1"
    out = place / "after"
    for module, name in ((shutil, "rmtree"), (terminal, "print_terminal")):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, interrupted_if(lambda: (out / "results.json").exists(), getattr(module, name)))
            stopped = call(*arguments, "--out", out)
        assert stopped.exit_code == 130, name
        assert stopped.stderr == f'interrupted: the results are complete, in "{out}"\n', name
        again = comply(place, "after", "--workers", "1")
        assert_same(place, done, again, "after")
        assert not list(place.glob(".after.*"))
        shutil.rmtree(out)


def interrupted_at(at: int, real: Callable[..., Any]) -> Callable[..., Any]:
    """A function whose call number ``at`` is interrupted."""
    calls = itertools.count(1)
    return interrupted_if(lambda: next(calls) == at, real)


def interrupted_if(now: Callable[[], bool], real: Callable[..., Any]) -> Callable[..., Any]:
    def called(*arguments: Any, **named: Any) -> Any:
        if now():
            raise KeyboardInterrupt
        return real(*arguments, **named)

    return called


def assert_same(place: Path, one: dict[str, Any], other: dict[str, Any], out: str, report: bool = True) -> None:
    """The same files to the byte, the times of the record aside, and the report where it was not written."""
    files = {name: sha for name, sha in one["files"].items() if report or name.startswith(("traces/", "cases/"))}
    apart = {"timing_s": 0, "sha256": 0, "files": files}
    assert {**one, **apart} == {**other, **(apart | {"files": other["files"]})}
    for name in files:
        assert (place / out / name).read_bytes() == (place / "out" / name).read_bytes(), name


def test_the_terminal_says_each_controller_and_each_failure(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "_write_report", lambda *_: None)
    arguments = "--controller", "published", "--out", place / "text", "--workers", "1", "--must-pass", "--no-maps"
    result = call("comply", place / "small.toml", "--suite", place / "three.toml", *arguments)
    assert result.exit_code == 1, result.stderr
    assert "0 of 2" in result.stdout or "2 of 2" in result.stdout
    assert "fail three, jump of the grid, published" in result.stdout
    assert f"report: {place / 'text' / 'results.json'}" in result.stdout.replace("\n", "")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--suite", "nothing"), 'suite = "nothing": there is no such suite'),
        (("--suite", "missing.toml"), "missing.toml"),
        (("--controller", "no one"), 'controller = "no one": unknown'),
    ],
)
def test_a_wrong_name_is_one_sentence(place: Path, arguments: tuple[str, ...], said: str) -> None:
    own = () if "--suite" in arguments else ("--suite", place / "three.toml")
    assert said in failure(2, "comply", place / "small.toml", *own, *arguments, "--out", place / "none")
    assert not (place / "none").exists()


def test_what_the_tests_of_a_suite_decide_is_refused_in_a_study() -> None:
    text = STUDY + "[[grid.components]]\norder = -1\namplitude_pu = 0.01\n[network]\nload = { P_pu = 0.5 }\n"
    with pytest.raises(StudyError) as caught:
        pipeline.study_for_suites(study_from_text(text))
    assert [fault.field for fault in caught.value.faults] == ["grid.components", "network"]


def test_every_fault_of_every_suite_is_said_at_once(place: Path) -> None:
    (place / "bad.toml").write_text('title = "Bad"\n[[tests]]\nname = "a"\nscr = "x"\nx_over_r = 0\n')
    (place / "worse.toml").write_text('title = "Worse"\n[[tests]]\nname = "a"\nscr = nan\nx_over_r = 1\n')
    said = failure(2, "comply", place / "small.toml", "--suite", place / "bad.toml", "--suite", place / "worse.toml")
    assert said.count("tests[0].scr") == 2
    assert "x_over_r" in said
    assert "nothing happens" in said


def test_a_folder_of_the_users_is_left_alone(place: Path) -> None:
    (place / "mine").mkdir()
    (place / "mine" / "letter.txt").write_text("dear")
    said = failure(2, "comply", place / "small.toml", "--suite", place / "three.toml", "--out", place / "mine")
    assert "left untouched" in said
    assert (place / "mine" / "letter.txt").read_text() == "dear"


def test_a_lost_worker_is_said_where_the_study_files_are_written() -> None:
    lost: Future[None] = Future()
    lost.set_exception(BrokenExecutor("a process was lost"))
    with pytest.raises(WorkerError, match="workers: "), workers_needed():
        lost.result()


def test_the_old_name_of_must_pass_still_works() -> None:
    from vsgdesign.verbs.cli.campaigns import comply

    (option,) = (one for one in comply.params if one.name == "must_pass")
    assert option.opts == ["--must-pass", "--strict"]
