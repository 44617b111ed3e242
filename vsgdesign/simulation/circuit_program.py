"""The circuit and the source of runs as records: what each interval adds, also where an event falls inside one.

The loop of runs reads a row of numbers in every sample. Before a sample at which the grid, the network or the source
changes, a record puts other numbers into the row of this run. Nothing else happens between two samples.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vsgdesign.codegen.llvm import Program
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.plant import PlantSteps, plant_steps
from vsgdesign.simulation.axes import FALLING, PEAK, RISING
from vsgdesign.simulation.circuits import Circuits
from vsgdesign.simulation.compiled_schedulers import directions
from vsgdesign.simulation.link_piece import GridSlopes, axes_of, grid_slopes, kept_of_slopes
from vsgdesign.simulation.loop import carrier_part
from vsgdesign.simulation.run_kind import LARGEST_DEGREE, Kind
from vsgdesign.simulation.timeline import Segments, Waves, last_before
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SAME_INSTANT = 1e-6
"""Share of a sample by which an event may lie beside a sample and still coincide with it."""

RAMP_DRIFT = 1e-4
"""Largest angle, rad, by which a ramp may drift from the frequency of its responses within one interval. What is left
out is of third order, 2e-13 of the source."""


class _Part(NamedTuple):
    """A part of the source over an interval: its fundamental, or a component."""

    added: NDArray[Any]
    """What it adds for its phasor at the beginning as a unit: complex (n, S), or real (n, S, 2)."""
    turn: Array
    """By how much it turns, rad (n,)."""


class _Interval(NamedTuple):
    """One interval of n runs whose circuits have S states: for one axis where both are alike, else for both."""

    transition: Array
    """(n, S, S)."""
    bridge: Array
    """(n, S), or (n, S, 2) for both axes."""
    source: tuple[_Part, ...]
    """The fundamental, then the components that turn in the loop."""
    edge: Array
    """(n, m): the numbers of the edge polynomials; none of an averaged bridge."""
    V_g: Array
    """Amplitude of the source that is in it, V peak (n,)."""
    slopes: GridSlopes | None = None
    """None where no dc link moves the voltage of the bridge."""

    def turned(self, angles: Array) -> _Interval:
        """With the source turned by more: (parts, n), rad."""
        more = zip(self.source, angles, strict=True)
        return self._replace(source=tuple(part._replace(turn=part.turn + angle) for part, angle in more))


class CutSample(NamedTuple):
    """A sample of a run in whose interval events fall, with a switched bridge: what its own loop is given."""

    lane: int
    sample: int
    slopes: tuple[str, ...]
    """Where each piece lies on the carrier."""
    values: dict[str, Array]
    """Values of a record, or of one number, by name."""


class CircuitProgram:
    """Writes the circuits of runs. ``lanes`` are numbers within the batch, ``segments`` those of the same lanes.

    ``circuits``: those of the segments' places; None: the study's filter on the segments' grids, with equal axes. On a
    ramp of the source the loop itself moves the source (``ramped``), or something outside of it adds the source's part.

    With a switched bridge, the samples in whose interval an event falls are left to loops of their own (``cut``).
    """

    def __init__(
        self,
        study: Study,
        kind: Kind,
        spans: Mapping[str, slice],
        writer: ProgramWriter,
        segments: Segments,
        circuits: Circuits | None = None,
        waves: Waves | None = None,
        *,
        first: int = 0,
    ) -> None:
        """``spans``: where the numbers of the runs stand. ``first``: which of the batch the first of these lanes is.
        ``waves``: what the sources have besides their fundamental,
        without ramps and with equal axes."""
        self.cut: list[CutSample] = []
        self._study, self._spans, self._writer, self._slopes = study, spans, writer, kind.bridge.slopes
        self._circuits, self._segments, self._T_s = circuits, segments, study.converter.T_s
        self._waves, self._first = waves, first
        # A run with a timeline of its own takes up its source's phase anew, and what moves a source is fed.
        self._turns = circuits is None or ("watch" in spans and not kind.moved)
        self._edged, self._in_pieces = kind.edged, kind.in_pieces
        self._ramped, self._axes, self._taken = kind.ramped, kind.axes, kind.taken
        self._of_slopes = kept_of_slopes(axes_of(kind)) if kind.coupled else None
        self._most_turns = kind.dc.turns if kind.dc is not None else 0.0
        if self._axes is not None:
            rows = range(self._axes.states)
            self._by_state = np.array([[k % 2 in self._axes.on(row) for k in rows] for row in rows])
            self._by_axis = self._by_state[:, :2]
            self._by_columns = self._axes.large

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
        last = inside & (following >= (begin + 1 - SAME_INSTANT) * T_s)  # the last one in its interval
        if last.any():
            self._cut_interval(lanes[last], begin[last], every.take(last))
        first = begin + inside
        whole = last | ~inside
        if whole.any():
            start = after.at(np.where(inside, first * T_s, after.t_s))
            self._whole(lanes[whole], first[whole], start.take(whole), following[whole])
        if self._turns:
            self._jumped(lanes[~inside], begin[~inside], every.take(~inside), after.take(~inside))

    def _cut_interval(self, lanes: NDArray[np.intp], at: Index, every: Segments) -> None:
        """The one interval of each run in which segments begin, from its pieces (:eq:`composite-interval`)."""
        T_s = self._T_s
        begin, end = at * T_s, (at + 1) * T_s
        within = (every.t_s > (begin + SAME_INSTANT * T_s)[:, None]) & (every.t_s < (end - SAME_INSTANT * T_s)[:, None])
        for count in np.unique(within.sum(axis=1)).tolist():
            some = np.flatnonzero(within.sum(axis=1) == count)
            self._cut_into(lanes[some], at[some], every.take(some), within[some])

    def _cut_into(self, lanes: NDArray[np.intp], at: Index, every: Segments, within: NDArray[np.bool_]) -> None:
        """Intervals of the same number of pieces."""
        T_s, rows = self._T_s, np.arange(len(lanes))
        first = np.argmax(within, axis=1)
        starts = [every.at_column(rows, first + k) for k in range(int(within[0].sum()))]
        before = last_before(every, starts[0].t_s).at(at * T_s)
        pieces = [before, *starts]
        instants = [at * T_s, *(one.t_s for one in starts), (at + 1) * T_s]
        found = []
        for piece, start, end in zip(pieces, instants[:-1], instants[1:], strict=True):
            one = self._interval(lanes, piece, np.asarray(end - start, dtype=np.float64), piece.phase - before.phase)
            # The source's phasors at the beginning of the piece, over those at the sample.
            angles = self._orders(lanes) * (piece.phase - before.phase)
            behind = (part._replace(added=_turned(part.added, a)) for part, a in zip(one.source, angles, strict=True))
            found.append(one._replace(source=tuple(behind)).turned(angles))
        if self._in_pieces:
            ends = zip(found[0].source, found[-1].source, strict=True)
            whole = tuple(_Part(one.added, last.turn) for one, last in ends)
            self._note_cut(lanes, at, [found[0]._replace(source=whole), *found[1:]], instants)
            return
        joint = found[0]
        for other in found[1:]:
            joint = _Interval(
                transition=other.transition @ joint.transition,
                bridge=_product(other.transition, joint.bridge) + other.bridge,
                source=tuple(
                    _Part(_product(other.transition, before.added) + part.added, part.turn)
                    for before, part in zip(joint.source, other.source, strict=True)
                ),
                edge=other.edge,
                V_g=joint.V_g,
            )
        self._put(lanes, at, joint)
        if self._ramped:  # the responses have the whole source in them
            self._write(lanes, at, "ramp_of", _held_ramp(joint.source[0].added))
            self._write(lanes, at, "ramp", np.column_stack([np.ones(len(lanes)), np.zeros(len(lanes))]))

    def _note_cut(self, lanes: NDArray[np.intp], at: Index, pieces: list[_Interval], instants: list[Array]) -> None:
        """Samples in pieces, whose source is that of the whole interval's beginning."""
        n = max(len(self._slopes), 1)
        begin = (at % n) / n
        places = [begin, *(begin + (t_s / self._T_s - at) / n for t_s in instants[1:-1]), begin + 1.0 / n]
        parts = [np.column_stack(carrier_part(*ends)) for ends in itertools.pairwise(places)]
        whole = self._slopes
        for k, lane in enumerate(lanes.tolist()):
            slope, slopes = whole[int(at[k]) % n] if whole else "", []
            values: dict[str, Array] = {}
            for number, (piece, part) in enumerate(zip(pieces, parts, strict=True)):
                head = f"piece_{number}." if number else ""
                values |= {f"{head}{name}": rows[k] for name, rows in self._rows(piece).items()}
                values |= {f"{head}part": part[k], f"{head}edge": piece.edge[k]}
                if piece.slopes is not None:
                    values[f"{head}slope"] = self._slope_rows(piece, piece.V_g)[k]
                low, high = part[k, 0], part[k, 1]
                slopes.append(slope if slope != PEAK or low < 0.5 < high else FALLING if low >= 0.5 else RISING)
            if self._turns:  # else it is fed where it is watched
                values["of.turn"] = pieces[0].source[0].turn[k : k + 1]
            if self._ramped:
                values["ramp_of"] = _held_ramp(pieces[0].source[0].added[k : k + 1])[0]
                values["ramp"] = np.array([1.0, 0.0])
            self.cut.append(CutSample(self._first + lane, int(at[k]), tuple(slopes), values))

    def _jumped(self, lanes: NDArray[np.intp], at: Index, every: Segments, after: Segments) -> None:
        """Where an event coincides with a sample, a jump of the phase is part of the turn of the interval before."""
        before = last_before(every, after.t_s) if len(lanes) else after
        jump = after.phase - before.phase
        some = np.flatnonzero(jump != 0.0)
        if some.size:
            early = before.take(some).at((at[some] - 1) * self._T_s)
            interval = self._interval(lanes[some], early, self._T_s)
            self._put(lanes[some], at[some] - 1, interval.turned(self._orders(lanes[some]) * jump[some]))

    def _whole(self, lanes: NDArray[np.intp], at: Index, source: Segments, until_s: Array | float) -> None:
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

    def _put_whole(self, lanes: NDArray[np.intp], at: Index, source: Segments) -> None:
        """The same interval from a sample on. On a ramp its slopes come with its responses."""
        interval = self._interval(lanes, source, self._T_s)
        if self._ramped:
            whole = interval.source[0]._replace(turn=source.omega * self._T_s)
            self._put(lanes, at, interval._replace(source=(whole,)), np.ones(len(lanes)))
            self._put_ramp(lanes, at, source)
        else:
            self._put(lanes, at, interval)
        if self._taken:
            self._write(lanes, at, "circuit", np.column_stack([source.R_g, source.L_g]))
        if self._circuits is not None and "pcc" in self._spans:
            per_state, per_source = self._circuits.at_pcc(source.place)
            acting = per_state[:, self._by_state[:2]], per_source[:, self._by_state[:2, :2]]
            self._write(lanes, at, "pcc", np.column_stack(acting))

    def _put_ramp(self, lanes: NDArray[np.intp], at: Index, source: Segments) -> None:
        """The responses to a source and to its slopes, and where its ramp is."""
        rho = self._steps(source, self._T_s).source
        slopes = np.column_stack([rms_to_peak(source.V_slope), source.omega_slope])
        parts = [part for m in range(3) for part in (rho[:, m].real, rho[:, m].imag)]
        self._write(lanes, at, "ramp_of", np.column_stack([*parts, slopes]))
        self._write(lanes, at, "ramp", np.column_stack([rms_to_peak(source.V_g_rms), np.zeros(len(lanes))]))

    def _slope_rows(self, interval: _Interval, V_g: Array) -> Array:
        """Values of the grid current's slopes that the runs have."""
        if interval.slopes is None or self._of_slopes is None:
            raise ValueError("the interval has no slopes.")
        return interval.slopes.rows(V_g)[:, self._of_slopes]

    def _put(self, lanes: NDArray[np.intp], at: Index, interval: _Interval, V_g: Array | None = None) -> None:
        """``V_g``: the amplitude that the slopes have in them, where it is not that of the interval."""
        if interval.slopes is not None:
            rows = self._slope_rows(interval, interval.V_g if V_g is None else V_g)
            self._write(lanes, at, "slope", rows)
        for name, rows in self._rows(interval).items():
            self._write(lanes, at, name, rows)
        self._write(lanes, at, "V_g", interval.V_g)
        self._write(lanes, at, "edge", interval.edge)
        if self._turns:  # else it is fed where it is watched
            self._write(lanes, at, "of.turn", interval.source[0].turn)

    def _write(self, lanes: NDArray[np.intp], at: Index, name: str, values: Array) -> None:
        """Before a sample, a record or a number takes values; nothing happens where the runs have none of this name."""
        if name in self._spans:
            self._writer.put(lanes + self._first, at, self._spans[name].start, values)

    def _steps(self, source: Segments, h: Array | float) -> PlantSteps:
        if self._circuits is None:
            return plant_steps(self._study, source.R_g, source.L_g, h, source.omega, edges=self._edged)
        return self._circuits.steps(source.place, np.broadcast_to(h, source.omega.shape), source.omega)

    def _orders(self, lanes: NDArray[np.intp]) -> Array:
        """How often each part of the source turns with its fundamental, (parts, n)."""
        orders = np.ones((1, len(lanes)))
        return orders if self._waves is None else np.concatenate([orders, self._waves.order[lanes].T])

    def _interval(
        self, lanes: NDArray[np.intp], source: Segments, h: Array | float, angle: Array | float = 0.0
    ) -> _Interval:
        """An interval of length h (s) that begins with the segments given, which are those of the lanes. ``angle``:
        that of the source over its phasor at the sample, rad, for the grid current's slopes."""
        if self._circuits is not None:  # a source on a ramp is added from outside
            steady = (source.V_slope == 0.0) & (source.omega_slope == 0.0)
            source = source._replace(
                V_g_rms=np.where(steady, source.V_g_rms, 0.0),
                V_slope=np.zeros_like(source.V_slope),
                omega_slope=np.zeros_like(source.omega_slope),
            )
            turn = np.where(steady, source.omega * h, 0.0)
        else:
            turn = source.omega * h + 0.5 * source.omega_slope * h * h
        steps = self._steps(source, h)
        V, a, r = rms_to_peak(source.V_g_rms), rms_to_peak(source.V_slope), source.omega_slope
        if self._axes is None:
            weights = np.stack([V + 0j, a + 0j, 0.5j * V * r], axis=1)  # :eq:`source-ramp` without a drift
            added = np.einsum("nm,nmi->ni", weights, steps.source)
        else:
            added = steps.source[:, 0] * V[:, None, None]
        edge = self._edges(steps) if self._edged else np.empty((len(added), 0))
        parts = [_Part(added, turn)]
        if self._waves is not None:
            for order, size in zip(self._waves.order[lanes].T, self._waves.size[lanes].T, strict=True):
                of_wave = plant_steps(self._study, source.R_g, source.L_g, h, order * source.omega).source[:, 0]
                parts.append(_Part(size[:, None] * of_wave, order * source.omega * h))
        slopes = None
        if self._of_slopes is not None:
            slopes = grid_slopes(
                self._study, self._circuits, source, np.asarray(h), np.asarray(angle), self._most_turns
            )
        return _Interval(steps.transition, steps.bridge, tuple(parts), edge, V, slopes)

    def _rows(self, interval: _Interval) -> dict[str, Array]:
        """Values of :class:`vsgdesign.simulation.circuit_sample.PlantRow`, (n, 20), or those of two axes, and the end
        of such a row for each component of the source."""
        count, sources = len(interval.V_g), [self._source_row(part) for part in interval.source]
        if self._axes is None:
            acting = [interval.transition.reshape(count, -1), interval.bridge]
        elif self._by_columns:
            acting = [interval.transition.swapaxes(1, 2).reshape(count, -1), interval.bridge[:, self._by_axis]]
        else:
            acting = [interval.transition[:, self._by_state], interval.bridge[:, self._by_axis]]
        waves = {f"wave_{k}.row": row for k, row in enumerate(sources[1:])}
        return {"row": np.column_stack([*acting, sources[0]]), **waves}

    def _source_row(self, part: _Part) -> Array:
        added, turn = part.added, directions(part.turn.tolist(), strict=self._study.simulation.strict)
        both = [np.real(added), np.imag(added)] if self._axes is None else [added.reshape(len(added), -1)]
        return np.column_stack([*both, turn])

    def _edges(self, steps: PlantSteps) -> Array:
        """Values of :class:`vsgdesign.simulation.circuit_sample.EdgeRow`, (n, 45): each state's coefficients, from the
        constant one on. Of two axes: of each coefficient the states and inputs that act on each other."""
        count, terms = steps.edge.shape[:2]
        most = (LARGEST_DEGREE if self._axes is None else self._axes.degree) + 1
        if terms > most or not np.isfinite(steps.edge).all():
            raise InfeasibleStudyError(
                "the circuit is too stiff to switch in a batch: its fastest mode (R/L or R_c/L) dies out within a "
                'sampling period. Sample faster, lower R_c, raise x_over_r, or use bridge = "averaged".'
            )
        full = np.zeros((count, most, *steps.edge.shape[2:]))
        full[:, :terms] = steps.edge
        if not self._slopes:  # of an averaged bridge their slopes alone are needed
            full = full[:, 1:]
        if self._axes is None:
            return full.transpose(0, 2, 1).reshape(count, -1)
        return full[:, :, self._by_axis].reshape(count, -1)


