"""Rough nodes are found, and the surface that they are pulled to is the one through their neighbours."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.design.robust_studies import specification, with_specification
from tests.gain_tables import table
from vsgdesign.design.between import BetweenCheck, PointCheck, broken_beside, reach, rough_nodes, surface
from vsgdesign.design.cell import CellDesign
from vsgdesign.design.evaluation import Figures
from vsgdesign.design.record import CellRecord, better
from vsgdesign.design.search import variables
from vsgdesign.design.table_nodes import demote

SCR, RATIO = (2.0, 3.0, 4.5, 6.0), (0.5, 1.0, 2.0)
SPEC = specification(with_specification(scr=SCR, x_over_r=RATIO))
V = variables("angle_damped", SPEC)
TABLE = table(scr=SCR, x_over_r=RATIO)
GOOD = Figures(
    overshoot_P=0.0,
    settling_P=1.0,
    overshoot_Q=0.0,
    settling_Q=1.0,
    cross_peak=0.1,
    disk_margin=1.2,
    damping_ratio=0.8,
    abscissa=-3.0,
)
CENTRE = np.array([3.3, 2.2, 1.9, 0.9, 0.8])


def record(scr: float, x_over_r: float, y: Any, missed: dict[str, float] | None = None, **changes: Any) -> CellRecord:
    gains = type(V.normalised(CENTRE))(*(float(value) for value in V.normalised(np.asarray(y))))
    design = CellDesign(
        normalised=gains,
        figures=GOOD,
        inertia=5.0,
        active="settling_time",
        price=7.0,
        shortfalls=missed or {},
        scenarios=37,
        iterations=20,
    )
    return replace(CellRecord(scr, x_over_r, design, GOOD, None), **changes)


def plane(scr: float, x_over_r: float) -> np.ndarray:
    """Linear in the logarithms."""
    slopes = np.array([[0.3, 0.1, 0.2, 0.0, 0.02], [-0.2, 0.1, 0.0, 0.01, 0.0]])
    return CENTRE + np.log([scr / 3.0, x_over_r]) @ slopes


def test_a_plane_is_its_own_surface_but_for_the_ridge() -> None:
    """The ridge keeps a share of the slope back: none in the middle of a symmetric neighbourhood, little elsewhere."""
    records = [record(s, x, plane(s, x)) for s in SCR for x in RATIO]
    scr, ratio = (np.array(values) for values in zip(*((s, x) for s in SCR for x in RATIO), strict=True))
    found = surface(V, TABLE, records, scr, ratio)
    expected = np.array([plane(s, x) for s, x in zip(scr, ratio, strict=True)])
    assert np.abs(found - expected).max() < 0.1
    flat = [record(s, x, CENTRE) for s in SCR for x in RATIO]
    np.testing.assert_allclose(surface(V, TABLE, flat, scr, ratio), np.tile(CENTRE, (12, 1)), rtol=1e-12)


def test_a_node_that_keeps_nothing_counts_little() -> None:
    """One node 1 off in ln k_1: nearly all of it is smoothed away, and more where the node misses its promises."""
    off = CENTRE + np.array([1.0, 0.0, 0.0, 0.0, 0.0])
    found = []
    for missed in ({}, {"overshoot": 0.1}):
        records = [
            record(s, x, off if (s, x) == (3.0, 1.0) else CENTRE, missed if (s, x) == (3.0, 1.0) else None)
            for s in SCR
            for x in RATIO
        ]
        found.append(surface(V, TABLE, records, np.array([3.0]), np.array([1.0]))[0] - CENTRE)
    assert found[0][1:] == pytest.approx(np.zeros(4), abs=1e-12)
    assert 0.0 < found[1][0] < 0.2 * found[0][0] < 0.2


def test_nodes_around_a_broken_promise_and_their_neighbours_are_rough() -> None:
    records = [record(s, x, CENTRE) for s in SCR for x in RATIO]
    assert rough_nodes(TABLE, records, (), True) == []
    point = PointCheck(5.0, 1.5, GOOD, {"overshoot": 0.06}, True)
    around = rough_nodes(TABLE, records, (point,), True)
    assert around == [k for k in range(12) if k // 3 >= 1]  # rows 4.5 and 6 and their neighbour, all columns
    grids = ((5.0, 1.5),)
    found = [
        k
        for k, (s, x) in enumerate((s, x) for s in SCR for x in RATIO)
        if broken_beside(TABLE, (point,), (s, x)) == grids
    ]
    assert found == [7, 8, 10, 11]  # of 4.5 and 6, X/R 1 and 2
    alone = [
        replace(r, design=replace(r.design, shortfalls={"overshoot": 0.1})) if k == 0 and r.design else r
        for k, r in enumerate(records)
    ]
    assert rough_nodes(TABLE, alone, (), True) == [0, 1, 3, 4]
    assert rough_nodes(TABLE, alone, (), False) == []
    lost = [replace(r, inner_rad_s=320.0) if k == 0 else r for k, r in enumerate(alone)]
    assert rough_nodes(TABLE, lost, (), True) == []


def test_a_node_that_keeps_its_promises_is_not_given_up_for_smoothness() -> None:
    kept, worse = record(3.0, 1.0, CENTRE), record(3.0, 1.0, CENTRE + 0.1, {"disk_margin": 0.9})
    new = record(3.0, 1.0, CENTRE + 0.2)
    assert better(None, worse) is worse
    assert better(kept, worse) is kept
    assert better(worse, new) is new
    assert new.design is not None
    pulled = replace(new, design=replace(new.design, active="overshoot", price=99.0))
    chosen = better(kept, pulled).design
    assert chosen is not None
    assert (chosen.normalised, chosen.active, chosen.price) == (new.design.normalised, "settling_time", 7.0)


def test_a_node_has_most_say_half_way_to_its_neighbours() -> None:
    assert reach(SCR, RATIO, 2.0, 1.0) == pytest.approx((2.0, np.sqrt(6.0), np.sqrt(0.5), np.sqrt(2.0)))
    assert reach(SCR, RATIO, 6.0, 0.5) == pytest.approx((np.sqrt(27.0), 6.0, 0.5, np.sqrt(0.5)))


def test_what_stays_broken_is_not_promised_by_the_nodes_around_it() -> None:
    """SCR 3.7 lies between the second node and the third, X/R 0.7 between the first and the second."""
    missed = {"overshoot": 0.08}
    points = (PointCheck(3.7, 0.7, GOOD, missed, True), PointCheck(5.0, 1.5, GOOD, missed, False))
    given_up = np.zeros(TABLE.shape, dtype=bool)
    given_up[1:3, 0:2] = True
    found = demote(TABLE, BetweenCheck(points, 0, 0))
    assert (TABLE.status == "met").all()
    assert ((found.status == "relaxed") == given_up).all()
    assert (found.active[given_up] == "between nodes: overshoot → 0.08").all()
    assert (found.active[~given_up] == TABLE.active[~given_up]).all()
