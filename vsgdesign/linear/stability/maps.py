"""Maps over grids: margins in every cell, the stale-schedule matrix, margin against estimate error. A cell is a grid
and an operating point, with gains or with the reason why there are none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import rated_current_rms, rms_to_peak
from vsgdesign.equations.grid import SCR_BASES
from vsgdesign.equations.power_flow import operating_point
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.linear.model.coupled import CoupledModel, coupled_model
from vsgdesign.linear.operating_point.full_order import Cell, FullOrderModel, linearise_full_order
from vsgdesign.linear.stability.margins import MarginTable, full_order_margins, reduced_margins
from vsgdesign.study.parameters.grid import Grid, Place
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

GainLaw = Callable[[Any, Any, Any, Any, Any], PowerLoopGains]
"""A function from arrays of the estimated R_g (Ω) and L_g (H) and of the P (W), Q (var) and V (phase rms, V) at the
control point to gains; NaN where there are none. :func:`vsgdesign.runtime.of_study.gain_law` gives the function of a
study's controller.
"""

OUTSIDE = "outside the limits"
"""The name of a cell beyond the converter's limits, on every page."""
NOT_ASKED = "not asked for"
"""How the reason of a cell begins that lies outside the box of the study's specification."""
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class CellSet:
    """N cells. ``faults`` contains for each cell the reason why it cannot be analysed, or None.

    Operating points are exact (P, Q) at the control point. ``V_rms`` and ``delta`` are NaN in faulty cells.
    ``outside`` contains for each cell the limit of the converter that its steady state exceeds, or why nobody asked
    for it (:func:`only_asked`), or None. Such a cell has values. It is not counted as a worst case, because the
    converter would not stay there, or because the study does not ask for this grid.
    """

    R_g: Array
    L_g: Array
    P: Array
    Q: Array
    V_rms: Array
    delta: Array
    gains: PowerLoopGains
    faults: tuple[str | None, ...]
    outside: tuple[str | None, ...]

    @property
    def good(self) -> NDArray[np.bool_]:
        """Which cells can be analysed."""
        return np.array([fault is None for fault in self.faults], dtype=bool)

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Which cells are within the converter's limits of voltage and current, and asked for."""
        return np.array([reason is None for reason in self.outside], dtype=bool)

    def take(self, index: NDArray[np.intp]) -> CellSet:
        """Some of the cells, in the given order."""
        gains = PowerLoopGains(*(value[index] for value in self.gains))
        faults, outside = (tuple(texts[k] for k in index) for texts in (self.faults, self.outside))
        return CellSet(
            R_g=self.R_g[index],
            L_g=self.L_g[index],
            P=self.P[index],
            Q=self.Q[index],
            V_rms=self.V_rms[index],
            delta=self.delta[index],
            gains=gains,
            faults=faults,
            outside=outside,
        )


NO_GAINS = "no gains: they are not numbers"


def cell_set(
    study: Study, R_g: Any, L_g: Any, P: Any, Q: Any, gains: PowerLoopGains, no_gains: str = NO_GAINS
) -> CellSet:
    """Cells of broadcast arrays of grids, powers and gains, each checked for an operating point and for gains.

    ``no_gains`` is the fault of a cell whose gains are NaN.
    """
    arrays = [np.asarray(value, dtype=float) for value in (R_g, L_g, P, Q, *gains)]
    R_g, L_g, P, Q, *rest = (np.array(a).ravel() for a in np.broadcast_arrays(*arrays))
    gains = PowerLoopGains(*rest)
    V_rms, delta = _operating_point(study, R_g, L_g, P, Q)
    has_gains = np.all([np.isfinite(value) for value in gains], axis=0)
    faults: list[str | None] = []
    for k in range(len(R_g)):
        if np.isnan(V_rms[k]):
            faults.append(
                f"no operating point: the grid cannot carry P = {P[k] / 1e3:.4g} kW, Q = {Q[k] / 1e3:.4g} kvar"
            )
        elif not has_gains[k]:
            faults.append(no_gains)
        else:
            faults.append(None)
    return CellSet(
        R_g=R_g,
        L_g=L_g,
        P=P,
        Q=Q,
        V_rms=V_rms,
        delta=delta,
        gains=gains,
        faults=tuple(faults),
        outside=tuple(_outside(study, P, Q, V_rms)),
    )


