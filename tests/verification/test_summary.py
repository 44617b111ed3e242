"""Summaries of blocks: the same whatever the workers, the order and the interruptions."""

from __future__ import annotations

import json
import math
import random
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from tests.verification import stand_in
from vsgdesign.campaigns.verification import counting
from vsgdesign.campaigns.verification.blocks import VerificationJob
from vsgdesign.campaigns.verification.counting import FIGURES, judged_values, last_grids
from vsgdesign.campaigns.verification.summary import (
    BROKEN,
    MAP,
    QUANTILE_ERROR,
    WORST,
    Summary,
    binned,
    merged_counts,
    quantile,
    summary_document,
    summary_of,
)
from vsgdesign.errors import ArtifactError
from vsgdesign.execution import jobs
from vsgdesign.execution.executors import worker_processes
from vsgdesign.execution.jobs import parts_done
from vsgdesign.execution.journal import Journal, journal_of, kept_folder
from vsgdesign.linear.operating_point.many import CURRENT, DC_ENERGY, FAULTS
from vsgdesign.simulation.lanes.results import OVER_LIMIT, STATUSES
from vsgdesign.study.parameters import load_study
from vsgdesign.verbs.pipeline.verify import WORK

ROOT = Path(__file__).resolve().parents[2]
STUDY = load_study(ROOT / "studies" / "published_averaged" / "study.toml")
RUNS = 1500
JOB = stand_in.job(STUDY, RUNS, block=128)


def text(summary: Summary) -> str:
    return json.dumps(summary_document(summary), allow_nan=False)


@pytest.fixture(scope="module")
def blocks() -> list[Summary]:
    return [JOB.run(number) for number in JOB.blocks]


@pytest.fixture(scope="module")
def whole(blocks: list[Summary]) -> Summary:
    return reduce(Summary.merged, blocks)


def test_every_number_is_that_of_a_plain_count(whole: Summary) -> None:
    """The oracle counts case by case, in one pass over all of them."""
    cases, family = stand_in.draw(STUDY, JOB.spec, 0, RUNS)
    results = [
        (k, stand_in.run(STUDY, JOB.spec, None, cases.take(np.array([k])), bridge="averaged", strict=False))
        for k in range(RUNS)
    ]
    R_g, L_g = last_grids(cases)
    c = STUDY.converter
    expected: dict[tuple[str, str], int] = {}
    kept: dict[tuple[str, str], list[tuple[float, int]]] = {}
    judged: dict[str, int] = dict.fromkeys(stand_in.FAMILIES, 0)
    grid_map = np.zeros(MAP, int)
    for k, found in results:
        name = stand_in.FAMILIES[family[k]]
        status = STATUSES[found.status[0]]
        if status in STATUSES[:2]:
            continue
        judged[name] += 1
        if name == "jump":
            scr = c.Z_base / math.hypot(R_g[k], c.omega_n * L_g[k])
            place = [
                min(max(int(n * math.log(x / low) / math.log(high / low)), 0), n - 1)
                for x, (low, high), n in (
                    (scr, stand_in.AXES.scr, MAP[0]),
                    (c.omega_n * L_g[k] / R_g[k], stand_in.AXES.x_over_r, MAP[1]),
                )
            ]
            grid_map[place[0], place[1]] += 1
        for promise in stand_in.PROMISES:
            if name not in promise.families:
                continue
            value = float(getattr(found, promise.figure)[0])
            if math.isnan(value) or (promise.survival and status != "judged"):
                value = math.inf
            kept.setdefault((name, promise.name), []).append((-value / promise.most, k))
            expected[name, promise.name] = expected.get((name, promise.name), 0) + (value > promise.most)
    assert sum(expected.values()) > 3
    for name, one in whole.families.items():
        assert one.judged == judged[name]
        assert one.drawn == int((family == stand_in.FAMILIES.index(name)).sum())
        for key, promise in one.promises.items():
            assert promise.broken == expected[name, key]
            assert [case.number for case in promise.worst] == [k for _, k in sorted(kept[name, key])[:WORST]]
            assert sum(promise.bins.values()) == judged[name]
    assert (whole.families["jump"].judged_map == grid_map).all()
    assert whole.families["step"].broken == sum(case.family == "step" for case in whole.broken)


