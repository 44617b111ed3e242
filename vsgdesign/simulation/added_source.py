"""What a run is given for every sample beside its program: what the source has besides its fundamental, and noise.

The stretches of a run are its parts in which neither the circuit nor its source changes. An interval that events cut is
a stretch of one sample.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.normals import NormalStream
from vsgdesign.equations.controller import Measurement
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.simulation.background import Background, Interval
from vsgdesign.simulation.circuits import Circuits, connection_at
from vsgdesign.simulation.compiled_schedulers import directions
from vsgdesign.simulation.sample import SensorChannel, Sensors
from vsgdesign.simulation.timeline import Timeline
from vsgdesign.simulation.wander import normal_stream
from vsgdesign.study.parameters.sensors import CHANNELS, SensorSpec
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]

_RAMP_STRETCH = 0.02
"""Longest stretch of a ramp with one centre frequency, s."""

_RAMP_DRIFT = 1e-4
"""Largest angle, rad, that a ramp may drift from its centre frequency within one period of a stretch. The source
model leaves out third-order terms of a period; against DOP853 that is 7e-11 of rated in the steepest test."""

NOISE_BLOCK = 4096
"""Samples whose noise is drawn from one stream."""

PROGRESS_STRETCH = 1.0
"""Longest stretch between two calls of ``progress``, s of simulated time."""


class Added(NamedTuple):
    """What is added to the source over a stretch: (count, states + 2), the increments of the states over each interval
    and the voltage at its beginning. Of an interval in pieces with a switched bridge: those of the first piece, and the
    increments over the others, (pieces − 1, states)."""

    rows: Array
    others: Array | None = None


def distorted(timeline: Timeline) -> bool:
    """Whether the source of a run ever has more than its fundamental, or one that wanders or is recorded."""
    moving = timeline.wander is not None or timeline.replay is not None
    return moving or any(components for _, components in timeline.components)


def adds_to_source(timeline: Timeline) -> bool:
    """Whether anything is ever added to the source of a run: it is distorted, or ramped."""
    return distorted(timeline) or not all(source.steady for source in timeline.sources)


class AddedSource:
    """The source of a run beside what its program says of it. A source that is ramped is added here as a whole
    (:eq:`source-ramp`)."""

    def __init__(self, study: Study, timeline: Timeline, circuits: Circuits, *, switched: bool) -> None:
        self._timeline, self._circuits, self._switched = timeline, circuits, switched
        self._T_s, self._strict = study.converter.T_s, study.simulation.strict
        self._changes = timeline.plant_changes()
        self._background = Background(circuits.of, rms_to_peak(study.converter.V_rated_rms), timeline)
        self._distorted = distorted(timeline)
        self._always = adds_to_source(timeline)
        self._ahead: dict[tuple[int, int], Array] = {}
        """What a ramp adds over stretches that are still to come, by first sample and length."""

    def marks(self, samples: int) -> set[int]:
        """The samples at which a stretch begins because of the circuit or its source, in a run of so many."""
        T_s, timeline = self._T_s, self._timeline
        cuts: set[int] = set()
        for t_s in self._changes:
            k = on_sample(t_s, T_s)
            cuts |= {k} if k is not None else {math.floor(t_s / T_s), math.floor(t_s / T_s) + 1}
        cuts |= set(range(0, samples, max(round(PROGRESS_STRETCH / T_s), 1)))
        for segment, following in itertools.zip_longest(timeline.sources, timeline.sources[1:]):
            if not segment.steady:
                end = samples if following is None else math.ceil(following.t_s / T_s)
                slope = max(abs(segment.omega_slope), 1e-12)
                ramp_steps = max(round(min(_RAMP_STRETCH, _RAMP_DRIFT / (slope * T_s)) / T_s), 1)
                cuts |= set(range(math.floor(segment.t_s / T_s), min(end, samples), ramp_steps))
        return {k for k in cuts if 0 <= k <= samples}

    def phasors(self, marks: list[int]) -> Array:
        """Cosine and sine of the source's phase at samples, (n, 2): where a stretch begins, the loop takes up its phase
        anew, so that rounding does not add up."""
        T_s, sources = self._T_s, self._timeline.sources
        starts = np.array(marks, dtype=np.float64) * T_s
        t_s = starts + 1e-6 * T_s
        held = np.maximum(np.searchsorted([s.t_s for s in sources], t_s, side="right") - 1, 0)
        begin, omega, phase = np.array([(s.t_s, s.omega, s.phase) for s in sources])[held].T
        phases = (phase + omega * (t_s - begin) + omega * (starts - t_s)).tolist()
        cut = {math.floor(t / T_s) for t in self._changes}
        for k, (mark, source) in enumerate(zip(marks, held.tolist(), strict=True)):
            if self._distorted or not sources[source].steady or (mark in cut and self._inside(mark)):
                phases[k] = self._timeline.source_at(float(t_s[k])).at(float(starts[k])).phase
        return directions(phases, strict=self._strict)

    def _inside(self, sample: int) -> list[float]:
        """The changes within the interval of a sample."""
        start, end = sample * self._T_s, (sample + 1) * self._T_s
        return [t for t in self._changes if start < t < end and on_sample(t, self._T_s) is None]

    def adds(self, sample: int) -> bool:
        """Whether something may be added in the interval of a sample that is not cut."""
        if not self._always or self._distorted:
            return self._distorted
        return not self._timeline.source_at((sample + 1e-6) * self._T_s).steady

    def over(self, first: int, count: int, later: Sequence[int] = ()) -> Added | None:
        """What is added over a stretch; None: nothing. ``later``: where stretches of the run end after it. Those of the
        same ramp are computed with it, which takes a fraction of one after the other."""
        if not self._always:
            return None
        if (known := self._ahead.pop((first, count), None)) is not None:
            return Added(known)
        T_s, inside = self._T_s, self._inside(first)
        if not inside and not self.adds(first):
            return None
        start, end = first * T_s, (first + 1) * T_s
        instants = [start, *inside]
        lengths = np.diff([*instants, end]).tolist() if inside else [T_s]
        found = []
        for k, h in enumerate(lengths):
            t_s = instants[k] + 1e-6 * T_s if k == 0 else instants[k]
            source = self._timeline.source_at(t_s).at(instants[k])
            components = self._timeline.components_at(t_s)
            found.append(Interval(float(h), connection_at(self._timeline, t_s), source, components))
        if not self._background.acts(found):
            return None
        if not inside and not self._distorted:
            return Added(self._of_ramp(found[0], first, count, later))
        rows = self._background.rows(found, first, count, T_s)
        if len(found) == 1:
            return Added(rows)
        states = self._circuits.states
        if self._switched:
            return Added(rows[:1], rows[1:, :states])
        joint = rows[0].copy()
        for piece, row in zip(found[1:], rows[1:], strict=True):
            joint[:states] = self._circuits.moved(piece.connection, piece.h, joint[:states]) + row[:states]
        return Added(joint[None])

    def _of_ramp(self, interval: Interval, first: int, count: int, later: Sequence[int]) -> Array:
        """What a ramp alone adds over a stretch, and over the next ones that it has as a whole."""
        T_s = self._T_s
        ends_s = next((t_s for t_s in self._changes if t_s > first * T_s + 1e-6 * T_s), math.inf)
        stretches, begin = [(first, count)], first + count
        for end in later:
            if (end + 1) * T_s >= ends_s:
                break
            stretches.append((begin, end - begin))
            begin = end
        intervals = [interval]
        for begin, _ in stretches[1:]:
            source = self._timeline.source_at(begin * T_s + 1e-6 * T_s).at(begin * T_s)
            intervals.append(interval._replace(source=source))
        rows = self._background.of_ramp(intervals, [length for _, length in stretches], T_s)
        self._ahead = dict(zip(stretches[1:], rows[1:], strict=True))
        return rows[0]


def on_sample(t_s: float, T_s: float) -> int | None:
    """The sample that an instant coincides with (to a millionth of a period), if any."""
    k = round(t_s / T_s)
    return k if abs(t_s / T_s - k) < 1e-6 else None


def sensors_of(study: Study, x: Array, omega: float) -> SensorsOfRun | None:
    """The sensors of a study's run; None where they are ideal."""
    spec = study.sensors
    return SensorsOfRun(study, spec, x, omega) if spec is not None and spec.act else None


