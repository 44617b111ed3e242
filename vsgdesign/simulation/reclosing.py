"""An island that is connected to the grid again when both sides of the breaker are near each other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.filters import capacitor_node_voltage
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.synchronising import GridWatch, watch_grid
from vsgdesign.runtime.floats import on_floats
from vsgdesign.simulation.connecting import LONGEST_S, InStep
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.network import SynchroCheck
from vsgdesign.study.parameters.study import ControllerSpec, Event, Study

Array = NDArray[np.float64]

_watched = on_floats(watch_grid)

_CLOSES = "breaker closes"

_SETTLES_S = 0.3
"""How long the voltages are watched before the breaker may close, s: what follows them settles within 0.2 s."""


def reclosed(study: Study, spec: ControllerSpec, ready: Ready = NOTHING, *, bridge: str | None = None) -> Study:
    """The study with the instant at which a controller's synchro-check closes the breaker as an event of its own.

    It runs the study once with the breaker open, and the breaker closes at the first sample at which the relay's
    conditions hold (:eq:`synchro-check`), or at which the converter has set itself to the grid and has been in step for
    0.2 s (:eq:`synchronised`). Up to this instant the run with the event is the same. Where the conditions never hold,
    the breaker stays open, and the event says so. A study whose breaker does not wait is returned as it is. ``study``
    has the current limit of the controller.
    """
    waits = [k for k, one in enumerate(study.events) if waits_to_close(one)]
    if not waits:
        return study
    at, event = waits[0], study.events[waits[0]]
    every_sample = replace(study, simulation=replace(study.simulation, log_interval=study.converter.T_s))
    timeline = build_timeline(every_sample)
    found: tuple[float, str] | None = None
    try:
        run = simulate(every_sample, feed_of(every_sample, spec, timeline, ready), bridge=bridge)
        if event.synchro_check is not None:
            found = _closing(study, run, event.t_s, event.synchro_check)
    except InStep as seen:
        found = None if seen.t_s is None else (seen.t_s, f"{_CLOSES} in step")
    events = list(study.events)
    given_up = min(event.t_s + LONGEST_S, study.simulation.duration)
    until = None if event.synchronised_until is None else (given_up if found is None else found[0])
    events[at] = replace(event, synchro_check=None, synchronised_until=until)
    if found is None:
        events[at] = replace(events[at], name=f"{event.name}: the breaker never closes")
        return replace(study, events=tuple(events))
    t_s, name = found
    for k, later in enumerate(events):
        if later.t_s >= t_s and later.network is not None:
            events[k] = replace(later, network=replace(later.network, connected=True))
    events.append(Event(t_s, name, network=replace(timeline.network_at(t_s), connected=True)))
    return replace(study, events=tuple(sorted(events, key=lambda one: one.t_s)))


def waits_to_close(event: Event) -> bool:
    """Whether the breaker waits from an event on, until an instant that is not known yet."""
    return event.synchro_check is not None or event.synchronised_until == math.inf


def closings_of(study: Study, found: Study) -> tuple[Event, ...]:
    """The events that :func:`reclosed` has added to a study."""
    names = {event.name for event in study.events}
    return tuple(event for event in found.events if event.name.startswith(_CLOSES) and event.name not in names)


def _closing(study: Study, run: Simulation, since_s: float, check: SynchroCheck) -> tuple[float, str] | None:
    """The first sample from ``since_s`` on at which the breaker may close, s, and in words by how much the converter's
    side then leads. None if there is none.

    The relay sees the voltage of the capacitor, as the controller does, and that behind the breaker. It follows both as
    the exported controller follows the grid before it connects.
    """
    c, T_s = study.converter, study.converter.T_s
    refs = c.references()
    i_s, v_c, i_g = (run.log[:, 2 * k : 2 * k + 2] for k in range(3))
    own: Array = capacitor_node_voltage(i_s, v_c, i_g, study.circuit())
    grid: Array = run.log[:, 6:8]
    first = math.ceil(since_s / T_s - 1e-6)
    begin = max(first - round(_SETTLES_S / T_s), 0)
    seen, behind = (GridWatch(float(v[begin, 0]), float(v[begin, 1]), c.omega_n) for v in (own, grid))
    most_V = check.V_pu * rms_to_peak(c.V_rated_rms)
    timeline = run.timeline
    faults = any(network.fault is not None for _, network in timeline.networks)
    for k in range(begin, len(own)):
        seen = _watched(seen, float(own[k, 0]), float(own[k, 1]), refs, T_s)
        behind = _watched(behind, float(grid[k, 0]), float(grid[k, 1]), refs, T_s)
        if k < first or (faults and timeline.network_at((k + 1e-6) * T_s).fault is not None):
            continue
        lead = math.atan2(seen.v_beta, seen.v_alpha) - math.atan2(behind.v_beta, behind.v_alpha)
        apart = math.remainder(lead - check.around, 2.0 * math.pi)
        lengths = math.hypot(seen.v_alpha, seen.v_beta) - math.hypot(behind.v_alpha, behind.v_beta)
        near = abs(apart) <= check.angle and abs(lengths) <= most_V
        if near and abs(seen.omega - behind.omega) <= check.omega:
            return k * T_s, f"{_CLOSES} at {math.degrees(math.remainder(lead, 2.0 * math.pi)):+.3g}°"
    return None
