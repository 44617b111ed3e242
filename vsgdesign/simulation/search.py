"""The instants of a run that only the run itself can tell, found while it goes on: when the phases of a fault are
interrupted, and when a breaker that waits closes.

An island is connected to the grid again when both sides of the breaker are near each other, or when the converter has
set itself to the grid behind it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.simulation.circuits import Circuits, Connection, connection_at, connections
from vsgdesign.simulation.clearing import SLACK, Clearing, cleared_events, clearings, rests_of_fault
from vsgdesign.simulation.run_kind import FAULT, RELAY, SYNC
from vsgdesign.simulation.sample import Phases, Relay, Setting
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


Array = NDArray[np.float64]

_SETTLES_S = 0.3
"""How long the voltages are watched before the breaker may close, s: what follows them settles within 0.2 s."""


class Record(NamedTuple):
    """Before a sample, numbers that a run has under a name take values."""

    sample: int
    name: str
    values: Array


def found_events(study: Study, found: Study) -> tuple[Event, ...]:
    """The events of the study that a run was, ``found``, which say an instant that it has found for ``study``."""
    told = (*cleared_events(study, found), *closings_of(study, found))
    return tuple(sorted(told, key=lambda event: event.t_s))


class Search:
    """Looks for the instants of one run, in order of time. Without ``finds`` it looks for none: events come at the
    instants that they give, and a breaker that waits stays open."""

    def __init__(self, study: Study, *, finds: bool) -> None:
        self._study, self._finds, self._T_s = study, finds, study.converter.T_s
        self._asked = list(clearings(study)) if finds else []
        self._clearing: Clearing | None = None
        wanted = {
            FAULT: bool(self._asked),
            RELAY: finds and any(event.synchro_check is not None for event in study.events),
            SYNC: any(event.synchronised_until is not None for event in study.events),
        }
        self.seeks = tuple(what for what, needed in wanted.items() if needed)
        """What the loop has to look for, or to do at instants that it finds."""
        self._next_clearing()

    def _next_clearing(self) -> None:
        self._clearing = Clearing(self._study, self._asked.pop(0)) if self._asked else None

    @property
    def study(self) -> Study:
        """With what is found so far. A fault that is being cleared is still there."""
        return self._study if self._clearing is None else self._clearing.held(self._study)

    @property
    def clearing(self) -> Clearing | None:
        """The fault whose zeros are looked for next."""
        return self._clearing

    def possible(self, timeline: Timeline) -> list[Connection]:
        """What the run may be connected to that its timeline does not have yet."""
        found = []
        for grid, network in connections(timeline) + (connections(build_timeline(self._study)) if self._finds else []):
            found += [Connection(grid, network), *(Connection(grid, one) for one in rests_of_fault(network))]
            if not network.connected and any(map(waits_to_close, self._study.events)):
                found.append(Connection(grid, replace(network, connected=True)))
        return list(dict.fromkeys(found)) if self._finds else []

    def special(self, timeline: Timeline) -> list[int]:
        """The samples in whose intervals the current of a fault is not that of one circuit: they are seen apart."""
        clearing = self._clearing
        if clearing is None:
            return []
        instants = [clearing.since_s, clearing.latest, *timeline.plant_changes()]
        among = {math.ceil(t_s / self._T_s - SLACK) - 1 for t_s in instants if t_s >= clearing.since_s}
        last = math.ceil(clearing.latest / self._T_s - SLACK) - 1
        return sorted(k for k in among if 0 <= k <= last)

    def under_way(self, t_s: float) -> bool:
        """Whether at an instant a fault is being cleared, or the converter sets itself to the grid."""
        clearing = self._clearing
        setting = (event.synchronised_until for event in self._study.events if event.t_s <= t_s)
        return (clearing is not None and clearing.since_s <= t_s) or any(
            until is not None and until > t_s for until in setting
        )

    def found_zero(self) -> None:
        """A phase is interrupted, or the whole fault."""
        clearing = self._clearing
        if clearing is not None and clearing.fault is None:
            self._study = clearing.found(self._study)
            self._next_clearing()

    def closed(self, t_s: float, lead: float | None) -> None:
        """The breaker that waits closes."""
        self._study = reclosed(self._study, t_s, lead)
        if self._clearing is not None:
            self._clearing.renew(self._study)

    def give_up(self) -> None:
        """The run is over."""
        while self._clearing is not None:
            self._clearing.interrupted()
            self.found_zero()
        if self._finds and any(map(waits_to_close, self._study.events)):
            self._study = reclosed(self._study, None)

    # What the loop is told.

    def records(self, timeline: Timeline, circuits: Circuits) -> Iterator[Record]:
        """What the loop is given to look for, from the beginning of the run on."""
        if self._clearing is not None:
            yield from self._of_clearing(self._clearing, timeline, circuits)
        waiting = next((one for one in self._study.events if one.synchro_check is not None), None)
        yield from self._of_relay(waiting, timeline) if waiting is not None and self._finds else ()
        setting = next((one for one in self._study.events if one.synchronised_until is not None), None)
        yield from self._of_setting(setting, timeline) if setting is not None else ()

    def _first(self, t_s: float) -> int:
        return max(math.ceil(t_s / self._T_s - SLACK), 0)

    def _of_clearing(self, clearing: Clearing, timeline: Timeline, circuits: Circuits) -> Iterator[Record]:
        begin, end = self._first(clearing.since_s), self._first(clearing.latest)
        changes = [self._first(t_s) for t_s in timeline.plant_changes() if clearing.since_s < t_s < clearing.latest]
        for k in sorted({begin, *changes}):
            rows = circuits.current_into_fault(connection_at(timeline, (k + SLACK) * self._T_s))
            yield Record(k, "seek.current", rows.ravel())
        phases, off = np.array(Phases(*clearing.phases)), np.zeros(3)
        yield Record(begin, "seek.phases", phases)
        for k in self.special(timeline):
            yield Record(k, "seek.phases", off)
            yield Record(k + 1, "seek.phases", phases if k + 1 < end and k + 1 not in self.special(timeline) else off)
        yield Record(end, "seek.phases", off)

    def _of_relay(self, event: Event, timeline: Timeline) -> Iterator[Record]:
        c, check, first = self._study.converter, event.synchro_check, self._first(event.t_s)
        if check is None:
            return
        begin, refs = max(first - round(_SETTLES_S / self._T_s), 0), c.references()
        relay = Relay(
            on=0.0,
            fresh=1.0,
            omega_n=c.omega_n,
            V_n=refs.V_n,
            cosine=math.cos(check.around),
            sine=math.sin(check.around),
            least=math.cos(check.angle),
            V_pk=check.V_pu * rms_to_peak(c.V_rated_rms),
            omega=check.omega,
        )
        yield Record(begin, "seek.relay", np.array(numbers_of(relay)))
        yield Record(begin + 1, "seek.relay.fresh", np.zeros(1))
        for k, free in self._free(first, timeline):
            yield Record(k, "seek.relay.on", np.array([free]))

    def _of_setting(self, event: Event, timeline: Timeline) -> Iterator[Record]:
        until, first, c = event.synchronised_until, self._first(event.t_s), self._study.converter
        if until is None:
            return
        waits = math.isinf(until)
        end = first + round(LONGEST_S / self._T_s) if waits else self._first(until)
        needed = float(round(IN_STEP_S / self._T_s)) if waits and self._finds else math.inf
        yield Record(first, "seek.watch_sync", np.array([0.0, 0.0, c.omega_n]))
        yield Record(first, "seek.ready", np.zeros(1))
        yield Record(first, "seek.setting", np.array(numbers_of(Setting(on=1.0, free=1.0, needed=needed))))
        for k, free in self._free(first, timeline):
            yield Record(k, "seek.setting.free", np.array([free]))
        yield Record(end, "seek.setting.on", np.zeros(1))

    def _free(self, first: int, timeline: Timeline) -> Iterator[tuple[int, float]]:
        """From which samples on no fault is there (1), or one is (0)."""
        for k in sorted({first, *(self._first(t_s) for t_s, _ in timeline.networks)}):
            if k >= first:
                yield k, float(timeline.network_at((k + SLACK) * self._T_s).fault is None)