def test_survived_cases_with_more_current_than_hardware_carries_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit of 1.14 pu instead of 2, which some currents of the stand-in exceed; the oracle counts case by case."""
    monkeypatch.setattr(counting, "HARDWARE_PU", 1.14)
    found = JOB.run(0).merged(JOB.run(1))
    cases, family = stand_in.draw(STUDY, JOB.spec, 0, 256)
    results = stand_in.run(STUDY, JOB.spec, None, cases, bridge="averaged", strict=False)
    for number, name in enumerate(stand_in.FAMILIES):
        expected = [
            (-results.peak_pu[k], k)
            for k in range(256)
            if family[k] == number and STATUSES[results.status[k]] == "judged" and results.peak_pu[k] > 1.14
        ]
        one = found.families[name]
        assert one.beyond == len(expected) > WORST
        assert [case.number for case in one.beyond_worst] == [k for _, k in sorted(expected)[:WORST]]
    assert text(summary_of(json.loads(text(found)))) == text(found)


def test_the_order_of_merging_does_not_matter(blocks: list[Summary], whole: Summary) -> None:
    shuffled = blocks.copy()
    random.Random(3).shuffle(shuffled)
    middle = len(blocks) // 2
    one, other = reduce(Summary.merged, shuffled[:middle]), reduce(Summary.merged, shuffled[middle:])
    assert text(other.merged(one)) == text(whole)


def test_a_block_is_counted_once(blocks: list[Summary]) -> None:
    with pytest.raises(ValueError, match="block 2 is in both"):
        blocks[2].merged(blocks[2])


def test_summaries_come_back(whole: Summary) -> None:
    assert text(summary_of(json.loads(text(whole)))) == text(whole)


def test_two_processes_give_the_same_bytes(whole: Summary, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "AHEAD", 3)
    with worker_processes(2) as pool:
        found = reduce(Summary.merged, (part for _, part in parts_done(JOB, JOB.blocks, pool)))
    assert text(found) == text(whole)


def test_a_summary_does_not_grow_with_the_runs() -> None:
    harsh = (replace(stand_in.PROMISES[0], limit=0.02),)  # six steps of ten break it
    jobs = (stand_in.job(STUDY, n, block=n, promises=harsh) for n in (20_000, 60_000))
    one, two = (len(text(job.run(0))) for job in jobs)
    assert BROKEN * 50 < one < 300_000
    assert two < 1.05 * one


def test_a_torn_journal_loses_the_torn_line_alone(blocks: list[Summary], whole: Summary, tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    journal = Journal(JOB, path)
    for summary in blocks[:5]:
        journal.add(summary)
    content = path.read_bytes()
    last = content.rstrip(b"\n").rfind(b"\n") + 1
    for cut in (last, last + 1, (last + len(content)) // 2, len(content) - 1):
        path.write_bytes(content[:cut])
        again = Journal(JOB, path)
        assert again.whole.blocks == (0, 1, 2, 3)
        for summary in blocks[4:]:
            again.add(summary)
        assert text(Journal(JOB, path).whole) == text(whole)


def test_a_long_journal_is_written_anew(blocks: list[Summary], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(type(JOB), "most_lines", 3)
    path = tmp_path / "journal.jsonl"
    journal = Journal(JOB, path)
    for summary in blocks:
        journal.add(summary)
    assert len(path.read_text().splitlines()) <= 3
    assert text(Journal(JOB, path).whole) == text(journal.whole)


def test_a_job_is_found_again_by_another_process() -> None:
    """The order of a set, and an address, are others in each process."""
    given = STUDY.with_changes(verification={"scr": [2, 10], "x_over_r": [0.8, 1.2], "runs": 10, "seed": 3})
    description = stand_in.job(given, RUNS).description
    assert given.verification is not None
    assert given.verification.given
    assert "set({" not in description
    assert " at 0x" not in description
    assert stand_in.job(given, RUNS).key != stand_in.job(STUDY, RUNS).key


def test_one_process_at_a_time(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with journal_of(JOB, out, WORK), pytest.raises(ArtifactError, match="another process"), journal_of(JOB, out, WORK):
        pytest.fail("both at work")
    assert not kept_folder(out, WORK).exists()


def interrupted(out: Path, job: VerificationJob, summary: Summary | None = None) -> Summary:
    """What a job finds; it adds something and is interrupted."""
    found = Summary()
    with suppress(KeyboardInterrupt), journal_of(job, out, WORK) as journal:
        found = journal.whole
        if summary is not None:
            journal.add(summary)
        raise KeyboardInterrupt
    return found


def test_what_is_finished_is_kept_for_its_own_job_alone(blocks: list[Summary], tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert interrupted(out, JOB, blocks[0]).blocks == ()
    assert interrupted(out, stand_in.job(STUDY, RUNS + 1)).blocks == ()
    assert interrupted(out, JOB).blocks == (0,)
    with journal_of(JOB, out, WORK, fresh=True) as journal:
        assert journal.whole.blocks == ()
    assert not kept_folder(out, WORK).exists()


def test_quantiles_are_never_too_small_and_by_a_percent_too_large() -> None:
    values = np.exp(np.random.default_rng(5).normal(-1.0, 1.5, 20_001))
    bins = merged_counts(binned(values[:7_000]), binned(values[7_000:]))
    assert bins == binned(values)
    for share in (0.5, 0.9, 0.99, 0.999, 1.0):
        exact = float(np.quantile(values, share, method="inverted_cdf"))
        assert exact <= quantile(bins, share, float(values.max())) <= exact * (1.0 + QUANTILE_ERROR)


def test_quantiles_where_some_values_are_infinite() -> None:
    bins = binned(np.array([0.0, 1.0, 2.0, math.inf]))
    assert quantile(bins, 0.75, math.inf) == pytest.approx(2.0, rel=0.01)
    assert quantile(bins, 0.76, math.inf) == math.inf
    assert math.isnan(quantile({}, 0.5, 0.0))


def test_a_figure_that_is_no_number_breaks_its_promise() -> None:
    figures = np.full((2, len(FIGURES)), math.nan)
    status = np.full(2, STATUSES.index("judged"), np.int8)
    for promise in stand_in.PROMISES:
        assert np.isinf(judged_values(promise, status, figures)).all()


def test_what_the_dc_side_cannot_do_is_no_rest_over_its_limit() -> None:
    status, fault = np.array([OVER_LIMIT] * 3, dtype=np.int8), np.array([DC_ENERGY, CURRENT, DC_ENERGY], dtype=np.int8)
    assert counting._reasons(status, fault) == {FAULTS[DC_ENERGY]: 2, "rest over limit": 1}
