"""Random disturbances of three converters that stand on a battery: survived as on an ideal link, told, or lost.

The angle-damped closed form goes through jumps of the grid, phase jumps, sags, ramps and new references in equal parts,
at eight states of charge. The battery has V_dc at 20 % of its charge and at the rating, with a drop of 5 %; it gives
1.5 times the rated current, and its capacitor stores 20 ms of the rating. "Ten times" has a tenth of the resistance and
ten times everything else. What is told beforehand is run anyway. ``VSGDESIGN_DC_SHARE=0.1`` runs a tenth.
``VSGDESIGN_DC_SEED=282033`` draws the cases with which the sum of what is told was made.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evidence._field_converters import CONTROLLER, CONVERTERS, STUDIES
from evidence._tables import leave, table
from evidence.weak_grids import with_box
from tests.simulation.one_by_one import run_one
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.draws import cases_of, uniforms_of
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.many import DC_ENERGY, DC_ENERGY_IN_DOUBT
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.lanes.results import BLOCKED, JUDGED, OVER_LIMIT
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.dc_link import NONE, POWER_CLAMP
from vsgdesign.study.parameters.study import ControllerSpec, Study

Index = NDArray[np.intp]

CONTROLS = (NONE, POWER_CLAMP)

SEED, COUNT = 330_033, 2000
"""Another seed than the one with which the sum of what is told was made (282 033)."""

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
    """How many of the cases that are told beforehand cannot begin, and how many are lost in a run."""
    refused = lost = 0
    for k in told.tolist():
        try:
            run = run_one(study, spec, NOTHING, cases, k, "averaged")
        except InfeasibleStudyError:
            refused += 1
            continue
        lost += run.divergence is not None
    return refused, lost


def measure(study: Study, count: int, seed: int) -> dict[str, Any]:
    """So many cases in equal parts over the states of charge, on an ideal link, on the battery, and on ten of them."""
    (spec,) = [one for one in study.controllers if one.name == CONTROLLER]
    counted = ("survived", "blocked", "told", "by_energy", "late", "refused", "lost", "lost_by_energy")
    found: dict[str, Any] = {control: dict.fromkeys(counted, 0) for control in CONTROLS}
    found |= dict.fromkeys(("judged", "ideal", "same", "same_or_told"), 0)
    per = -(-count // len(CHARGES))
    for k, charge in enumerate(CHARGES.tolist()):
        cases, _ = cases_of(boxed(study), spec, uniforms_of(seed, k * per, per), ready=NOTHING)
        ideal = run_lanes(study, spec, NOTHING, cases).status
        judged, held = ideal >= JUDGED, on_battery(study, charge)
        for control in CONTROLS:
            own, of = with_control(held, control), found[control]
            results = run_lanes(own, spec, NOTHING, cases)
            fed, by_energy = results.status, np.isin(results.fault, (DC_ENERGY, DC_ENERGY_IN_DOUBT))
            told = judged & (fed <= OVER_LIMIT)
            of["survived"] += int((judged & (fed == JUDGED)).sum())
            of["blocked"] += int((judged & (fed == BLOCKED)).sum())
            of["told"] += int(told.sum())
            of["late"] += int((judged & (fed > JUDGED) & (fed != BLOCKED)).sum())
            for which, prefix in ((told & ~by_energy, ""), (told & by_energy, "_by_energy")):
                refused, lost = anyway(own, spec, cases, np.flatnonzero(which))
                of["refused"] += refused
                of[f"lost{prefix}"] += lost
            of["by_energy"] += int((told & by_energy).sum())
        large = run_lanes(on_battery(study, charge, 10.0), spec, NOTHING, cases).status
        found["judged"] += int(judged.sum())
        found["ideal"] += int((ideal == JUDGED).sum())
        found["same"] += int((judged & (large == ideal)).sum())
        found["same_or_told"] += int((judged & ((large == ideal) | (large <= OVER_LIMIT))).sum())
    return found


def main(folder: Path) -> None:
    count = round(float(os.environ.get("VSGDESIGN_DC_SHARE", "1")) * COUNT)
    seed, document = int(os.environ.get("VSGDESIGN_DC_SEED", str(SEED))), {}
    for name in CONVERTERS:
        study = load_study(STUDIES / f"{CONVERTERS[name]}.toml")
        document[name] = measure(study, count, seed)
        print(name, document[name], flush=True)
    head = ["converter", "control", "judged and survived with an ideal link", "survived", "told: no rest"]
    head += [
        "of these cannot begin",
        "run anyway: lost",
        "told: energy",
        "run anyway: lost",
        "blocked",
        "lost otherwise",
    ]
    rows = [
        [
            name,
            f"`{control}`",
            f"{one['judged']}, {one['ideal']}",
            str(one[control]["survived"]),
            str(one[control]["told"] - one[control]["by_energy"]),
            str(one[control]["refused"]),
            f"{one[control]['lost']} of {one[control]['told'] - one[control]['by_energy'] - one[control]['refused']}",
            str(one[control]["by_energy"]),
            f"{one[control]['lost_by_energy']} of {one[control]['by_energy']}",
            *(str(one[control][key]) for key in ("blocked", "late")),
        ]
        for name, one in document.items()
        for control in CONTROLS
    ]
    own = [
        "converter",
        "ten times: the same verdict",
        "the same, or told",
    ]
    more = [
        [
            name,
            f"{one['same']} of {one['judged']}",
            f"{one['same_or_told']} of {one['judged']}",
        ]
        for name, one in document.items()
    ]
    leave(folder, "dc_side", document, [*table(head, rows), "", *table(own, more)])
