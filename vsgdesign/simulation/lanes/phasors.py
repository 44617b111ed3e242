"""Where the sources of many runs are: their phasors at the beginning, and anew where a stretch of a single run begins.

A phasor that turns in the loop gathers a rounding in every sample. Two runs of one case stay together to the last
digits only if both take up their phasors at the same samples
(:meth:`vsgdesign.simulation.added_source.AddedSource.phasors`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vsgdesign.equations.power_loops import References
from vsgdesign.simulation.added_source import PROGRESS_STRETCH
from vsgdesign.simulation.batch import Batch
from vsgdesign.simulation.circuit_program import SAME_INSTANT, ProgramWriter
from vsgdesign.simulation.lanes.cases import LaneCases
from vsgdesign.simulation.timeline import Segments, Waves

Array = NDArray[np.float64]
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
