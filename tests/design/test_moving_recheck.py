"""The second look at a proof of changing gains: it accepts what was proved, refuses what is changed, and its enclosures
hold the model that the product linearises."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest

from tests.design.test_moving_gains import MADE, PLACES, moving, true_ball, true_gain
from tests.design.test_proof_recheck import drop, left, no_search, with_arrays, with_statement
from vsgdesign.artifacts.certificate_record import CertificateCell
from vsgdesign.certificate import Region, moving_proof_file, region_of
from vsgdesign.certificate.full_order.cells import Arcs
from vsgdesign.certificate.moving.places import middle_error
from vsgdesign.certificate.moving.statement import MovingJob, MovingProof
from vsgdesign.certificate.recheck import checking
from vsgdesign.certificate.recheck.changing import difference_of, middles_of, reach_of
from vsgdesign.certificate.recheck.inner import Inner, arcs_of, cells_of
from vsgdesign.certificate.recheck.loops import Ball, Loops, boxes_of, made_of
from vsgdesign.certificate.recheck.verdict import check_proof
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.study.parameters import load_study

__all__ = ["no_search"]


@functools.cache
def made_proof() -> Any:
    """A study with the file of a proof of two boxes."""
    study = load_study("studies/laboratory/study.toml")
    spec, _ = region_of(study, "scheduled", None, None)
    region = Region((3.0, 3.2), (3.0, 3.0001), (4e3, 4.5e3), (0.0, 0.5e3), 0.1)
    job = MovingJob(study=study, spec=spec, tables={}, region=region, decay=1.0)
    every, left_ = job.of_mode(0, {name: part for block in job.blocks for name, part in job.run(block).items()})
    assert not left_
    assert not any(part["left"] for part in every)
    nothing: Any = None
    found = MovingProof(
        controller=spec.name, region=region, proved=1.0, left=(), decay=(1.0, 1.0), cells=1, boxes=1, values=1,
        why_not=None, sampled=nothing, steps="", blocks=tuple(part["record"] for part in every),
        balls=tuple({name: part[name] for name in ("decay", "L", "R")} for part in every),
        slowest=CertificateCell(scr=3.0, x_over_r=3.0, P=4e3, Q=0.0, error_R=0.0, error_L=0.0, decay=3.0),
    )  # fmt: skip
    file = moving_proof_file(study, spec, found)
    assert file is not None
    return study, file


@pytest.mark.usefixtures("no_search")
def test_what_was_proved_is_accepted_and_what_is_changed_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rates beyond the decay, weights in which the gains are no small ball, a larger error, and what is left out."""
    study, proof = made_proof()
    found = check_proof(proof, study, None)
    assert not found.faults
    assert found.looked is not None
    assert found.looked.boxes == found.looked.of > 0
    monkeypatch.setattr(checking, "_DEEPEST", 3)  # what is not true is given up sooner
    parts, region = proof.statement["parts"], proof.statement["region"]
    far = [part | {"decay": 3.0 * part["decay"]} for part in parts]
    flat = [part | {"R": [[1e-3 * part["R"][0][0], 0.0], part["R"][1]]} for part in parts]
    for other, words in (
        (with_statement(proof, parts=far), "a box is not confirmed"),
        (with_statement(proof, parts=flat), "a box is not confirmed"),
        (with_statement(proof, region=region | {"error": 0.15}), "the errors of the middle"),
        (with_statement(proof, parts=parts[1:]), "balls of gains"),
        (with_statement(proof, parts=[part | {"R": [[1.0]]} for part in parts]), "no matrices of numbers"),
        (with_statement(proof, decay=2.0 * max(part["decay"] for part in parts)), "which is less than"),
        (with_statement(proof, model="full"), "errors beyond"),
        (with_arrays(proof, drop("arcs", 0, 1)), "an arc is missing|arcs do not end"),
        (with_arrays(proof, left), "certified"),
    ):
        faults = check_proof(other, study, None).faults
        assert any(one in fault for fault in faults for one in words.split("|")), (words, faults)


@pytest.mark.parametrize("made", MADE.values(), ids=list(MADE))
def test_its_enclosures_hold_the_small_gain_of_the_model(made: Any) -> None:
    """|f|² − β²Σ|n|² on small boxes and arcs holds the value of the product's matrices, and β all estimates."""
    study, problem = moving(made)
    rng, c, limits = np.random.default_rng(9), study.converter, problem.system.static
    error, T_s = middle_error(problem.region), c.T_s
    ball = Ball(problem.ball.left, problem.ball.right, problem.ball.first, error)
    loops = Loops(
        study=study, inner=Inner.of(study, problem.system.apart), region=problem.region,
        schedule=problem.system.schedule, table=None, current=limits.current, bridge_voltage=limits.bridge_voltage,
        alpha=problem.loop.alpha, divisor=problem.loop.divisor, ball=ball,
    )  # fmt: skip
    for place in PLACES[made]:
        R, X = place[0] * np.cos(place[1]) * c.Z_base, place[0] * np.sin(place[1]) * c.Z_base
        f, w = study.filter, study.grid_source.omega_g / c.omega_n
        V, _ = operating_point(place[2], place[3], study.grid_source.V_g_rms, R + f.R_2, w * (X + c.omega_n * f.L_2))
        unit = float(V) ** 2 / np.hypot(R, X)
        x = np.array([place[0], place[1], error, error, place[2] / unit, place[3] / unit])
        width, t = np.array([0.005, 0.005, 0.0, 0.0, 0.01, 0.01]), rng.uniform(-1.0, 1.0, 7)
        low, high = (x - width * (1.0 + t[:6]))[None], (x + width * (1.0 - t[:6]))[None]
        cells, index = cells_of(loops.inner, low[:, :2], high[:, :2]), np.zeros(1, dtype=int)
        edges = Arcs.coarsest(T_s).edges
        arc = np.array([0, 3, 9, 14, 20, 30])
        arcs = arcs_of(loops.inner, cells, np.zeros(len(arc), int), edges[arc], edges[arc + 1], loops.alpha)
        estimates = np.concatenate([problem.pieces.first, problem.pieces.slope], axis=1)[:1]
        at = boxes_of(loops, cells, index, low, high, estimates)
        middles = middles_of(loops, at)
        reach = reach_of(loops, cells, index, (low, high, estimates), at, middles)
        most = true_ball(study, problem, place)
        assert most <= reach[0] < 1.3 * most
        omega = 0.5 * (edges[arc] + edges[arc + 1]) + 0.5 * (edges[arc + 1] - edges[arc]) * t[6]
        z = np.exp((-loops.alpha + 1j * omega) * T_s)
        own, wanted = true_gain(study, problem, place, z, float(reach[0]))
        ((good, J),) = [one for one in middles if one[0].any()]
        assert good.all()
        made_ = made_of(loops, at, J)
        found = difference_of(loops, arcs, np.arange(len(arc)), at, made_, np.zeros(len(arc), int), reach)
        powers = np.array([np.prod(t ** np.array(e)) for e in found.space.exponents])
        off = np.abs((found.c * powers[:, None]).sum(axis=0) - wanted)
        assert (off <= found.radius).all()
        assert (found.radius < 0.5 * np.abs(own) ** 2).all()
