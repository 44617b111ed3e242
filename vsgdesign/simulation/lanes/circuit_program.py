"""The circuit and the source of a batch as records: what each interval adds, also where an event falls inside one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.frames import rms_to_peak
from vsgdesign.operating_point.plants import PlantSteps, plant_steps
from vsgdesign.parameters.study import Study
from vsgdesign.simulation.circuit_sample import Coefficients
from vsgdesign.simulation.lanes.program import ProgramWriter
from vsgdesign.simulation.lanes.segments import Segments, last_before
from vsgdesign.simulation.loop import KindLoop, carrier_part

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SAME_INSTANT = 1e-6
"""Share of a sample by which an event may lie beside a sample and still coincide with it."""

RAMP_DRIFT = 1e-4
"""Largest angle, rad, by which a ramp may drift from the frequency of its responses within one interval. What is left
out is of third order, 2e-13 of the source."""


TERMS = len(Coefficients._fields)
"""Terms of an edge polynomial."""


class _Interval(NamedTuple):
    """One interval of n lanes: transition (n, 3, 3), bridge (n, 3), and what the source adds, complex (n, 3), for the
    source's phasor at its beginning as a unit; and by how much the source turns, rad."""

    transition: Array
    bridge: Array
    source: Complex
    turn: Array
    edge: Array
    """(n, 48) of :class:`vsgdesign.simulation.circuit_sample.EdgeRow`; (n, 0) for an averaged bridge."""


class BrokenSample(NamedTuple):
    """A sample of a lane in whose interval an event falls, with a switched bridge: what its own loop is given."""

    lane: int
    sample: int
    values: dict[str, Array]
    """Values of a record, or of one number, by name."""


