"""The proof of the sampled full-order loop against random points and a search: none may decay more slowly than what is
proved. Both of its enclosures against the model that the product linearises: none may be outside.

Interrupted work goes on from the parts that are finished.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from evidence._kept_runs import kept_runs
from evidence._tables import leave, table
from tests.design import test_full_order_proof as first
from tests.design import test_proof_recheck as second
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.certificate import Region, prove_full_order
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order.points import decays_at
from vsgdesign.certificate.proof import worst_points
from vsgdesign.certificate.region import System, random_points
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.one_unit import as_unit

POINTS, SEARCHED, STEPS = 200_000, 2_000, 5
"""Of each mode of each case: random points, points that a search moves to slower ones, and its steps from each in each
of 14 rounds."""
ATTACKED, TOGETHER = 25_000, 1_000
"""Points of each problem that are drawn, and how many in two cells together; fewer of them lie in the region."""


class Case(NamedTuple):
    """What is proved: study, controller, region and decay in 1/s; whether it is one of several equal units."""

    study: str
    controller: str
    region: Region
    decay: float
    pair: bool = False


CASES = {
    "laboratory": Case(
        "studies/laboratory/study.toml",
        "scheduled",
        Region((2.0, 12.0), (3.0, 3.0001), (4e3, 8e3), (0.0, 2e3), 0.2),
        0.5,
    ),
    "utility": Case(
        "studies/utility/study.toml",
        "scheduled",
        Region((1.5, 10.0), (3.0, 10.0), (3e5, 7e5), (0.0, 1e5), 0.2),
        0.3,
    ),
    "closed form of studies/table": Case(
        "studies/table/study.toml",
        "closed_form",
        Region((2.0, 20.0), (2.0, 20.0), (-4.5e3, 4.5e3), (-2e3, 2e3), 0.2),
        0.5,
    ),
    "closed form of studies/plant": Case(
        "studies/plant/study.toml",
        "table",
        Region((2.0, 20.0), (1.0, 20.0), (-11.25e3, 11.25e3), (-3.75e3, 3.75e3), 0.2),
        0.5,
        True,
    ),
}

_AT_ONCE = 5_000


def main(folder: Path) -> None:
    """Proves each case and attacks its statement, then attacks the enclosures."""
    rows = [
        row for found in kept_runs(case, list(CASES), folder / "full_order.jsonl", "proofs") for row in found["rows"]
    ]
    head = ("case", "1/s proved", "share", "boxes", "CPU s", "least of the search", "least of the draws", "points",
            "least of the points that are moved", "points", "below")  # fmt: skip
    leave(folder, "full_order", rows, table(head, [[_cell(value) for value in row.values()] for row in rows]))
    made = [(name, start) for name in first.MADE for start in range(0, ATTACKED, TOGETHER)]
    parts = kept_runs(attack, made, folder / "full_order_enclosures.jsonl", "enclosures")
    attacked = [_joined(name, [part for part in parts if part["problem"] == name]) for name in first.MADE]
    head = ("problem", "points", "outside of the first", "called empty", "median of off over radius",
            "points of the second", "outside", "called empty", "median")  # fmt: skip
    lines = table(head, [[_cell(value) for value in row.values()] for row in attacked])
    leave(folder, "full_order_enclosures", attacked, lines)


def attack(task: tuple[str, int]) -> dict[str, Any]:
    """Random places in boxes and on arcs of one problem, in two random cells of grids, with the gains that the estimate
    leads to: f of the model that the product linearises against both enclosures."""
    name, start = task
    made = first.MADE[name]
    _, problem = made()
    rng = np.random.default_rng(1000 + start)
    region = problem.region
    grids = np.array([1.0 / np.array(region.scr)[::-1], np.arctan(region.x_over_r)])
    ends = np.array([grids[:, 0] * 1.01, grids[:, 1] / 1.03])
    low = np.exp(rng.uniform(np.log(ends[0]), np.log(ends[1]), (2, 2)))
    try:
        held, near, empty = first.compared(made, first.places(made, 1000 + start, TOGETHER, low))
    except AssertionError:  # a cell that has to be cut, or too few places that count
        return {"problem": name, "points": 0, "outside": 0, "empty": 0, "near": [], "second": None}
    found = {
        "problem": name,
        "points": len(held),
        "outside": int((~held).sum()),
        "empty": int(empty.sum()),
        "near": [float(np.median(near))],
    }
    held, near, empty = second.compared(made, seed=1000 + start)
    return found | {"second": [len(held), int((~held).sum()), int(empty.sum()), float(np.median(near))]}


def _joined(name: str, parts: list[dict[str, Any]]) -> dict[str, Any]:
    every = [part["second"] for part in parts if part["second"] is not None]
    counts = np.sum([one[:3] for one in every], axis=0).astype(int).tolist()
    return {
        "problem": name,
        **{key: sum(part[key] for part in parts) for key in ("points", "outside", "empty")},
        "near": float(np.median([value for part in parts for value in part["near"]])),
        **dict(zip(("second", "second_outside", "second_empty"), counts, strict=True)),
        "second_near": float(np.median([one[3] for one in every])),
    }


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else f"{value:,}" if isinstance(value, int) else str(value)


def case(name: str) -> dict[str, Any]:
    """The proof of one case, and the attack on what it states."""
    asked = CASES[name]
    study: Study = as_unit(load_study(asked.study), "evidence")
    spec, region = next(one for one in study.controllers if one.name == asked.controller), asked.region
    if asked.pair:
        spec = replace(spec, schedule="closed_form", table_file=None)
        study = replace(study, controllers=(spec,))
    begin = time.process_time()
    proof = prove_full_order(study, spec, region, decay=asked.decay, pair=asked.pair, workers=1)
    seconds = time.process_time() - begin
    system, _ = prepared(study, spec, region, NOTHING, None, None)
    own = study.with_limit_of(spec)
    rows = []
    for apart, found in ((False, proof), (True, proof.differential)):
        if found is None:
            continue
        drawn, moved = attacked(own, replace(system, apart=apart), region)
        rows.append(
            {
                "case": f"{name}{', against each other' if apart else ', together' if asked.pair else ''}",
                "decay": found.decay,
                "proved": found.proved,
                "boxes": found.boxes,
                "cpu_s": round(seconds, 1),
                "least_searched": found.slowest.decay,
                "least_drawn": float(drawn.min()),
                "points": len(drawn),
                "least_moved": float(moved.min()),
                "moved": len(moved),
                "below": int((drawn <= found.decay).sum() + (moved <= found.decay).sum()),
            }
        )
    return {"rows": rows}


def attacked(study: Study, system: System, region: Region) -> tuple[Any, Any]:
    """The decays at random points within the static limits, and at those to which a search moves the slowest of as many
    others."""
    rng = np.random.default_rng(7)
    found: list[Any] = []
    while sum(map(len, found)) < POINTS:
        points = random_points(region, _AT_ONCE, rng)
        decays = decays_at(study, system, points[system.within_limits(points)])
        found.append(decays[np.isfinite(decays)])

    def shortfall(places: Any, _: Any) -> Any:
        return -np.nan_to_num(decays_at(study, system, places), nan=np.inf)

    points, A = system.matrices(random_points(region, 2 * SEARCHED, rng), partial=True)
    while len(points) < SEARCHED:
        more, other = system.matrices(random_points(region, 2 * SEARCHED, rng), partial=True)
        points, A = np.concatenate([points, more]), np.concatenate([A, other])
    _, worth = worst_points(system, region, shortfall, points, A, rng, kept=SEARCHED, tries=STEPS)
    return np.concatenate(found)[:POINTS], -worth
