"""One run of a batch: what Python does for it where a stretch begins and ends, and what it logs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.controller_data import flat_state
from vsgdesign.equations.limiters import GridEstimate
from vsgdesign.equations.power_loops import PowerLoopGains, References, gain_transfer
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.identification import Probe
from vsgdesign.linear.operating_point.sampled import SampledState
from vsgdesign.runtime.floats import on_floats
from vsgdesign.simulation.added_source import AddedSource, sensors_of
from vsgdesign.simulation.batch import Batch
from vsgdesign.simulation.circuits import CircuitOfGrid, Circuits
from vsgdesign.simulation.connecting import Connecting
from vsgdesign.simulation.every_sample import EverySample
from vsgdesign.simulation.field_feed import FieldScheduler
from vsgdesign.simulation.gains import GainChange, RunFeed
from vsgdesign.simulation.gains_of_run import ListedGains, OnlineGains
from vsgdesign.simulation.loop import LOG_COLUMNS, SENSED_COLUMNS
from vsgdesign.simulation.online import OnlineScheduler
from vsgdesign.simulation.outcome import Divergence, good_rows, outside
from vsgdesign.simulation.probing import HeldProbe, add_offset
from vsgdesign.simulation.timeline import Timeline, build_timeline
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

_gain_transfer = on_floats(gain_transfer)


@dataclass(frozen=True, eq=False)
class RunOf:
    """What is simulated: a study with gains over time, or with a scheduler that is asked for them."""

    study: Study
    schedule: Sequence[GainChange] | OnlineScheduler | FieldScheduler
    log_states: int = 0
    """For how many first samples the controller's states are kept."""
    probe: Probe | None = None
    """Sent from t = 0 on, in place of one that the scheduler asks for."""
    circuit: CircuitOfGrid | None = None
    """Replaces the study's circuit between bridge and source."""
    twins: tuple[float, ...] = ()
    """The instants (s) of steps from which on the run without them goes beside it (``twin.steps_with_twin``)."""
    every_sample: EverySample | None = None
    """Gets every sample of the run, or as many as figures need, beside its log."""


@dataclass(frozen=True)
class Twin:
    """The run without a step, from the step on up to the next event. Rows are those of the run's own log, or those of
    which figures are taken where the run is asked for these."""

    event_s: float
    """When the step comes, s."""
    t_s: Array
    log: Array
    circuit_log: Array
    timeline: Timeline
    """Without the step."""


