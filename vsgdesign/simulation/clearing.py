"""Clearing of a fault: the instants at which the current of each phase passes through zero and is interrupted."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import clarke_inverse
from vsgdesign.linear.operating_point.network import NetworkCircuit
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.grid import PHASE_PAIRS, PHASE_TO_PHASE, THREE_PHASE, Fault, Network
from vsgdesign.study.parameters.study import Event, Study

Array = NDArray[np.float64]

MOST_CYCLES = 5.0
"""Nominal cycles after which a current without a zero is interrupted. Only a lasting dc component can keep it from zero
for so long."""

_REST = {"a": "bc", "b": "ca", "c": "ab"}
"""The phases between which a three-phase fault remains when one phase is interrupted."""

_PHASE = ": phase"
"""Follows the name of an event that clears a fault, before the phases with their instants."""

SLACK = 1e-6
"""Share of a sample by which an instant may lie beside a sample and still belong to it."""


class Clearing:
    """A fault that is cleared phase by phase at the zeros of its currents (:eq:`fault-current`), while a run goes on.

    A fault between two phases ends at the first zero of its current at or after the asked instant. Of a three-phase
    fault, the phase that comes to zero first is interrupted. The other two then have one current, through 2R, and are
    interrupted at its zero. All that happens in the grid together with the clearing happens at the last zero: a line
    whose breakers interrupt the fault is out when the last phase is interrupted. A current that has no zero within
    MOST_CYCLES, or before the next fault, is interrupted then, and the event says so.
    """

    def __init__(self, study: Study, asked_s: float) -> None:
        listed, cycle = build_timeline(study).networks, 2.0 * math.pi / study.converter.omega_n
        self.asked_s, self._T_s = asked_s, study.converter.T_s
        self.renew(study)
        again = [t_s for t_s, network in listed if t_s > asked_s and network.fault is not None]
        self.latest = min([asked_s + MOST_CYCLES * cycle, study.simulation.duration, *again])
        """The instant at which the current is interrupted without a zero, s."""
        changes = [t for (_, old), (t, new) in itertools.pairwise(listed) if t < asked_s and new.fault != old.fault]
        self._since = _Since(asked_s, max(changes, default=0.0))
        self._steps: list[_Step] = []
        self.fault = self._before.fault
        """What is left of it; None: it is over."""

    def renew(self, study: Study) -> None:
        """The study has other events before the fault than were known so far."""
        self._before = [network for t_s, network in build_timeline(study).networks if t_s < self.asked_s][-1]

    @property
    def since_s(self) -> float:
        """From when on a zero is looked for, s."""
        return self._since.t_s

    @property
    def phases(self) -> tuple[float, float, float]:
        """1 for each of the phases a, b, c whose zero is looked for, else 0."""
        waited = "" if self.fault is None else "abc" if self.fault.kind == THREE_PHASE else self.fault.phases[0]
        return tuple(float(phase in waited) for phase in "abc")  # type: ignore[return-value]

    def held(self, study: Study) -> Study:
        """The study with what is left of the fault, and without the events at the instant of its clearing."""
        return _held(study, self.asked_s, self._before, self._steps, self.latest)

    def zero(self, sample: int, at: Sequence[SampleOfFault], changed: bool, *, surely: bool = False) -> float | None:
        """Looks at an interval of the run, from a sample to the next one. Returns the instant at which a phase is
        interrupted; None: in none of it. ``surely``: the loop has seen a zero, which a last bit may have moved out of
        the interval.

        Between two samples the current is a cubic with the exact values and slopes at both. It is a straight line where
        the slopes jump in between: at another event (``changed``), and where the bridge's voltage acts on the fault's
        current at once.
        """
        slack, t_0 = SLACK * self._T_s, sample * self._T_s
        t_1, since, fault = t_0 + self._T_s, self._since, self.fault
        found = None if fault is None else self._first_zero(t_0, t_1, at, changed)
        if found is None and surely and fault is not None:
            currents = at[0].currents
            nearest = min((k for k, waited in enumerate(self.phases) if waited), key=lambda k: abs(currents[k]))
            found = _Zero(t_0, "abc"[nearest], currents)
        if fault is None or (found is None and t_1 < self.latest - slack):
            return None
        if found is None or found.t_s > self.latest:
            self.interrupted()
        elif fault.kind == PHASE_TO_PHASE:
            self._steps.append(_Step(found.t_s, f"{_listed(fault.phases)} at", None))
        else:
            rest = rest_of_fault(fault, _REST[found.phase])
            self._steps.append(_Step(found.t_s, f"{found.phase} at", rest))
            since = _Since(found.t_s, found.t_s, found.currents)
        self._since, self.fault = since, self._steps[-1].fault
        return self._steps[-1].t_s

    def interrupted(self) -> None:
        """It is interrupted without a zero."""
        if self.fault is not None:
            self._steps.append(_Step(self.latest, f"{_listed(_phases(self.fault))} without a zero until", None))
            self.fault = None

    def _first_zero(self, t_0: float, t_1: float, at: Sequence[SampleOfFault], changed: bool) -> _Zero | None:
        since, slack = self._since, SLACK * self._T_s
        if since.t_s >= t_1 - slack:
            return None
        currents = [one.currents for one in at]
        columns = [k for k, waited in enumerate(self.phases) if waited]
        inside = since.t_s > t_0 + slack
        if not inside and not (currents[0][columns] * currents[1][columns] <= 0.0).any():
            return None
        begin = since.t_s if inside else t_0
        if inside and since.begun_s > t_0 + slack:
            if since.currents is None:
                return None
            piece = _Piece(begin, t_1, since.currents, currents[1])
        else:
            slopes = None if changed else _slopes(at)
            piece = _Piece(t_0, t_1, currents[0], currents[1], slopes)
        roots = [(root, "abc"[column]) for column in columns if (root := piece.root(begin, column)) is not None]
        if not roots:
            return None
        t_s, phase = min(roots)
        return _Zero(t_s, phase, piece.at(t_s))

    def found(self, study: Study) -> Study:
        """The study in which the fault is cleared phase by phase."""
        timeline, steps, asked_s = build_timeline(study), self._steps, self.asked_s
        last = steps[-1].t_s
        words = ", ".join(f"{step.words} {step.t_s:.4f} s" for step in steps)
        plural = "s" if " and " in steps[0].words else ""
        events = list(_held(study, asked_s, self._before, steps[:-1], last).events)
        later = [event for event in study.events if asked_s < event.t_s <= last]
        at_last = [event for event in study.events if event.t_s == asked_s]
        told = next(k for k, event in enumerate(at_last) if event.network is not None and event.network.fault is None)
        for k, event in enumerate(at_last):
            name = f"{event.name}{_PHASE}{plural} {words}" if k == told else event.name
            network = None if event.network is None else timeline.network_at(last)
            events.append(replace(_without(event, later), t_s=last, name=name, network=network))
        return replace(study, events=tuple(sorted(events, key=lambda event: event.t_s)))


def rest_of_fault(fault: Fault, phases: str) -> Fault:
    """What is left between two phases of a three-phase fault of which the third is interrupted."""
    return Fault(kind=PHASE_TO_PHASE, at=fault.at, R=2.0 * fault.R, phases=phases)


def rests_of_fault(network: Network) -> list[Network]:
    """The networks that a clearing may leave of one with a three-phase fault; none of another one."""
    fault = network.fault
    if fault is None or fault.kind != THREE_PHASE:
        return []
    return [replace(network, fault=rest_of_fault(fault, phases)) for phases in PHASE_PAIRS]


class SampleOfFault(NamedTuple):
    """What is known of a fault's current at a sample."""

    x: Array
    """The circuit's states."""
    v_g: Array
    """(2,): the voltage of the source, V peak."""
    circuit: NetworkCircuit

    @property
    def currents(self) -> Array:
        """(3,): of the phases into the fault, A (:eq:`fault-current`)."""
        return np.array(clarke_inverse(*(self.x @ self.circuit.fault_per_state.T)))


