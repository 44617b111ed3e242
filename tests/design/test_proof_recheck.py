"""The second look at a full-order proof: it accepts what was proved, refuses what is not true, and its enclosures hold
the model that the product linearises."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.design.full_order_problems import ALPHA, a_table, closed_form, laboratory, units_apart, units_table
from tests.design.test_full_order_proof import MADE, places
from vsgdesign.artifacts.proof_file import LEFT, ProofFile, packed, unpacked
from vsgdesign.certificate import proof_file, prove_full_order, region_of
from vsgdesign.certificate.full_order.rows import inner_rows
from vsgdesign.certificate.recheck import verdict
from vsgdesign.certificate.recheck.inner import Inner, arcs_of, cells_of
from vsgdesign.certificate.recheck.loops import Loops, boxes_of, f_of, jacobians, made_of
from vsgdesign.certificate.recheck.polynomials import Space
from vsgdesign.certificate.recheck.reading import cells_of_table
from vsgdesign.certificate.recheck.verdict import FOREIGN, check_proof
from vsgdesign.certificate.region import Region
from vsgdesign.study.parameters import load_study

REGION = Region((8.0, 8.5), (3.0, 3.02), (4e3, 8e3), (0.0, 2e3), 0.1)


@functools.cache
def made() -> Any:
    """A study with a proof of few boxes."""
    study = load_study("studies/laboratory/study.toml")
    spec, _ = region_of(study, "scheduled", None, None)
    found = prove_full_order(study, spec, REGION, decay=0.5, workers=1)
    assert found.complete
    return study, proof_file(study, found, None)


@pytest.fixture
def no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the search for slow points had found nothing: boxes and arcs alone decide, in less time."""
    monkeypatch.setattr(verdict, "_decays", lambda *_: (None, []))


def with_arrays(proof: ProofFile, change: Callable[[dict[str, Any]], None]) -> ProofFile:
    """A copy whose first block was changed."""
    arrays = {name: value.copy() for name, value in unpacked(proof.blocks[0]).items()}
    change(arrays)
    return replace(proof, blocks=(packed(arrays), *proof.blocks[1:]))


def with_statement(proof: ProofFile, **changes: Any) -> ProofFile:
    return replace(proof, statement=proof.statement | changes)


@pytest.mark.usefixtures("no_search")
def test_what_was_proved_is_accepted_whole() -> None:
    study, proof = made()
    found = check_proof(proof, study, None)
    assert not found.faults
    assert found.looked is not None
    assert found.looked.boxes == found.looked.of > 0
    assert found.looked.share == pytest.approx(1.0)
    assert found.proved == 1.0


def drop(name: str, start: int, end: int | None) -> Callable[[dict[str, Any]], None]:
    def change(arrays: dict[str, Any]) -> None:
        keep = np.ones(len(arrays[name]), dtype=np.bool_)
        keep[start:end] = False
        arrays[name] = arrays[name][keep]

    return change


def left(arrays: dict[str, Any]) -> None:
    arrays["tree"][-1] = LEFT


def narrower(column: int, share: float) -> Callable[[dict[str, Any]], None]:
    def change(arrays: dict[str, Any]) -> None:
        low, high = arrays["roots"][:, column], arrays["roots"][:, column + 6]
        arrays["roots"][:, column + 6] = low + share * (high - low)

    return change


@pytest.mark.usefixtures("no_search")
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (drop("tree", -1, None), "the tree of boxes is cut short"),
        (drop("tree", 0, 1), "the tree of boxes"),
        (left, "certified: does not agree with the tree of boxes"),
        (drop("arcs", -1, None), "an arc is missing"),
        (drop("arcs", 0, 1), "an arc is missing|arcs do not end"),
        (drop("cells", 0, 1), "a proved box has no arcs|arcs too many"),
        (narrower(0, 0.98), "no box holds the grids"),
        (narrower(1, 0.98), "no box holds the grids"),
        (narrower(2, 0.98), "errors beyond"),
        (narrower(4, 0.98), "powers beyond"),
    ],
)
def test_what_is_left_out_is_refused(change: Callable[[dict[str, Any]], None], words: str) -> None:
    """Each file has its right hash: the arrays are changed before it is written."""
    study, proof = made()
    found = check_proof(with_arrays(proof, change), study, None)
    assert any(re.search(words, fault) for fault in found.faults), found.faults


