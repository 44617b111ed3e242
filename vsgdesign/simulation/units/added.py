"""What the grid's source adds to the circuit of a plant besides its fundamental, or a record in its place, gap by gap,
and the errors and the noise that the sensors of each unit add to what it measures.

The circuit is linear, so each component adds its own exact response, whatever the converters do (:eq:`plant-added`).
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsgdesign.codegen.records import numbers_of
from vsgdesign.equations.frames import rms_to_peak
from vsgdesign.linear.operating_point.circuit_of_units import Topology, UnitsCircuit, Wiring, circuit_of_units
from vsgdesign.linear.operating_point.flow_of_units import Clock
from vsgdesign.linear.operating_point.plant import less_one
from vsgdesign.simulation.added_source import SensorsOfRun
from vsgdesign.simulation.background import Background, Interval
from vsgdesign.simulation.circuit_program import SAME_INSTANT
from vsgdesign.simulation.units.timeline import PlantTimeline
from vsgdesign.study.parameters.study import Study

Array = NDArray[np.float64]


class _OfPlant(Background):
    """The components of a source at the grid's impedance of a plant. In place of a connection it takes a topology."""

    def __init__(self, wiring: Wiring, names: tuple[str, ...], V_base_pk: float, timeline: Any) -> None:
        super().__init__(lambda _: None, V_base_pk, timeline)  # type: ignore[arg-type, return-value]
        self._wiring, self._names = wiring, names
        self._lines = functools.lru_cache(maxsize=64)(self._straight)

    def circuit(self, topology: Topology) -> UnitsCircuit:
        """The circuit in a topology."""
        return circuit_of_units(self._wiring, topology, self._names)

    def _states(self, connection: Any) -> int:
        del connection  # the states are those of all topologies
        return 2 * len(self._names)

    def _response(self, connection: Any, h: float, omega: float) -> NDArray[Any]:
        circuit = self.circuit(connection)
        n = len(circuit.A)
        # The third input is e^{jωs}; the second makes (s/h) e^{jωs} of it, and the first (s/h)² e^{jωs} of that.
        M = np.zeros((n + 3, n + 3), dtype=complex)
        M[:n, :n], M[:n, n] = circuit.A, circuit.E[:, 0]
        M[n:, n:] = 1j * omega * np.eye(3) + np.diag([1.0 / h, 2.0 / h], 1)
        grown = circuit.X @ less_one(M * h)[:n, n:] + circuit.X_g[:, :1] * np.exp(1j * omega * h)
        found = np.empty((3, 2 * len(grown)), dtype=complex)
        for m in range(3):
            found[m, 0::2], found[m, 1::2] = grown[:, m] * h**m, -1j * grown[:, m] * h**m
        return found

    def _straight(self, connection: Any, h: float) -> Array:
        """What a source v + s·t at the grid adds, as
        :func:`vsgdesign.linear.operating_point.plant.straight_line_responses` has it."""
        circuit = self.circuit(connection)
        n = len(circuit.A)
        M = np.zeros((n + 2, n + 2))
        M[:n, :n], M[:n, n], M[n, n + 1] = circuit.A, circuit.E[:, 0], 1.0
        grown = circuit.X @ less_one(M * h)[:n, n:]
        found = np.zeros((4, 2 * len(grown)))
        for k, at_end in enumerate((1.0, h)):
            found[2 * k, 0::2] = found[2 * k + 1, 1::2] = grown[:, k] + at_end * circuit.X_g[:, 0]
        return found