class CircuitProgram:
    """Writes the circuit of a batch. ``lanes`` are numbers within the batch, ``segments`` those of the same lanes.

    With a switched bridge, the samples in whose interval an event falls are left to loops of their own (``broken``).
    """

    broken: list[BrokenSample]

    def __init__(self, study: Study, loop: KindLoop, writer: ProgramWriter, segments: Segments, ramped: bool) -> None:
        self.broken = []
        self._switched = bool(loop.spec.cyclic)
        self._study, self._loop, self._writer, self._ramped = study, loop, writer, ramped
        self._segments, self._T_s = segments, study.converter.T_s
        self._row, self._turn = loop.rows("row").start, loop.place.get("of.turn")

    def write(self) -> None:
        """Every interval of the run: those of the first segment, of the events, and of what follows each."""
        lanes = np.arange(len(self._segments.t_s))
        self._whole(lanes, np.zeros(len(lanes), dtype=np.int64), self._segments.column(0), np.inf)
        for k in range(1, self._segments.t_s.shape[1]):
            chosen = np.flatnonzero(np.isfinite(self._segments.t_s[:, k]))
            if chosen.size:
                self._change(chosen, k)

    def _change(self, lanes: NDArray[np.intp], k: int) -> None:
        """What the k-th segment changes."""
        T_s, every = self._T_s, self._segments.take(lanes)
        after = every.column(k)
        begin = np.round(after.t_s / T_s).astype(np.int64)
        inside = np.abs(after.t_s / T_s - begin) >= SAME_INSTANT
        begin[inside] = np.floor(after.t_s[inside] / T_s).astype(np.int64)
        following = every.t_s[:, k + 1] if k + 1 < every.t_s.shape[1] else np.full(len(lanes), np.inf)
        if inside.any():
            self._broken(lanes[inside], begin[inside], every.take(inside), after.take(inside))
        first = begin + inside
        self._whole(lanes, first, after.at(np.where(inside, first * T_s, after.t_s)), following)
        self._jumped(lanes[~inside], begin[~inside], every.take(~inside), after.take(~inside))

    def _broken(self, lanes: NDArray[np.intp], at: NDArray[np.int64], every: Segments, after: Segments) -> None:
        """The one interval of each lane in which a segment begins, from its two parts (:eq:`composite-interval`)."""
        T_s = self._T_s
        before = last_before(every, after.t_s).at(at * T_s)
        one = self._interval(before, np.asarray(after.t_s - at * T_s, dtype=np.float64))
        other = self._interval(after, np.asarray((at + 1) * T_s - after.t_s, dtype=np.float64))
        # The source's phasor at the event, over the one at the sample.
        turned = np.exp(1j * (after.phase - before.phase))
        if self._switched:
            other = other._replace(source=other.source * turned[:, None])
            turn = (after.phase - before.phase) + other.turn
            self._note_broken(lanes, at, one._replace(turn=turn), other, after.t_s)
            return
        source = np.einsum("nij,nj->ni", other.transition, one.source) + other.source * turned[:, None]
        joint = _Interval(
            transition=other.transition @ one.transition,
            bridge=np.einsum("nij,nj->ni", other.transition, one.bridge) + other.bridge,
            source=source,
            turn=(after.phase - before.phase) + other.turn,
            edge=other.edge,
        )
        self._put(lanes, at, joint)
        if self._ramped:  # the responses have the whole source in them
            whole = np.zeros((len(lanes), 20))
            whole[:, :3], whole[:, 3:6] = source.real, source.imag
            self._writer.put(lanes, at, self._loop.rows("ramp_of").start, whole)
            self._writer.put(
                lanes, at, self._loop.rows("ramp").start, np.column_stack([np.ones(len(lanes)), np.zeros(len(lanes))])
            )

    def _note_broken(
        self, lanes: NDArray[np.intp], at: NDArray[np.int64], one: _Interval, other: _Interval, t_s: Array
    ) -> None:
        """Samples in two parts, whose source is that of the whole interval's beginning."""
        n = self._study.converter.samples_per_carrier
        begin = (at % n) / n
        middle = begin + (t_s / self._T_s - at) / n
        parts = [np.column_stack(carrier_part(*ends)) for ends in ((begin, middle), (middle, begin + 1.0 / n))]
        for k, lane in enumerate(lanes.tolist()):
            values = {
                "row": _row(one)[k],
                "part": parts[0][k],
                "edge": one.edge[k],
                "second.row": _row(other)[k],
                "second.part": parts[1][k],
                "second.edge": other.edge[k],
            }
            if self._turn is not None:
                values["of.turn"] = one.turn[k : k + 1]
            if self._ramped:
                values["ramp_of"] = np.concatenate([one.source[k].real, one.source[k].imag, np.zeros(14)])
                values["ramp"] = np.array([1.0, 0.0])
            self.broken.append(BrokenSample(lane, int(at[k]), values))

    def _jumped(self, lanes: NDArray[np.intp], at: NDArray[np.int64], every: Segments, after: Segments) -> None:
        """Where an event coincides with a sample, a jump of the phase is part of the turn of the interval before."""
        before = last_before(every, after.t_s) if len(lanes) else after
        jump = after.phase - before.phase
        some = np.flatnonzero(jump != 0.0)
        if some.size:
            early = before.take(some).at((at[some] - 1) * self._T_s)
            interval = self._interval(early, self._T_s)
            self._put(lanes[some], at[some] - 1, interval._replace(turn=interval.turn + jump[some]))

    def _whole(self, lanes: NDArray[np.intp], at: NDArray[np.int64], source: Segments, until_s: Array | float) -> None:
        """Whole intervals from a sample on, and on a ramp of the frequency again and again until ``until_s``."""
        T_s = self._T_s
        self._put_whole(lanes, at, source)
        if not self._ramped:
            return
        slope = np.abs(source.omega_slope)
        stretch = np.where(
            slope > 0.0, np.maximum(np.round(RAMP_DRIFT / np.maximum(slope, 1e-12) / T_s / T_s), 1.0), np.inf
        )
        ends, sample = np.broadcast_to(until_s, slope.shape) / T_s, at + stretch
        while (some := np.flatnonzero(sample < ends)).size:
            now = sample[some].astype(np.int64)
            source_now = source.take(some).at(np.asarray(now * T_s, dtype=np.float64))
            self._put_whole(lanes[some], now, source_now)
            sample[some] += stretch[some]

    def _put_whole(self, lanes: NDArray[np.intp], at: NDArray[np.int64], source: Segments) -> None:
        """The same interval from a sample on. On a ramp its slopes come with its responses."""
        interval = self._interval(source, self._T_s)
        if self._ramped:
            self._put(lanes, at, interval._replace(turn=source.omega * self._T_s))
            self._put_ramp(lanes, at, source)
        else:
            self._put(lanes, at, interval)

    def _put_ramp(self, lanes: NDArray[np.intp], at: NDArray[np.int64], source: Segments) -> None:
        """The responses to a source and to its slopes, and where its ramp is."""
        rho = plant_steps(self._study, source.R_g, source.L_g, self._T_s, source.omega).source
        slopes = np.column_stack([rms_to_peak(source.V_slope), source.omega_slope])
        parts = [part for m in range(3) for part in (rho[:, m].real, rho[:, m].imag)]
        self._writer.put(lanes, at, self._loop.rows("ramp_of").start, np.column_stack([*parts, slopes]))
        now = np.column_stack([rms_to_peak(source.V_g_rms), np.zeros(len(lanes))])
        self._writer.put(lanes, at, self._loop.rows("ramp").start, now)

    def _put(self, lanes: NDArray[np.intp], at: NDArray[np.int64], interval: _Interval) -> None:
        self._writer.put(lanes, at, self._row, _row(interval))
        if self._switched:
            self._writer.put(lanes, at, self._loop.rows("edge").start, interval.edge)
        if self._turn is not None:
            self._writer.put(lanes, at, self._turn, interval.turn)

    def _interval(self, source: Segments, h: Array | float) -> _Interval:
        """An interval of length h (s) that begins with the segment given."""
        steps = plant_steps(self._study, source.R_g, source.L_g, h, source.omega, edges=self._switched)
        V, a, r = rms_to_peak(source.V_g_rms), rms_to_peak(source.V_slope), source.omega_slope
        weights = np.stack([V + 0j, a + 0j, 0.5j * V * r], axis=1)  # :eq:`source-ramp` without a drift
        added = np.einsum("nm,nmi->ni", weights, steps.source)
        edge = _edges(steps) if self._switched else np.empty((len(added), 0))
        return _Interval(steps.transition, steps.bridge, added, source.omega * h + 0.5 * r * h * h, edge)


def _row(interval: _Interval) -> Array:
    """Values of :class:`vsgdesign.simulation.circuit_sample.PlantRow`, (n, 20)."""
    return np.column_stack(
        [
            interval.transition.reshape(-1, 9),
            interval.bridge,
            interval.source.real,
            interval.source.imag,
            np.cos(interval.turn),
            np.sin(interval.turn),
        ]
    )


def _edges(steps: PlantSteps) -> Array:
    """Values of :class:`vsgdesign.simulation.circuit_sample.EdgeRow`, (n, 45): each state's coefficients, from the
    constant one on."""
    count, degree = steps.edge.shape[:2]
    if degree > TERMS or not np.isfinite(steps.edge).all():
        raise InfeasibleStudyError(
            "the circuit is too stiff to switch in a batch: its fastest mode (R/L or R_c/L) dies out within a sampling "
            'period. Sample faster, lower R_c, raise x_over_r, or use bridge = "averaged".'
        )
    full = np.zeros((count, 3, TERMS))
    full[:, :, :degree] = steps.edge.transpose(0, 2, 1)
    return full.reshape(count, 3 * TERMS)
