"""Each controller's open P loop on each grid of the scenario, with its classical margins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES
from vsgdesign.errors import NoOperatingPointError
from vsgdesign.operating_point import solve_operating_point
from vsgdesign.parameters import Grid
from vsgdesign.report.page.converter import grid_label
from vsgdesign.runtime.of_study import gain_law
from vsgdesign.simulation import ControllerResult, ScenarioResult
from vsgdesign.simulation.feeds import as_told
from vsgdesign.stability.loops import LoopMargins, coupled_loop, loop_margins, power_loops


@dataclass(frozen=True, kw_only=True)
class LoopOnGrid:
    """The open P loop of one controller on one grid, at the operating point of the controller's design."""

    label: str
    Z_ohm: float
    P: float
    Q: float
    gains: PowerLoopGains
    numerator: NDArray[np.float64]
    denominator: NDArray[np.float64]
    margins: LoopMargins

    @property
    def corner_rad_s(self) -> float:
        """The loop's fastest corner; K_ip·D_p for the published structure."""
        return float(np.abs(np.roots(self.denominator)).max())

    def response(self, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Frequency response at angular frequencies in rad/s."""
        s = 1j * omega
        return np.polyval(self.numerator, s) / np.polyval(self.denominator, s)


def distinct_grids(result: ScenarioResult) -> tuple[Grid, ...]:
    """Every grid of the scenario once, in order of appearance."""
    return tuple(dict.fromkeys(grid for _, grid in result.timeline.grids))


def loops_on_grids(result: ScenarioResult, controller: ControllerResult) -> tuple[LoopOnGrid, ...]:
    """The loops on all grids that can carry the power of the controller's design."""
    study, target = result.study, controller.spec.target
    law = as_told(gain_law(study, controller.spec, result.ready), controller.spec)
    loops = []
    for grid in distinct_grids(result):
        R, X = study.path_to_grid(grid)
        try:
            point = solve_operating_point(target.P, target.Q, study.grid_source.V_g_rms, R, X)
        except NoOperatingPointError:
            continue
        at_point = law(grid.R_g, grid.L_g, target.P, target.Q, point.V_rms)
        gains = PowerLoopGains(*(float(value) for value in at_point))
        if not np.isfinite(gains).all():
            continue
        # Beyond A = 0 the loop has positive feedback: it has no margin to speak of.
        if point.A <= 0.0:
            continue
        if STRUCTURES[target.structure].uncoupled:
            open_loop = power_loops(gains, point.A, point.D).P_open
        else:
            open_loop = coupled_loop(point, gains, study.grid_source.V_g_rms, R, X, loop=0)
        numerator, denominator = (np.trim_zeros(np.ravel(part[0][0]), "f") for part in (open_loop.num, open_loop.den))
        loops.append(
            LoopOnGrid(
                label=grid_label(result, grid),
                Z_ohm=float(np.hypot(R, X)),
                P=target.P,
                Q=target.Q,
                gains=gains,
                numerator=numerator,
                denominator=denominator,
                margins=loop_margins(open_loop),
            )
        )
    return tuple(loops)