def _product(transition: Array, values: NDArray[Any]) -> NDArray[Any]:
    """Φ (n, S, S) times (n, S) or (n, S, 2)."""
    return np.einsum("nij,nj...->ni...", transition, values)


def _turned(source: NDArray[Any], angle: Array) -> NDArray[Any]:
    """What the source adds, for a phasor that lies an angle (rad, (n,)) behind that at its beginning."""
    if np.iscomplexobj(source):
        return source * np.exp(1j * angle)[:, None]
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    c, s = source[..., 0], source[..., 1]
    return np.stack([c * cosine + s * sine, s * cosine - c * sine], axis=-1)


def _held_ramp(source: NDArray[Any]) -> Array:
    """Values of :class:`vsgdesign.simulation.sample.RampRow`, (n, 20), where an interval has the whole source."""
    whole = np.zeros((len(source), 20))
    whole[:, :3], whole[:, 3:6] = np.real(source), np.imag(source)
    return whole


class ProgramWriter:
    """Collects records of lanes, in any order of time. Records of one lane and sample are done in the order in which
    they were added."""

    def __init__(self) -> None:
        self._parts: list[tuple[Index, Index, Index, Index, Index]] = []
        self._values: list[Array] = []
        self._size = 0

    def put(self, lane: ArrayLike, at: ArrayLike, row: int, values: Array) -> None:
        """Before sample ``at`` (n,) of a lane (n,), the rows from ``row`` on take values (n, count), or (n,)."""
        values = np.asarray(values, dtype=float)
        values = values[:, None] if values.ndim == 1 else values
        count = values.shape[1]
        source = self._size + count * np.arange(len(values))
        self._values.append(values.ravel())
        self._size += values.size
        self._add(lane, at, row, count, source)

    def copy(self, lane: ArrayLike, at: ArrayLike, row: int, count: int, origin: int) -> None:
        """Before sample ``at`` (n,) of a lane (n,), ``count`` rows from ``row`` on take those from ``origin`` on."""
        self._add(lane, at, row, count, np.full(np.shape(lane), -1 - origin))

    def _add(self, lane: ArrayLike, at: ArrayLike, row: int, count: int, source: Index) -> None:
        lane, at = np.asarray(lane, dtype=np.int64), np.asarray(at, dtype=np.int64)
        same = np.broadcast_to(np.int64(row), lane.shape), np.broadcast_to(np.int64(count), lane.shape)
        self._parts.append((lane, at, *same, source.astype(np.int64)))

    def program(self, groups: int, width: int) -> Program:
        """The program of so many groups of ``width`` lanes."""
        nothing = np.zeros(0, dtype=np.int64)
        parts = self._parts or [(nothing,) * 5]
        lane, at, row, count, source = (np.concatenate(values) for values in zip(*parts, strict=True))
        group = lane // width
        order = np.lexsort((np.arange(len(lane)), at, group))
        first = np.searchsorted(group[order], np.arange(groups + 1)).astype(np.int64)
        return Program(
            first=first,
            at=at[order],
            lane=(lane % width)[order],
            row=row[order],
            count=count[order],
            source=source[order],
            values=np.concatenate([np.zeros(0), *self._values]),
            done=first[:-1].copy(),
        )
