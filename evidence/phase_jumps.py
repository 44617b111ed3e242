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
    below_95,
    designed_again,
    hardware_of,
    peaks_of,
    phase_jumps,
    remedied,
)
from vsgdesign.study.parameters import Study

STUDIES = {
    "5 kVA": "studies/survival/study.toml",
    "12.5 kVA": "studies/survival/laboratory.toml",
    "1 MVA": "studies/survival/utility.toml",
    "published": "studies/published/study.toml",
}
FRESH, SEED = 300, 8086


def measure(name: str, study: Study) -> list[dict[str, Any]]:
    """What is told of a converter beside :data:`FRESH` jumps, and remedies beside loops that are designed again."""
    told, own = phase_jumps(study), hardware_of(study)
    if told is None or own is None:
        return []
    pairs = [(angle, scr) for angle in ANGLES_DEG for scr in SCRS]
    fresh = np.split(peaks_of(own, pairs, FRESH, SEED), len(pairs))
    rows: list[dict[str, Any]] = [
        row(name, f"{one.angle_deg:g}° at SCR {one.scr:g}", one.p95_pu, None, below_95(found))
        for one, found in zip(told.peaks, fresh, strict=True)
    ]
    if told.warned is not None:
        pair, fully = [(told.warned.angle_deg, told.warned.scr)], phase_jumps(study, remedies=True)
        for k, (what, other) in enumerate(remedied(own)):
            gains, omega_t, _ = designed_again(other._replace(converter=own.converter), True)
            found = below_95(peaks_of(other._replace(gains=gains, omega_t=omega_t), pair, FRESH, SEED))
            rows.append(row(name, what, told.remedies[k].p95_pu, fully.remedies[k].p95_pu if fully else None, found))
    return rows


def row(name: str, what: str, told: float | None, fully: float | None, measured: float | None) -> dict[str, Any]:
    """``fully``: what is told with ``--remedies``."""
    return {"converter": name, "what": what, "told": told, "fully": fully, "is": measured}


def main(folder: Path) -> None:
    """Prints the table and leaves its rows."""
    rows = [one for name, file in STUDIES.items() for one in measure(name, vd.load(file))]
    head = ("converter", "jump, or other hardware", "told, pu", "--remedies, pu", "measured, pu", "told/measured − 1")
    shown = []
    for one in rows:
        found, known = float(one["is"]), one["told"] if one["told"] is not None else one["fully"]
        told, fully = ("–" if one[name] is None else f"{one[name]:.3f}" for name in ("told", "fully"))
        shown.append(
            (one["converter"], one["what"], told, fully, f"{found:.3f}", f"{100 * (known / found - 1):+.1f} %")
        )
    leave(folder, "phase_jumps", rows, table(head, shown))
