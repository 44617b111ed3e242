"""The map answer of the explorer: one figure of one controller over SCR × X/R."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import Ready
from vsgdesign.explore.answer import Answer
from vsgdesign.explore.scene import Shown, at_source, held_grid, shown_of
from vsgdesign.explore.state import State
from vsgdesign.explore.survived import survived_cells
from vsgdesign.operating_point.static_limits import static_limit_uses
from vsgdesign.parameters.study import Study
from vsgdesign.stability.cells import CellSet, cell_set, gains_in_force, grid_arrays
from vsgdesign.stability.quick import quick_figures

Array = NDArray[np.float64]

SCR = (1.2, 25.0)
X_OVER_R = (0.25, 25.0)
"""Ends of the map, where the study's own grids do not lie further out."""
MARGIN = 1.2
"""From a grid of the study to the end of the map, as a ratio."""
COUNTS = (30, 20)
"""Nodes along SCR and along X/R."""


@dataclass(frozen=True)
class MapFigure:
    """What is known of a figure of the map. Values are in the unit as shown."""

    name: str
    label: str
    unit: str
    better: str
    """``high`` or ``low``."""
    ends: tuple[float, float]
    """Ends of the colour scale."""
    promise: float | None
    scale: float = 1.0
    """Shown value over the value in SI."""

    def document(self) -> dict[str, Any]:
        """For the page."""
        names = ("name", "label", "unit", "promise", "better")
        return {name: getattr(self, name) for name in names} | {"low": self.ends[0], "high": self.ends[1]}


def map_figures(study: Study) -> tuple[MapFigure, ...]:
    """The figures of the map with what the study promises: its specification, else its gates."""
    spec, gates = study.specification, study.stability.gates
    asked = spec is not None and spec.settles
    settling = spec.settling_time if spec is not None and asked else gates.settling_time
    overshoot = 100.0 * spec.overshoot if spec is not None and asked else None
    return (
        MapFigure("disk_margin", "Disk margin", "", "high", (0.0, 2.0), None if spec is None else spec.disk_margin),
        # Of every mode; that of a specification is a promise of the power loops alone (docs/study-file.md).
        MapFigure("damping", "Least damping ratio", "", "high", (0.0, 1.0), gates.damping_ratio),
        MapFigure("settling_s", "2 % settling of P", "s", "low", (0.0, 2.0 * settling), settling),
        MapFigure("overshoot", "Overshoot of P", "%", "low", (0.0, 6.0 * (overshoot or 5.0)), overshoot, 100.0),
        MapFigure("decay", "Decay of the slowest mode", "1/s", "high", (0.0, 10.0 / settling), None),
        MapFigure("survived", "Survived event (EMT)", "", "high", (0.0, 1.0), 1.0),
    )


def figures_of(study: Study, ready: Ready) -> list[dict[str, Any]]:  # noqa: ARG001 - as the session calls it
    """The figures of the map for the page."""
    return [figure.document() for figure in map_figures(study)]


