"""What a page without a server simulates with: the starts of its controllers."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evidence._random_studies import bare, table_of
from vsgdesign.artifacts.ready import Ready, read_tables
from vsgdesign.report.explore.page_runs import PageRuns, page_runs
from vsgdesign.report.explore.session import Session
from vsgdesign.study.parameters import study_from_text

STUDY = """
base = "case:lab_12kva_lcl"
grid = { scr_basis = "impedance", scr = 5, x_over_r = 3 }
power_loops = { structure = "angle_damped", P_droop = 0.05, Q_droop = 0.5 }
converter = { current_limit_pu = 1.2, current_limiter = "projection" }
simulation = { duration = 1.0, P_ref = "4 kW", Q_ref = 0 }
[[controllers]]
name = "fixed"
kind = "fixed"
[[controllers]]
name = "listed"
kind = "scheduled"
structure = "published"
[[controllers]]
name = "followed"
kind = "scheduled"
[[controllers]]
name = "table"
kind = "scheduled"
schedule = "table"
table = "table.json"
"""
"""One controller for each way in which gains come about."""


@functools.cache
def session_in(folder: Path) -> Session:
    table_of(bare("lab_12kva_lcl"), "a", folder / "table.json")
    study = study_from_text(STUDY, folder=folder)
    return Session(study, Ready(tables=read_tables(study)))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return session_in(tmp_path_factory.mktemp("runs"))


def runs_of(session: Session) -> PageRuns:
    at = [(f"{i},0", replace(session.start, scr=scr)) for i, scr in enumerate((0.4, 3.0, 7.0))]
    return page_runs(session.study_of(session.start), session.ready, at)


def test_every_way_of_gains_has_its_starts(session: Session) -> None:
    found, data, _ = runs_of(session)
    assert [one["gains"] for one in found["controllers"]] == ["fixed", "listed", "followed", "table"]
    for one in found["controllers"]:  # the weakest grid carries no 4 kW
        assert one["keys"] == ["1,0", "2,0"]
        assert one["why"]["0,0"].startswith("no operating point")
    numbers = np.frombuffer(data[found["module"] :])
    assert data[:4] == b"\0asm"
    counts = [one["width"] + 2 * len(one["varying"]) for one in found["controllers"]]
    assert len(numbers) == sum(counts)
    loops = [one["loop"] for one in found["controllers"]]
    assert len(set(loops)) == 1  # they are of one kind
    rows = found["places"][loops[0]]["rows"]
    first, at = numbers[: counts[0]], rows.index("state.P_f")
    columns = first[found["controllers"][0]["width"] :].reshape(-1, 2)
    varying = dict(zip(found["controllers"][0]["varying"], columns, strict=True))
    np.testing.assert_allclose(varying.get(at, first[[at, at]]), 4e3, rtol=1e-9)  # it rests at its powers


def test_the_same_bytes_when_made_twice(session: Session) -> None:
    assert runs_of(session) == runs_of(session)
