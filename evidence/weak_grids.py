"""Random disturbances on weak resistive grids and in the whole box: how many are lost, how, and which ones.

The angle-damped closed form of three converters and the gain table of the second one, all with the projection limiter
at 1.2 pu, go through jumps of the grid, phase jumps up to 180 degrees, sags, ramps of the frequency and new references
in equal parts. Estimates are wrong by up to 20 % and silent for 20 ms to 1 s. ``VSGDESIGN_WEAK_SHARE=0.1`` runs a
tenth. ``VSGDESIGN_WEAK_BEFORE=FILE`` names the weak_grids.json of another version, and lists what is lost in one alone:
a case is the same in both.
"""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from evidence._field_converters import CONVERTERS, STUDIES
from evidence._tables import leave, table
from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.campaigns.verification.draws import cases_of, uniforms_of
from vsgdesign.simulation.lanes.results import DIVERGED, JUDGED, STATUSES
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.study.parameters import load_study
from vsgdesign.study.parameters.case_families import FAMILIES, families
from vsgdesign.study.parameters.study import Study
from vsgdesign.verbs.pipeline.survival import survival_tables

SEED, BLOCK = 282_028, 4096

BOXES = {"corner": ((1.2, 1.6), (0.3, 0.6), 4096), "whole box": ((1.2, 20.0), (0.3, 20.0), 10240)}
"""SCR, X/R, and how many cases are drawn."""

SUBJECTS = (*((name, "angle_damped") for name in CONVERTERS), ("12.5 kVA", "table"))

PEAK_PU = 1.26
"""Largest current later than 5 ms after an event that is not counted, pu."""


def with_box(study: Study, scr: tuple[float, float], x_over_r: tuple[float, float]) -> Study:
    """The study with all families but small steps in equal parts, on grids of this box."""
    asked = study.verification
    if asked is None:
        raise ValueError(f"{study.name} has no verification")
    drawn = {
        name: replace(family, weight=0.0 if name not in FAMILIES or name == "step" else 1.0)
        for name, family in asked.families.items()
    }
    drawn["phase"] = replace(drawn["phase"], ranges={**drawn["phase"].ranges, "jump": (0.0, math.pi)})
    return replace(
        study, verification=replace(asked, families=drawn, box=replace(asked.box, scr=scr, x_over_r=x_over_r))
    )


def measure(study: Study, controller: str, ready: Ready, count: int) -> dict[str, Any]:
    """So many cases of a controller: how many are judged and above the limit, and each lost one."""
    (spec,) = [one for one in study.controllers if one.name == controller]
    judged, above, lost = 0, 0, []
    for first in range(0, count, BLOCK):
        cases, family = cases_of(study, spec, uniforms_of(SEED, first, min(BLOCK, count - first)), ready=ready)
        found = run_lanes(study, spec, ready, cases)
        is_judged = found.status >= JUDGED
        judged += int(is_judged.sum())
        above += int((found.peak_pu[is_judged] > PEAK_PU).sum())
        for k in np.flatnonzero(found.status >= DIVERGED):
            lost.append([first + int(k), families()[family[k]], STATUSES[found.status[k]]])
    return {"judged": judged, "above": above, "lost": lost}


def main(folder: Path) -> None:
    share, before = float(os.environ.get("VSGDESIGN_WEAK_SHARE", "1")), os.environ.get("VSGDESIGN_WEAK_BEFORE")
    kept = folder / "survival"
    kept.mkdir(exist_ok=True)
    earlier = json.loads(Path(before).read_text(encoding="utf-8")) if before else {}
    document = {}
    for name, controller in SUBJECTS:
        study = load_study(STUDIES / f"{CONVERTERS[name]}.toml")
        ready = survival_tables(study, kept) if controller == "table" else NOTHING
        for box, (scr, x_over_r, count) in BOXES.items():
            found = measure(with_box(study, scr, x_over_r), controller, ready, round(share * count))
            document[f"{name}, {controller}, {box}"] = found
    leave(folder, "weak_grids", document, table_of(document, earlier))
    print("\n".join(told(document, earlier)))


def table_of(document: dict[str, Any], earlier: dict[str, Any]) -> list[str]:
    """How many are lost, how, and in which disturbances."""
    head = ["converter, controller, box", "lost before", "lost of judged", "newly lost", "how", "disturbance"]
    rows = []
    for name, found in document.items():
        lost, new = found["lost"], newly_lost(found, earlier.get(name))
        how, where = (Counter(case[place] for case in lost).most_common() for place in (2, 1))
        rows.append(
            [
                name,
                str(len(earlier[name]["lost"])) if name in earlier else "–",
                f"{len(lost)} of {found['judged']:,} ({100.0 * len(lost) / found['judged']:.2f} %)",
                str(len(new)) if name in earlier else "–",
                ", ".join(f"{count} {status}" for status, count in how) or "–",
                ", ".join(f"{count} {family}" for family, count in where) or "–",
                str(found["above"]),
            ]
        )
    return table([*head, f"> {PEAK_PU} pu"], rows)


def newly_lost(found: dict[str, Any], earlier: dict[str, Any] | None) -> set[int]:
    """Numbers of the cases that the other version did not lose; without another version none."""
    numbers = {case[0] for case in found["lost"]}
    return numbers - {case[0] for case in (earlier or found)["lost"]}


def told(document: dict[str, Any], earlier: dict[str, Any]) -> list[str]:
    """Every lost case."""
    return [
        f"lost: {name}: case {number}: {family}: {status}{' (new)' if number in new else ''}"
        for name, found in document.items()
        for new in (newly_lost(found, earlier.get(name)),)
        for number, family, status in found["lost"]
    ]
