"""What the page learns once of the study: its names, axes, limits and curves that do not depend on the state."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vsgdesign.artifacts.ready import Ready
from vsgdesign.explore import standin
from vsgdesign.explore.colours import colour_of
from vsgdesign.parameters.study import Study

SCR = (1.2, 25.0)
X_OVER_R = (0.25, 25.0)
"""Ends of the map where the study's own axes do not reach further."""


def study_info(study: Study, ready: Ready) -> dict[str, Any]:
    """The document of ``GET study``."""
    scr, x_over_r = map_axes(study)
    return {
        "study": {"name": study.name, "title": study.title, "file": Path(study.files[0]).name if study.files else ""},
        "controllers": [
            {"name": spec.name, "colour": colour_of(k), "structure": spec.target.structure, "own": False}
            for k, spec in enumerate(study.controllers)
        ],
        "fields": standin.fields_of(study, ready),
        "figures": standin.figures_of(study, ready),
        "events": standin.events_of(study),
        "defaults": standin.defaults(study, ready),
        "map": {"scr": list(scr), "x_over_r": list(x_over_r)},
        "nodes": _nodes(study, ready),
        "static_limit": None,
        "certificate": _certificate(ready),
        "gates": _gates(study),
        "modes": {"re": [-80.0, 10.0], "im": [-80.0, 80.0]},
        "S_rated": study.converter.S_rated,
    }


def map_axes(study: Study) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ends of SCR and of X/R on the map: those of the specification with a margin, or the usual ones."""
    if study.specification is None:
        return SCR, X_OVER_R
    scr, ratio = study.specification.scr, study.specification.x_over_r
    return (min(scr) / 1.2, max(scr) * 1.2), (min(ratio) / 1.2, max(ratio) * 1.2)


def _nodes(study: Study, ready: Ready) -> dict[str, Any] | None:
    tables = [ready.tables[spec.name] for spec in study.controllers if spec.name in ready.tables]
    if not tables:
        return None
    table, scr, ratio, kept = tables[-1], [], [], []
    for i, s in enumerate(table.scr):
        for j, x in enumerate(table.x_over_r):
            if table.status[i][j] != "outside":
                scr.append(float(s))
                ratio.append(float(x))
                kept.append(int(table.status[i][j] == "met"))
    return {"scr": scr, "x_over_r": ratio, "kept": kept}


def _certificate(ready: Ready) -> dict[str, Any] | None:
    """The certified rectangle of the last table that has one, as a closed polygon."""
    certificates = [table.certificate for table in ready.tables.values()]
    regions = [one.region for one in certificates if one is not None and one.certified]
    if not regions or regions[-1].scr is None or regions[-1].x_over_r is None:
        return None
    (low, high), (left, right) = regions[-1].scr, regions[-1].x_over_r
    return {"scr": [low, high, high, low, low], "x_over_r": [left, left, right, right, left]}


def _gates(study: Study) -> dict[str, float | None]:
    s = study.specification
    return {
        "damping": None if s is None else s.damping_ratio,
        "disk_margin": None if s is None else s.disk_margin,
        "settling_s": None if s is None else s.settling_time,
        "overshoot": None if s is None else s.overshoot,
        "band": 0.02,
        "current_limit_pu": study.converter.current_limit_pu,
    }
