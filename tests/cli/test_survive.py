"""The survive verb: what it prints and leaves, how it goes on after an interruption, and what it refuses."""

from __future__ import annotations

import csv
import html
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.cli.small_studies import call, failure
from tests.gain_tables import table
from vsgdesign.artifacts.gain_table import base_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns import survival as many
from vsgdesign.metrics.survival import Survival
from vsgdesign.report.drawing.quantities import plain
from vsgdesign.report.survival import survival_blocks, survival_sentences
from vsgdesign.simulation import survival
from vsgdesign.simulation.survival import CaseResult, GridState, Subject, SurvivalCase
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.event import Event
from vsgdesign.verbs.pipeline.survival import survival_document

TEXT = """
base = "case:hoang2025_5kva"
[study]
name = "small"
[converter]
current_limit_pu = 1.2
[inner_loops]
transient_resistance_pu = 0.08
[power_loops]
structure = "angle_damped"
tau_P = "5 ms"
tau_Q = "5 ms"
[simulation]
duration = "1 s"
P_ref = "2 kW"
Q_ref = "0 var"
[survival]
random = 2
seed = 5
[[controllers]]
name = "scheduled"
kind = "scheduled"
[[controllers]]
name = "other"
kind = "fixed"
"""


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> tuple[SurvivalCase, ...]:
    """Four systematic disturbances: two small, one too large for a circular limit, one without a rest."""
    start = GridState(scr=5.0, x_over_r=3.0, P_pu=0.4, Q_pu=0.0)
    events = (
        ("phase", Event.of_pu(0.0, phase_deg=3.0)),
        ("phase", Event.of_pu(0.0, phase_deg=-3.0)),
        ("overload", Event.of_pu(0.0, phase_deg=170.0)),
        ("jump", Event.of_pu(0.0, scr=0.2, x_over_r=3.0)),
    )
    cases = tuple(SurvivalCase(group=group, start=start, changes=(one,), cleared_s=0.0) for group, one in events)
    monkeypatch.setattr(survival, "fixed_set", lambda: cases)
    return cases


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(TEXT)
    return path


def survive(study: Path, *arguments: str) -> Any:
    return call("survive", str(study), "--workers", "1", "--no-explorer", "--controller", "scheduled", *arguments)


