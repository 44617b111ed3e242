"""What a page without a server simulates with: the starts of its controllers."""

from __future__ import annotations

import functools
from pathlib import Path

import pytest

from evidence._random_studies import bare, table_of
from evidence.page_runs import STUDY
from tests.explore.dc_studies import SOURCES
from tests.explore.dc_studies import STUDY as STUDY_WITH_SOURCE
from vsgdesign.artifacts.ready import Ready, read_tables
from vsgdesign.report.explore.lattice import Lattice, Texts
from vsgdesign.report.explore.page_runs import PageRuns, page_runs
from vsgdesign.report.explore.page_starts import TOO_STIFF, starts_of
from vsgdesign.report.explore.session import Session
from vsgdesign.report.explore.state import PlaceOfState
from vsgdesign.study.parameters import study_from_text

STIFF = """
base = "case:utility_1mva_60hz"
grid = { scr = 5, x_over_r = 3 }
filter = { R_c = 2.0 }
simulation = { duration = 1.0, P_ref = 0, Q_ref = 0 }
[[controllers]]
name = "fixed"
kind = "fixed"
"""
"""On a strong grid its fastest mode dies out within a sample."""


@functools.cache
def session_in(folder: Path, bridge: str = "averaged") -> Session:
    table_of(bare("lab_12kva_lcl"), "a", folder / "table.json")
    study = study_from_text(STUDY.format(case="lab_12kva_lcl", P_ref=4000.0), folder=folder)
    return Session(study, Ready(tables=read_tables(study)), bridge=bridge)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return session_in(tmp_path_factory.mktemp("runs"))


def runs_of(session: Session) -> PageRuns:
    study, lattice = session.study_of(session.start), Lattice((0.4, 3.0, 7.0), (3.0,), PlaceOfState(3.0, 3.0))
    states = lattice.states(session.start, held=False)
    return page_runs(
        study, session.ready, lattice, {False: (states, starts_of(study, session.ready, states))}, {}, Texts()
    )


@pytest.fixture(scope="module")
def runs(session: Session) -> PageRuns:
    return runs_of(session)


def test_every_way_of_gains_has_its_starts(runs: PageRuns) -> None:
    found, data = runs
    assert [one["gains"] for one in found["controllers"]] == ["fixed", "listed", "followed", "table"]
    assert data[:4] == b"\0asm"
    kinds, packed = found["columns"]["kinds"], data[found["module"] :]
    assert len(packed) == sum({"s": 8, "e": 24, "w": 9}[kind] for kind in kinds)
    there = {one["there"] for one in found["controllers"]}
    assert len(there) == 1  # the weakest grid carries no 4 kW
    assert kinds[there.pop()] == "w"
    assert all(kinds[one["why"]] == "w" for one in found["controllers"])
    loops = [one["loop"] for one in found["controllers"]]
    assert len(set(loops)) == 1  # they are of one kind


@pytest.mark.parametrize(("bridge", "held"), [("averaged", False), ("averaged", True), ("pwm", False)])
def test_starts_on_many_grids_are_those_of_single_runs(session: Session, bridge: str, held: bool) -> None:
    """To the bit, in all ways in which gains come about, and with the words of those that have no start."""
    if bridge != session.bridge:
        session = Session(session.study, session.ready, bridge=bridge)
    study, lattice = session.study_of(session.start), Lattice((0.4, 2.0, 7.0), (0.7, 4.0), PlaceOfState(3.0, 3.0))
    states = lattice.states(session.start, held=held)
    together = starts_of(study, session.ready, states)
    for at, state in enumerate(states):
        alone = starts_of(study, session.ready, [state])  # one grid is begun as any run
        assert together.saves[at] == alone.saves[0]
        for many, one in zip(together.starts, alone.starts, strict=True):
            assert many.why[at] == one.why[0]
            if one.why[0] is None:
                assert many.numbers[at].tobytes() == one.numbers[0].tobytes()
    assert {one.there.sum() for one in together.starts} == {4}  # the weakest grids carry no 4 kW


@pytest.mark.parametrize("source", ["battery", "converter", "photovoltaic", "clamped"])
def test_starts_of_a_dc_link_are_those_of_single_runs(source: str) -> None:
    """To the bit, with the words of grids on which the source cannot hold the rest."""
    session = Session(study_from_text(STUDY_WITH_SOURCE.format(dc=SOURCES[source])), Ready())
    states = Lattice((2.0, 7.0), (0.7, 4.0), PlaceOfState(3.0, 3.0)).states(session.start, held=False)
    together = starts_of(session.study, session.ready, states)
    for at, state in enumerate(states):
        alone = starts_of(session.study, session.ready, [state])
        for many, one in zip(together.starts, alone.starts, strict=True):
            assert many.why[at] is None
            assert many.numbers[at].tobytes() == one.numbers[0].tobytes()


def test_a_grid_that_is_too_stiff_to_switch_has_no_start() -> None:
    """Its edges need a loop of another form, and the page has one loop for all grids. The others keep theirs."""
    session = Session(study_from_text(STIFF), Ready(), bridge="pwm")
    states = Lattice((1.0, 20.0), (1.0,), PlaceOfState(1.0, 1.0)).states(session.start, held=False)
    for bridge, why in (("pwm", [None, TOO_STIFF]), ("averaged", [None, None])):
        own = Session(session.study, session.ready, bridge=bridge)
        assert starts_of(own.study, own.ready, states).starts[0].why == why


def test_controllers_share_the_numbers_of_a_grid(runs: PageRuns) -> None:
    """The circuit and the grid are kept once."""
    found, _ = runs
    rows = found["places"][found["controllers"][0]["loop"]]["rows"]
    first, second = (one["numbers"] for one in found["controllers"][1:3])
    same = [name for name, a, b in zip(rows, first, second, strict=False) if a == b]
    assert {"row.p11", "row.b1", "row.re1", "grid.R_g"} <= set(same)


def test_the_same_bytes_when_made_twice(runs: PageRuns, session: Session) -> None:
    assert runs_of(session) == runs