class SensorsOfRun:
    """The sensors of a run. ``x`` (2n): the circuit's state at its beginning; ``omega``: of the source there, rad/s."""

    def __init__(self, study: Study, spec: SensorSpec, x: Array, omega: float) -> None:
        c = study.converter
        rated = np.repeat([rms_to_peak(c.V_rated_rms), c.I_rated_pk, c.I_rated_pk], 3)
        self.rms = spec.noise * rated
        """Of the noise of each channel, (9,)."""
        limit = (spec.range_pu if spec.range_pu > 0.0 else math.inf) * rated
        steps = 2.0 * limit / 2.0**spec.bits if spec.bits else np.zeros(len(CHANNELS))
        gains, offsets = 1.0 + np.array(spec.gain_errors), np.array(spec.offset_errors) * rated
        lag = spec.skew / (c.omega_n * c.T_s)
        # The vectors of the sample before the first, as if the run had always been as it begins.
        v = x[2:4] + study.filter.R_c * (x[0:2] - x[4:6])
        turned = np.exp(-1j * omega * c.T_s) * np.array([complex(*pair) for pair in (v, x[0:2], x[4:6])])
        self.before = Measurement(*turned.view(np.float64).tolist())
        """What was true one sample before the first."""
        channels = [SensorChannel(*values) for values in np.stack([gains, offsets, steps, limit], axis=1).tolist()]
        self.constants = Sensors(*channels, late_v=max(-lag, 0.0), late_i=max(lag, 0.0))
        self._seed, self._next = spec.seed, -1
        self._stream: NormalStream | None = None

    def noise(self, first: int, count: int) -> Array:
        """What is added to each reading of samples first … first + count − 1: (count, 9), channels in the order of
        ``CHANNELS``."""
        found = np.zeros((count, len(CHANNELS)))
        if self.rms.any():
            self.put(first, found)
        return found

    def put(self, first: int, out: Array) -> None:
        """Puts the same from sample ``first`` on into ``out`` (count, 9), which may lie anywhere.

        Each block of samples has a stream of its own. To go on where the last call ended costs nothing but the draw.
        """
        done = 0
        while done < len(out):
            at = (first + done) % NOISE_BLOCK
            if self._stream is None or at == 0 or first + done != self._next:
                self._stream = self.stream(first + done)
            part = out[done : done + NOISE_BLOCK - at]
            self._stream.put(part, self.rms)
            done += len(part)
            self._next = first + done

    def stream(self, sample: int) -> NormalStream:
        """The numbers from a sample on, up to the end of its block, nine for each."""
        block, at = divmod(sample, NOISE_BLOCK)
        found = normal_stream(self._seed, "noise", block)
        found.skip(at * len(CHANNELS))
        return found
