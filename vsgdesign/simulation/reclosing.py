"""An island that is connected to the grid again: when both sides of the breaker are near each other, or when the
converter has set itself to the grid behind it."""

from __future__ import annotations

import math
from dataclasses import replace

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation.timeline import Timeline, build_timeline
from vsgdesign.study.parameters.study import Event, Study

_CLOSES = "breaker closes"

IN_STEP_S = 0.2
"""Time for which the converter must be in step before the breaker closes, s, as with the exported code."""

LONGEST_S = 5.0
"""Time after which a converter that is not in step gives up, s."""


def waits_to_close(event: Event) -> bool:
    """Whether the breaker waits from an event on, until an instant that is not known yet."""
    return event.synchro_check is not None or event.synchronised_until == math.inf


def reclosed(study: Study, t_s: float | None, lead: float | None = None) -> Study:
    """The study with the instant at which the breaker closes as an event of its own; None: it never closes, and the
    event that waits says so.

    ``lead``: by how much the converter's side leads then, rad; None: the converter has set itself to the grid.
    """
    events = list(study.events)
    at = next(k for k, one in enumerate(events) if waits_to_close(one))
    event = events[at]
    given_up = min(event.t_s + LONGEST_S, study.simulation.duration)
    until = None if event.synchronised_until is None else (given_up if t_s is None else t_s)
    events[at] = replace(event, synchro_check=None, synchronised_until=until)
    if t_s is None:
        events[at] = replace(events[at], name=f"{event.name}: the breaker never closes")
        return replace(study, events=tuple(events))
    network = replace(build_timeline(study).network_at(t_s), connected=True)
    for k, later in enumerate(events):
        if later.t_s >= t_s and later.network is not None:
            events[k] = replace(later, network=replace(later.network, connected=True))
    word = "in step" if lead is None else f"at {math.degrees(math.remainder(lead, 2.0 * math.pi)):+.3g}°"
    events.append(Event(t_s, f"{_CLOSES} {word}", network=network))
    return replace(study, events=tuple(sorted(events, key=lambda one: one.t_s)))


def closings_of(study: Study, found: Study) -> tuple[Event, ...]:
    """The events that :func:`reclosed` has added to a study."""
    names = {event.name for event in study.events}
    return tuple(event for event in found.events if event.name.startswith(_CLOSES) and event.name not in names)


def check_setting(timeline: Timeline, probes: bool) -> None:
    """Whether a converter can set itself to the grid behind its breaker; ``probes``: whether something else moves its
    angle. Raises InfeasibleStudyError where it cannot."""
    if probes:
        raise InfeasibleStudyError(
            "synchronise: a converter that sets itself to the grid sends no probe. Give a controller without a field "
            "estimator, or leave synchronise out."
        )
    if timeline.wander is not None or timeline.replay is not None:
        raise InfeasibleStudyError(
            "synchronise: the voltage behind the breaker is not known beforehand with [background] or [replay]. "
            "Leave them out, or leave synchronise out."
        )
