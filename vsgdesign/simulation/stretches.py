"""A stretch of a run in which neither the circuit nor its source changes, and the interval that an event cuts."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsgdesign.frames import rms_to_peak
from vsgdesign.simulation.background import Background, Interval
from vsgdesign.simulation.bodies import FALLING, PEAK, RISING
from vsgdesign.simulation.circuits import Circuits, connection_at
from vsgdesign.simulation.loop import PieceRows, RunLoop, carrier_part, slopes_of
from vsgdesign.simulation.run_log import RunLog
from vsgdesign.simulation.timeline import SourceSegment, Timeline

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stretch:
    """Samples ``first`` … ``first + count − 1``. One whose interval an event cuts is a single sample long."""

    first: int
    count: int
    pieces: list[PieceRows]
    fed: Array | None
    """(count, n): what the loop is given for every sample; None for nothing."""

    def run(self, loop: RunLoop, log: RunLog, done: int) -> int:
        """Runs what is left of it after ``done`` samples, or less. Returns how many samples were run."""
        if len(self.pieces) > 1 and self.fed is not None:
            log.run_in_pieces(loop, self.first, self.pieces, self.fed[0])
            return 1
        if done == 0:
            loop.put_piece(self.pieces[0])
        fed = None if self.fed is None else self.fed[done:]
        return log.run(loop, self.first + done, self.first + self.count, fed)


class Sources:
    """The stretches of a run with their source. A source that is ramped is added from outside the loop, as its other
    components are (:eq:`source-ramp`)."""

    def __init__(self, circuits: Circuits, background: Background, timeline: Timeline) -> None:
        self._circuits, self._background, self._timeline = circuits, background, timeline
        self._changes = timeline.plant_changes()
        self._held: tuple[float, float, tuple[SourceSegment, Mapping[str, Array]] | None] = math.inf, -math.inf, None
        moving = timeline.wander is not None or timeline.replay is not None
        self._distorted = moving or any(components for _, components in timeline.components)

    def stretch(self, first: int, count: int, T_s: float, noise: Array | None, per_carrier: int) -> Stretch:
        """The stretch; ``noise`` (count, 9) is that of the sensors, if they are not ideal."""
        start, end = first * T_s, (first + 1) * T_s
        inside = [t for t in self._changes if start < t < end and on_sample(t, T_s) is None]
        if not inside and not self._distorted:
            t_s = start + 1e-6 * T_s
            held = self._held_at(t_s, T_s)
            if held is not None:  # as mostly: nothing is added to the source, and the interval is in one piece
                source, numbers = held
                phase = source.phase + source.omega * (t_s - source.t_s) + source.omega * (start - t_s)
                pieces = [PieceRows(numbers, (math.cos(phase), math.sin(phase)))]
                return Stretch(first, count, pieces, None if noise is None else np.ascontiguousarray(noise))
        instants = [start, *inside]
        lengths = np.diff([*instants, end]).tolist() if inside else [T_s]
        found = []
        for k, h in enumerate(lengths):
            t_s = instants[k] + 1e-6 * T_s if k == 0 else instants[k]
            source = self._timeline.source_at(t_s).at(instants[k])
            found.append(
                Interval(float(h), connection_at(self._timeline, t_s), source, self._timeline.components_at(t_s))
            )
        added = None
        if self._background.acts(found):
            added = self._background.rows(found, first, count, T_s)
        elif len(found) > 1:
            added = np.zeros((len(found), self._circuits.states + 2))
        fed = [] if added is None else [added[:1] if len(found) > 1 else added]
        fed += [] if noise is None else [noise]
        whole = None if not fed else np.ascontiguousarray(np.concatenate(fed, axis=1))
        return Stretch(first, count, self._intervals(found, added, first, T_s, per_carrier), whole)

    def _held_at(self, t_s: float, T_s: float) -> tuple[SourceSegment, Mapping[str, Array]] | None:
        """The source at an instant, and the numbers of the circuit over one interval, until the next change; None for a
        source that is ramped."""
        since, until, held = self._held
        if not since <= t_s < until:
            k = bisect_right(self._changes, t_s)
            since, until = ((-math.inf, *self._changes)[k], (*self._changes, math.inf)[k])
            source = self._timeline.source_at(t_s, described=False)
            if source.steady:
                numbers = self._circuits.numbers(
                    connection_at(self._timeline, t_s), T_s, rms_to_peak(source.V_g_rms), source.omega
                )
                held = source, numbers
            else:
                held = None
            self._held = since, until, held
        return held

    def _piece(self, interval: Interval) -> PieceRows:
        source = interval.source
        omega = source.omega if source.steady else None
        numbers = self._circuits.numbers(interval.connection, interval.h, rms_to_peak(source.V_g_rms), omega)
        return PieceRows(numbers, (math.cos(source.phase), math.sin(source.phase)))

    def _intervals(self, found: list[Interval], added: Array | None, first: int, T_s: float, n: int) -> list[PieceRows]:
        if len(found) == 1:
            return [self._piece(found[0])]
        made, elapsed = [], 0.0
        for k, piece in enumerate(found):
            whole = self._piece(piece)
            slope, part = "", None
            if self._circuits.switched:
                j = first % n
                scale = 1.0 / (n * T_s)
                begin = j / n + elapsed * scale
                end = j / n + (elapsed + piece.h) * scale if k < len(found) - 1 else j / n + 1.0 / n
                slope, part = slopes_of(n)[j], carrier_part(begin, end)
                if slope == PEAK and (begin >= 0.5 or end <= 0.5):
                    slope = FALLING if begin >= 0.5 else RISING
            made.append(PieceRows(whole.circuit, whole.source, slope, part, None if added is None else added[k]))
            elapsed += piece.h
        return made


def on_sample(t_s: float, T_s: float) -> int | None:
    """The sample that an instant coincides with (to a millionth of a period), if any."""
    k = round(t_s / T_s)
    return k if abs(t_s / T_s - k) < 1e-6 else None
