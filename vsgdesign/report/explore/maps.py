"""The map answer of the explorer: one figure of one controller over SCR × X/R, fast enough to follow the mouse."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.definitions import DEFINITIONS
from vsgdesign.artifacts.ready import Ready
from vsgdesign.linear.operating_point.equilibrium import static_limit_uses
from vsgdesign.linear.operating_point.full_order import FullOrderModel
from vsgdesign.linear.stability.maps import CellSet, cell_set, full_order_cells, gains_in_force, grid_arrays
from vsgdesign.linear.stability.margins import eigenvalues_of, margins_named
from vsgdesign.linear.stability.modes_of_units import asked_apart, differential_modes
from vsgdesign.linear.stability.step_responses import full_order_settling
from vsgdesign.metrics.modes import least_damping
from vsgdesign.report.explore.scene import (
    Shown,
    at_source,
    event_s,
    events_at,
    held_grid,
    length_s,
    references_of,
    shown_of,
    told_spec,
)
from vsgdesign.report.explore.state import State
from vsgdesign.report.explore.wire import Answer
from vsgdesign.simulation.lanes.cases import ACTIVE, DISTURBANCE, REACTIVE, STEP, LaneCases, LaneEvents
from vsgdesign.simulation.lanes.results import JUDGED, NO_REST, OVER_LIMIT, LaneResults
from vsgdesign.simulation.lanes.run import run_lanes
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

QUICK_FIGURES = ("disk_margin_output", "damping_all_modes", "decay", "settling_s", "overshoot")

_POINTS = 60
_LOWEST_RAD_S = 0.1
_STEP_POINTS = 500


@dataclass(frozen=True)
class QuickFigures:
    """One figure of N cells: arrays (N,)."""

    values: Array
    """NaN where it is not known, and in unstable cells but for the damping and the decay."""
    known: NDArray[np.bool_]
    """Whether the cell has an operating point, gains and a steady state."""
    stable: NDArray[np.bool_]


def quick_figures(study: Study, cells: CellSet, figure: str) -> QuickFigures:
    """One of QUICK_FIGURES of the full-order model in every cell.

    ``disk_margin_output`` is found on 60 frequencies and then refined, as
    :func:`vsgdesign.linear.stability.margins.full_order_margins` does on more. ``decay`` is the decay rate of the
    slowest mode (1/s), of a unit of a plant also of the units against each other, without which no cell is stable.
    ``settling_s`` (2 %) and ``overshoot`` (a share of the step) are those of P after a step of its
    reference, read from 500 points over ten time constants of the slowest mode. Raises ValueError for another name.
    """
    if figure not in QUICK_FIGURES:
        raise ValueError(f'figure = "{figure}": must be one of {", ".join(QUICK_FIGURES)}')
    model = full_order_cells(study, cells)
    index = np.flatnonzero(cells.good)[model.index]
    values, known = np.full(len(cells.R_g), np.nan), np.zeros(len(cells.R_g), dtype=bool)
    known[index], stable = True, np.zeros(len(known), dtype=bool)
    eigenvalues = eigenvalues_of(model)
    stable[index] = eigenvalues.real.max(axis=1) < 0.0
    if len(index):
        values[index] = _of(model, figure)
    if len(index) and asked_apart(study) > 0.0:
        each, omega = cells.take(index), study.grid_source.omega_g
        growth = differential_modes(study, each.gains, each.P, each.Q, each.V_rms, omega).real
        stable[index] &= growth < 0.0
        values[index] = np.fmin(values[index], -growth) if figure == "decay" else values[index]
    return QuickFigures(values, known, stable)


def _of(model: FullOrderModel, figure: str) -> Array:
    if figure == "disk_margin_output":
        omega = np.geomspace(_LOWEST_RAD_S, 0.999 * np.pi / model.T_s, _POINTS)
        return margins_named(model, ["disk_output"], omega)["disk_output"].value
    if figure in ("damping_all_modes", "decay"):
        eigenvalues = eigenvalues_of(model)
        return least_damping(eigenvalues) if figure == "damping_all_modes" else -eigenvalues.real.max(axis=1)
    settling, overshoot = full_order_settling(model, "P_ref", "P", _STEP_POINTS)
    return settling if figure == "settling_s" else overshoot


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
        names = ("name", "label", "unit", "promise", "better", "scale")
        return {name: getattr(self, name) for name in names} | {"low": self.ends[0], "high": self.ends[1]}


def map_figures(study: Study) -> tuple[MapFigure, ...]:
    """The figures of the map with what the study promises: its specification, else its gates."""
    spec, gates = study.specification, study.stability.gates
    asked = spec is not None and spec.settles
    settling = spec.settling_time if spec is not None and asked else gates.settling_time
    overshoot = 100.0 * spec.overshoot if spec is not None and asked else None
    output, damping = (DEFINITIONS[name].heading for name in ("disk_margin_output", "damping_all_modes"))
    return (
        MapFigure("disk_margin_output", output, "", "high", (0.0, 2.0), None if spec is None else spec.disk_margin),
        # Its limit is the gate: a specification asks for the damping ratio of the power loops.
        MapFigure("damping_all_modes", damping, "", "high", (0.0, 1.0), gates.damping_ratio),
        MapFigure("settling_s", "2 % settling of P", "s", "low", (0.0, 2.0 * settling), settling),
        MapFigure("overshoot", "Overshoot of P", "%", "low", (0.0, 6.0 * (overshoot or 5.0)), overshoot, 100.0),
        MapFigure(
            "decay", "Decay of the slowest mode", "1/s", "high", (0.0, 10.0 / settling), asked_apart(study) or None
        ),
        MapFigure("survived", "Survived event (EMT)", "", "high", (0.0, 1.0), 1.0),
    )


def figures_of(study: Study) -> list[dict[str, Any]]:
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
    (:func:`vsgdesign.linear.operating_point.equilibrium.static_limit_uses`).
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
        "limit_use": limit_use(one.study, cells).reshape(shape),
    }
    return Answer(header, axes | arrays)


def map_cells(one: Shown, state: State, scr: Array, x_over_r: Array) -> CellSet:
    """Cells of a map, X/R slowest, with the gains of one controller in force."""
    R_g, L_g = (values.T for values in grid_arrays(one.study, scr, x_over_r))
    return cells_at(one, state, R_g, L_g)


def cells_at(one: Shown, state: State, R_g: Array, L_g: Array) -> CellSet:
    """Cells of any grids at the state's powers, with the gains of one controller in force."""
    study = one.study
    if one.law is None:
        raise ValueError(f"controller {one.name}: {one.why}")
    P, Q = state.P_pu * study.converter.S_rated, state.Q_pu * study.converter.S_rated
    error = state.error_R, state.error_X
    gains = gains_in_force(study, one.law, R_g, L_g, P, Q, error=error, held=held_grid(study, state))
    return cell_set(study, R_g, L_g, P, Q, gains, one.law.why_none)