def cells_under(
    study: Study, law: GainLaw, R_g: Any, L_g: Any, P: Any, Q: Any, R_hat: Any = None, L_hat: Any = None
) -> CellSet:
    """Cells with the gains that a law gives in the steady state of each cell, at its P, Q and V.

    ``R_hat``, ``L_hat``: the grid that the law receives, if it is not the true one. All arrays are broadcast.
    """
    arrays = (R_g, L_g, P, Q, R_g if R_hat is None else R_hat, L_g if L_hat is None else L_hat)
    R_g, L_g, P, Q, R_hat, L_hat = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in arrays))
    V_rms, _ = _operating_point(study, R_g, L_g, P, Q)
    gains = law(R_hat, L_hat, P, Q, V_rms)
    return cell_set(study, R_g, L_g, P, Q, gains, getattr(law, "why_none", NO_GAINS))


def gains_in_force(
    study: Study,
    law: GainLaw,
    R_g: Any,
    L_g: Any,
    P: Any,
    Q: Any,
    *,
    error: tuple[float, float] = (0.0, 0.0),
    held: Grid | None = None,
) -> PowerLoopGains:
    """The gains that a controller has in the steady state of grids (broadcast arrays), wrongly estimated or held.

    ``error``: relative errors of R_g and L_g in the estimate that the law receives. ``held``: the grid whose gains are
    held. They are those of its own steady state at the same P and Q, with the same errors of its estimate, and remain
    in force on all of the grids.
    """
    R_g, L_g, P, Q = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in (R_g, L_g, P, Q)))
    R_made, L_made = (R_g, L_g) if held is None else (np.full(R_g.shape, held.R_g), np.full(R_g.shape, held.L_g))
    V_rms, _ = _operating_point(study, R_made, L_made, P, Q)
    return law(R_made * (1.0 + error[0]), L_made * (1.0 + error[1]), P, Q, V_rms)


def _operating_point(study: Study, R_g: Array, L_g: Array, P: Array, Q: Array) -> tuple[Array, Array]:
    """V and δ of every cell; NaN if the grid cannot carry P and Q."""
    R, X = study.filter.R_2 + R_g, study.grid_source.omega_g * (study.filter.L_2 + L_g)
    with np.errstate(invalid="ignore"):
        return operating_point(P, Q, study.grid_source.V_g_rms, R, X)


def _outside(study: Study, P: Array, Q: Array, V_rms: Array) -> list[str | None]:
    """The limits of the converter that each steady state exceeds: of the voltage at the capacitor, of its current."""
    c, f, omega = study.converter, study.filter, study.grid_source.omega_g
    low, high = c.V_limits_rms
    with np.errstate(invalid="ignore"):
        shunt = 1j * omega * f.C / (1.0 + 1j * omega * f.C * f.R_c)
        current_pu = rms_to_peak(np.abs(rated_current_rms(P - 1j * Q, V_rms) + shunt * V_rms)) / c.I_rated_pk
    found: list[str | None] = []
    for k, i in enumerate(current_pu):
        if V_rms[k] < low or V_rms[k] > high:
            found.append(f"V = {V_rms[k] / c.V_rated_rms:.3g} pu, allowed {c.V_min_pu:g} to {c.V_max_pu:g}")
        elif c.current_limit_pu is not None and i > c.current_limit_pu:
            found.append(f"current {i:.3g} pu, allowed {c.current_limit_pu:g}")
        else:
            found.append(None)
    return found


