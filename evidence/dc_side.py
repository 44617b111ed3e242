"""Random disturbances of three converters that stand on a battery: survived as on an ideal link, told, or lost.

The angle-damped closed form goes through jumps of the grid, phase jumps, sags, ramps and new references in equal parts,
at eight states of charge. The battery has V_dc at 20 % of its charge and at the rating, with a drop of 5 %; it gives
1.5 times the rated current, and its capacitor stores 20 ms of the rating. "Ten times" has a tenth of the resistance and
ten times everything else. ``VSGDESIGN_DC_SHARE=0.1`` runs a tenth.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from evidence._field_converters import CONTROLLER, CONVERTERS, STUDIES
from evidence._tables import leave, table
from evidence.weak_grids import with_box
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.draws import cases_of, uniforms_of
from vsgdesign.simulation.lanes.results import BLOCKED, JUDGED, OVER_LIMIT
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import Study

SEED, COUNT = 282_033, 2000
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


def measure(study: Study, count: int) -> dict[str, Any]:
    """So many cases in equal parts over the states of charge, on an ideal link, on the battery, and on ten of them."""
    (spec,) = [one for one in study.controllers if one.name == CONTROLLER]
    found: dict[str, Any] = dict.fromkeys(("judged", "ideal", "survived", "blocked", "told", "late", "same"), 0)
    per = -(-count // len(CHARGES))
    seconds = {"ideal": 0.0, "battery": 0.0}
    for k, charge in enumerate(CHARGES.tolist()):
        cases, _ = cases_of(boxed(study), spec, uniforms_of(SEED, k * per, per), ready=NOTHING)
        begin = time.process_time()
        ideal = run_lanes(study, spec, NOTHING, cases).status
        middle = time.process_time()
        fed = run_lanes(on_battery(study, charge), spec, NOTHING, cases).status
        seconds["battery"] += time.process_time() - middle
        seconds["ideal"] += middle - begin
        large = run_lanes(on_battery(study, charge, 10.0), spec, NOTHING, cases).status
        judged = ideal >= JUDGED
        found["judged"] += int(judged.sum())
        found["ideal"] += int((ideal == JUDGED).sum())
        found["survived"] += int((judged & (fed == JUDGED)).sum())
        found["blocked"] += int((judged & (fed == BLOCKED)).sum())
        found["told"] += int((judged & (fed <= OVER_LIMIT)).sum())
        found["late"] += int((judged & (fed > JUDGED) & (fed != BLOCKED)).sum())
        found["same"] += int((judged & (large == ideal)).sum())
    return found | {"share_of_speed": seconds["ideal"] / seconds["battery"]}


def main(folder: Path) -> None:
    count = round(float(os.environ.get("VSGDESIGN_DC_SHARE", "1")) * COUNT)
    document = {}
    for name in CONVERTERS:
        study = load_study(STUDIES / f"{CONVERTERS[name]}.toml")
        document[name] = measure(study, count)
    head = ["converter", "judged with an ideal link", "survived with it", "on the battery: survived", "told before"]
    head += [
        "blocked",
        "lost otherwise",
        "ten times: the same verdict",
        "speed of the batch over that of an ideal link",
    ]
    rows = [
        [
            name,
            *(str(one[key]) for key in ("judged", "ideal", "survived", "told", "blocked", "late", "same")),
            f"{100.0 * one['share_of_speed']:.0f} %",
        ]
        for name, one in document.items()
    ]
    leave(folder, "dc_side", document, table(head, rows))
