"""Why a node is relaxed: each cause on a node that has it, and a table that keeps and says it."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.design.robust_studies import ROOT, TEXT, controller, specification
from vsgdesign.artifacts import read_table_file, write_table_file
from vsgdesign.artifacts.table_text import cause_text, causes_text
from vsgdesign.design import table
from vsgdesign.design.box import limit_uses, scenarios_of_estimate, within_limits
from vsgdesign.design.cell import common_design
from vsgdesign.design.evaluation import Figures, law_of
from vsgdesign.design.record import CellRecord, CellTask, record_document, record_of, run_task
from vsgdesign.design.table import DELAY, ERROR, INNER, LIMIT, NONE, Cause, build_table, explain
from vsgdesign.report.gain_table.page import causes_table, verdict_of
from vsgdesign.report.gain_table.words import heading
from vsgdesign.study.parameters import Study, study_from_text

LABORATORY = """
base = "studies/laboratory/study.toml"
[[controllers]]
name = "angle_damped"
kind = "scheduled"
structure = "angle_damped"
Q_droop = 0.5
[specification]
settling_time = "0.2 s"
P = [-1e4, 1e4]
Q = [-3e3, 3e3]
scr = [2, 8]
x_over_r = [1, 6]
[verification]
scr = [2, 8]
x_over_r = [1, 6]
"""


def text(*changes: tuple[str, str]) -> str:
    found = TEXT
    for old, new in changes:
        assert old in found
        found = found.replace(old, new)
    return found


ONE_LOAD = ("P = [-4500, 4500]\nQ = [-2000, 2000]", "P = [4500]\nQ = [2000]")
EXACT, STIFF = ("error = 0.2", "error = 0.0"), ("Q_droop = 0.5", "Q_droop = 0.05")
SLOW_SAMPLES = ("[specification]", "[converter]\ndelay_samples = 1\nsamples_per_carrier = 1\n[specification]")
WEAK = ("scr = [3, 6]\nx_over_r = [1, 3]", "scr = [1.2, 3]\nx_over_r = [0.3, 10]")
CASES: dict[str, tuple[str, float, float]] = {
    DELAY: (text(EXACT, ONE_LOAD, SLOW_SAMPLES), 6.0, 1.0),
    INNER: (LABORATORY, 8.0, 6.0),
    ERROR: (
        text(
            ("error = 0.2", "error = 0.4"),
            STIFF,
            ("1.3 s", "0.8 s"),
            ("margin = 1.0", "margin = 1.2"),
            ("scr = [3, 6]\nx_over_r = [1, 3]", "scr = [2, 6]\nx_over_r = [0.7, 6]"),
        ),
        2.0,
        0.7,
    ),
    LIMIT: (text(EXACT, STIFF, WEAK, ("margin = 1.0", "margin = 1.3")), 1.2, 0.3),
    NONE: (text(EXACT, STIFF, ("Q = [-2000, 2000]", "Q = [0]"), ("1.3 s", "0.05 s")), 3.0, 1.0),
}


def task_of(study: Study, scr: float, x_over_r: float) -> CellTask:
    spec, chosen = specification(study), controller(study)
    law = law_of(study, chosen.target, spec.aim)
    s = scenarios_of_estimate(study, spec, scr, x_over_r, chosen.target.P, chosen.target.Q)
    centre = tuple(float(value) for value in common_design(law, spec, [s]))
    return CellTask(study=study, target=chosen.target, spec=spec, scr=scr, x_over_r=x_over_r, centre=centre, seed=0)


_RECORDS: dict[str, CellRecord] = {}


def once(task: CellTask) -> CellRecord:
    """A designed cell: equal tasks have equal records, and take seconds."""
    if task.key not in _RECORDS:
        _RECORDS[task.key] = run_task(task)
    return _RECORDS[task.key]


@functools.cache
def designed(case: str) -> tuple[CellTask, CellRecord]:
    source, scr, x_over_r = CASES[case]
    task = task_of(study_from_text(source, folder=ROOT), scr, x_over_r)
    return task, once(task)


@pytest.mark.parametrize("expected", CASES)
def test_the_cause_is_what_stands_in_the_way(expected: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """And what the node would keep without it is what was specified."""
    monkeypatch.setattr(table, "run_task", once)
    task, record = designed(expected)
    study, spec = task.study, task.spec
    assert record.missed
    found = explain(task, record)
    assert found.cause == expected
    assert found.missed == record.missed
    assert 0.5 < found.limit_use <= 1.0
    said = cause_text(found.as_document())
    if expected == NONE:
        assert found.keeps is None
        assert "asks for more than this structure can reach" in said
        return
    assert found.keeps is not None
    assert found.keeps["settling_time"] <= spec.settling_time
    assert found.keeps["overshoot"] <= spec.overshoot
    assert found.keeps["disk_margin"] >= spec.disk_margin
    assert found.keeps["damping_ratio"] >= spec.damping_ratio
    assert f"settle in {found.keeps['settling_time']:.3g} s" in said
    # Taken away for good, that cause is gone: the node keeps its promises, or has another one.
    if expected == DELAY:
        at_once = replace(study, converter=replace(study.converter, delay_samples=0))
        assert not once(replace(task, study=at_once)).missed
    if expected == ERROR:
        exact = replace(spec, box=replace(spec.box, error_R=0.0, error_X=0.0))
        assert not once(replace(task, spec=exact)).missed


def test_limits_are_used_up_where_powers_are_drawn_in() -> None:
    """A scenario is within the limits exactly where it uses no more than all of each."""
    study = study_from_text(CASES[LIMIT][0], folder=ROOT)
    s = scenarios_of_estimate(study, specification(study), 1.2, 0.3, 4500.0, 1000.0)
    uses = limit_uses(study, s)
    assert max(use.max() for use in uses.values()) == pytest.approx(1.0, abs=1e-6)
    c = study.converter
    np.testing.assert_allclose(uses["largest voltage"], s.V_rms / (c.V_max_pu * c.V_rated_rms))
    more = replace(s, P=1.3 * s.P)
    np.testing.assert_array_equal(
        within_limits(study, more), np.max(list(limit_uses(study, more).values()), axis=0) <= 1
    )


def test_what_the_record_keeps_comes_back() -> None:
    _, record = designed(DELAY)
    assert record.ideal
    assert record_of(record_document(record)) == record


def document(cause: str, **changes: Any) -> dict[str, Any]:
    keeps = {"settling_time": 0.7, "overshoot": 0.012, "disk_margin": 1.3, "damping_ratio": 0.8, "H": 2.0}
    found = Cause(
        scr=1.5,
        x_over_r=0.5,
        cause=cause,
        missed={"overshoot": 0.08},
        keeps=keeps,
        limit="least voltage",
        limit_use=0.98,
    )
    return found.as_document() | changes


def test_what_is_said() -> None:
    kept = "P and Q settle in 0.7 s with 1.2 % overshoot, disk margin at the output 1.3, "
    kept += "damping ratio of the power loops 0.8, H 2 s."
    assert cause_text(document(ERROR)) == (
        "SCR 1.5, X/R 0.5: a promise is given up (overshoot 0.08) because of the error of the estimate. With an exact "
        f"estimate it would keep all: {kept}"
    )
    assert "the static limit (least voltage, of which it uses 98 %). With half of the powers" in cause_text(
        document(LIMIT)
    )
    assert "Nodes closer together would help" in cause_text(document("interpolation", keeps=None))
    unstable = {"inner_loops": float("nan")}
    assert "the inner loops find no steady state" in cause_text(document(INNER, missed=unstable))
    assert "unstable at 320 rad/s" in cause_text(document(INNER, missed={"inner_loops": 320.0}))
    assert causes_text([document(INNER), document(ERROR), document(ERROR)]) == "2 by estimate error, 1 by inner loops"


def test_a_build_finds_them_keeps_them_and_says_them(tmp_path: Path) -> None:
    """Every node of this table fails for its delay."""
    study = study_from_text(CASES[DELAY][0], folder=ROOT)
    options = {"smoothings": 0, "refinements": 0, "points": 5, "certificate": False}
    built = build_table(study, controller(study), tmp_path / "cells", **options)
    assert (built.table.status == "relaxed").all()
    assert [cause.cause for cause in built.causes] == [DELAY] * 4
    write_table_file(built.table, tmp_path / "t.json")
    table = read_table_file(tmp_path / "t.json")
    assert [cause["cause"] for cause in table.causes] == [DELAY] * 4
    lines = "\n".join(heading(table))
    assert "why cells are relaxed: 4 by delay" in lines
    assert cause_text(table.causes[0]) in lines
    assert "In 4 a promise is relaxed (4 by delay)" in verdict_of(table)
    rows = causes_table(table).rows
    assert [row[0] for row in rows] == ["delay"] * 4
    assert all(len(row) == len(causes_table(table).head) for row in rows)


def test_a_cell_that_interpolation_breaks_says_so() -> None:
    from vsgdesign.design.table import explained_between

    figures = Figures(
        overshoot_P=0.01,
        settling_P=1.0,
        overshoot_Q=0.01,
        settling_Q=1.0,
        cross_peak=0.1,
        disk_margin=1.4,
        damping_ratio=0.8,
        abscissa=-2.0,
    )
    design = designed(DELAY)[1].design
    assert design is not None
    record = CellRecord(3.0, 1.0, replace(design, shortfalls={}), figures, None)
    found = explained_between(record, {"overshoot": 0.07})
    assert "the cell itself keeps every promise" in cause_text(found.as_document())
