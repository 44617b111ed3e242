"""Lanes of one kind, packed into groups: their rows, their program, and what they have watched at the end."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import aligned_zeros
from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.controller_data import ControllerState
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.equations.power_loops import References
from vsgdesign.linear.operating_point.dc_rest import power_of_plant
from vsgdesign.linear.operating_point.many import ManyStates
from vsgdesign.metrics.events import late_rows
from vsgdesign.metrics.step_response import SETTLING_BAND
from vsgdesign.metrics.survival import END_S, FIRST_S, SAME_ROW, SurvivalDemand
from vsgdesign.simulation.batch import Batch, Log
from vsgdesign.simulation.circuit_program import SAME_INSTANT, CircuitProgram, ProgramWriter
from vsgdesign.simulation.circuits import Circuits
from vsgdesign.simulation.dc_beyond import Outside
from vsgdesign.simulation.dc_start import clamp_at_rest, dc_changed
from vsgdesign.simulation.lanes.cases import ACTIVE, STEP, LaneCases, segments_of, study_of_case
from vsgdesign.simulation.lanes.feed import FED_SAMPLES, LaneFeed, put_phasors, take_up_phasors
from vsgdesign.simulation.lanes.rests import Rests, cycles_at_end
from vsgdesign.simulation.loop import Build, kind_of, side_by_side, watched_names
from vsgdesign.simulation.run_kind import DISTURBANCE, Kind
from vsgdesign.simulation.run_kind import STEP as STEP_WATCHED
from vsgdesign.simulation.timeline import build_timeline, segments_of_timelines
from vsgdesign.study.parameters.dc_link import DcLink
from vsgdesign.study.parameters.event_kinds import DC_QUANTITIES
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Samples = NDArray[np.int64]

PROTECTION_COLUMNS = 3
"""Numbers of a sample that are logged where a protection is judged: frequency, and both components of the voltage."""

LOOK_SAMPLES = 128
"""After so many samples a part looks which dc links are outside of their limits."""


class Watched(Protocol):
    """Lanes of one converter each that are watched: a part, or one unit of each plant of a part."""

    place: dict[str, int]
    kept: dict[str, int]
    study: Study
    cases: LaneCases
    index: NDArray[np.intp]
    ends: Samples
    cycle: int
    beside: bool
    mains: slice
    guarded: bool
    cycle_at_end: Samples
    outside: Outside | None
    """The dc links that have left their limits; None: they are ideal."""

    def __len__(self) -> int: ...

    @property
    def end(self) -> int: ...

    @property
    def means(self) -> Log | None: ...

    def span(self, name: str) -> slice: ...

    def get(self, row: int | str) -> Array: ...

    def put(self, row: int | str, values: Any) -> None: ...

    def watched(self, name: str) -> Array: ...

    def logged(self, columns: slice) -> Iterator[tuple[slice, Array]]: ...

    def run(self, begin: int, end: int) -> None: ...


class Part(Batch):
    """Cases of a batch that are of one kind, in descending order of their ends."""

    def __init__(
        self,
        kind: Kind,
        study: Study,
        build: Build,
        cases: LaneCases,
        index: NDArray[np.intp],
        ends: Samples,
        *,
        cycle: int,
        shared: Mapping[str, float],
        beside: bool = False,
    ) -> None:
        """``cases`` (n) run for ``ends`` samples (n,), and ``index`` (n,) says which of the batch they are; ``cycle``:
        samples over which means are taken. ``beside``: behind each case is its twin."""
        means = ("watched.sum_P", "watched.sum_Q") if kind.watch == DISTURBANCE else ("power",)
        means = means if kind.own_rest else ()
        node = "true" if kind.sensors else "measured"
        guarded = ("said.omega", f"{node}.v_alpha", f"{node}.v_beta")
        self.guarded = study.protection is not None and kind.watch == DISTURBANCE
        """Whether the protection of the study is judged: its columns are logged after those of the means, from the
        first sample on."""
        logged = (*means, *(guarded if self.guarded else ()))
        kept = {"watch": len(watched_names(kind)), "limited": 1, "late": 1, "limited_at_end": 1}
        kept |= {} if kind.dc is None else {"dc_lowest": 1, "dc_highest": 1}
        kept |= dict.fromkeys(("first", "least", "most"), cases.events.count)
        begin = 0 if self.guarded or not logged else int(first_judged(cases, study.converter.T_s).min())
        if kind.watch != DISTURBANCE:  # before the step there is the mean with which it begins
            begin = max(begin - cycle, 0)
        shared = {**shared, "log_begin": begin - 1.0} if kind.waits else shared
        super().__init__(kind, study, len(cases), build, logged=logged, kept=kept, shared=shared)
        self.cases, self.index, self.ends, self.cycle = cases, index, ends, cycle
        self.beside, self.mains = beside, slice(None, None, 2 if beside else None)
        """Whether behind each case is its twin, and the cases themselves."""
        self.cycle_at_end = np.zeros(len(cases), dtype=np.int64)
        """Samples of a cycle of the grid at the end, (n,)."""
        self.slots: Array | None = None
        """Where lanes that wait log, each of them samples of its own, one after the other (G, L, slots, n)."""
        self.outside = None if study.dc is None else Outside(study, self.place, len(cases))
        if logged:
            groups, _, width = self.rows.shape
            slots = self.end - begin
            if kind.waits:  # what is too early lands in the first slot
                self.slots = aligned_zeros((groups, width, slots + 1, len(logged)))
                rows = self.slots[:, :, 1:].transpose(0, 2, 3, 1)
            else:
                rows = aligned_zeros((groups, slots, len(logged), width))
            self.log(Log(rows, logged, begin=begin))
        self.feed: LaneFeed | None = None
        """What the lanes are given sample by sample; None: nothing."""

    @property
    def end(self) -> int:
        """The sample up to which the part has to run: one beyond its last, so that what is kept at an end is kept."""
        return int(self.ends[0]) + 1

    @property
    def means(self) -> Log | None:
        """Where a rest of its own is judged, the power that is stepped, or the sums of both over a cycle."""
        return self.logs[0] if self.kind.own_rest else None

    def logged(self, columns: slice) -> Iterator[tuple[slice, Array]]:
        """The lanes of each group, with some columns of their log (S, n, W)."""
        width = self.spec.width
        for k, log in enumerate(self.logs[0].rows if self.logs else ()):
            lanes = slice(k * width, min((k + 1) * width, len(self)))
            yield lanes, log[:, columns, : lanes.stop - lanes.start]

    def run(self, begin: int, end: int) -> None:
        """Runs the samples from ``begin`` up to before ``end`` of every group that is not over."""
        active, end = -(-int((self.ends + 1 > begin).sum()) // self.spec.width), min(end, self.end)
        if active and self.feed is None:
            self._advance(begin, end, None, active)
        elif active and self.feed is not None:
            for at in range(begin, end, FED_SAMPLES):
                until = min(at + FED_SAMPLES, end)
                whole = np.full(len(self), at), np.full(len(self), until - at)
                self._advance(at, until, self.feed.given(*whole, 0, active), active)

    def _advance(self, begin: int, end: int, fed: Array | None, active: int) -> None:
        """:meth:`advance`, with a look at the dc links now and then."""
        for at in range(begin, end, LOOK_SAMPLES if self.outside is not None else max(end - begin, 1)):
            until = min(at + LOOK_SAMPLES, end) if self.outside is not None else end
            self.advance(at, until, None if fed is None else fed[:, at - begin : until - begin], active)
            self.look()

    def look(self) -> None:
        """Looks at the dc links."""
        if self.outside is not None:
            self.outside.look(self.get)

    def watched(self, name: str) -> Array:
        """What was watched up to the end of every run, (n,)."""
        return self.get(self.kept["watch"] + self.place[f"watch.{name}"] - self.span("watch").start)


def padded(values: Array, groups: int, width: int) -> Array:
    """(n,) values of lanes as (G, L), the last lane again in the places that are left."""
    full = np.empty(groups * width)
    full[: len(values)], full[len(values) :] = values, values[-1]
    return full.reshape(groups, width)


def at_or_after(t_s: Array, T_s: float, slack: float) -> Samples:
    """The first sample that lies at most ``slack`` samples before an instant; a very late one where there is none."""
    return np.ceil(np.minimum(t_s / T_s, 2.0**40) - slack).astype(np.int64)


def first_judged(cases: LaneCases, T_s: float) -> Samples:
    """The first sample that a settling time or a recovery counts, (n,): that of the step, or that of the clearing."""
    step = cases.kind == STEP
    return np.where(step, at_or_after(cases.events.t_s[:, 0], T_s, 0.5), at_or_after(cases.cleared_s, T_s, 1e-9))


def make_part(  # noqa: PLR0913 - everything that a part is made of
    study: Study,
    cases: LaneCases,
    index: NDArray[np.intp],
    rests: Rests,
    ends: Samples,
    demand: SurvivalDemand,
    *,
    step: bool,
    ramped: bool,
    bridge: str,
    strict: bool,
    listening: bool = False,
    beside: bool = False,
    target: str = "native",
) -> Part:
    """A part of the cases of one kind, which are ``cases`` with their ``rests`` and ends, and ``index`` in the batch.
    ``beside``: each of them goes beside its twin, in the next lane.

    ``demand``: what is asked of a disturbance, with the cycle of these cases, or that over which the power of a step is
    judged. ``listening``: a field estimator does.
    """
    order = np.argsort(-ends, kind="stable")
    if beside:
        order = np.repeat(order, 2)
        cases = cases.take(order[::2]).beside_twins()
    else:
        cases = cases.take(order)
    index, rests, ends = index[order], rests.take(order), ends[order]
    sensors, own_rest = cases.around.act, beside or bridge == "pwm" or cases.around.distort(study)
    # The loop itself turns what is constant; all else is fed, as in a run of its own.
    distorted, linked = cases.around.distort(study), cases.networks is not None
    moved = cases.around.moves or (ramped and (sensors or distorted or linked)) or (linked and distorted)
    waves = None if moved else cases.around.waves(study, len(cases))
    segments, lines, circuits = segments_of(cases), [], None
    studies = [study_of_case(study, cases, k, int(end)) for k, end in enumerate(ends)] if moved or linked else []
    if studies:
        lines = [build_timeline(one) for one in studies]
        edged = kind_of(study, switched=bridge == "pwm").edged
        circuits = Circuits(study, lines, switched=edged, states=rests.states)
        segments = segments_of_timelines(lines, circuits.place)
    watch = STEP_WATCHED if step else DISTURBANCE
    kind = kind_of(study, switched=bridge == "pwm", axes=None if circuits is None else circuits.axes)
    kind = kind._replace(ramped=ramped and not moved, moved=moved, watch=watch, own_rest=own_rest)
    kind = kind._replace(sensors=sensors, field=listening, waits=listening, network=linked)
    kind = kind if waves is None else kind._replace(waves=waves.order.shape[1])
    c = study.converter
    limit = c.I_rated_pk * (demand.i_max_pu if demand.i_max_pu is not None else 1e6)
    cycle = max(round(demand.cycle_s / c.T_s), 1)
    shared = {
        "of.band": SETTLING_BAND if step else demand.band,
        "of.per_S": 1.0 / c.S_rated,
        "of.per_cycle": 1.0 / cycle,
        "load_of.limit_sq": limit * limit,
    }
    build = side_by_side(strict=strict, target=target)
    part = Part(kind, study, build, cases, index, ends, cycle=cycle, shared=shared, beside=beside)
    writer = ProgramWriter()
    part.cycle_at_end[:] = cycles_at_end(study, segments)
    _rest(part, cases, rests)
    put_phasors(part, np.full(len(part), cases.around.phase), waves)
    circuit = CircuitProgram(study, kind, part.spans, writer, segments, circuits, waves=waves)
    circuit.write()
    if sensors or moved:
        part.feed = LaneFeed(part, beside=beside)
    if part.feed is not None and sensors:
        part.feed.add_sensors(cases.around.sensors or (), np.array(rests.start.plant), cases.omega_g)
    if part.feed is not None and circuits is not None and moved:
        part.feed.add_sources(writer, studies, lines, circuits)
    elif waves is not None or sensors:
        take_up_phasors(part, writer, cases, segments, waves, part.end)
    put_references(part, writer, cases)
    put_links(part, writer, cases)
    (watch_step if step else watch_disturbance)(part, writer, cases, rests)
    if moved and not step:
        at_start = np.array([one.source_phase(np.zeros(1))[0] for one in lines])
        part.put("watch.delta", rests.start.controller.theta - at_start)
    lanes, watched = np.arange(len(cases)), part.span("watch")
    writer.copy(lanes, ends, part.kept["watch"], watched.stop - watched.start, watched.start)
    writer.copy(lanes, ends, part.kept["limited_at_end"], 1, part.place["limited"])
    keep_links(part, writer)
    _means(part, cases, rests, cycle)
    part.follow(writer, circuit.cut)
    return part


def _means(part: Part, cases: LaneCases, rests: Rests, cycle: int) -> None:
    """What is judged by its mean over a cycle has been at rest for one."""
    ringed = [name for name, _ in part.spec.rings]
    if not ringed:
        return
    present = means_at_rest(part, cases, rests, cycle)
    groups, _, width = part.rows.shape
    part.rings = aligned_zeros((groups, cycle, len(ringed), width))
    part.ring_length = np.full(groups, cycle, dtype=np.int64)
    for k, name in enumerate(ringed):
        part.rings[:, :, k] = padded(present[name], groups, width)[:, None]


def means_at_rest(part: Watched, cases: LaneCases, rests: Rests, cycle: int) -> dict[str, Array]:
    """Sets the sums over a cycle to those of the rest, and returns what is read again a cycle later, (n,) by name."""
    P_or_Q = np.where(cases.signal == ACTIVE, rests.P_start, rests.Q_start)
    present = {"P_ago": rests.P_start, "Q_ago": rests.Q_start, "power_ago": P_or_Q}
    sums = {"P_ago": "watch.sum_P", "Q_ago": "watch.sum_Q", "power_ago": "watch.sum"}
    for name, row in sums.items():
        if row in part.place:
            part.put(row, cycle * present[name])
    if "watch.mean" in part.place:
        part.put("watch.mean", P_or_Q)
    return present


def _rest(part: Part, cases: LaneCases, rests: Rests) -> None:
    """The lanes at rest."""
    start, place = rests.start, part.place
    for name, values in _flat(start.controller):
        part.put(f"state.{name}", values)
    for row, values in enumerate(start.plant):
        part.put(part.span("x").start + row, values)
    if part.kind.bridge.delayed:
        for row, values in enumerate(start.pending):
            part.put(part.span("pending").start + row, values)
    if "watch.entry.last_out" in place:
        part.put("watch.entry.last_out", np.full(len(part), -1.0))
    if part.study.dc is not None:
        _rest_link(part, part.study.dc, start, cases)
    nominal = part.study.converter.references()
    for name, value in zip(References._fields, (cases.P_ref, cases.Q_ref, nominal.omega_0, nominal.V_n), strict=True):
        if f"refs.{name}" in place:
            part.put(f"refs.{name}", np.broadcast_to(value, len(part)))
    part.put("V_g", rms_to_peak(cases.V_g_rms))
    for name in ("R_g", "L_g"):
        if f"circuit.{name}" in place:
            part.put(f"circuit.{name}", getattr(cases, name))


def _rest_link(part: Part, link: DcLink, start: ManyStates, cases: LaneCases) -> None:
    """The dc links of the lanes at rest."""
    study = part.study
    powers = power_of_plant(study, start.plant).tolist()
    rows = [numbers_of(link.at_rest(p, study.converter, study.filter)) for p in powers]
    part.put(part.span("dc").start, np.array(rows).T)
    constants = numbers_of(link.settings(study.converter, study.filter))
    part.put(part.span("link").start, np.repeat(np.array(constants)[:, None], len(part), axis=1))
    if link.clamps:
        part.put(part.span("clamp").start, np.array([clamp_at_rest(omega) for omega in cases.omega_g.tolist()]).T)
        of = np.array(link.clamp(study.converter, study.filter))
        part.put(part.span("clamp_of").start, np.repeat(of[:, None], len(part), axis=1))
    if link.droops:
        part.put("droop_of.per_volt", np.full(len(part), link.droop(study.converter).per_volt))


def _flat(state: ControllerState) -> list[tuple[str, Array]]:
    found = [(name, values) for name, values in state._asdict().items() if name != "limiter"]
    return found + [(f"limiter.{name}", values) for name, values in state.limiter._asdict().items()]


def put_references(part: Watched, writer: ProgramWriter, cases: LaneCases) -> None:
    """Changes of the references: in force at the first sample at or after their time."""
    events, T_s = cases.events, part.study.converter.T_s
    for k in range(events.count):
        for name in References._fields:
            some = np.flatnonzero(np.isfinite(getattr(events, name)[:, k]) & np.isfinite(events.t_s[:, k]))
            if some.size:
                at = at_or_after(events.t_s[some, k], T_s, SAME_INSTANT)
                writer.put(some, at, part.place[f"refs.{name}"], getattr(events, name)[some, k])


def put_links(part: Watched, writer: ProgramWriter, cases: LaneCases) -> None:
    """Changes of the sources of the dc links: in force at the first sample at or after their time."""
    study, events = part.study, cases.events
    for lane, held in enumerate(cases.links(study.dc) or ()):
        for j, link in enumerate(held[1:]):
            given = {name: float(getattr(events, name)[lane, j]) for name in DC_QUANTITIES}
            changed = {name: value for name, value in given.items() if math.isfinite(value)}
            at = at_or_after(events.t_s[lane, j : j + 1], study.converter.T_s, SAME_INSTANT)
            for name, values in dc_changed(study, link, changed) if changed else ():
                writer.put([lane], at, part.span(name).start, values[None])


def keep_links(part: Watched, writer: ProgramWriter) -> None:
    """The least and the largest voltage of the dc links up to the ends."""
    for name in ("lowest", "highest") if part.study.dc is not None else ():
        writer.copy(np.arange(len(part)), part.ends, part.kept[f"dc_{name}"], 1, part.place[f"dc.{name}"])


def _load(part: Watched, writer: ProgramWriter, lanes: NDArray[np.intp], t_s: Array, at: Samples, first: bool) -> None:
    """The current counts from an event on, apart in its first 5 ms."""
    place, T_s = part.place, part.study.converter.T_s
    if first:
        writer.put(lanes, at, place["load_of.after"], np.ones(len(lanes)))
        writer.copy(lanes, at + 1, part.kept["limited"], 1, place["limited"])
    writer.put(lanes, at, place["load_of.first"], np.ones(len(lanes)))
    # The end of the 5 ms of one event must not end those of the next.
    writer.put(lanes, at_or_after(t_s + FIRST_S, T_s, 0.5), place["load_of.first"], np.zeros(len(lanes)))


def watch_step(part: Watched, writer: ProgramWriter, cases: LaneCases, rests: Rests) -> None:
    """A step is watched from its event on."""
    place, T_s = part.place, part.study.converter.T_s
    active = cases.signal == ACTIVE
    if "of.final" in place:
        part.put("of.initial", np.where(active, rests.P_start, rests.Q_start))
        part.put("of.final", np.where(active, rests.P_end, rests.Q_end))
    part.put("of.of_P", active.astype(float))
    part.put("of.of_Q", (~active).astype(float))
    lanes, t_s = np.arange(len(cases)), cases.events.t_s[:, 0]
    at = at_or_after(t_s, T_s, 0.5)
    if part.means is None:
        _entry_anew(part, writer, lanes, at)
        writer.put(lanes, at, place["watch.most"], np.zeros(len(lanes)))
        writer.copy(lanes, at, place["of.initial"], 1, place["watch.mean"])
    else:
        late = part.ends - late_rows(part.ends - at, part.cycle_at_end)
        writer.put(lanes, late, place["watch.late"], np.zeros(len(lanes)))
    _load(part, writer, lanes, t_s, at, first=True)


def _entry_anew(part: Watched, writer: ProgramWriter, lanes: NDArray[np.intp], at: Samples) -> None:
    writer.put(lanes, at, part.span("watch.entry").start, np.tile([-1.0, 0.0, 0.0, 0.0], (len(lanes), 1)))


def watch_disturbance(part: Watched, writer: ProgramWriter, cases: LaneCases, rests: Rests) -> None:
    """A disturbance is watched from its first event on, its recovery from its end on, and the angle after each."""
    place, kept, T_s, events = part.place, part.kept, part.study.converter.T_s, cases.events
    clamps = part.study.dc is not None and part.study.dc.clamps
    part.put("of.P_rest", rests.P_asked if clamps else rests.P_end)  # a clamp says in each sample what is left of it
    if clamps:
        part.put(part.span("rest_of").start, rests.curve.T)
    else:
        part.put("of.Q_rest", rests.Q_end)
    part.put("watch.delta", rests.delta_start)
    least = place["watch.least"]
    for k in range(events.count):
        lanes = np.flatnonzero(np.isfinite(events.t_s[:, k]))
        t_s = events.t_s[lanes, k]
        at = at_or_after(t_s, T_s, SAME_ROW)
        writer.copy(lanes, at, kept["first"] + k, 1, place["watch.delta"])
        if k > 0:
            writer.copy(lanes, at, kept["least"] + k - 1, 1, least)
            writer.copy(lanes, at, kept["most"] + k - 1, 1, least + 1)
        writer.put(lanes, at, least, np.tile([np.inf, -np.inf], (len(lanes), 1)))
        _load(part, writer, lanes, t_s, at, first=k == 0)
    everyone = np.arange(len(cases))
    if part.means is None:
        _entry_anew(part, writer, everyone, first_judged(cases, T_s))
    late = part.ends - np.int64(math.floor(END_S / T_s + 1e-6))
    writer.copy(everyone, late, kept["late"], 1, place["limited"])
