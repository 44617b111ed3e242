"""One figure of the full-order model in many cells, fast enough for a map that follows the mouse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.metrics.modes import damping_ratio
from vsgdesign.operating_point.full_order import FullOrderModel
from vsgdesign.parameters.study import Study
from vsgdesign.stability.cells import CellSet, full_order_cells
from vsgdesign.stability.margins import eigenvalues_of, margins_named
from vsgdesign.stability.steps import full_order_settling

Array = NDArray[np.float64]

QUICK_FIGURES = ("disk_margin", "damping", "decay", "settling_s", "overshoot")

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

    ``disk_margin`` is that of the loop broken at the plant's output, found on 60 frequencies and then refined, as
    :func:`vsgdesign.stability.margins.full_order_margins` does on more. ``damping`` is the least damping ratio,
    ``decay`` the decay rate of the slowest mode (1/s). ``settling_s`` (2 %) and ``overshoot`` (a share of the step) are
    those of P after a step of its reference, read from 500 points over ten time constants of the slowest mode. Raises
    ValueError for another name.
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
    return QuickFigures(values, known, stable)


def _of(model: FullOrderModel, figure: str) -> Array:
    if figure == "disk_margin":
        omega = np.geomspace(_LOWEST_RAD_S, 0.999 * np.pi / model.T_s, _POINTS)
        return margins_named(model, ["disk_output"], omega)["disk_output"].value
    if figure in ("damping", "decay"):
        eigenvalues = eigenvalues_of(model)
        return damping_ratio(eigenvalues).min(axis=1) if figure == "damping" else -eigenvalues.real.max(axis=1)
    settling, overshoot = full_order_settling(model, "P_ref", "P", _STEP_POINTS)
    return settling if figure == "settling_s" else overshoot
