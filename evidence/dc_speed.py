"""How fast a batch is whose converters stand on a battery, over one with ideal dc links.

The disturbances of ``dc_side`` at 60 % of the charge, in processor time, after the loops have been compiled; the least
of three runs each.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from evidence._field_converters import CONTROLLER, CONVERTERS, STUDIES
from evidence._tables import leave, table
from evidence.dc_side import SEED, boxed, on_battery
from vsgdesign.artifacts.ready import NOTHING
from vsgdesign.campaigns.verification.draws import cases_of, uniforms_of
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.study import ControllerSpec, Study

COUNT, TIMES, FEW = 240, 3, 16


def seconds(studies: list[Study], spec: ControllerSpec, cases: LaneCases) -> list[float]:
    """Least processor time of each study, s; they take turns, so that all meet the same machine."""
    for study in studies:
        run_lanes(study, spec, NOTHING, cases.take(np.arange(FEW)))
    found = [float("inf")] * len(studies)
    for _ in range(TIMES):
        for k, study in enumerate(studies):
            begin = time.process_time()
            run_lanes(study, spec, NOTHING, cases)
            found[k] = min(found[k], time.process_time() - begin)
    return found


def main(folder: Path) -> None:
    document = {}
    for name in CONVERTERS:
        study = load_study(STUDIES / f"{CONVERTERS[name]}.toml")
        (spec,) = [one for one in study.controllers if one.name == CONTROLLER]
        cases, _ = cases_of(boxed(study), spec, uniforms_of(SEED, 0, COUNT), ready=NOTHING)
        held = on_battery(study, 0.6)
        if held.dc is None:
            raise ValueError("the dc link is ideal.")
        free = replace(held, dc=replace(held.dc, compensation="none"))
        ideal, *others = seconds([study, held, free], spec, cases)
        document[name] = dict(zip(("measured", "none"), (ideal / one for one in others), strict=True))
    head = ["converter", '`compensation = "measured"`', '`compensation = "none"`']
    rows = [[name, *(f"{100.0 * share:.0f} %" for share in one.values())] for name, one in document.items()]
    leave(folder, "dc_speed", document, table(head, rows))
