"""Clearing of a fault: the instants at which the current of each phase passes through zero and is interrupted."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.artifacts.ready import NOTHING, Ready
from vsgdesign.equations.frames import clarke_inverse
from vsgdesign.errors import SimulationDivergedError
from vsgdesign.linear.operating_point.network import NetworkCircuit, network_circuit
from vsgdesign.simulation.circuits import connection_at, states_of_timelines
from vsgdesign.simulation.feeds import feed_of
from vsgdesign.simulation.reclosing import closings_of, reclosed, waits_to_close
from vsgdesign.simulation.run import Simulation, simulate
from vsgdesign.simulation.timeline import build_timeline
from vsgdesign.study.parameters.network import PHASE_TO_PHASE, THREE_PHASE, Fault, Network
from vsgdesign.study.parameters.study import ControllerSpec, Event, Study

Array = NDArray[np.float64]

MOST_CYCLES = 5.0
"""Nominal cycles after which a current without a zero is interrupted. Only a lasting dc component can keep it from zero
for so long."""

_REST = {"a": "bc", "b": "ca", "c": "ab"}
"""The phases between which a three-phase fault remains when one phase is interrupted."""

_PHASE = ": phase"
"""Follows the name of an event that clears a fault, before the phases with their instants."""


def with_instants(study: Study, spec: ControllerSpec, ready: Ready = NOTHING, *, bridge: str | None = None) -> Study:
    """The study with every instant that only a run can tell as an event of its own: those at which the currents of
    faults are interrupted (:func:`cleared_at_zeros`), and that at which a breaker that waits closes
    (:func:`vsgdesign.simulation.reclosing.reclosed`).

    They are found in order of time, because each depends on those before it. A study without such events is returned
    unchanged. ``study`` has the current limit of the controller. Raises what a run raises.
    """
    for asked_s in clearings(study):
        if any(waits_to_close(one) and one.t_s < asked_s for one in study.events):
            closed = reclosed(study, spec, ready, bridge=bridge)
            if any(one.t_s < asked_s for one in closings_of(study, closed)):
                study = closed
        study = _cleared(study, asked_s, spec, ready, bridge)
    return reclosed(study, spec, ready, bridge=bridge)


def cleared_at_zeros(study: Study, spec: ControllerSpec, ready: Ready = NOTHING, *, bridge: str | None = None) -> Study:
    """The study in which each fault is cleared phase by phase at the zeros of its currents (:eq:`fault-current`).

    A fault between two phases ends at the first zero of its current at or after the asked instant. Of a three-phase
    fault, the phase that comes to zero first is interrupted. The other two then have one current, through 2R, and are
    interrupted at its zero. All that happens in the grid together with the clearing happens at the last zero: a line
    whose breakers interrupt the fault is out when the last phase is interrupted. A current that has no zero within
    MOST_CYCLES, or before the next fault, is interrupted then, and the event says so. The instants belong to the
    controller ``spec``: each is found in a run of the study up to it. A study without such an event is returned
    unchanged. ``study`` has the current limit of the controller. Raises what a run raises.
    """
    for asked_s in clearings(study):
        study = _cleared(study, asked_s, spec, ready, bridge)
    return study


def clearings(study: Study) -> tuple[float, ...]:
    """The instants after the start at which a fault ends and no other one takes its place, s."""
    timeline, found, before = build_timeline(study), [], study.network
    for t_s in sorted({t_s for t_s, _ in timeline.networks}):
        network = timeline.network_at(t_s)
        if t_s > 0.0 and before.fault is not None and network.fault is None:
            found.append(t_s)
        before = network
    return tuple(found)


def found_events(study: Study, found: Study) -> tuple[Event, ...]:
    """The events of ``found`` that say an instant which :func:`with_instants` has found for ``study``."""
    told = (*cleared_events(study, found), *closings_of(study, found))
    return tuple(sorted(told, key=lambda event: event.t_s))


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


def _cleared(study: Study, asked_s: float, spec: ControllerSpec, ready: Ready, bridge: str | None) -> Study:
    """The study in which one fault is cleared phase by phase."""
    timeline = build_timeline(study)
    before = [network for t_s, network in timeline.networks if t_s < asked_s][-1]
    steps = _interruptions(study, asked_s, before, _Runs(spec, ready, bridge))
    last = steps[-1].t_s
    words = ", ".join(f"{step.words} {step.t_s:.4f} s" for step in steps)
    plural = "s" if " and " in steps[0].words else ""
    events = list(_held(study, asked_s, before, steps[:-1], last).events)
    later = [event for event in study.events if asked_s < event.t_s <= last]
    at_last = [event for event in study.events if event.t_s == asked_s]
    told = next(k for k, event in enumerate(at_last) if event.network is not None and event.network.fault is None)
    for k, event in enumerate(at_last):
        name = f"{event.name}{_PHASE}{plural} {words}" if k == told else event.name
        network = None if event.network is None else timeline.network_at(last)
        events.append(replace(_without(event, later), t_s=last, name=name, network=network))
    return replace(study, events=tuple(sorted(events, key=lambda event: event.t_s)))


def _interruptions(study: Study, asked_s: float, before: Network, runs: _Runs) -> list[_Step]:
    """When the phases of a fault that is cleared at ``asked_s`` are interrupted. ``before``: the network until then."""
    listed = build_timeline(study).networks
    cycle = 2.0 * math.pi / study.converter.omega_n
    again = [t_s for t_s, network in listed if t_s > asked_s and network.fault is not None]
    latest = min([asked_s + MOST_CYCLES * cycle, study.simulation.duration, *again])
    changes = [t for (_, old), (t, new) in itertools.pairwise(listed) if t < asked_s and new.fault != old.fault]
    since = _Since(asked_s, max(changes, default=0.0))
    steps: list[_Step] = []
    fault = before.fault
    while fault is not None:
        held = _held(study, asked_s, before, steps, latest)
        zero = None
        # A second, longer run only where the first one shows no zero.
        for until in dict.fromkeys((min(since.t_s + 1.05 * cycle, latest), latest)):
            run = runs.until(held, until)
            zero = None if run is None else _first_zero(held, run, fault, since)
            if zero is not None:
                break
        if zero is None or zero.t_s > latest:
            steps.append(_Step(latest, f"{_listed(_phases(fault))} without a zero until", None))
        elif fault.kind == PHASE_TO_PHASE:
            steps.append(_Step(zero.t_s, f"{_listed(fault.phases)} at", None))
        else:
            rest = Fault(kind=PHASE_TO_PHASE, at=fault.at, R=2.0 * fault.R, phases=_REST[zero.phase])
            steps.append(_Step(zero.t_s, f"{zero.phase} at", rest))
            since = _Since(zero.t_s, zero.t_s, zero.currents)
        fault = steps[-1].fault
    return steps


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


class _Runs(NamedTuple):
    """Short runs of one controller."""

    spec: ControllerSpec
    ready: Ready
    bridge: str | None

    def until(self, study: Study, until: float) -> Simulation | None:
        """The run up to the first samples after an instant, with every sample; None where it diverges at once."""
        T_s = study.converter.T_s
        duration = min(math.ceil(until / T_s + 2.0) * T_s, study.simulation.duration)
        # No breaker closes here: a run that looks for the instant at which it may would end there.
        events = [
            event
            if event.synchronised_until is None
            else replace(event, synchronised_until=min(event.synchronised_until, duration + 1.0))
            for event in study.events
        ]
        simulation = replace(study.simulation, duration=duration, log_interval=T_s)
        short = replace(study, events=tuple(events), simulation=simulation)
        try:
            feed = feed_of(short, self.spec, build_timeline(short), self.ready)
            return simulate(short, feed, bridge=self.bridge)
        except SimulationDivergedError:
            return None


def _first_zero(study: Study, run: Simulation, fault: Fault, since: _Since) -> _Zero | None:
    """The first instant at which the current of a phase of a fault is zero; None if there is none.

    Between two samples the current is a cubic with the exact values and slopes at both. It is a straight line where the
    slopes jump in between: at another event, and where the bridge's voltage acts on the fault's current at once.
    """
    T_s, slack = study.converter.T_s, 1e-6 * study.converter.T_s
    columns = ["abc".index(phase) for phase in (_phases(fault) if fault.kind == THREE_PHASE else fault.phases[0])]
    first = max(math.floor(since.t_s / T_s - 1e-6), 0)
    currents = _fault_currents(study, run, first)
    for k in range(len(currents) - 1):
        t_0 = (first + k) * T_s
        t_1 = t_0 + T_s
        if since.t_s >= t_1 - slack:
            continue
        inside = since.t_s > t_0 + slack
        if not inside and not (currents[k, columns] * currents[k + 1, columns] <= 0.0).any():
            continue
        begin = since.t_s if inside else t_0
        if inside and since.begun_s > t_0 + slack:
            if since.currents is None:
                continue
            piece = _Piece(begin, t_1, since.currents, currents[k + 1])
        else:
            changed = any(t_0 + slack < t_s <= t_1 + slack for t_s in run.timeline.plant_changes())
            slopes = None if changed else _slopes(study, run, first + k)
            piece = _Piece(t_0, t_1, currents[k], currents[k + 1], slopes)
        roots = [(root, "abc"[column]) for column in columns if (root := piece.root(begin, column)) is not None]
        if roots:
            t_s, phase = min(roots)
            return _Zero(t_s, phase, piece.at(t_s))
    return None


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


def _circuit_at(study: Study, run: Simulation, t_s: float) -> NetworkCircuit:
    states = states_of_timelines([run.timeline])
    if states is None:
        raise ValueError("there is no fault in this run")
    return network_circuit(study.filter, *connection_at(run.timeline, t_s), states)


def _fault_currents(study: Study, run: Simulation, first: int) -> Array:
    """(n, 3): currents of the phases into the fault from a row on, A (:eq:`fault-current`)."""
    T_s, end = study.converter.T_s, len(run.log)
    x = np.column_stack([run.log[first:, :6], run.circuit_log[first:]])
    found = np.zeros((len(x), 2))
    changes = [max(math.ceil(t_s / T_s - 1e-6), first) for t_s in run.timeline.plant_changes()]
    cuts = sorted({first, end, *(k for k in changes if k < end)})
    for begin, until in itertools.pairwise(cuts):
        circuit = _circuit_at(study, run, (begin + 1e-6) * T_s)
        found[begin - first : until - first] = x[begin - first : until - first] @ circuit.fault_per_state.T
    return np.column_stack(clarke_inverse(*found.T))


def _slopes(study: Study, run: Simulation, row: int) -> tuple[Array, Array] | None:
    """Of the currents at a row and at the next one, A/s; None where the voltage of the bridge acts on them at once."""
    circuit = _circuit_at(study, run, (row + 1e-6) * study.converter.T_s)
    rows = circuit.fault_per_state
    if np.abs(rows @ circuit.B).max() > 0.0:
        return None
    found = []
    for k in (row, row + 1):
        x = np.concatenate([run.log[k, :6], run.circuit_log[k]])
        found.append(np.array(clarke_inverse(*(rows @ (circuit.A @ x + circuit.E @ run.log[k, 6:8])))))
    return found[0], found[1]