def limit_use(study: Study, cells: CellSet) -> Array:
    """The share of the static limits that each cell's operating point uses."""
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


Mask = NDArray[np.bool_]


def survived_cells(one: Shown, ready: Ready, state: State, cells: CellSet) -> tuple[Mask, Mask]:
    """Whether a verdict is known in every cell, and whether the controller survives the event there: (N,) each.

    A case without a rest before and after the event, or whose rest is beyond the current limit, has no verdict. A step
    of a reference is survived if the response settles.
    """
    known, good = np.zeros(len(cells.R_g), dtype=bool), np.zeros(len(cells.R_g), dtype=bool)
    index = np.flatnonzero(cells.good)
    if len(index) == 0:
        return known, good
    results = results_of(one, ready, state, cells.take(index))
    known[index] = ~np.isin(results.status, (NO_REST, OVER_LIMIT))
    settled = np.isfinite(results.settling_s) if state.event.kind == "step" else True
    good[index] = (results.status == JUDGED) & settled
    return known, good


def results_of(one: Shown, ready: Ready, state: State, cells: CellSet) -> LaneResults:
    """The results of :func:`vsgdesign.simulation.lanes.run.run_lanes` for cells without faults."""
    gains = type(cells.gains)(*(float(value[0]) for value in cells.gains))
    spec = told_spec(one, ready, state, gains)
    return run_lanes(one.study.undisturbed, spec, ready, lane_cases(one.study, state, cells))


def lane_cases(study: Study, state: State, cells: CellSet) -> LaneCases:
    """The page's event in cells without faults. The references put each cell at the state's powers in spite of the
    droops."""
    count, source = len(cells.R_g), study.grid_source
    P_ref, Q_ref = references_of(study, cells)
    references = zip(P_ref.tolist(), Q_ref.tolist(), strict=True)
    none = np.zeros(count)
    return LaneCases(
        R_g=cells.R_g,
        L_g=cells.L_g,
        V_g_rms=np.full(count, source.V_g_rms),
        omega_g=np.full(count, source.omega_g),
        P_ref=P_ref,
        Q_ref=Q_ref,
        events=LaneEvents.of([events_at(study, state.event, event_s(study), *refs) for refs in references]),
        error_R=none + state.error_R,
        error_X=none + state.error_X,
        silent_s=none + (0.0 if state.event.kind == "step" else state.silent_s),
        cleared_s=none + event_s(study) + length_s(state.event),
        kind=np.full(count, STEP if state.event.kind == "step" else DISTURBANCE, dtype=np.int8),
        signal=np.full(count, ACTIVE if state.event.signal == "P" else REACTIVE, dtype=np.int8),
    )