class AddedToPlant:
    """What is fed to the loop of a plant: for each instant the increments of the circuit's states over the gap before
    it, α and β in turn, and the voltage that is added to the source's at the instant."""

    def __init__(self, study: Study, timeline: PlantTimeline, wiring: Wiring, clock: Clock) -> None:
        self._timeline, self._clock = timeline, clock
        V = rms_to_peak(study.converter.V_rated_rms)
        self._background = _OfPlant(wiring, timeline.names, V, timeline.shared)
        self._width = 2 * len(timeline.names)
        self._starts = np.array([one.t_s for one in timeline.segments])
        self._slack = SAME_INSTANT * min(one.gap for one in clock.instants)

    def fed(self, begin: int, end: int) -> Array:
        """(1, end − begin, 2n + 2, 1), for samples ``begin`` to ``end`` − 1 of the loop."""
        first = max(begin - 1, 0)
        rows = self._rows(first, end)
        found = np.zeros((end - begin, self._width + 2))
        found[begin == 0 :, : self._width] = rows[: end - 1 - first, : self._width]
        found[:, self._width :] = rows[begin - first :, self._width :]
        return found[None, :, :, None]

    def _rows(self, first: int, end: int) -> Array:
        """For each gap from instant ``first`` on: the increments over it, and the voltage at its beginning."""
        per, period = len(self._clock.instants), self._clock.period
        instants = np.arange(first, end)
        t_s = (instants // per) * period + np.array([one.t_s for one in self._clock.instants])[instants % per]
        segment = np.maximum(np.searchsorted(self._starts, t_s + self._slack, side="right") - 1, 0)
        found = np.empty((end - first, self._width + 2))
        for place, slot in itertools.product(np.unique(segment).tolist(), range(per)):
            own = np.flatnonzero((segment == place) & (instants % per == slot))
            if len(own):
                since = np.arange(len(own), dtype=np.float64) * period
                at = self._clock.instants[slot]
                interval = self._interval(place, float(t_s[own[0]]), at.gap)
                found[own] = self._background.over(interval, int(instants[own[0]] // per), since, at.t_s)
        for start in self._starts[(self._starts > t_s[0]) & (self._starts < self._clock.time(end))].tolist():
            i = int(np.searchsorted(t_s, start - self._slack, side="right")) - 1
            if i >= 0 and start - t_s[i] > self._slack:
                found[i] = self._in_pieces(first + i)
        return found

    def _interval(self, segment: int, t_s: float, h: float) -> Interval:
        own = self._timeline.segments[segment]
        return Interval(h, own.topology, own.source.at(t_s), own.components)  # type: ignore[arg-type]

    def _in_pieces(self, i: int) -> Array:
        """A gap in which events fall."""
        begin, end, period = self._clock.time(i), self._clock.time(i + 1), i // len(self._clock.instants)
        inside = self._starts[(self._starts > begin + self._slack) & (self._starts < end - self._slack)].tolist()
        marks = [begin, *inside, end]
        joint = np.zeros(self._width + 2)
        for k, (t_s, until) in enumerate(itertools.pairwise(marks)):
            segment = int(np.searchsorted(self._starts, t_s + self._slack, side="right")) - 1
            interval = self._interval(max(segment, 0), t_s, until - t_s)
            elapsed = t_s - period * self._clock.period
            row = self._background.over(interval, period, np.zeros(1), elapsed)[0]
            if k == 0:
                joint = row
                continue
            phi = self._background.circuit(self._timeline.segments[max(segment, 0)].topology).moved(
                until - t_s, interval.source.omega
            )[0]
            states = joint[: self._width].reshape(-1, 2)
            joint[: self._width] = (phi @ states).ravel() + row[: self._width]
        return joint


def adds(timeline: PlantTimeline) -> bool:
    """Whether the grid's source has more than its fundamental at any time."""
    shared = timeline.shared
    moving = shared.wander is not None and shared.wander.spec.distorts
    more = (one.components or not one.source.steady for one in timeline.segments)
    return moving or shared.replay is not None or any(more)


def put_sensors(at: Callable[[str], Array], k: int, sensors: SensorsOfRun | None) -> None:
    """Puts the sensors of a unit into the rows of a run."""
    if sensors is not None:
        at(f"u{k}.sensors")[:] = numbers_of(sensors.constants)
        at(f"u{k}.before")[:] = sensors.before


def with_noise(
    more: Array | None, sensors: Sequence[SensorsOfRun | None], clock: Clock, begin: int, end: int
) -> Array | None:
    """What is fed over samples of the loop, (1, end − begin, n, 1), with the noise of all sensors behind it; None:
    nothing. Each unit draws for its own samples."""
    found, per = [] if more is None else [more], len(clock.instants)
    for k, own in enumerate(sensors):
        if own is None:
            continue
        at = [j for j, one in enumerate(clock.instants) if k in one.units]
        turn, place = divmod(begin, per)
        rows = np.flatnonzero(np.isin(np.arange(begin, end) % per, at))
        noise = own.noise(turn * len(at) + sum(one < place for one in at), len(rows))
        fed = np.zeros((1, end - begin, noise.shape[1], 1))
        fed[0, rows, :, 0] = noise
        found.append(fed)
    return np.concatenate(found, axis=2) if found else None
