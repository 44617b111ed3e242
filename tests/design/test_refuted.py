"""Grids between nodes that the full-order model alone refutes go back to the designer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.design.robust_studies import controller, law, scenarios, specification, textbook, with_specification
from tests.design.test_smoothing import record
from tests.gain_tables import table
from vsgdesign.artifacts.gain_table import ValidityBox
from vsgdesign.certificate.full_order import points as search
from vsgdesign.design import table_nodes
from vsgdesign.design.between import BetweenCheck, refuted_between
from vsgdesign.design.record import CellTask, with_full_order
from vsgdesign.design.table_nodes import TableJob, TableNodes, look_between, smooth_nodes
from vsgdesign.execution.executors import silent

SCR, RATIO = (8.0, 20.0), (3.0, 20.0)
STUDY = with_specification(scr=SCR, x_over_r=RATIO)
SPEC = specification(STUDY)
CENTRE = tuple(float(value) for value in textbook(STUDY))


def made(scr: Any, x_over_r: Any) -> Any:
    """A table of the closed form that promises everything."""
    limits = (-4500.0, 4500.0), (-2e3, 2e3), STUDY.converter.V_limits_rms, 0.2
    box = ValidityBox((scr[0], scr[-1]), (x_over_r[0], x_over_r[-1]), *limits)
    return table(scr=scr, x_over_r=x_over_r, validity=box, status=np.full((len(scr), len(x_over_r)), "met"))


@pytest.fixture(autouse=True)
def _small_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "_KEPT", 6)


def test_the_slowest_mode_between_nodes_is_found_where_it_grows() -> None:
    """The published inner loops lose the network's mode near SCR 20 and X/R 20, which ideal ones do not have."""
    options = STUDY, controller(STUDY), law(STUDY), SPEC
    (found,) = refuted_between(*options, made(SCR, RATIO), 0)
    assert found.scr > 15.0
    assert found.missed == {"settling_time": np.inf}
    assert found.promised
    assert refuted_between(*options, made((3.0, 5.0), (1.0, 3.0)), 0) == ()
    # What the table does not promise is not refuted.
    relaxed = replace(made(SCR, RATIO), status=np.full((2, 2), "relaxed"))
    assert refuted_between(*options, relaxed, 0) == ()


def test_nodes_around_it_are_asked_to_keep_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A look that finds nothing else ends with it, its nodes are rough, and their new tasks have the grid."""
    monkeypatch.setattr(table_nodes, "probe", lambda *_, **__: ())
    monkeypatch.setattr(table_nodes, "look_at_random", lambda *_: BetweenCheck((), 0, 0))
    own = made(SCR, RATIO)
    job = TableJob(
        study=STUDY, controller=controller(STUDY), spec=SPEC, law=law(STUDY), folder=tmp_path, executor=None, seed=0,
        points=5, tell=silent,
    )  # fmt: skip
    order = [(s, x) for s in SCR for x in RATIO]
    tasks = {node: task(node) for node in order}
    nodes = TableNodes(scr=SCR, x_over_r=RATIO, tasks=tasks, best={node: record(*node, CENTRE) for node in order})
    look = look_between(job, nodes, own, iter(range(9)), first=True, last=False)
    assert look.refuted == look.broken != ()
    assert look.checked is not None
    assert look.checked.broken == look.refuted
    assert look.rough == (0, 1, 2, 3)
    grid = look.refuted[0].scr, look.refuted[0].x_over_r
    for one in smooth_nodes(job, nodes, own, look).tasks.values():
        assert one.refuted == one.beside == (grid,)
        assert one.key != task((one.scr, one.x_over_r)).key


def task(node: tuple[float, float]) -> CellTask:
    return CellTask(
        study=STUDY, target=controller(STUDY).target, spec=SPEC, scr=node[0], x_over_r=node[1], centre=CENTRE, seed=0
    )


def test_a_design_is_judged_there_by_the_full_order_model() -> None:
    design = record(8.0, 3.0, CENTRE).design
    assert design is not None
    s = scenarios(STUDY, 8.0, 3.0)
    alone = with_full_order(task((8.0, 3.0)), law(STUDY), s, design)
    assert "inner_loops" not in alone.missed
    there = with_full_order(replace(task((8.0, 3.0)), refuted=((20.0, 20.0),)), law(STUDY), s, design)
    assert "inner_loops" in there.missed