@pytest.mark.usefixtures("no_search")
def test_arcs_that_do_not_reach_around_are_refused() -> None:
    study, proof = made()
    arcs = (*proof.coarse_arcs[:-1], 0.999 * proof.coarse_arcs[-1])
    found = check_proof(replace(proof, coarse_arcs=arcs), study, None)
    assert "before the half circle does" in found.faults[0]


@pytest.mark.usefixtures("no_search")
def test_a_larger_region_than_the_boxes_is_refused() -> None:
    study, proof = made()
    region = proof.statement["region"] | {"P": [3.9e3, 8e3]}
    assert "powers beyond" in check_proof(with_statement(proof, region=region), study, None).faults[0]


@pytest.mark.usefixtures("no_search")
def test_other_inner_gains_or_another_table_are_told_apart() -> None:
    study, proof = made()
    gains = proof.statement["inner_gains"]
    other = check_proof(with_statement(proof, inner_gains=gains | {"K_pv": 2.0 * gains["K_pv"]}), study, None)
    assert "inner_gains" in other.faults[0]
    assert check_proof(replace(proof, table="0" * 64), study, None).carried == (FOREIGN,)


def test_more_than_the_slowest_mode_decays_is_refused() -> None:
    study, proof = made()
    faster = with_statement(proof, decay=proof.statement["slowest"]["decay"] * 1.02)
    assert "a mode at" in check_proof(faster, study, None).faults[0]


@pytest.mark.usefixtures("no_search")
def test_the_boxes_alone_refuse_it_too() -> None:
    study, proof = made()
    faster = with_statement(proof, decay=proof.statement["slowest"]["decay"] * 1.2)
    assert "a box is not confirmed" in check_proof(faster, study, None).faults[0]


@pytest.mark.usefixtures("no_search")
def test_an_inner_gain_with_which_a_point_is_unstable_is_refused_by_the_boxes() -> None:
    """The statement names the gains that the study has: nothing but the loop itself is wrong."""
    study, proof = made()
    wild = study.inner_gains._replace(K_pv=6.0 * study.inner_gains.K_pv)
    other = replace(study, inner_gains=wild)
    found = check_proof(with_statement(proof, inner_gains=wild._asdict()), other, None)
    assert "a box is not confirmed" in found.faults[0]


def test_operations_hold_every_point() -> None:
    """Products, quotients, roots, sines and exponentials of random polynomials, at random points and radii."""
    rng, space, count = np.random.default_rng(3), Space(3, 3), 60
    low = rng.uniform(0.2, 0.9, (count, 3))
    high = low + rng.uniform(0.0, 0.2, (count, 3))
    x, y, w = (space.variable(low[:, k], high[:, k], k) for k in range(3))
    sine, power = space.sine(low[:, 0], high[:, 0], 0, 0), space.exponential(2j, -0.3, low[:, 2], high[:, 2], 2)
    rough = (x * y).widened(0.01)
    results = [rough * w, 1.0 / (x + y), (x * x + y).sqrt(), sine * power, (power + 3.0).reciprocal() * x - 2.0]
    for k in range(40):
        t = rng.uniform(-1.0, 1.0, (count, 3))
        if k < 8:
            t = np.sign(t)
        a, b, c = (0.5 * (low + high) + 0.5 * (high - low) * t).T
        e = np.expm1(-0.3 + 2j * c)
        off = 0.01 * np.exp(2j * np.pi * rng.random(count))
        truths = [(a * b + off) * c, 1.0 / (a + b), np.sqrt(a * a + b), np.sin(a) * e, a / (e + 3.0) - 2.0]
        powers = np.array([np.prod(t ** np.array(exponents), axis=1) for exponents in space.exponents])
        for form, truth in zip(results, truths, strict=True):
            assert (np.abs((form.c * powers).sum(axis=0) - truth) <= form.radius).all()
    assert max(float(form.radius.max()) for form in results) < 0.06  # and the bounds say something


