"""The scene that a state of the page describes: the study with its source, and the gains of each shown controller."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vsgdesign.artifacts.gain_table import base_differences, base_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.scheduler_data import CLAMPED, FRESH, HELD
from vsgdesign.errors import InfeasibleStudyError, NoOperatingPointError
from vsgdesign.linear.stability.cells import NO_GAINS, CellSet, cell_set, gains_in_force
from vsgdesign.report.explore.state import OWN, State
from vsgdesign.runtime.guards import STATUSES
from vsgdesign.runtime.of_study import ControllerGains, gain_law
from vsgdesign.runtime.table import TableSchedule
from vsgdesign.study.parameters.grid import Grid, Place
from vsgdesign.study.parameters.study import ControllerSpec, Study


@dataclass(frozen=True, kw_only=True)
class Shown:
    """One controller that is shown."""

    name: str
    spec: ControllerSpec
    study: Study
    """The study of the scene with this controller's own current limit."""
    law: ControllerGains | None
    """Its gains as a function of the grid and the operating point; None if it has none."""
    why: str | None = None
    """Why there is no law."""
    note: str | None = None
    """What has to be known to read its figures."""

    def status(self, grid: Grid, held: bool, error: tuple[float, float]) -> str:
        """What its schedule does in the steady state on a grid: ``fixed``, ``held``, ``fresh``, or ``clamped`` where a
        table is asked for a place outside its box (:data:`vsgdesign.runtime.guards.STATUSES`)."""
        if self.spec.kind == "fixed":
            return "fixed"
        if held:
            return STATUSES[HELD]
        law = self.law
        if law is None or law.settings is None or not isinstance(law.schedule, TableSchedule):
            return STATUSES[FRESH]
        told = grid.R_g * (1.0 + error[0]), grid.L_g * (1.0 + error[1])
        drawn = law.schedule.drawn_to(*told, law.settings.scr, law.settings.r_over_x)[:2]
        return STATUSES[FRESH if np.allclose(drawn, told, rtol=1e-6) else CLAMPED]


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What all answers to one state begin with."""

    study: Study
    """With the voltage and the frequency of the state's source."""
    grid: Grid
    held: Grid | None
    """The grid whose gains are held; None if they follow the grid."""
    P: float
    Q: float
    """W and var at the control point."""
    error: tuple[float, float]
    """Relative errors of R_g and L_g in the estimate."""
    shown: tuple[Shown, ...]
    cells: CellSet
    """One cell for each shown controller: the grid, the operating point, and its gains in force."""


def scene_of(study: Study, ready: Ready, state: State) -> Scene:
    """The scene of a state. ``study`` has the state's changes already, and ``ready`` contains its tables."""
    return scenes_of(study, ready, [state])[0]


def scenes_of(study: Study, ready: Ready, states: Sequence[State]) -> list[Scene]:
    """The scenes of states that differ in their grid alone."""
    state = states[0]
    study = at_source(study, state)
    c = study.converter
    grids = [Place(one.scr, one.x_over_r, study.scr_basis).grid(c) for one in states]
    held = held_grid(study, state)
    P, Q = state.P_pu * c.S_rated, state.Q_pu * c.S_rated
    shown, error = shown_of(study, ready, state), (state.error_R, state.error_X)
    R_g, L_g = np.array([(grid.R_g, grid.L_g) for grid in grids]).T
    parts = [_cells(one, R_g, L_g, held, P, Q, error) for one in shown]
    return [
        Scene(study=study, grid=grid, held=held, P=P, Q=Q, error=error, shown=shown, cells=_together(study, parts, k))
        for k, grid in enumerate(grids)
    ]


def references_of(study: Study, cells: CellSet) -> tuple[np.ndarray, np.ndarray]:
    """P_ref (W) and Q_ref (var), (N,) each, that put each cell at its powers in spite of its droops, as
    :func:`vsgdesign.simulation.steps.references_at` says for one."""
    c, gains = study.converter, cells.gains
    P_ref = cells.P - gains.D_p * (c.omega_n - study.grid_source.omega_g)
    return P_ref, cells.Q - gains.D_q * (c.V_rated_rms - cells.V_rms)