class RunState:
    """A run that is under way."""

    def __init__(self, of: RunOf, timeline: Timeline | None = None) -> None:
        """Raises InfeasibleStudyError where the scheduler's or the probe's period does not fit the sampling."""
        self.of, self.study = of, of.study
        self.timeline = build_timeline(of.study) if timeline is None else timeline
        self.T_s = self.study.converter.T_s
        self.samples = round(self.study.simulation.duration / self.T_s)
        self.feed = _feed(of, self.timeline)
        self.kept = round(self.study.simulation.log_interval / self.T_s)
        self.log_every = math.gcd(self.kept, self.feed.log_samples)  # a scheduler's samples are taken from the log
        self.divergence: Divergence | None = None
        self.ended = self.samples
        """The sample before which the run ends."""
        self.twins: tuple[Twin, ...] = ()
        """What became of the twins that were asked for."""

    def begin(self, batch: Batch, number: int, start: SampledState, circuits: Circuits) -> None:
        """Puts the run, which is the ``number``-th of a batch, at its start."""
        study = self.study
        self._like = start.controller
        names = ("x", "state", "limited", "refs", "power_gains", "grid")
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
        self._added = AddedSource(study, self.timeline, circuits, switched=bool(batch.kind.bridge.slopes))
        self.log = RunLog(batch, number, -(-self.samples // self.log_every), self.of.every_sample)
        self.feed.sensed, self.feed.more = self.log.sensed, self.log.more
        hold = self.feed.probe_hold if self.of.probe is None else self.of.probe.hold
        self._held = None if hold is None else HeldProbe(hold, study, self.samples)
        self.feed.held = self._held
        probes = hold is not None or isinstance(self.of.schedule, FieldScheduler)
        self._connecting = Connecting(study, self.timeline, probes=probes)
        self._gains, self._refs = self.feed.first(), self._references(0)
        self._state, self._offset = self._read_state(), None
        self._put: dict[str, object] = {}  # what the loop was given last
        self._begun = 0
        """The sample with which the stretch begins that is under way."""

    def marks(self) -> list[int]:
        """The samples at which a stretch of this run begins, and its last one, in ascending order."""
        samples = self.samples
        cuts = {0, samples} | self._added.marks(samples) | self._connecting.cuts(samples)
        cuts |= set() if self._held is None else self._held.cuts(samples)
        cuts |= {math.ceil(t_s / self.T_s - 1e-6) for t_s, _ in self.timeline.references}
        self._quiet = {k for k in self.feed.quiet(samples) - cuts if not self._added.adds(k)}
        return sorted(k for k in cuts | self.feed.cuts(samples) if 0 <= k <= samples)

    def stops(self, marks: list[int]) -> list[int]:
        """Those of the marks at which the loop has to end: not where a schedule is going to say what it said before.
        The source takes up its phase there all the same."""
        return [mark for mark in marks if mark not in self._quiet]

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
        state = with_gains(read, self._refs, self._gains, gains)
        self._gains, self._refs = gains, refs
        state = self._connecting.set_to_grid(first, state, gains, self._now["x"])
        if self._held is not None:
            self._held.ask(first, feed.wanted() if self.of.probe is None else self.of.probe)
            refs = self._held.references(first, refs)
            self._offset = self._held.offset(first, state.V)
            state = add_offset(state, *self._offset)
        if state is not read or first == 0:
            self._put_state(state)
        self._put_changed("refs", refs)
        self._put_gains(first)

    def fed(self, first: int, count: int) -> tuple[Array | None, Array | None, Array | None]:
        """What the run is given over a stretch: what is added to the source (count, states + 2), over the later pieces
        of its interval (pieces − 1, states), and the noise of the sensors (count, 9). None: nothing."""
        if first >= self.ended:
            return None, None, None
        added = self._added.over(first, count)
        noise = None if self._sensors is None else self._sensors.noise(first, count)
        return (None, None, noise) if added is None else (added.rows, added.others, noise)

    def conclude(self, done: int) -> bool:
        """Ends the cycle of a field estimator, if one ends before sample ``done``. Returns whether the run goes on: it
        does not if it has diverged."""
        state = self._read_state()
        if self._outside(state) is not None:
            return False
        if not self.feed.closed:
            return True
        gains = self.feed.conclude(done, self._gains, state)
        self._put_state(with_gains(state, self._refs, self._gains, gains))
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
            diverged_s = good * self.T_s
            self.divergence = Divergence(diverged_s, f"the simulation diverged at {diverged_s:.4g} s: {why}")
            self.log.end(good)
            self.ended = done

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
        return self.divergence is not None and rows <= apart

    def finish(self) -> None:
        """Hands over the last window."""
        self.log.end(self.samples)
        self.feed.limited_samples = int(self._now["limited"][0])
        state = self._read_state()
        refs = self._references(self.samples)
        self.feed.finish(self.samples, self._gains, state, refs, self.log.rows, self.log_every)

    @property
    def final_state(self) -> ControllerState:
        """The controller's state at the end."""
        return self._state

    @property
    def final_plant(self) -> Array:
        """The circuit's state at the end."""
        return self._now["x"].copy()

    def _outside(self, state: ControllerState) -> str | None:
        return outside(self.study, self._now["x"], state)

    def _read_state(self) -> ControllerState:
        numbers = self._now["state"].tolist()
        count = len(self._like) - 1
        return ControllerState(*numbers[:count], limiter=type(self._like.limiter)(*numbers[count:]))

    def _put_state(self, state: ControllerState) -> None:
        self._now["state"][:] = flat_state(state)

    def _references(self, sample: int) -> References:
        """At a sample, with the slack by which instants are taken to coincide with it."""
        return self.timeline.references_at((sample + 1e-6) * self.T_s)

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


class RunLog:
    """What a batch has logged of one run, which is to have ``length`` rows. ``seen`` gets the rows of a log that is
    written anew again and again."""

    def __init__(self, batch: Batch, number: int, length: int, seen: EverySample | None = None) -> None:
        group, lane = batch.lane(number)
        self._batch, self._seen, last = batch, seen, batch.logs[-1]
        main = last if last.into is None or seen is None else last.into
        self._whole = main.rows[group, :, :, lane]
        self._last = last.rows[group, :, :, lane]
        self._states = [log.rows[group, :, :, lane] for log in batch.logs[:-1]]
        self._sensed = len(SENSED_COLUMNS) if batch.kind.sensors else 0
        self._every, self.length = main.every, length

    @property
    def rows(self) -> Array:
        """(n, len(LOG_COLUMNS))."""
        return self._whole[: self.length, : len(LOG_COLUMNS)]

    @property
    def sensed(self) -> Array:
        """(n, 4): what the sensors say of the capacitor node's voltage and of i_g; (0, 4) where they are ideal."""
        found = self._whole[: self.length, len(LOG_COLUMNS) : len(LOG_COLUMNS) + self._sensed]
        return found if self._sensed else np.empty((0, len(SENSED_COLUMNS)))

    @property
    def more(self) -> Array:
        """(n, m): the circuit's other states."""
        return self._whole[: self.length, len(LOG_COLUMNS) + self._sensed :]

    @property
    def states(self) -> Array:
        """The controller's states, a row for each of the first samples."""
        if not self._states:
            return np.empty((0, 0))
        return self._states[0][: self.length * self._every, self._whole.shape[1] :].copy()

    def good(self, study: Study, begin: int, end: int) -> int:
        """The sample of the first row among those of samples ``begin`` to ``end`` − 1 that has diverged."""
        log = self._batch.logs[-1]
        first, last = (-(-sample // log.every) - log.begin // log.every for sample in (begin, end))
        return log.begin + (first + good_rows(study, self._last[first:last, : len(LOG_COLUMNS)])) * log.every

    def make_room(self, begin: int, end: int) -> None:
        """Before samples ``begin`` to ``end`` − 1 are run: a log that is too full for them is written anew."""
        log = self._batch.logs[-1]
        if self._seen is not None and end - log.begin > len(self._last) * log.every:
            self._hand_over(begin)
            self._batch.log_anew(begin // log.every * log.every)

    def end(self, sample: int) -> None:
        """The log ends before a sample."""
        self.length = min(self.length, -(-sample // self._every))
        if self._seen is not None:
            self._hand_over(sample)

    def _hand_over(self, end: int) -> None:
        """Gives what is logged of the samples before ``end``."""
        if self._seen is not None:
            log, own = self._batch.logs[-1], len(LOG_COLUMNS)
            rows = self._last[: -(-(end - log.begin) // log.every)]
            self._seen.take(log.begin, log.every, rows[:, :own], rows[:, own + self._sensed :])


def with_gains(
    state: ControllerState, refs: References, before: PowerLoopGains, after: PowerLoopGains
) -> ControllerState:
    """The state with other gains; the frequency at which the integrator would rest stays (:eq:`gain-transfer`)."""
    if after is before:
        return state
    return state._replace(omega_i=_gain_transfer(state.omega_i, refs, before, after))


def _feed(of: RunOf, timeline: Timeline) -> RunFeed:
    schedule, study = of.schedule, of.study
    if isinstance(schedule, FieldScheduler):
        if of.probe is not None:
            raise InfeasibleStudyError(
                "probe: a field estimator sends its own in every sample and listens to that one alone. Leave probe "
                "out, or give a controller without a field estimator."
            )
        return schedule.fresh()
    T_s = study.converter.T_s
    return ListedGains(schedule, T_s) if isinstance(schedule, Sequence) else OnlineGains(schedule, study, timeline)
