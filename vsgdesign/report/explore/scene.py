"""What a state of the page describes: the study with its source, the gains of each shown controller, and its event as
the events of a study file say it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vsgdesign.artifacts.gain_table import base_differences, base_of
from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.equations.scheduler_data import CLAMPED, FRESH, HELD
from vsgdesign.errors import InfeasibleStudyError, NoOperatingPointError
from vsgdesign.linear.stability.maps import NO_GAINS, CellSet, cell_set, gains_in_force
from vsgdesign.metrics.survival import GRACE_S, SETTLING_TIMES, WATCHED
from vsgdesign.report.explore.state import OWN, EventOfState, State
from vsgdesign.runtime.guards import STATUSES
from vsgdesign.runtime.of_study import ControllerGains, gain_law
from vsgdesign.runtime.table import TableSchedule
from vsgdesign.simulation.steps import references_at
from vsgdesign.simulation.survival.cases import settling_time_of
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.grid import Grid, GridEstimate, Place
from vsgdesign.study.parameters.study import UPDATE_PERIOD, ControllerSpec, Study


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


LEAD_S = 0.1
"""The run is at rest for about this long before its event, s."""

SHOWN_S = 2.0
"""Least time that is simulated after the event is over, s."""

_LABELS = {
    "step": ("step of a reference", "pu", -0.5, 0.5, 0.01, 0.05),
    "grid": ("jump to another grid", "", 0.0, 0.0, 1.0, 0.0),
    "phase": ("phase jump", "deg", -60.0, 60.0, 1.0, 20.0),
    "sag": ("voltage sag", "pu", 0.0, 0.95, 0.05, 0.5),
    "ramp": ("frequency ramp", "Hz", -2.0, 2.0, 0.05, -0.5),
}

NAMES = {
    "step": "step of {}_ref by {:+.3g} pu",
    "grid": "SCR {:.3g}, X/R {:.3g}",
    "phase": "phase {:+.3g}°",
    "sag": "V_g {:.3g} pu",
    "ramp": "{:+.3g} Hz over {:.3g} s",
}
"""What an event is called in a study file."""
STEP_NAME = "{} by {} {}"
"""The same of a step of another set point: its label, its size and the unit."""


def events_of() -> list[dict[str, Any]]:
    """The kinds of events with the limits of their sizes, as the page lists them."""
    names = ("label", "unit", "low", "high", "step", "value")
    steps = {
        name: (step.label, step.unit, -step.most, step.most, 0.02 * step.most, step.size[1])
        for name, (_, step) in EVENT_KINDS.explored.items()
    }
    return [{"kind": kind, **dict(zip(names, row, strict=True))} for kind, row in (_LABELS | steps).items()]


def study_of(scene: Scene, ready: Ready, state: State, k: int) -> Study:
    """The study whose run :func:`vsgdesign.simulation.scenario.run_scenario` gives the page's EMT of the ``k``-th shown
    controller: this controller alone, from the state's grid and powers through its event.

    The references are those that put this controller at the state's powers in spite of its droops. The bridge is that
    of the session; the source is sinusoidal, and the sensors are ideal. Only a controller with gains can be asked for.
    """
    gains = PowerLoopGains(*(float(values[k]) for values in scene.cells.gains))
    own, spec = scene.shown[k].study, run_spec(scene, ready, state, k)
    P_ref, Q_ref = references_at(own, scene.grid, gains, scene.P, scene.Q)
    lead_s, over_s = event_s(own), length_s(state.event)
    source = replace(own.grid_source, components=())
    calm = replace(own.undisturbed, survival=own.survival)  # with its protection
    study = replace(calm, grid=scene.grid, grid_source=source, controllers=(spec,))
    simulation = replace(
        own.simulation,
        duration=_whole(lead_s + over_s + after_s(scene, ready, state), own.simulation.log_interval),
        start="steady_state",
        P_ref=P_ref,
        Q_ref=Q_ref,
        survival=state.event.kind != "step",
    )
    return replace(study, simulation=simulation, events=events_at(study, state.event, lead_s, P_ref, Q_ref))


def run_spec(scene: Scene, ready: Ready, state: State, k: int) -> ControllerSpec:
    """The ``k``-th shown controller as it runs: with what it knows of the grid, or with its held gains."""
    gains = PowerLoopGains(*(float(values[k]) for values in scene.cells.gains))
    return told_spec(scene.shown[k], ready, state, gains)


def told_spec(one: Shown, ready: Ready, state: State, gains: PowerLoopGains) -> ControllerSpec:
    """A shown controller with what it knows of the grid, or with ``gains`` where they are fixed or held.

    A controller that has an estimator of its own is told the grid instead, with the state's errors and silence.
    """
    spec = one.spec
    if state.hold is not None or spec.kind == "fixed":
        return replace(
            spec, kind="fixed", gains=gains, schedule="closed_form", table_file=None, estimate="truth", knowledge=None
        )
    known = GridEstimate(error_R=state.error_R, error_X=state.error_X, silent_s=state.silent_s)
    period = ready.update_period(spec) or UPDATE_PERIOD
    return replace(spec, estimate="truth", update_period=period, knowledge=None if known == GridEstimate() else known)


def event_s(study: Study) -> float:
    """When the event begins, s of the run: at a row of its log."""
    return _whole(LEAD_S, study.simulation.log_interval)


def length_s(event: EventOfState) -> float:
    """Time from the beginning of an event until it is over, s."""
    return event.length_s if event.kind in ("sag", "ramp") else 0.0


def after_s(scene: Scene, ready: Ready, state: State) -> float:
    """Time that is simulated after the event is over, s: for a verdict on survival what the slowest target needs."""
    if state.event.kind == "step":
        return SHOWN_S
    T = max(settling_time_of(one.spec, ready) for one in scene.shown if one.law is not None)
    return max(SHOWN_S, (SETTLING_TIMES + WATCHED) * T + GRACE_S + 2.0 / state.f_hz)


def samples_of_step(study: Study) -> int:
    """The samples from a step of a reference to the end of its run."""
    lead_s, T_s = event_s(study), study.converter.T_s
    return round(_whole(lead_s + SHOWN_S, study.simulation.log_interval) / T_s) - round(lead_s / T_s)


def _whole(t_s: float, interval: float) -> float:
    return max(math.ceil(t_s / interval - 1e-6), 1) * interval


def events_at(study: Study, event: EventOfState, t_s: float, P_ref: float, Q_ref: float) -> tuple[Event, ...]:
    """The page's event as events of a study. ``P_ref`` and ``Q_ref``: the references before it, W and var."""
    c, source = study.converter, study.grid_source
    if event.kind == "step":
        name = NAMES["step"].format(event.signal, event.size)
        size = event.size * c.S_rated
        if event.signal == "P":
            return (Event(t_s, name, P_ref=P_ref + size),)
        return (Event(t_s, name, Q_ref=Q_ref + size),)
    if event.kind in EVENT_KINDS.explored:
        kind, step = EVENT_KINDS.explored[event.kind]
        name = STEP_NAME.format(step.label, f"{event.size:+.3g}", step.unit)
        return (replace(Event(t_s, name), **{kind.quantity: step.value(event.size, c)}),)
    if event.kind == "grid":
        place = Place(event.to_scr, event.to_x_over_r, study.scr_basis)
        return (Event(t_s, NAMES["grid"].format(event.to_scr, event.to_x_over_r), grid=place.grid(c)),)
    if event.kind == "phase":
        return (Event(t_s, NAMES["phase"].format(event.size), phase_jump=math.radians(event.size)),)
    if event.kind == "sag":
        V = (1.0 - event.size) * source.V_g_rms
        return (
            Event(t_s, NAMES["sag"].format(V / c.V_rated_rms), V_g_rms=V),
            Event(t_s + event.length_s, NAMES["sag"].format(source.V_g_rms / c.V_rated_rms), V_g_rms=source.V_g_rms),
        )
    omega = source.omega_g + 2.0 * math.pi * event.size
    return (Event(t_s, NAMES["ramp"].format(event.size, event.length_s), omega_g=omega, over=event.length_s),)
