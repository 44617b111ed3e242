"""A table's columns over boxes whose estimates meet several of its cells, in the proof and in its second look."""

from __future__ import annotations

import functools
import itertools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.design.full_order_problems import a_table, with_table
from tests.design.test_proof_recheck import loops_of
from tests.gain_tables import table
from vsgdesign.artifacts.gain_table import GainTable, ValidityBox, base_of
from vsgdesign.artifacts.proof_file import ProofFile, proved_table
from vsgdesign.artifacts.ready import Ready
from vsgdesign.certificate import proof_file, prove_full_order
from vsgdesign.certificate.full_order import points, statement
from vsgdesign.certificate.full_order.boxes import pieces_of, whole
from vsgdesign.certificate.full_order.cells import Arcs
from vsgdesign.certificate.full_order.points import least_decay
from vsgdesign.certificate.recheck import checking, verdict
from vsgdesign.certificate.recheck.reading import NotCoveredError, check_covered, leaves_of
from vsgdesign.certificate.recheck.verdict import check_proof
from vsgdesign.certificate.region import Region
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.structures import NormalisedGains
from vsgdesign.runtime.guards import settings_of
from vsgdesign.runtime.table import table_schedule
from vsgdesign.study.parameters import load_study


@pytest.mark.parametrize("error_Z", [0.0, 0.1])
def test_columns_hold_every_estimate_of_a_box(error_Z: float) -> None:
    """Random boxes, narrow and as wide as the error set, and estimates of random places in them, looked up as a
    scheduler does: the column is as far from the box's form as the box says, or nearer."""
    study, problem = with_table(error_Z)
    pieces, schedule, c = problem.pieces, table_schedule(a_table()), study.converter
    rng, count = np.random.default_rng(4), 400
    inside = np.flatnonzero(np.isfinite(np.hstack([pieces.first, pieces.slope])).all(axis=1))
    piece = rng.choice(inside, count)
    low, high = np.zeros((count, 6)), np.zeros((count, 6))
    low[:, 0] = np.geomspace(1.0 / 9.0, 1.0 / 2.0, count)
    low[:, 1] = rng.uniform(*pieces.angle[piece].T)
    high[:, 0] = low[:, 0] * rng.uniform(1.0, 1.16, count)
    high[:, 1] = np.minimum(low[:, 1] + rng.uniform(0.0, 0.13, count), pieces.angle[piece, 1])
    e, wide = pieces.errors, rng.choice([0.02, 0.1, 0.4], (count, 2))
    low[:, 2:4] = rng.uniform(-e, e, (count, 2))
    high[:, 2:4] = np.minimum(low[:, 2:4] + wide, e)
    parameters = pieces.parameters(low, high, piece)
    names = NormalisedGains._fields
    forms, off = parameters[4 : 4 + 4 * len(names)].reshape(len(names), 4, count), parameters[-len(names) :]
    looked = 0
    for k in range(20):
        t = rng.random((count, 4)) if k else np.ones((count, 4))
        first, angle, e_R, e_X = (low[:, :4] + t * (high - low)[:, :4]).T
        w_R, w_X = problem.region.error_scales(angle)
        R = np.cos(angle) * (1.0 + w_R * e_R) * first * c.Z_base
        X = np.sin(angle) * (1.0 + w_X * e_X) * first * c.Z_base
        x, y = c.Z_base / np.hypot(R, X), R / X
        held = (1.0 / x >= pieces.first[piece, 0]) & (1.0 / x <= pieces.first[piece, 1])
        held &= (y >= pieces.slope[piece, 0]) & (y <= pieces.slope[piece, 1])
        for form, far, value in zip(forms, off, schedule.normalised(R, X / c.omega_n), strict=True):
            found = form[0] + form[1] * x + form[2] * y + form[3] * x * y
            assert (np.abs(found - value) <= far)[held].all()
        looked += int(held.sum())
    several, exact = int((off[0] > 1e-6).sum()), int((off[0] < 1e-9).sum())
    assert looked > 3000
    assert min(several, exact) > 30
    assert np.median(off[0][off[0] > 1e-6]) < 0.03 * 15.8  # and they say something


