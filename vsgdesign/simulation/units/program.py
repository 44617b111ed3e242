"""What circuit and sources do between two instants of a plant's clock, as records of the loop (:eq:`plant-gap`).

The numbers of a gap are a matrix. An event at an instant changes the matrices from the next gap on. Events within a gap
make one matrix of its pieces, which serves this gap alone. In a run with switched bridges such a gap is moved from edge
to edge.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.errors import InfeasibleStudyError
from vsgdesign.linear.operating_point.circuit_of_units import UnitsCircuit, Wiring, circuit_of_units
from vsgdesign.linear.operating_point.flow_of_units import Clock
from vsgdesign.simulation.circuit_program import SAME_INSTANT, ProgramWriter
from vsgdesign.simulation.units.body import AXES, PlantKind
from vsgdesign.simulation.units.carriers import edges_of, gaps_of_plant
from vsgdesign.simulation.units.timeline import PlantSegment, PlantTimeline
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


class Gap(NamedTuple):
    """An interval: y moves by ``phi`` y + ``gamma`` v_b + ``rho`` p with unit phasors p, which turn by ``turn``. More
    rows behind those of y are integrals over it."""

    phi: Array
    gamma: Array
    rho: Complex
    turn: Complex
    """(S,): factors."""

    def then(self, other: Gap) -> Gap:
        """This interval, and another one after it."""
        n = self.phi.shape[1]
        found = Gap(
            other.phi @ self.phi[:n],
            other.phi @ self.gamma[:n] + other.gamma,
            other.phi @ self.rho[:n] + other.rho * self.turn,
            self.turn * other.turn,
        )
        for whole, first in ((found.phi, self.phi), (found.gamma, self.gamma), (found.rho, self.rho)):
            whole[n:] += first[n:]
        return found

    def turned(self, angle: float) -> Gap:
        """With the phasor of the grid, the first one, turned by more at its end."""
        turn = self.turn.copy()
        turn[0] *= np.exp(1j * angle)
        return self._replace(turn=turn)

    def numbers(self, terminals: Array | None = None) -> Array:
        """As the loop takes them: column by column, with the phasors behind the states, and behind these the voltages
        at terminals, ``terminals`` (m, n + S) per state and per phasor of a source."""
        n, sources = self.phi.shape[1], len(self.turn)
        behind = slice(n, n + 2 * sources)
        own = np.zeros((len(self.phi), n + 2 * sources + self.gamma.shape[1]))
        own[:, :n], own[:, behind.stop :] = self.phi, self.gamma
        own[:, behind][:, 0::2], own[:, behind][:, 1::2] = self.rho.real, -self.rho.imag
        rows = np.vstack([own[:n], np.zeros((2 * sources, own.shape[1]))])
        for s, one in enumerate(self.turn):
            at = slice(n + 2 * s, n + 2 * s + 2)
            rows[at, at] = [[one.real, -one.imag], [one.imag, one.real]]
        if terminals is not None:
            rows = np.vstack([rows, terminals[:, :n] @ rows[:n] + terminals[:, n:] @ rows[n::2]])
        return np.vstack([rows, own[n:]]).T.ravel()


def edge_responses(circuit: UnitsCircuit, h: float, units: int) -> Array:
    """:meth:`UnitsCircuit.edges` of a circuit that can be switched. Raises InfeasibleStudyError for another one."""
    found = circuit.edges(h, units)
    if not np.isfinite(found).all():
        raise InfeasibleStudyError(
            "the network is too stiff to switch: its fastest mode (R/L, or R_c/L) dies out many times between two "
            'samples. Give it less resistance or more inductance, or use bridge = "averaged".'
        )
    return found


class PlantProgram:
    """Writes the records of a run."""

    def __init__(self, kind: PlantKind, wiring: Wiring, segments: Sequence[PlantSegment], clock: Clock) -> None:
        self._kind, self._wiring, self._segments, self._clock = kind, wiring, segments, clock
        self._V = np.array([0.0, *(rms_to_peak(one.V_rms) for one in wiring.plant.sources)])
        self._T = min(one.gap for one in clock.instants)
        self._lane = 0
        self.cut: dict[int, list[tuple[float, float, PlantSegment]]] = {}
        """Of switched bridges: the pieces (begin and end, s, and the segment) of gaps in which events fall, by the
        sample at their ends. There the loop finds the circuit moved."""

    def time(self, k: int) -> float:
        """The instant of a sample of the loop, s."""
        return self._clock.time(k)

    def sample_from(self, t_s: float, unit: int | None = None) -> int:
        """The first sample of the loop at or after an instant, or the first one of a unit."""
        clock = self._clock
        count = len(clock.instants)
        k = max(int(t_s / clock.period) - 1, 0) * count
        while self.time(k) < t_s - SAME_INSTANT * self._T or (
            unit is not None and unit not in clock.instants[k % count].units
        ):
            k += 1
        return k

    def write(self, writer: ProgramWriter, row: int, V_g: int, lane: int = 0) -> None:
        """``row``: where the matrices begin. ``V_g``: the row of the amplitude of the grid's source. ``lane``: of which
        run they are."""
        first, slots, self._lane = self._segments[0], self._slots(), lane
        still = self._gap(first, 0.0)
        self._put(writer, 0, row, 0, still, first)
        self._put_all(writer, 1, row, first)
        writer.put([lane], [0], V_g, np.array([rms_to_peak(first.moved.V_g_rms)]))
        due: dict[int, list[PlantSegment]] = {}
        for one in self._segments[1:]:
            due.setdefault(self.sample_from(one.t_s), []).append(one)
        before = first
        for k, some in sorted(due.items()):
            begin, end, present, gap = self.time(k - 1), self.time(k), before, None
            pieces: list[tuple[float, float, PlantSegment]] = []
            for one in some:
                at = min(one.t_s, end)
                if end - at > SAME_INSTANT * self._T:
                    piece = self._gap(present, at - begin)
                    jump = one.source.phase - present.moved.at(one.t_s).phase
                    gap = (piece if gap is None else gap.then(piece)).turned(jump)
                    pieces.append((begin, at, present))
                    begin, present = at, one
            last = self._gap(present, end - begin)
            gap = last if gap is None else gap.then(last)
            jump = some[-1].moved.at(end).phase - present.moved.at(end).phase
            if pieces and self._kind.gaps:
                self.cut[k] = [*pieces, (begin, end, present)]
                gap = self._still(gap.turn)
            self._put(writer, k, row, k % slots, gap.turned(jump), some[-1])
            self._put_all(writer, k + 1, row, some[-1])
            writer.put([lane], [k], V_g, np.array([rms_to_peak(some[-1].moved.V_g_rms)]))
            before = some[-1]

    def _slots(self) -> int:
        return self._kind.turns

    def _put_all(self, writer: ProgramWriter, k: int, row: int, segment: PlantSegment) -> None:
        """The matrices of all gaps from a sample on."""
        count = len(self._clock.instants)
        for slot in range(self._slots()):
            self._put(writer, k, row, slot, self._gap(segment, self._clock.instants[(slot - 1) % count].gap), segment)

    def _put(self, writer: ProgramWriter, k: int, row: int, slot: int, gap: Gap, at_end: PlantSegment) -> None:
        """The matrix of a gap before a sample, at which there is the segment ``at_end``."""
        numbers = gap.numbers(self._terminals(at_end))
        writer.put([self._lane], [k], row + slot * len(numbers), numbers[None])

    def _terminals(self, segment: PlantSegment) -> Array | None:
        """The voltages at the terminals that the loop is to give, per state and per phasor of a source."""
        if not self._kind.terminals:
            return None
        of_units = [int(name.removeprefix("terminal")) for name in self._kind.terminals]
        V = self._V.copy()
        V[0] = rms_to_peak(segment.moved.V_g_rms)
        per_state, per_source = circuit_of_units(self._wiring, segment.topology, self._kind.states).terminals
        return np.hstack([per_state, per_source * V])[of_units]

    def _gap(self, segment: PlantSegment, h: float) -> Gap:
        omega, V = segment.moved.omega, self._V.copy()
        V[0] = rms_to_peak(segment.moved.V_g_rms)
        turn = np.full(len(V), np.exp(1j * omega * h))
        if h == 0.0:
            return self._still(turn)
        circuit = circuit_of_units(self._wiring, segment.topology, self._kind.states)
        phi, gamma, rho = circuit.moved(h, omega)
        if self._kind.gaps:
            edges = edge_responses(circuit, h, len(self._kind.units))
            more = np.zeros((len(edges), self._kind.degree + 1, len(phi)))
            more[:, : edges.shape[1]] = edges
            gamma = np.hstack([gamma, more.reshape(-1, len(phi)).T])
        if self._kind.linked:
            more = circuit.charge(h, omega, self._kind.linked)
            phi, gamma, rho = np.vstack([phi, more[0]]), np.vstack([gamma, more[1]]), np.vstack([rho, more[2]])
        return Gap(phi, gamma, rho * V, turn)

    def _still(self, turn: Complex) -> Gap:
        """Nothing but the sources moves."""
        kind = self._kind
        n, m = len(kind.states), len(kind.states) + len(kind.linked)
        bridges = len(kind.factors) - len(kind.moved)
        return Gap(np.eye(m, n), np.zeros((m, bridges)), np.zeros((m, len(turn)), dtype=complex), turn)

    def moved(self, y: Complex, v: Complex, segment: PlantSegment, begin: float, end: float) -> Complex:
        """The circuit's states, α + jβ, over a piece of a gap with constant voltages of the bridges."""
        circuit = circuit_of_units(self._wiring, segment.topology, self._kind.states)
        phi, gamma, rho = circuit.moved(end - begin, segment.moved.omega)
        source, others = segment.moved.at(begin), self._wiring.plant.sources
        phases = source.phase + np.array([0.0, *(one.phase for one in others)])
        V = np.array([rms_to_peak(segment.moved.V_g_rms), *self._V[1:]])
        return phi @ y + gamma @ v + rho @ (V * np.exp(1j * phases))

    def switched(self, unit: int) -> Iterator[int]:
        """The samples of a unit at whose end of an interval the circuit has been switched in it."""
        for before, after in pairwise(self._segments):
            if after.topology.connected != before.topology.connected:
                k = self.sample_from(after.t_s, unit)
                inside = self.time(k) > after.t_s + SAME_INSTANT * self._T
                yield k if inside else self.sample_from(self.time(k) + 0.5 * self._T, unit)


