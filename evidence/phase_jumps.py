"""Currents that `inner` tells after phase jumps, beside fresh jumps, and beside hardware with loops designed for it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import vsgdesign as vd
from evidence._tables import leave, table
from vsgdesign.campaigns.phase_jumps import (
    ANGLES_DEG,
    SCRS,
    Hardware,
    below_95,
    hardware_of,
    peaks_of,
    phase_jumps,
    remedied,
)
from vsgdesign.design.inner import GridBox, design_inner_loops
from vsgdesign.study.parameters import Study
from vsgdesign.verbs.pipeline.inner import asked_of

STUDIES = {
    "5 kVA": "studies/survival/study.toml",
    "12.5 kVA": "studies/survival/laboratory.toml",
    "1 MVA": "studies/survival/utility.toml",
    "published": "studies/published/study.toml",
}
FRESH, SEED = 300, 8086


def designed_again(own: Hardware, box: GridBox) -> Hardware:
    """Hardware with inner loops that are designed for it."""
    found = design_inner_loops(own.converter, own.filter, box)
    return own._replace(gains=found.gains, omega_t=found.omega_t)


def measure(name: str, study: Study) -> list[dict[str, Any]]:
    """What is told of a converter beside :data:`FRESH` jumps, and remedies beside loops that are designed again."""
    told, own = phase_jumps(study), hardware_of(study)
    if told is None or own is None:
        return []
    pairs = [(angle, scr) for angle in ANGLES_DEG for scr in SCRS]
    fresh = np.split(peaks_of(own, pairs, FRESH, SEED), len(pairs))
    rows: list[dict[str, Any]] = [
        {"converter": name, "what": f"{one.angle_deg:g}° at SCR {one.scr:g}", "told": one.p95_pu, "is": below_95(found)}
        for one, found in zip(told.peaks, fresh, strict=True)
    ]
    if told.warned is not None:
        pair = [(told.warned.angle_deg, told.warned.scr)]
        request = asked_of(study)
        box = GridBox(request.scr, request.x_over_r, request.scr_basis)
        others = [("the same, loops designed again", told.warned.p95_pu, own)]
        others += [(r.change, r.p95_pu, other) for r, (_, other) in zip(told.remedies, remedied(own), strict=True)]
        for what, said, other in others:
            found = below_95(peaks_of(designed_again(other, box), pair, FRESH, SEED))
            rows.append({"converter": name, "what": what, "told": said, "is": found})
    return rows


def main(folder: Path) -> None:
    """Prints the table and leaves its rows."""
    rows = [row for name, file in STUDIES.items() for row in measure(name, vd.load(file))]
    head = ("converter", "jump, or other hardware", "told, pu", "measured, pu", "told/measured − 1")
    shown = []
    for row in rows:
        told, found = float(row["told"]), float(row["is"])
        shown.append(
            (row["converter"], row["what"], f"{told:.3f}", f"{found:.3f}", f"{100 * (told / found - 1):+.1f} %")
        )
    leave(folder, "phase_jumps", rows, table(head, shown))