@pytest.mark.parametrize("error_Z", [0.0, 0.1])
def test_estimates_of_a_box_lie_between_its_limits(error_Z: float) -> None:
    """On both bases of the SCR of the grids and of the estimates, at random places and at the corners of boxes,
    which have the limits."""
    _, problem = with_table(error_Z)
    rng, count = np.random.default_rng(9), 300
    piece = np.full(count, 0)
    low = np.zeros((count, 6))
    low[:, :4] = rng.uniform([0.1, 0.1, -0.2, -0.2], [0.5, 1.3, 0.1, 0.1], (count, 4))
    high = low + rng.uniform(0.0, 0.1, (count, 6))
    low[:, 1], high[:, 1] = np.clip([low[:, 1], high[:, 1]], *problem.pieces.angle[0])
    for bases in itertools.product(SCR_BASES.values(), repeat=2):
        pieces = replace(problem.pieces, bases=bases)
        least, most = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
        for t in [*itertools.product((0.0, 1.0), repeat=4), *rng.random((50, count, 4))]:
            first, angle, e_R, e_X = (low[:, :4] + np.asarray(t) * (high - low)[:, :4]).T
            w_R, w_X = problem.region.error_scales(angle)
            R, X = np.cos(angle) * (1.0 + w_R * e_R), np.sin(angle) * (1.0 + w_X * e_X)
            size = bases[0].magnitude(first, np.sin(angle))
            found = np.stack([bases[1].counted(R, X) * size, R / X], axis=1)
            least, most = np.minimum(least, found), np.maximum(most, found)
        for k, limits in enumerate(pieces.estimates(low, high, piece)):
            slack = 1e-12 * np.abs(limits)
            assert (limits[:, 0] - slack[:, 0] <= least[:, k]).all()
            assert (most[:, k] <= limits[:, 1] + slack[:, 1]).all()
            if not error_Z:  # with it, an angle counts twice
                assert np.median((limits[:, 1] - limits[:, 0]) / (most - least)[:, k]) < 1.0 + 1e-9


@pytest.mark.parametrize("error_Z", [0.0, 0.1])
def test_a_proof_begins_with_all_that_the_second_look_asks_for(error_Z: float) -> None:
    """Of every cell of a whole region, with estimates inside of a table and beyond its limits. Without the boxes of one
    piece something is missing."""
    made = functools.partial(with_table, error_Z)
    _, problem = made()
    box = settings_of(a_table())
    pieces = pieces_of(problem.system, problem.region, (box.scr, box.r_over_x))
    _, _, boxes = whole(problem.system, problem.region, pieces)
    roots = np.concatenate([boxes.low, boxes.high], axis=1)
    estimates = np.concatenate([pieces.first, pieces.slope], axis=1)[boxes.piece]
    loops = loops_of(made)
    file: Any = SimpleNamespace(coarse_arcs=Arcs.coarsest(problem.loop.T_s).edges.tolist())
    check_covered(loops, file, roots, estimates)
    assert len(np.unique(boxes.piece)) >= (3 if error_Z else 6)
    for k in np.unique(boxes.piece):
        some = boxes.piece != k
        with pytest.raises(NotCoveredError):
            check_covered(loops, file, roots[some], estimates[some])


def two_by_two(middle: float) -> tuple[Any, Any, GainTable]:
    """A table of four cells on a strong grid, with k_1 of the node in the middle."""
    study = replace(load_study("studies/table/study.toml"), scr_basis="impedance")
    spec = next(one for one in study.controllers if one.name == "table")
    k_1 = np.full((3, 3), 15.8)
    k_1[1, 1] = middle
    box = ValidityBox((8.0, 8.6), (2.0, 2.2), (1e3, 3e3), (0.0, 1e3), (93.5, 137.5), 0.05)
    found = table(
        "angle_damped",
        "poles",
        np.array([8.0, 8.3, 8.6]),
        np.array([2.0, 2.1, 2.2]),
        {"k_1": k_1, "d_1": 6.6, "k_2": 4.0, "share_Q": 0.9},
        D_q=9.09,
        validity=box,
        base=base_of(study),
    )
    return study, spec, found


def test_a_proof_over_several_cells_of_a_table_is_accepted_and_that_of_another_table_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One box holds estimates in all four cells. With the same boxes, a table whose middle node is unstable is
    refused by them alone: its statement and hash are made right."""
    monkeypatch.setattr(verdict, "_decays", lambda *_: (None, []))
    monkeypatch.setattr(statement, "least_decay", lambda one, two, three: least_decay(one, two, three, 0, 100))
    monkeypatch.setattr(points, "_KEPT", 2)
    study, spec, one = two_by_two(17.0)
    region = Region((8.25, 8.35), (2.09, 2.11), (1e3, 3e3), (0.0, 1e3), 0.05)
    proof = prove_full_order(study, spec, region, ready=Ready(tables={"table": one}), decay=0.5, workers=1)
    assert proof.complete
    file: ProofFile = proof_file(study, proof, one)
    leaves, _, _ = leaves_of(file)
    assert (leaves.estimates[:, 0] < 1.0 / 8.3).any()
    found = check_proof(file, study, one)
    assert not found.faults
    assert found.looked is not None
    assert found.looked.boxes == found.looked.of > 0
    wild = two_by_two(-5.0)[2]
    monkeypatch.setattr(checking, "_DEEPEST", 6)
    refused = check_proof(replace(file, table=proved_table(wild)), study, wild)
    assert any("a box is not confirmed" in fault for fault in refused.faults)
