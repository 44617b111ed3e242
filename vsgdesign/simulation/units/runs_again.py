"""Runs of a plant that are made again: with the closing of a breaker as an event, and without a step.

Units join the others when both sides of their breakers are near each other (:eq:`synchro-check`). The instant is not
known beforehand. A run with the breaker open says when the relay closes it; nothing before that instant depends on it,
so the run is made again with the closing as an event.

The twin of a step is the same run without it, with which noise is told from motion (:eq:`twin`). It has the same
source, the same noise of the sensors, the same gains, the same probes and the same grids for the limiters. It is
simulated from the start, with what the estimators of the units did in the run.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import GridWatch
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.sample import Relay, relay_sees
from vsgdesign.simulation.search import LONGEST_S
from vsgdesign.simulation.twin import steps_with_twin
from vsgdesign.simulation.units.run import PlantRun, UnitRun, simulate_plant
from vsgdesign.simulation.units.timeline import plant_timeline
from vsgdesign.simulation.units.windows import Schedule, Tape
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.network_fields import NOTHING_SAID
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]

NEVER = "the breaker never closes"

_SETTLES_S = 0.3
"""For so long the relay follows both voltages before it may close, s."""

_LOOK_S = 2e-4
"""How often it looks, s."""


def waiting(study: Study) -> Event | None:
    """The first event of a plant whose breaker waits to close."""
    return next((event for event in study.events if event.synchro_check is not None), None)


def joined(study: Study, event: Event, run: PlantRun) -> Study:
    """The study with the closing of a breaker as an event at the instant that a run says, or with a name that says that
    it never closes. ``run``: with the breaker open. Raises InfeasibleStudyError where no other unit is at the node."""
    found = next(_closings(event, run), None)
    if found is None:
        closing = replace(event, name=f"{event.name}: {NEVER}", synchro_check=None, switched=NOTHING_SAID)
    else:
        t_s, lead = found
        name = f"{event.element}: breaker closes at {math.degrees(lead):+.2g}°"
        closing = replace(event, t_s=t_s, name=name, synchro_check=None)
    events = [closing if one is event else one for one in study.events]
    return replace(study, events=tuple(sorted(events, key=lambda one: one.t_s)))


def _closings(event: Event, run: PlantRun) -> Iterator[tuple[float, float]]:
    """The instants (s) at which the relay of an event closes, with the lead of the unit's side (rad)."""
    check, plant = event.synchro_check, run.timeline.plant
    k = next(j for j, one in enumerate(plant.units) if one.name == event.element)
    opened = run.timeline.segment_at(event.t_s).topology.opened
    beside = [j for j, one in enumerate(plant.units) if one.node == plant.units[k].node and one.name not in opened]
    if check is None or not beside:
        raise InfeasibleStudyError(
            f"{event.name}: no other unit is connected at {plant.units[k].node}, whose voltage the relay could look "
            "at. Close the breaker without synchro_check."
        )
    c, j, dt = run.units[k].study.converter, beside[0], float(run.t_s[1] - run.t_s[0])
    every = max(round(_LOOK_S / dt), 1)
    first = int(np.searchsorted(run.t_s, event.t_s - _SETTLES_S))
    last = int(np.searchsorted(run.t_s, min(event.t_s + LONGEST_S, float(run.t_s[-1]))))
    own, behind = run.units[k].terminals, _at_node(run, run.units[j], plant.units[j].R, plant.units[j].L)
    relay = Relay(
        on=0.0,
        fresh=1.0,
        omega_n=c.omega_n,
        V_n=c.V_rated_rms,
        cosine=math.cos(check.around),
        sine=math.sin(check.around),
        least=math.cos(check.angle),
        V_pk=check.V_pu * rms_to_peak(c.V_rated_rms),
        omega=check.omega,
    )
    seen = other = GridWatch(0.0, 0.0, c.omega_n)
    for row in range(first, last, every):
        t_s = float(run.t_s[row])
        relay = relay._replace(on=1.0 * (t_s >= event.t_s))
        here, there = own[row].tolist(), behind[row].tolist()
        seen, other, near = relay_sees(seen, other, relay, here[0], here[1], there[0], there[1], every * dt)
        relay = relay._replace(fresh=0.0)
        if near > 0.5:
            lead = complex(seen.v_alpha, seen.v_beta) * complex(other.v_alpha, -other.v_beta)
            yield t_s, math.atan2(lead.imag, lead.real)


def _at_node(run: PlantRun, unit: UnitRun, R: float, L: float) -> Array:
    """(n, 2): the voltage at the node of a unit that is connected, behind its transformer and feeder."""
    i = unit.log[:, 4:6]
    return unit.terminals - R * i - L * np.gradient(i, run.t_s, axis=0)


def twins_of(
    study: Study, spec: ControllerSpec, run: PlantRun, schedules: Sequence[Schedule], tape: Tape, interval: float
) -> dict[float, PlantRun]:
    """The run without each step that has a twin (:func:`vsgdesign.simulation.twin.steps_with_twin`), up to the next
    event, by the time of the step, s. ``tape``: what the estimators did in ``run``, whose rows are ``interval`` apart,
    s."""
    found: dict[float, PlantRun] = {}
    if run.divergence is not None:
        return found
    known = [
        one if isinstance(one, FieldScheduler) else unit.gain_changes
        for one, unit in zip(schedules, run.units, strict=True)
    ]
    for t_s in steps_with_twin(study, spec):
        end_s = min((event.t_s for event in study.events if event.t_s > t_s), default=study.simulation.duration)
        held = replace(
            study,
            events=tuple(event for event in study.events if event.t_s < t_s),
            simulation=replace(study.simulation, duration=end_s),
        )
        again = plant_timeline(held, spec)
        twin = simulate_plant(held, known, timeline=again, log_interval=interval, tape=tape.played())
        if twin.divergence is None:
            found[t_s] = twin
    return found