def map_axes(study: Study) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ends of SCR and of X/R on the map: the usual ones, moved apart so that the study's grids lie well inside.

    These are the grids of its specification, the grid with which it begins, and those of its events.
    """
    grids = [study.grid, *(event.grid for event in study.events if event.grid is not None)]
    places = [grid.place(study.converter, study.scr_basis) for grid in grids]
    scr, ratio = [place.scr for place in places], [place.x_over_r for place in places if np.isfinite(place.x_over_r)]
    if study.specification is not None:
        scr, ratio = [*scr, *study.specification.scr], [*ratio, *study.specification.x_over_r]
    return _around(SCR, scr), _around(X_OVER_R, ratio)


def _around(ends: tuple[float, float], values: list[float]) -> tuple[float, float]:
    return min([ends[0], *(value / MARGIN for value in values)]), max([ends[1], *(MARGIN * value for value in values)])


def map_answer(study: Study, ready: Ready, state: State) -> Answer:
    """One figure over SCR × X/R for the controller ``state.map_of``, or for the last one that is shown.

    ``study`` has the state's changes already. The operating point, the errors of the estimate and the held gains are
    those of the state.

    Values are NaN where there is no operating point or there are no gains, and −inf where the converter is unstable
    (``unstable``). "survived" is 1 or 0, and NaN where the event leaves no steady state within the current limit.
    ``limit_use`` is the share of the static limits that the operating point uses: 1 on the limit
    (:func:`vsgdesign.operating_point.static_limits.static_limit_uses`).
    """
    study = at_source(study, state)
    figure = next(one for one in map_figures(study) if one.name == state.figure)
    scr, ratio = (np.geomspace(*ends, count) for ends, count in zip(map_axes(study), COUNTS, strict=True))
    shape = len(ratio), len(scr)
    shown = [one for one in shown_of(study, ready, state) if state.map_of in (None, one.name)]
    header: dict[str, Any] = figure.document() | {"figure": figure.name}
    axes = {"scr": scr, "x_over_r": ratio}
    if not shown or shown[-1].law is None:
        words = shown[-1].why if shown else "No controller is shown."
        return Answer(header | {"controller": None, "why": words}, axes | {"values": np.full(shape, np.nan)})
    one = shown[-1]
    cells = map_cells(one, state, scr, ratio)
    if figure.name == "survived":
        known, good = survived_cells(one, ready, state, cells)
        values, stable = np.where(known, good.astype(float), np.nan), known
    else:
        found = quick_figures(one.study, cells, figure.name)
        known, stable = found.known, found.stable
        values = np.where(stable, figure.scale * found.values, np.where(known, -np.inf, np.nan))
    header |= {
        "controller": one.name,
        "why": _why_empty(cells, known),
        "counts": _counts(cells, known, stable, values, figure),
    }
    arrays = {
        "values": values.reshape(shape),
        "unstable": (known & ~stable).astype(float).reshape(shape),
        "limit_use": _limit_use(one.study, cells).reshape(shape),
    }
    return Answer(header, axes | arrays)


def map_cells(one: Shown, state: State, scr: Array, x_over_r: Array) -> CellSet:
    """Cells of a map, X/R slowest, with the gains of one controller in force."""
    study = one.study
    if one.law is None:
        raise ValueError(f"controller {one.name}: {one.why}")
    R_g, L_g = (values.T for values in grid_arrays(study, scr, x_over_r))
    P, Q = state.P_pu * study.converter.S_rated, state.Q_pu * study.converter.S_rated
    error = state.error_R, state.error_X
    gains = gains_in_force(study, one.law, R_g, L_g, P, Q, error=error, held=held_grid(study, state))
    return cell_set(study, R_g, L_g, P, Q, gains, one.law.why_none)


def _limit_use(study: Study, cells: CellSet) -> Array:
    omega = study.grid_source.omega_g
    R, X = study.filter.R_2 + cells.R_g, omega * (study.filter.L_2 + cells.L_g)
    uses = static_limit_uses(study, R, X, omega, cells.P, cells.Q, cells.V_rms)
    return np.max(np.array(list(uses.values())), axis=0)


def _why_empty(cells: CellSet, known: NDArray[np.bool_]) -> str | None:
    """Why no cell has a value, or None."""
    if known.any():
        return None
    if not cells.good.any():
        return f"No grid of the map has a value. The last one: {cells.faults[-1]}."
    return "No grid of the map has a steady state before and after the event within the limits of the converter."


def _counts(
    cells: CellSet, known: NDArray[np.bool_], stable: NDArray[np.bool_], values: Array, figure: MapFigure
) -> dict[str, int | None]:
    """How many cells have no operating point or no gains, are unstable, are stable, and keep the promise."""
    kept = None
    if figure.promise is not None:
        met = values >= figure.promise if figure.better == "high" else values <= figure.promise
        kept = int((met & stable).sum())
    return {
        "cells": len(cells.R_g),
        "no_point": int((~known).sum()),
        "unstable": int((known & ~stable).sum()),
        "stable": int(stable.sum()),
        "kept": kept,
    }