def only_asked(study: Study, cells: CellSet) -> CellSet:
    """The cells with a reason in ``outside`` where SCR, X/R, P or Q leave the box of the study's specification.

    The powers of a design point are asked for on every grid of the box: a design keeps its promises there, too.
    """
    asked = study.specification
    if asked is None:
        return cells
    c = study.converter
    scr = SCR_BASES[asked.scr_basis].scr(cells.R_g, cells.L_g, c.Z_base, c.omega_n)
    with np.errstate(divide="ignore"):
        x_over_r = c.omega_n * cells.L_g / cells.R_g
    limits = {"SCR": (scr, asked.scr, 1.0, ""), "X/R": (x_over_r, asked.x_over_r, 1.0, "")}
    limits |= {"P": (cells.P, asked.box.P, 1e3, " kW"), "Q": (cells.Q, asked.box.Q, 1e3, " kvar")}
    outside = list(cells.outside)
    targets = [study.target, *(spec.target for spec in study.controllers)]
    designed = np.any([(cells.P == target.P) & (cells.Q == target.Q) for target in targets], axis=0)
    for name, (values, allowed, unit, suffix) in limits.items():
        low, high = min(allowed), max(allowed)
        room = _ROUNDING * max(abs(low), abs(high))
        beyond = (values < low - room) | (values > high + room)
        for k in np.flatnonzero(beyond & ~designed if name in "PQ" else beyond):
            if outside[k] is None:
                said = f"{values[k] / unit:.4g} outside {low / unit:g} to {high / unit:g}{suffix}"
                outside[k] = f"{NOT_ASKED}: {name} {said}"
    return replace(cells, outside=tuple(outside))


def grid_arrays(study: Study, scr: Array, x_over_r: Array) -> tuple[Array, Array]:
    """R_g and L_g over scr (rows) × x_over_r (columns), on the study's SCR basis; shape (len(scr), len(x_over_r))."""
    grids = [[Place(float(s), float(x), study.scr_basis).grid(study.converter) for x in x_over_r] for s in scr]
    return np.array([[g.R_g for g in row] for row in grids]), np.array([[g.L_g for g in row] for row in grids])


def reduced_cells(study: Study, cells: CellSet, coupling: bool = True) -> CoupledModel:
    """The coupled reduced model of the cells without faults, in order."""
    good = cells.good
    R = study.filter.R_2 + cells.R_g[good]
    X = study.grid_source.omega_g * (study.filter.L_2 + cells.L_g[good])
    gains = PowerLoopGains(*(value[good] for value in cells.gains))
    return coupled_model(
        cells.delta[good],
        cells.V_rms[good],
        np.full(R.shape, study.grid_source.V_g_rms),
        R,
        X,
        gains,
        lags=study.power_lags,
        coupling=coupling,
    )


def full_order_cells(study: Study, cells: CellSet) -> FullOrderModel:
    """The full-order model of the cells without faults, with references that place each cell at its (P, Q) despite
    the droop.
    """
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


MODELS = ("reduced", "full_order")


