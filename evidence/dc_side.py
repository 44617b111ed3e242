"""Random disturbances of three converters that stand on a battery: survived as on an ideal link, told, or lost.

The angle-damped closed form goes through jumps of the grid, phase jumps, sags, ramps and new references in equal parts,
at eight states of charge. The battery has V_dc at 20 % of its charge and at the rating, with a drop of 5 %; it gives
1.5 times the rated current, and its capacitor stores 20 ms of the rating. "Ten times" has a tenth of the resistance and
ten times everything else. What has no rest is run anyway; what is told for its energy was lost in a run, and is
compared with the sum by hand (:mod:`evidence._dc_sums`). ``VSGDESIGN_DC_SHARE=0.1`` runs a tenth,
``VSGDESIGN_DC_CHARGES=0,1`` the empty and the full battery alone, and ``VSGDESIGN_DC_SEED`` draws other cases.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence._dc_sums import refused as refused_by_hand
from evidence._field_converters import CONTROLLER, CONVERTERS, STUDIES
from evidence._tables import leave, table
from evidence.weak_grids import with_box
from tests.simulation.one_by_one import run_one
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.draws import cases_of, uniforms_of
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.many import DC_ENERGY
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.lanes.results import BLOCKED, JUDGED, OVER_LIMIT
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.dc_link import NONE, POWER_CLAMP
from vsgdesign.study.parameters.study import ControllerSpec, Study

Index = NDArray[np.intp]

CONTROLS = (NONE, POWER_CLAMP)

SEED, COUNT = 330_033, 2000
"""Another seed than the one with which the sum by hand was made (282 033)."""

CHARGES = np.linspace(0.2, 1.0, 8)


def on_battery(study: Study, charge: float, times: float = 1.0) -> Study:
    """A study whose converter stands on the battery, or on one that is so many times as large."""
    c = study.converter
    V, S = c.V_dc, c.S_rated
    battery = {
        "open_circuit": [(1.03 + 0.02 * k) * V for k in range(6)],
        "R_i": 0.05 * V * V / S / times,
        "i_max": 1.5 * S / V * times,
        "capacity_Ah": S / V * times,
        "charge": charge,
    }
    return study.with_changes(dc={"source": "battery", "C": 2.0 * 0.02 * S / V**2 * times, "battery": battery})


def boxed(study: Study) -> Study:
    """In the whole box, with all families in equal parts."""
    return with_box(study, (1.2, 20.0), (0.3, 20.0))


def with_control(study: Study, control: str) -> Study:
    """The study with another control of its dc side."""
    if study.dc is None:
        raise ValueError("the dc link is ideal.")
    return replace(study, dc=replace(study.dc, control=control))


def anyway(study: Study, spec: ControllerSpec, cases: LaneCases, told: Index) -> tuple[int, int]:
    """How many of the cases that have no rest cannot begin, and how many are lost in a run."""
    refused = lost = 0
    for k in told.tolist():
        try:
            run = run_one(study, spec, NOTHING, cases, k, "averaged")
        except InfeasibleStudyError:
            refused += 1
            continue
        lost += run.divergence is not None
    return refused, lost


COUNTED = ("survived", "no_rest", "refused", "lost", "beyond", "by_hand", "blocked", "late", "hand")


def measure(study: Study, count: int, seed: int, charges: Sequence[float]) -> dict[str, Any]:
    """So many cases in equal parts over CHARGES, of which some are run, on an ideal link, on the battery, and on ten of
    them."""
    (spec,) = [one for one in study.controllers if one.name == CONTROLLER]
    found: dict[str, Any] = {control: dict.fromkeys(COUNTED, 0) for control in CONTROLS}
    found |= dict.fromkeys(("judged", "ideal", "same", "same_or_told"), 0)
    per, listed = -(-count // len(CHARGES)), (*CHARGES.tolist(), 0.0)
    for charge in charges:
        cases, _ = cases_of(boxed(study), spec, uniforms_of(seed, listed.index(charge) * per, per), ready=NOTHING)
        ideal = run_lanes(study, spec, NOTHING, cases).status
        judged, held = ideal >= JUDGED, on_battery(study, charge)
        for control in CONTROLS:
            own, of = with_control(held, control), found[control]
            results = run_lanes(own, spec, NOTHING, cases)
            fed, beyond = results.status, judged & (results.fault == DC_ENERGY)
            none = judged & (fed <= OVER_LIMIT) & ~beyond
            by_hand = refused_by_hand(own, spec, cases) if charge in (0.0, 1.0) else np.zeros(len(cases), dtype=bool)
            of["survived"] += int((judged & (fed == JUDGED)).sum())
            of["blocked"] += int((judged & (fed == BLOCKED)).sum())
            of["late"] += int((judged & (fed > JUDGED) & (fed != BLOCKED)).sum())
            of["no_rest"] += int(none.sum())
            refused, lost = anyway(own, spec, cases, np.flatnonzero(none))
            of["refused"] += refused
            of["lost"] += lost
            of["beyond"] += int(beyond.sum())
            of["by_hand"] += int((beyond & by_hand).sum())
            of["hand"] += int((judged & ~none & by_hand).sum())
        large = run_lanes(on_battery(study, charge, 10.0), spec, NOTHING, cases).status
        found["judged"] += int(judged.sum())
        found["ideal"] += int((ideal == JUDGED).sum())
        found["same"] += int((judged & (large == ideal)).sum())
        found["same_or_told"] += int((judged & ((large == ideal) | (large <= OVER_LIMIT))).sum())
    return found


def main(folder: Path) -> None:
    count = round(float(os.environ.get("VSGDESIGN_DC_SHARE", "1")) * COUNT)
    seed, document = int(os.environ.get("VSGDESIGN_DC_SEED", str(SEED))), {}
    given = os.environ.get("VSGDESIGN_DC_CHARGES")
    charges = CHARGES.tolist() if given is None else [float(one) for one in given.split(",")]
    for name in CONVERTERS:
        study = load_study(STUDIES / f"{CONVERTERS[name]}.toml")
        document[name] = measure(study, count, seed, charges)
        print(name, document[name], flush=True)
    head = ["converter", "control", "judged and survived with an ideal link", "survived", "told: no rest"]
    head += ["of these cannot begin", "run anyway: lost", "told: energy", "refused by hand as well", "only by hand"]
    head += ["blocked", "lost otherwise"]
    rows = [
        [
            name,
            f"`{control}`",
            f"{one['judged']}, {one['ideal']}",
            str(one[control]["survived"]),
            str(one[control]["no_rest"]),
            str(one[control]["refused"]),
            f"{one[control]['lost']} of {one[control]['no_rest'] - one[control]['refused']}",
            str(one[control]["beyond"]),
            str(one[control]["by_hand"]),
            str(one[control]["hand"] - one[control]["by_hand"]),
            *(str(one[control][key]) for key in ("blocked", "late")),
        ]
        for name, one in document.items()
        for control in CONTROLS
    ]
    own = ["converter", "ten times: the same verdict", "the same, or told"]
    more = [
        [name, f"{one['same']} of {one['judged']}", f"{one['same_or_told']} of {one['judged']}"]
        for name, one in document.items()
    ]
    leave(folder, "dc_side", document, [*table(head, rows), "", *table(own, more)])