def test_it_prints_and_leaves_the_same_numbers(study: Path, tmp_path: Path, few: tuple[SurvivalCase, ...]) -> None:
    out = tmp_path / "out"
    printed = json.loads(survive(study, "--out", str(out), "--json").stdout)
    kept = json.loads((out / "results.json").read_text())
    assert printed == {key: value for key, value in kept.items() if key in printed}
    one = kept["variants"]["scheduled"]
    assert one["stale_to_1_s"]["cases"] == len(few) + 2
    assert one["groups"]["phase"]["survived"] == 2
    assert one["groups"]["jump"]["statuses"] == {"no rest": 1}
    with (out / "cases.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(few) + 2
    assert sum(row["status"] == "survived" for row in rows) == one["stale_to_1_s"]["survived"]
    assert not list(tmp_path.glob(".out*"))
    text = survive(study, "--out", str(out)).stdout
    assert f"{one['stale_to_1_s']['survived']}/{one['stale_to_1_s']['judged']}" in text
    assert "report.html" in text
    page = (out / "report.html").read_text(encoding="utf-8")
    lost = one["stale_to_1_s"]["judged"] - one["stale_to_1_s"]["survived"]
    assert len(one["lost"]) == lost > 0
    assert f"and loses {lost}." in page
    for case in one["lost"]:
        assert case["reason"] in html.unescape(page)


def test_an_interruption_is_continued(
    study: Path, tmp_path: Path, few: tuple[SurvivalCase, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    out, run, made = tmp_path / "out", many.verdicts_of, []
    monkeypatch.setattr(many, "CHUNK_OF_LANES", 1)

    def stopping(subject: Any, cases: list[SurvivalCase]) -> Any:
        if len(made) == 3:
            raise KeyboardInterrupt
        return counted(subject, cases)

    def counted(subject: Any, cases: list[SurvivalCase]) -> Any:
        made.extend(cases)
        return run(subject, cases)

    with monkeypatch.context() as patched:
        patched.setattr(many, "verdicts_of", stopping)
        result = survive(study, "--out", str(out))
    assert result.exit_code == 130
    assert "finished work is kept, and the same command continues there" in result.stderr
    assert not out.exists()
    made.clear()
    monkeypatch.setattr(many, "verdicts_of", counted)
    assert survive(study, "--out", str(out)).exit_code == 0
    assert len(made) == len(few) + 2 - 3


def test_limiters_stand_beside_each_other(study: Path, tmp_path: Path, few: tuple[SurvivalCase, ...]) -> None:
    result = survive(study, "--out", str(tmp_path / "out"), "--limiter", "none", "--limiter", "circular", "--json")
    document = json.loads(result.stdout)
    assert list(document["variants"]) == ["scheduled, none", "scheduled, circular"]
    free = document["variants"]["scheduled, none"]["beyond_hardware"]
    assert min(one["peak_pu"] for one in free) > 2.0
    assert "overload" in {one["group"] for one in free}
    assert document["variants"]["scheduled, circular"]["beyond_hardware"] == []
    said = [repr(block) for block in survival_blocks(document) if "but above" in repr(block)]
    worst = f"{len(free)} cases, up to {free[0]['peak_pu']:.3g} pu"
    assert f"but above 2 pu, more than hardware carries: {worst}" in said[0]
    assert len(few) == 4


@pytest.mark.parametrize(("scr", "said"), [(3.0, "All of these"), (0.5, "1 of these"), (0.1, "")])
def test_losses_on_grids_without_a_table_are_counted(scr: float, said: str) -> None:
    """Two cases are lost: on SCR 2 alone, and after a jump to SCR 0.2. Of a table from ``scr`` on both, one or none of
    them lie outside; its X/R hold for both."""
    made = load_study("studies/table/study.toml")
    spec, here = made.controllers[-1], GridState(scr=2.0, x_over_r=3.0, P_pu=0.4, Q_pu=0.0)
    changes = (Event.of_pu(0.0, phase_deg=170.0), Event.of_pu(0.0, scr=0.2, x_over_r=3.0))
    cases = [SurvivalCase(group="jump", start=here, changes=(one,), cleared_s=0.0) for one in changes]
    box = replace(table(name=spec.name).validity, scr=(scr, 9.0), x_over_r=(1.0, 9.0))
    ready = Ready(tables={spec.name: replace(table(name=spec.name, base=base_of(made, "impedance")), validity=box)})
    lost = [CaseResult(case=one, verdict=Survival(status="slipped", reason="a turn"), seconds=0.0) for one in cases]
    subject = Subject(study=made, spec=spec, ready=ready, limit_pu=1.2)
    document = survival_document(made, {"t": subject}, {"t": lost})
    text = f"{said} begin or end on a grid outside of its table (SCR {plain(scr)} to 9, X/R 1 to 9)." if said else ""
    assert survival_sentences(document)[0] == " ".join(
        filter(None, ("t survives 0 of 2 disturbances and loses 2.", text))
    )


def test_every_fault_at_once(study: Path, tmp_path: Path) -> None:
    study.write_text(TEXT.replace("current_limit_pu = 1.2", ""), encoding="utf-8")
    message = failure(2, "survive", str(study), "--controller", "nobody", "--limiter", "square")
    for word in ("converter.current_limit_pu", '"nobody"', '"square"', "projection"):
        assert word in message
    assert not (tmp_path / "out").exists()


def test_a_wrong_section(study: Path) -> None:
    study.write_text(TEXT.replace("random = 2", "random = -2\nsize = 3"), encoding="utf-8")
    message = failure(2, "survive", str(study))
    assert "survival.random" in message
    assert "survival.size" in message
