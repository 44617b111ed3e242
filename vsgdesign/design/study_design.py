"""What is known of a study's controllers before a simulation: power flow, and closed forms and tables on its grids."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from vsgdesign.artifacts.ready import NOTHING, Ready, read_tables
from vsgdesign.design.power_flow import PowerFlow, power_flow
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES, effective_inertia
from vsgdesign.errors import InfeasibleStudyError, NoOperatingPointError
from vsgdesign.linear.operating_point import OperatingPoint, solve_operating_point
from vsgdesign.linear.stability.loops import LoopMargins, coupled_loop, loop_margins, power_loops
from vsgdesign.runtime.of_study import follows_measured, gain_law, schedule_of
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.study import ControllerSpec, Study


@dataclass(frozen=True, kw_only=True)
class ClosedFormDesign:
    """One controller's gains on one grid, the point they are designed at, and the loops' margins there.

    A controller that estimates the grid has the gains of the true one, one with a gain table those of its table.
    Margins are those of the paper's two loops for a structure that is designed without coupling, the published one;
    for the others, those of each loop with the other closed, coupling included.
    """

    controller: str
    grid: Grid
    point: OperatingPoint
    gains: PowerLoopGains
    margins_P: LoopMargins
    margins_Q: LoopMargins
    inertia_s: float
    """H that the grid sees (:eq:`effective-inertia`)."""

    @property
    def droop_W_per_Hz(self) -> float:
        """P–f droop."""
        return 2.0 * math.pi * self.gains.D_p


def distinct_grids(study: Study) -> tuple[Grid, ...]:
    """The grids of a study's scenario in order of appearance."""
    return tuple(dict.fromkeys([study.grid, *(event.grid for event in study.events if event.grid is not None)]))


def design_closed_form(study: Study, spec: ControllerSpec, grid: Grid, ready: Ready = NOTHING) -> ClosedFormDesign:
    """A controller on a grid of the scenario: scheduled gains are made for it, fixed ones for their own grid.

    Raises InfeasibleStudyError where the design point does not exist on a grid, or a table is not there.
    """
    table = ready.table(spec)
    structure = spec.target.structure if table is None else table.structure
    made_for = grid if spec.kind == "scheduled" else (spec.design_grid or study.grid)
    R, X = study.path_to_grid(grid)
    limits = study.converter.V_limits_rms
    try:
        if spec.gains is None and not follows_measured(spec):
            schedule_of(study, spec, ready).gains(made_for.R_g, made_for.L_g)  # says why there are none
        point = solve_operating_point(spec.target.P, spec.target.Q, study.grid_source.V_g_rms, R, X, limits)
        found = gain_law(study, spec, ready)(grid.R_g, grid.L_g, spec.target.P, spec.target.Q, point.V_rms)
        gains = PowerLoopGains(*(float(value) for value in found))
    except NoOperatingPointError as error:
        raise InfeasibleStudyError(f"controller {spec.name}: {error}") from error
    if STRUCTURES[structure].uncoupled:
        loops = power_loops(gains, point.A, point.D)
        open_P, open_Q = loops.P_open, loops.Q_open
    else:
        source, transient = study.grid_source.V_g_rms, study.power_lags._replace(tau_P=0.0, tau_Q=0.0)
        open_P, open_Q = (coupled_loop(point, gains, source, (R, X), transient, loop=k) for k in (0, 1))
    c = study.converter
    inertia = float(effective_inertia(gains, c.S_rated, c.omega_n))
    return ClosedFormDesign(
        controller=spec.name,
        grid=grid,
        point=point,
        gains=gains,
        margins_P=loop_margins(open_P),
        margins_Q=loop_margins(open_Q),
        inertia_s=inertia,
    )


@dataclass(frozen=True)
class StudyDesign:
    """What is known of a study's controllers before a simulation."""

    study: Study
    ready: Ready
    """The gain tables that are there."""
    flows: tuple[PowerFlow, ...]
    designs: tuple[ClosedFormDesign, ...]
    """Of every controller that has gains, on every grid of the scenario."""
    missing: tuple[str, ...]
    """One sentence on each controller whose gain table is not there."""

    def document(self) -> dict[str, Any]:
        """Everything, in JSON's types."""
        return {
            "study": self.study.name,
            "hash": self.study.hash,
            "power_flow": [flow.document() for flow in self.flows],
            "designs": [
                asdict(d) | {"gains": d.gains.named(), "inertia_s": d.inertia_s, "droop_W_per_Hz": d.droop_W_per_Hz}
                for d in self.designs
            ],
            "missing": list(self.missing),
        }


def design_study(study: Study) -> StudyDesign:
    """The power flow of every controller, and its gains on every grid of the scenario. Raises InfeasibleStudyError."""
    ready = Ready(tables=read_tables(study))
    known = [spec for spec in study.controllers if spec.schedule != "table" or spec.name in ready.tables]
    missing = [
        f"{spec.name}: its gain table is not built yet. vsgdesign run builds it, vsgdesign table build keeps it."
        for spec in study.controllers
        if spec not in known
    ]
    if study.dc is not None and study.dc.droops:
        missing.append(
            "A droop of the link's voltage has no closed form: the gains are made as for an ideal link. margins and "
            "simulate have this voltage as a state."
        )
    flows = [power_flow(study, spec, ready) for spec in study.controllers]
    designs = [design_closed_form(study, spec, grid, ready) for spec in known for grid in distinct_grids(study)]
    return StudyDesign(study, ready, tuple(flows), tuple(designs), tuple(missing))