def loops_of(of: Any) -> Loops:
    """What a second look sees of a problem."""
    study, problem = of()
    limits = problem.system.static
    return Loops(
        study=study,
        inner=Inner.of(study, problem.system.apart),
        region=problem.region,
        schedule=problem.system.schedule,
        table=None if of in (laboratory, closed_form) else units_table() if of is units_apart else a_table(),
        current=limits.current,
        bridge_voltage=limits.bridge_voltage,
        alpha=ALPHA,
        divisor=problem.loop.divisor,
    )


def compared(of: Any, seed: int = 5) -> tuple[Any, list[float], Any]:
    """At the places of the first enclosures: whether f of det(z − A) is held, how far it is off over the radius, and
    whether a condition says that a point that counts is none."""
    _, problem = of()
    at, pieces, loops = places(of, seed), problem.pieces, loops_of(of)
    cells = cells_of(loops.inner, at.low, at.low * [1.02, 1.01])
    arcs = arcs_of(loops.inner, cells, at.cell, at.edges[:, 0], at.edges[:, 1], ALPHA)
    each = np.arange(len(at.f))
    estimates = np.concatenate([pieces.first, pieces.slope], axis=1)[at.piece]
    if loops.table is not None:  # the cell of the table that holds the place is one of those that the box may meet
        own = [cells_of_table(loops, x, x, one)[0] for x, one in zip(at.x, estimates, strict=True)]
        for k, one in enumerate(own):
            assert one.tolist() in cells_of_table(loops, at.start[k], at.end[k], estimates[k]).tolist()
        estimates = np.array(own)
    boxes = boxes_of(loops, cells, at.cell, at.start, at.end, estimates)
    held, near = np.zeros(len(each), dtype=np.bool_), []
    for may, J in jacobians(loops, boxes):
        found = f_of(loops, arcs, each, boxes, made_of(loops, boxes, J), each)
        powers = np.array([np.prod(at.t ** np.array(e), axis=1) for e in found.space.exponents])
        off = np.abs((found.c * powers).sum(axis=0) - at.f)
        held |= may & (off <= found.radius)
        near += (off / found.radius)[may].tolist()
    return held, near, np.any([condition.limits()[0] > 0.0 for condition in boxes.conditions], axis=0)


@pytest.mark.parametrize("of", MADE.values(), ids=list(MADE))
def test_enclosures_hold_the_model_that_the_product_linearises(of: Any) -> None:
    held, near, empty = compared(of)
    assert held.all()
    assert np.median(near) < 0.2  # the bounds are for the whole box; at a point there is room
    assert not empty.any()


@pytest.mark.parametrize("of", [laboratory, closed_form], ids=["laboratory", "closed form"])
@pytest.mark.parametrize("kappa", [0.0, 1.4])
def test_both_derivations_of_the_controller_agree(of: Any, kappa: float) -> None:
    """Derivatives of the controller's equations against its quotients by hand; with a large prediction, too."""
    study, _ = of()
    study = replace(study, inner_gains=study.inner_gains._replace(kappa=kappa))
    rows, own = inner_rows(study), Inner.of(study).numerators
    R_c = study.filter.R_c
    wanted = {
        "denominator": (own["own"], 0.0),
        "i_s": (own["i_s"], R_c),
        "v_c": (own["v"], 0.0),
        "i_g": (own["i_g"], -R_c),
        "waiting": (own["u"], 0.0),
        "V": (own["V"] / np.sqrt(2.0), 0.0),
    }
    for name, (mine, share) in wanted.items():
        found = np.zeros(8, dtype=complex)
        found[: len(mine)] += mine
        found[: len(own["v"])] += share * own["v"]
        theirs = np.zeros(8, dtype=complex)
        theirs[: len(getattr(rows, name).coefficients)] = getattr(rows, name).coefficients
        assert np.abs(found - theirs).max() <= 1e-12 * max(np.abs(found).max(), 1e-300), name
