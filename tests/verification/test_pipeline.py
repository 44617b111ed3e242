"""The folder of a verification: the same counts from any way there, nothing lost, nothing of others replaced."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.verification import stand_in
from tests.verification.test_summary import STUDY
from vsgdesign.campaigns.verification.blocks import Shard, VerificationJob
from vsgdesign.errors import ArtifactError, StudyError
from vsgdesign.execution.journal import kept_count, kept_folder
from vsgdesign.study.parameters import study_from_text
from vsgdesign.verbs.pipeline import verify
from vsgdesign.verbs.pipeline.verify import WORK, Asked, check_verifiable, merge_shards, verify_study

RUNS = 1000
ASKED = Asked(runs=RUNS, search=0, explorer=False)


@pytest.fixture(autouse=True)
def without_emt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Formulas in place of the EMT, in small blocks."""

    def job_of(study: Any, spec: Any, ready: Any, asked: Asked) -> Any:
        del ready
        drawn = replace(
            study.verification, runs=asked.runs or 1, seed=study.verification.seed if asked.seed is None else asked.seed
        )
        return stand_in.job(replace(study, verification=drawn), drawn.runs, spec=spec, block=64), 0.99

    monkeypatch.setattr(verify, "job_of", job_of)
    monkeypatch.setattr(
        "vsgdesign.report.verification.page.write_verification_page", lambda *_: []
    )  # its figures take seconds


def counts(folder: Path) -> bytes:
    return (folder / "counts.json").read_bytes()


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    verify_study(STUDY, tmp_path / "whole", ASKED, workers=1)
    return tmp_path / "whole"


def test_the_folder_says_what_was_counted(whole: Path) -> None:
    document = json.loads((whole / "results.json").read_text(encoding="utf-8"))
    assert document["runs"] == RUNS
    step = document["families"]["step"]
    assert step["drawn"] == step["judged"] + sum(step["left_out"].values())
    assert 0 < step["promises"]["settling"]["broken"] <= step["broken"]
    assert step["promises"]["settling"]["worst"] is None  # one never settles
    assert document["broken"] == sum(one["broken"] for one in document["families"].values())
    assert [row["rank"] for row in document["worst"]] == list(range(1, 21))
    assert all(row["agrees"] is None and (whole / row["study"]).is_file() for row in document["worst"])
    assert document["families"]["step"]["promises"]["settling"]["broken"] == sum(
        "settling" in case["promises"] for case in document["broken_cases"]
    )
    assert not kept_folder(whole, WORK).exists()


