"""What is known of a study's controllers before a simulation: closed forms and tables on its grids, and the power flow:
where a controller rests with its droops, over grids and powers, and what limits."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready, read_tables
from vsgdesign.equations.frames import peak_to_rms
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.structures import STRUCTURES, effective_inertia
from vsgdesign.errors import InfeasibleStudyError, NoOperatingPointError
from vsgdesign.linear.operating_point import OperatingPoint, solve_operating_point
from vsgdesign.linear.operating_point.equilibrium import static_limit_uses
from vsgdesign.linear.operating_point.many import (
    BRIDGE_VOLTAGE,
    CURRENT,
    FAULTS,
    LIMITER_ACTS,
    LIMITER_PULLS,
    NO_POINT,
    Lanes,
)
from vsgdesign.linear.operating_point.many_rests import GainsOfMany, many_rests_with_measured_gains
from vsgdesign.linear.stability.loops import LoopMargins, coupled_loop, loop_margins, power_loops
from vsgdesign.runtime.of_study import follows_measured, gain_law, schedule_of
from vsgdesign.study.parameters.grid import Grid, Place
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

_LIMITING = {
    NO_POINT: "power transfer",
    BRIDGE_VOLTAGE: "bridge voltage",
    CURRENT: "current",
    LIMITER_ACTS: "current",
    LIMITER_PULLS: "limiter's voltage",
}
"""The limit that a fault of a rest stands for."""


class FlowAxes(NamedTuple):
    """What a power flow is computed for: every combination of these."""

    scr_basis: str
    scr: tuple[float, ...]
    x_over_r: tuple[float, ...]
    P_ref: tuple[float, ...]
    """W."""
    Q_ref: tuple[float, ...]
    """var."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """SCR, X/R, and all powers of a grid."""
        return len(self.scr), len(self.x_over_r), len(self.P_ref) * len(self.Q_ref)


@dataclass(frozen=True, kw_only=True)
class PowerFlow:
    """Rests of one controller on N combinations of its axes, with the source at its nominal values.

    All arrays are (N,), and NaN where there is no rest.
    """

    controller: str
    axes: FlowAxes
    scr: Array
    x_over_r: Array
    P_ref: Array
    Q_ref: Array
    P: Array
    """W, at the filter's capacitor, as ``Q`` (var) and ``V_rms`` (phase)."""
    Q: Array
    V_rms: Array
    I_rms: Array
    """Through the converter-side inductor, A rms."""
    modulation_index: Array
    """The bridge's voltage over V_dc/2."""
    modulation_margin: Array
    """What is left of the bridge's largest voltage, as a share of it."""
    used: Array
    """Share that the rest uses of the limit nearest to it (:eq:`static-limits`); NaN without a rest."""
    limit: tuple[str, ...]
    """The name of this limit, or what prevents a rest."""
    obstacle: tuple[str, ...]
    """Why the converter cannot stay there; empty where it can."""

    @property
    def possible(self) -> NDArray[np.bool_]:
        """Where the converter can stay."""
        return np.array([not one for one in self.obstacle])

    def document(self) -> dict[str, Any]:
        """All of it in JSON's types, one list of N entries for each quantity."""
        lists = {name: getattr(self, name) for name in FIELDS}
        return {"controller": self.controller, "scr_basis": self.axes.scr_basis, **lists}


FIELDS = (
    *("scr", "x_over_r", "P_ref", "Q_ref", "P", "Q", "V_rms", "I_rms"),
    *("modulation_index", "modulation_margin", "used", "limit", "obstacle"),
)
"""The columns of a power flow."""


def flow_axes(study: Study) -> FlowAxes:
    """The grids and powers that a study asks for: its specification's, else the axes of its [stability]. Of a range of
    powers, its ends and zero between them."""
    asked = study.specification
    if asked is None:
        s = study.stability
        return FlowAxes(study.scr_basis, s.scr, s.x_over_r, s.P, s.Q)
    return FlowAxes(asked.scr_basis, asked.scr, asked.x_over_r, _ends(asked.box.P), _ends(asked.box.Q))


def _ends(values: Sequence[float]) -> tuple[float, ...]:
    low, high = min(values), max(values)
    return tuple(sorted({low, high} | ({0.0} if low < 0.0 < high else set())))


def power_flow(study: Study, spec: ControllerSpec, ready: Ready = NOTHING, axes: FlowAxes | None = None) -> PowerFlow:
    """The rests of a controller with both of its droops and its gains, and the limit that is nearest to each.

    A controller whose gain table is not there has the droops of this table, which are known before its design. Raises
    the errors of :func:`vsgdesign.runtime.of_study.gain_law`.
    """
    study, axes = study.with_limit_of(spec), axes or flow_axes(study)
    c, source = study.converter, study.grid_source
    combined = np.array(list(itertools.product(*axes[1:]))).T
    places = [Place(float(scr), float(x_over_r), axes.scr_basis).grid(c) for scr, x_over_r in combined[:2].T]
    R_g, L_g = np.array([[grid.R_g, grid.L_g] for grid in places]).T
    lanes = Lanes(R_g, L_g, source.V_g_rms, source.omega_g, combined[2], combined[3])
    states, _ = many_rests_with_measured_gains(study, lanes, _gains_of(study, spec, ready, R_g, L_g))
    X = source.omega_g * (study.filter.L_2 + L_g)
    uses = static_limit_uses(study, study.filter.R_2 + R_g, X, source.omega_g, states.P, states.Q, states.V)
    shares = np.array(list(uses.values()))
    nearest = np.argmax(np.where(np.isnan(shares), -np.inf, shares), axis=0)
    used, names = shares[nearest, np.arange(len(nearest))], list(uses)
    limit, obstacle = [], []
    for fault, k, share in zip(states.fault.tolist(), nearest.tolist(), used.tolist(), strict=True):
        beyond = "" if not share > 1.0 else f"beyond the limit of the {names[k]}"
        limit.append(_LIMITING.get(fault, FAULTS[fault]) if fault else names[k])
        obstacle.append(FAULTS[fault] or beyond)
    return PowerFlow(
        controller=spec.name,
        axes=axes,
        scr=combined[0],
        x_over_r=combined[1],
        P_ref=combined[2],
        Q_ref=combined[3],
        P=states.P,
        Q=states.Q,
        V_rms=states.V,
        I_rms=peak_to_rms(states.i_s_pk),
        modulation_index=states.v_b_pk / (0.5 * c.V_dc),
        modulation_margin=1.0 - states.v_b_pk / c.v_max_pk,
        used=used,
        limit=tuple(limit),
        obstacle=tuple(obstacle),
    )


def _gains_of(study: Study, spec: ControllerSpec, ready: Ready, R_g: Array, L_g: Array) -> GainsOfMany:
    """The gains at measured P, Q and V; of a table that is not there those with its droops, which decide a rest."""
    if spec.schedule == "table" and spec.name not in ready.tables:
        c, target = study.converter, spec.target
        structure = STRUCTURES[target.structure]
        if structure.P_droop and structure.Q_droop:
            droops = structure.rated_droops(target.P_droop, target.Q_droop, c.S_rated, c.omega_n, c.V_rated_rms)
            constant = PowerLoopGains(0.0, droops[0], 0.0, droops[1])
            return lambda P, _Q, _V: PowerLoopGains(*(np.full(P.shape, value) for value in constant))
        spec = replace(spec, schedule="closed_form")
    law = gain_law(study, spec, ready)
    return lambda P, Q, V: law(R_g, L_g, P, Q, V)


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
