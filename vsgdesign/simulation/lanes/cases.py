"""Cases of a batch as arrays: where each run rests at first, what happens in it, and what is known of its grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import References
from vsgdesign.linear.operating_point.many import Lanes
from vsgdesign.simulation.lanes.around import NOTHING, Around
from vsgdesign.simulation.timeline import Segments
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.event import Event
from vsgdesign.study.parameters.event_kinds import DC_QUANTITIES
from vsgdesign.study.parameters.grid import Grid, Network
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Kinds = NDArray[np.int8]
Networks = tuple[tuple[float, Network], ...]
"""Load, fault and breaker of a run from each instant (s) on, the first one from t = 0 on."""

STEP, DISTURBANCE = 0, 1
"""Kinds of a case: a step of one reference, which has an overshoot and a settling time; anything else."""

ACTIVE, REACTIVE = 0, 1
"""The signal of a step: P or Q."""


_QUANTITIES = ("V_g_rms", "omega_g", *References._fields, *DC_QUANTITIES)
_NOTHING = ("over", "phase_jump")
"""Quantities of an event that are NaN, and those that are zero, where it does not change them."""


@dataclass(frozen=True, kw_only=True)
class LaneEvents:
    """The events of N runs (:class:`vsgdesign.study.parameters.event.Event`, in SI) as arrays (N, E), in ascending
    order of time; E is the most that any run has.

    NaN in a quantity means that it does not change. Rows that are not used are at t = inf.
    """

    t_s: Array
    """Time of the run, s."""
    R_g: Array
    """Ω; with L_g: both or none are given."""
    L_g: Array
    """H."""
    V_g_rms: Array
    """Phase rms, V."""
    omega_g: Array
    """rad/s."""
    over: Array
    """Duration of a linear ramp of V_g_rms and omega_g, s. Zero means a step."""
    phase_jump: Array
    """rad."""
    P_ref: Array
    """W."""
    Q_ref: Array
    """var."""
    omega_0: Array
    """Frequency set point, rad/s."""
    V_n: Array
    """Voltage set point, phase rms, V."""
    dc_power: Array
    """Share of the source of the dc link that is left."""
    dc_charge: Array
    """Its state of charge."""
    irradiance: Array
    """On its array, W/m²."""

    @property
    def count(self) -> int:
        """E."""
        return self.t_s.shape[1]

    @classmethod
    def of(cls, runs: Sequence[Sequence[Event]]) -> LaneEvents:
        """The events of runs, in SI and in ascending order of time. Their grids, sources and set points are taken."""
        found = no_events(len(runs), max((len(events) for events in runs), default=0))
        for k, events in enumerate(runs):
            for j, event in enumerate(events):
                values = {name: getattr(event, name) for name in (*_QUANTITIES, *_NOTHING)} | {"t_s": event.t_s}
                if event.grid is not None:
                    values |= {"R_g": event.grid.R_g, "L_g": event.grid.L_g}
                for name, value in values.items():
                    if value is not None:
                        getattr(found, name)[k, j] = value
        return found

    def events(self, k: int) -> tuple[Event, ...]:
        """The events of a run."""
        found = []
        for j in np.flatnonzero(np.isfinite(self.t_s[k])):
            of_event = {f.name: float(getattr(self, f.name)[k, j]) for f in fields(self)}
            R_g, L_g = of_event.pop("R_g"), of_event.pop("L_g")
            given: dict[str, Any] = {name: value for name, value in of_event.items() if not math.isnan(value)}
            found.append(Event(grid=None if math.isnan(R_g) else Grid(R_g, L_g), **given))
        return tuple(found)


@dataclass(frozen=True, kw_only=True)
class LaneCases:
    """N runs that begin at rest. Arrays (N,), SI; the source begins at −90° and the phase of its background."""

    R_g: Array
    L_g: Array
    """The grid at the start, at the PCC, Ω and H."""
    V_g_rms: Array
    omega_g: Array
    """The source at the start, phase rms V and rad/s."""
    P_ref: Array
    Q_ref: Array
    """The references at the start, W and var."""
    events: LaneEvents
    error_R: Array
    error_X: Array
    """Errors of the estimate, relative: it is R_g (1 + error_R) and L_g (1 + error_X) at all times."""
    silent_s: Array
    """After every change of the grid or its source there is no estimate for this long, s."""
    cleared_s: Array
    """When the last change is over, s of the run."""
    kind: Kinds
    """STEP or DISTURBANCE."""
    signal: Kinds
    """ACTIVE or REACTIVE, of a step."""
    around: Around = NOTHING
    """Backgrounds and sensors."""
    networks: tuple[Networks, ...] | None = None
    """Load, fault and breaker of each case; None: those of the study. A change of them has its row in ``events``."""

    def __len__(self) -> int:
        return len(self.R_g)

    @classmethod
    def of_studies(
        cls, studies: Sequence[Study], silent_s: Array | float = 0.0, cleared_s: Array | None = None
    ) -> Self:
        """The events of studies of one converter as disturbances, with a grid that is told without an error.
        ``silent_s`` and ``cleared_s``: as the fields; None: when the last event is over."""
        none = np.zeros(len(studies))
        last = [max((event.t_s + event.over for event in study.events), default=0.0) for study in studies]
        return cls(
            R_g=np.array([study.grid.R_g for study in studies]),
            L_g=np.array([study.grid.L_g for study in studies]),
            V_g_rms=np.array([study.grid_source.V_g_rms for study in studies]),
            omega_g=np.array([study.grid_source.omega_g for study in studies]),
            P_ref=np.array([study.simulation.P_ref for study in studies]),
            Q_ref=np.array([study.simulation.Q_ref for study in studies]),
            events=LaneEvents.of([study.events for study in studies]),
            error_R=none,
            error_X=none,
            silent_s=none + silent_s,
            cleared_s=np.array(last) if cleared_s is None else cleared_s,
            kind=np.full(len(studies), DISTURBANCE, dtype=np.int8),
            signal=np.full(len(studies), ACTIVE, dtype=np.int8),
        )

    def besides(self, k: int) -> tuple[str, str]:
        """What is to be said of a case besides its start and its events: before them, and with the first one."""
        del k
        return "", ""

    @property
    def at_start(self) -> Lanes:
        """Grid, source and set points at the start."""
        return Lanes(self.R_g, self.L_g, self.V_g_rms, self.omega_g, self.P_ref, self.Q_ref)

    def references_at_end(self, nominal: References) -> References:
        """The set points after the last event, (N,). ``nominal``: those that hold where none was given."""
        start = nominal._replace(P_ref=self.P_ref, Q_ref=self.Q_ref)
        at_end = [np.array(np.broadcast_to(value, len(self)), dtype=float) for value in start]
        for k in range(self.events.count):
            for values, name in zip(at_end, References._fields, strict=True):
                given = getattr(self.events, name)[:, k]
                known = np.isfinite(given) & np.isfinite(self.events.t_s[:, k])
                values[known] = given[known]
        return References(*at_end)

    def links(self, link: DcLink | None) -> tuple[tuple[DcLink, ...], ...] | None:
        """The dc links of each case, from the start on and from each event on; None where no event changes them."""
        given = np.stack([getattr(self.events, name) for name in DC_QUANTITIES])
        if link is None or not np.isfinite(given).any():
            return None
        found = []
        for k in range(len(self)):
            now, held = dict[str, float](), [link]
            for values in given[:, k].T.tolist():
                new = {name: value for name, value in zip(DC_QUANTITIES, values, strict=True) if math.isfinite(value)}
                now |= new
                held.append(link.after(now) if new else held[-1])
            found.append(tuple(held))
        return tuple(found)

    def take(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> Self:
        """Some of the cases, by index or by mask."""
        parts = {f.name: getattr(self, f.name) for f in fields(self)}
        events, around, networks = parts.pop("events"), parts.pop("around").take(chosen), parts.pop("networks")
        some = LaneEvents(**{f.name: getattr(events, f.name)[chosen] for f in fields(events)})
        if networks is not None:
            networks = tuple(networks[k] for k in np.arange(len(self))[chosen].tolist())
        others = {name: values[chosen] for name, values in parts.items()}
        return type(self)(events=some, around=around, networks=networks, **others)

    def in_study(self, study: Study) -> LaneCases:
        """The cases with the network, in the background and with the sensors of a study, where they have none of their
        own."""
        if self.networks is None and not study.network.plain:
            return replace(self, networks=(((0.0, study.network),),) * len(self)).in_study(study)
        if self.around != NOTHING or study.undisturbed is study:
            return self
        around = Around.of(study, len(self))
        V_g_rms, omega_g = around.sources(self.V_g_rms, self.omega_g)
        events = self.events
        if around.replay is None:  # a record says what its source does
            per_event = around.sources(events.V_g_rms.T, events.omega_g.T)
            events = replace(events, V_g_rms=per_event[0].T, omega_g=per_event[1].T)
        return replace(self, V_g_rms=V_g_rms, omega_g=omega_g, events=events, around=around.neutral)

    def beside_twins(self) -> LaneCases:
        """Each of the cases, which are steps, and behind it its twin: the same without the step (:eq:`twin`). Its
        reference is set to what it is, at the same instant."""
        pairs = self.take(np.repeat(np.arange(len(self)), 2))
        twin = np.arange(len(pairs)) % 2 == 1
        held = {}
        for name, start in (("P_ref", pairs.P_ref), ("Q_ref", pairs.Q_ref)):
            given = getattr(pairs.events, name)
            held[name] = np.where(twin[:, None] & np.isfinite(given), start[:, None], given)
        return replace(pairs, events=replace(pairs.events, **held))

    def later(self, by_s: float) -> LaneCases:
        """The same cases with everything that happens later by a time."""
        events, networks = replace(self.events, t_s=self.events.t_s + by_s), self.networks
        if networks is not None:
            networks = tuple((one[0], *((t_s + by_s, network) for t_s, network in one[1:])) for one in networks)
        return replace(self, events=events, cleared_s=self.cleared_s + by_s, networks=networks)

    @property
    def ramped(self) -> NDArray[np.bool_]:
        """Whether a case has a ramp, (N,)."""
        return np.any(self.events.over > 0.0, axis=1)


def study_of_case(study: Study, cases: LaneCases, k: int, samples: int) -> Study:
    """The study of one case: its start, what is around it, its events, and a log of each of so many samples."""
    T_s, around = study.converter.T_s, cases.around
    return replace(
        study,
        grid=Grid(float(cases.R_g[k]), float(cases.L_g[k])),
        grid_source=replace(study.grid_source, V_g_rms=float(cases.V_g_rms[k]), omega_g=float(cases.omega_g[k])),
        background=None if around.backgrounds is None else around.backgrounds[k],
        sensors=None if around.sensors is None else around.sensors[k],
        network=study.network if cases.networks is None else cases.networks[k][0][1],
        events=_events_of(cases, k),
        simulation=replace(
            study.simulation,
            duration=samples * T_s,
            start="steady_state",
            log_interval=T_s,
            P_ref=float(cases.P_ref[k]),
            Q_ref=float(cases.Q_ref[k]),
        ),
    )


def _events_of(cases: LaneCases, k: int) -> tuple[Event, ...]:
    """The events of a case with what they change of its network."""
    events = cases.events.events(k)
    if cases.networks is None:
        return events
    changed = dict(cases.networks[k][1:])
    return tuple(replace(event, network=changed.get(event.t_s)) for event in events)


def no_events(count: int, each: int = 1) -> LaneEvents:
    """Events of ``count`` runs, ``each`` of a run, none of which ever comes: to be filled in."""
    unchanged = {name: np.full((count, each), np.nan) for name in ("R_g", "L_g", *_QUANTITIES)}
    none = {name: np.zeros((count, each)) for name in _NOTHING}
    return LaneEvents(t_s=np.full((count, each), np.inf), **unchanged, **none)


_OF_PLANT = ("R_g", "L_g", "V_g_rms", "omega_g", "over", "phase_jump")


def segments_of(cases: LaneCases) -> Segments:
    """The segments of every lane: one from the start on, one from each event on, and one from the end of each ramp on.

    An event that changes no more than a reference has none.
    """
    count, events = len(cases), cases.events
    rows = np.arange(count)
    present = Segments(
        t_s=np.zeros(count),
        R_g=cases.R_g.astype(float),
        L_g=cases.L_g.astype(float),
        V_g_rms=cases.V_g_rms.astype(float),
        V_slope=np.zeros(count),
        omega=cases.omega_g.astype(float),
        omega_slope=np.zeros(count),
        phase=np.full(count, cases.around.phase),
        place=np.zeros(count, dtype=np.int64),
    )
    found = [present]
    # The end of the ramp that runs, and the value that is held from there on.
    V_end_s, V_goal = np.full(count, np.inf), np.zeros(count)
    omega_end_s, omega_goal = np.full(count, np.inf), np.zeros(count)
    following = np.zeros(count, dtype=np.intp)
    padded = {name: np.column_stack([getattr(events, name), np.full(count, np.nan)]) for name in _OF_PLANT}
    times = np.column_stack([events.t_s, np.full(count, np.inf)])
    while True:
        event_s = times[rows, following]
        t_s = np.minimum(event_s, np.minimum(V_end_s, omega_end_s))
        some = np.isfinite(t_s)
        if not some.any():
            break
        now = present.at(np.where(some, t_s, present.t_s))
        V, V_slope, omega, omega_slope, phase = now.V_g_rms, now.V_slope, now.omega, now.omega_slope, now.phase
        ends = some & (t_s == V_end_s)
        V, V_slope, V_end_s = np.where(ends, V_goal, V), np.where(ends, 0.0, V_slope), np.where(ends, np.inf, V_end_s)
        ends = some & (t_s == omega_end_s)
        omega, omega_slope = np.where(ends, omega_goal, omega), np.where(ends, 0.0, omega_slope)
        omega_end_s = np.where(ends, np.inf, omega_end_s)
        comes = some & (t_s == event_s)
        given = {name: np.where(comes, values[rows, following], np.nan) for name, values in padded.items()}
        phase = phase + np.where(comes, np.nan_to_num(given["phase_jump"]), 0.0)
        over = np.where(comes, np.nan_to_num(given["over"]), 0.0)
        V, V_slope, V_end_s, V_goal = _ramped(V, V_slope, V_end_s, V_goal, given["V_g_rms"], over, t_s)
        omega, omega_slope, omega_end_s, omega_goal = _ramped(
            omega, omega_slope, omega_end_s, omega_goal, given["omega_g"], over, t_s
        )
        jumps = np.isfinite(given["R_g"])
        present = Segments(
            t_s=now.t_s,
            R_g=np.where(jumps, given["R_g"], now.R_g),
            L_g=np.where(jumps, given["L_g"], now.L_g),
            V_g_rms=V,
            V_slope=V_slope,
            omega=omega,
            omega_slope=omega_slope,
            phase=phase,
            place=now.place,
        )
        following = following + comes
        changed = some & np.any([new != old for new, old in zip(present[1:], now[1:], strict=True)], axis=0)
        found.append(present._replace(t_s=np.where(changed, t_s, np.inf)))
    stacked = Segments(*(np.stack(values, axis=1) for values in zip(*found, strict=True)))
    order = np.argsort(stacked.t_s, axis=1, kind="stable")
    most = int(np.isfinite(stacked.t_s).sum(axis=1).max(initial=1))
    return Segments(*(np.take_along_axis(values, order, axis=1)[:, :most] for values in stacked))


def _ramped(
    value: Array, slope: Array, end_s: Array, held: Array, goal: Array, over: Array, t_s: Array
) -> tuple[Array, Array, Array, Array]:
    """Value, slope, end and final value after an event that steps or ramps to ``goal`` (NaN: does not)."""
    steps, ramps = np.isfinite(goal) & (over == 0.0), np.isfinite(goal) & (over > 0.0)
    safe = np.where(ramps, over, 1.0)
    return (
        np.where(steps, goal, value),
        np.where(steps, 0.0, np.where(ramps, (goal - value) / safe, slope)),
        np.where(steps, np.inf, np.where(ramps, t_s + over, end_s)),
        np.where(ramps, goal, held),
    )