def switched(
    kind: PlantKind, plants: Sequence[tuple[PlantTimeline, Wiring]], clock: Clock, degree: int = 0
) -> PlantKind:
    """The kind of runs with switched bridges of the units: plants of one clock, whose carriers are alike. ``degree``:
    of the responses to edges, at least. Raises InfeasibleStudyError where a dc link moves, the carriers do not repeat,
    or a circuit is too stiff."""
    gaps = gaps_of_plant(plants[0][0], clock)
    sampling = kind.sampling * (len(gaps) // len(kind.sampling))
    most = max(degree, *(_degree(timeline, wiring, clock) for timeline, wiring in plants))
    return kind._replace(sampling=sampling, turns=1 if kind.turns == 1 else len(sampling), gaps=gaps, degree=most)


def _degree(timeline: PlantTimeline, wiring: Wiring, clock: Clock) -> int:
    """The largest degree of a response to an edge in the circuits of a run."""
    units, lengths = len(timeline.units), {one.gap for one in clock.instants}
    topologies = {one.topology for one in timeline.segments}
    circuits = [circuit_of_units(wiring, one, timeline.names) for one in topologies]
    return max(edge_responses(one, h, units).shape[1] - 1 for one in circuits for h in lengths)


def cross(
    at: Callable[[str], Array], kind: PlantKind, program: PlantProgram, units: Sequence[Study], sample: int
) -> None:
    """Moves the circuit over the gap before a sample of the loop. ``at``: the numbers of a record or of one number by
    its name, as an array that moves with the run."""

    def both(before: str, behind: str) -> complex:
        return complex(*(at(f"{before}{axis}{behind}")[0] for axis in AXES))

    begin, end = program.time(sample - 1), program.time(sample)
    y = np.array([both("", f".{name}") for name in kind.states])
    v = np.array([both("", f".held.{k}") for k in range(kind.converters)])
    edges: list[tuple[float, int, complex]] = []
    for k, (gap, study) in enumerate(zip(kind.gaps[(sample - 1) % len(kind.gaps)], units, strict=True)):
        c = study.converter
        own = edges_of(both(f"u{k}.acts.", ""), c.V_dc, gap, zero_sequence=c.zero_sequence)
        edges += [(begin + share * (end - begin), k, step) for share, step in own]
    for first, last, segment in program.cut[sample]:
        marks = sorted({first, last, *(t_s for t_s, _, _ in edges if first < t_s < last)})
        for one, other in itertools.pairwise(marks):
            now = v.copy()
            for t_s, k, step in edges:
                now[k] += step if t_s <= one else 0.0
            y = program.moved(y, now, segment, one, other)
    for name, value in zip(kind.states, y.tolist(), strict=True):
        at(f"alpha.{name}")[:], at(f"beta.{name}")[:] = value.real, value.imag
