"""The proof of the sampled full-order loop against random points and a search: none may decay more slowly than that."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from evidence._tables import leave, table
from tests.design.test_full_order_proof import MADE
from tests.design.test_proof_recheck import compared
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.certificate import Region, prove_full_order, region_of
from vsgdesign.certificate.certifying import prepared
from vsgdesign.certificate.full_order.points import decays_at
from vsgdesign.certificate.region import random_points
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import Study

POINTS = 100_000
ATTACKED = 25_000
"""Points of each problem whose enclosures are attacked."""
CASES: dict[str, tuple[str, str, Region, float]] = {
    "laboratory": (
        "studies/laboratory/study.toml",
        "scheduled",
        Region((2.0, 12.0), (3.0, 3.0001), (4e3, 8e3), (0.0, 2e3), 0.2),
        0.5,
    ),
    "utility": (
        "studies/utility/study.toml",
        "scheduled",
        Region((1.5, 10.0), (3.0, 10.0), (3e5, 7e5), (0.0, 1e5), 0.2),
        0.3,
    ),
    "closed form of studies/table": (
        "studies/table/study.toml",
        "closed_form",
        Region((2.0, 20.0), (2.0, 20.0), (-4.5e3, 4.5e3), (-2e3, 2e3), 0.2),
        0.5,
    ),
}
"""Study, controller, region and decay to prove, 1/s."""

_AT_ONCE = 5_000


def main(folder: Path) -> None:
    """Proves each case, and draws points in its region; then the enclosures of the second look are attacked."""
    attacked = [attack(name) for name in MADE]
    head_2 = ("problem", "points", "outside", "called empty", "median of off over radius")
    lines_2 = table(head_2, [[_cell(row[key]) for key in attacked[0]] for row in attacked])
    leave(folder, "full_order_recheck", attacked, lines_2)
    rows = [case(name) for name in CASES]
    head = ("case", "1/s proved", "boxes", "CPU s", "least of the search", "least of the draws", "points", "below")
    keys = ("case", "decay", "boxes", "cpu_s", "least_searched", "least_drawn", "points", "below")
    lines = table(head, [[_cell(row[key]) for key in keys] for row in rows])
    leave(folder, "full_order", rows, lines)


def attack(name: str, count: int = ATTACKED) -> dict[str, Any]:
    """Random places in boxes and on arcs of one problem, with the gains that the estimate leads to: f of the model that
    the product linearises against the enclosures of :mod:`vsgdesign.certificate.recheck`."""
    held: list[Any] = []
    near: list[float] = []
    empty = 0
    while sum(map(len, held)) < count:
        own, off, none = compared(MADE[name], seed=1000 + len(held))
        held.append(own)
        near += off
        empty += int(none.sum())
    every = np.concatenate(held)
    return {
        "problem": name,
        "points": len(every),
        "outside": int((~every).sum()),
        "empty": empty,
        "near": float(np.median(near)),
    }


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else f"{value:,}" if isinstance(value, int) else str(value)


def case(name: str, count: int = POINTS) -> dict[str, Any]:
    """The proof and the draws of one case."""
    file, controller, region, decay = CASES[name]
    study: Study = load_study(file)
    spec, _ = region_of(study, controller, None, None)
    begin = time.process_time()
    proof = prove_full_order(study, spec, region, decay=decay, workers=1)
    seconds = time.process_time() - begin
    system, _ = prepared(study, spec, region, NOTHING, None, None)
    own, rng = study.with_limit_of(spec), np.random.default_rng(7)
    found: list[Any] = []
    while sum(map(len, found)) < count:
        points = random_points(region, _AT_ONCE, rng)
        decays = decays_at(own, system, points[system.within_limits(points)])
        found.append(decays[np.isfinite(decays)])
    every = np.concatenate(found)
    return {
        "case": name,
        "decay": decay,
        "proved": proof.proved if not proof.complete else 1.0,
        "boxes": proof.boxes,
        "cpu_s": round(seconds, 1),
        "least_searched": proof.slowest.decay,
        "least_drawn": float(every.min()),
        "points": len(every),
        "below": int((every <= decay).sum()),
    }
