"""What the page learns once of the study: its names, fields, axes and curves that do not depend on the state."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.campaigns.verification.counting import LIMIT_ROOM
from vsgdesign.linear.stability.cells import reduced_cells
from vsgdesign.metrics.met import most_overshoot, most_settling_time
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.report.explore.dc_side import signals_of
from vsgdesign.report.explore.fields import fields_of, gains_of
from vsgdesign.report.explore.maps import figures_of, map_axes, map_cells, map_figures
from vsgdesign.report.explore.scene import events_of, shown_of
from vsgdesign.report.explore.state import defaults, state_of
from vsgdesign.study.parameters.study import Study

NEAR_RAD_S = 100.0
"""Modes up to this distance from the origin decide the window of the s-plane: slower than the inner loops."""
MOST = 0.85
"""Share of these modes that the window shows: the fastest of a grid may be far away from the others."""
ROOM = 1.4
"""The window is wider than the modes need by this factor: they move where a target changes or gains are held."""


def study_info(study: Study, ready: Ready, colours: Mapping[str, str]) -> dict[str, Any]:
    """The document of ``GET study``."""
    scr, x_over_r = map_axes(study)
    promises = {figure.name: (figure.promise, figure.scale) for figure in map_figures(study)}
    gates = {name: None if value is None else value / scale for name, (value, scale) in promises.items()}
    return {
        "study": {"name": study.name, "title": study.title, "file": Path(study.files[0]).name if study.files else ""},
        "controllers": [
            {"name": spec.name, "colour": colours[spec.name], "structure": spec.target.structure, "own": False}
            for spec in study.controllers
        ],
        "fields": fields_of(study),
        "gains": gains_of(),
        "figures": figures_of(study),
        "events": events_of(),
        "defaults": defaults(study),
        "map": {"scr": list(scr), "x_over_r": list(x_over_r)},
        "nodes": _nodes(study, ready),
        "static_limit": None,  # it moves with the powers: an array of the map's answer has it
        "certificate": _certificate(ready),
        "gates": gates | {"band": SETTLING_BAND, "current_limit_pu": study.converter.current_limit_pu},
        "most": most_allowed(gates, study.converter.current_limit_pu),
        "modes": modes_window(study, ready),
        "S_rated": study.converter.S_rated,
        "signals": signals_of(study),
    }


def most_allowed(gates: Mapping[str, float | None], current_limit_pu: float | None) -> dict[str, float]:
    """The largest values that keep the gates of times, overshoots and currents, SI: those of the page of a run."""
    rules = {"settling_s": most_settling_time, "overshoot": most_overshoot}
    found = {name: float(rule(gate)) for name, rule in rules.items() if (gate := gates[name]) is not None}
    return found if current_limit_pu is None else found | {"current_limit_pu": LIMIT_ROOM * current_limit_pu}


def modes_window(study: Study, ready: Ready) -> dict[str, list[float]]:
    """Ends of Re s and of Im s, 1/s, that show the slow modes of all controllers on a few of the study's grids.

    They are the modes of the reduced model. The window belongs to the study, so that modes move in it and not with it.
    """
    state = state_of(defaults(study), study)
    spec = study.specification
    ends = map_axes(study) if spec is None else [(min(values), max(values)) for values in (spec.scr, spec.x_over_r)]
    scr, x_over_r = (np.geomspace(low, high, 4) for low, high in ends)
    found: list[NDArray[np.complex128]] = [np.empty(0, dtype=complex)]
    for one in shown_of(study, ready, state):
        if one.law is not None:
            cells = map_cells(one, state, scr, x_over_r)
            if cells.good.any():
                found.append(np.linalg.eigvals(reduced_cells(one.study, cells).A).astype(complex).ravel())
    s = np.concatenate(found)
    s = s[np.abs(s) < NEAR_RAD_S]
    if len(s) == 0:
        return {"re": [-NEAR_RAD_S, 0.1 * NEAR_RAD_S], "im": [-NEAR_RAD_S, NEAR_RAD_S]}
    left, top = (_rounded_up(ROOM * float(np.quantile(v, MOST))) for v in (np.maximum(-s.real, 0.0), np.abs(s.imag)))
    top = max(top, 0.75 * left)
    return {"re": [-left, 0.2 * left], "im": [-top, top]}


def _rounded_up(value: float) -> float:
    """The next of 1, 1.5, 2, 3, 5, 7 or 10 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(value, 1.0)))
    return float(next(m * power for m in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0) if m * power >= value * (1.0 - 1e-9)))


def _nodes(study: Study, ready: Ready) -> dict[str, Any] | None:
    """Nodes of the last table inside the static limits, and whether each keeps the specification."""
    tables = [ready.tables[spec.name] for spec in study.controllers if spec.name in ready.tables]
    if not tables:
        return None
    table, status = tables[-1], np.asarray(tables[-1].status)
    rows, columns = np.nonzero(status != "outside")
    return {
        "scr": table.scr[rows].tolist(),
        "x_over_r": table.x_over_r[columns].tolist(),
        "kept": (status[rows, columns] == "met").astype(int).tolist(),
    }


def _certificate(ready: Ready) -> dict[str, Any] | None:
    """The certified rectangle of the last table that has one, as a closed polygon."""
    certificates = [table.certificate for table in ready.tables.values()]
    regions = [one.region for one in certificates if one is not None and one.certified]
    if not regions or regions[-1].scr is None or regions[-1].x_over_r is None:
        return None
    (low, high), (left, right) = regions[-1].scr, regions[-1].x_over_r
    return {"scr": [low, high, high, low, low], "x_over_r": [left, left, right, right, left]}