def _slopes(at: Sequence[SampleOfFault]) -> tuple[Array, Array] | None:
    """Of the currents at a sample and at the next one, A/s; None where the bridge's voltage acts on them at once."""
    circuit = at[0].circuit
    rows = circuit.fault_per_state
    if np.abs(rows @ circuit.B).max() > 0.0:
        return None
    first, second = (np.array(clarke_inverse(*(rows @ (circuit.A @ one.x + circuit.E @ one.v_g)))) for one in at)
    return first, second


def clearings(study: Study) -> tuple[float, ...]:
    """The instants after the start at which a fault ends and no other one takes its place, s."""
    timeline, found, before = build_timeline(study), [], study.network
    for t_s in sorted({t_s for t_s, _ in timeline.networks}):
        network = timeline.network_at(t_s)
        if t_s > 0.0 and before.fault is not None and network.fault is None:
            found.append(t_s)
        before = network
    return tuple(found)


def cleared_events(study: Study, found: Study) -> tuple[Event, ...]:
    """The last interruption of each of the :func:`clearings` of ``study``, in order, of the study that was found."""
    begin = tuple(f"{event.name}{_PHASE}" for event in study.events)
    return tuple(event for event in found.events if begin and event.name.startswith(begin))


class _Step(NamedTuple):
    """One interruption: when, what it says, and the fault that is left."""

    t_s: float
    words: str
    fault: Fault | None