def held_grid(study: Study, state: State) -> Grid | None:
    """The grid whose gains are held, or None."""
    hold = state.hold
    return None if hold is None else Place(hold.scr, hold.x_over_r, study.scr_basis).grid(study.converter)


def at_source(study: Study, state: State) -> Study:
    """The study with the voltage and the frequency of the state's source."""
    source = replace(
        study.grid_source, V_g_rms=state.V_g_pu * study.converter.V_rated_rms, omega_g=2.0 * math.pi * state.f_hz
    )
    return study if source == study.grid_source else replace(study, grid_source=source)


def shown_of(study: Study, ready: Ready, state: State) -> tuple[Shown, ...]:
    """The controllers of a state, each with its law or with the reason why it has none."""
    found = []
    for spec in study.controllers:
        if spec.name in state.controllers:
            law, why = _law(study, spec, ready)
            found.append(
                Shown(
                    name=spec.name,
                    spec=spec,
                    study=study.with_limit_of(spec),
                    law=law,
                    why=why,
                    note=None if law is None else _note(study, spec, ready),
                )
            )
    # A controller of the study that has this name itself is the one that is meant.
    if OWN in state.controllers and state.own is not None and all(one.name != OWN for one in found):
        spec = ControllerSpec(name=OWN, kind="fixed", target=study.target, gains=state.own)
        found.append(Shown(name=OWN, spec=spec, study=study, law=gain_law(study, spec)))
    return tuple(found)


def _law(study: Study, spec: ControllerSpec, ready: Ready) -> tuple[ControllerGains | None, str | None]:
    try:
        return gain_law(study, spec, ready), None
    except (InfeasibleStudyError, NoOperatingPointError) as error:
        return None, str(error)


def _note(study: Study, spec: ControllerSpec, ready: Ready) -> str | None:
    """In what the study differs from the one for which a controller's table was designed."""
    table = ready.table(spec)
    if table is None:
        return None
    differences = base_differences(table.base, base_of(study, table.base.scr_basis), "the study")
    if not differences:
        return None
    return f"The table was designed for other data, and its gains are not changed: {'; '.join(differences)}."


def _cells(
    one: Shown, R_g: np.ndarray, L_g: np.ndarray, held: Grid | None, P: float, Q: float, error: tuple[float, float]
) -> CellSet:
    """A controller on several grids."""
    study = one.study
    if one.law is None:
        nothing = PowerLoopGains(*(np.nan,) * len(PowerLoopGains._fields))
        return cell_set(study, R_g, L_g, P, Q, nothing, one.why or NO_GAINS)
    gains = gains_in_force(study, one.law, R_g, L_g, P, Q, error=error, held=held)
    return cell_set(study, R_g, L_g, P, Q, gains, one.law.why_none)


def _together(study: Study, parts: list[CellSet], k: int) -> CellSet:
    """The k-th cell of every controller."""
    if not parts:
        none = np.empty(0)
        return cell_set(study, none, none, none, none, PowerLoopGains(*[none] * len(PowerLoopGains._fields)))
    return joined_cells([(part, k) for part in parts])


def joined_cells(cells: Sequence[tuple[CellSet, int]]) -> CellSet:
    """Some cells of several sets, one after another."""
    names = ("R_g", "L_g", "P", "Q", "V_rms", "delta")
    arrays = {name: np.array([getattr(own, name)[k] for own, k in cells]) for name in names}
    gains = np.array([[values[k] for values in own.gains] for own, k in cells]).T
    faults, outside = (tuple(getattr(own, name)[k] for own, k in cells) for name in ("faults", "outside"))
    return CellSet(**arrays, gains=PowerLoopGains(*gains), faults=faults, outside=outside)
