"""The twin of a step: the same run without the step, with which noise is told from motion (:eq:`twin`).

Until the step both are the same run, so the twin begins as a copy of it. It then has the same source, the same noise
of the sensors, the same gains, the same probe and the same grid for its limiter, and none of this is made twice.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.controller import ControllerState
from vsgdesign.equations.power_loops import PowerLoopGains, References
from vsgdesign.identification import Probe
from vsgdesign.identification.interface import samples_itself
from vsgdesign.simulation.batch import Batch, Log
from vsgdesign.simulation.field_feed import probe_of
from vsgdesign.simulation.field_observer import PLACE_OF_CLOSED, goes_on
from vsgdesign.simulation.gains import RunFeed
from vsgdesign.simulation.loop import log_names
from vsgdesign.simulation.run_asked import RunLog, Twin
from vsgdesign.simulation.run_state import RunState
from vsgdesign.study.parameters.background import BackgroundSpec
from vsgdesign.study.parameters.grid import Grid
from vsgdesign.study.parameters.replay import ReplaySpec
from vsgdesign.study.parameters.sensors import SensorSpec
from vsgdesign.study.parameters.study import ControllerSpec, Study

Array = NDArray[np.float64]


def steps_with_twin(study: Study, spec: ControllerSpec, *, probes: bool = False) -> tuple[float, ...]:
    """The instants (s) of the steps of a study that have a twin when a controller runs.

    Those are steps of P_ref or Q_ref at which nothing else changes but set points, in a run that never rests: its
    sensors have noise or bits, its grid wanders or is a record, or it sends a probe. ``probes``: whether its scheduler
    asks for one. Without any of these a run rests, and there is no twin.
    """
    moves = never_rests(study, spec, probes=probes)
    instants = {event.t_s for event in study.events if event.t_s > 0.0}
    until = (one.synchronised_until for one in study.events if one.synchronised_until is not None)
    connected_s = max((t_s for t_s in until if math.isfinite(t_s)), default=0.0)
    return tuple(t_s for t_s in sorted(instants) if moves and _steps_alone(study, t_s, connected_s))


def never_rests(study: Study, spec: ControllerSpec, *, probes: bool = False) -> bool:
    """Whether powers never rest when a controller runs. ``probes``: whether its scheduler asks for a probe."""
    probes = probes or (samples_itself(spec.estimate) and probe_of(study).send)
    return probes or restless(study.sensors, study.background, study.replay)


def restless(sensors: SensorSpec | None, background: BackgroundSpec | None, replay: ReplaySpec | None) -> bool:
    """Whether powers never rest with these sensors and in this grid, not even in the mean over a cycle."""
    noise = sensors is not None and (sensors.noise > 0.0 or sensors.bits > 0)
    return noise or (background is not None and background.restless) or replay is not None


def _steps_alone(study: Study, t_s: float, connected_s: float) -> bool:
    """Whether a power's reference is stepped at an instant and no more than set points change."""
    events = [event for event in study.events if event.t_s == t_s]
    stepped = any(event.P_ref is not None or event.Q_ref is not None for event in events)
    return stepped and t_s >= connected_s and not any(e.of_grid or e.synchro_check is not None for e in events)


