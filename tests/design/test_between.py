"""Between the nodes: a good table holds, a spoiled node is found, and a broken promise asks for a node there."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.design.robust_studies import law, specification, with_specification
from tests.gain_tables import table
from vsgdesign.artifacts.gain_table import GainTable, ValidityBox, base_of
from vsgdesign.design.between import check_between, check_points, failing_intervals, probe
from vsgdesign.design.box import scenarios_of_truth
from vsgdesign.design.evaluation import evaluate, worst
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.execution.jobs import each_of
from vsgdesign.runtime.table import with_node_gains

STUDY = with_specification(scr=(3.0, 6.0, 12.0), x_over_r=(1.0, 2.0, 4.0), overshoot=0.08, settling_time=2.5)
SPEC = specification(STUDY)
LAW = law(STUDY)
PARAMETERS = {"k_1": 12.0, "d_1": 6.0, "k_2": 3.4, "q": 0.0, "share_P": 1.0, "share_Q": 1.0}
GRID = np.array([[4.2, 1.7], [9.0, 3.0], [5.0, 1.2]])


def constant_table(**changes: Any) -> GainTable:
    box = ValidityBox((3.0, 12.0), (1.0, 4.0), (-4500.0, 4500.0), (-2000.0, 2000.0), (93.5, 137.5), 0.2)
    made = table(
        scr=SPEC.scr,
        x_over_r=SPEC.x_over_r,
        parameters=PARAMETERS,
        base=base_of(STUDY, "impedance"),
        validity=box,
        D_p=LAW.D_p,
        D_q=LAW.D_q,
    )
    return with_node_gains(replace(made, **changes))


GOOD = constant_table()


def spoiled(i: int, j: int) -> GainTable:
    """One node with a third of the damping."""
    d_1 = GOOD.columns["d_1"].copy()
    d_1[i, j] /= 3.0
    return constant_table(columns=GOOD.columns | {"d_1": d_1})


def test_the_same_gains_everywhere_are_those_of_one_design() -> None:
    """With constant columns a lookup is the design itself, whatever the estimate: the figures are those of the cell."""
    normalised = NormalisedGains(12.0, 6.0, 3.4, 0.0, 1.0, 1.0)
    for point, (scr, x_over_r) in zip(check_points(STUDY, LAW, SPEC, GOOD, GRID), GRID, strict=True):
        s = scenarios_of_truth(STUDY, SPEC, scr, x_over_r, GOOD.P_design, GOOD.Q_design)
        expected = worst(evaluate(LAW, normalised, s, SPEC.settling_time))
        for name, value in vars(expected).items():
            assert getattr(point.figures, name) == pytest.approx(value, rel=1e-6, abs=1e-7), name


def test_a_good_table_holds_between_its_nodes() -> None:
    checked = check_between(STUDY, LAW, SPEC, GOOD, count=60, seed=3)
    assert len(checked.points) == 60
    assert checked.promised == 60
    assert checked.broken == ()
    assert probe(STUDY, LAW, SPEC, GOOD, count=20, seed=3) == ()
    assert failing_intervals(GOOD, ()) == []
    assert checked == check_between(STUDY, LAW, SPEC, GOOD, count=60, seed=3)
    assert checked.points != check_between(STUDY, LAW, SPEC, GOOD, count=60, seed=4).points


def test_a_spoiled_node_is_found_and_nodes_are_asked_for_beside_it() -> None:
    checked = check_between(STUDY, LAW, SPEC, spoiled(0, 0), count=60, seed=3)
    assert checked.broken
    for point in checked.broken:
        assert point.scr < 6.0 / 0.8
        assert point.x_over_r < 2.0 * 1.5
        assert set(point.missed) <= {"overshoot", "settling_time", "disk_margin", "damping_ratio"}
    cuts = failing_intervals(GOOD, probe(STUDY, LAW, SPEC, spoiled(0, 0), count=20, seed=3))
    assert cuts
    assert {axis for axis, _ in cuts} <= {"scr", "x_over_r"}
    for axis, value in cuts:
        nodes = SPEC.scr if axis == "scr" else SPEC.x_over_r
        assert any(value == pytest.approx(np.sqrt(a * b), rel=1e-5) for a, b in itertools.pairwise(nodes))


def test_nothing_is_promised_beside_a_relaxed_node() -> None:
    status = GOOD.status.copy()
    status[0, 0] = "relaxed"
    given_up = replace(spoiled(0, 0), status=status)
    points = check_points(STUDY, LAW, SPEC, given_up, np.array([[3.2, 1.1], [9.0, 3.0]]))
    assert [point.promised for point in points] == [False, True]
    assert points[0].missed
    assert probe(STUDY, LAW, SPEC, given_up, count=10, seed=0) == ()


def test_workers_see_what_one_process_sees() -> None:
    """Equal to the last digit, in order, whoever looks at which grids."""
    alone = check_between(STUDY, LAW, SPEC, GOOD, count=300, seed=5)
    with ThreadPoolExecutor(2) as executor:
        assert check_between(STUDY, LAW, SPEC, GOOD, count=300, seed=5, each=each_of(executor)) == alone


def test_grids_without_a_scenario_are_counted_as_outside() -> None:
    """With the source at 1.5 pu not even no load is within 1.25 pu."""
    study = with_specification(V_g_rms=(165.0,), scr=(3.0, 6.0, 12.0), x_over_r=(1.0, 2.0, 4.0))
    study = replace(study, grid_source=replace(study.grid_source, V_g_rms=165.0))
    checked = check_between(study, LAW, specification(study), GOOD, count=5, seed=0)
    assert checked.outside == 5
    assert checked.points == ()