@dataclass(frozen=True)
class MarginMap:
    """Margins over named axes. ``shape`` contains the lengths of the axes; :meth:`field` arranges a column of the
    table.

    ``faults`` contains for each cell (flat, row-major) None or the reason; faulty cells are NaN in every field.
    """

    model: str
    axes: tuple[tuple[str, Array], ...]
    cells: CellSet
    table: MarginTable
    analysed: NDArray[np.intp]
    """Flat index of each row of the table."""
    faults: tuple[str | None, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes."""
        return tuple(len(values) for _, values in self.axes)

    def field(self, values: NDArray) -> Array:
        """A column of the table (rows,) as an array over the axes, NaN where there is no row."""
        spread = np.full(len(self.faults), np.nan)
        spread[self.analysed] = values
        return spread.reshape(self.shape)

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Rows of the table whose cells are within the converter's limits and asked for; only these can be worst
        cases."""
        return self.cells.inside[self.analysed]

    @property
    def stable(self) -> Array:
        """1 if stable, 0 if not, and NaN if it is not known."""
        return self.field(self.table.stable)


def margin_map(
    study: Study,
    law: GainLaw,
    scr: Sequence[float],
    x_over_r: Sequence[float],
    P: Sequence[float],
    Q: Sequence[float],
    model: str = "reduced",
) -> MarginMap:
    """Margins over SCR × X/R × (P, Q) with the gains that a law gives in the steady state of each cell.

    The last axis contains the combinations of P (W) and Q (var), P slowest. ``model``: "reduced" (coupled, ideal
    inner loops) or "full_order" (sampled, complete).
    """
    scr_axis, ratio_axis = np.asarray(scr, dtype=float), np.asarray(x_over_r, dtype=float)
    P_box, Q_box = operating_box(P, Q)
    R_g, L_g = grid_arrays(study, scr_axis, ratio_axis)
    cells = cells_under(study, law, R_g[..., None], L_g[..., None], P_box, Q_box)
    axes = (("SCR", scr_axis), ("X/R", ratio_axis), ("P, Q", np.arange(len(P_box), dtype=float)))
    return _analyse(study, cells, axes, model)


def judged_map(study: Study, field: MarginMap) -> MarginMap:
    """A map whose cells count where the study's specification asks for them (:func:`only_asked`)."""
    return replace(field, cells=only_asked(study, field.cells))


def stale_schedule_matrix(
    study: Study, law: GainLaw, scr: Sequence[float], x_over_r: float, P: float, Q: float, model: str = "reduced"
) -> MarginMap:
    """True SCR (rows) × SCR that the law receives (columns), at one X/R and one operating point of the true grid."""
    axis = np.asarray(scr, dtype=float)
    R_g, L_g = (values[:, 0] for values in grid_arrays(study, axis, np.array([x_over_r])))
    cells = cells_under(study, law, R_g[:, None], L_g[:, None], P, Q, R_g[None, :], L_g[None, :])
    return _analyse(study, cells, (("true SCR", axis), ("SCR of the gains", axis)), model)


def estimate_error_map(
    study: Study,
    law: GainLaw,
    scr: Sequence[float],
    x_over_r: Sequence[float],
    errors: Sequence[float],
    P: float,
    Q: float,
    model: str = "reduced",
) -> MarginMap:
    """Margins of a schedule that receives R_g(1 + e_R) and L_g(1 + e_L): SCR × X/R × e_R × e_L.

    ``errors`` are relative, with sign; both estimates take each of them. P, Q and V are measured and are therefore
    those of the true grid.
    """
    scr_axis, ratio_axis = np.asarray(scr, dtype=float), np.asarray(x_over_r, dtype=float)
    e = np.asarray(errors, dtype=float)
    R_g, L_g = grid_arrays(study, scr_axis, ratio_axis)
    R_g, L_g = R_g[..., None, None], L_g[..., None, None]
    cells = cells_under(study, law, R_g, L_g, P, Q, R_g * (1.0 + e[:, None]), L_g * (1.0 + e[None, :]))
    axes = (("SCR", scr_axis), ("X/R", ratio_axis), ("error of R_g", e), ("error of L_g", e))
    return _analyse(study, cells, axes, model)


def _analyse(study: Study, cells: CellSet, axes: tuple[tuple[str, Array], ...], model: str) -> MarginMap:
    good = np.flatnonzero(cells.good)
    if model == "reduced":
        return MarginMap(model, axes, cells, reduced_margins(reduced_cells(study, cells)), good, cells.faults)
    if model != "full_order":
        raise ValueError(f'model = "{model}": must be one of {", ".join(MODELS)}')
    full = full_order_cells(study, cells)
    faults = list(cells.faults)
    for k, fault in zip(good, full.faults, strict=True):
        faults[k] = fault
    return MarginMap(model, axes, cells, full_order_margins(full), good[full.index], tuple(faults))
