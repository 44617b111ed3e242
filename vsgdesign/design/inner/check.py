"""Designed inner loops held against the full order: with power loops, at operating points, on a lattice of grids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsgdesign.design.inner.grids import GridBox, GridPoint, lattice
from vsgdesign.design.inner.system import angle_damped_target, study_of
from vsgdesign.equations.inner_loops import InnerLoopGains
from vsgdesign.metrics.modes import damping_ratio, to_continuous
from vsgdesign.operating_point.full_order import Cell, linearise_full_order
from vsgdesign.parameters.converter import Converter, Filter
from vsgdesign.parameters.grid import Place
from vsgdesign.parameters.study import ClosedFormTarget
from vsgdesign.runtime.closed_form import closed_form_schedule

CHECKED = (7, 7)
"""SCR × X/R of the check."""
POWERS_PU = (-0.5, 0.1, 0.7)
"""Active powers of the check over the rated one, reactive power zero."""


@dataclass(frozen=True, kw_only=True)
class FullOrderCheck:
    """The full-order model with the power loops closed, over grids × powers.

    A cell without a steady state (the grid cannot carry the power, or a limit is in the way) is not analysed: no inner
    gains help it.
    """

    cells: int
    analysed: int
    stable: int
    grids: int
    stable_grids: int
    """Grids with a cell that was analysed, and those of them whose every analysed cell is stable."""
    damping: float
    """Least damping ratio of all modes of all analysed cells."""
    scr: float
    x_over_r: float
    P: float
    """W; where that is."""

    @property
    def passed(self) -> bool:
        """Whether something was analysed and all of it is stable."""
        return 0 < self.analysed == self.stable


def check_full_order(
    converter: Converter,
    filter_: Filter,
    gains: InnerLoopGains,
    omega_t: float,
    box: GridBox,
    *,
    target: ClosedFormTarget | None = None,
    settling_time: float = 1.0,
    grids: Sequence[GridPoint] | None = None,
    powers_pu: Sequence[float] = POWERS_PU,
) -> FullOrderCheck:
    """Modes of the sampled full-order model (:eq:`sampled-map`) with closed-form power loops that know the grid.

    ``target`` None: the angle-damped closed form for ``settling_time`` s. ``grids`` None: a lattice over the box.
    """
    target = target or angle_damped_target(settling_time)
    study = study_of(converter, filter_, gains, omega_t, box, target=target)
    points = lattice(box, *CHECKED) if grids is None else tuple(grids)
    requested, where = [], []
    for scr, x_over_r in points:
        grid = Place(scr, x_over_r, box.basis).grid(converter)
        for share in powers_pu:
            P = share * converter.S_rated
            power_gains = closed_form_schedule(study, target, P, 0.0).gains_over(
                np.array([grid.R_g]), np.array([grid.L_g])
            )
            values = type(power_gains)(*(float(np.ravel(value)[0]) for value in power_gains))
            if all(np.isfinite(value) for value in values):
                requested.append(Cell(grid, values, P, 0.0))
                where.append((scr, x_over_r, P))
    model = linearise_full_order(study, requested)
    at = [where[k] for k in model.index]
    s = to_continuous(np.linalg.eigvals(model.A) if len(at) else np.ones((0, 1)), model.T_s)
    stable, damping = s.real.max(axis=1) < 0.0, damping_ratio(s).min(axis=1)
    seen = {place[:2] for place in at}
    lost = {place[:2] for place, good in zip(at, stable, strict=True) if not good}
    worst = int(np.argmin(damping)) if len(at) else -1
    scr, x_over_r, P = at[worst] if at else (float("nan"),) * 3
    return FullOrderCheck(
        cells=len(points) * len(powers_pu),
        analysed=len(at),
        stable=int(stable.sum()),
        grids=len(seen),
        stable_grids=len(seen - lost),
        damping=float(damping[worst]) if at else float("nan"),
        scr=scr,
        x_over_r=x_over_r,
        P=P,
    )
