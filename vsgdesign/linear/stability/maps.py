"""Maps over grids: margins in every cell, the stale-schedule matrix, margin against estimate error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.linear.stability.cells import (
    CellSet,
    GainLaw,
    cells_under,
    full_order_cells,
    grid_arrays,
    only_asked,
    operating_box,
    reduced_cells,
)
from vsgdesign.linear.stability.margins import MarginTable, full_order_margins, reduced_margins
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

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
