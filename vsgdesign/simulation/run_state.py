"""One run of a batch: what Python does for it where a stretch begins and ends, and what it logs."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.controller import ControllerState, GridWatch
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.equations.grid import capacitor_node_voltage
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.linear.operating_point.network import NetworkCircuit
from vsgdesign.linear.operating_point.sampled import SampledState
from vsgdesign.runtime.schedule import on_floats
from vsgdesign.simulation.added_source import Added, AddedSource, adds_to_source, sensors_of
from vsgdesign.simulation.batch import STANDS, Batch
from vsgdesign.simulation.circuit_program import SAME_INSTANT, CircuitProgram, CutSample, ProgramWriter
from vsgdesign.simulation.circuits import Circuits, connection_at, states_of_timelines
from vsgdesign.simulation.clearing import SLACK, SampleOfFault
from vsgdesign.simulation.dc_start import BLOCKS_AT, blocked, dc_at_start, dc_changed
from vsgdesign.simulation.feeds import LateSchedule
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.field_observer import HeldProbe, add_offset
from vsgdesign.simulation.gains import gain_changes, with_gains
from vsgdesign.simulation.online import Hears
from vsgdesign.simulation.outcome import Divergence, outside
from vsgdesign.simulation.run_asked import RunLog, RunOf, Twin, feed_of_run
from vsgdesign.simulation.run_kind import SYNC
from vsgdesign.simulation.sample import Relay, relay_sees
from vsgdesign.simulation.search import Search, check_setting
from vsgdesign.simulation.timeline import build_timeline, segments_of_timelines

Array = NDArray[np.float64]

_relay_sees = on_floats(relay_sees)


_AHEAD = 31
"""So many stretches may be computed together with the one before them."""

_MOST_SAMPLES = 400_000
"""So many samples at most does a run have that goes side by side with another one: their logs then take 0.1 GB."""


class RunState:
    """A run that is under way."""

    def __init__(self, of: RunOf) -> None:
        """Raises InfeasibleStudyError where the scheduler's or the probe's period does not fit the sampling."""
        self.of, self.search = of, Search(of.study, finds=of.finds is not None)
        self.study = self.search.study
        """With the instants that are found so far."""
        self.timeline = build_timeline(self.study)
        self.T_s = self.study.converter.T_s
        self.samples = round(self.study.simulation.duration / self.T_s)
        self.feed = feed_of_run(of, self.timeline)
        if self.study is not of.study:
            self._follow_feed()
        self.late = self._late()
        """The schedule of a table whose updates are those of all runs side by side; None: the run makes its own."""
        thin = of.rows if of.rows is not None and of.rows.thin else None
        self.kept = round(self.study.simulation.log_interval / self.T_s) if thin is None else thin.every
        self.log_every = math.gcd(self.kept, self.feed.log_samples)  # a scheduler's samples are taken from the log
        self.divergence: Divergence | None = None
        self.ended = self._end()
        """The sample before which the run ends."""
        self.loop_seconds = 0.0
        """Wall time inside the compiled loop."""
        self.twins: tuple[Twin, ...] = ()
        """What became of the twins that were asked for."""

    def _late(self) -> LateSchedule | None:
        schedule, beside = self.of.schedule, self.of.together and not self.goes_alone
        if not beside or not isinstance(schedule, LateSchedule) or schedule.runtime is None:
            return None
        return schedule if self.feed.leave_updates() else None

    @property
    def goes_alone(self) -> bool:
        """Whether the run has something that one of several side by side cannot have, or that would change its bits
        there, or is so long that the logs of several would take much memory."""
        of, study = self.of, self.study
        own = (of.probe, of.circuit, of.every_sample, self.feed.memory, self.feed.probe_hold, study.sensors, study.dc)
        several = of.twins or of.log_states or self.samples > _MOST_SAMPLES
        return bool(several) or any(one is not None for one in own)

    @property
    def like(self) -> Hashable:
        """What runs of one converter and controller have in common that can go side by side."""
        adds = adds_to_source(self.timeline)
        states = states_of_timelines([self.timeline])
        return self.search.seeks, states, adds, self.kept, self.log_every, self.of.rows, self.late is None

    def begin(self, batch: Batch, number: int, start: SampledState, circuits: Circuits) -> None:
        """Puts the run, which is the ``number``-th of a batch, at its start."""
        study = self.study
        self._like = start.controller
        names = ("x", "state", "limited", "refs", "power_gains", "grid", "source", "V_g", "seek.found", "seek.phases")
        names += ("seek.relay", "seek.relay.on", "seek.own_relay", "seek.behind_relay")
        names += ("dc.lowest", "dc.highest", "clamp.cut")
        self._now = {name: batch.view(name, number) for name in names if name in batch.spans}
        """The numbers of the run that Python reads or sets."""
        batch.set("x", start.plant.tolist(), number)
        batch.set("state", start.controller, number)
        if batch.kind.bridge.delayed:
            batch.set("pending", start.pending, number)
        self._sensors = sensors_of(study, start.plant, self.timeline.source_at(0.0).omega)
        if self._sensors is not None:
            batch.set("sensors", numbers_of(self._sensors.constants), number)
            batch.set("before", self._sensors.before, number)
        if self.feed.memory is not None:
            self.feed.memory.moves_in(batch.view("lock", number))
        if study.dc is not None:
            dc = dc_at_start(study, start.plant, self.timeline.source_at(0.0).omega)
            for name in dc._fields:
                if name in batch.spans:
                    batch.set(name, numbers_of(getattr(dc, name)), number)
        self._batch, self._number, self._circuits, self._before = batch, number, circuits, None
        self._added = self._added_source()
        self.log = RunLog(batch, number, -(-self.samples // self.log_every), self.of.every_sample)
        self.feed.sensed, self.feed.more = self.log.sensed, self.log.more
        hold = self.feed.probe_hold if self.of.probe is None else self.of.probe.hold
        self._held = None if hold is None else HeldProbe(hold, study, self.samples)
        self.feed.held = self._held
        probes = hold is not None or isinstance(self.of.schedule, FieldScheduler)
        if SYNC in batch.kind.seeks and any(one.synchronised_until is not None for one in study.events):
            check_setting(self.timeline, probes)
        self._gains, self._refs = self.feed.first(), self._references(0)
        self._state, self._offset = self._read_state(), None
        self._put: dict[str, object] = {}  # what the loop was given last
        self._at_end = self._now["x"].copy(), 0
        """The circuit's states at the end of the run, and in how many samples it has limited its current."""
        self._stops: list[int] | None = None
        self._fed: tuple[int, int, Added | None] = (-1, 0, None)
        """Of the present stretch, and which it is."""
        self._since = 0
        """From here on the run has the events that it has now."""
        self._begun = 0
        """The sample with which the stretch begins that is under way."""

    def _end(self) -> int:
        end_s = math.inf if self.of.ends is None else self.of.ends(self.study)
        return self.samples if math.isinf(end_s) else min(round(end_s / self.T_s), self.samples)

    def marks(self) -> list[int]:
        """The samples at which a stretch of this run begins, and its last one, in ascending order."""
        samples = self.ended
        cuts = {0, samples} | self._added.marks(samples)
        cuts |= set() if self._held is None else self._held.cuts(samples)
        cuts |= {math.ceil(t_s / self.T_s - 1e-6) for t_s, _ in self.timeline.references}
        quiet = self.feed.quiet(samples) - cuts
        self._quiet = quiet if self.late is not None else {k for k in quiet if not self._added.adds(k)}
        return sorted(k for k in cuts | self.feed.cuts(samples) if 0 <= k <= samples)

    def stops(self, marks: list[int]) -> list[int]:
        """The samples at which the loop has to end, in ascending order: the marks, but not where a schedule is going to
        say what it said before, and what is looked at apart. The source takes up its phase at the marks alone."""
        apart = {at for k in self.search.special(self.timeline) for at in (k, k + 1) if at <= self.ended}
        return sorted(apart.union(mark for mark in marks if mark not in self._quiet))

    @property
    def own_stops(self) -> list[int]:
        """The samples at which the loop has to end for this run."""
        if self._stops is None:
            self._stops = self.stops(self.marks())
        return self._stops

    def phasors(self, marks: list[int]) -> Array:
        """Of the source at samples, (n, 2)."""
        return self._added.phasors(marks)

    def before(self, first: int) -> None:
        """What happens before the first sample of a stretch: gains, references, a probe, the grid behind a breaker."""
        feed = self.feed
        if first >= self.ended:
            return
        self._begun = first
        read, refs = self._state, self._references(first)
        feed.limited_samples = int(self._now["limited"][0])
        gains = feed.update(first, self._gains, read, refs, self.log.rows, self.log_every)
        # With the references of the samples before: a step of them at this sample belongs to the new gains.
        state = with_gains(read, self._followed(), self._gains, gains)
        self._gains, self._refs = gains, refs
        if self._held is not None:
            self._held.ask(first, feed.wanted() if self.of.probe is None else self.of.probe)
            refs = self._held.references(first, refs)
            self._offset = self._held.offset(first, state.V)
            state = add_offset(state, *self._offset)
        if state is not read or first == 0:
            self._put_state(state)
        self._put_changed("refs", refs)
        self._put_gains(first)
        self._before = self._batch.state(self._number) if first in self.search.special(self.timeline) else None

    def fed(self, first: int, count: int, *, anew: bool = False) -> tuple[Array | None, Array | None, Array | None]:
        """What the run is given over a stretch: what is added to the source (count, states + 2), over the later pieces
        of its interval (pieces − 1, states), and the noise of the sensors (count, 9). None: nothing. ``anew``: a sample
        is computed again."""
        if first >= self.ended:
            return None, None, None
        begin, length = (first, count) if anew else self._own_stretch(first, count)
        if anew or self._fed[:2] != (begin, length):
            later = [] if anew else self._stops_after(begin + length)
            added = self._added.over(begin, length, later)
            if not anew:
                self._fed = begin, length, added
        else:
            added = self._fed[2]
        noise = None if self._sensors is None else self._sensors.noise(first, count)
        if added is None:
            return None, None, noise
        return added.rows[first - begin : first - begin + count], added.others, noise

    def _own_stretch(self, first: int, count: int) -> tuple[int, int]:
        """First sample and length of the stretch that this run alone would be in: what is added is computed from its
        beginning, so that its bits are the same beside others, at whose stops the loop ends as well."""
        stops = self.own_stops
        at = bisect_right(stops, first)
        begin = max(stops[at - 1], self._since) if at else self._since
        return begin, max(stops[at] - begin if at < len(stops) else 0, first + count - begin)

    def _stops_after(self, sample: int) -> list[int]:
        """Some of those that follow a stop; none where it is not one."""
        stops = self.own_stops
        at = bisect_right(stops, sample)
        return stops[at : at + _AHEAD] if at and stops[at - 1] == sample else []

    def conclude(self, done: int) -> bool:
        """Ends the cycle of a field estimator, if one ends before sample ``done``. Returns whether the run goes on: it
        does not if it has diverged."""
        state = self._read_state()
        if self._outside(state) is not None:
            return False
        if not self.feed.closed:
            return True
        gains = self.feed.conclude(done, self._gains, state)
        self._put_state(with_gains(state, self._followed(), self._gains, gains))
        self._gains = gains
        self._put_gains(done)
        return True

    def after(self, done: int) -> None:
        """What happens after the last sample of a stretch, before sample ``done``. The run may have diverged."""
        if done > self.ended:
            return
        self._take_offset_away()
        why = self._outside(self._state)
        if why is not None:
            good = self.log.good(self.study, self._begun, done)
            diverged_s, whole = good * self.T_s, self._blocked() is None
            said = f"the simulation diverged at {diverged_s:.4g} s" if whole else BLOCKS_AT.format(diverged_s)
            self.divergence = Divergence(diverged_s, f"{said}: {why}", blocked=not whole)
            self.log.end(good)
            self.ended, self._stops = done, None
        if done == self.ended:  # others beside it may go on
            self._at_end = self._now["x"].copy(), int(self._now["limited"][0])

    def _take_offset_away(self) -> None:
        state = self._read_state()
        if self._offset is not None:
            state = add_offset(state, -self._offset[0], -self._offset[1])
            self._put_state(state)
        self._state = state

    @property
    def gains(self) -> PowerLoopGains:
        """The present gains."""
        return self._gains

    @property
    def too_short(self) -> bool:
        """Whether it has diverged before two rows of its log."""
        seen = self.of.every_sample
        rows, apart = (self.log.length, self.kept // self.log_every) if seen is None else (seen.length, 1)
        if self.log.seen is not None:
            rows, apart = self.log.samples, 1
        return self.divergence is not None and rows <= apart

    def looks_at(self, sample: int) -> bool:
        """Whether it looks at the interval of a sample whatever the loop has found there."""
        return self._before is not None and sample == self._begun

    def look(self, sample: int, fed: Callable[[], Array | None]) -> bool:
        """Takes up the instants in the interval of a sample that has been computed, if there are any. ``fed``: what the
        batch is given in it. Returns whether the run goes on with other events than before."""
        batch, number = self._batch, self._number
        if not batch.kind.seeks or sample >= self.ended:
            return False
        found, special = batch.found(number), self._before
        self._now["seek.found"][:] = 0.0
        if 0.0 < found < STANDS:  # the breaker closes before the next sample
            self.search.closed((sample + 1) * self.T_s, None)
            self._follow(sample + 1)
            return True
        if found < STANDS and (special is None or sample != self._begun):
            return False

        def computed() -> Array:
            return batch.after_cut(batch.cut_at(number, sample), fed())

        after = batch.state(number) if found < STANDS else computed()
        if found < STANDS and special is not None:
            batch.put_state(number, special)
        changed, lead = False, self._lead(sample) if found >= STANDS else None
        if lead is not None:
            self.search.closed(sample * self.T_s, lead)
            self._now["seek.relay.on"][:] = 0.0
            self._follow(sample)
            changed, after = True, computed()
        crossed = found >= STANDS and lead is None
        while self._passes_zero(sample, after, crossed):
            self._now["seek.phases"][:] = 0.0
            self._follow(sample)
            changed, after, crossed = True, computed(), False
        batch.put_state(number, after)
        if changed:
            self._since = sample + 1
        return changed

    def _lead(self, sample: int) -> float | None:
        """By how much the converter's side of a breaker that closes before a sample leads, rad; None: none closes."""
        if "seek.relay" not in self._now:
            return None
        own, behind = (GridWatch(*self._now[f"seek.{side}_relay"].tolist()) for side in ("own", "behind"))
        x = self._now["x"]
        v = [float(capacitor_node_voltage(x[k], x[2 + k], x[4 + k], self.study.circuit())) for k in (0, 1)]
        v_g = self._source_voltage(sample, self._now["source"]).tolist()
        seen, other, near = _relay_sees(own, behind, Relay(*self._now["seek.relay"].tolist()), *v, *v_g, self.T_s)
        if near < 0.5:
            return None
        return math.atan2(seen.v_beta, seen.v_alpha) - math.atan2(other.v_beta, other.v_alpha)

    def _passes_zero(self, sample: int, after: Array, crossed: bool) -> bool:
        """Whether a phase of a fault is interrupted in the interval of a sample, whose state is that before it;
        ``after``: the state after it. ``crossed``: the loop has seen it."""
        clearing, circuits, T_s = self.search.clearing, self._circuits, self.T_s
        if clearing is None:
            return False
        spans, at = self._batch.spans, []
        for k, x, source in (
            (sample, self._now["x"].copy(), self._now["source"]),
            (sample + 1, after[spans["x"]], after[spans["source"]]),
        ):
            circuit = circuits.of(connection_at(self.timeline, (k + SLACK) * T_s))
            if not isinstance(circuit, NetworkCircuit):
                return False
            at.append(SampleOfFault(x, self._source_voltage(k, source), circuit))
        begin, end = (sample + SLACK) * T_s, (sample + 1 + SLACK) * T_s
        changed = any(begin < t_s <= end for t_s in self.timeline.plant_changes())
        if clearing.zero(sample, at, changed, surely=crossed) is None:
            return False
        self.search.found_zero()
        return True

    def _source_voltage(self, sample: int, source: Array) -> Array:
        """(2,): at a sample in which the source's fundamental has this phasor, V peak."""
        added = self._added.over(sample, 1)
        v_g: Array = self._now["V_g"] * source
        return v_g if added is None else v_g + added.rows[0, -2:]

    def _follow(self, sample: int) -> None:
        """The run goes on with what has been found, from a sample on."""
        self.study = self.search.study
        self.timeline = build_timeline(self.study)
        self.ended = self._end()
        self._circuits.meet(self.timeline)
        self._stops, self._since, self._fed = None, sample, (-1, 0, None)
        self._follow_feed()
        self._added = self._added_source()
        self._batch.follow_anew(self._number, *program_of([self]), sample)

    def _follow_feed(self) -> None:
        """Gains and figures follow what has been found."""
        if self.of.every_sample is not None:
            self.of.every_sample.follow(self.timeline)
        schedule, spec = self.of.schedule, self.of.finds
        if isinstance(schedule, Hears):
            schedule.hear(self.study, self.timeline)
        changes = gain_changes(self.study, spec, self.timeline) if spec and isinstance(schedule, Sequence) else ()
        self.feed.follow(self.timeline, changes)

    def _added_source(self) -> AddedSource:
        self.is_fed = self._sensors is not None or adds_to_source(self.timeline)
        """Whether the run is given anything sample by sample."""
        return AddedSource(self.study, self.timeline, self._circuits, switched=self._batch.kind.in_pieces)

    def write(self, writer: ProgramWriter) -> None:
        """Writes what happens in the run besides its circuit: to what it looks for, its dc link and its phasors."""
        batch, number, spans = self._batch, self._number, self._batch.spans
        for one in self.search.records(self.timeline, self._circuits) if batch.kind.seeks else ():
            writer.put([number], [one.sample], spans[one.name].start, one.values[None])
        for event in self.study.events:
            if event.of_dc and (link := self.timeline.link_at(event.t_s)) is not None:
                sample = [math.ceil(event.t_s / self.T_s - SAME_INSTANT)]
                for name, values in dc_changed(self.study, link, event.of_dc):
                    writer.put([number], sample, spans[name].start, values[None])
        marks = self.marks()[:-1]
        writer.put(np.full(len(marks), number), marks, spans["source"].start, self.phasors(marks))

    def finish(self) -> None:
        """Hands over the last window."""
        self.log.end(self.ended)
        self.feed.limited_samples = self._at_end[1]
        refs = self._references(self.ended)
        self.give_up()
        self.feed.finish(self.ended, self._gains, self._state, refs, self.log.rows, self.log_every)

    def give_up(self) -> None:
        """The run is over: what it has not found by now it does not find."""
        self.search.give_up()
        self.study = self.search.study
        self.timeline = build_timeline(self.study)

    def let_go(self) -> None:
        """Nothing looks at the run any more: the memory of its log is for others, whatever still refers to the run."""
        self.feed.sensed = self.feed.more = None
        self._batch.log()
        del self.log

    @property
    def between(self) -> Array | None:
        """What the rows that were asked for say of the samples between them."""
        taken = self._batch.between
        return None if taken is None else taken.of(self._number)

    @property
    def final_state(self) -> ControllerState:
        """The controller's state at the end."""
        return self._state

    @property
    def final_plant(self) -> Array:
        """The circuit's state at the end."""
        return self._at_end[0]

    def _outside(self, state: ControllerState) -> str | None:
        return self._blocked() or outside(self.study, self._now["x"], state)

    def _blocked(self) -> str | None:
        """Why the bridge blocks; None: it does not."""
        if self.study.dc is None:
            return None
        return blocked(self.study.dc, float(self._now["dc.lowest"][0]), float(self._now["dc.highest"][0]))

    def _read_state(self) -> ControllerState:
        numbers = self._now["state"].tolist()
        count = len(self._like) - 1
        return ControllerState(*numbers[:count], limiter=type(self._like.limiter)(*numbers[count:]))

    def _put_state(self, state: ControllerState) -> None:
        self._now["state"][:] = flat_state(state)

    def _references(self, sample: int) -> References:
        """At a sample, with the slack by which instants are taken to coincide with it."""
        return self.timeline.references_at((sample + 1e-6) * self.T_s)

    def _followed(self) -> References:
        """The references that the power loops have followed in the sample before."""
        cut = self._now.get("clamp.cut")
        return self._refs if cut is None else self._refs._replace(P_ref=self._refs.P_ref + float(cut[0]))

    def _put_gains(self, sample: int) -> None:
        self._put_changed("power_gains", self._gains)
        grid = self.feed.grid(sample) or self.study.grid
        if self._put.get("grid") != grid:
            self._put["grid"] = grid
            if "grid" in self._now:
                self._now["grid"][:] = GridEstimate(grid.R_g, grid.L_g)

    def _put_changed(self, name: str, record: PowerLoopGains | References) -> None:
        """Gives the loop a record if it is another one than it has."""
        known = self._put.get(name)
        if known is not record and known != record:
            self._put[name] = record
            self._now[name][:] = record


def program_of(runs: Sequence[RunState]) -> tuple[ProgramWriter, list[CutSample]]:
    """What happens in runs of a batch that follow each other, and the samples in whose intervals events fall."""
    first, writer = runs[0], ProgramWriter()
    batch, circuits = first._batch, first._circuits
    segments = segments_of_timelines([run.timeline for run in runs], circuits.place)
    circuit = CircuitProgram(first.study, batch.kind, batch.spans, writer, segments, circuits, first=first._number)
    circuit.write()
    for run in runs:
        run.write(writer)
    return writer, circuit.cut