def test_an_interruption_loses_nothing(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, run, made = tmp_path / "out", VerificationJob.run, []

    def stopping(job: Any, number: int) -> Any:
        if len(made) == 5:
            raise KeyboardInterrupt
        made.append(number)
        return run(job, number)

    monkeypatch.setattr(VerificationJob, "run", stopping)
    with pytest.raises(KeyboardInterrupt):
        verify_study(STUDY, out, ASKED, workers=1)
    assert not out.exists()
    assert kept_count(out, WORK) == 5 * 64
    monkeypatch.setattr(VerificationJob, "run", lambda job, number: made.append(number) or run(job, number))
    verify_study(STUDY, out, ASKED, workers=1)
    assert sorted(made) == list(range(16))
    assert counts(out) == counts(whole)


def test_a_table_that_was_designed_for_it_goes_with_the_blocks(tmp_path: Path) -> None:
    beside = kept_folder(tmp_path / "out", WORK)
    beside.mkdir()
    (beside / "study.one.table.json").write_text("{}")
    verify_study(STUDY, tmp_path / "out", ASKED, workers=1)
    assert not beside.exists()


def test_a_fresh_start_forgets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, run, made = tmp_path / "out", VerificationJob.run, []

    def stopping(job: Any, number: int) -> Any:
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(number)
        return run(job, number)

    monkeypatch.setattr(VerificationJob, "run", stopping)
    for _ in range(2):
        made.clear()
        with pytest.raises(KeyboardInterrupt):
            verify_study(STUDY, out, ASKED, workers=1, fresh=True)
        assert made == [0, 1]


def shard(folder: Path, number: int, of: int, asked: Asked = ASKED) -> Path:
    verify_study(STUDY, folder / f"shard-{number}", asked, workers=1, shard=Shard(number, of))
    return folder / f"shard-{number}"


def test_shards_merge_into_the_whole(whole: Path, tmp_path: Path) -> None:
    for number in (3, 1, 2):
        shard(tmp_path / "parts", number, 3)
    merge_shards(STUDY, [tmp_path / "parts"], tmp_path / "merged", Asked(search=0, explorer=False), workers=1)
    assert counts(tmp_path / "merged") == counts(whole)
    files = [folder / "results.json" for folder in (whole, tmp_path / "merged")]
    results = [json.loads(file.read_bytes()) for file in files]
    varying = {"timing_s", "shards", "workers", "files", "sha256"}
    one, other = ({key: value for key, value in found.items() if key not in varying} for found in results)
    assert one == other


def test_shards_that_do_not_fit(tmp_path: Path) -> None:
    parts = [shard(tmp_path, number, 3) for number in (1, 2)]
    out = tmp_path / "merged"
    with pytest.raises(ArtifactError, match=r"5 blocks of 16, the first with number 2, are missing"):
        merge_shards(STUDY, parts, out, workers=1)
    with pytest.raises(ArtifactError, match=r"both have block 0: the same runs would count twice"):
        merge_shards(STUDY, [*parts, parts[0]], out, workers=1)
    other = shard(tmp_path / "other", 3, 3, replace(ASKED, seed=77))
    with pytest.raises(ArtifactError, match=r"of another verification: seed 77 instead of 1"):
        merge_shards(STUDY, [*parts, other], out, workers=1)
    third = shard(tmp_path, 3, 3)
    changed = STUDY.with_changes(converter={"current_limit_pu": 1.3})
    with pytest.raises(ArtifactError, match="another content of the study"):
        merge_shards(changed, [*parts, third], out, workers=1)
    with pytest.raises(ArtifactError, match=r"has no counts.json"):
        merge_shards(STUDY, [tmp_path / "nothing"], out, workers=1)
    path = third / "counts.json"
    path.write_text(path.read_text().replace('"drawn": ', '"drawn": 1'))
    with pytest.raises(ArtifactError, match="was changed after it was written"):
        merge_shards(STUDY, [*parts, third], out, workers=1)
    path.write_text("NaN")
    with pytest.raises(ArtifactError, match="is not the counts of a verification"):
        merge_shards(STUDY, [*parts, third], out, workers=1)
    assert not out.exists()


@pytest.mark.parametrize("text", ["3/2", "0/2", "1", "a/b", "1/", "-1/3", "1/2/3", ""])
def test_a_shard_that_is_none(text: str) -> None:
    with pytest.raises(ValueError, match=r"i/N|the first of N is 1/N"):
        Shard.read(text)


def test_a_folder_with_something_of_others_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(ArtifactError, match=r"notes.txt.*left untouched"):
        verify_study(STUDY, tmp_path / "out", ASKED, workers=1)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_every_fault_at_once() -> None:
    text = """
base = "case:hoang2025_5kva"
[simulation]
duration = "1 s"
P_ref = "2 kW"
Q_ref = "0 var"
[background]
modulation = 0.01
modulation_frequency = "10 Hz"
[sensors]
bits = 12
[network]
load = { P_pu = 0.5 }
[[controllers]]
name = "scheduled"
kind = "scheduled"
"""
    study = study_from_text(text)
    with pytest.raises(StudyError) as caught:
        check_verifiable(study, Asked(controller="nobody"))
    assert {fault.field for fault in caught.value.faults} == {"controller", "background", "network"}
