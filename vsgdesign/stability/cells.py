"""Cells of a map: grids × operating points, each with gains, or with the reason why there is none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.model.coupled import CoupledModel, coupled_model
from vsgdesign.operating_point.full_order import Cell, FullOrderModel, linearise_full_order
from vsgdesign.parameters.study import ControllerSpec, Grid, Study, grid_from_scr
from vsgdesign.runtime.of_study import schedule_of

Array = NDArray[np.float64]

GainLaw = Callable[[Array, Array], PowerLoopGains]
"""Grids as arrays (R_g in Ω, L_g in H) to gains; NaN where there are none."""


def gain_law(study: Study, spec: ControllerSpec) -> GainLaw:
    """The gains that a controller of the study has when it knows the grid (scheduled), or always (fixed)."""
    schedule = schedule_of(study, spec)
    if spec.kind == "scheduled":
        return schedule.gains_over
    grid = spec.design_grid or study.grid
    fixed = spec.gains or schedule.gains(grid.R_g, grid.L_g)

    def constant(R_g: Array, L_g: Array) -> PowerLoopGains:
        shape = np.broadcast_shapes(np.shape(R_g), np.shape(L_g))
        return PowerLoopGains(*(np.full(shape, value) for value in fixed))

    return constant


@dataclass(frozen=True)
class CellSet:
    """N cells. ``faults`` says per cell why it cannot be analysed; None: it can.

    Operating points are exact (P, Q) at the control point. ``V_rms`` and ``delta`` are NaN in faulty cells.
    """

    R_g: Array
    L_g: Array
    P: Array
    Q: Array
    V_rms: Array
    delta: Array
    gains: PowerLoopGains
    faults: tuple[str | None, ...]

    @property
    def good(self) -> NDArray[np.bool_]:
        """Which cells can be analysed."""
        return np.array([fault is None for fault in self.faults], dtype=bool)


def cell_set(study: Study, R_g: Any, L_g: Any, P: Any, Q: Any, gains: PowerLoopGains) -> CellSet:
    """Cells of broadcast arrays of grids, powers and gains, each checked for an operating point and for gains."""
    arrays = [np.asarray(value, dtype=float) for value in (R_g, L_g, P, Q, *gains)]
    R_g, L_g, P, Q, *rest = (np.array(a).ravel() for a in np.broadcast_arrays(*arrays))
    gains = PowerLoopGains(*rest)
    R, X = study.filter.R_2 + R_g, study.grid_source.omega_g * (study.filter.L_2 + L_g)
    with np.errstate(invalid="ignore"):
        V_rms, delta = operating_point(P, Q, study.grid_source.V_g_rms, R, X)
    has_gains = np.all([np.isfinite(value) for value in gains], axis=0)
    faults: list[str | None] = []
    for k in range(len(R_g)):
        if np.isnan(V_rms[k]):
            faults.append(
                f"no operating point: the grid cannot carry P = {P[k] / 1e3:.4g} kW, Q = {Q[k] / 1e3:.4g} kvar"
            )
        elif not has_gains[k]:
            faults.append("no gains: the design point does not exist on this grid")
        else:
            faults.append(None)
    return CellSet(R_g, L_g, P, Q, V_rms, delta, gains, tuple(faults))


def grid_arrays(study: Study, scr: Array, x_over_r: Array) -> tuple[Array, Array]:
    """R_g and L_g over scr (rows) × x_over_r (columns), on the study's SCR basis; shape (len(scr), len(x_over_r))."""
    grids = [[grid_from_scr(float(s), float(x), study.scr_basis, study.converter) for x in x_over_r] for s in scr]
    return np.array([[g.R_g for g in row] for row in grids]), np.array([[g.L_g for g in row] for row in grids])


def reduced_cells(study: Study, cells: CellSet, coupling: bool = True) -> CoupledModel:
    """The coupled reduced model of the good cells, in order."""
    good = cells.good
    R = study.filter.R_2 + cells.R_g[good]
    X = study.grid_source.omega_g * (study.filter.L_2 + cells.L_g[good])
    gains = PowerLoopGains(*(value[good] for value in cells.gains))
    return coupled_model(
        cells.delta[good], cells.V_rms[good], np.full(R.shape, study.grid_source.V_g_rms), R, X, gains,
        tau_P=study.tau_P, tau_Q=study.tau_Q, coupling=coupling,
    )  # fmt: skip


def full_order_cells(study: Study, cells: CellSet) -> FullOrderModel:
    """The full-order model of the good cells, with references that put each at its (P, Q) in spite of droop."""
    requests: list[Cell] = []
    c, omega_g = study.converter, study.grid_source.omega_g
    for k in np.flatnonzero(cells.good):
        gains = PowerLoopGains(*(float(value[k]) for value in cells.gains))
        P_ref = cells.P[k] - gains.D_p * (c.omega_n - omega_g)
        Q_ref = cells.Q[k] - gains.D_q * (c.V_rated_rms - cells.V_rms[k])
        requests.append(Cell(Grid(float(cells.R_g[k]), float(cells.L_g[k])), gains, float(P_ref), float(Q_ref)))
    return linearise_full_order(study, requests)


def operating_box(P: Sequence[float], Q: Sequence[float]) -> tuple[Array, Array]:
    """All combinations of P and Q, flat."""
    grid = np.meshgrid(np.asarray(P, dtype=float), np.asarray(Q, dtype=float), indexing="ij")
    return grid[0].ravel(), grid[1].ravel()
