"""Many cases: kept as they finish, found again, the same on any number of workers, and counted right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.simulation.survival.subjects import subject
from vsgdesign.campaigns import survival as many
from vsgdesign.campaigns.survival import run_many
from vsgdesign.errors import ArtifactError
from vsgdesign.metrics.survival import NO_REST, NOT_AT_REST, SURVIVED, Survival
from vsgdesign.simulation.survival import (
    CaseResult,
    GridState,
    SurvivalCase,
    by_group,
    figures_of,
)
from vsgdesign.study.parameters.event import Event

START = GridState(scr=5.0, x_over_r=3.0, P_pu=0.3, Q_pu=0.0)


def case(phase: float, group: str = "phase") -> SurvivalCase:
    return SurvivalCase(group=group, start=START, changes=(Event.of_pu(0.0, phase_deg=phase),), cleared_s=0.0)


CASES = tuple(case(float(phase)) for phase in range(1, 11))


def test_workers_agree_with_this_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many, "CHUNK_OF_LANES", 4)
    subjects = {"one": subject(), "other": replace(subject(), limit_pu=0.2)}
    here = run_many(subjects, CASES, workers=1)
    seen: list[float] = []
    there = run_many(
        subjects, CASES, tmp_path / "runs.jsonl", workers=2, progress=lambda _what, share: seen.append(share)
    )
    for name in subjects:
        assert [r.verdict for r in here[name]] == [r.verdict for r in there[name]]
        assert [r.case for r in there[name]] == list(CASES)
    assert here["one"] != here["other"]  # a rest over its limit is left out
    assert seen == sorted(seen)
    assert (seen[0], seen[-1]) == (0.0, 1.0)


def test_finished_runs_are_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept, subjects = tmp_path / "folder" / "runs.jsonl", {"one": subject()}
    first = run_many(subjects, CASES[:3], kept, workers=1)
    text = kept.read_text(encoding="utf-8")
    assert len(text.splitlines()) == 1  # a block
    kept.write_text(text + '{"key": "cut sho', encoding="utf-8")  # what a kill leaves

    def again(*_: object) -> list[Survival]:
        raise AssertionError("a finished run was made again")

    with monkeypatch.context() as patched:
        patched.setattr(many, "verdicts_of", again)
        assert run_many(subjects, CASES[:3], kept, workers=1) == first
        with pytest.raises(AssertionError):
            run_many({"one": replace(subject(), limit_pu=1.3)}, CASES[:3], kept, workers=1)
    longer = run_many(subjects, CASES[:4], kept, workers=1)
    assert longer["one"][:3] == first["one"]
    assert [line.split(" ")[1] for line in kept.read_text(encoding="utf-8").splitlines()] == ["3", "1"]


def test_an_interruption_keeps_what_is_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many, "CHUNK_OF_LANES", 2)
    kept = tmp_path / "runs.jsonl"

    def stop(_what: str, share: float) -> None:
        if share >= 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_many({"one": subject()}, CASES[:6], kept, workers=1, progress=stop)
    assert [line.split(" ")[1] for line in kept.read_text(encoding="utf-8").splitlines()] == ["2", "2"]


def test_two_at_once_are_refused(tmp_path: Path) -> None:
    kept, subjects = tmp_path / "runs.jsonl", {"one": subject()}

    def inner(_what: str, _share: float) -> None:
        run_many(subjects, CASES[:1], kept, workers=1)

    with pytest.raises(ArtifactError, match="in use"):
        run_many(subjects, CASES[:1], kept, workers=1, progress=inner)


def result(status: str, group: str = "a", **figures: Any) -> CaseResult:
    return CaseResult(case=case(1.0, group), verdict=Survival(status=status, **figures), seconds=0.1)


def test_figures_over_results() -> None:
    results = (
        result(SURVIVED, recovery_s=1.0, peak_pu=1.2, first_peak_pu=1.5, swing_rad=0.1),
        result(SURVIVED, recovery_s=3.0, peak_pu=1.3, first_peak_pu=1.0, swing_rad=3.0),
        result(NOT_AT_REST, recovery_s=9.0, peak_pu=1.25, first_peak_pu=1.1, swing_rad=0.2),
        result(NO_REST),
    )
    found = figures_of(results, settling_time=2.0)
    assert (found.cases, found.judged, found.survived) == (4, 3, 2)
    assert found.share == pytest.approx(2.0 / 3.0)
    assert found.statuses == {SURVIVED: 2, NOT_AT_REST: 1, NO_REST: 1}
    assert (found.peak_pu, found.first_peak_pu, found.swing_rad) == (1.3, 1.5, 3.0)
    assert found.peak_kept == pytest.approx(2.0 / 3.0)
    assert found.beyond_hardware == 0
    heavy = result(SURVIVED, peak_pu=2.1), result(NOT_AT_REST, peak_pu=9.0)
    assert figures_of(heavy, settling_time=2.0).beyond_hardware == 1
    assert found.peak_median_pu == 1.25
    assert found.peak_99_pu == pytest.approx(1.299)  # 98 % of the way from the second of three to the third
    assert (found.recovery_median, found.recovery_worst) == (1.0, 1.5)
    nothing = figures_of(results[3:], settling_time=2.0)
    assert nothing.share is nothing.peak_pu is nothing.recovery_median is nothing.peak_kept is None


def test_groups_keep_their_order() -> None:
    results = (result(SURVIVED, "b"), result(NO_REST, "a"), result(NOT_AT_REST, "b"))
    assert [(group, len(members)) for group, members in by_group(results).items()] == [("b", 2), ("a", 1)]


def test_a_subject_is_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before: once for every case, which took longer than the runs where a table belongs to the subject."""
    stamps: list[object] = []
    stamp = many._stamp
    monkeypatch.setattr(many, "_stamp", lambda one: stamps.append(one) or stamp(one))
    run_many({"one": subject()}, CASES[:3], workers=1)
    assert len(stamps) == 1
