"""The event that the page shows, as the events of a study file say it: the study of each shown controller's EMT run."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from vsgdesign.artifacts.ready import Ready
from vsgdesign.equations.power_loops import PowerLoopGains
from vsgdesign.metrics.survival import GRACE_S, SETTLING_TIMES, WATCHED
from vsgdesign.report.explore.scene import Scene, Shown
from vsgdesign.report.explore.state import EventOfState, State
from vsgdesign.simulation.steps import references_at
from vsgdesign.simulation.survival.demand import settling_time_of
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.event_kinds import EVENT_KINDS
from vsgdesign.study.parameters.grid import GridEstimate, Place
from vsgdesign.study.parameters.study import UPDATE_PERIOD, ControllerSpec, Study

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


def events_of(study: Study) -> list[dict[str, Any]]:  # noqa: ARG001 - as the session calls it
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