class TwinRun(RunState):
    """The run without a step beside its main run, from a sample up to before ``end``."""

    def __init__(self, main: RunState, batch: Batch, event_s: float, first: int, end: int) -> None:
        """``batch``: that of the main run alone, before sample ``first``, from which on the step acts."""
        vars(self).update(vars(main))
        self.batch, self._main_batch, self._event_s, self.end = batch.apart(), batch, event_s, end
        self._batch = self.batch
        if batch.rings is not None:
            self.batch.rings = batch.rings.copy()
        held = tuple(one for one in main.timeline.references if one[0] < event_s)
        self.timeline = replace(main.timeline, references=held)
        self.feed = _AsMain(main, batch, self.batch)
        self._put = dict(self._put)
        self._now = {name: self.batch.view(name) for name in self._now}
        for name in ("seek.phases", "seek.relay.on"):  # it looks for nothing
            if name in self._now:
                self._now[name][:] = 0.0
        own = batch.logs[-1]
        names = log_names(batch.kind)
        if main.of.every_sample is not None:
            self.kept, self.log_every = main.of.every_sample.every, own.every
        self._first_row = -(-first // self.log_every)
        rows = np.empty((1, -(-end // self.log_every) - self._first_row, len(names), 1))
        self.batch.log(Log(rows, names, self.log_every, begin=self._first_row * self.log_every))
        self.log = RunLog(self.batch, 0, rows.shape[1])
        self.lost = False
        """Whether it diverged: there is no twin then."""

    def follow(self, begin: int, end: int, fed: Array | None) -> None:
        """Moves through the samples through which the main run has just gone, which was given ``fed``. What it sends
        makes its cycles end where those of the main run do."""
        self.batch.others = self._main_batch.others
        if self.batch.advance(begin, end, fed) != end - begin:
            raise RuntimeError("the twin of a run has ended a cycle of its field estimator before the run has.")

    def conclude(self, done: int) -> bool:
        """As the main run, after whose cycle this one ends."""
        self.lost |= not super().conclude(done)
        return not self.lost

    def after(self, done: int) -> None:
        """What happens after the last sample of a stretch."""
        del done
        self._take_offset_away()
        self.lost |= self._outside(self._state) is not None

    def cut(self, sample: int) -> None:
        """It ends before a sample."""
        rows = max(-(-sample // self.log_every) - self._first_row, 0)
        self.log.length = min(self.log.length, rows)

    def over(self) -> Twin:
        """What it logged."""
        every = self.kept // self.log_every
        rows = slice(-self._first_row % every, None, every)
        log = self.log.rows[rows]
        first = -(-self._first_row // every)
        t_s = np.arange(first, first + len(log), dtype=np.float64) * (self.kept * self.T_s)
        return Twin(self._event_s, t_s, log, self.log.more[rows], self.timeline)


class _AsMain(RunFeed):
    """The gains, the probe and the told grid of the main run, which is always a stretch or a cycle ahead."""

    def __init__(self, main: RunState, batch: Batch, own: Batch) -> None:
        self._main = main
        if main.feed.memory is not None:
            self._lock, self._of_main = own.view("lock"), batch.view("lock")

    @property
    def closed(self) -> bool:  # type: ignore[override]
        return bool(self._lock[PLACE_OF_CLOSED] != 0.0)

    def wanted(self) -> Probe | None:
        return self._main.feed.wanted()

    def grid(self, sample: int) -> Grid | None:
        return self._main.feed.grid(sample)

    def update(
        self, sample: int, present: PowerLoopGains, state: ControllerState, refs: References, log: Array, log_every: int
    ) -> PowerLoopGains:
        del sample, present, state, refs, log, log_every
        return self._main.gains

    def conclude(self, sample: int, present: PowerLoopGains, state: ControllerState) -> PowerLoopGains:
        """The cycle ends as that of the main run did, with what is sent in the next one. Whether nothing is sent after
        a limited sample stays the twin's own."""
        del sample, present, state
        goes_on(self._lock, self._of_main)
        return self._main.gains


class Twins:
    """The twins of a run that is alone in its batch, one after the other."""

    def __init__(self, run: RunState, batch: Batch) -> None:
        self._run, self._batch, self.done = run, batch, list[Twin]()
        self._steps = {math.ceil(t_s / run.T_s - 1e-6): t_s for t_s in run.of.twins}
        self._now: TwinRun | None = None

    def begin(self, first: int) -> TwinRun | None:
        """The twin of the stretch that begins with a sample, before anything has happened in it; None: none."""
        if self._now is not None and (self._now.end <= first or self._now.lost):
            self._end()
        run, t_s = self._run, self._steps.get(first)
        if t_s is not None and not run.search.under_way(t_s):
            later = [event.t_s for event in run.study.events if event.t_s > t_s]
            end = math.ceil(min(later, default=run.study.simulation.duration) / run.T_s - 1e-6)
            self._now = TwinRun(run, self._batch, t_s, first, min(end, run.samples))
        return self._now

    def cut(self, sample: int | None) -> None:
        """The run has found an instant: its twin ends before this sample. None: it has not."""
        if sample is not None and self._now is not None:
            self._now.cut(sample)
            self._end()

    def _end(self) -> None:
        if self._now is not None and not self._now.lost:
            self.done.append(self._now.over())
        self._now = None

    def finish(self) -> tuple[Twin, ...]:
        """All twins of the run, which is over."""
        self._end()
        return tuple(self.done)