class _Since(NamedTuple):
    """From when on a zero is looked for."""

    t_s: float
    begun_s: float
    """Since when the network has had this fault."""
    currents: Array | None = None
    """(3,): just after ``t_s``, A, where the fault begins at that instant; None where the run's rows say it."""


class _Zero(NamedTuple):
    t_s: float
    phase: str
    currents: Array
    """(3,): of all phases at that instant, A."""


def _phases(fault: Fault) -> str:
    return fault.phases if fault.kind == PHASE_TO_PHASE else "abc"


def _listed(phases: str) -> str:
    return " and ".join(sorted(phases)) if len(phases) < 3 else "a, b and c"


def _without(event: Event, later: list[Event]) -> Event:
    """An event that comes late, without what an event that was asked for later has said in the meantime."""
    names = ("grid", "V_g_rms", "omega_g", "P_ref", "Q_ref", "components")
    said = {name for one in later for name in names if getattr(one, name) is not None}
    return replace(event, **dict.fromkeys(said)) if said else event


def _held(study: Study, asked_s: float, before: Network, steps: list[_Step], until: float) -> Study:
    """The study with what is left of a fault up to ``until``, and without the events at the instant of its clearing."""
    events, network, fault = [], before, before.fault
    listed: list[tuple[float, Event | _Step]] = [(event.t_s, event) for event in study.events if event.t_s != asked_s]
    listed += [(step.t_s, step) for step in steps]
    for t_s, one in sorted(listed, key=lambda pair: pair[0]):
        if isinstance(one, _Step):
            fault = one.fault
            events.append(
                Event(t_s, f"fault current of phase {one.words[0]} ends", network=replace(network, fault=fault))
            )
            network = events[-1].network
        elif asked_s < t_s < until and one.network is not None:
            events.append(replace(one, network=replace(one.network, fault=fault)))
            network = events[-1].network
        else:
            events.append(one)
    return replace(study, events=tuple(events))


class _Piece(NamedTuple):
    """The currents of the phases (3,) between two instants."""

    t_0: float
    t_1: float
    begin: Array
    end: Array
    slopes: tuple[Array, Array] | None = None
    """At both instants, A/s; None: straight lines."""

    def at(self, t_s: float) -> Array:
        h, rise = self.t_1 - self.t_0, self.end - self.begin
        s = (t_s - self.t_0) / h
        line = self.begin + s * rise
        if self.slopes is None:
            return line
        left, right = (h * slope - rise for slope in self.slopes)
        return line + s * (1.0 - s) * ((1.0 - s) * left - s * right)

    def root(self, since_s: float, column: int) -> float | None:
        """Where the current of a phase is zero from an instant on, by bisection; None if its sign stays."""
        low, high = since_s, self.t_1
        at_low = self.at(low)[column]
        if at_low * self.end[column] > 0.0:
            return None
        while high - low > 1e-9 * (self.t_1 - self.t_0):
            middle = 0.5 * (low + high)
            if at_low * self.at(middle)[column] <= 0.0:
                high = middle
            else:
                low = middle
        return high
