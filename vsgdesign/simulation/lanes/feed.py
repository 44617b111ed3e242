"""What many runs are given sample by sample: what moves their sources, and the noise of their sensors; and the phasors
of their sources at the beginning, and anew where a stretch of a single run begins.

A phasor that turns in the loop gathers a rounding in every sample. Two runs of one case stay together to the last
digits only if both take up their phasors at the same samples
(:meth:`vsgdesign.simulation.added_source.AddedSource.phasors`).
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.llvm import aligned_zeros
from vsgdesign.codegen.many_normals import ManyNormalStreams
from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.power_loops import References
from vsgdesign.simulation.added_source import NOISE_BLOCK, PROGRESS_STRETCH, AddedSource, SensorsOfRun
from vsgdesign.simulation.batch import Batch
from vsgdesign.simulation.circuit_program import SAME_INSTANT, ProgramWriter
from vsgdesign.simulation.circuits import Circuits
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.loop import fed_names
from vsgdesign.simulation.run_kind import DISTURBANCE
from vsgdesign.simulation.timeline import Segments, Timeline, Waves
from vsgdesign.study.parameters.sensors import CHANNELS, SensorSpec
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Samples = NDArray[np.int64]

FED_SAMPLES = 512
"""Samples for which the runs are given something at once where all of them are at the same one."""

_AHEAD = 2048
"""Samples for which a source is moved at once: to do so costs as much as some hundred samples."""


class LaneFeed:
    """What the runs of a batch are given. Their sensors are put into the batch, and their sources where they begin."""

    def __init__(self, batch: Batch, *, beside: bool = False) -> None:
        """``beside``: behind each run is its twin, which is given the same."""
        self._batch = batch
        self._apart = 2 if beside else 1
        self._sources: list[_SourceOfLane] = []
        self._noise: _Noise | None = None
        fed = fed_names(batch.kind._replace(added=batch.kind.moved))
        self._columns = len(fed)
        at = next((k for k, name in enumerate(fed) if name.startswith("noise.")), 0)
        self._of_noise = slice(at, at + len(CHANNELS))
        self._room = np.zeros((0, 0, self._columns, batch.rows.shape[2]))

    def add_sensors(self, specs: Sequence[SensorSpec], x: Array, omega: Array) -> None:
        """``x`` (2n, N): the circuits' states at the beginning; ``omega`` (N,): of the sources there, rad/s."""
        batch, mains = self._batch, []
        for number in range(0, len(batch), self._apart):
            run = SensorsOfRun(batch.study, specs[number], x[:, number], float(omega[number]))
            mains.append(run)
            for lane in range(number, number + self._apart):
                batch.set("sensors", numbers_of(run.constants), lane)
                batch.set("before", run.before, lane)
        self._noise = _Noise(mains, batch.rows.shape[2] // self._apart, self._apart)

    def add_sources(
        self, writer: ProgramWriter, studies: Sequence[Study], timelines: Sequence[Timeline], circuits: Circuits
    ) -> None:
        """The sources as runs of their own have them. Each takes up its phasor where a stretch of such a run begins."""
        for number, (study, timeline) in enumerate(zip(studies, timelines, strict=True)):
            source = _SourceOfLane(self._batch, number, study, timeline, circuits)
            self._sources.append(source)
            marks = source.marks[:-1]
            writer.put(np.full(len(marks), number), marks, self._batch.span("source").start, source.phasors(marks))

    def alone(self, batch: Batch) -> LaneFeed:
        """The same for a batch of the runs without their twins."""
        one = copy(self)
        one._batch, one._apart, one._sources = batch, 1, self._sources[:: self._apart]
        if self._noise is not None:
            one._noise = _Noise(self._noise.sensors, batch.rows.shape[2], 1)
        one._room = self._room[:0]
        return one

    def given(self, begin: Samples, counts: Samples, first: int, groups: int, late: Samples | None = None) -> Array:
        """What ``groups`` groups from ``first`` on are given, (groups, most, n, L), each run from its own sample
        ``begin`` (N,) on for ``counts`` (N,) samples, which come ``late`` (N,) samples later than the first; None: at
        once. It is valid until the next call."""
        late = np.zeros_like(counts) if late is None else late
        width, most = self._room.shape[3], int((counts + late).max())
        if self._room.shape[0] < groups or self._room.shape[1] < most:
            self._room = aligned_zeros((groups, most, self._columns, width))
        found = self._room[:groups, :most]
        if self._noise is not None:
            mains = (one[:: self._apart] for one in (begin, counts, late))
            self._noise.put(found[:, :, self._of_noise], first, *mains)
        for group in range(first, first + groups):
            lanes = range(group * width, min((group + 1) * width, len(self._batch)), self._apart)
            for lane in lanes if self._sources else ():
                rows = slice(late[lane], late[lane] + counts[lane])
                self._sources[lane].put(found[group - first, rows, :, lane % width], int(begin[lane]))
            if self._apart > 1 and self._sources:
                columns = self._sources[0].columns
                found[group - first, :, :columns, 1::2] = found[group - first, :, :columns, ::2]
        return found


class _Noise:
    """The noise of the sensors of runs side by side, ``each`` in a group, and of their twins."""

    def __init__(self, sensors: Sequence[SensorsOfRun], each: int, copies: int) -> None:
        self.sensors, self._each = sensors, each
        scale = np.zeros((-(-len(sensors) // each), each, len(CHANNELS)))
        scale.reshape(-1, len(CHANNELS))[: len(sensors)] = [one.rms for one in sensors]
        self._groups = [ManyNormalStreams(one.T, copies) for one in scale]
        self._next = np.full(len(sensors), -1)
        """The sample after the last one of each run that was drawn."""

    def put(self, out: Array, first: int, begin: Samples, counts: Samples, late: Samples) -> None:
        """Puts what is added to the readings into ``out`` (groups, most, 9, L), the groups from ``first`` on: of each
        run (N,) from its sample ``begin`` on into ``counts`` rows, from row ``late`` on."""
        each = self._each
        runs = slice(first * each, min((first + len(out)) * each, len(self.sensors)))
        begin, counts, late = begin[runs], counts[runs], late[runs]
        # A block of samples has a stream of its own, which may begin in any row.
        edge = begin + (-begin) % NOISE_BLOCK
        due = [np.where((begin != self._next[runs]) & (begin < edge), begin, -1)]
        while (within := edge < begin + counts).any():
            due.append(np.where(within, edge, -1))
            edge = edge + NOISE_BLOCK
        self._next[runs] = begin + counts
        anew: list[list[tuple[int, int, int]]] = [[] for _ in out]
        for samples in due:
            for run in np.flatnonzero(samples >= 0).tolist():
                row = int(late[run] + samples[run] - begin[run])
                anew[run // each].append((row, run, int(samples[run])))
        for group, listed in enumerate(anew):
            streams, own, done = self._groups[first + group], slice(group * each, (group + 1) * each), 0
            count = len(late[own])
            streams.first[:count], streams.until[:count] = late[own], late[own] + counts[own]
            for row, run, sample in sorted(listed):
                streams.put(out[group], done, row)
                streams.take(run % each, self.sensors[runs.start + run].stream(sample))
                done = row
            streams.put(out[group], done, out.shape[1])


class _SourceOfLane:
    """The source of one run, stretch by stretch."""

    def __init__(self, batch: Batch, number: int, study: Study, timeline: Timeline, circuits: Circuits) -> None:
        self._batch, self._number, self._timeline = batch, number, timeline
        self._T_s = study.converter.T_s
        self._added = AddedSource(study, timeline, circuits, switched=batch.kind.in_pieces)
        samples = round(study.simulation.duration / self._T_s) + 1
        self.marks = sorted(self._added.marks(samples) | {0, samples})
        """The samples at which its stretches begin, and the first one after its end."""
        self._turns = batch.kind.watch == DISTURBANCE
        self.columns = len(batch.kind.states) + 2
        """How many are given to every run; one that is a disturbance has one more, at the end."""
        self._begin, self._rows = 0, np.zeros((0, self.columns + self._turns))

    def phasors(self, marks: list[int]) -> Array:
        """At samples, (n, 2)."""
        return self._added.phasors(marks)

    def put(self, found: Array, first: int) -> None:
        """Puts what is given from sample ``first`` on into the columns of ``found`` (count, n)."""
        done = 0
        while done < len(found):
            at = first + done
            if not self._begin <= at < self._begin + len(self._rows):
                self._move(at)
            rows = self._rows[at - self._begin : at - self._begin + len(found) - done]
            into = found[done : done + len(rows)]
            into[:, : self.columns] = rows[:, : self.columns]
            if self._turns:
                into[:, -1] = rows[:, -1]
            done += len(rows)

    def _move(self, at: int) -> None:
        """The rows of the stretch in which a sample is."""
        following = bisect_right(self.marks, at)
        end = min(self.marks[following] if following < len(self.marks) else at + _AHEAD, at + _AHEAD)
        added = self._added.over(at, end - at)
        self._begin, self._rows = at, np.zeros((end - at, self.columns)) if added is None else added.rows
        if added is not None and added.others is not None:
            self._batch.others[self._number, at] = added.others
        if self._turns:
            instants: Array = np.arange(at, end + 1, dtype=np.float64) * self._T_s
            turns = np.diff(self._timeline.source_phase(instants, SAME_INSTANT * self._T_s))
            self._rows = np.column_stack([self._rows, turns])


Index = NDArray[np.int64]


def put_phasors(batch: Batch, phase: Array, waves: Waves | None) -> None:
    """The sources where they begin, the fundamentals at these phases, rad (N,)."""
    batch.put("source", np.stack([np.cos(phase), np.sin(phase)]))
    if waves is not None:
        for number, (angle, size) in enumerate(zip(waves.at(phase).T, waves.size.T, strict=True)):
            batch.put(f"wave_{number}.phasor", np.stack([np.cos(angle), np.sin(angle)]))
            batch.put(f"wave_{number}.V", size)


def take_up_phasors(
    batch: Batch, writer: ProgramWriter, cases: LaneCases, segments: Segments, waves: Waves | None, samples: int
) -> None:
    """The phasors anew at the samples at which single runs of so many samples take them up; without ramps."""
    T_s = batch.study.converter.T_s
    lane, at = _marks(cases, segments, T_s, samples)
    start = at * T_s
    now = start + SAME_INSTANT * T_s
    index = np.maximum((segments.t_s[lane] <= now[:, None]).sum(axis=1) - 1, 0)
    source = segments.at_column(lane, index)
    phase = source.phase + source.omega * (now - source.t_s) + source.omega * (start - now)
    writer.put(lane, at, batch.span("source").start, _phasors(phase))
    if waves is not None:
        for number, angle in enumerate(waves.take(lane).at(phase).T):
            writer.put(lane, at, batch.span(f"wave_{number}.phasor").start, _phasors(angle))


def _marks(cases: LaneCases, segments: Segments, T_s: float, samples: int) -> tuple[NDArray[np.intp], Index]:
    """Lanes, and the samples at which their phasors are taken up: every second, with each change of the circuit or its
    source, and with each change of the references."""
    count, events = len(cases), cases.events
    every = np.arange(0, samples, max(round(PROGRESS_STRETCH / T_s), 1))
    found = [np.broadcast_to(every, (count, len(every))).astype(float)]
    changes = np.where(np.isfinite(segments.t_s), segments.t_s, np.nan) / T_s
    near = np.abs(changes - np.round(changes)) < SAME_INSTANT
    found += [np.where(near, np.round(changes), side) for side in (np.floor(changes), np.floor(changes) + 1.0)]
    given = np.isfinite([getattr(events, name) for name in References._fields]).any(axis=0) & np.isfinite(events.t_s)
    found.append(np.where(given, np.ceil(np.where(given, events.t_s, 0.0) / T_s - SAME_INSTANT), np.nan))
    at = np.concatenate(found, axis=1)
    used = np.isfinite(at) & (at < samples)
    lane, _ = np.nonzero(used)
    return lane, at[used].astype(np.int64)


def _phasors(angle: Array) -> Array:
    """(n, 2), with the digits of a single run."""
    return np.array([(math.cos(a), math.sin(a)) for a in angle.tolist()]).reshape(-1, 2)
